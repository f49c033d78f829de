//! The wait for the robot: until the controller has said which arm it moves.
//!
//! In: turns of the loop. Out: the arm, or why it did not become known; sentences about what is missing, at
//! once when that changes and again every minute: nothing is silent for long, and a robot that
//! is switched on an hour later is waited for.

use super::scene::NoObserver;
use super::{Shell, StartError};
use cell_machine::event::Arm;
use cell_values::time::Timestamp;
use std::time::Duration;

/// For the controller to say which arm it moves.
const IDENTIFY_WITHIN: Duration = Duration::from_secs(30);

/// For the first word about a robot that is awaited, and for the same word again.
const SPEAK_AFTER: Duration = Duration::from_secs(3);
const SPEAK_AGAIN: Duration = Duration::from_secs(60);

/// What was said last of a robot that is awaited.
#[derive(Default)]
struct Said {
    last: Option<(Timestamp, String)>,
}

impl Said {
    fn line(&mut self, now: Timestamp, missing: &str, say: &mut dyn FnMut(&str)) {
        let same = |(at, text): &(Timestamp, String)| text == missing && now.since(*at) < SPEAK_AGAIN;
        if !self.last.as_ref().is_some_and(same) {
            say(missing);
            self.last = Some((now, missing.to_string()));
        }
    }
}

impl Shell {
    /// Waits until the controller has said which arm it moves.
    ///
    /// # Errors
    /// It has not within 30 s, or `stop` was raised.
    pub async fn identify(&mut self, stop: &dyn Fn() -> bool) -> Result<Arm, StartError> {
        let began = self.now();
        loop {
            self.turn(&mut NoObserver).await;
            if let Some(arm) = self.outcome.arm.take() {
                return Ok(arm);
            }
            self.guard(began, IDENTIFY_WITHIN, "the robot did not answer on all its ports", stop)?;
        }
    }

    /// Waits as long as it takes until the controller has said which arm it moves, and says what is missing
    /// when that changes, and again every minute.
    ///
    /// # Errors
    /// `stop` was raised.
    pub async fn wait_for_robot(
        &mut self,
        stop: &dyn Fn() -> bool,
        say: &mut dyn FnMut(&str),
    ) -> Result<Arm, StartError> {
        let (began, mut said) = (self.now(), Said::default());
        loop {
            self.turn(&mut NoObserver).await;
            if let Some(arm) = self.outcome.arm.take() {
                return Ok(arm);
            }
            if stop() {
                return Err(StartError::Stopped);
            }
            // A robot that is there answers within this time.
            if self.now().since(began) >= SPEAK_AFTER {
                said.line(self.now(), &self.machine.missing().join("; "), say);
            }
        }
    }

    pub(super) fn guard(
        &self,
        since: Timestamp,
        within: Duration,
        what: &str,
        stop: &dyn Fn() -> bool,
    ) -> Result<(), StartError> {
        if stop() {
            return Err(StartError::Stopped);
        }
        if self.now().since(since) <= within {
            return Ok(());
        }
        let links = self.machine.missing();
        let links = if links.is_empty() { "all links are up".to_string() } else { links.join("; ") };
        Err(StartError::Deadline { what: what.to_string(), seconds: within.as_secs(), links })
    }
}
