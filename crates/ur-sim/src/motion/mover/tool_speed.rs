//! How fast the tool and the arm are, and may be.
//!
//! In: the mover's joint speeds and the tool speed limit of the safety configuration. Out: speeds scaled
//! down to it. Here because segments, joint speeds and tool speeds are all held to the same limit.

use crate::motion::FRAME_SECONDS;
use crate::motion::dynamics::tool_jacobian;
use crate::motion::mover::{Mover, Task};
use nalgebra::{Isometry3, Vector6};

impl Mover {
    /// Slows segments down in the next frame to the tool speed allowed: the speed this frame would have had
    /// without the limiter determines by how much.
    pub(super) fn limit_tool_speed(&mut self, next_flange: &Isometry3<f64>) {
        let next = next_flange * self.arm.flange_from_tcp;
        let speed = (next.translation.vector - self.tcp().translation.vector).norm() / FRAME_SECONDS;
        let unlimited = speed / self.limiter;
        self.limited = self.limiter;
        let allowed = (self.arm.tool_speed / unlimited.max(1e-9)).clamp(0.01, 1.0);
        self.limiter = if matches!(self.task, Task::Segments(_)) { allowed } else { 1.0 };
    }

    /// Slows segments down in the next frame: the last one took `strain` of what is allowed, which grows
    /// with the speed. True if something else than segments is beyond it, which cannot be slowed.
    pub fn hold_back(&mut self, strain: f64) -> bool {
        if !matches!(self.task, Task::Segments(_)) {
            return strain > 1.0;
        }
        let unlimited = strain / self.limited;
        self.limiter = self.limiter.min(1.0 / unlimited.max(1e-9)).max(0.01);
        false
    }

    /// Joint speeds (rad/s) scaled down so that the tool keeps its limit.
    pub(super) fn within_tool_speed(&self, speeds: [f64; 6]) -> [f64; 6] {
        let arm = &self.arm;
        let tool =
            tool_jacobian(arm.kinematics.chain(), &arm.flange_from_tcp, &self.q) * Vector6::from(speeds);
        let part = (arm.tool_speed / tool.fixed_rows::<3>(0).norm().max(1e-9)).min(1.0);
        speeds.map(|speed| speed * part)
    }

    /// The task's part of the tool's speed: m/s and rad/s in the base frame.
    pub(super) fn own_tool_speed(&self) -> Vector6<f64> {
        tool_jacobian(self.arm.kinematics.chain(), &self.arm.flange_from_tcp, &self.q)
            * Vector6::from(self.own)
    }

    /// What a commanded tool speed comes to now: the slider's share, within the tool's limit.
    pub(super) fn tool_aim(&self, target: &Vector6<f64>) -> Vector6<f64> {
        let slowed = self.arm.tool_speed / target.fixed_rows::<3>(0).norm().max(1e-9);
        *target * (self.pace() * slowed.min(1.0))
    }
}
