//! `celld doctor` as a user starts it, against the simulator and the daemon, over real sockets: what it
//! finds missing is missing, and once nothing is, the cell can be armed.

use crate::cell::{LOG, celld, configuration, copy_calibration, start_daemon, start_sim, text, wait_until};
use crate::edit::replace_once;
use serde_json::Value;
use std::cell::RefCell;
use std::path::Path;

const ADDRESS: &str = "127.0.6.17";

/// The sheet, and the exit code. A computer that was held up while it was made finds a gap in the robot's
/// states, and says so: then it is made anew.
fn sheet(folder: &Path) -> (Value, i32) {
    let made = RefCell::new((Value::Null, 1));
    wait_until("the robot's states come in a row", || {
        *made.borrow_mut() = one_sheet(folder);
        !missing(&made.borrow().0, "problem").contains(&"robot states".to_string())
    });
    made.into_inner()
}

fn one_sheet(folder: &Path) -> (Value, i32) {
    let run = celld(&["doctor", "--format", "json"], folder);
    let sheet = serde_json::from_slice(&run.stdout);
    let code = run.status.code().expect("an exit code");
    (sheet.unwrap_or_else(|error| panic!("{error}: {} {}", text(&run.stdout), text(&run.stderr))), code)
}

/// The lines that are not as they should be, as `area item`.
fn lines(sheet: &Value, verdict: &str) -> Vec<String> {
    let lines = sheet["lines"].as_array().expect("lines").iter();
    let word = |line: &Value, key: &str| line[key].as_str().expect("a word").to_string();
    lines
        .filter(|line| word(line, "verdict") == verdict)
        .map(|line| format!("{} {}", word(line, "area"), word(line, "item")))
        .collect()
}

/// The same without those of this computer, which may be slow while tests run.
fn missing(sheet: &Value, verdict: &str) -> Vec<String> {
    lines(sheet, verdict).into_iter().filter(|line| !line.starts_with("computer ")).collect()
}

/// The exit code that belongs to the sheet.
fn its_code(sheet: &Value) -> i32 {
    i32::from(!lines(sheet, "problem").is_empty())
}

fn strings(words: &[&str]) -> Vec<String> {
    words.iter().map(ToString::to_string).collect()
}

fn fault(order: &str) {
    let mut answer = ureq::post(format!("http://{ADDRESS}:8091/fault")).send(order).expect("an answer");
    let text = answer.body_mut().read_to_string().expect("text");
    assert!(text.contains("true"), "{order}: {text}");
}

fn order(folder: &Path, words: &[&str]) -> (i32, String) {
    let run = celld(words, folder);
    (run.status.code().expect("an exit code"), text(&run.stdout))
}

#[test]
fn cell_doctor_names_what_is_missing_until_the_arm_may_move() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    copy_calibration(folder);
    let (cell, sim) = configuration(folder, ADDRESS, 1);
    // As on a real cell: a person confirms the gripper.
    let text = std::fs::read_to_string(&cell).expect("the configuration");
    std::fs::write(&cell, replace_once(&text, "simulation: {clock_factor: 1}\n", "")).expect("written");

    let (off, code) = sheet(folder);
    let links = ["robot dashboard", "robot RTDE", "robot primary"];
    let rest = ["gripper Modbus", "camera picture", "arming `celld arm`"];
    assert_eq!((missing(&off, "problem"), code), (strings(&[links, rest].concat()), 1));

    let _sim = start_sim(&sim);
    let (on, code) = sheet(folder);
    assert_eq!(missing(&on, "problem"), ["gripper identity", "arming `celld arm`"], "{on:#}");
    assert_eq!((code, &on["ready"]), (1, &Value::Bool(false)));

    fault("{do: ur.local}");
    fault("{do: ur.claim, args: {input: input_int_register_24}}");
    let (faulty, _) = sheet(folder);
    let expected = ["robot remote control", "robot registers", "gripper identity", "arming `celld arm`"];
    assert_eq!(missing(&faulty, "problem"), expected, "{faulty:#}");
    assert!(faulty.to_string().contains("input_int_register_24"), "{faulty:#}");
    fault("{do: clear}");

    let daemon = start_daemon(folder, &cell);
    let log = || std::fs::read_to_string(folder.join(LOG)).unwrap_or_default();
    wait_until("the daemon runs", || log().contains("celld runs"));
    wait_until("arming is refused", || {
        let (code, why) = order(folder, &["arm"]);
        code == 1 && why.contains("celld confirm-gripper")
    });
    wait_until("the gripper is confirmed", || order(folder, &["confirm-gripper"]).0 == 0);
    wait_until("and the cell armed", || order(folder, &["arm"]).0 == 0);
    let (busy, code) = sheet(folder);
    assert_eq!((missing(&busy, "problem"), code), (Vec::new(), its_code(&busy)), "{busy:#}");
    let in_use = ["robot registers", "gripper in use", "camera in use", "arming in use"];
    assert!(in_use.iter().all(|line| missing(&busy, "note").contains(&line.to_string())), "{busy:#}");
    drop(daemon);

    let (ready, code) = sheet(folder);
    assert_eq!((missing(&ready, "problem"), code), (Vec::new(), its_code(&ready)), "remembered: {ready:#}");
    assert!(ready.to_string().contains("confirmed by a person"), "{ready:#}");
}
