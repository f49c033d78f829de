//! What goes in and out of the gripper session: channels, parameters, commands, events, Modbus requests.
//!
//! Plain data, so that the supervisor, the sockets and tests can write them down. Vacuum is relative, as a
//! fraction (0 ambient, 0.6 = 60 %). Registers (hardware/gripper/README.md): 0, 1 control of channel A, B;
//! 258, 259 their vacuum in per mille.

use cell_values::time::Duration;
use serde::{Deserialize, Serialize};
use std::fmt;

/// First control register, channel A; B follows.
pub const CONTROL: u16 = 0;
/// First vacuum register, channel A; B follows. Per mille.
pub const VACUUM: u16 = 258;
/// Product code (Connectivity Guide).
pub const PRODUCT: u16 = 1536;
/// Firmware, two registers.
pub const FIRMWARE: u16 = 1540;
/// Serial number, 16 registers.
pub const SERIAL: u16 = 1545;
/// Registers of the serial number.
pub const SERIAL_COUNT: u16 = 16;
/// Product code of a VGC10.
pub const VGC10: u16 = 0x11;
/// Product code of a VG10, which has the same registers.
pub const VG10: u16 = 0x10;
/// Modbus unit of a single or primary tool.
pub const UNIT: u8 = 65;
/// Highest vacuum that may be requested.
pub const MAX_TARGET: f64 = 0.8;

/// What the device says of itself (Connectivity Guide): which product it is, not on which arm it hangs.
/// `None` where a register is missing or was silent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
pub struct Identity {
    /// Product code.
    pub product: Option<u16>,
    /// Firmware, as it stands in its two registers.
    pub firmware: Option<[u16; 2]>,
    /// Serial number, as it stands in its registers.
    pub serial: Option<[u16; SERIAL_COUNT as usize]>,
}

impl Identity {
    /// The serial number as text where its bytes are one, else in hexadecimal; `None` where it has none. How
    /// the device lays it out is not published.
    pub fn serial_text(&self) -> Option<String> {
        let words = self.serial.filter(|words| words.iter().any(|word| *word != 0))?;
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_be_bytes()).filter(|b| *b != 0).collect();
        if bytes.iter().all(u8::is_ascii_graphic) {
            return Some(bytes.iter().copied().map(char::from).collect());
        }
        Some(words.iter().map(|word| format!("{word:04x}")).collect())
    }
}

/// Why there is no vacuum reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, thiserror::Error, Deserialize, Serialize)]
pub enum GripperFault {
    /// Nothing comes, or no more than that is known.
    #[default]
    #[error("the gripper does not answer")]
    Silent,
    /// See [`ModbusFailure::Taken`].
    #[error("another client holds the gripper's connection")]
    Taken,
    /// See [`ModbusFailure::Refused`].
    #[error("the gripper refuses the connection")]
    Refused,
    /// See [`ModbusFailure::Unserved`].
    #[error("the gripper's box accepts the connection but does not answer")]
    Unserved,
    /// It answers, and has no registers 258 and 259.
    #[error("the gripper has no registers for the vacuum (258, 259)")]
    NoVacuum,
}

/// Modbus exception of a register that is not there.
pub const NO_SUCH_REGISTER: u8 = 2;

impl From<&ModbusFailure> for GripperFault {
    fn from(failure: &ModbusFailure) -> GripperFault {
        match failure {
            ModbusFailure::Taken => GripperFault::Taken,
            ModbusFailure::Refused => GripperFault::Refused,
            ModbusFailure::Unserved => GripperFault::Unserved,
            ModbusFailure::Exception(NO_SUCH_REGISTER) => GripperFault::NoVacuum,
            ModbusFailure::Timeout
            | ModbusFailure::Exception(_)
            | ModbusFailure::Connection(_)
            | ModbusFailure::Malformed(_) => GripperFault::Silent,
        }
    }
}

/// Which channels; at least one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum Channels {
    /// A.
    A,
    /// B.
    B,
    /// Both, acting at once.
    Both,
}

impl Channels {
    /// For sentences.
    pub fn as_str(self) -> &'static str {
        match self {
            Channels::A => "channel A",
            Channels::B => "channel B",
            Channels::Both => "both channels",
        }
    }

    /// These and the others.
    pub(super) fn and(self, other: Channels) -> Channels {
        if self == other { self } else { Channels::Both }
    }

    /// What is left of these without the others.
    pub(super) fn without(self, other: Channels) -> Option<Channels> {
        match (self, other) {
            (Channels::Both, Channels::A) => Some(Channels::B),
            (Channels::Both, Channels::B) => Some(Channels::A),
            (Channels::A, Channels::B) | (Channels::B, Channels::A) => Some(self),
            (_, Channels::Both) | (Channels::A, Channels::A) | (Channels::B, Channels::B) => None,
        }
    }

    pub(super) fn first_register(self) -> u16 {
        match self {
            Channels::A | Channels::Both => CONTROL,
            Channels::B => CONTROL + 1,
        }
    }

    pub(super) fn count(self) -> usize {
        if self == Channels::Both { 2 } else { 1 }
    }

    /// The lowest vacuum of these channels: a grip is as good as its worst cup.
    pub(super) fn lowest(self, vacuum: [f64; 2]) -> f64 {
        match self {
            Channels::A => vacuum[0],
            Channels::B => vacuum[1],
            Channels::Both => vacuum[0].min(vacuum[1]),
        }
    }

    pub(super) fn highest(self, vacuum: [f64; 2]) -> f64 {
        match self {
            Channels::A => vacuum[0],
            Channels::B => vacuum[1],
            Channels::Both => vacuum[0].max(vacuum[1]),
        }
    }
}

impl fmt::Display for Channels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// What the session needs to know; measured or decided for the cell, so nothing has a default.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct GripperParameters {
    /// Vacuum from which on an object counts as gripped, fraction.
    pub vacuum_min: f64,
    /// Vacuum below which a held object counts as lost, fraction; a little below `vacuum_min`.
    pub vacuum_hold: f64,
    /// Time for reaching `vacuum_min`.
    pub grip_within: Duration,
    /// Time for letting the air in.
    pub release_within: Duration,
}

/// What may be requested.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub enum GripperCommand {
    /// Pump on, up to `target` (fraction, at most 0.8).
    Grip {
        /// Which channels.
        channels: Channels,
        /// Vacuum to keep.
        target: f64,
    },
    /// Vents open. The requester makes sure that the object is placed, or that a person wants it.
    Release {
        /// Which channels.
        channels: Channels,
    },
    /// Pump off, vents shut, both channels; refused while something is or may be held.
    Idle,
}

/// Why a command was not taken.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum GripperRefused {
    /// Vacuum outside what the device can do.
    #[error("vacuum target {0} is outside 0.05 to 0.8")]
    Target(f64),
    /// Something is or may be held.
    #[error("the gripper holds, or is about to")]
    Holding,
    /// Commands wait for a gripper that does not answer.
    #[error("{0} commands are waiting already")]
    QueueFull(usize),
}

/// A request to be sent; exactly one answer is expected, an error if none comes.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum ModbusRequest {
    /// Read holding registers (function 3).
    Read {
        /// First register.
        address: u16,
        /// How many.
        count: u16,
    },
    /// Write registers (function 16).
    Write {
        /// First register.
        address: u16,
        /// Their values.
        values: Vec<u16>,
    },
}

/// Why a request got no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Deserialize, Serialize)]
pub enum ModbusFailure {
    /// Nothing came.
    #[error("no answer in time")]
    Timeout,
    /// The device said no.
    #[error("Modbus exception {0}")]
    Exception(u8),
    /// The connection is gone or was never there.
    #[error("connection: {0}")]
    Connection(String),
    /// The device ends connections before it answers: it serves one client.
    #[error("another client holds the gripper's connection")]
    Taken,
    /// Nobody accepts connections at the address.
    #[error("the gripper's box refuses the connection: another client may have the only one it serves")]
    Refused,
    /// A connection was made, and nothing has come on it: another client may be served before ours.
    #[error("the connection was accepted, but no answer came")]
    Unserved,
    /// An answer that is none.
    #[error("malformed answer: {0}")]
    Malformed(String),
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub enum GripperEvent {
    /// The object is held.
    Gripped {
        /// Lowest vacuum of the channels used.
        vacuum: f64,
    },
    /// The vacuum did not come, or the command did not get through; the pump may still be on.
    GripFailed {
        /// Lowest vacuum of the channels used; NaN never, 0 if there was no reading.
        vacuum: f64,
    },
    /// The air is in.
    Released,
    /// The air did not get in, or the command did not get through; the object may still hang there.
    ReleaseFailed {
        /// Highest vacuum of the channels released.
        vacuum: f64,
    },
    /// What is held is still held, and the vacuum falls. Reported once.
    VacuumWeak {
        /// Lowest vacuum of the channels used.
        vacuum: f64,
        /// The highest it was.
        best: f64,
    },
    /// What was held is held no more. Reported once.
    VacuumLost {
        /// Lowest vacuum of the channels used.
        vacuum: f64,
    },
    /// No answer three times in a row. Reported once until it answers again.
    Unreachable {
        /// Failures in a row.
        failures: u32,
        /// The last one.
        cause: ModbusFailure,
    },
    /// It answers: the first time, or again.
    Answering,
    /// A command was not taken; nothing of it reaches the device.
    Refused,
    /// A reading of both channels, A and B, as fractions.
    Reading {
        /// Vacuum of A and B.
        vacuum: [f64; 2],
    },
}
