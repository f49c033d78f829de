//! One frame of the arm: where its task puts the joints 2 ms later.
//!
//! In: the task, the speed scaling and the drift of this frame. Out: joint positions, speeds and
//! accelerations, or the fault that keeps the arm where the last frame left it. Every kind of task ends in
//! joint positions, so that drift and limits are applied in one place.

use crate::motion::mover::{Active, Mover, SOFT_RAMP_SECONDS, Task};
use crate::motion::{Arm, FRAME_SECONDS, MotionFault};
use cell_values::units::Joints;
use nalgebra::Vector6;
use std::collections::VecDeque;

impl Mover {
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
        let placed = next.and_then(|next| Ok((next, self.off_path(&next)?)));
        match placed.and_then(|(next, actual)| self.check(&actual).map(|()| (next, actual))) {
            Ok((next, actual)) => {
                let before = self.q();
                let placed = match actual == before {
                    true => self.placed,
                    false => self.arm.kinematics.chain().placed(&actual),
                };
                self.limit_tool_speed(&placed.frames[5]);
                let qd: [f64; 6] = std::array::from_fn(|i| (actual.0[i] - before.0[i]) / FRAME_SECONDS);
                self.qdd = std::array::from_fn(|i| (qd[i] - self.qd[i]) / FRAME_SECONDS);
                (self.q, self.placed, self.qd) = (next, placed, qd);
                if let Some(carried) = &mut self.carried {
                    carried.q = actual;
                }
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
        let before = self.q();
        for joint in 0..6 {
            let speed = (next.0[joint] - before.0[joint]) / FRAME_SECONDS;
            if speed.is_nan() || speed.abs() > self.arm.joint_speed[joint] * 1.05 {
                return Err(MotionFault::JointSpeed { joint, speed });
            }
        }
        match self.arm.outside(next) {
            Some(joint) => Err(MotionFault::JointRange { joint, position: next.0[joint] }),
            None => Ok(()),
        }
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
