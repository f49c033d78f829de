//! Two daemons, each with a state folder of its own, on one robot: the second finds the mark of the first in
//! the robot's registers, says who is there, and neither arms nor disturbs it.

use crate::cell::{LOG, celld, configuration, copy_calibration, start_daemon, start_sim, text, wait_until};

#[test]
fn cell_second_daemon_on_one_robot_names_the_first_and_leaves_it_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let (cell, sim) = configuration(folder.path(), "127.7.6.9", 1);
    copy_calibration(folder.path());
    let _sim = start_sim(&sim);
    let first = start_daemon(folder.path(), &cell);
    wait_until("the first is armed", || celld(&["arm"], folder.path()).status.code() == Some(0));

    let other = folder.path().join("other");
    std::fs::create_dir(&other).expect("created");
    let _second = start_daemon(&other, &cell);
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
    wait_until("the first works on", || done().is_some());

    drop(first);
    // The cell of the second is complete once the registers are free: it takes orders then.
    wait_until("the second takes over once the first is gone", || {
        status().contains("robot at 127.7.6.9: ready")
    });
}
