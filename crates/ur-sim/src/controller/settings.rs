//! What scripts set and read back, and little else depends on: flags, port memory, Modbus signals, encoders.
//!
//! In and out: the functions of `setting_functions`. Bounded: names and addresses are checked there.

use crate::controller::encoders::Encoder;
use std::collections::HashMap;

/// Flags of a program.
pub const FLAGS: usize = 33;

/// Modbus signals a program may add.
pub const MAX_SIGNALS: usize = 256;

/// How the serial line of the tool is set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolLine {
    /// Bits a second.
    pub baud: i32,
    /// 0 none, 1 odd, 2 even.
    pub parity: i32,
    /// 1 or 2.
    pub stop_bits: i32,
    /// Idle characters before it receives and before it sends.
    pub idle_chars: [f64; 2],
}

/// All of it.
#[derive(Clone, Debug)]
pub struct Settings {
    /// `set_flag`.
    pub flags: [bool; FLAGS],
    /// General purpose registers of the Modbus map that were written, by address.
    pub port_registers: HashMap<u16, i32>,
    /// Time since the start when it was last requested: ms, s, min, h, days.
    pub split_time: [u16; 5],
    /// The serial line of the tool; absent: it is not enabled.
    pub tool_line: Option<ToolLine>,
    /// Values of Modbus signals, by name.
    pub signals: HashMap<String, i32>,
    /// The two encoders.
    pub encoders: [Encoder; 2],
    /// Range of the first one that `set_conveyor_tick_count` has set.
    pub conveyor_range: Option<i32>,
    /// Acceleration of the base, m/s2 in the base frame: the joint moments feel it.
    pub base_acceleration: [f64; 3],
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            flags: [false; FLAGS],
            port_registers: HashMap::new(),
            split_time: [0; 5],
            tool_line: None,
            signals: HashMap::new(),
            encoders: Default::default(),
            conveyor_range: None,
            base_acceleration: [0.0; 3],
        }
    }
}
