//! What goes in and out of the robot session: parameters, state, commands, events, refusals.
//!
//! Plain data, so that the supervisor and tests can write them down. Joints in rad, base to wrist 3; poses
//! are those of the controller (base frame, m and rotation vector).

use crate::device::program::{Nonce, PROGRAM_TEXT, WATCHDOG_FRAMES};
use crate::device::registers::ProgramStatus;
use cell_motion::path::CheckedPath;
use cell_values::time::{Duration, Timestamp};
use cell_values::units::Joints;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use ur_arm::kinematics::DhParameters;
use ur_wire::enumerations::{RobotMode, RuntimeState, SafetyMode};

/// The three connections to a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize, Serialize)]
pub enum Link {
    /// TCP 30004: state out, registers in.
    Rtde,
    /// TCP 29999: power, brakes, stop, questions.
    Dashboard,
    /// TCP 30001: kinematics and messages out, program text in.
    Primary,
}

impl Link {
    /// All of them.
    pub const ALL: [Link; 3] = [Link::Rtde, Link::Dashboard, Link::Primary];

    /// The controller's port.
    pub fn port(self) -> u16 {
        match self {
            Link::Rtde => 30004,
            Link::Dashboard => 29999,
            Link::Primary => 30001,
        }
    }
}

impl std::fmt::Display for Link {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Link::Rtde => "RTDE",
            Link::Dashboard => "dashboard",
            Link::Primary => "primary interface",
        })
    }
}

/// What a controller says of itself over the dashboard.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct RobotIdentity {
    /// Model, without the "e".
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// Software version.
    pub version: String,
}

impl std::fmt::Display for RobotIdentity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {} with {}", self.model, self.serial, self.version)
    }
}

/// What was known when the cell was commissioned.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
pub struct KnownRobot {
    /// Who it is.
    pub identity: Option<RobotIdentity>,
    /// Checksum of its safety configuration; a controller that does not send one is not compared.
    pub safety_checksum: Option<u32>,
}

/// What the session needs to know beforehand.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotParameters {
    /// Template of the on-robot program, normally [`PROGRAM_TEXT`].
    pub program_text: String,
    /// Controller frames without a heartbeat before the program stops the arm.
    pub watchdog_frames: u32,
    /// Packages per second from the controller: 500, or 125 where the PC or the network is slow.
    pub frequency_hz: f64,
    /// The number of this process, for another celld that finds the robot taken.
    pub process: u32,
}

impl RobotParameters {
    /// celld's own program at the controller's full rate.
    pub fn full_rate() -> RobotParameters {
        let program_text = PROGRAM_TEXT.to_string();
        RobotParameters { program_text, watchdog_frames: WATCHDOG_FRAMES, frequency_hz: 500.0, process: 1 }
    }
}

/// RTDE inputs that celld needs and another client of the controller holds.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct InputsTaken {
    /// Exact names.
    pub names: Vec<String>,
    /// The process of the celld whose mark in the registers changes.
    pub celld: Option<u32>,
}

impl std::fmt::Display for InputsTaken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let names = self.names.join(", ");
        match self.celld {
            Some(process) => write!(
                f,
                "another celld drives this robot (process {process} of its computer) and holds {names}"
            ),
            None => write!(
                f,
                "another client of the controller holds {names}: probably EtherNet/IP or PROFINET, the \
                 OnRobot URCap, or another RTDE client"
            ),
        }
    }
}

/// Age of a robot's state after which it must not start a motion, in real time.
pub const STALE_AFTER: Duration = Duration::from_millis(100);

/// The robot as the last package showed it.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct RobotState {
    /// When the package arrived. Stays if the controller's own time does not advance.
    pub received: Timestamp,
    /// Controller time, s since it started.
    pub controller_time_s: f64,
    /// Joint positions, rad.
    pub q: Joints,
    /// Joint speeds, rad/s.
    pub qd: [f64; 6],
    /// TCP pose.
    pub tcp_pose: [f64; 6],
    /// How far the arm is powered up.
    pub robot_mode: RobotMode,
    /// What the safety system allows.
    pub safety_mode: SafetyMode,
    /// What the controller does with its program.
    pub runtime_state: RuntimeState,
    /// The freedrive button is pressed: a person guides the arm by hand.
    pub guided: bool,
    /// Momentary scaling by the trajectory limiter, 0 to 1.
    pub speed_scaling: f64,
    /// Speed slider, 0 to 1.
    pub target_speed_fraction: f64,
    /// Payload set, kg.
    pub payload: f64,
    /// Its centre of gravity in the flange frame, m.
    pub payload_cog: [f64; 3],
    /// TCP set, in the flange frame.
    pub tcp_offset: [f64; 6],
    /// Nonce register.
    pub nonce: i32,
    /// Number of the last command taken.
    pub accepted: i32,
    /// Number of the last command carried out.
    pub finished: i32,
    /// Status register.
    pub program_status: ProgramStatus,
    /// Heartbeat register as the program last saw it.
    pub heartbeat_echo: i32,
    /// From the dashboard; `None` until it has answered.
    pub remote_control: Option<bool>,
}

impl RobotState {
    /// True if no joint moves faster than 0.01 rad/s (0.6 degrees per second).
    pub fn stands_still(&self) -> bool {
        self.qd.iter().all(|speed| speed.abs() < 0.01)
    }

    /// How fast programs run, 0 to 1: slider times limiter; 0 while paused.
    pub fn speed_share(&self) -> f64 {
        match self.runtime_state {
            RuntimeState::Playing => (self.speed_scaling * self.target_speed_fraction).clamp(0.0, 1.0),
            RuntimeState::Stopping
            | RuntimeState::Stopped
            | RuntimeState::Pausing
            | RuntimeState::Paused
            | RuntimeState::Resuming
            | RuntimeState::Unknown(_) => 0.0,
        }
    }
}

/// What the supervisor may request.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub enum RobotCommand {
    /// Arm power on; done at once if it is on.
    PowerOn,
    /// Brakes off; done at once if they are.
    ReleaseBrakes,
    /// Stop whatever runs, then upload and start the program.
    StartProgram {
        /// Fresh for every start.
        nonce: Nonce,
    },
    /// Follow a path after everything sent before.
    Stream(CheckedPath),
    /// The same, where the next path is not known yet: it begins where this one ends, and where it is there
    /// before the last segment's turn, that one is left out. The next path has to be free from the corner
    /// before the last segment as well as from its end.
    SetOut(CheckedPath),
    /// Payload from here on in the stream.
    SetPayload {
        /// kg, everything beyond the flange.
        mass_kg: f64,
        /// In the flange frame, m.
        centre_of_gravity_m: [f64; 3],
    },
    /// TCP from here on in the stream, in the flange frame.
    SetTcp([f64; 6]),
    /// Stop the arm now and forget everything streamed. Always taken.
    Stop,
    /// End the program.
    EndProgram,
    /// On a person's order only.
    UnlockProtectiveStop,
    /// On a person's order only.
    CloseSafetyPopup,
}

impl RobotCommand {
    /// In a few words, for messages.
    pub fn name(&self) -> &'static str {
        match self {
            RobotCommand::PowerOn => "power on",
            RobotCommand::ReleaseBrakes => "brake release",
            RobotCommand::StartProgram { .. } => "starting the program",
            RobotCommand::Stream(_) | RobotCommand::SetOut(_) => "a path",
            RobotCommand::SetPayload { .. } => "the payload",
            RobotCommand::SetTcp(_) => "the TCP",
            RobotCommand::Stop => "stop",
            RobotCommand::EndProgram => "ending the program",
            RobotCommand::UnlockProtectiveStop => "unlocking the protective stop",
            RobotCommand::CloseSafetyPopup => "closing the popup",
        }
    }
}

/// Why a command was not taken.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refused {
    /// A link that the command needs is down.
    #[error("{0} is not connected")]
    NotConnected(Link),
    /// The state is older than 100 ms.
    #[error("the robot's state is stale")]
    Stale,
    /// The safety mode forbids motion.
    #[error("safety mode is {0}")]
    SafetyMode(SafetyMode),
    /// The arm is not RUNNING.
    #[error("robot mode is {0}, not RUNNING")]
    RobotMode(RobotMode),
    /// The pendant is in local mode, or the mode is unknown.
    #[error("remote control is off: switch the pendant to remote control")]
    LocalMode,
    /// The dashboard's last answer about remote control is too old to begin a path.
    #[error("the dashboard has not said for 1.5 s whether remote control is on")]
    RemoteControlUnknown,
    /// The program does not run, or not any more.
    #[error("celld's program does not run on the robot")]
    NoProgram,
    /// The program is being started, stopped or ended.
    #[error("the program is busy: {0}")]
    Busy(&'static str),
    /// The path does not begin where the arm is (or will be).
    #[error("the path begins {difference_rad:.4} rad away from where the arm is or will be")]
    WrongStart {
        /// Largest difference of a joint.
        difference_rad: f64,
    },
    /// A number that must not reach the robot.
    #[error("{what} is {value}")]
    BadNumber {
        /// Which.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// Too much is waiting.
    #[error("{0} commands are waiting already")]
    QueueFull(usize),
}

/// Why the program does not run any more. Every path not finished before is void.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Deserialize, Serialize)]
pub enum ProgramEnd {
    /// By [`RobotCommand::EndProgram`].
    #[error("ended as asked")]
    AsRequested,
    /// By [`RobotCommand::Stop`] or because of a safety stop.
    #[error("stopped by celld")]
    StoppedByUs,
    /// It did not show its nonce in time.
    #[error("did not start: {0}")]
    NotStarted(String),
    /// The program's watchdog stopped the arm.
    #[error("the robot missed celld's heartbeat and stopped")]
    HeartbeatLost,
    /// The program refused a command of ours.
    #[error("the robot refused command {sequence}")]
    Rejected {
        /// The command after the last one accepted.
        sequence: i32,
    },
    /// A runtime exception.
    #[error("runtime exception in line {line}, column {column}: {text}")]
    Exception {
        /// From 1.
        line: i32,
        /// From 1.
        column: i32,
        /// The controller's words.
        text: String,
    },
    /// From the pendant, a safety event, or another client.
    #[error("stopped from outside (pendant, safety system or another client)")]
    FromOutside,
    /// Another program wrote its nonce.
    #[error("another program took over")]
    Replaced,
    /// RTDE is gone; the program's watchdog stops the arm.
    #[error("the RTDE link was lost")]
    LinkLost,
    /// Something was not done within its deadline.
    #[error("{0}")]
    Overdue(String),
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub enum RobotEvent {
    /// RTDE streams and its state is good to use.
    RtdeReady,
    /// RTDE does not stream any more.
    RtdeLost,
    /// Who the controller says it is; once per dashboard connection.
    Identity {
        /// Serial number.
        serial: String,
        /// Model, without the "e".
        model: String,
        /// Software version.
        version: String,
    },
    /// The calibrated arm; once per primary connection.
    Kinematics {
        /// Calibrated parameters.
        dh: DhParameters,
        /// Six checksums that name the calibration.
        checksum: [u32; 6],
    },
    /// The checksum of the safety configuration; once per primary connection, where the controller sends it.
    SafetyChecksum {
        /// It.
        checksum: u32,
    },
    /// Remote control on or off; also the first answer.
    RemoteControl {
        /// On.
        on: bool,
    },
    /// The program runs and shows its nonce.
    ProgramRunning {
        /// Its nonce.
        nonce: Nonce,
    },
    /// The program does not run any more, or never did.
    ProgramEnded {
        /// Why.
        reason: ProgramEnd,
    },
    /// A segment has been followed (a blended one: its blend has begun), or was left out.
    SegmentFinished {
        /// Number of the path, see `Robot::last_batch`.
        batch: u32,
        /// Index of the segment in the path.
        index: usize,
    },
    /// The arm is at rest at the end of a path. Not reported of a way that went on in another.
    PathFinished {
        /// Number of the path.
        batch: u32,
    },
    /// The payload is set.
    PayloadSet,
    /// The TCP is set.
    TcpSet,
    /// The arm is at rest after a stop.
    Stopped,
    /// The program is held (pendant, safeguard); deadlines do not advance.
    Paused,
    /// The program goes on.
    Resumed,
    /// The safety mode changed; also the first one.
    Safety {
        /// New mode.
        mode: SafetyMode,
    },
    /// The robot mode changed; also the first one.
    Mode {
        /// New mode.
        mode: RobotMode,
    },
    /// Something a person requested is done.
    Completed {
        /// What was requested.
        what: Cow<'static, str>,
    },
    /// The controller did not do what was requested.
    Refused {
        /// What was requested.
        what: String,
        /// Its words.
        reply: String,
    },
    /// A register is taken by another client or a field bus; celld tries again a few times.
    InputInUse {
        /// Which, and by whom.
        taken: InputsTaken,
        /// Tries so far.
        attempt: u32,
    },
    /// A program failed (any program).
    RuntimeException {
        /// From 1.
        line: i32,
        /// From 1.
        column: i32,
        /// The controller's words.
        text: String,
    },
    /// An error code of the controller at warning level or above.
    ErrorCode {
        /// Code.
        code: i32,
        /// Argument.
        argument: i32,
        /// 2 warning, 3 violation, 4 fault, 5 critical.
        level: i32,
        /// Text, mostly empty.
        text: String,
    },
    /// A line of a program's `textmsg` or an RTDE text.
    Message {
        /// The text.
        text: String,
    },
    /// The peer fell silent; the link is dropped.
    LinkSilent {
        /// Which link.
        link: Link,
        /// What did not come.
        detail: String,
    },
    /// A segment is overdue although the program plays.
    ArmStalled {
        /// Which.
        detail: String,
    },
    /// A joint is where it cannot have turned to since the state before.
    JointJump {
        /// Which, and by how much.
        detail: String,
    },
    /// The peer broke the protocol. The link is dropped unless only a value is unknown.
    ProtocolFault {
        /// Which link.
        link: Link,
        /// What was wrong.
        detail: String,
        /// Faults within the last 60 s, this one included; three are reason to stop for good.
        recent: u32,
    },
}
