//! What the robot's session is made of: the program's life, the heartbeat, requests to the arm, as plain
//! data.
//!
//! Below the files that work with it, so that none of them needs another.

use crate::device::program::Nonce;
use crate::device::robot_types::{ProgramEnd, RobotState};
use cell_values::time::{Duration, Timestamp};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use ur_wire::dashboard::Command;
use ur_wire::enumerations::{RobotMode, SafetyMode};

/// Commands that the program could take may be held back (stale state, remote control unknown) this long.
pub const SEND_WITHIN: Duration = Duration::from_secs(5);

/// No path begins when the dashboard's last answer about remote control is older: it is polled every second,
/// and a pendant that was switched meanwhile must not see the arm set off.
pub const REMOTE_CONTROL_WITHIN: Duration = Duration::from_millis(1500);

/// Where the program is in its life.
#[derive(Deserialize, Serialize)]
pub enum Program {
    /// None of ours runs.
    Absent,
    /// Whatever runs is being stopped, then ours is uploaded.
    Clearing {
        /// Of ours.
        nonce: Nonce,
        /// For the other to stop.
        deadline: Timestamp,
    },
    /// Uploaded, not proved.
    Starting {
        /// Looked for.
        nonce: Nonce,
        /// For the nonce.
        deadline: Timestamp,
        /// The link was read-only; the text goes out again once it is made anew.
        upload_again: bool,
        /// That has happened once.
        retried: bool,
    },
    /// Proved by its nonce.
    Running {
        /// Its nonce.
        nonce: Nonce,
    },
    /// The stop opcode is out: the arm comes to rest, then the program ends.
    Stopping {
        /// For its end.
        deadline: Timestamp,
    },
    /// Will end by itself.
    Ending {
        /// Why.
        reason: ProgramEnd,
        /// Until when.
        deadline: Timestamp,
    },
    /// The dashboard's `stop` is out and the heartbeat is off.
    Halting {
        /// Why; `None` if the program was not ours.
        reason: Option<ProgramEnd>,
        /// A requester waits for [`RobotEvent::Stopped`].
        requested: bool,
        /// Until when.
        deadline: Timestamp,
    },
}

impl Program {
    /// When its patience ends.
    pub fn deadline(&self) -> Option<Timestamp> {
        match self {
            Program::Absent | Program::Running { .. } => None,
            Program::Clearing { deadline, .. }
            | Program::Starting { deadline, .. }
            | Program::Stopping { deadline }
            | Program::Ending { deadline, .. }
            | Program::Halting { deadline, .. } => Some(*deadline),
        }
    }

    /// A program of ours may be on the controller and reads its registers in its next frame.
    pub fn reads_registers(&self) -> bool {
        match self {
            Program::Starting { .. }
            | Program::Running { .. }
            | Program::Stopping { .. }
            | Program::Ending { .. } => true,
            Program::Absent | Program::Clearing { .. } | Program::Halting { .. } => false,
        }
    }

    /// It may begin or go on with a motion.
    pub fn may_move(&self) -> bool {
        match self {
            Program::Clearing { .. } | Program::Starting { .. } | Program::Running { .. } => true,
            Program::Absent | Program::Stopping { .. } | Program::Ending { .. } | Program::Halting { .. } => {
                false
            }
        }
    }

    pub fn wants_heartbeat(&self) -> bool {
        self.reads_registers()
    }
}

/// The sign of life, and its echo.
#[derive(Default, Deserialize, Serialize)]
pub struct Heartbeat {
    pub count: i32,
    pub next: Option<Timestamp>,
    pub echo: i32,
    pub echo_changed: Timestamp,
}

impl Heartbeat {
    /// When the next is due.
    pub fn next(&self) -> Option<Timestamp> {
        self.next
    }
}

/// Answers to who the controller is.
#[derive(Default, Deserialize, Serialize)]
pub struct Identity {
    pub serial: Option<String>,
    pub model: Option<String>,
    pub version: Option<String>,
    pub reported: bool,
}

/// What an accepted dashboard command has to lead to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum ArmGoal {
    /// Power is on.
    PoweredOn,
    /// The brakes are off.
    Running,
    /// The safety mode allows motion again.
    Unlocked,
}

/// Waiting for the arm to do what the dashboard accepted.
#[derive(Deserialize, Serialize)]
pub struct ArmWait {
    /// For people.
    pub what: Cow<'static, str>,
    /// The command that was sent.
    pub command: Command,
    /// When it is done.
    pub goal: ArmGoal,
    /// The controller has accepted it.
    pub answered: bool,
    /// Until when.
    pub deadline: Timestamp,
    /// Power or brakes had been wanted before it.
    #[serde(default)]
    pub powered_before: bool,
}

/// What was sent for power and brakes comes true by itself unless `power off` follows it.
#[derive(Deserialize, Serialize)]
pub struct PoweringOff {
    /// The controller has accepted it.
    pub accepted: bool,
    /// Since then, and the arm is off.
    pub off_since: Option<Timestamp>,
    /// By then whatever was sent before has come true at the latest.
    pub until: Timestamp,
}

impl ArmGoal {
    /// True if the robot is there.
    pub fn reached(self, state: &RobotState) -> bool {
        match self {
            ArmGoal::PoweredOn => match state.robot_mode {
                RobotMode::Idle | RobotMode::Running => true,
                RobotMode::NoController
                | RobotMode::Disconnected
                | RobotMode::ConfirmSafety
                | RobotMode::Booting
                | RobotMode::PowerOff
                | RobotMode::PowerOn
                | RobotMode::Backdrive
                | RobotMode::UpdatingFirmware
                | RobotMode::Unknown(_) => false,
            },
            ArmGoal::Running => state.robot_mode == RobotMode::Running,
            ArmGoal::Unlocked => state.safety_mode.allows_motion(),
        }
    }
}

/// Payload and TCP as given to the running program.
#[derive(Default, Deserialize, Serialize)]
pub struct Setup {
    pub payload: Option<(f64, [f64; 3])>,
    pub tcp: Option<[f64; 6]>,
    /// Set while a path waits for the controller to show them.
    pub deadline: Option<Timestamp>,
}

/// What was reported last, so that changes are.
#[derive(Default, Deserialize, Serialize)]
pub struct Reported {
    pub mode: Option<RobotMode>,
    pub safety: Option<SafetyMode>,
    pub paused: bool,
}
