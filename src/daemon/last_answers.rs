//! When each device answered last and when the loop came round last, by the wall's clock, and how fast a
//! simulated cell goes by it.
//!
//! In: marks of the loop, for each answer of a device and each turn. Out: ages, for the status file. Apart
//! from the supervisor's status, whose words change only when a device does, and which a loop that hangs
//! does not change any more.

use cell_edge::clock::Clock;
use cell_machine::supervisor::status::Device;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Shared between the loop, which marks, and the keeper, which reads.
#[derive(Clone, Debug, Default)]
pub struct LastAnswers(Arc<Mutex<Marks>>, Option<Clock>);

#[derive(Debug, Default)]
struct Marks {
    devices: [Option<Instant>; 3],
    turn: Option<Instant>,
}

impl LastAnswers {
    /// None yet, in a cell with this clock.
    pub fn timed_by(clock: Clock) -> LastAnswers {
        LastAnswers(Arc::default(), Some(clock))
    }

    /// Seconds of the cell per second of the wall's clock, while it follows a simulator.
    pub fn time_factor(&self) -> Option<f64> {
        self.1.as_ref().and_then(Clock::factor_reached)
    }

    fn marks(&self) -> MutexGuard<'_, Marks> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The loop has come round now.
    pub fn turned(&self) {
        self.marks().turn = Some(Instant::now());
    }

    /// How long ago the loop came round; none before its first turn.
    pub fn loop_age(&self) -> Duration {
        self.marks().turn.map_or(Duration::ZERO, |at| at.elapsed())
    }

    /// The device has answered now.
    pub fn now(&self, device: Device) {
        self.marks().devices[device as usize] = Some(Instant::now());
    }

    /// How long ago the device answered, s, to a tenth; `None`: not since the start.
    pub fn age_s(&self, device: Device) -> Option<f64> {
        let answered = self.marks().devices[device as usize];
        answered.map(|at| (at.elapsed().as_secs_f64() * 10.0).round() / 10.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_device_has_an_age_of_its_own_once_it_has_answered() {
        let answered = LastAnswers::default();
        answered.now(Device::Gripper);
        assert!(answered.age_s(Device::Gripper).is_some_and(|age| age < 600.0));
        assert_eq!((answered.age_s(Device::Robot), answered.age_s(Device::Camera)), (None, None));
    }
}
