//! Packages of RTDE as bytes, for mutants that change a command or a state on its way.

use std::ops::Range;

/// A command of celld: sequence number, opcode and options, six arguments, speed, acceleration, blend.
const COMMAND_BYTES: usize = 88;
/// Its fields.
pub const SEQUENCE: Range<usize> = 4..8;
pub const OPCODE: Range<usize> = 8..12;
pub const OPTIONS: Range<usize> = 12..16;
pub const SPEED: Range<usize> = 64..72;
pub const ACCELERATION: Range<usize> = 72..80;
pub const BLEND: Range<usize> = 80..88;

/// The opcodes of `movej`, `movel` and stop.
pub const MOVE_JOINT: i32 = 1;
pub const MOVE_LINEAR: i32 = 2;
pub const STOP: i32 = 5;

/// A sign of life of celld, by the number of its recipe: the mark of who writes is as long.
const HEARTBEAT_BYTES: usize = 8;
const HEARTBEAT_RECIPE: u8 = 1;

/// A state of the robot, and its fields.
const STATE_BYTES: usize = 292;
pub const TIME: Range<usize> = 4..12;
pub const ROBOT_MODE: Range<usize> = 204..208;
pub const STATUS_BITS: Range<usize> = 216..220;
pub const NONCE: Range<usize> = 268..272;

/// The argument of a command with this number, from 0.
pub fn argument(number: usize) -> Range<usize> {
    16 + 8 * number..24 + 8 * number
}

pub fn integer(package: &[u8], at: Range<usize>) -> i32 {
    i32::from_be_bytes(package[at].try_into().expect("the drill runs"))
}

pub fn double(package: &[u8], at: Range<usize>) -> f64 {
    f64::from_be_bytes(package[at].try_into().expect("the drill runs"))
}

pub fn set_integer(package: &mut [u8], at: Range<usize>, value: i32) {
    package[at].copy_from_slice(&value.to_be_bytes());
}

pub fn set_double(package: &mut [u8], at: Range<usize>, value: f64) {
    package[at].copy_from_slice(&value.to_be_bytes());
}

/// Each package; the network of these cells splits none.
fn packages(bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut rest = bytes;
    let mut found = Vec::new();
    while let [high, low, ..] = *rest {
        let length = usize::from(u16::from_be_bytes([high, low])).clamp(3, rest.len());
        found.push(rest[..length].to_vec());
        rest = &rest[length..];
    }
    found
}

fn of_length(bytes: &[u8], length: usize, mut change: impl FnMut(&mut [u8]) -> bool) -> Vec<u8> {
    let mut kept = Vec::new();
    for mut package in packages(bytes) {
        let wanted = package.len() == length && package[2] == b'U';
        if !wanted || change(&mut package) {
            kept.extend(package);
        }
    }
    kept
}

/// The bytes with each command changed, without those for which `change` is false.
pub fn commands(bytes: &[u8], change: impl FnMut(&mut [u8]) -> bool) -> Vec<u8> {
    of_length(bytes, COMMAND_BYTES, change)
}

/// The same with celld's signs of life.
pub fn heartbeats(bytes: &[u8], mut change: impl FnMut(&mut [u8]) -> bool) -> Vec<u8> {
    of_length(bytes, HEARTBEAT_BYTES, |package| package[3] != HEARTBEAT_RECIPE || change(package))
}

/// The same with states of the robot.
pub fn states(bytes: &[u8], change: impl FnMut(&mut [u8]) -> bool) -> Vec<u8> {
    of_length(bytes, STATE_BYTES, change)
}
