//! A process that is stopped, a log that nobody takes, signals that end.

use super::Cell;
use crate::cell::{CELLD, LOG, PATIENCE, Running, wait_until};
use std::process::{Command, Stdio};
use std::time::Instant;

/// The daemon is stopped in the middle of a carry: disarmed afterwards, still there, and says so.
#[test]
fn cell_that_was_held_up_is_disarmed_stays_and_says_so() {
    let mut cell = Cell::start("127.7.9.4", &[]);
    cell.carry();
    cell.signal("STOP");
    // Long enough for every deadline of the robot; the arm stops by its program's own watchdog.
    wait_until("the arm rests", || cell.rests());
    std::thread::sleep(std::time::Duration::from_secs(16));
    cell.signal("CONT");
    wait_until("it says so", || cell.log().contains("celld was held up for"));
    wait_until("the status says so", || !cell.armed());
    assert!(cell.daemon().try_wait().expect("a child").is_none(), "it stays: {}", cell.log());
    assert!(!cell.log().contains("check the disk"), "{}", cell.log());
    assert!(cell.holds(), "the object stays held");
}

/// A thread's scheduling is SCHED_FIFO (1), by its `stat` (proc(5)).
fn is_real_time(stat: &str) -> bool {
    stat.rsplit_once(") ").and_then(|(_, after)| after.split(' ').nth(38)) == Some("1")
}

/// So many threads of this process have real-time scheduling.
fn real_time_threads(process: u32) -> usize {
    let tasks = std::fs::read_dir(format!("/proc/{process}/task")).expect("it runs").flatten();
    let stats = tasks.filter_map(|task| std::fs::read_to_string(task.path().join("stat")).ok());
    stats.filter(|stat| is_real_time(stat)).count()
}

/// The system gives this user's threads real-time scheduling.
fn may_have_real_time() -> bool {
    let tried = std::thread::spawn(|| {
        cell_edge::priority::real_time();
        std::fs::read_to_string("/proc/thread-self/stat").is_ok_and(|stat| is_real_time(&stat))
    });
    tried.join().expect("it ends")
}

/// The loop and the two readers of reported orders go before everything ordinary, also after a plan was
/// made; nothing else does.
#[test]
fn cell_keeps_real_time_for_the_loop_and_the_readers_of_orders() {
    let mut cell = Cell::start("127.7.9.17", &[]);
    cell.carry();
    let expected = if may_have_real_time() { 3 } else { 0 };
    assert_eq!(real_time_threads(cell.daemon().id()), expected);
}

/// Under the C library's allocator the loop waits for threads of low priority. With this variable the other
/// one prints its name on standard error.
#[test]
fn cell_uses_mimalloc() {
    let mut celld = Command::new(CELLD);
    let output = celld.arg("--version").env("MIMALLOC_VERBOSE", "1").output().expect("the binary runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.starts_with("mimalloc: "), "{said}");
}

/// Standard error is a pipe that nobody reads: an abort is taken, and SIGTERM ends the daemon.
#[test]
fn cell_with_a_blocked_log_takes_an_abort_and_ends() {
    let mut cell = Cell::without_daemon("127.7.9.5");
    let process = Command::new(CELLD)
        .args(["run", "--config"])
        .arg(&cell.config)
        .env("CELLD_LOG", "trace")
        .current_dir(cell.path())
        .stderr(Stdio::piped())
        .spawn();
    cell.daemon = Some(Running(process.expect("the binary runs")));
    wait_until("the daemon takes orders", || cell.celld(&["disarm"]).0 == Some(0));
    cell.carry();
    let (code, said) = cell.celld(&["abort"]);
    assert!(said.contains("disarmed"), "{code:?}: {said}");
    assert!(cell.rests());
    cell.signal("TERM");
    let since = Instant::now();
    while cell.daemon().try_wait().expect("a child").is_none() {
        assert!(since.elapsed() < PATIENCE, "it does not end");
        std::thread::yield_now();
    }
    assert!(cell.holds(), "the end leaves the vacuum as it is");
}

/// A terminal that is closed ends the daemon as SIGTERM does: the arm stops, the status is no longer armed.
#[test]
fn cell_ends_at_a_hangup_as_at_sigterm() {
    let mut cell = Cell::start("127.7.9.6", &[]);
    cell.carry();
    cell.signal("HUP");
    let code = cell.daemon().wait().expect("a child").code();
    let log = std::fs::read_to_string(cell.path().join(LOG)).expect("the log");
    assert_eq!(code, Some(0), "{log}");
    assert!(cell.rests() && cell.holds() && !cell.armed(), "{log}");
}
