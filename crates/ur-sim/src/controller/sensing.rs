//! What the arm feels: the force at its tool, contact, and where it has been.
//!
//! In: the force with which the world presses on the tool ([`Sensing::set_contact_wrench`], the hook of the
//! world), the force a client's own sensor reports over RTDE, joint positions of each frame. Out: the
//! measured force, how long a contact has lasted, joint positions of the last seconds. Modelled: the sensor
//! has no noise and the tool no weight in it, so that a free arm measures nothing.

use cell_values::units::Joints;
use nalgebra::{Isometry3, Vector3};
use std::collections::VecDeque;

/// Frames that are remembered (3 s).
const FRAMES: usize = 1500;

/// Force that counts as contact, N.
const CONTACT_FORCE: f64 = 5.0;

/// A force sensor of a client.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExternalSensor {
    /// Where it measures, in the flange frame, m.
    pub offset: [f64; 3],
}

/// Force sensor, contact detection and history.
#[derive(Clone, Debug, Default)]
pub struct Sensing {
    /// At the TCP, base frame: N, Nm; what the world does to the tool.
    contact: [f64; 6],
    /// A client's sensor is used instead of the built-in one.
    pub external: Option<ExternalSensor>,
    zero: [f64; 6],
    /// Newest first.
    frames: VecDeque<(Joints, [f64; 6])>,
}

impl Sensing {
    /// What the world does to the tool from now on: force (N) and torque (Nm) at the TCP in the base frame.
    pub fn set_contact_wrench(&mut self, wrench: [f64; 6]) {
        if wrench.iter().all(|value| value.is_finite()) {
            self.contact = wrench;
        }
    }

    /// Force and torque before zeroing; `reported` is what a client sends for its sensor, in the flange
    /// frame.
    pub fn raw(
        &self,
        reported: &[f64; 6],
        base_from_flange: &Isometry3<f64>,
        tcp: &Vector3<f64>,
    ) -> [f64; 6] {
        let Some(sensor) = &self.external else { return self.contact };
        let part = |first: usize| {
            base_from_flange.rotation
                * Vector3::new(reported[first], reported[first + 1], reported[first + 2])
        };
        let lever = base_from_flange.rotation * (Vector3::from(sensor.offset) - tcp);
        let (force, torque) = (part(0), part(3) + lever.cross(&part(0)));
        [force.x, force.y, force.z, torque.x, torque.y, torque.z]
    }

    /// What the world does to the tool, whatever a sensor says of it: N, Nm, at the TCP in the base frame.
    pub fn contact(&self) -> [f64; 6] {
        self.contact
    }

    /// Takes the present force for none.
    pub fn zero(&mut self, raw: [f64; 6]) {
        self.zero = raw;
    }

    /// Force and torque as shown, from what [`Sensing::raw`] gives.
    pub fn measured(&self, raw: &[f64; 6]) -> [f64; 6] {
        std::array::from_fn(|i| raw[i] - self.zero[i])
    }

    /// Remembers a frame.
    pub fn remember(&mut self, q: Joints, measured: [f64; 6]) {
        self.frames.truncate(FRAMES - 1);
        self.frames.push_front((q, measured));
    }

    /// Joint positions and measured forces of the last seconds, newest first.
    pub fn past(&self) -> impl Iterator<Item = &(Joints, [f64; 6])> {
        self.frames.iter()
    }

    /// Joint positions `frames` ago; `None` further back than is remembered.
    pub fn positions(&self, frames: usize) -> Option<Joints> {
        self.frames.get(frames).map(|(q, _)| *q)
    }

    /// Frames since the tool came into contact against `direction` (base frame; zero for any), 0 without
    /// one.
    pub fn contact_frames(&self, direction: &Vector3<f64>) -> usize {
        let touches = |force: &[f64; 6]| {
            let force = Vector3::new(force[0], force[1], force[2]);
            let against = match direction.try_normalize(1e-9) {
                Some(direction) => -force.dot(&direction),
                None => force.norm(),
            };
            against > CONTACT_FORCE
        };
        self.frames.iter().take_while(|(_, force)| touches(force)).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contact_counts_from_its_begin_and_by_its_direction() {
        let mut sensing = Sensing::default();
        let q = |x: f64| Joints([x; 6]);
        (0..10).for_each(|k| sensing.remember(q(f64::from(k)), [0.0; 6]));
        (10..17).for_each(|k| sensing.remember(q(f64::from(k)), [0.0, 0.0, 20.0, 0.0, 0.0, 0.0]));
        assert_eq!(sensing.contact_frames(&Vector3::zeros()), 7);
        assert_eq!(sensing.contact_frames(&Vector3::new(0.0, 0.0, -0.1)), 7, "pressing down");
        assert_eq!(sensing.contact_frames(&Vector3::new(0.0, 0.0, 0.1)), 0, "moving away");
        assert_eq!(sensing.positions(7), Some(q(9.0)), "the last position without contact");
        assert_eq!(sensing.positions(17), None);
    }

    #[test]
    fn a_clients_sensor_is_turned_into_the_base_frame_and_zeroed() {
        let mut sensing =
            Sensing { external: Some(ExternalSensor { offset: [0.0; 3] }), ..Sensing::default() };
        let flange = Isometry3::rotation(Vector3::x() * std::f64::consts::FRAC_PI_2);
        let raw = sensing.raw(&[0.0, 2.0, 0.0, 0.0, 0.0, 0.0], &flange, &Vector3::new(0.0, 0.0, 0.1));
        assert!((raw[2] - 2.0).abs() < 1e-12, "flange y is base z: {raw:?}");
        assert!((raw[3] - 0.2).abs() < 1e-12, "about a TCP 0.1 m ahead: {raw:?}");
        sensing.zero(raw);
        assert_eq!(sensing.measured(&raw), [0.0; 6]);
    }
}
