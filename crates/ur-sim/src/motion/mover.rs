//! What the arm is doing: following segments, servoing, moving at a speed, stopping or resting.
//!
//! In: commands, and [`Mover::step`] once per frame with the speed scaling of that frame. Out: joint
//! positions, speeds and accelerations. The speed slider, pauses and protective stops scale the time of the
//! segments, so the arm stays on its path while it slows down and when it goes on. So does the safety
//! configuration's limit of the tool speed: the real controller plans within it and stops protectively only
//! when it is exceeded, which a simulated arm that follows exactly never does.
//! A blend: the new segment starts from the target of the one before while that still brakes; the joint
//! positions are those of the new one plus what the old one lacks to its target. In a blend of moves of equal
//! acceleration `a` that meet at an angle, acceleration is at most `a` times the difference of the two unit
//! directions (that of a parabola).

use crate::motion::dynamics::tool_jacobian;
use crate::motion::segment::{MoveLimits, Segment, Start};
use crate::motion::tool_path::ToolPath;
use crate::motion::{Arm, FRAME_SECONDS, MotionFault};
use cell_values::units::Joints;
use nalgebra::{Isometry3, Vector6};
use std::collections::VecDeque;

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
    still_frames: u64,
    /// Tool speed set in the last frame of a tool-speed task; measuring it anew each frame would drift.
    tool_speed: Option<Vector6<f64>>,
    /// Share of the segments' speed that keeps the tool within its limit.
    limiter: f64,
    /// Tool speed that is added to any motion (force mode, freedrive): m/s and rad/s in the base frame.
    drift: Vector6<f64>,
    /// How far the segments' joint positions have drifted, rad.
    drifted: [f64; 6],
}

impl Mover {
    /// An arm at rest at `q`.
    pub fn new(arm: Arm, q: Joints) -> Mover {
        Mover {
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
            still_frames: 0,
            tool_speed: None,
            limiter: 1.0,
            drift: Vector6::zeros(),
            drifted: [0.0; 6],
        }
    }

    /// Joint positions.
    pub fn q(&self) -> Joints {
        self.q
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
        tool_jacobian(&self.arm.dh, &self.arm.flange_from_tcp, &self.q) * Vector6::from(self.qd)
    }

    /// Starts a joint move to `to`.
    ///
    /// # Errors
    /// When a target is out of range.
    pub fn move_joints(&mut self, to: &Joints, limits: &MoveLimits) -> Result<MoveId, MotionFault> {
        if let Some(joint) = self.arm.outside(to) {
            return Err(MotionFault::JointRange { joint, position: to.0[joint] });
        }
        let (from, lead) = self.departure(limits.acceleration);
        let segment = Segment::joint(&self.arm, &from, to, limits, lead);
        Ok(self.add(segment))
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
        let (from, lead) = self.departure(limits.acceleration.max(1.0));
        let path = ToolPath::line(&self.arm.tcp(&from), base_from_tcp);
        let segment = Segment::tool(&self.arm, &from, path, limits, lead)?;
        Ok(self.add(segment))
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
        let segment = Segment::tool(&self.arm, &from, path, limits, lead)?;
        Ok(self.add(segment))
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
            self.task = Task::Segments(VecDeque::new());
            return Ok(self.add(segment));
        }
        let (from, lead) = self.departure(limits.acceleration.max(1.0));
        let path = ToolPath::line(&self.arm.tcp(&from), base_from_tcp);
        let segment = Segment::process(&self.arm, &from, path, limits, Start::Lead(lead))?;
        Ok(self.add(segment))
    }

    /// The way on to `to` from a process move whose blend has begun, and the speed it goes on with.
    fn takeover(&self, to: &Isometry3<f64>) -> Option<(ToolPath, f64)> {
        let Task::Segments(segments) = &self.task else { return None };
        let only = segments.back().filter(|_| segments.len() == 1)?;
        let handover = only.segment.handover(only.time)?;
        let path = ToolPath::corner(&self.arm.tcp(&self.q), &handover.direction, handover.ahead, to)?;
        Some((path, handover.speed))
    }

    /// Accelerates the joints (rad/s2) for this frame and the next; then they brake unless driven on.
    pub fn drive(&mut self, acceleration: [f64; 6]) {
        self.task = Task::Driven { acceleration, frames_left: 2 };
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
    }

    /// Time in which speed scaling goes from 1 to 0 from now on, s.
    pub fn set_ramp(&mut self, seconds: f64) {
        self.ramp_seconds = seconds;
    }

    /// Ends whatever the arm does at once, as the brakes do.
    pub fn freeze(&mut self) {
        self.task = Task::Stand;
        self.qd = [0.0; 6];
        self.qdd = [0.0; 6];
        self.own = [0.0; 6];
        self.drift = Vector6::zeros();
    }

    /// One frame of `FRAME_SECONDS`; `scaling` is where the speed scaling should go (0: at rest).
    ///
    /// # Errors
    /// When the arm cannot go on; it then stays where the last frame left it.
    pub fn step(&mut self, scaling: f64) -> Result<(), MotionFault> {
        if !matches!(self.task, Task::ToolSpeed { .. } | Task::StopTool { .. }) {
            self.tool_speed = None;
        }
        let ramp = if matches!(self.task, Task::Stand) { 1.0 } else { FRAME_SECONDS / self.ramp_seconds };
        self.scaling += (scaling - self.scaling).clamp(-ramp, ramp);
        let drive = if self.stalled { 0.0 } else { 1.0 };
        self.drive +=
            (drive - self.drive).clamp(-FRAME_SECONDS / SOFT_RAMP_SECONDS, FRAME_SECONDS / SOFT_RAMP_SECONDS);
        let next = self.next_position().and_then(|next| self.give_way(next));
        match next.and_then(|next| self.check(&next).map(|()| next)) {
            Ok(next) => {
                self.limit_tool_speed(&next);
                let qd: [f64; 6] = std::array::from_fn(|i| (next.0[i] - self.q.0[i]) / FRAME_SECONDS);
                self.qdd = std::array::from_fn(|i| (qd[i] - self.qd[i]) / FRAME_SECONDS);
                (self.q, self.qd) = (next, qd);
                self.still_frames = if self.stands() { self.still_frames.saturating_add(1) } else { 0 };
                Ok(())
            }
            Err(fault) => {
                self.freeze();
                Err(fault)
            }
        }
    }

    /// Adds the drift of this frame, and to segments what has drifted before.
    fn give_way(&mut self, next: Joints) -> Result<Joints, MotionFault> {
        let on_segments = matches!(self.task, Task::Segments(_));
        let mut given = next;
        if on_segments {
            given.0.iter_mut().zip(self.drifted).for_each(|(q, drifted)| *q += drifted);
        }
        self.own = std::array::from_fn(|i| (given.0[i] - self.q.0[i]) / FRAME_SECONDS);
        let step = self.drift * (FRAME_SECONDS * self.scaling * self.drive);
        if step.norm() > 0.0 {
            given =
                self.arm.follow(&self.arm.moved(&given, &step), &given).ok_or(MotionFault::Unreachable)?;
        }
        let drifted = std::array::from_fn(|i| given.0[i] - next.0[i]);
        self.drifted = if on_segments { drifted } else { [0.0; 6] };
        Ok(given)
    }

    fn check(&self, next: &Joints) -> Result<(), MotionFault> {
        for joint in 0..6 {
            let speed = (next.0[joint] - self.q.0[joint]) / FRAME_SECONDS;
            if speed.is_nan() || speed.abs() > self.arm.joint_speed[joint] * 1.05 {
                return Err(MotionFault::JointSpeed { joint, speed });
            }
        }
        match self.arm.outside(next) {
            Some(joint) => Err(MotionFault::JointRange { joint, position: next.0[joint] }),
            None => Ok(()),
        }
    }

    /// Where a new segment starts, and how long what is under way still takes: the blend of a segment, or
    /// the run-out of any other motion.
    fn departure(&mut self, acceleration: f64) -> (Joints, f64) {
        if let Task::Segments(segments) = &self.task
            && let Some(last) = segments.back()
        {
            return (last.segment.target(), (last.segment.duration() - last.time).max(0.0));
        }
        if self.stands() {
            self.task = Task::Segments(VecDeque::new());
            return (self.q, 0.0);
        }
        let segment = Segment::run_out(&self.q, &self.own, acceleration);
        let departure = (segment.target(), segment.duration());
        self.task = Task::Segments(VecDeque::from([Active { segment, time: 0.0, id: MoveId(0) }]));
        departure
    }

    fn add(&mut self, segment: Segment) -> MoveId {
        self.last_id += 1;
        let id = MoveId(self.last_id);
        let active = Active { segment, time: 0.0, id };
        match &mut self.task {
            Task::Segments(segments) => segments.push_back(active),
            other => *other = Task::Segments(VecDeque::from([active])),
        }
        id
    }

    fn next_position(&mut self) -> Result<Joints, MotionFault> {
        let pace = self.pace();
        let scaled = FRAME_SECONDS * pace * self.limiter;
        match &mut self.task {
            Task::Stand => Ok(self.q),
            Task::Segments(segments) => {
                let next = sum_of(segments, &self.arm, &self.q, scaled)?;
                if segments.is_empty() {
                    self.task = Task::Stand;
                }
                Ok(next)
            }
            Task::Servo { .. } => Ok(self.servo_step()),
            Task::JointSpeed { target, acceleration } => {
                let (target, acceleration) = (target.map(|speed| speed * pace), *acceleration);
                Ok(self.towards(&self.within_tool_speed(target), acceleration))
            }
            Task::Driven { acceleration, frames_left } => {
                let acceleration = *acceleration;
                *frames_left = frames_left.saturating_sub(1);
                if *frames_left == 0 || pace < 0.5 {
                    self.task = Task::StopJoints { acceleration: self.arm.joint_acceleration / 4.0 };
                }
                Ok(Joints(std::array::from_fn(|i| {
                    let speed = self.own[i] + acceleration[i] * FRAME_SECONDS;
                    self.q.0[i] + speed * FRAME_SECONDS
                })))
            }
            Task::ToolSpeed { target, acceleration, turn_acceleration } => {
                let (target, a, turn) = (*target, *acceleration, *turn_acceleration);
                self.tool_speed_step(self.tool_aim(&target), a, turn)
            }
            Task::StopJoints { acceleration } => {
                let acceleration = *acceleration;
                let next = self.towards(&[0.0; 6], acceleration);
                self.stand_when_there(&next);
                Ok(next)
            }
            Task::StopTool { acceleration, turn_acceleration } => {
                let (acceleration, turn) = (*acceleration, *turn_acceleration);
                let next = self.tool_speed_step(Vector6::zeros(), acceleration, turn)?;
                self.stand_when_there(&next);
                Ok(next)
            }
        }
    }

    fn stand_when_there(&mut self, next: &Joints) {
        if next.max_difference(&self.q) < 1e-12 {
            self.task = Task::Stand;
        }
    }

    fn servo_step(&mut self) -> Joints {
        let Task::Servo { target, lookahead, seconds_left } = &mut self.task else { return self.q };
        *seconds_left -= FRAME_SECONDS;
        let (limit, gain) = (self.arm.joint_speed, self.scaling * self.drive / *lookahead);
        let wanted: [f64; 6] =
            std::array::from_fn(|i| ((target.0[i] - self.q.0[i]) * gain).clamp(-limit[i], limit[i]));
        let over = *seconds_left < -FRAME_SECONDS / 2.0;
        let wanted = self.within_tool_speed(wanted);
        let acceleration = self.arm.joint_acceleration;
        if over {
            self.task = Task::StopJoints { acceleration: acceleration / 4.0 };
        }
        let most = acceleration * FRAME_SECONDS;
        Joints(std::array::from_fn(|i| {
            self.q.0[i] + (self.own[i] + (wanted[i] - self.own[i]).clamp(-most, most)) * FRAME_SECONDS
        }))
    }

    /// A frame with the speeds changing towards `target`, all in step, the one that changes most by
    /// `acceleration`.
    fn towards(&self, target: &[f64; 6], acceleration: f64) -> Joints {
        let most = target.iter().zip(self.own).fold(0.0f64, |most, (a, b)| most.max((a - b).abs()));
        let part = if most > 0.0 { (acceleration * FRAME_SECONDS / most).min(1.0) } else { 1.0 };
        Joints(std::array::from_fn(|i| {
            self.q.0[i] + (self.own[i] + (target[i] - self.own[i]) * part) * FRAME_SECONDS
        }))
    }

    fn tool_speed_step(
        &mut self,
        target: Vector6<f64>,
        acceleration: f64,
        turn_acceleration: f64,
    ) -> Result<Joints, MotionFault> {
        let now = self.tool_speed.unwrap_or_else(|| self.own_tool_speed());
        let change = target - now;
        let (linear, angular) = (change.fixed_rows::<3>(0).norm(), change.fixed_rows::<3>(3).norm());
        let part = (acceleration * FRAME_SECONDS / linear.max(1e-12))
            .min(turn_acceleration * FRAME_SECONDS / angular.max(1e-12))
            .min(1.0);
        let speed = now + change * part;
        self.tool_speed = Some(speed);
        if speed.norm() < 1e-12 {
            return Ok(self.q);
        }
        let next = self.arm.moved(&self.q, &(speed * FRAME_SECONDS));
        self.arm.follow(&next, &self.q).ok_or(MotionFault::Unreachable)
    }
}

/// Advances all segments by `seconds`: the position of the last, plus what each earlier one lacks to its
/// target. Segments that have ended are removed.
fn sum_of(
    segments: &mut VecDeque<Active>,
    arm: &Arm,
    standing: &Joints,
    seconds: f64,
) -> Result<Joints, MotionFault> {
    let mut sum = *standing;
    for (index, active) in segments.iter_mut().rev().enumerate() {
        active.time += seconds;
        let position = active.segment.position(arm, active.time)?;
        if index == 0 {
            sum = position;
        } else {
            let target = active.segment.target();
            sum.0.iter_mut().zip(position.0).zip(target.0).for_each(|((sum, q), t)| *sum += q - t);
        }
    }
    segments.retain(|active| active.time < active.segment.duration());
    Ok(sum)
}

mod tool_speed;

#[cfg(test)]
mod tests;
