//! This computer: calendar, disk, scheduling, and how late it wakes up.
//!
//! In: [`ComputerFacts`]. Out: lines. Pure. None of it stops the arm from moving safely (the on-robot
//! program watches the heartbeat), but a cell on a computer that is late stops often, and for reasons that
//! are hard to find.

use crate::doctor::{Area, Line};
use cell_values::time::Duration;

/// What was measured here.
#[derive(Clone, Debug, PartialEq)]
pub struct ComputerFacts {
    /// Calendar time, s since 1970.
    pub unix_s: f64,
    /// The calendar follows a time server; `None` where the system does not say.
    pub clock_follows: Option<bool>,
    /// The state folder, or the nearest folder above it that exists.
    pub state: String,
    /// Bytes free there.
    pub free_bytes: Option<u64>,
    /// Longest of some small writes that reach the disk, or why none did.
    pub write: Result<Duration, String>,
    /// A thread may go before others (nice -10).
    pub may_go_first: bool,
    /// Cores that this process may use.
    pub cores: usize,
    /// Longest delay of a thread that wakes every 2 ms.
    pub latest_wake: Duration,
}

/// 2026-01-01: no calendar of a machine that runs this software is before it.
const BUILT_AFTER_UNIX_S: f64 = 1_767_225_600.0;
/// A journal with pictures of faults fits for long.
const ROOM_NOTED: u64 = 5 << 30;
const ROOM_NEEDED: u64 = 500 << 20;
/// A record is on disk before each pick and place: beyond this it is felt, and beyond that the arm waits.
const WRITE_NOTED: Duration = Duration::from_millis(50);
const WRITE_SLOW: Duration = Duration::from_millis(500);
/// The heartbeat goes out every 8 ms, and the on-robot program stops the arm when it falls silent.
const WAKE_NOTED: Duration = Duration::from_millis(10);
const WAKE_LATE: Duration = Duration::from_millis(60);

fn ok(item: &'static str, found: impl Into<String>) -> Line {
    Line::ok(Area::Computer, item, found)
}

fn note(item: &'static str, found: impl Into<String>, hint: impl Into<String>) -> Line {
    Line::note(Area::Computer, item, found, hint)
}

fn problem(item: &'static str, found: impl Into<String>, hint: impl Into<String>) -> Line {
    Line::problem(Area::Computer, item, found, hint)
}

impl ComputerFacts {
    /// The lines.
    pub fn lines(&self) -> Vec<Line> {
        vec![self.clock(), self.room(), self.writes(), self.scheduling(), self.wakes()]
    }

    fn clock(&self) -> Line {
        let follow = "start a time service (systemd-timesyncd, chrony): names and dates of jobs come from \
                      it, motion does not";
        if self.unix_s < BUILT_AFTER_UNIX_S {
            return problem("clock", "the calendar is years behind", follow);
        }
        match self.clock_follows {
            Some(true) => ok("clock", "follows a time server"),
            Some(false) => note("clock", "follows no time server", follow),
            None => note("clock", "the system does not say whether it follows a time server", ""),
        }
    }

    fn room(&self) -> Line {
        let Some(free) = self.free_bytes else {
            return note("disk", format!("the room at {} cannot be found out", self.state), "");
        };
        let found = format!("{:.1} GB free at {}", free as f64 / 1e9, self.state);
        let hint = "make room, or put the state folder elsewhere with --state";
        match free {
            free if free < ROOM_NEEDED => problem("disk", found, hint),
            free if free < ROOM_NOTED => note("disk", found, hint),
            _ => ok("disk", found),
        }
    }

    fn writes(&self) -> Line {
        let longest = match &self.write {
            Ok(longest) => *longest,
            Err(cause) => {
                let hint =
                    "celld must be able to write its state folder: its journal goes to disk before each move";
                return problem("disk writes", cause.clone(), hint);
            }
        };
        let found = format!("reach the disk within {:.1} ms", longest.as_secs_f64() * 1e3);
        let hint = "each move waits for two of them: use a solid-state disk of this computer, no memory \
                    card or network";
        match longest {
            longest if longest >= WRITE_SLOW => problem("disk writes", found, hint),
            longest if longest >= WRITE_NOTED => note("disk writes", found, hint),
            _ => ok("disk writes", found),
        }
    }

    fn scheduling(&self) -> Line {
        let cores = format!("{} cores", self.cores);
        if self.may_go_first {
            return ok("priority", format!("robot communication may go before other work; {cores}"));
        }
        note(
            "priority",
            format!("robot communication may not go before other work; {cores}"),
            "LimitNICE=-10 in the service's unit, or `nice` in /etc/security/limits.conf; and nothing else \
             on this computer",
        )
    }

    fn wakes(&self) -> Line {
        let late = self.latest_wake;
        let found =
            format!("a thread that wakes every 2 ms was {:.1} ms late at worst", late.as_secs_f64() * 1e3);
        let hint = "the heartbeat of the robot's program comes every 8 ms: end other work, switch power \
                    saving off in the BIOS, use a kernel with PREEMPT_RT";
        if late >= WAKE_LATE {
            problem("wake-ups", found, hint)
        } else if late >= WAKE_NOTED {
            note("wake-ups", found, hint)
        } else {
            ok("wake-ups", found)
        }
    }
}
