//! Who waits for whom while a daemon follows the time of a simulator: decisions without sockets.
//!
//! In: simulated time, what each side has reported, and the wall's clock as an argument. Out: whether the
//! simulator holds its time, and which time the daemon's clock shows. Neither side waits for the other
//! longer than [`PATIENCE`].

use cell_values::time::Duration;
use std::time::Instant;

/// Simulated time that the simulator may be ahead of what is taken in: five states at 125 Hz, and well below
/// the age at which a state counts as stale.
pub const LEAD: Duration = Duration::from_millis(40);

/// Longest that one side waits for the other, wall time. After it, each goes on by itself, so that every
/// deadline still comes. Beside a load of 30 a thread may get no processor for a second.
pub const PATIENCE: Duration = Duration::from_secs(5);

/// Seconds of a simulator's time in a second of the wall's, at most.
const FASTEST: u32 = 1000;

/// A wait that ends with its patience, and does not begin again before its reason has ended once.
#[derive(Debug)]
pub struct Wait {
    patience: Duration,
    since: Option<Instant>,
    given_up: bool,
}

impl Default for Wait {
    fn default() -> Wait {
        Wait::of(PATIENCE)
    }
}

impl Wait {
    /// Not begun yet; it lasts for so long of the wall's time at most.
    pub fn of(patience: Duration) -> Wait {
        Wait { patience, since: None, given_up: false }
    }

    /// Whether to wait now, while `late` says that there is a reason to.
    pub fn holds(&mut self, late: bool, now: Instant) -> bool {
        if !late {
            *self = Wait::of(self.patience);
            return false;
        }
        let since = *self.since.get_or_insert(now);
        self.given_up |= now.saturating_duration_since(since) >= self.patience;
        !self.given_up
    }
}

/// How far a follower is, as the simulator sees it.
#[derive(Debug, Default)]
pub struct Progress {
    taken_in: Option<Duration>,
    wait: Wait,
}

impl Progress {
    /// The follower has taken in everything that was sent before this simulated time; false if that is
    /// before what it reported last. Only a report that goes on is a sign of life.
    pub fn taken_in(&mut self, simulated: Duration) -> bool {
        match self.taken_in {
            Some(before) if simulated < before => return false,
            Some(before) if simulated == before => {}
            Some(_) | None => self.wait = Wait::default(),
        }
        self.taken_in = Some(simulated);
        true
    }

    /// Whether the simulator holds its time for this follower: not before its first report; `None` once it
    /// has been waited for long enough.
    pub fn holds(&mut self, simulated: Duration, now: Instant) -> Option<bool> {
        let late = self.taken_in.is_some_and(|taken_in| simulated.saturating_sub(taken_in) > LEAD);
        let holds = self.wait.holds(late, now);
        (holds == late).then_some(holds)
    }
}

/// Where the time of a follower's clock comes from.
#[derive(Clone, Copy, Debug)]
enum Course {
    /// From the wall's clock: `shown` at `at`.
    Free { shown: Duration, at: Instant },
    /// From the simulator: `shown` at its time `simulated`, which arrived at `at`.
    Led { shown: Duration, simulated: Duration, at: Instant },
}

/// The time that a follower's clock shows. It never goes back, whatever becomes of the simulator.
#[derive(Debug)]
pub struct FollowerTime {
    factor: f64,
    course: Course,
}

impl FollowerTime {
    /// Zero now, and `factor` times as fast as the wall's clock until a simulator reports its time.
    pub fn new(factor: f64, now: Instant) -> FollowerTime {
        FollowerTime { factor, course: Course::Free { shown: Duration::ZERO, at: now } }
    }

    /// The time at `now`; a simulator that has been silent for [`PATIENCE`] is followed no longer.
    pub fn at(&mut self, now: Instant) -> Duration {
        if let Course::Led { shown, at, .. } = self.course
            && now.saturating_duration_since(at) > PATIENCE
        {
            self.course = Course::Free { shown, at: at + PATIENCE };
        }
        match self.course {
            Course::Free { shown, at } => shown + now.saturating_duration_since(at).mul_f64(self.factor),
            Course::Led { shown, .. } => shown,
        }
    }

    /// The simulator's time is `simulated`; false if that is before what it said last, or further ahead
    /// than any simulator runs.
    pub fn received(&mut self, simulated: Duration, now: Instant) -> bool {
        let shown = match self.course {
            Course::Led { shown, simulated: before, at } => {
                let most = (now.saturating_duration_since(at) + PATIENCE) * FASTEST;
                match simulated.checked_sub(before).filter(|passed| *passed <= most) {
                    Some(passed) => shown + passed,
                    None => return false,
                }
            }
            Course::Free { .. } => self.at(now),
        };
        self.course = Course::Led { shown, simulated, at: now };
        true
    }

    /// The simulator is gone: the time goes on from what it shows.
    pub fn lost(&mut self, now: Instant) {
        self.course = Course::Free { shown: self.at(now), at: now };
    }

    /// The simulator's own time, while it is followed.
    pub fn simulated(&self) -> Option<Duration> {
        match self.course {
            Course::Led { simulated, .. } => Some(simulated),
            Course::Free { .. } => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn the_simulator_waits_for_a_follower_that_has_reported_and_is_behind() {
        let (mut progress, start) = (Progress::default(), Instant::now());
        assert_eq!(progress.holds(3000 * MS, start), Some(false), "nobody has reported yet");
        assert!(progress.taken_in(2900 * MS));
        assert_eq!(progress.holds(3000 * MS, start), Some(true), "100 ms are too many");
        assert!(progress.taken_in(2980 * MS));
        assert_eq!(progress.holds(3000 * MS, start), Some(false));
    }

    #[test]
    fn a_follower_that_reports_nothing_is_given_up() {
        let (mut progress, start) = (Progress::default(), Instant::now());
        assert!(progress.taken_in(1000 * MS));
        assert_eq!(progress.holds(2000 * MS, start), Some(true));
        assert_eq!(progress.holds(2000 * MS, start + PATIENCE - MS), Some(true));
        assert_eq!(progress.holds(2000 * MS, start + PATIENCE), None);
    }

    #[test]
    fn a_follower_that_repeats_itself_is_given_up_and_one_that_goes_back_is_not_heard() {
        let (mut progress, start) = (Progress::default(), Instant::now());
        assert!(progress.taken_in(1000 * MS));
        for second in 0..5 {
            assert!(progress.taken_in(1000 * MS));
            assert_eq!(progress.holds(2000 * MS, start + second * 1000 * MS), Some(true));
        }
        assert_eq!(progress.holds(2000 * MS, start + PATIENCE), None);
        assert!(!progress.taken_in(999 * MS));
    }

    #[test]
    fn a_follower_that_reports_late_again_and_again_is_waited_for() {
        let (mut progress, start) = (Progress::default(), Instant::now());
        for second in 0..20 {
            assert!(progress.taken_in(1000 * second * MS));
            assert_eq!(progress.holds(1000 * (second + 1) * MS, start + 1000 * second * MS), Some(true));
        }
    }

    #[test]
    fn the_clock_stands_with_its_simulator() {
        let start = Instant::now();
        let mut time = FollowerTime::new(5.0, start);
        assert_eq!(time.at(start + 100 * MS), 500 * MS, "alone it runs at the factor");
        assert!(time.received(7000 * MS, start + 100 * MS));
        assert_eq!(time.at(start + 1000 * MS), 500 * MS);
        assert!(time.received(7040 * MS, start + 1000 * MS));
        assert_eq!(time.at(start + 1000 * MS), 540 * MS);
        assert_eq!(time.simulated(), Some(7040 * MS));
    }

    #[test]
    fn a_silent_simulator_does_not_stop_the_clock_for_longer_than_its_patience() {
        let start = Instant::now();
        let mut time = FollowerTime::new(2.0, start);
        time.received(1000 * MS, start);
        assert_eq!(time.at(start + PATIENCE), Duration::ZERO);
        assert_eq!(time.at(start + PATIENCE + 50 * MS), 100 * MS);
        assert_eq!(time.simulated(), None);
    }

    #[test]
    fn a_lost_simulator_lets_the_clock_go_on_at_once() {
        let start = Instant::now();
        let mut time = FollowerTime::new(1.0, start);
        time.received(1000 * MS, start);
        time.received(1200 * MS, start + 10 * MS);
        time.lost(start + 10 * MS);
        assert_eq!(time.at(start + 60 * MS), 250 * MS);
    }

    /// Otherwise the clock would stand until the simulator had caught up, and nothing would become stale.
    #[test]
    fn a_simulator_that_comes_back_is_followed_from_the_time_shown() {
        let start = Instant::now();
        let mut time = FollowerTime::new(1.0, start);
        time.received(1000 * MS, start);
        let back = start + PATIENCE + 500 * MS;
        assert_eq!(time.at(back), 500 * MS);
        assert!(time.received(1002 * MS, back));
        assert_eq!(time.at(back), 500 * MS);
        assert!(time.received(1010 * MS, back + 8 * MS));
        assert_eq!(time.at(back + 8 * MS), 508 * MS);
    }

    #[test]
    fn a_simulator_whose_time_goes_back_is_not_followed() {
        let start = Instant::now();
        let mut time = FollowerTime::new(1.0, start);
        assert!(time.received(1000 * MS, start) && time.received(1000 * MS, start));
        assert!(!time.received(999 * MS, start));
        assert!(!time.received(Duration::MAX, start), "nor one whose time jumps");
        assert!(time.received(2000 * MS, start));
    }
}
