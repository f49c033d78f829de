//! What the arm is commanded to do: moves, servoing, speeds, torques, stops.
//!
//! In: targets, limits, and the task under way. Out: the mover's new task, or why a move cannot be made.
//! Apart from the frames because a command comes once and decides where its move starts and what it blends
//! with; a frame only follows the task that is there.

use crate::motion::mover::corner::Next;
use crate::motion::mover::{Active, MoveId, Mover, Task};
use crate::motion::rounding::EntrySpeed;
use crate::motion::segment::{MoveLimits, Segment, Start};
use crate::motion::tool_path::ToolPath;
use crate::motion::{FRAME_SECONDS, MotionFault};
use cell_values::units::Joints;
use nalgebra::{Isometry3, Vector6};
use std::collections::VecDeque;

impl Mover {
    /// Starts a joint move to `to`.
    ///
    /// # Errors
    /// When a target is out of range.
    pub fn move_joints(&mut self, to: &Joints, limits: &MoveLimits) -> Result<MoveId, MotionFault> {
        if let Some(joint) = self.arm.outside(to) {
            return Err(MotionFault::JointRange { joint, position: to.0[joint] });
        }
        let (limits, nominal) = (&self.blending(limits), limits.blend);
        if let Some(segment) = self.rounded(&Next::Joints(to), limits)? {
            return Ok(self.take_over(segment, limits, nominal));
        }
        let (from, lead) = self.departure(limits.acceleration);
        let segment = Segment::joint(&self.arm, &from, to, limits, Start::Lead(lead));
        Ok(self.add(segment, limits, nominal))
    }

    /// Starts a straight tool move to `base_from_tcp`.
    ///
    /// # Errors
    /// When the line leads out of reach or through a singularity.
    pub fn move_tool(
        &mut self,
        base_from_tcp: &Isometry3<f64>,
        limits: &MoveLimits,
    ) -> Result<MoveId, MotionFault> {
        let (limits, nominal) = (&self.blending(limits), limits.blend);
        if let Some(segment) = self.rounded(&Next::Tool(base_from_tcp), limits)? {
            return Ok(self.take_over(segment, limits, nominal));
        }
        let (from, lead) = self.departure(limits.acceleration.max(1.0));
        let path = ToolPath::line(&self.arm.tcp(&from), base_from_tcp);
        let segment = Segment::tool(&self.arm, &from, path, limits, Start::Lead(lead))?;
        Ok(self.add(segment, limits, nominal))
    }

    /// Starts a move on the circle through `via` to `to`; with `fixed` the tool turns with the circle.
    ///
    /// # Errors
    /// When the circle leads out of reach or through a singularity.
    pub fn move_circle(
        &mut self,
        via: &Isometry3<f64>,
        to: &Isometry3<f64>,
        fixed: bool,
        limits: &MoveLimits,
    ) -> Result<MoveId, MotionFault> {
        let (from, lead) = self.departure(limits.acceleration.max(1.0));
        let path = ToolPath::circle(&self.arm.tcp(&from), via, to, fixed);
        let segment = Segment::tool(&self.arm, &from, path, limits, Start::Lead(lead))?;
        Ok(self.add(segment, limits, limits.blend))
    }

    /// Starts a process move: where the last one's blend begins, the tool goes on at its speed round the
    /// corner.
    ///
    /// # Errors
    /// When the way leads out of reach or through a singularity.
    pub fn move_process(
        &mut self,
        base_from_tcp: &Isometry3<f64>,
        limits: &MoveLimits,
    ) -> Result<MoveId, MotionFault> {
        if let Some((path, speed)) = self.takeover(base_from_tcp) {
            let segment = Segment::process(&self.arm, &self.q, path, limits, Start::Motion(speed))?;
            return Ok(self.take_over(segment, limits, limits.blend));
        }
        let (from, lead) = self.departure(limits.acceleration.max(1.0));
        let path = ToolPath::line(&self.arm.tcp(&from), base_from_tcp);
        let segment = Segment::process(&self.arm, &from, path, limits, Start::Lead(lead))?;
        Ok(self.add(segment, limits, limits.blend))
    }

    /// The way on to `to` from a process move whose blend has begun, and the speed it goes on with.
    fn takeover(&self, to: &Isometry3<f64>) -> Option<(ToolPath, f64)> {
        let Task::Segments(segments) = &self.task else { return None };
        let only = segments.back().filter(|_| segments.len() == 1)?;
        let handover = only.segment.handover(only.time)?;
        let path = ToolPath::corner(&self.path_tcp(), &handover.direction, handover.ahead, to)?;
        Some((path, handover.speed))
    }

    /// Accelerates the joints (rad/s2) for this frame and the next; then they brake unless driven on.
    pub fn drive(&mut self, acceleration: [f64; 6]) {
        self.task = Task::Driven { acceleration, frames_left: 2 };
    }

    /// Lets the arm follow `target` with a first-order lag of `lookahead` (s) for `seconds`.
    ///
    /// # Errors
    /// A target is out of a joint's range; the arm then goes on with what it did.
    pub fn servo(&mut self, target: &Joints, lookahead: f64, seconds: f64) -> Result<(), MotionFault> {
        if let Some(joint) = self.arm.outside(target) {
            return Err(MotionFault::JointRange { joint, position: target.0[joint] });
        }
        let seconds_left = seconds.max(FRAME_SECONDS);
        self.task = Task::Servo { target: *target, lookahead: lookahead.max(FRAME_SECONDS), seconds_left };
        Ok(())
    }

    /// Moves the joints at `target` (rad/s) until the next command.
    pub fn joint_speed(&mut self, target: [f64; 6], acceleration: f64) {
        self.task = Task::JointSpeed { target, acceleration };
    }

    /// Moves the tool at `target` (m/s, rad/s in the base frame) until the next command.
    pub fn tool_speed(&mut self, target: Vector6<f64>, acceleration: f64, turn_acceleration: f64) {
        self.task = Task::ToolSpeed { target, acceleration, turn_acceleration };
    }

    /// Stops the joints, the fastest of them braking at `acceleration` (rad/s2).
    pub fn stop_joints(&mut self, acceleration: f64) {
        self.task = Task::StopJoints { acceleration };
    }

    /// Stops the tool along its direction at `acceleration` (m/s2) and `turn_acceleration` (rad/s2).
    pub fn stop_tool(&mut self, acceleration: f64, turn_acceleration: f64) {
        self.task = Task::StopTool { acceleration, turn_acceleration };
    }

    /// Where a new segment starts, and how long what is under way still takes: the blend of a segment, or
    /// the run-out of any other motion.
    fn departure(&mut self, acceleration: f64) -> (Joints, f64) {
        if let Task::Segments(segments) = &self.task
            && let Some(last) = segments.back()
        {
            return (last.segment.target(), (last.segment.duration() - last.time).max(0.0));
        }
        if self.stands() || (self.carried.is_some() && self.has_braked()) {
            self.task = Task::Segments(VecDeque::new());
            return (self.q, 0.0);
        }
        let segment = Segment::run_out(&self.q, &self.own, acceleration);
        let departure = (segment.target(), segment.duration());
        self.task = Task::Segments(VecDeque::from([Active { segment, time: 0.0, id: MoveId(0) }]));
        departure
    }

    /// A move with the radius at which its blend begins.
    fn blending(&mut self, limits: &MoveLimits) -> MoveLimits {
        let keeps = self.blends.entry_speed() != EntrySpeed::Braked;
        MoveLimits { blend: self.blends.radius(limits.blend), keeps, ..*limits }
    }

    /// In place of the move under way.
    fn take_over(&mut self, segment: Segment, limits: &MoveLimits, nominal: f64) -> MoveId {
        self.task = Task::Segments(VecDeque::new());
        self.add(segment, limits, nominal)
    }

    /// `nominal` is the blend's radius as it was commanded, m.
    fn add(&mut self, segment: Segment, limits: &MoveLimits, nominal: f64) -> MoveId {
        self.last_id += 1;
        (self.last_blend, self.blend_radius) = (nominal, limits.blend);
        let id = MoveId(self.last_id);
        let active = Active { segment, time: 0.0, id };
        match &mut self.task {
            Task::Segments(segments) => segments.push_back(active),
            other => *other = Task::Segments(VecDeque::from([active])),
        }
        id
    }
}
