//! The one clock of the daemon: monotonic, scaled by a factor when the cell is simulated.
//!
//! In: the machine's monotonic clock and a factor, and the clock channel of our simulator where the cell is
//! simulated. Out: [`Timestamp`]s since the clock was made. Every deadline and poll rate is counted on this
//! clock, so none changes its meaning when the simulation runs faster. A clock that follows a simulator
//! stands while that does, so that a busy computer slows both sides instead of making the robot look silent.
//! The calendar time is read here too, for names and records only.

use crate::clock_channel::Following;
use cell_values::time::{Duration, Timestamp};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// Longest nap beside a simulator, in scaled time: a fraction of the time it may be ahead.
const LONGEST_NAP: Duration = Duration::from_millis(10);

#[derive(Clone, Debug)]
enum Source {
    Wall(Instant),
    Simulator(Arc<Mutex<Following>>),
}

/// How far a simulator had come at one moment; nothing on any other clock.
#[derive(Clone, Copy, Debug)]
pub struct Mark(Option<Duration>);

/// A monotonic clock that runs `factor` times as fast as the machine's. Clones stay in step.
#[derive(Clone, Debug)]
pub struct Clock {
    source: Source,
    factor: f64,
}

impl Clock {
    /// A clock that starts now. A factor that is not positive and finite counts as 1.
    pub fn new(factor: f64) -> Clock {
        Clock { source: Source::Wall(Instant::now()), factor: sound(factor) }
    }

    /// A clock that follows the simulator whose RTDE server has this address, while it has a clock channel;
    /// else as [`Clock::new`]. For cells that are configured as simulated, and no others.
    pub fn simulated(rtde: SocketAddr, factor: f64) -> Clock {
        let factor = sound(factor);
        Clock { source: Source::Simulator(Arc::new(Mutex::new(Following::new(rtde, factor)))), factor }
    }

    /// Scaled time since the clock was made.
    pub fn now(&self) -> Timestamp {
        match &self.source {
            Source::Wall(origin) => Timestamp::from_secs_f64(origin.elapsed().as_secs_f64() * self.factor),
            Source::Simulator(following) => Timestamp::ZERO + lock(following).at(Instant::now()),
        }
    }

    /// How far the simulator is: everything that it has sent before can be read now.
    pub fn mark(&self) -> Mark {
        Mark(match &self.source {
            Source::Wall(_) => None,
            Source::Simulator(following) => lock(following).simulated(Instant::now()),
        })
    }

    /// Reports to the simulator that everything it had sent before the mark has been taken in, and that what
    /// came of it is on its way.
    pub fn taken_in(&self, mark: Mark) {
        if let (Source::Simulator(following), Mark(Some(simulated))) = (&self.source, mark) {
            lock(following).taken_in(simulated, Instant::now());
        }
    }

    /// Seconds of this clock per second of the wall's, lately; none unless a simulator is followed.
    pub fn factor_reached(&self) -> Option<f64> {
        match &self.source {
            Source::Wall(_) => None,
            Source::Simulator(following) => lock(following).factor_reached(),
        }
    }

    /// True if this clock stands while a simulator does.
    pub fn is_simulated(&self) -> bool {
        matches!(self.source, Source::Simulator(_))
    }

    /// How much faster than the machine's clock this one runs.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    /// The wall time that a stretch of this clock's time takes, unless a simulator holds its time.
    pub fn wall(&self, scaled: Duration) -> Duration {
        scaled.div_f64(self.factor)
    }

    /// Wall time to sleep at most while such a stretch is waited for: a simulator is answered in between.
    pub fn nap(&self, scaled: Duration) -> Duration {
        match &self.source {
            Source::Wall(_) => self.wall(scaled),
            Source::Simulator(_) => self.wall(scaled.min(LONGEST_NAP)),
        }
    }
}

fn lock(following: &Mutex<Following>) -> MutexGuard<'_, Following> {
    following.lock().unwrap_or_else(PoisonError::into_inner)
}

fn sound(factor: f64) -> f64 {
    if factor.is_finite() && factor > 0.0 { factor } else { 1.0 }
}

/// Calendar time in s since 1970 (UTC); it may jump, so it dates records and decides nothing about motion.
pub fn unix_now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

/// Seconds since this machine started, sleep included: the same in every process, and no clock setting turns
/// it back. The age of an order is counted on it.
pub fn boot_now_s() -> f64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

/// The boot that `boot_now_s` counts from, another one after each start of this computer; empty if the
/// system does not name it.
pub fn boot_id() -> String {
    let id = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    id.trim().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock_channel::ClockServer;

    #[test]
    fn a_boot_has_one_id() {
        assert!(!boot_id().is_empty());
        assert_eq!(boot_id(), boot_id());
    }

    #[test]
    fn the_factor_scales_time_and_waits_alike() {
        let (slow, clock) = (Clock::new(1.0), Clock::new(1000.0));
        std::thread::yield_now();
        let (real, scaled) = (slow.now(), clock.now());
        assert!(scaled.nanos() > 100 * real.nanos(), "{scaled:?} after {real:?}");
        assert_eq!(clock.wall(Duration::from_secs(5)), Duration::from_millis(5));
    }

    #[test]
    fn a_bad_factor_is_one() {
        for factor in [0.0, -2.0, f64::NAN, f64::INFINITY] {
            assert_eq!(Clock::new(factor).factor(), 1.0);
        }
    }

    #[test]
    fn clones_follow_the_same_simulator() {
        let rtde = SocketAddr::from(([127, 77, 2, 1], 1));
        let mut server = ClockServer::open(rtde).unwrap();
        let clock = Clock::simulated(rtde, 5.0);
        let clone = clock.clone();
        clock.now();
        server.reached(Duration::from_secs(3), Instant::now());
        let at = clock.now();
        assert_eq!(clone.now(), at);
        let mark = clone.mark();
        server.reached(Duration::from_secs(4), Instant::now());
        assert_eq!(clone.now().since(at), Duration::from_secs(1));
        clock.taken_in(mark);
        assert!(server.holds(Instant::now()), "the mark was made a second ago");
        clone.taken_in(clock.mark());
        assert!(!server.holds(Instant::now()));
    }

    /// A real robot may have a simulator's address, at the end of a tunnel.
    #[test]
    fn a_real_cell_follows_no_simulator() {
        let rtde = SocketAddr::from(([127, 77, 2, 1], 2));
        let mut server = ClockServer::open(rtde).unwrap();
        let clock = Clock::new(1.0);
        clock.taken_in(clock.mark());
        server.reached(Duration::from_secs(3), Instant::now());
        assert!(!server.is_followed() && clock.factor_reached().is_none());
        assert_eq!(clock.nap(Duration::from_secs(5)), Duration::from_secs(5));
    }
}
