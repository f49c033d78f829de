//! The poses of the frames that bodies move with.
//!
//! In: an arm's chain, joints. Out: the poses of base, links and flange, and how each moves. Pure.

use crate::bodies::nearing::{Twist, twists};
use crate::bodies::shape::placed;
use cell_values::units::Joints;
use nalgebra::Isometry3;
use parry3d_f64::math::Pose;
use ur_arm::chain::Chain;

/// Frame of what hangs on the flange, after the arm's frames 0 (base) to 6.
pub const TOOL_FRAME: usize = 7;

/// Poses of the frames 0 to 6 and of the flange, in the base frame.
pub(super) fn poses(chain: &Chain, q: &Joints) -> [Pose; 8] {
    of_bodies(&chain.placed(q).bodies)
}

/// The same, and how each moves there while the joints go `way` (rad).
pub(super) fn moving(chain: &Chain, q: &Joints, way: &[f64; 6]) -> ([Pose; 8], [Twist; 8]) {
    let placed = chain.placed(q);
    let twists = twists(&placed.frames, way);
    (of_bodies(&placed.bodies), std::array::from_fn(|frame| twists[frame.min(6)]))
}

fn of_bodies(bodies: &[Isometry3<f64>; 6]) -> [Pose; 8] {
    std::array::from_fn(|frame| match frame {
        0 => Pose::IDENTITY,
        TOOL_FRAME => placed(&bodies[5]),
        link => placed(&bodies[link - 1]),
    })
}
