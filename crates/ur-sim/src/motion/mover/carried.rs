//! The arm away from its path: its tasks go on in the path's own coordinates, and a conveyor or an offset
//! shifts where they lead.
//!
//! In: the belt, and how far it moves in a frame; or the offset that a script wants. Out: joint positions.
//! Without either nothing is computed, and the arm is where its tasks put it.

use crate::motion::MotionFault;
use crate::motion::belt::Belt;
use crate::motion::carrier::{Carried, Carrier};
use crate::motion::mover::{Mover, Task};
use crate::motion::path_offset::{OffsetFrame, OffsetWish, PathOffset};
use cell_values::units::Joints;
use nalgebra::Vector6;

impl Mover {
    /// From now on a belt carries all motion along; it begins where the arm is.
    pub fn track(&mut self, belt: Belt) {
        self.settle_on_path();
        self.carried = Some(Carried { by: Carrier::Belt(belt), q: self.q });
    }

    /// From now on the offset of [`Mover::offset`] is laid over all motion.
    pub fn begin_offset(&mut self) {
        if !self.is_offset() {
            self.settle_on_path();
            self.carried = Some(Carried { by: Carrier::Offset(PathOffset::default()), q: self.q });
        }
    }

    /// A belt carries the arm.
    pub fn tracks(&self) -> bool {
        self.carried.as_ref().is_some_and(|carried| matches!(carried.by, Carrier::Belt(_)))
    }

    /// An offset is laid over the path.
    pub fn is_offset(&self) -> bool {
        self.carried.as_ref().is_some_and(|carried| matches!(carried.by, Carrier::Offset(_)))
    }

    /// The offset that is applied, relative to `frame`: m and a rotation vector in rad; 0 without one.
    pub fn applied_offset(&self, frame: OffsetFrame) -> [f64; 6] {
        match self.carried.as_ref().map(|carried| &carried.by) {
            Some(Carrier::Offset(offset)) => offset.relative_to(frame, &self.path_tcp()),
            Some(Carrier::Belt(_)) | None => [0.0; 6],
        }
    }

    /// What scripts want laid over the path; it is when [`Mover::begin_offset`] has been called.
    pub fn offset(&mut self) -> &mut OffsetWish {
        &mut self.offset
    }

    /// The belt moves on: m or rad.
    pub fn move_belt(&mut self, by: f64) {
        if let Some(Carried { by: Carrier::Belt(belt), .. }) = &mut self.carried {
            belt.advance(by);
        }
    }

    /// The TCP's speed as it would be on its path: m/s, rad/s.
    pub fn path_speed(&self) -> Vector6<f64> {
        if self.carried.is_some() { self.own_tool_speed() } else { self.tcp_speed() }
    }

    /// Leaves belt or offset and stops the joints, the fastest of them braking at `acceleration` (rad/s2).
    pub fn leave_carrier(&mut self, acceleration: f64) {
        self.settle_on_path();
        self.task = Task::StopJoints { acceleration };
    }

    /// Where the arm is becomes where its path is.
    pub(super) fn settle_on_path(&mut self) {
        if let Some(carried) = self.carried.take() {
            (self.q, self.own) = (carried.q, self.qd);
            (self.drifted, self.tool_speed) = ([0.0; 6], None);
        }
    }

    /// Where the arm is for the next position of its path.
    pub(super) fn off_path(&mut self, path: &Joints) -> Result<Joints, MotionFault> {
        let Some(carried) = &mut self.carried else { return Ok(*path) };
        let now = self.arm.tcp(path);
        let pose = match &mut carried.by {
            Carrier::Belt(belt) => belt.place(&now),
            Carrier::Offset(offset) => {
                offset.advance(&self.offset, &self.arm.tcp(&self.q), &now);
                offset.place(&now)
            }
        };
        self.arm.follow(&pose, &carried.q).ok_or(MotionFault::Unreachable)
    }

    /// Ends the task of an arm at rest, which stays where it is: on its belt, too.
    pub fn rest(&mut self) {
        (self.task, self.own) = (Task::Stand, [0.0; 6]);
    }
}

#[cfg(test)]
mod tests {
    use crate::motion::Arm;
    use crate::motion::FRAME_SECONDS;
    use crate::motion::belt::Belt;
    use crate::motion::mover::Mover;
    use crate::motion::segment::MoveLimits;
    use cell_values::units::Joints;
    use nalgebra::{Translation3, Vector3};
    use ur_arm::kinematics::DhParameters;

    const LIMITS: MoveLimits =
        MoveLimits { acceleration: 1.2, speed: 0.25, seconds: 0.0, blend: 0.0, keeps: false };

    #[test]
    fn a_line_is_driven_on_the_belt_and_the_arm_brakes_behind_it() {
        let mut mover =
            Mover::new(Arm::ur5e(DhParameters::UR5E), Joints([0.0, -1.57, 1.57, -1.57, -1.57, 0.0]));
        let before = mover.tcp();
        mover.track(Belt::Straight { direction: Vector3::y(), moved: 0.0 });
        let to = Translation3::new(0.0, 0.0, -0.05) * before;
        let id = mover.move_tool(&to, &LIMITS).unwrap();
        let mut frames = 0;
        while !mover.released(id) {
            mover.move_belt(0.1 * FRAME_SECONDS);
            mover.step(1.0).unwrap();
            frames += 1;
        }
        let moved = f64::from(frames) * 0.1 * FRAME_SECONDS;
        let at = mover.tcp().translation.vector - before.translation.vector;
        assert!((at - Vector3::new(0.0, moved, -0.05)).norm() < 1e-6, "{at} {moved}");
        assert!((mover.tcp_speed()[1] - 0.1).abs() < 1e-3 && !mover.stands());
        // A second move goes on from the path's end, whatever the belt has done.
        let id = mover.move_tool(&before, &LIMITS).unwrap();
        while !mover.released(id) {
            mover.move_belt(0.1 * FRAME_SECONDS);
            mover.step(1.0).unwrap();
            frames += 1;
        }
        let moved = f64::from(frames) * 0.1 * FRAME_SECONDS;
        let at = mover.tcp().translation.vector - before.translation.vector;
        assert!((at - Vector3::new(0.0, moved, 0.0)).norm() < 1e-6, "{at} {moved}");
        mover.leave_carrier(20.0);
        assert!(!mover.tracks() && !mover.stands());
        while !mover.stands() {
            mover.step(1.0).unwrap();
        }
        let braked = mover.tcp().translation.vector - before.translation.vector;
        assert!((0.0..2e-3).contains(&(braked.y - moved)), "{braked}");
    }
}
