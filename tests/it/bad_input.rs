//! Files that are wrong, one fault at a time and several at once, through the built binary: `celld check`
//! ends with exit code 2 and says file, line, column, what is wrong and what to change. Besides, wrong
//! options that must end with 2 before anything starts.

use crate::edit::replace_first;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const CONFIG: &str = include_str!("../../config/cell.yaml");
const SIM: &str = include_str!("../../config/sim.yaml");
const JOB: &str = "\
version: 1
goal:
  objects:
    - {id: plank-1, pose: [0.1, 0.1, 0]}
    - {id: block, pose: [0.4, 0.4, 0]}
objective: pp
";
const JOB_WITH_FILE: &str = "version: 1\ngoal: {file: goal.yaml}\n";
const INSTANCE: &str = "\
workspace: {width: 0.5, height: 0.5}
objects:
  - {id: a, footprint: {disc: {radius: 0.05}}, start: [0.1, 0.1, 0], goal: [0.4, 0.1, 0], marker: {id: 7, size: 0.04}}
  - {id: b, footprint: {disc: {radius: 0.05}}, start: [0.1, 0.4, 0], goal: [0.4, 0.4, 0], marker: {id: 8, size: 0.04}}
";
const CROSSING: &str = "footprint: [[0, 0], [0.1, 0.1], [0.1, 0], [0, 0.1]]";

/// A sound text, what is replaced by what, where the complaint has to point (a text from the replacement
/// on), and words of the complaint.
type Case = (&'static str, &'static str, &'static str, &'static str, &'static [&'static str]);

const CASES: &[Case] = &[
    (CONFIG, "keep_out: []", "keep_ut: []", "keep_ut", &["unknown key", "did you mean \"keep_out\""]),
    (CONFIG, "height: 0.02\n", "height: 20 mm\n", "20 mm", &["not a number", "without \"mm\""]),
    (CONFIG, "vacuum_min: 0.3", "vacuum_min: high", "high", &["not a number"]),
    (CONFIG, "clearance: 0.002", "clearance: .nan", ".nan", &["not a finite number"]),
    (CONFIG, "footprint: {disc: {radius: 0.045}}", CROSSING, "[0.1, 0], [0,", &["crosses itself", "reorder"]),
    (CONFIG, "id: 1, size: 0.036", "id: 00, size: 0.036", "00,", &["marker 0 is used twice", "plank-1"]),
    (CONFIG, "{id: 501,", "{id: 0500,", "0500", &["marker 500 is used twice"]),
    (CONFIG, "{id: 501,", "{id: 3,", "3,", &["marker 3 is also that of object \"lid\""]),
    (CONFIG, "solver: auto", "solver: best", "best", &["one of: tbm, rbm, etbm, erbm, mcts, emcts, auto"]),
    (CONFIG, "objective: pp", "objective: speed", "speed", &["not known here", "one of: pp, ti, time"]),
    (CONFIG, "mount: flange\n", "mount: wall\n", "wall", &["one of: flange, fixed"]),
    (SIM, "\nseed: 1", "\nsed: 1", "sed", &["unknown key", "did you mean \"seed\""]),
    (SIM, "start_deg: [0.12,", "start_deg: [12 cm,", "12 cm", &["without \"cm\""]),
    (SIM, "mass: 0.12", "mass: [0.12]", "[0.12]", &["a list where a number"]),
    (SIM, "\ntime_factor: 1", "\ntime_factor: .nan", ".nan", &["not a finite number"]),
    (SIM, "footprint: {disc: {radius: 0.045}}", CROSSING, "[0.1, 0], [0,", &["crosses itself"]),
    (SIM, "id: 1, size: 0.036", "id: 0, size: 0.036", "0,", &["marker 0 is used twice"]),
    (SIM, "{id: 501,", "{id: 0500,", "0500", &["marker 500 is used twice"]),
    (SIM, "{id: 501,", "{id: 3,", "3,", &["marker 3 is also that of object \"lid\""]),
    (SIM, "[0.34, 0.14, -60]", "[0.12, 0.14, -60]", "[0.12", &["\"plank-2\" overlaps \"plank-1\" by", "mm"]),
    (SIM, "[0.36, 0.38, 0]", "[0.49, 0.38, 0]", "[0.49", &["\"lid\" reaches over the table's edge by 35"]),
    (SIM, "bind: 127.0.0.2", "bind: localhost", "localhost", &["not an IP address"]),
    (SIM, "noise_levels: 2.0", "noise_levels: 0.0", "0.0", &["out of range", "between 0.1 and 50"]),
    (JOB, "objective: pp", "objctive: pp", "objctive", &["unknown key", "did you mean \"objective\""]),
    (JOB, "[0.1, 0.1, 0]", "[100 mm, 0.1, 0]", "100 mm", &["without \"mm\""]),
    (JOB, "objective: pp", "objective: [pp]", "[pp]", &["a list where a text is wanted"]),
    (JOB, "[0.1, 0.1, 0]", "[.nan, 0.1, 0]", ".nan", &["not a finite number"]),
    (JOB, "objective: pp", "objective: speed", "speed", &["not known here"]),
    (JOB, "{id: block", "{id: blok", "{id: blok", &["\"blok\" is unknown", "did you mean \"block\""]),
    (JOB, "{id: block", "{id: plank-1", "{id: plank-1", &["has a goal already, at line 4"]),
    (
        JOB,
        "{id: block, pose: [0.4, 0.4, 0]}",
        "{id: block, pose: [0.12, 0.1, 0]}",
        "{id: block",
        &["the goals of \"block\" and \"plank-1\" (line 4) overlap by", "move them apart"],
    ),
    (
        JOB,
        "{id: block, pose: [0.4, 0.4, 0]}",
        "{id: block, pose: [0.47, 0.4, 0]}",
        "{id: block",
        &["the goal of \"block\" reaches 10.00 mm over the table's edge"],
    ),
    (JOB_WITH_FILE, "goal.yaml", "/dev/zero", "/dev/zero", &["leads out of the goal folder"]),
    (JOB_WITH_FILE, "goal.yaml", "../goal.yaml", "../goal", &["leads out of the goal folder"]),
    (JOB_WITH_FILE, "goal.yaml", "none.yaml", "none.yaml", &["No such file", "goal_folder"]),
    (INSTANCE, "marker: {id: 7", "markr: {id: 7", "markr", &["unknown key", "did you mean \"marker\""]),
    (INSTANCE, "radius: 0.05", "radius: 50 mm", "50 mm", &["without \"mm\""]),
    (INSTANCE, "width: 0.5", "width: '0.5'", "'0.5'", &["text in quotes where a number"]),
    (INSTANCE, "[0.1, 0.1, 0]", "[0.1, .nan, 0]", ".nan", &["not a finite number"]),
    (INSTANCE, "footprint: {disc: {radius: 0.05}}", CROSSING, "[0.1, 0], [0,", &["crosses itself"]),
    (INSTANCE, "id: 8", "id: 07", "07", &["marker 7 is used twice, first by object \"a\" in line 3"]),
    (INSTANCE, "[0.1, 0.4, 0]", "[0.1, 0.15, 0]", "[0.1,", &["\"b\" overlaps \"a\" by 50.000 mm"]),
    (INSTANCE, "[0.4, 0.4, 0]", "[0.4, 0.15, 0]", "[0.4,", &["\"b\" overlaps \"a\" by 50.000 mm"]),
    (INSTANCE, "[0.4, 0.4, 0]", "[0.46, 0.4, 0]", "[0.46", &["over the table's edge by 10.000 mm"]),
    (INSTANCE, "{id: a,", "{strat: [0, 0, 0], id: a,", "strat", &["unknown key", "did you mean \"start\""]),
];

fn celld(words: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_celld"));
    command.args(words).output().expect("celld runs")
}

fn cell_yaml() -> String {
    format!("{}/config/cell.yaml", env!("CARGO_MANIFEST_DIR"))
}

/// What `celld check` says about a text, and the path it says it about.
fn reported(folder: &Path, name: &str, text: &str) -> (String, String) {
    let path: PathBuf = folder.join(name);
    std::fs::write(&path, text).expect("writable");
    let path = path.display().to_string();
    let output = celld(&["check", &path, "--config", &cell_yaml()]);
    assert_eq!(output.status.code(), Some(2), "{text}");
    (path, String::from_utf8(output.stdout).expect("text"))
}

/// Line and column of a place in a text, both from 1.
fn place(text: &str, index: usize) -> String {
    let before = &text[..index];
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
    format!("{line}:{column}")
}

#[test]
fn every_fault_is_reported_with_file_line_and_column() {
    let folder = tempfile::tempdir().expect("a folder");
    for (base, from, to, at, words) in CASES {
        let start = base.find(from).unwrap_or_else(|| panic!("{from:?} is not in the sound text"));
        let text = replace_first(base, from, to);
        let index = start + text[start..].find(at).expect("the place is in the text");
        let (path, reported) = reported(folder.path(), "bad.yaml", &text);
        let wanted = format!("{path}:{}: ", place(&text, index));
        let line = reported.lines().find(|line| line.starts_with(&wanted) && line.contains(words[0]));
        let line = line.unwrap_or_else(|| panic!("{to}: wanted {wanted}{words:?}, told:\n{reported}"));
        for word in *words {
            assert!(line.contains(word), "{to}: {word:?} is not in: {line}");
        }
    }
}

#[test]
fn the_texts_are_sound_before_they_are_spoilt() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("goal.yaml"), "objects:\n  - {id: lid, pose: [0.2, 0.2, 0]}\n")
        .expect("written");
    for text in [CONFIG, SIM, JOB, JOB_WITH_FILE, INSTANCE] {
        let path = folder.path().join("good.yaml");
        std::fs::write(&path, text).expect("writable");
        let output = celld(&["check", &path.display().to_string(), "--config", &cell_yaml()]);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stdout));
    }
}

#[test]
fn syntax_errors_have_a_place_in_every_kind_of_file() {
    let folder = tempfile::tempdir().expect("a folder");
    for text in [CONFIG, SIM, JOB, INSTANCE] {
        let (path, reported) = reported(folder.path(), "torn.yaml", &format!("{text}torn: [1, 2\n"));
        let rest = reported.strip_prefix(&format!("{path}:")).unwrap_or_else(|| panic!("{reported}"));
        let mut numbers = rest.split(':');
        let line: usize = numbers.next().and_then(|n| n.parse().ok()).expect("a line");
        let column: Option<usize> = numbers.next().and_then(|n| n.parse().ok());
        assert!(line >= text.lines().count() && column.is_some(), "{reported}");
    }
}

#[test]
fn three_faults_of_one_file_are_reported_in_one_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let spoilt = |text: &str, changes: [(&str, &str); 3]| {
        changes.iter().fold(text.to_owned(), |text, (from, to)| replace_first(&text, from, to))
    };
    let files = [
        (
            spoilt(
                CONFIG,
                [
                    ("tool_speed_m_s: 0.25", "tool_speed_m_s: 250 mm"),
                    ("{id: 501,", "{id: 3,"),
                    ("park_pose_deg: [-91.7", "park_pose_deg: [361"),
                ],
            ),
            [
                "without \"mm\"",
                "marker 3 is also that of object \"lid\"",
                "joint 1 at 361.0 degrees is outside its range",
            ],
        ),
        (
            spoilt(
                SIM,
                [
                    ("[0.36, 0.38, 0]", "[0.49, 0.38, 0]"),
                    ("mass: 0.12", "mass: heavy"),
                    ("{id: 501,", "{id: 500,"),
                ],
            ),
            ["over the table's edge", "\"heavy\" is not a number", "marker 500 is used twice"],
        ),
        (
            spoilt(JOB, [("[0.1, 0.1, 0]", "[0.1, 0.1]"), ("block", "blok"), ("pp", "speed")]),
            ["2 values, 3 are wanted", "\"blok\" is unknown", "\"speed\" is not known here"],
        ),
        (
            spoilt(
                INSTANCE,
                [("[0.4, 0.4, 0]", "[0.46, 0.4, 0]"), ("radius: 0.05", "radius: .nan"), ("id: 8", "id: 07")],
            ),
            ["over the table's edge", ".nan is not a finite number", "marker 7 is used twice"],
        ),
    ];
    for (text, wanted) in files {
        let (path, reported) = reported(folder.path(), "bad.yaml", &text);
        for word in wanted {
            let line = reported.lines().find(|line| line.contains(word));
            assert!(line.is_some_and(|line| line.starts_with(&format!("{path}:"))), "{word}:\n{reported}");
        }
    }
}

#[test]
fn devices_and_fifos_are_refused_and_never_read() {
    for words in [
        &["check", "/dev/zero"][..],
        &["plan", "/dev/zero"],
        &["submit", "/dev/zero"],
        &["verify", "/dev/zero", "/dev/zero"],
    ] {
        let output = celld(words);
        let reported = [output.stdout, output.stderr].concat();
        let reported = String::from_utf8_lossy(&reported);
        assert!(
            output.status.code() == Some(2) && reported.contains("not a regular file"),
            "{words:?}: {reported}"
        );
    }
}

#[test]
fn wrong_options_end_with_2_before_anything_starts() {
    let sim = format!("{}/config/sim.yaml", env!("CARGO_MANIFEST_DIR"));
    let cases: [(&[&str], &str); 6] = [
        (&["demo", "--solver", "foo"], "one of: tbm"),
        (&["demo", "--time-limit=-1"], "between 0.001 and 86400 s"),
        (&["demo", "--time-limit=nan"], "between 0.001 and 86400 s"),
        (&["demo", "--time-limit=1e30"], "between 0.001 and 86400 s"),
        (&["sim", "--time-factor", "0"], "between 0.01 and 1000"),
        (&["sim", "--config", &sim, "--bind", "0.0.0.0", "--control"], "this machine only"),
    ];
    for (words, expected) in cases {
        let output = celld(words);
        let reported = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && reported.contains(expected), "{words:?}: {reported}");
    }
}
