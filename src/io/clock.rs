//! The one clock of the daemon: monotonic, scaled by a factor when the cell is simulated.
//!
//! In: the machine's monotonic clock and a factor. Out: [`Timestamp`]s since the clock was made, and waits
//! for such a timestamp. Every deadline and poll rate is counted on this clock, so none changes its meaning
//! when the simulation runs faster. The calendar time is read here too, for names and records only.

use crate::time::{Duration, Timestamp};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// A monotonic clock that runs `factor` times as fast as the machine's. Copies stay in step.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    origin: Instant,
    factor: f64,
}

impl Clock {
    /// A clock that starts now. A factor that is not positive and finite counts as 1.
    pub fn new(factor: f64) -> Clock {
        let factor = if factor.is_finite() && factor > 0.0 { factor } else { 1.0 };
        Clock { origin: Instant::now(), factor }
    }

    /// Scaled time since the clock was made.
    pub fn now(&self) -> Timestamp {
        self.at(Instant::now())
    }

    /// The scaled time of an instant of the machine's clock.
    pub fn at(&self, instant: Instant) -> Timestamp {
        Timestamp::from_secs_f64(instant.saturating_duration_since(self.origin).as_secs_f64() * self.factor)
    }

    /// How much faster than the machine's clock this one runs.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    /// The wall time that a stretch of this clock's time takes.
    pub fn wall(&self, scaled: Duration) -> Duration {
        scaled.div_f64(self.factor)
    }

    /// The machine's instant at which this clock shows `when`.
    pub fn instant(&self, when: Timestamp) -> Instant {
        self.origin + self.wall(Duration::from_nanos(when.nanos()))
    }

    /// Returns once this clock shows `when` or later.
    pub async fn sleep_until(&self, when: Timestamp) {
        tokio::time::sleep_until(tokio::time::Instant::from_std(self.instant(when))).await;
    }
}

/// Calendar time in s since 1970 (UTC); it may jump, so it dates records and decides nothing about motion.
pub fn unix_now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_factor_scales_time_and_waits_alike() {
        let clock = Clock::new(10.0);
        let later = clock.origin + Duration::from_millis(20);
        assert_eq!(clock.at(later), Timestamp::from_secs_f64(0.2));
        assert_eq!(clock.instant(Timestamp::from_secs_f64(0.2)), later);
        assert_eq!(clock.wall(Duration::from_secs(5)), Duration::from_millis(500));
    }

    #[test]
    fn a_bad_factor_is_one() {
        for factor in [0.0, -2.0, f64::NAN, f64::INFINITY] {
            assert_eq!(Clock::new(factor).factor(), 1.0);
        }
    }
}
