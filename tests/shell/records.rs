//! Disks, folders and journals that celld cannot work with: it refuses and gives the reason, before anything
//! moves.

use super::{Cell, JOB, runs};
use crate::cell::{CELLD, LOG, Running, wait_until};
use celld::jobs::journal::Journal;
use rusqlite::Connection;
use std::fs::File;
use std::path::Path;
use std::process::{Command, Stdio};

/// What `unshare` gives a process so that it may mount: as root within it, or as root of this system.
const OWN_MOUNTS: [&[&str]; 2] = [&["--user", "--map-root-user", "--mount"], &["--mount"]];

fn unshare(options: &[&str], folder: &Path, script: &str) -> Command {
    let mut command = Command::new("unshare");
    command.args(options).args(["sh", "-c", script]).current_dir(folder).stdout(Stdio::null());
    command
}

/// `celld run` after a script that mounts, in mounts of its own; `None`, with a remark, where the system
/// allows none.
fn run_after(cell: &Cell, script: &str) -> Option<Command> {
    let mounts = |options: &[&str]| {
        let mut tried = unshare(options, cell.path(), "mount -t tmpfs tmpfs .");
        tried.stderr(Stdio::null()).status().is_ok_and(|status| status.success())
    };
    let Some(options) = OWN_MOUNTS.into_iter().find(|options| mounts(options)) else {
        eprintln!("SKIPPED: celld on disks that are read-only or divided, this user may not mount");
        return None;
    };
    let script = format!("{script} && exec \"$0\" run --config \"$1\"");
    let mut command = unshare(options, cell.path(), &script);
    command.arg(CELLD).arg(&cell.config);
    Some(command)
}

/// The daemon, with its log in its folder.
fn start(cell: &Cell, mut command: Command) -> Running {
    let log = File::create(cell.path().join(LOG)).expect("a file");
    Running(command.stderr(log).spawn().expect("it starts"))
}

/// The daemon ends by itself, with these words.
fn refuses(cell: &Cell, command: Command, words: &[&str]) {
    let mut daemon = start(cell, command);
    let process = daemon.0.id();
    wait_until("it ends", || !runs(process));
    let (code, said) = (daemon.0.wait().expect("a child").code(), cell.log());
    assert_eq!(code, Some(1), "{said}");
    for part in words {
        assert!(said.contains(part), "{part}: {said}");
    }
}

/// Another program has the journal to itself; the disk is read-only; a job folder is on another file system.
#[test]
fn cell_refuses_a_state_folder_that_cannot_be_used_and_gives_the_reason() {
    let cell = Cell::without_robot("127.7.9.22");
    std::fs::create_dir(cell.state()).expect("created");
    let journal = cell.state().join("history.sqlite");
    drop(Journal::open(&journal).expect("a journal"));
    let other = Connection::open(&journal).expect("the journal");
    other.execute_batch("PRAGMA locking_mode=EXCLUSIVE; BEGIN EXCLUSIVE;").expect("locked");
    refuses(&cell, cell.run(), &["the journal cannot be used", "history.sqlite", "database is locked"]);
    drop(other);

    let read_only = "mount -t tmpfs -o ro tmpfs state";
    let divided = "mkdir -p state/jobs/done && mount -t tmpfs tmpfs state/jobs/done";
    let cases = [
        (read_only, ["state folder: ", "Read-only file system"]),
        (divided, ["state/jobs/done is on another file system", "put the whole state folder on one"]),
    ];
    for (script, words) in cases {
        let Some(command) = run_after(&cell, script) else { return };
        refuses(&cell, command, &words);
    }
}

#[test]
fn cell_accepts_no_job_while_another_program_locks_the_journal() {
    let mut cell = Cell::start("127.7.9.25", &[]);
    let jobs = cell.state().join("jobs");
    let other = Connection::open(cell.state().join("history.sqlite")).expect("the journal");
    other.execute_batch("BEGIN EXCLUSIVE").expect("locked");
    std::fs::write(jobs.join("incoming/carry.yaml"), JOB).expect("written");
    let refused =
        |line: &str| line.contains("no job file could be taken in") && line.contains("database is locked");
    wait_until("it says so", || cell.log().lines().any(refused));
    assert_eq!(cell.celld(&["disarm"]).0, Some(0), "orders do not wait for the journal");
    assert!(jobs.join("incoming/carry.yaml").is_file() && !jobs.join("hold/carry").exists());

    other.execute_batch("ROLLBACK").expect("released");
    wait_until("the job is begun", || jobs.join("active/carry").is_dir());
    assert!(cell.daemon().try_wait().expect("a child").is_none(), "it stays: {}", cell.log());
}
