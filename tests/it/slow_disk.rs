//! A disk that takes a quarter of a second for every commit, and more than one at times, end to end: the
//! arm's heartbeat does not wait for it, and a wait of the arm is reported.
//!
//! The daemon is the real one; a library put before libc's holds each fsync up. The robot's program stops
//! the arm when it receives nothing for 200 ms, so that a loop that waits for one commit fails here.

use crate::cell::{
    LOG, celld, configuration, copy_calibration, preloaded, result_of, start_daemon_with, start_strict_sim,
    text, wait_until,
};

/// Before libc: slow commits; each of the journal leaves a mark.
const SLOW: &str = r#"
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

static int slowly(long call, int file) {
    char link[64], name[4096] = {0};
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    if (readlink(link, name, sizeof name - 1) < 0) abort();
    static int commits;
    int marks = -1, longer = 0;
    if (strstr(name, "history.sqlite"))
        marks = open(getenv("SLOW_DISK_MARKS"), O_WRONLY | O_CREAT | O_APPEND, 0600);
    if (marks >= 0) {
        if (write(marks, "x", 1) != 1) abort();
        close(marks);
        longer = ++commits % 4 == 0;
    }
    usleep(longer ? 1400000 : 250000);
    return (int)syscall(call, file);
}

int fsync(int file) { return slowly(SYS_fsync, file); }
int fdatasync(int file) { return slowly(SYS_fdatasync, file); }
"#;

#[test]
fn cell_keeps_its_heartbeat_on_a_slow_disk() {
    let folder = tempfile::tempdir().expect("a folder");
    let (cell, sim) = configuration(folder.path(), "127.7.6.3", 1);
    copy_calibration(folder.path());
    let _sim = start_strict_sim(&sim);
    let (library, marks) = (preloaded(folder.path(), SLOW), folder.path().join("marks"));
    let commits = || std::fs::metadata(&marks).map_or(0, |meta| meta.len());
    let slow = [("LD_PRELOAD", library.as_path()), ("SLOW_DISK_MARKS", marks.as_path())];
    let _daemon = start_daemon_with(folder.path(), &cell, &slow);
    let state = folder.path().join("state");
    wait_until("the cell is armed", || celld(&["arm"], folder.path()).status.code() == Some(0));
    let before = commits();
    let job = "version: 1\nid: slow\ngoal:\n  objects:\n    - {id: lid, pose: [0.3, 0.38, 0]}\n";
    std::fs::write(state.join("jobs/incoming/slow.yaml"), job).expect("written");
    let ended = || ["done", "failed"].into_iter().find_map(|end| result_of(&state, end, "slow"));
    wait_until("the job ends", || ended().is_some());
    let said = std::fs::read_to_string(folder.path().join(LOG)).expect("what the daemon said");
    let result = ended().expect("a result");
    assert!(result.contains("status: done") && result.contains("moves: 1"), "{result}\n{said}");
    assert!(!said.contains("disarmed"), "{said}");
    assert!(said.contains("no motion begins before it is written"), "{said}");
    // Meant, gripped, released, done and the result, at least one commit each.
    assert!(commits() >= before + 5, "{} commits were slow", commits() - before);
    let status = text(&celld(&["status"], folder.path()).stdout);
    assert!(status.contains("armed") && !status.contains("disarmed"), "{status}");
}
