//! What stops the cell, in words: a code for programs, a sentence and what to do for people, each reason
//! its own.
//!
//! In: what the controller or a device reports, whether something is held. Out: [`Reason`]s. A hint never
//! names a command that would be refused: while something is held `celld arm` is, and `celld recover` leads
//! on. Pure.

use crate::code::Code;
use crate::device::robot_types::{ProgramEnd, RobotEvent};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::motion_speed;
use crate::supervisor::input::DeviceSnapshot;
use crate::supervisor::phase::Phase;
use crate::supervisor::reason::Reason;
use crate::supervisor::safety_words::{mode_words, safety_code, safety_hint, safety_words};
use cell_values::time::Timestamp;
use ur_wire::enumerations::{RobotMode, RuntimeState, SafetyMode};

impl Supervisor {
    /// A reason with what to do first; what comes then depends on what is held.
    fn reason_of(&self, code: Code, message: impl Into<String>, first: &str) -> Reason {
        code.because(message, format!("{first}; {}", self.then()))
    }

    /// Something is held, or may hang on the cups.
    pub(crate) fn may_be_held(&self) -> bool {
        let held = self.back.held.as_ref().is_some_and(|held| !held.let_go);
        held || self.back.grips || self.back.fell.is_some()
    }

    /// What leads on after a stop.
    pub(crate) fn then(&self) -> &'static str {
        self.then_with(self.job_waits_for_a_round())
    }

    /// The same; `waits`: the job goes on waiting after the stop.
    pub(crate) fn then_with(&self, waits: bool) -> &'static str {
        match (self.may_be_held(), self.job.is_some()) {
            (true, _) => "something may be held: `celld recover` shows the ways back",
            (false, true) if waits => "the job waits: `celld arm` has it begin",
            (false, true) => "then `celld arm` and submit again",
            (false, false) => "then `celld arm`",
        }
    }

    fn safety_reason(&self, mode: SafetyMode) -> Reason {
        let hint = safety_hint(mode);
        match safety_code(mode) {
            Code::ProtectiveStop => Code::ProtectiveStop.because(safety_words(mode), hint),
            code => self.reason_of(code, safety_words(mode), hint),
        }
    }

    /// Why an event of the robot stops the cell; `None` for those that do not.
    pub(crate) fn fault_of(&mut self, devices: &DeviceSnapshot, event: RobotEvent) -> Option<Reason> {
        if let Some(reason) = self.other_robot(&event) {
            return Some(reason);
        }
        Some(match event {
            RobotEvent::ProgramEnded { reason } => return self.program_reason(reason),
            RobotEvent::RuntimeException { line, column, text } => {
                let message = format!("the on-robot program failed at line {line}, column {column}: {text}");
                self.reason_of(Code::ProgramFailed, message, "report this line, it is celld's own program")
            }
            RobotEvent::LinkSilent { link, detail } => {
                let first = "see that the controller is on and in the network";
                self.reason_of(Code::LinkSilent, format!("{link}: {detail}"), first)
            }
            RobotEvent::ProtocolFault { link, detail, .. } => {
                let first = "see that this controller and its software are those of the README";
                self.reason_of(Code::ProtocolFault, format!("{link}: {detail}"), first)
            }
            RobotEvent::ArmStalled { detail } => {
                let first = "see what holds the arm, and the pendant";
                self.reason_of(Code::ArmStalled, format!("the arm does not follow: {detail}"), first)
            }
            RobotEvent::JointJump { detail } => {
                let first = "look at the arm, and at the pendant for a fault of this joint";
                self.reason_of(Code::JointJump, format!("the arm's position jumped: {detail}"), first)
            }
            RobotEvent::RtdeLost => self.rtde_lost(devices),
            RobotEvent::Refused { what, reply } => {
                let message = format!("{what} was not carried out by the controller: {reply}");
                self.reason_of(Code::RobotRefused, message, "see the pendant")
            }
            RobotEvent::Safety { mode } if !mode.allows_motion() => self.safety_reason(mode),
            RobotEvent::RemoteControl { on: false } => self.local_control(),
            RobotEvent::Safety { .. }
            | RobotEvent::RemoteControl { on: true }
            | RobotEvent::Kinematics { .. }
            | RobotEvent::SafetyChecksum { .. }
            | RobotEvent::RtdeReady
            | RobotEvent::Identity { .. }
            | RobotEvent::ProgramRunning { .. }
            | RobotEvent::SegmentFinished { .. }
            | RobotEvent::PathFinished { .. }
            | RobotEvent::PayloadSet
            | RobotEvent::TcpSet
            | RobotEvent::Stopped
            | RobotEvent::Paused
            | RobotEvent::Resumed
            | RobotEvent::Mode { .. }
            | RobotEvent::Completed { .. }
            | RobotEvent::InputInUse { .. }
            | RobotEvent::ErrorCode { .. }
            | RobotEvent::Message { .. } => return None,
        })
    }

    fn program_reason(&mut self, reason: ProgramEnd) -> Option<Reason> {
        // Whatever ran before ours is stopped on the way to starting ours.
        if matches!((&self.phase, &reason), (Phase::BringUp(_), ProgramEnd::AsRequested)) {
            return None;
        }
        self.nonce = None;
        let message = format!("celld's program on the robot does not run as it should: {reason}");
        Some(match reason {
            // A round, the daemon or a stop has ended it; why is said already.
            ProgramEnd::AsRequested | ProgramEnd::StoppedByUs => return None,
            ProgramEnd::FromOutside => {
                self.reason_of(Code::ProgramStopped, message, "see who stopped it, and that the cell is safe")
            }
            ProgramEnd::Replaced => {
                self.reason_of(Code::ProgramReplaced, message, "see who else sends programs to this robot")
            }
            ProgramEnd::HeartbeatLost => {
                let first = "see the network, and that this computer is not overloaded";
                match self.job_outlives_a_stop() {
                    true => Code::HeartbeatLost.because(message, first),
                    false => self.reason_of(Code::HeartbeatLost, message, first),
                }
            }
            ProgramEnd::LinkLost => {
                let first = "see the network, and that no other RTDE client has taken celld's inputs \
                             (`celld recover` names those taken)";
                self.reason_of(Code::LinkLost, message, first)
            }
            ProgramEnd::NotStarted(_) => {
                self.reason_of(Code::ProgramNotStarted, message, "see the pendant for the program's error")
            }
            ProgramEnd::Rejected { .. } | ProgramEnd::Exception { .. } => {
                self.reason_of(Code::ProgramFailed, message, "report this, it is celld's own program")
            }
            ProgramEnd::Overdue(_) => {
                let first = "see the pendant, and that no other program runs";
                self.reason_of(Code::ProgramOverdue, message, first)
            }
        })
    }

    fn rtde_lost(&self, devices: &DeviceSnapshot) -> Reason {
        if devices.all_links_lost {
            let message = "the controller closed all its connections: it is restarting or was switched off";
            return self.reason_of(Code::ControllerGone, message, "wait for the controller, look at the arm");
        }
        let message = "the connection to the controller (RTDE) is lost, and with it the sight of the arm: \
                       its program should stop by itself, keep away until the arm is seen at rest";
        self.reason_of(Code::LinkLost, message, "see the network between this computer and the controller")
    }

    fn local_control(&self) -> Reason {
        let message = "the pendant was switched to local control";
        self.reason_of(
            Code::LocalControl,
            message,
            "switch it back to Remote Control once nobody works at it",
        )
    }

    /// What in the robot's state forbids going on with a motion.
    pub(crate) fn motion_reason(&self, now: Timestamp, devices: &DeviceSnapshot) -> Option<Reason> {
        let Some(robot) = devices.robot else {
            let message = "the robot has never sent a state";
            return Some(self.reason_of(Code::LinkSilent, message, "see that the controller is on"));
        };
        if !devices.robot_fresh {
            let seconds = now.since(robot.received).as_secs_f64();
            let message = format!("the robot's state stopped coming {seconds:.2} s ago");
            Some(self.reason_of(Code::LinkSilent, message, "see the network and the load of this computer"))
        } else if !robot.safety_mode.allows_motion() {
            Some(self.safety_reason(robot.safety_mode))
        } else if robot.robot_mode != RobotMode::Running {
            let message = format!("the arm is not ready any more: {}", mode_words(robot.robot_mode));
            Some(self.reason_of(Code::PowerSwitched, message, "see who switched its power or brakes"))
        } else if robot.guided {
            let message = "a person holds the freedrive button";
            Some(self.reason_of(Code::HandGuided, message, "let go of it and stand clear"))
        } else if robot.remote_control == Some(false) {
            Some(self.local_control())
        } else {
            None
        }
    }

    /// A motion that was held for too long.
    pub(crate) fn held_too_long(&self, devices: &DeviceSnapshot) -> Reason {
        let paused = devices.robot.is_some_and(|robot| robot.runtime_state != RuntimeState::Playing);
        if paused || motion_speed(devices) > 0.0 {
            let message = "the program was paused for too long: the table may have changed";
            self.reason_of(Code::PausedTooLong, message, "see that the cell is safe")
        } else {
            let message = "the speed slider was at zero for too long: the table may have changed";
            let hint = "raise the speed slider (in Local Control if the pendant locks it)";
            self.reason_of(Code::SpeedZero, message, hint)
        }
    }
}
