//! When each device answered last, by the wall's clock.
//!
//! In: marks of the loop, for each answer of a device. Out: ages, for the status file. Apart from the
//! supervisor's status, whose words change only when a device does.

use cell_machine::supervisor::status::Device;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Shared between the loop, which marks, and the keeper, which reads.
#[derive(Clone, Debug, Default)]
pub struct LastAnswers(Arc<Mutex<[Option<Instant>; 3]>>);

impl LastAnswers {
    /// The device has answered now.
    pub fn now(&self, device: Device) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)[device as usize] = Some(Instant::now());
    }

    /// How long ago the device answered, s, to a tenth; `None`: not since the start.
    pub fn age_s(&self, device: Device) -> Option<f64> {
        let answered = self.0.lock().unwrap_or_else(PoisonError::into_inner)[device as usize];
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
