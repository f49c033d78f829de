//! Two daemons, each with a state folder of its own, on one robot: the second finds the mark of the first in
//! the robot's registers, says who is there, and neither arms nor disturbs it. `celld watch` prints what the
//! first does meanwhile.

use crate::cell::{
    CELLD, LOG, Running, celld, configuration, copy_calibration, eventually, start_daemon, start_sim, text,
    wait_until,
};
use crate::edit::replace_once;
use std::path::Path;
use std::process::Command;

/// `celld watch` on the daemon of this folder.
fn watch(folder: &Path) -> Running {
    let lines = std::fs::File::create(folder.join("watched.txt")).expect("a file");
    Running(
        Command::new(CELLD).arg("watch").current_dir(folder).stdout(lines).spawn().expect("the binary runs"),
    )
}

fn watched(folder: &Path) -> String {
    std::fs::read_to_string(folder.join("watched.txt")).expect("its lines")
}

#[test]
fn cell_second_daemon_on_one_robot_names_the_first_and_leaves_it_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let (cell, sim) = configuration(folder.path(), "127.7.6.9", 1);
    copy_calibration(folder.path());
    let _sim = start_sim(&sim);
    let first = start_daemon(folder.path(), &cell);
    let _watch = watch(folder.path());
    // A change is what differs from what was seen before: a look that comes later finds an armed cell.
    wait_until("who watches sees it disarmed", || watched(folder.path()).contains("(disarmed)"));
    wait_until("the first is armed", || celld(&["arm"], folder.path()).status.code() == Some(0));

    let other = folder.path().join("other");
    std::fs::create_dir(&other).expect("created");
    // Its page is another one: of two at one address the second daemon would not start at all.
    let first_cell = std::fs::read_to_string(&cell).expect("the configuration");
    let second = cell.with_file_name("second.yaml");
    std::fs::write(&second, replace_once(&first_cell, ":8737'}", ":8738'}")).expect("written");
    let _second = start_daemon(&other, &second);
    let log = || std::fs::read_to_string(other.join(LOG)).expect("what the second says");
    let named = format!("another celld drives this robot (process {} of its computer)", first.0.id());
    wait_until("the second says who is there", || log().contains(&named));
    let status = || text(&celld(&["status"], &other).stdout);
    wait_until("so does its status", || status().contains(&named));
    let refused = celld(&["arm"], &other);
    assert_ne!(refused.status.code(), Some(0), "{}", text(&refused.stdout));

    let job = "version: 1\nid: one\ngoal:\n  objects:\n    - {id: lid, pose: [0.3, 0.38, 0]}\n";
    std::fs::write(folder.path().join("state/jobs/incoming/one.yaml"), job).expect("written");
    let done = || crate::cell::result_of(&folder.path().join("state"), "done", "one");
    let failed = || crate::cell::result_of(&folder.path().join("state"), "failed", "one");
    wait_until("the job of the first has ended", || done().or(failed()).is_some());
    assert_eq!(failed(), None, "the first works on:\n{}", watched(folder.path()));

    let ended = "job one: done, every object is at its goal (1 moves, ";
    for change in ["ARMED: the arm may move", "job one is taken up", "job one has ended", ended] {
        let seen = || watched(folder.path());
        assert!(eventually(|| seen().contains(change)), "{change:?} is not in\n{}", seen());
    }
    drop(first);
    let killed = "the daemon has ended; its last status says: idle, armed";
    wait_until("who watches sees its end", || watched(folder.path()).contains(killed));
    // The cell of the second is complete once the registers are free: it takes orders then.
    wait_until("the second takes over once the first is gone", || {
        status().contains("robot at 127.7.6.9: ready")
    });
}
