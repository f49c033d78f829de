//! Primary interface session: program text out, kinematics and messages in.
//!
//! In: bytes of TCP 30001, program text, the time. Out: bytes and [`PrimaryEvent`]s. There is no answer to
//! an upload; its success shows in key messages, runtime exceptions, and (what counts) the nonce over RTDE.

use crate::device::outbox::Outbox;
use cell_values::time::{Duration, Timestamp};
use serde::{Deserialize, Serialize};
use ur_wire::primary::{Package, Splitter};
use ur_wire::primary_arm::KinematicsData;
use ur_wire::primary_message::{MessageBody, PROGRAM_STARTED, PROGRAM_STOPPED, READ_ONLY};
use ur_wire::primary_state::SubPackage;

/// Robot state comes at 10 Hz; this long without a package and the link is dead.
const SILENT_AFTER: Duration = Duration::from_millis(2500);
/// The first package (the version message) may take longer.
const FIRST_WITHIN: Duration = Duration::from_secs(10);
/// Sub-package of the robot state that begins with the checksum of the safety configuration. The client
/// interface guide reserves it; its first word is known from the maker's forum (thread 988). It is sent only
/// where safety settings are applied, so its absence means nothing.
const SAFETY_DATA: u8 = 10;
/// No length (m) or angle (rad) of a calibrated arm is larger. Shoulder and elbow turn about nearly parallel
/// axes: their calibrated offsets are hundreds of metres that cancel each other.
const KINEMATICS_MAX: f64 = 1e6;
/// Error codes below are for developers.
const WARNING: i32 = 2;
/// Error codes from here on are developer variants of lower ones.
const DEVELOPER: i32 = 128;

/// What the session reports.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub enum PrimaryEvent {
    /// The calibrated arm, once per connection.
    Kinematics(Box<KinematicsData>),
    /// The checksum of the safety configuration, once per connection and whenever it changes.
    SafetyChecksum(u32),
    /// A program of this name started.
    ProgramStarted(String),
    /// A program of this name ended.
    ProgramStopped(String),
    /// A program failed.
    RuntimeException {
        /// From 1.
        line: i32,
        /// From 1.
        column: i32,
        /// The controller's words.
        text: String,
    },
    /// Program text was refused because the pendant was in local mode when the link was made.
    ReadOnly,
    /// An error code at warning level or above.
    ErrorCode {
        /// Code.
        code: i32,
        /// Argument.
        argument: i32,
        /// 2 warning, 3 violation, 4 fault, 5 critical.
        level: i32,
        /// Text.
        text: String,
    },
    /// A program's `textmsg`.
    Message(String),
    /// The link is dropped because of this.
    Fault(String),
    /// The link is dropped because nothing came for this long.
    Silent(String),
}

#[derive(Deserialize, Serialize)]
enum Step {
    Down,
    First { deadline: Timestamp },
    Streaming { last_package: Timestamp },
}

/// The session. See the module.
#[derive(Deserialize, Serialize)]
pub struct PrimarySession {
    step: Step,
    splitter: Splitter,
    kinematics_seen: bool,
    safety_checksum: Option<u32>,
    outbox: Outbox<PrimaryEvent>,
}

impl Default for PrimarySession {
    fn default() -> PrimarySession {
        PrimarySession {
            step: Step::Down,
            splitter: Splitter::default(),
            kinematics_seen: false,
            safety_checksum: None,
            outbox: Outbox::default(),
        }
    }
}

impl PrimarySession {
    /// The TCP connection is established.
    pub fn connected(&mut self, now: Timestamp) {
        self.outbox.reset_link();
        self.splitter = Splitter::default();
        self.kinematics_seen = false;
        self.safety_checksum = None;
        self.step = Step::First { deadline: now + FIRST_WITHIN };
    }

    /// The TCP connection is gone.
    pub fn disconnected(&mut self) {
        self.step = Step::Down;
        self.outbox.reset_link();
    }

    /// True once the controller has sent something.
    pub fn ready(&self) -> bool {
        matches!(self.step, Step::Streaming { .. })
    }

    /// Sends a program; false if the link is not ready.
    #[must_use]
    pub fn upload(&mut self, program: &str) -> bool {
        if self.ready() {
            self.outbox.send(program.as_bytes().to_vec());
        }
        self.ready()
    }

    /// Bytes arrived.
    pub fn received(&mut self, now: Timestamp, bytes: &[u8]) {
        self.splitter.push(bytes);
        while !matches!(self.step, Step::Down) {
            match self.splitter.next_package() {
                Ok(Some(package)) => {
                    self.step = Step::Streaming { last_package: now };
                    self.package(package);
                }
                Ok(None) => return,
                Err(error) => self.fault(error.to_string()),
            }
        }
    }

    /// Time went by.
    pub fn tick(&mut self, now: Timestamp) {
        match self.step {
            Step::First { deadline } if now >= deadline => self.silent("no package within 10 s".into()),
            Step::Streaming { last_package } if now.since(last_package) >= SILENT_AFTER => {
                self.silent("no package for 2.5 s".into());
            }
            Step::Down | Step::First { .. } | Step::Streaming { .. } => {}
        }
    }

    /// When to call [`PrimarySession::tick`] next, and why.
    pub fn poll_timeout(&self) -> Option<(Timestamp, &'static str)> {
        match self.step {
            Step::Down => None,
            Step::First { deadline } => Some((deadline, "primary interface version")),
            Step::Streaming { last_package } => {
                Some((last_package + SILENT_AFTER, "primary interface silence"))
            }
        }
    }

    /// Bytes to send.
    pub fn poll_transmit(&mut self) -> Option<Vec<u8>> {
        self.outbox.poll_transmit()
    }

    /// What happened.
    pub fn poll_event(&mut self) -> Option<PrimaryEvent> {
        self.outbox.poll_event()
    }

    /// True once if the link should be dropped.
    pub fn poll_close(&mut self) -> bool {
        self.outbox.poll_close()
    }

    fn fault(&mut self, detail: String) {
        self.drop_link(PrimaryEvent::Fault(detail));
    }

    fn silent(&mut self, detail: String) {
        self.drop_link(PrimaryEvent::Silent(detail));
    }

    fn drop_link(&mut self, event: PrimaryEvent) {
        self.step = Step::Down;
        self.outbox.report(event);
        self.outbox.close();
    }

    fn package(&mut self, package: Package) {
        match package {
            Package::RobotState(parts) => {
                for part in parts {
                    match part {
                        SubPackage::Kinematics(data) => self.kinematics(data),
                        SubPackage::Other { kind: SAFETY_DATA, payload } => self.safety_data(&payload),
                        _ => {}
                    }
                }
            }
            Package::Message(message) => self.message(message.body),
            Package::Other { .. } => {}
        }
    }

    fn kinematics(&mut self, data: KinematicsData) {
        if self.kinematics_seen {
            return;
        }
        let numbers = [data.theta, data.a, data.d, data.alpha];
        let possible = |value: &f64| value.is_finite() && value.abs() <= KINEMATICS_MAX;
        if let Some(wrong) = numbers.as_flattened().iter().find(|value| !possible(value)) {
            return self.fault(format!("the arm's kinematics hold an impossible number: {wrong:e}"));
        }
        self.kinematics_seen = true;
        self.outbox.report(PrimaryEvent::Kinematics(Box::new(data)));
    }

    fn safety_data(&mut self, payload: &[u8]) {
        let Some(&word) = payload.first_chunk() else { return };
        let checksum = u32::from_be_bytes(word);
        if self.safety_checksum.replace(checksum) != Some(checksum) {
            self.outbox.report(PrimaryEvent::SafetyChecksum(checksum));
        }
    }

    fn message(&mut self, body: MessageBody) {
        let event = match body {
            MessageBody::Key { title, text, .. } if title == PROGRAM_STARTED => {
                PrimaryEvent::ProgramStarted(text)
            }
            MessageBody::Key { title, text, .. } if title == PROGRAM_STOPPED => {
                PrimaryEvent::ProgramStopped(text)
            }
            MessageBody::RuntimeException { line, column, text } => {
                PrimaryEvent::RuntimeException { line, column, text }
            }
            MessageBody::Error { code: READ_ONLY, .. } => PrimaryEvent::ReadOnly,
            MessageBody::Error { code, argument, level, text, .. }
                if (WARNING..DEVELOPER).contains(&level) =>
            {
                PrimaryEvent::ErrorCode { code, argument, level, text }
            }
            MessageBody::Text(text) => PrimaryEvent::Message(text),
            // Other keys, lower levels and the safety mode (which RTDE shows sooner) need no reaction.
            MessageBody::Key { .. }
            | MessageBody::Error { .. }
            | MessageBody::SafetyMode { .. }
            | MessageBody::Version { .. }
            | MessageBody::Popup { .. }
            | MessageBody::RequestValue { .. }
            | MessageBody::Other { .. } => return,
        };
        self.outbox.report(event);
    }
}
