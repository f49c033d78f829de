//! Quantities that cross module borders: joint positions, and the few factors between units.
//!
//! In and out: plain numbers. Everything inside celld is SI (m, rad, s, kg, N); degrees and millimetres
//! exist only in files people write and in text people read, and are converted here and nowhere else.

use serde::{Deserialize, Serialize};

/// Joint positions of a six-axis arm in rad, base to wrist 3 (the order of `actual_q` in RTDE).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Joints(pub [f64; 6]);

/// The joints' names, as the controller's messages have them.
pub const JOINT_NAMES: [&str; 6] = ["base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3"];

impl Joints {
    /// Largest absolute difference over the six joints, rad.
    #[inline]
    pub fn max_difference(&self, other: &Joints) -> f64 {
        self.0.iter().zip(&other.0).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    /// The joints a share (0 to 1) of the way along a straight joint move.
    #[inline]
    pub fn lerp(&self, to: &Joints, share: f64) -> Joints {
        Joints(std::array::from_fn(|i| self.0[i] + share * (to.0[i] - self.0[i])))
    }

    /// True when every number is finite.
    #[inline]
    pub fn is_finite(&self) -> bool {
        self.0.iter().all(|value| value.is_finite())
    }
}

/// Degrees to radians.
pub fn rad_from_deg(degrees: f64) -> f64 {
    degrees.to_radians()
}

/// Radians to degrees.
pub fn deg_from_rad(radians: f64) -> f64 {
    radians.to_degrees()
}

/// Metres to millimetres, for text.
pub fn mm_from_m(metres: f64) -> f64 {
    metres * 1e3
}

/// Standard atmosphere rounded as the gripper's manual does, Pa: relative vacuum x this x cup area = force.
pub const ATMOSPHERE_PA: f64 = 101_000.0;

/// Standard gravity, m/s2.
pub const GRAVITY: f64 = 9.80665;
