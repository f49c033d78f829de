//! The one clock of the daemon: monotonic, scaled by a factor when the cell is simulated.
//!
//! In: the machine's monotonic clock and a factor, or the [`Pace`] of a simulation in the same process. Out:
//! [`Timestamp`]s since the clock was made. Every deadline and poll rate is counted on this clock, so none
//! changes its meaning when the simulation runs faster. A clock that follows a pace stops while the
//! simulation is held up, so that a busy computer slows both sides instead of making the robot look silent.
//! The calendar time is read here too, for names and records only.

use cell_values::time::{Duration, Timestamp};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// A pace that has not moved for so long (wall time) is no pace any more: the clock goes on by itself, so
/// that every deadline still comes.
const PACE_LOST: Duration = Duration::from_secs(2);

/// Simulated time that the simulation may be ahead of a follower of its clock: five states at 125 Hz, and
/// well below the age at which a state counts as stale.
const LEAD: Duration = Duration::from_millis(40);

/// Means "no follower".
const NO_FOLLOWER: u64 = u64::MAX;

/// How far a simulation has come, written by its frame thread, and how far a daemon in the same process has
/// taken it in.
#[derive(Debug)]
pub struct Pace {
    start: Instant,
    /// The controller's own time at simulated time zero, s.
    epoch_s: f64,
    simulated_us: AtomicU64,
    wall_us: AtomicU64,
    received_us: AtomicU64,
}

impl Pace {
    /// A simulation that starts now, its controller's clock at `epoch_s`.
    pub fn new(epoch_s: f64) -> Pace {
        Pace {
            start: Instant::now(),
            epoch_s,
            simulated_us: AtomicU64::new(0),
            wall_us: AtomicU64::new(0),
            received_us: AtomicU64::new(NO_FOLLOWER),
        }
    }

    /// True while a follower has not yet taken in what happened `LEAD` ago: the simulation has to wait.
    pub fn ahead(&self) -> bool {
        let received = self.received_us.load(Ordering::Relaxed);
        received != NO_FOLLOWER
            && self.simulated_us.load(Ordering::Relaxed).saturating_sub(received) > LEAD.as_micros() as u64
    }

    /// Waits no longer, until the follower reports again.
    pub fn give_up(&self) {
        self.received_us.store(NO_FOLLOWER, Ordering::Relaxed);
    }

    /// Notes that so much simulated time is over.
    pub fn reached(&self, simulated: Duration) {
        self.simulated_us.store(simulated.as_micros() as u64, Ordering::Relaxed);
        self.wall_us.store(self.start.elapsed().as_micros() as u64, Ordering::Relaxed);
    }

    /// Simulated seconds per second of wall time so far; 1 before the first.
    pub fn factor(&self) -> f64 {
        let wall = self.wall_us.load(Ordering::Relaxed);
        let simulated = self.simulated_us.load(Ordering::Relaxed);
        if wall == 0 { 1.0 } else { simulated as f64 / wall as f64 }
    }

    /// Simulated time, which goes on at `factor` once the simulation has not moved for [`PACE_LOST`].
    fn now(&self, factor: f64) -> Duration {
        let silent =
            self.start.elapsed().saturating_sub(Duration::from_micros(self.wall_us.load(Ordering::Relaxed)));
        let simulated = Duration::from_micros(self.simulated_us.load(Ordering::Relaxed));
        simulated + silent.saturating_sub(PACE_LOST).mul_f64(factor)
    }
}

#[derive(Clone, Debug)]
enum Source {
    Wall(Instant),
    /// With the latest time that was handed out: a pace that is found again must not turn time back.
    Paced(Arc<Pace>, Arc<AtomicU64>),
}

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

    /// A clock that shows simulated time; `factor` is the one the simulation aims at, for waits.
    pub fn paced(pace: Arc<Pace>, factor: f64) -> Clock {
        Clock { source: Source::Paced(pace, Arc::default()), factor: sound(factor) }
    }

    /// Scaled time since the clock was made, or simulated time.
    pub fn now(&self) -> Timestamp {
        match &self.source {
            Source::Wall(origin) => Timestamp::from_secs_f64(origin.elapsed().as_secs_f64() * self.factor),
            Source::Paced(pace, latest) => {
                let now = pace.now(self.factor).as_nanos() as u64;
                let latest = latest.fetch_max(now, Ordering::Relaxed).max(now);
                Timestamp::ZERO + Duration::from_nanos(latest)
            }
        }
    }

    /// Reports to a simulation in this process that its state of controller time `at_s` has been taken in.
    pub fn received(&self, at_s: f64) {
        if let Source::Paced(pace, _) = &self.source {
            let received = ((at_s - pace.epoch_s).max(0.0) * 1e6) as u64;
            pace.received_us.store(received.min(NO_FOLLOWER - 1), Ordering::Relaxed);
        }
    }

    /// How much faster than the machine's clock this one runs.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    /// The wall time that a stretch of this clock's time takes.
    pub fn wall(&self, scaled: Duration) -> Duration {
        scaled.div_f64(self.factor)
    }
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
    fn a_paced_clock_stands_with_its_simulation_and_never_goes_back() {
        let pace = Arc::new(Pace::new(41.0));
        let clock = Clock::paced(pace.clone(), 5.0);
        pace.reached(Duration::from_secs(3));
        let at = |seconds: f64| Timestamp::from_secs_f64(seconds);
        assert_eq!((clock.now(), clock.clone().now()), (at(3.0), at(3.0)));
        pace.reached(Duration::from_secs(4));
        assert_eq!(clock.now(), at(4.0));
        // As after a stall during which the clock went on by itself.
        pace.reached(Duration::from_secs(1));
        assert_eq!(clock.now(), at(4.0));
    }

    #[test]
    fn the_simulation_waits_for_its_follower_and_only_for_one() {
        let pace = Arc::new(Pace::new(41.0));
        let clock = Clock::paced(pace.clone(), 5.0);
        pace.reached(Duration::from_secs(3));
        assert!(!pace.ahead(), "nobody follows yet");
        clock.received(43.9);
        assert!(pace.ahead(), "100 ms are too many");
        clock.received(43.98);
        assert!(!pace.ahead());
        clock.received(43.9);
        pace.give_up();
        assert!(!pace.ahead());
        Clock::new(5.0).received(1.0);
    }

    #[test]
    fn a_simulation_that_has_died_does_not_stop_the_clock() {
        let start = Instant::now().checked_sub(Duration::from_secs(10)).expect("the machine runs that long");
        let pace = Pace { start, ..Pace::new(0.0) };
        pace.simulated_us.store(1_000_000, Ordering::Relaxed);
        pace.wall_us.store(1_000_000, Ordering::Relaxed);
        // 9 s of silence, 7 beyond the patience, at factor 2.
        let now = pace.now(2.0).as_secs_f64();
        assert!((15.0..16.0).contains(&now), "{now}");
    }
}
