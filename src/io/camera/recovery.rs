//! What is tried, and in which order, with a camera that gives no usable picture. Pure.
//!
//! In: the kind of fault, what the camera can do, what was tried since the last good picture. Out: the next
//! step. From mild to harsh: request again, connect anew, restart the device, give up; every step has a
//! count, so the ladder ends. What is wrong with the light or the focus is only waited for, and what is
//! wrong with the configuration not even that.

use crate::io::camera::FaultKind;
use std::time::Duration;

/// A step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Request a picture again after this time.
    Retry(Duration),
    /// Connect anew after this time, then request a picture.
    Reopen(Duration),
    /// Restart the device, then connect anew.
    Reset,
    /// Nothing is left to try.
    GiveUp,
}

/// What was tried since the last good picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tried {
    /// Pictures requested again.
    pub retries: u32,
    /// Connections made anew.
    pub reopened: u32,
    /// Restarts of the device.
    pub resets: u32,
}

/// How often a picture is requested again before anything else.
const RETRIES: u32 = 2;
/// How often the connection is made anew before and after a restart of the device.
const REOPENINGS: u32 = 2;
/// How often the device is restarted.
const RESETS: u32 = 1;
/// Before the first repetition: a camera at 5 pictures a second has a new one by then. It doubles each time.
const PAUSE: Duration = Duration::from_millis(200);

/// The next step.
pub fn next(kind: FaultKind, can_reset: bool, tried: &Tried) -> Step {
    match kind {
        FaultKind::Misfit | FaultKind::Ended => Step::GiveUp,
        FaultKind::Dark | FaultKind::Overexposed | FaultKind::Flat | FaultKind::Blurred => {
            // Exposure control may still be settling; the rest is for a person.
            if tried.retries < RETRIES { Step::Retry(doubled(tried.retries)) } else { Step::GiveUp }
        }
        FaultKind::Unplugged | FaultKind::Frozen | FaultKind::Repeated | FaultKind::Broken => {
            if tried.retries < RETRIES {
                Step::Retry(doubled(tried.retries))
            } else if tried.reopened < REOPENINGS * (1 + tried.resets) {
                Step::Reopen(doubled(tried.reopened % REOPENINGS))
            } else if can_reset && tried.resets < RESETS {
                Step::Reset
            } else {
                Step::GiveUp
            }
        }
    }
}

fn doubled(times: u32) -> Duration {
    PAUSE * 2u32.pow(times.min(4))
}

impl Tried {
    /// Counts a step.
    pub fn count(&mut self, step: Step) {
        match step {
            Step::Retry(_) => self.retries += 1,
            Step::Reopen(_) => self.reopened += 1,
            Step::Reset => self.resets += 1,
            Step::GiveUp => {}
        }
    }
}

impl std::fmt::Display for Tried {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let counts = [
            (self.retries, "another picture"),
            (self.reopened, "connected anew"),
            (self.resets, "device restarted"),
        ];
        let said: Vec<String> = counts
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("{what} {count} x"))
            .collect();
        if said.is_empty() {
            f.write_str("nothing, nothing would help")
        } else {
            f.write_str(&said.join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn climb(kind: FaultKind, can_reset: bool) -> String {
        let mut tried = Tried::default();
        let mut steps = String::new();
        loop {
            let step = next(kind, can_reset, &tried);
            tried.count(step);
            steps.push(match step {
                Step::Retry(_) => 'r',
                Step::Reopen(_) => 'o',
                Step::Reset => 'X',
                Step::GiveUp => return steps,
            });
        }
    }

    #[test]
    fn steps_go_from_mild_to_harsh_and_end() {
        assert_eq!(climb(FaultKind::Frozen, true), "rrooXoo");
        assert_eq!(climb(FaultKind::Unplugged, false), "rroo");
        assert_eq!(climb(FaultKind::Dark, true), "rr", "a restart brings no light");
        assert_eq!(climb(FaultKind::Misfit, true), "", "another serial number stays another");
    }

    #[test]
    fn pauses_grow_and_what_was_tried_is_reported() {
        let tried = Tried { retries: 1, ..Tried::default() };
        assert_eq!(next(FaultKind::Repeated, false, &tried), Step::Retry(2 * PAUSE));
        let tried = Tried { retries: 2, reopened: 2, resets: 1 };
        assert_eq!(tried.to_string(), "another picture 2 x, connected anew 2 x, device restarted 1 x");
    }
}
