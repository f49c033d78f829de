//! The rules about the limits of every motion: range, speed and acceleration of the joints; speed of the
//! tool on a line; box and speed of a calibration round.
//!
//! In: the arm of every frame, the limits of the cell's own configuration, the round as it was ordered.
//! Out: breaches. The limits that the machine was given do not count. A stop may be harder than a motion,
//! and a corner that is cut turns: a blend of two moves of acceleration `a` takes up to `2 a`. A corner
//! that is passed without braking has the acceleration of its speed and radius, which is not judged here.
//! The rule that the gripper keeps its object is judged there too.

use crate::pair::rules::found::Found;
use crate::pair::rules::rule::Rule;
use crate::pair::rules::truth::Truth;
use cell_machine::supervisor::round::RoundOrder;
use cell_motion::arm::ArmLimits;
use cell_motion::slow::CalibrationBox;
use nalgebra::{Isometry3, Vector3};

/// A joint may be beyond its range by so much: what the arm follows a path to, rad.
const RANGE_RAD: f64 = 1e-3;

/// Share of a speed limit that is no breach of it.
const SPEED_SHARE: f64 = 1.02;

/// A corner between two moves takes so many times their acceleration, and a little for its shape.
const CORNER: f64 = 2.1;

/// Frames after full speed is reached in which the arm still catches up: 0.3 s.
const SETTLES_FRAMES: u64 = 150;

/// Fastest tool while calibrating, m/s, and what a measured speed may be over it.
const ROUND_M_S: f64 = 0.1;
const ROUND_SHARE: f64 = 1.05;

/// Frames over which the tool's speed is measured, 20 ms.
const MEASURED_FRAMES: u64 = 10;

/// The flange may be so far outside the calibration box: the error of a calibration, m.
const BOX_M: f64 = 2e-3;

/// A calibration round under way.
#[derive(Debug)]
struct Round {
    room: Option<CalibrationBox>,
    /// Where the tool was, and when.
    tool: Option<(u64, Vector3<f64>)>,
}

/// Limits of every motion. See the module.
#[derive(Debug)]
pub(super) struct Limits {
    limits: ArmLimits,
    flange_from_tool: Isometry3<f64>,
    /// Poses and box of the round that a person orders at the page.
    taught: RoundOrder,
    round: Option<Round>,
    /// The last frame in which something other than celld's program at full speed moved the arm.
    disturbed: u64,
}

impl Limits {
    /// Of this cell.
    pub fn new(limits: ArmLimits, flange_from_tool: Isometry3<f64>, taught: RoundOrder) -> Limits {
        Limits { limits, flange_from_tool, taught, round: None, disturbed: 0 }
    }

    /// A calibration round is ordered; without an order it is the taught one. Crossings are as fast as work.
    pub fn round_begins(&mut self, order: Option<&RoundOrder>) {
        let order = order.unwrap_or(&self.taught);
        self.round = order.crossings.is_empty().then_some(Round { room: order.room, tool: None });
    }

    /// It is over, or forgotten with its daemon.
    pub fn round_over(&mut self) {
        self.round = None;
    }

    /// One controller frame.
    pub fn frame(&mut self, truth: &Truth, found: &mut Found) {
        if !truth.ours || !truth.follows {
            self.disturbed = truth.frame;
        }
        if truth.ours && truth.moves {
            self.joints(truth, found);
            self.on_line(truth, found);
            self.in_round(truth, found);
        }
    }

    fn joints(&self, truth: &Truth, found: &mut Found) {
        let limits = &self.limits;
        for joint in 0..6 {
            let (low, high) = limits.joint_range[joint];
            let (q, speed) = (truth.q.0[joint], truth.qd[joint]);
            if q < low - RANGE_RAD || q > high + RANGE_RAD {
                found.push(Rule::JointRange, format!("joint {} at {q:.3} rad", joint + 1));
            }
            if speed.abs() > SPEED_SHARE * limits.joint_speed {
                found.push(Rule::JointSpeed, format!("joint {} at {speed:.2} rad/s", joint + 1));
            }
            let acceleration = truth.qdd[joint];
            let settled = truth.frame > self.disturbed + SETTLES_FRAMES;
            if settled && !truth.rounds && acceleration.abs() > CORNER * limits.joint_acceleration {
                let detail = format!("joint {} at {acceleration:.1} rad/s2", joint + 1);
                found.push(Rule::JointAcceleration, detail);
            }
        }
    }

    /// Nowhere on a line is the tool faster than ordered, whatever speed a corner has left it.
    fn on_line(&self, truth: &Truth, found: &mut Found) {
        let Some(ordered) = truth.line_speed else { return };
        let most = SPEED_SHARE * ordered.min(self.limits.tool_speed);
        if truth.tool_speed > most {
            found.push(Rule::ToolSpeed, format!("{:.3} m/s, not {most:.3}", truth.tool_speed));
        }
    }

    fn in_round(&mut self, truth: &Truth, found: &mut Found) {
        let Some(round) = &mut self.round else { return };
        let flange = truth.flange.translation.vector;
        let outside = round.room.map_or(0.0, |room| outside_m(&room, &flange));
        if outside > BOX_M {
            found.push(Rule::RoundOutsideBox, format!("{:.0} mm", 1e3 * outside));
        }
        let tool = (truth.flange * self.flange_from_tool).translation.vector;
        let (since, before) = *round.tool.get_or_insert((truth.frame, tool));
        let frames = truth.frame - since;
        if frames < MEASURED_FRAMES {
            return;
        }
        round.tool = Some((truth.frame, tool));
        let speed = (tool - before).norm() / (frames as f64 * ur_sim::motion::FRAME_SECONDS);
        if speed > ROUND_SHARE * ROUND_M_S {
            found.push(Rule::RoundTooFast, format!("{speed:.3} m/s"));
        }
    }
}

/// How far a place lies outside a box along the worst axis, m.
fn outside_m(room: &CalibrationBox, place: &Vector3<f64>) -> f64 {
    let beyond = |axis: usize| (room.low_m[axis] - place[axis]).max(place[axis] - room.high_m[axis]);
    beyond(0).max(beyond(1)).max(beyond(2)).max(0.0)
}
