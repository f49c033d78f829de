//! What may be requested of the robot, and what has to hold before it is done.
//!
//! In: [`RobotCommand`]s. Out: dashboard commands, programs and streams, or a [`Refused`] with the reason.

use crate::device::registers::{CommandRegisters, Opcode};
use crate::device::robot::Robot;
use crate::device::robot::parts::{ArmGoal, ArmWait, Program};
use crate::device::robot_types::{Link, Refused, RobotCommand, RobotEvent, RobotState};
use crate::device::stream::Stream;
use cell_motion::path::CheckedPath;
use cell_values::time::{Duration, Timestamp};
use ur_arm::kinematics::DhParameters;
use ur_wire::dashboard::Command;
use ur_wire::enumerations::{RobotMode, RuntimeState};

/// The real arm takes 3 to 8 s to power on and 2 to 5 s to release its brakes.
const ARM_WITHIN: Duration = Duration::from_secs(30);
/// A path may begin this far from where the arm is, rad per joint: the arm's own tracking error at rest is
/// far below, a path made for another place far above.
const START_TOLERANCE_RAD: f64 = 0.01;
/// The arm's rating, tool included, kg.
const MAX_PAYLOAD_KG: f64 = 5.0;

impl Robot {
    pub(super) fn take_command(&mut self, now: Timestamp, command: RobotCommand) -> Result<(), Refused> {
        match command {
            RobotCommand::PowerOn => self.request_arm(now, "power on", Command::PowerOn, ArmGoal::PoweredOn),
            RobotCommand::ReleaseBrakes => {
                self.request_arm(now, "brake release", Command::BrakeRelease, ArmGoal::Running)
            }
            RobotCommand::UnlockProtectiveStop => self.request_arm(
                now,
                "unlock protective stop",
                Command::UnlockProtectiveStop,
                ArmGoal::Unlocked,
            ),
            RobotCommand::CloseSafetyPopup => self.request_dashboard(now, Command::CloseSafetyPopup),
            RobotCommand::StartProgram { nonce } => {
                self.arm_is_ready()?;
                self.start_program(now, nonce)
            }
            RobotCommand::Stream(path) => self.stream_path(&path, Stream::push_path),
            RobotCommand::SetOut(path) => self.stream_path(&path, Stream::push_to_wait),
            RobotCommand::SetPayload { mass_kg, centre_of_gravity_m } => {
                self.program_takes_commands()?;
                within("payload in kg", mass_kg, 0.0, MAX_PAYLOAD_KG)?;
                for value in centre_of_gravity_m {
                    within("centre of gravity in m", value, -1.0, 1.0)?;
                }
                self.stream.push_payload(mass_kg, centre_of_gravity_m)
            }
            RobotCommand::SetTcp(tcp) => {
                self.program_takes_commands()?;
                for (index, value) in tcp.into_iter().enumerate() {
                    let limit = if index < 3 { 0.57 } else { std::f64::consts::PI };
                    within("TCP", value, -limit, limit)?;
                }
                self.stream.push_tcp(tcp)
            }
            RobotCommand::Stop => {
                self.stop(now);
                Ok(())
            }
            RobotCommand::EndProgram => self.end_program(now),
        }
    }

    fn request_dashboard(&mut self, now: Timestamp, command: Command) -> Result<(), Refused> {
        if self.remote_control != Some(true) {
            return Err(Refused::LocalMode);
        }
        let taken = self.dashboard.request(now, command);
        if taken { Ok(()) } else { Err(Refused::NotConnected(Link::Dashboard)) }
    }

    fn request_arm(
        &mut self,
        now: Timestamp,
        what: &'static str,
        command: Command,
        goal: ArmGoal,
    ) -> Result<(), Refused> {
        let state = self.state.as_ref().ok_or(Refused::NotConnected(Link::Rtde))?;
        if goal.reached(state) {
            self.report(RobotEvent::Completed { what: what.into() });
            return Ok(());
        }
        self.request_dashboard(now, command.clone())?;
        let powered_before = self.powers;
        if goal != ArmGoal::Unlocked {
            self.powers = true;
        }
        // A stop may have come between: the command counts anew, and so does its time.
        self.arm_waits.retain(|wait| wait.command != command);
        self.arm_waits.push(ArmWait {
            what: what.into(),
            command,
            goal,
            answered: false,
            deadline: now + ARM_WITHIN,
            powered_before,
        });
        Ok(())
    }

    /// What has to hold before a program is started: all of it is the robot's state, fresh.
    fn arm_is_ready(&self) -> Result<&RobotState, Refused> {
        let state = self.state.as_ref().ok_or(Refused::NotConnected(Link::Rtde))?;
        if !self.fresh(self.clock) {
            return Err(Refused::Stale);
        }
        if !state.safety_mode.allows_motion() {
            return Err(Refused::SafetyMode(state.safety_mode));
        }
        if state.robot_mode != RobotMode::Running {
            return Err(Refused::RobotMode(state.robot_mode));
        }
        if state.remote_control != Some(true) {
            return Err(Refused::LocalMode);
        }
        Ok(state)
    }

    pub(super) fn program_takes_commands(&self) -> Result<&RobotState, Refused> {
        let state = self.arm_is_ready()?;
        match &self.program {
            Program::Running { .. } if state.runtime_state == RuntimeState::Playing => Ok(state),
            Program::Running { .. } => Err(Refused::Busy("the program is paused")),
            Program::Absent => Err(Refused::NoProgram),
            Program::Clearing { .. } | Program::Starting { .. } => Err(Refused::Busy("it is being started")),
            Program::Stopping { .. } | Program::Halting { .. } => Err(Refused::Busy("it is being stopped")),
            Program::Ending { .. } => Err(Refused::Busy("it is being ended")),
        }
    }

    fn stream_path(
        &mut self,
        path: &CheckedPath,
        push: fn(&mut Stream, &CheckedPath, &DhParameters) -> Result<u32, Refused>,
    ) -> Result<(), Refused> {
        let state = self.program_takes_commands()?;
        let from = self.stream.end().unwrap_or(state.q);
        let difference_rad = from.max_difference(&path.start());
        if difference_rad > START_TOLERANCE_RAD || !path.start().is_finite() {
            return Err(Refused::WrongStart { difference_rad });
        }
        push(&mut self.stream, path, &self.dh).map(|_| ())
    }

    /// Writes a command that is taken with any new number.
    pub(super) fn write_at_once(&mut self, opcode: Opcode) {
        let sequence = self.stream.skip_sequence();
        self.rtde.write_command(&CommandRegisters::bare(sequence, opcode));
    }
}

fn within(what: &'static str, value: f64, low: f64, high: f64) -> Result<(), Refused> {
    if (low..=high).contains(&value) { Ok(()) } else { Err(Refused::BadNumber { what, value }) }
}
