//! Orders are taken in time or not at all.

use super::{Cell, ended, files, signal};
use crate::cell::wait_until;
use std::path::Path;

/// The daemon is stopped, `arm` is given, its client ends: after the daemon goes on, nothing is armed.
#[test]
fn cell_does_not_arm_for_a_client_that_has_ended() {
    let cell = Cell::start("127.7.9.1", &[]);
    for (way, taken_back) in [("INT", true), ("KILL", false)] {
        cell.signal("STOP");
        let client = cell.client(&["arm"]);
        wait_until("the order lies there", || files(&cell, ".command") == 1);
        signal(way, client.0.id());
        let (code, said) = ended(client);
        assert_eq!(code, taken_back.then_some(130), "{way}: {said}");
        assert_eq!(said.contains("taken back: nothing was done"), taken_back, "{way}: {said}");
        assert_eq!(files(&cell, ".command"), usize::from(!taken_back), "{way}");
        cell.signal("CONT");
        if !taken_back {
            wait_until("it is refused", || cell.log().contains("the client that gave this order ended"));
        }
        let (code, said) = cell.celld(&["recover"]);
        assert_eq!(code, Some(0), "the daemon takes orders: {said}");
        assert!(!cell.armed(), "{way}: {}", cell.log());
    }
    // Nothing else kept it from being armed.
    cell.arm();
}

/// A thousand orders lie in the folder; an abort is carried out before them.
#[test]
fn cell_is_aborted_before_a_thousand_other_orders() {
    let cell = Cell::start("127.7.9.2", &[]);
    cell.carry();
    let daemon = cell.status()["daemon"].as_str().expect("a name").to_string();
    // None of them moves the arm, and no client waits for them.
    let text = format!(r#"{{"daemon": "{daemon}", "boot_s": 1.0, "command": {{"do": "resume"}}}}"#);
    let folder = cell.state().join("commands");
    cell.signal("STOP");
    (0..1000).for_each(|n| std::fs::write(folder.join(format!("{n:04}.command")), &text).expect("written"));
    let abort = cell.client(&["abort"]);
    wait_until("the abort lies there", || files(&cell, "-stop.command") == 1);
    cell.signal("CONT");
    let (code, said) = ended(abort);
    assert!(said.contains("disarmed"), "{code:?}: {said}");
    assert!(files(&cell, ".command") > 0, "others were taken before it");
    assert!(cell.rests(), "{said}");
    // The status follows the answer, by as much as its file takes.
    wait_until("the status says disarmed", || !cell.armed());
    wait_until("the others are refused", || files(&cell, ".command") == 0);
}

/// Without a file handle left, an abort is taken and answered, and the robot is reached again.
#[test]
fn cell_is_aborted_and_reaches_its_robot_without_a_file_handle_left() {
    let mut cell = Cell::start("127.7.9.3", &[]);
    cell.carry();
    let id = cell.daemon().id();
    // Every handle below the first free number is in use: nothing more can be opened.
    let is_free = |n: &u64| !Path::new(&format!("/proc/{id}/fd/{n}")).exists();
    let limit = (0..).find(is_free).expect("a free number");
    let lowered = std::process::Command::new("prlimit")
        .args([format!("--pid={id}"), format!("--nofile={limit}:{limit}")])
        .status();
    assert!(lowered.expect("prlimit").success());
    // What becomes free below the limit is used up from outside: connections to the daemon's page, as many
    // as wait without being accepted.
    let page: Vec<_> =
        (0..120).map_while(|_| std::net::TcpStream::connect((cell.address, 8737)).ok()).collect();
    let (code, said) = cell.celld(&["abort"]);
    assert!(said.contains("disarmed"), "{code:?}: {said}");
    assert!(cell.rests());
    for n in 0..20 {
        let (code, said) = cell.celld(&["disarm"]);
        assert_eq!(code, Some(0), "{n}: {said}");
    }
    cell.stop_robot();
    wait_until("the robot is silent", || cell.robot_silent_s() > 2.0);
    cell.start_robot();
    wait_until("the robot answers", || cell.robot_silent_s() < 1.0);
    assert!(cell.log().contains("a connection could not be accepted"), "handles were left");
    drop(page);
    wait_until("the status says so", || !cell.armed());
}
