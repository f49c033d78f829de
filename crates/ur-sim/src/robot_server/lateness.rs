//! Whether the simulator's own tasks are late with what clients have sent or are to be sent.
//!
//! In: each connection with a check that says whether its tasks have something to do. Out: whether simulated
//! time is held for them. The thread that makes the frames may have a processor while the tasks that read and
//! write sockets wait for one: a heartbeat that lies unread must not count as a missing one. A connection
//! with a fault in force is never late: what the fault holds back is not waited for.

use crate::motion::FRAME_SECONDS;
use cell_edge::pace::{LEAD, Wait};
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Instant;

/// True if a connection's tasks have something to do.
pub type Check = dyn Fn() -> bool + Send + Sync;

struct Connection {
    has_work: Weak<Check>,
    /// At the ends of so many frames in a row there was something to do.
    frames: u32,
    wait: Wait,
}

/// The connections that are watched.
#[derive(Default)]
pub struct Lateness(Mutex<Vec<Connection>>);

impl fmt::Debug for Lateness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Lateness")
    }
}

impl Lateness {
    /// Watches a connection for as long as the caller keeps the check.
    pub fn watch(&self, has_work: &Arc<Check>) {
        let has_work = Arc::downgrade(has_work);
        self.with(|all| all.push(Connection { has_work, frames: 0, wait: Wait::default() }));
    }

    /// A frame has ended.
    pub fn frame(&self) {
        self.with(|all| {
            all.retain_mut(|connection| {
                let Some(has_work) = connection.has_work.upgrade() else { return false };
                connection.frames = if has_work() { connection.frames.saturating_add(1) } else { 0 };
                true
            });
        });
    }

    /// Whether to hold the time for a connection that is behind by more than it may be.
    pub fn holds(&self, now: Instant) -> bool {
        self.with(|all| {
            let mut holds = false;
            for connection in all {
                let long = f64::from(connection.frames) * FRAME_SECONDS > LEAD.as_secs_f64();
                let late = long && connection.has_work.upgrade().is_some_and(|has_work| has_work());
                holds |= connection.wait.holds(late, now);
            }
            holds
        })
    }

    fn with<T>(&self, act: impl FnOnce(&mut Vec<Connection>) -> T) -> T {
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_edge::pace::PATIENCE;
    use std::sync::atomic::{AtomicBool, Ordering};

    /// A connection that has something to do while the flag is up.
    fn watched() -> (Lateness, Arc<AtomicBool>, Arc<Check>) {
        let (lateness, flag) = (Lateness::default(), Arc::new(AtomicBool::new(true)));
        let check: Arc<Check> = {
            let flag = flag.clone();
            Arc::new(move || flag.load(Ordering::Relaxed))
        };
        lateness.watch(&check);
        (lateness, flag, check)
    }

    fn frames(lateness: &Lateness, count: usize) {
        (0..count).for_each(|_| lateness.frame());
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
        frames(&lateness, 1);
        assert!(lateness.with(|all| all.is_empty()));
    }
}
