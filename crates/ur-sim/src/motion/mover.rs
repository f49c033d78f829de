//! What the arm is doing: following segments, servoing, moving at a speed, stopping or resting.
//!
//! In: commands (`commands`), and [`Mover::step`] once per frame (`frame`) with the speed scaling of that
//! frame. Out: joint positions, speeds and accelerations. The speed slider, pauses and protective stops
//! scale the time of the segments, so the arm stays on its path while it slows down and when it goes on. So
//! does the safety configuration's limit of the tool speed: the real controller plans within it and stops
//! protectively only when it is exceeded, which a simulated arm that follows exactly never does. A blend
//! the arm brakes for: the new segment starts from the target of the one before while that still brakes;
//! the joint positions are those of the new one plus what the old one lacks to its target. In a blend of
//! moves of equal acceleration `a` that meet at an angle, acceleration is at most `a` times the difference
//! of the two unit directions (that of a parabola).

use crate::motion::carrier::Carried;
use crate::motion::dynamics::tool_jacobian;
use crate::motion::path_offset::OffsetWish;
use crate::motion::rounding::{BlendConfig, Blends};
use crate::motion::segment::Segment;
use crate::motion::{Arm, FRAME_SECONDS};
use cell_values::units::Joints;
use nalgebra::{Isometry3, Vector6};
use std::collections::VecDeque;
use ur_arm::chain::Placed;

/// Time in which speed scaling goes from 1 to 0, s: pause and slider.
pub const SOFT_RAMP_SECONDS: f64 = 0.2;

/// The same for protective and safeguard stops.
pub const HARD_RAMP_SECONDS: f64 = 0.04;

/// Identity of a move command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MoveId(pub u64);

#[derive(Clone, Debug)]
struct Active {
    segment: Segment,
    time: f64,
    id: MoveId,
}

#[derive(Clone, Debug)]
enum Task {
    Stand,
    Segments(VecDeque<Active>),
    Servo {
        target: Joints,
        lookahead: f64,
        seconds_left: f64,
    },
    JointSpeed {
        target: [f64; 6],
        acceleration: f64,
    },
    /// Driven by torques for a frame at a time.
    Driven {
        acceleration: [f64; 6],
        frames_left: u32,
    },
    ToolSpeed {
        target: Vector6<f64>,
        acceleration: f64,
        turn_acceleration: f64,
    },
    StopJoints {
        acceleration: f64,
    },
    StopTool {
        acceleration: f64,
        turn_acceleration: f64,
    },
}

/// The moving arm.
#[derive(Clone, Debug)]
pub struct Mover {
    /// The arm's geometry and limits.
    pub arm: Arm,
    q: Joints,
    /// Links and bodies there, in the base frame; computed where the joints change, as most frames leave
    /// them.
    placed: Placed,
    qd: [f64; 6],
    qdd: [f64; 6],
    /// Joint speeds of the task alone, without the drift: what braking and speeding up start from.
    own: [f64; 6],
    task: Task,
    scaling: f64,
    /// A fault: the arm does not follow, and this is not reported.
    stalled: bool,
    /// Share of the motion that reaches the arm, 0 while it is stalled.
    drive: f64,
    ramp_seconds: f64,
    last_id: u64,
    /// Blend radius of the move that was started last, m.
    last_blend: f64,
    /// The radius at which that blend begins, m.
    blend_radius: f64,
    blends: Blends,
    still_frames: u64,
    /// Tool speed set in the last frame of a tool-speed task; measuring it anew each frame would drift.
    tool_speed: Option<Vector6<f64>>,
    /// Share of the segments' speed that keeps the arm within its limits, and that of the last frame.
    limiter: f64,
    limited: f64,
    /// Tool speed that is added to any motion (force mode, freedrive): m/s and rad/s in the base frame.
    drift: Vector6<f64>,
    /// How far the segments' joint positions have drifted, rad.
    drifted: [f64; 6],
    /// What takes the arm away from its path; `q` is then where its path is.
    carried: Option<Carried>,
    /// What scripts want laid over the path.
    offset: OffsetWish,
}

impl Mover {
    /// An arm at rest at `q`.
    pub fn new(arm: Arm, q: Joints) -> Mover {
        Mover {
            placed: arm.kinematics.chain().placed(&q),
            arm,
            q,
            qd: [0.0; 6],
            qdd: [0.0; 6],
            own: [0.0; 6],
            task: Task::Stand,
            scaling: 1.0,
            stalled: false,
            drive: 1.0,
            ramp_seconds: SOFT_RAMP_SECONDS,
            last_id: 0,
            last_blend: 0.0,
            blend_radius: 0.0,
            blends: Blends::new(BlendConfig::default()),
            still_frames: 0,
            tool_speed: None,
            limiter: 1.0,
            limited: 1.0,
            drift: Vector6::zeros(),
            drifted: [0.0; 6],
            carried: None,
            offset: OffsetWish::default(),
        }
    }

    /// Sets how later moves blend.
    pub fn set_blends(&mut self, config: BlendConfig) {
        self.blends = Blends::new(config);
    }

    /// True in a corner that is passed without braking, and for two frames after it.
    pub fn rounds_corner(&self) -> bool {
        let Task::Segments(segments) = &self.task else { return false };
        let mut corners = segments.iter().map(|active| (active.time, active.segment.corner_seconds()));
        corners.any(|(time, seconds)| seconds > 0.0 && time < seconds + 2.0 * FRAME_SECONDS)
    }

    /// The ordered speed of the line that the tool follows alone, m/s; none in a corner and for other moves.
    pub fn line_speed(&self) -> Option<f64> {
        let Task::Segments(segments) = &self.task else { return None };
        let only = segments.back().filter(|_| segments.len() == 1)?;
        let from = only.segment.corner_seconds() + 2.0 * FRAME_SECONDS;
        only.segment.line_speed().filter(|_| only.time >= from)
    }

    /// Joint positions.
    pub fn q(&self) -> Joints {
        self.carried.as_ref().map_or(self.q, |carried| carried.q)
    }

    /// The TCP in the base frame as it would be without conveyor and offset.
    pub fn path_tcp(&self) -> Isometry3<f64> {
        self.carried.as_ref().map_or_else(|| self.tcp(), |_| self.arm.tcp(&self.q))
    }

    /// Links and bodies in the base frame.
    pub fn placed(&self) -> &Placed {
        &self.placed
    }

    /// The flange in the base frame.
    pub fn flange(&self) -> Isometry3<f64> {
        self.placed.frames[5]
    }

    /// The TCP in the base frame.
    pub fn tcp(&self) -> Isometry3<f64> {
        self.flange() * self.arm.flange_from_tcp
    }

    /// Joint speeds over the last frame, rad/s.
    pub fn qd(&self) -> [f64; 6] {
        self.qd
    }

    /// Joint accelerations over the last frame, rad/s2.
    pub fn qdd(&self) -> [f64; 6] {
        self.qdd
    }

    /// Momentary speed scaling, 0 to 1.
    pub fn scaling(&self) -> f64 {
        self.scaling * self.limiter
    }

    /// Tool speed added to any motion: m/s and rad/s in the base frame.
    pub fn drift(&self) -> Vector6<f64> {
        self.drift
    }

    /// Lets the tool give way at this speed from now on.
    pub fn set_drift(&mut self, drift: Vector6<f64>) {
        self.drift = drift;
    }

    /// Pose the move that was started last leads to; `None` when the arm is in none.
    pub fn waypoint(&self) -> Option<Isometry3<f64>> {
        let Task::Segments(segments) = &self.task else { return None };
        segments.back().map(|last| self.arm.tcp(&last.segment.target()))
    }

    /// Whether the blend (m) of a move to `base_from_tcp` would reach into that of the move under way.
    pub fn blends_overlap(&self, base_from_tcp: &Isometry3<f64>, blend: f64) -> bool {
        let Some(before) = self.waypoint() else { return false };
        let apart = (base_from_tcp.translation.vector - before.translation.vector).norm();
        blend > 0.0 && self.last_blend > 0.0 && apart < self.last_blend + blend
    }

    /// True when no joint moves.
    pub fn stands(&self) -> bool {
        self.qd.iter().all(|speed| speed.abs() < 1e-9)
    }

    /// Frames since the arm last moved.
    pub fn still_frames(&self) -> u64 {
        self.still_frames
    }

    /// Speed of the TCP in the base frame: m/s, rad/s.
    pub fn tcp_speed(&self) -> Vector6<f64> {
        tool_jacobian(self.arm.kinematics.chain(), &self.arm.flange_from_tcp, &self.q())
            * Vector6::from(self.qd)
    }

    /// True once the program may go on: the move has ended, or its blend begins with the next frame.
    pub fn released(&self, id: MoveId) -> bool {
        let Task::Segments(segments) = &self.task else { return true };
        let active = segments.iter().find(|active| active.id == id);
        active.is_none_or(|active| {
            let release = active.segment.release();
            release < active.segment.duration() && active.time + FRAME_SECONDS >= release
        })
    }

    /// Nothing but force mode or freedrive moves the arm.
    pub fn has_braked(&self) -> bool {
        self.own.iter().all(|speed| speed.abs() < 1e-9)
    }

    /// True while a move that was not released yet is under way.
    pub fn busy(&self) -> bool {
        match &self.task {
            Task::Segments(segments) => segments.back().is_some_and(|active| !self.released(active.id)),
            Task::StopJoints { .. } | Task::StopTool { .. } => !self.has_braked(),
            Task::Stand
            | Task::Servo { .. }
            | Task::JointSpeed { .. }
            | Task::ToolSpeed { .. }
            | Task::Driven { .. } => false,
        }
    }

    /// Torques drive it.
    pub fn is_driven(&self) -> bool {
        matches!(self.task, Task::Driven { .. })
    }

    /// Share of its speed at which the arm moves now: the slider's, ramped, 0 while paused or stopped.
    pub fn pace(&self) -> f64 {
        self.scaling * self.drive
    }

    /// The requested speed has been reached, or none is requested.
    pub fn at_speed(&self) -> bool {
        match &self.task {
            Task::JointSpeed { target, .. } => {
                let aim = self.within_tool_speed(target.map(|speed| speed * self.pace()));
                aim.iter().zip(self.own).all(|(a, b)| (a - b).abs() < 1e-6)
            }
            Task::ToolSpeed { target, .. } => (self.tool_aim(target) - self.own_tool_speed()).norm() < 1e-4,
            Task::Stand | Task::Segments(_) | Task::Servo { .. } | Task::Driven { .. } => true,
            Task::StopJoints { .. } | Task::StopTool { .. } => self.stands(),
        }
    }

    /// Share of the time of the move that was started last, 0 to 1; `None` when the arm is in none.
    pub fn progress(&self) -> Option<f64> {
        let Task::Segments(segments) = &self.task else { return None };
        let last = segments.back()?;
        Some((last.time / last.segment.duration().max(FRAME_SECONDS)).clamp(0.0, 1.0))
    }

    /// Keeps the arm from following its commands (a fault), or lets it go on.
    pub fn set_stalled(&mut self, stalled: bool) {
        self.stalled = stalled;
    }

    /// Places an arm at rest elsewhere (start of the simulation, tests).
    pub fn place(&mut self, q: Joints) {
        self.freeze();
        (self.q, self.drifted, self.tool_speed) = (q, [0.0; 6], None);
        self.placed = self.arm.kinematics.chain().placed(&q);
    }

    /// Time in which speed scaling goes from 1 to 0 from now on, s.
    pub fn set_ramp(&mut self, seconds: f64) {
        self.ramp_seconds = seconds;
    }

    /// Ends whatever the arm does at once, as the brakes do.
    pub fn freeze(&mut self) {
        self.settle_on_path();
        self.task = Task::Stand;
        self.qd = [0.0; 6];
        self.qdd = [0.0; 6];
        self.own = [0.0; 6];
        self.drift = Vector6::zeros();
    }
}

mod carried;
mod commands;
mod corner;
mod frame;
mod tool_speed;

#[cfg(test)]
mod tests;
