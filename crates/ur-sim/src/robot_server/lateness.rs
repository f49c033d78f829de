//! Whether the simulator's own tasks are late, while a daemon follows its time.
//!
//! In: what is watched, each with a check that says whether there is work to do. Out: whether simulated time
//! is held for it. The thread that makes the frames may have a processor while the tasks that read and write
//! sockets, or draw pictures, wait for one: a heartbeat that lies unread must not count as a missing one. A
//! connection with a fault in force has no work: what the fault holds back is not waited for.

use crate::motion::FRAME_SECONDS;
use cell_edge::pace::Wait;
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

/// True if there is work to do.
pub type Check = dyn Fn() -> bool + Send + Sync;

struct Watched {
    has_work: Weak<Check>,
    /// At the ends of so many frames in a row there was work to do.
    frames: u32,
    /// Simulated time that it may take.
    allowed: Duration,
    wait: Wait,
}

/// What is watched.
#[derive(Default)]
pub struct Lateness {
    watched: Mutex<Vec<Watched>>,
    followed: AtomicBool,
}

impl fmt::Debug for Lateness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Lateness")
    }
}

impl Lateness {
    /// Watches for as long as the caller keeps the check. Work may take `allowed` of simulated time before
    /// that is held, for `patience` of wall time at most.
    pub fn watch(&self, has_work: &Arc<Check>, allowed: Duration, patience: Duration) {
        let has_work = Arc::downgrade(has_work);
        self.with(|all| {
            all.retain(|one| one.has_work.strong_count() > 0);
            all.push(Watched { has_work, frames: 0, allowed, wait: Wait::of(patience) });
        });
    }

    /// A frame has ended; `followed`: a daemon follows the simulator's time.
    pub fn frame(&self, followed: bool) {
        self.followed.store(followed, Ordering::Relaxed);
        if !followed {
            return;
        }
        self.with(|all| {
            for one in all {
                let has_work = one.has_work.upgrade().is_some_and(|has_work| has_work());
                one.frames = if has_work { one.frames.saturating_add(1) } else { 0 };
            }
        });
    }

    /// A daemon follows the simulator's time.
    pub fn is_followed(&self) -> bool {
        self.followed.load(Ordering::Relaxed)
    }

    /// Whether to hold the time for work that takes longer than it may.
    pub fn holds(&self, now: Instant) -> bool {
        self.with(|all| {
            let mut holds = false;
            for one in all {
                let long = f64::from(one.frames) * FRAME_SECONDS > one.allowed.as_secs_f64();
                let late = long && one.has_work.upgrade().is_some_and(|has_work| has_work());
                holds |= one.wait.holds(late, now);
            }
            holds
        })
    }

    fn with<T>(&self, act: impl FnOnce(&mut Vec<Watched>) -> T) -> T {
        act(&mut self.watched.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_edge::pace::{LEAD, PATIENCE};

    /// There is work to do while the flag is up.
    fn watched() -> (Lateness, Arc<AtomicBool>, Arc<Check>) {
        let (lateness, flag) = (Lateness::default(), Arc::new(AtomicBool::new(true)));
        let check: Arc<Check> = {
            let flag = flag.clone();
            Arc::new(move || flag.load(Ordering::Relaxed))
        };
        lateness.watch(&check, LEAD, PATIENCE);
        (lateness, flag, check)
    }

    fn frames(lateness: &Lateness, count: usize) {
        (0..count).for_each(|_| lateness.frame(true));
    }

    #[test]
    fn time_is_held_once_work_has_waited_for_40_ms_of_it() {
        let (lateness, flag, _check) = watched();
        let now = Instant::now();
        frames(&lateness, 20);
        assert!(!lateness.holds(now));
        frames(&lateness, 1);
        assert!(lateness.holds(now));
        flag.store(false, Ordering::Relaxed);
        assert!(!lateness.holds(now));
    }

    #[test]
    fn new_work_at_every_frame_is_no_delay() {
        let (lateness, flag, _check) = watched();
        for _ in 0..100 {
            flag.fetch_xor(true, Ordering::Relaxed);
            frames(&lateness, 1);
            assert!(!lateness.holds(Instant::now()));
        }
    }

    #[test]
    fn work_that_nobody_does_is_given_up_and_closed_connections_are_forgotten() {
        let (lateness, _flag, check) = watched();
        let now = Instant::now();
        frames(&lateness, 50);
        assert!(lateness.holds(now) && !lateness.holds(now + PATIENCE));
        frames(&lateness, 50);
        assert!(!lateness.holds(now + 2 * PATIENCE));
        drop(check);
        let next: Arc<Check> = Arc::new(|| false);
        lateness.watch(&next, LEAD, PATIENCE);
        assert_eq!(lateness.with(|all| all.len()), 1);
    }
}
