//! Segments the arm can follow, and the check without which none reaches the robot.
//!
//! In: an [`ArmModel`] (calibrated kinematics, where the table and the tool are, limits, bodies), the
//! joints the path starts from, [`Leg`]s, and the [`Room`]: what lies on the table, what is held. Out: a
//! [`CheckedPath`], whose only constructor is the check, or a [`PathFault`] that names leg, joint, height
//! or the two bodies that would meet. Pure. The controller interpolates; the check follows the same
//! interpolation (joint-linear for `movej`, tool-linear for `movel`), corners between blended segments
//! included, and slows segments that would load a joint, or the vacuum, more than they may.

mod check;
mod corners;
mod fault;
mod leg;
mod traced;

pub use crate::arm::{ArmLimits, ArmModel, BlendSpeed};
use crate::bodies::Room;
pub use crate::path::fault::{PathFault, out_of_reach};
pub use crate::path::leg::{Leg, Segment};
use cell_values::units::Joints;
use serde::{Deserialize, Serialize};

/// A path that passed the check: the only thing the robot session accepts.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct CheckedPath {
    start: Joints,
    segments: Vec<Segment>,
}

impl CheckedPath {
    /// Checks `legs` from `start` on; see the module for what is checked.
    ///
    /// # Errors
    /// The first fault along the path.
    pub fn new(
        model: &ArmModel,
        start: &Joints,
        legs: &[Leg],
        room: &Room,
    ) -> Result<CheckedPath, PathFault> {
        Ok(CheckedPath { start: *start, segments: check::path(model, start, legs, room)? })
    }

    /// Where the arm has to be when the path begins.
    pub fn start(&self) -> Joints {
        self.start
    }

    /// Where the arm is at its end.
    pub fn end(&self) -> Joints {
        self.segments.last().map_or(self.start, Segment::target)
    }

    /// The segments in order.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }
}
