//! The time that counts for a session's deadlines: that in which it was awake.
//!
//! In: the clock, and when the session wanted to be woken. Out: session time, which stands still while the
//! session was not woken although it was due. A busy PC that wakes a session late (and lets it look at its
//! deadlines before it has read what arrived meanwhile) must not accuse the device. What protects people from
//! a PC that sleeps is the watchdog on the robot; how old a state is, is always told by the real clock.

use crate::time::{Duration, Timestamp};

/// A wake-up may be this late without consequence.
const SLACK: Duration = Duration::from_millis(10);

/// Session time. See the module.
#[derive(Debug, Default)]
pub struct Pace {
    lateness: Duration,
    due: Option<Timestamp>,
    last: Timestamp,
}

impl Pace {
    /// Session time at `now`.
    pub fn wake(&mut self, now: Timestamp) -> Timestamp {
        let lateness = u64::try_from(self.lateness.as_nanos()).unwrap_or(u64::MAX);
        let mut time = Timestamp::from_nanos(now.nanos().saturating_sub(lateness));
        if let Some(due) = self.due.map(|due| due.max(self.last)) {
            let late = time.since(due);
            if late > SLACK {
                self.lateness += late;
                time = due;
            }
        }
        self.last = time.max(self.last);
        self.last
    }

    /// The session wants to be woken at this session time.
    pub fn sleep_until(&mut self, due: Option<Timestamp>) {
        self.due = due;
    }

    /// The clock's time of a session time.
    pub fn on_the_clock(&self, session: Timestamp) -> Timestamp {
        session + self.lateness
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    #[test]
    fn time_stands_still_while_overslept() {
        let mut pace = Pace::default();
        assert_eq!(pace.wake(ms(1000)), ms(1000));
        pace.sleep_until(Some(ms(1020)));
        assert_eq!(pace.wake(ms(1010)), ms(1010), "early is no matter");
        assert_eq!(pace.wake(ms(1025)), ms(1025), "a little late neither");
        pace.sleep_until(Some(ms(1040)));
        assert_eq!(pace.wake(ms(1640)), ms(1040));
        assert_eq!(pace.on_the_clock(ms(1060)), ms(1660));
        pace.sleep_until(Some(ms(1060)));
        assert_eq!(pace.wake(ms(1650)), ms(1050));
    }

    #[test]
    fn without_an_appointment_nothing_is_late_and_time_never_goes_back() {
        let mut pace = Pace::default();
        pace.wake(ms(1000));
        pace.sleep_until(None);
        assert_eq!(pace.wake(ms(9000)), ms(9000));
        pace.sleep_until(Some(Timestamp::ZERO));
        assert_eq!(pace.wake(ms(9005)), ms(9005));
        assert_eq!(pace.wake(ms(9200)), ms(9005), "an appointment in the past is one for at once");
    }
}
