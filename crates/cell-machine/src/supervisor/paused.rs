//! Commands to the arm while its program is paused by another client or at the pendant.
//!
//! In: what the supervisor wants done. Out: the same, without what a paused program could not take, which is
//! kept for it.

use crate::device::robot_types::RobotCommand;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::input::{Action, DeviceSnapshot};
use ur_wire::enumerations::RuntimeState;

impl Supervisor {
    /// A paused program takes no commands: those of a pick-n-place that is under way are kept for it until
    /// it plays again, and fall away with a stop.
    pub(crate) fn hold_while_paused(
        &mut self,
        devices: &DeviceSnapshot,
        actions: Vec<Action>,
    ) -> Vec<Action> {
        let playing = devices.robot.is_none_or(|robot| robot.runtime_state == RuntimeState::Playing);
        let mut out = if playing { std::mem::take(&mut self.held_back) } else { Vec::new() };
        for action in actions {
            match &action {
                Action::Robot(
                    RobotCommand::Stream(_) | RobotCommand::SetOut(_) | RobotCommand::SetPayload { .. },
                ) if !playing && self.moving() => {
                    self.held_back.push(action);
                    continue;
                }
                Action::Robot(RobotCommand::Stop) => {
                    self.held_back.clear();
                    out.retain(|kept| !matches!(kept, Action::Robot(_)));
                }
                Action::Robot(
                    RobotCommand::Stream(_)
                    | RobotCommand::SetOut(_)
                    | RobotCommand::SetPayload { .. }
                    | RobotCommand::PowerOn
                    | RobotCommand::ReleaseBrakes
                    | RobotCommand::StartProgram { .. }
                    | RobotCommand::SetTcp(_)
                    | RobotCommand::EndProgram
                    | RobotCommand::UnlockProtectiveStop
                    | RobotCommand::CloseSafetyPopup,
                )
                | Action::Gripper(_)
                | Action::Capture { .. }
                | Action::Observe { .. }
                | Action::Picture { .. }
                | Action::Plan(_)
                | Action::Commit { .. }
                | Action::Reply { .. }
                | Action::RoundOver(_)
                | Action::Say(_)
                | Action::End(_) => {}
            }
            out.push(action);
        }
        if !self.moving() {
            self.held_back.clear();
        }
        out
    }
}
