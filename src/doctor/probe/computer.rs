//! Calendar, disk and scheduling of this computer, measured.
//!
//! In: the state folder. Out: [`ComputerFacts`]. A file is written and removed in the state folder, or in
//! the nearest folder above it that exists.

use crate::doctor::computer::ComputerFacts;
use cell_edge::files::{remove, write_atomic};
use cell_edge::priority;
use rearrange::document::chain::chain;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// Small writes that are timed.
const WRITES: usize = 10;
/// Wake-ups that are timed, and how far apart.
const WAKES: u32 = 500;
const WAKE_EVERY: Duration = Duration::from_millis(2);

/// Measures this computer.
pub fn facts(state: &Path, unix_s: f64) -> ComputerFacts {
    let folder = existing(state);
    ComputerFacts {
        unix_s,
        clock_follows: clock_follows(),
        state: folder.display().to_string(),
        free_bytes: rustix::fs::statvfs(&folder).ok().map(|at| at.f_bavail.saturating_mul(at.f_frsize)),
        write: longest_write(&folder),
        may_go_first: may_go_first(),
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        latest_wake: latest_wake(),
    }
}

/// The folder itself, or the nearest above it that exists.
fn existing(folder: &Path) -> PathBuf {
    let absolute = std::path::absolute(folder).unwrap_or_else(|_| folder.to_path_buf());
    let found = absolute.ancestors().find(|path| path.is_dir());
    found.unwrap_or(Path::new("/")).to_path_buf()
}

/// What the system's own tool says; `None` where there is none.
fn clock_follows() -> Option<bool> {
    let shown =
        Command::new("timedatectl").args(["show", "-p", "NTPSynchronized", "--value"]).output().ok()?;
    match String::from_utf8_lossy(&shown.stdout).trim() {
        "yes" => Some(true),
        "no" => Some(false),
        _ => None,
    }
}

/// Writes as the daemon writes its files: to the disk, not to its cache.
fn longest_write(folder: &Path) -> Result<Duration, String> {
    let path = folder.join(format!(".celld-doctor-{}", std::process::id()));
    let mut longest = Duration::ZERO;
    for _ in 0..WRITES {
        let begun = Instant::now();
        write_atomic(&path, b"celld doctor\n").map_err(|error| chain(&error))?;
        longest = longest.max(begun.elapsed());
    }
    remove(&path).map_err(|error| chain(&error))?;
    Ok(longest)
}

/// Tries it on a thread of its own, which ends.
fn may_go_first() -> bool {
    let tried = std::thread::spawn(|| {
        priority::raise();
        rustix::process::getpriority_process(None).is_ok_and(|nice| nice < 0)
    });
    tried.join().unwrap_or(false)
}

fn latest_wake() -> Duration {
    let begun = Instant::now();
    let mut latest = Duration::ZERO;
    for wake in 1..=WAKES {
        let due = begun + WAKE_EVERY * wake;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        latest = latest.max(Instant::now().saturating_duration_since(due));
    }
    latest
}
