//! SIGKILL to the real daemon in the middle of a job, while the simulated robot runs on: after writes,
//! syncs, renames and removals in the state folder, and at any time. Nothing is lost, nothing is done twice,
//! nothing moves by itself.
//!
//! In: `CELLD_KILLS=N` makes N kills of either kind instead of a few, spread over a job's time and calls (at
//! most one after each call), `CELLD_KILLS_ONLY=3,7` repeats these of them alone, and `CELLD_KILLS_CELLS=M`
//! has M simulated cells at addresses of their own share them: they mostly wait. A library put before libc's
//! counts the calls on files of the state folder and kills the process after one of them. Out: for each
//! kill, that the next daemon has the job in one place, is disarmed, offers a way back where something is
//! held, and that the job can be brought to its end.

use crate::cell::{
    LOG, Running, celld, configuration, copy_calibration, preloaded, result_of, start_daemon,
    start_daemon_with, start_sim, wait_until,
};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Before libc: counts calls that change the state folder, status and recordings apart, and kills the
/// process after one of them.
const KILLER: &str = r#"
#define _GNU_SOURCE
#include <fcntl.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

static atomic_int calls;

static void count(const char *name) {
    if (!strstr(name, "/state/") || strstr(name, "status.json") || strstr(name, "/recordings/")) return;
    int now = atomic_fetch_add(&calls, 1) + 1;
    if (now == atoi(getenv("KILL_AFTER"))) kill(getpid(), SIGKILL);
    int marks = open(getenv("KILL_MARKS"), O_WRONLY | O_CREAT | O_APPEND, 0600);
    if (marks >= 0) { if (syscall(SYS_write, marks, "x", 1) != 1) abort(); close(marks); }
}

static void count_file(int file) {
    char link[64], name[4096] = {0};
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    if (readlink(link, name, sizeof name - 1) > 0) count(name);
}

ssize_t write(int file, const void *bytes, size_t size) {
    ssize_t result = syscall(SYS_write, file, bytes, size);
    count_file(file);
    return result;
}

ssize_t pwrite64(int file, const void *bytes, size_t size, off64_t at) {
    ssize_t result = syscall(SYS_pwrite64, file, bytes, size, at);
    count_file(file);
    return result;
}

int fsync(int file) { int result = syscall(SYS_fsync, file); count_file(file); return result; }
int fdatasync(int file) { int result = syscall(SYS_fdatasync, file); count_file(file); return result; }
int rename(const char *from, const char *to) {
    int result = syscall(SYS_rename, from, to);
    count(to);
    return result;
}
int unlink(const char *name) { int result = syscall(SYS_unlink, name); count(name); return result; }
"#;

/// When the daemon is killed.
#[derive(Clone, Copy, Debug)]
enum When {
    /// After this call on the state folder, from 1.
    Call(u32),
    /// So long after the job was handed in.
    After(Duration),
}

/// Where the object of the jobs goes in turn, x, m.
const PLACES: [f64; 2] = [0.30, 0.40];

/// One cell whose daemons are killed one after the other; the table stays as they leave it.
struct Cell {
    folder: tempfile::TempDir,
    config: PathBuf,
    killer: PathBuf,
    _sim: Running,
}

impl Cell {
    fn new(address: &str) -> Cell {
        let folder = tempfile::tempdir().expect("a folder");
        let (config, sim) = configuration(folder.path(), address, 4);
        copy_calibration(folder.path());
        let killer = preloaded(folder.path(), KILLER);
        Cell { _sim: start_sim(&sim), folder, config, killer }
    }

    /// A job that is cut off, and brought to its end by the next daemon; how many calls and seconds it took
    /// where it was not cut off. The object goes to and fro between two places, so that there is work.
    fn kill(&self, number: usize, to_x: f64, when: When) -> Option<(u32, Duration)> {
        let folder = self.folder.path().join(format!("kill-{number}"));
        std::fs::create_dir(&folder).expect("created");
        let (marks, after) = (
            folder.join("marks"),
            match when {
                When::Call(call) => call.to_string(),
                When::After(_) => "0".to_string(),
            },
        );
        let environment = [
            ("LD_PRELOAD", self.killer.as_path()),
            ("KILL_AFTER", Path::new(&after)),
            ("KILL_MARKS", marks.as_path()),
        ];
        let mut daemon = start_daemon_with_killer(&folder, &self.config, &environment);
        let job =
            format!("version: 1\nid: tidy\ngoal:\n  objects:\n    - {{id: lid, pose: [{to_x}, 0.38, 0]}}\n");
        let gone = |daemon: &mut Running| daemon.0.try_wait().expect("a child").is_some();
        let (mut armed, mut handed) = (false, None);
        let limit = Instant::now();
        while !gone(&mut daemon) {
            assert!(limit.elapsed() < Duration::from_secs(240), "{when:?}: {}", said(&folder));
            armed = armed || celld(&["arm"], &folder).status.code() == Some(0);
            if armed && handed.is_none() {
                // As `celld submit` does: whole, under its name at once.
                std::fs::write(folder.join("job.tmp"), &job).expect("written");
                std::fs::rename(folder.join("job.tmp"), folder.join("state/jobs/incoming/tidy.yaml"))
                    .expect("renamed");
                handed = Some(Instant::now());
            }
            if let (When::After(time), Some(since)) = (when, handed)
                && since.elapsed() >= time
            {
                daemon.0.kill().expect("killed");
            }
            let state = folder.join("state");
            if result_of(&state, "done", "tidy").is_some() {
                let calls = std::fs::metadata(&marks).map_or(0, |meta| meta.len());
                return Some((calls as u32, handed.expect("a job").elapsed()));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        drop(daemon);
        self.next_daemon_ends_it(&folder, when, handed.is_some(), &job);
        None
    }

    fn next_daemon_ends_it(&self, folder: &Path, when: When, handed: bool, job: &str) {
        std::fs::rename(folder.join(LOG), folder.join("first.txt")).expect("the log of the first");
        let _daemon = start_daemon(folder, &self.config);
        let state = folder.join("state");
        let status = || -> serde_json::Value {
            let shown = celld(&["status", "--format", "json"], folder);
            serde_json::from_slice(&shown.stdout).unwrap_or_default()
        };
        wait_until("the next daemon takes orders", || {
            status()["status"]["state"].as_str().is_some_and(|state| state != "starting")
        });
        wait_until("gripper and robot answer", || {
            let now = status();
            let devices = now["status"]["devices"].as_array().cloned().unwrap_or_default();
            devices.iter().take(2).all(|device| device["age_s"].is_number())
        });
        let now = status();
        assert_eq!(now["status"]["armed"], false, "{when:?}: {now:#}");
        if handed {
            // A file is in two places while it is brought into its folder.
            wait_until("the job is in one place", || places_of(&state, "tidy").len() == 1);
        } else {
            std::fs::write(state.join("jobs/incoming/tidy.yaml"), job).expect("written");
        }
        wait_until("nothing is held, or it is put down", || put_down(folder, &status()));
        wait_until("the cell is armed", || celld(&["arm"], folder).status.code() == Some(0));
        let ended = |id: &str| {
            ["done", "failed"].into_iter().find_map(|end| result_of(&state, end, id).map(|text| (end, text)))
        };
        wait_until("the job has ended", || ended("tidy").is_some());
        let (end, result) = ended("tidy").expect("a result");
        if end == "failed" {
            assert!(result.contains("status: interrupted"), "{when:?}: {result}\n{}", said(folder));
            let again = job.replace("id: tidy", "id: again");
            std::fs::write(state.join("jobs/incoming/again.yaml"), again).expect("written");
            wait_until("the job that follows is done", || {
                if celld(&["status"], folder).stdout.starts_with(b"idle (disarmed)") {
                    celld(&["arm"], folder);
                }
                ended("again").is_some()
            });
            let (end, result) = ended("again").expect("a result");
            assert_eq!(end, "done", "{when:?}: {result}\n{}", said(folder));
        }
        wait_until("the job is in one place", || places_of(&state, "tidy").len() == 1);
    }
}

/// Puts down what is held, by the way back that is offered; true once nothing is.
fn put_down(folder: &Path, status: &serde_json::Value) -> bool {
    if status["status"]["holding"].is_null() {
        return true;
    }
    celld(&["recover", "--place"], folder);
    false
}

/// A daemon that may be gone before it has opened its folders.
fn start_daemon_with_killer(folder: &Path, cell: &Path, environment: &[(&str, &Path)]) -> Running {
    // The folders are there before: a kill while they are made leaves nothing to lose.
    std::fs::create_dir_all(folder.join("state/jobs/incoming")).expect("created");
    start_daemon_with(folder, cell, environment)
}

/// Where the job is in the state folder.
fn places_of(state: &Path, id: &str) -> Vec<String> {
    let jobs = state.join("jobs");
    let mut places = Vec::new();
    if jobs.join("incoming").join(format!("{id}.yaml")).exists() {
        places.push("incoming".to_string());
    }
    places.extend(
        ["hold", "active"].into_iter().filter(|f| jobs.join(f).join(id).exists()).map(str::to_string),
    );
    for end in ["done", "failed"] {
        let months = std::fs::read_dir(jobs.join(end)).into_iter().flatten().flatten();
        places.extend(months.filter(|month| month.path().join(id).exists()).map(|_| end.to_string()));
    }
    places
}

fn said(folder: &Path) -> String {
    ["first.txt", LOG].map(|name| std::fs::read_to_string(folder.join(name)).unwrap_or_default()).concat()
}

#[test]
fn cell_daemon_killed_anywhere_in_a_job_loses_and_repeats_nothing() {
    let kills = stated("CELLD_KILLS").unwrap_or(2);
    let cells = stated("CELLD_KILLS_CELLS").unwrap_or(1).clamp(1, 200) as u8;
    let cell = Cell::new("127.7.6.11");
    let undisturbed = cell.kill(0, PLACES[0], When::Call(0));
    let first = cell.folder.path().join("kill-0");
    let (calls, time) = undisturbed.unwrap_or_else(|| panic!("not killed, and gone: {}", said(&first)));
    assert!(calls > 30, "{calls} calls on the state folder");
    let shares = |count: u32| (0..count).map(move |k| f64::from(2 * k + 1) / f64::from(2 * count));
    let at_calls = shares(kills.min(calls)).map(|share| When::Call((share * f64::from(calls)) as u32 + 1));
    let at_times = shares(kills).map(|share| When::After(time.mul_f64(share)));
    let only = stated_list("CELLD_KILLS_ONLY");
    let all = (1..).zip(at_calls.chain(at_times));
    let due: Vec<(usize, When)> = all.filter(|(n, _)| only.is_empty() || only.contains(n)).collect();
    assert!(due.len() >= only.len() && !due.is_empty(), "{only:?}: not so many kills");
    let (next, killed) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let work = |cell: &Cell| {
        for to_x in PLACES.into_iter().cycle().skip(1) {
            let Some((number, when)) = due.get(next.fetch_add(1, Ordering::Relaxed)) else { break };
            killed.fetch_add(usize::from(cell.kill(*number, to_x, *when).is_none()), Ordering::Relaxed);
            if kills > 10 {
                eprintln!(
                    "{number} of {}: {when:?} of {calls} calls, {:.1} s",
                    due.len(),
                    time.as_secs_f64()
                );
            }
        }
    };
    std::thread::scope(|scope| {
        for index in 1..cells {
            let work = &work;
            scope.spawn(move || work(&Cell::new(&format!("127.7.6.{}", 11 + u32::from(index)))));
        }
        work(&cell);
    });
    // The last moments of a job may be over before the kill comes.
    let killed = killed.into_inner();
    assert!(4 * killed >= 3 * due.len(), "{killed} of {} were killed", due.len());
}

fn stated_list(name: &str) -> Vec<usize> {
    let text = std::env::var(name).unwrap_or_default();
    let numbers = text.split(',').map(str::trim).filter(|number| !number.is_empty());
    numbers.map(|number| number.parse().unwrap_or_else(|_| panic!("{name}: {number}: a number"))).collect()
}

fn stated(name: &str) -> Option<u32> {
    std::env::var(name).ok().and_then(|text| text.parse().ok())
}
