//! The arm as far as motion needs to know it: kinematics, frames, limits, bodies.
//!
//! In: calibrated kinematics, where table and tool are. Out: joints for poses of the tool and back, in the
//! posture of the work or as near to other joints as full turns allow. Pure.

use crate::bodies::Bodies;
use cell_values::units::Joints;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use ur_arm::kinematics::Kinematics;

/// Limits every path keeps; from the cell's configuration, none has a default.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct ArmLimits {
    /// Lowest and highest position of each joint, rad.
    pub joint_range: [(f64, f64); 6],
    /// Highest joint speed, rad/s.
    pub joint_speed: f64,
    /// Highest joint acceleration, rad/s2.
    pub joint_acceleration: f64,
    /// Highest tool speed on linear segments, m/s.
    pub tool_speed: f64,
    /// Highest tool acceleration on linear segments, m/s2.
    pub tool_acceleration: f64,
}

/// The speed at which a controller passes blends, as far as it is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
pub enum BlendSpeed {
    /// Unknown: corners must be safe at any speed.
    #[default]
    Unknown,
    /// The controller brakes before the corner. Nobody has confirmed that of a real arm. Only for comparison
    /// in simulation: a load's grip does not limit the speed in corners.
    Braked,
}

/// The arm as far as motion needs to know it.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct ArmModel {
    /// Calibrated kinematics, from the controller.
    #[serde(rename = "dh")]
    pub kinematics: Kinematics,
    /// Where the table frame is in the base frame, from calibration.
    pub base_from_table: Isometry3<f64>,
    /// The tool frame (centre of the cup lips, z out of the gripper) in the flange frame.
    pub flange_from_tool: Isometry3<f64>,
    /// A taught posture over the table: work is done in its family of solutions (shoulder, elbow and wrist
    /// side), so that transfers never turn the arm inside out over the objects.
    pub home: Joints,
    /// Limits.
    pub limits: ArmLimits,
    /// Its speed in blends.
    pub blend_speed: BlendSpeed,
    /// Arm, tool, table and equipment as bodies.
    pub bodies: Bodies,
}

impl ArmModel {
    /// `base_from_flange` that brings the tool to `table_from_tool`.
    pub fn flange_at(&self, table_from_tool: &Isometry3<f64>) -> Isometry3<f64> {
        self.base_from_table * table_from_tool * self.flange_from_tool.inverse()
    }

    /// `table_from_tool` at joint positions `q`.
    pub fn tool_at(&self, q: &Joints) -> Isometry3<f64> {
        self.base_from_table.inverse() * self.kinematics.forward(q) * self.flange_from_tool
    }

    /// Joints for a tool pose, nearest to `near` and inside the joint range.
    pub fn joints_at(&self, table_from_tool: &Isometry3<f64>, near: &Joints) -> Option<Joints> {
        self.kinematics
            .inverse_near(&self.flange_at(table_from_tool), near, self.common_range())
            .filter(|q| self.outside_range(q).is_none())
    }

    /// As [`ArmModel::joints_at`], but only in the posture of `home`. Each joint comes as near to `near` as
    /// full turns and its range allow: an arm that was left wound up works on so, and does not sweep round.
    pub fn joints_in_work_posture(&self, table_from_tool: &Isometry3<f64>, near: &Joints) -> Option<Joints> {
        self.first_unwound(&self.in_work_posture(table_from_tool), near)
    }

    /// All joint solutions of a tool pose in the posture of `home`, without full turns.
    pub fn in_work_posture(&self, table_from_tool: &Isometry3<f64>) -> Vec<Joints> {
        let posture = self.kinematics.posture(&self.home);
        self.kinematics.inverse_in(&self.flange_at(table_from_tool), posture)
    }

    /// The first of these solutions that can be turned into its range, as [`ArmModel::unwound`] does.
    pub fn first_unwound(&self, solutions: &[Joints], near: &Joints) -> Option<Joints> {
        solutions.iter().find_map(|q| self.unwound(q, near))
    }

    /// The same position of the arm with each joint turned as near to `near` as its range allows; `None`
    /// where a joint has no such turn in its range.
    pub fn unwound(&self, q: &Joints, near: &Joints) -> Option<Joints> {
        let mut out = *q;
        for (joint, value) in out.0.iter_mut().enumerate() {
            let (low, high) = self.limits.joint_range[joint];
            let nearest = *value + TAU * ((near.0[joint] - *value) / TAU).round();
            let turns = [0.0, -TAU, TAU, -2.0 * TAU, 2.0 * TAU].map(|turn| nearest + turn);
            let in_range = turns.into_iter().filter(|turned| (low..=high).contains(turned));
            *value =
                in_range.min_by(|a, b| (a - near.0[joint]).abs().total_cmp(&(b - near.0[joint]).abs()))?;
        }
        Some(out)
    }

    /// The widest range that all joints share at least partly; single joints are checked separately.
    pub fn common_range(&self) -> (f64, f64) {
        let range = &self.limits.joint_range;
        (
            range.iter().map(|r| r.0).fold(f64::INFINITY, f64::min),
            range.iter().map(|r| r.1).fold(f64::NEG_INFINITY, f64::max),
        )
    }

    /// The first joint outside its range (or not a number).
    pub fn outside_range(&self, q: &Joints) -> Option<usize> {
        (0..6).find(|&i| {
            let (low, high) = self.limits.joint_range[i];
            !(low..=high).contains(&q.0[i])
        })
    }
}
