//! The controller's Modbus registers and coils, for its server (port 502) and for scripts' port functions.
//!
//! In: an address. Out: what it holds now, or what a write to it does. The map is the one that the maker
//! publishes: inputs and outputs (0 to 33), general purpose (128 to 255), robot state (256 to 266), joints
//! (270 to 325), tool pose, speed and offset (400 to 425), currents, tool, time since the start; coils for
//! inputs, outputs, robot state and the boolean registers that RTDE has too. Assumed: gaps below 512 read as
//! 0, further addresses do not exist; joint angles are those within one turn, with whole turns beside them;
//! clients write the boolean input registers and not the output ones.

use crate::controller::core::Core;
use std::f64::consts::TAU;
use ur_wire::enumerations::SafetyMode;

/// General purpose registers.
const GENERAL: std::ops::RangeInclusive<u16> = 128..=255;

/// Gaps of the map below this address read as 0.
const FIRST_UNKNOWN: u16 = 512;

/// Coils of the first input and output register.
const INPUT_REGISTERS: std::ops::RangeInclusive<u16> = 300..=427;
const OUTPUT_REGISTERS: std::ops::RangeInclusive<u16> = 500..=627;

/// Minutes, hours and days, in ms.
const MINUTE_MS: u64 = 60_000;
const HOUR_MS: u64 = 60 * MINUTE_MS;
const DAY_MS: u64 = 24 * HOUR_MS;

/// A number in two's complement, as far as it goes.
fn word(value: f64) -> u16 {
    (value.round().clamp(-32_768.0, 32_767.0) as i16).cast_unsigned()
}

/// Box outputs or inputs in bits 0 to 7, those of the tool in 8 and 9.
fn packed(bits: u64) -> u16 {
    (bits & 0xff | bits >> 8 & 0x300) as u16
}

fn unpacked(word: u16) -> u64 {
    u64::from(word & 0xff) | u64::from(word & 0x300) << 8
}

/// What a register holds; `None` for an address that does not exist.
pub fn read(core: &Core, address: u16) -> Option<u16> {
    let (modes, registers) = (&core.modes, &core.registers);
    let [major, minor, ..] = core.version();
    let joint = |first: u16| usize::from(address - first);
    Some(match address {
        0 => packed(registers.digital_inputs),
        1 => packed(registers.digital_outputs),
        16 | 18 => (registers.analog_outputs[joint(16) / 2] * 65_535.0).round() as u16,
        17 | 19 => u16::from(registers.analog_output_voltage[joint(17) / 2]),
        20 => registers.tool_voltage as u16,
        21 => (registers.digital_inputs >> 16 & 3) as u16,
        22 => (registers.digital_outputs >> 16 & 3) as u16,
        30 => (registers.digital_inputs >> 8 & 0xff) as u16,
        31 => (registers.digital_outputs >> 8 & 0xff) as u16,
        _ if GENERAL.contains(&address) => {
            core.settings.port_registers.get(&address).map_or(0, |v| *v as u16)
        }
        256 => major as u16,
        257 => minor as u16,
        258 => modes.robot_mode().code() as u16,
        260..=265 => u16::from(state(core, address)),
        266 => modes.safety_mode().code() as u16,
        270..=275 => word(core.actual_q().0[joint(270)].rem_euclid(TAU) * 1e3),
        280..=285 => word(core.actual_qd()[joint(280)] * 1e3),
        290..=295 => word(core.joint_currents()[joint(290)] * 1e3),
        300..=305 => 35,
        310..=315 => modes.joint_mode() as u16,
        320..=325 => word(core.actual_q().0[joint(320)].div_euclid(TAU)),
        400..=402 => word(core.tcp_pose()[joint(400)] * 1e4),
        403..=405 => word(core.tcp_pose()[joint(400)] * 1e3),
        410..=415 => word(core.mover.tcp_speed()[joint(410)] * 1e3),
        420..=425 => word(core.tcp_offset[joint(420)] * 1e3),
        450 => 600,
        768 => 253,
        769 => 35,
        770 => 0,
        2048 => 0,
        2049..=2053 => core.settings.split_time[joint(2049)],
        _ if address < FIRST_UNKNOWN => 0,
        _ => return None,
    })
}

/// A write to this register does something.
pub fn writable(address: u16) -> bool {
    matches!(address, 1..=3 | 16..=20 | 22 | 31..=33 | 2048) || GENERAL.contains(&address)
}

/// Writes a register; false if it is not [`writable`].
pub fn write(core: &mut Core, address: u16, value: u16) -> bool {
    if !writable(address) {
        return false;
    }
    let now_ms = (core.timestamp() * 1e3) as u64;
    let registers = &mut core.registers;
    let outputs = &mut registers.digital_outputs;
    let part = |bits: u64, mask: u64, value: u64| bits & !mask | value & mask;
    match address {
        1 => *outputs = part(*outputs, unpacked(0x3ff), unpacked(value)),
        2 => *outputs |= unpacked(value),
        3 => *outputs &= !unpacked(value),
        16 | 18 => registers.analog_outputs[usize::from(address - 16) / 2] = f64::from(value) / 65_535.0,
        17 | 19 => registers.analog_output_voltage[usize::from(address - 17) / 2] = value != 0,
        20 if matches!(value, 0 | 12 | 24) => registers.tool_voltage = i32::from(value),
        22 => *outputs = part(*outputs, 3 << 16, u64::from(value) << 16),
        31 => *outputs = part(*outputs, 0xff << 8, u64::from(value) << 8),
        32 => *outputs |= u64::from(value & 0xff) << 8,
        33 => *outputs &= !(u64::from(value & 0xff) << 8),
        2048 => {
            let parts = [now_ms % 1000, now_ms / 1000 % 60, now_ms / MINUTE_MS % 60, now_ms / HOUR_MS % 24];
            let [ms, s, min, h] = parts.map(|part| part as u16);
            core.settings.split_time = [ms, s, min, h, (now_ms / DAY_MS) as u16];
        }
        _ if GENERAL.contains(&address) => {
            core.settings.port_registers.insert(address, i32::from(value.cast_signed()));
        }
        _ => {}
    }
    true
}

/// What a coil holds; `None` for one that does not exist.
pub fn read_coil(core: &Core, address: u16) -> Option<bool> {
    let bit = |register: u16, number: u16| read(core, register).map(|word| word >> number & 1 == 1);
    match address {
        0..=15 => bit(0, address),
        16..=31 => bit(1, address - 16),
        128..=135 => bit(30, address - 128),
        136..=143 => bit(31, address - 136),
        260..=265 => Some(state(core, address)),
        32..=127 | 144..=159 => Some(false),
        _ if INPUT_REGISTERS.contains(&address) => {
            Some(core.registers.input_bits[usize::from(address) - 300])
        }
        _ if OUTPUT_REGISTERS.contains(&address) => {
            Some(core.registers.output_bits[usize::from(address) - 500])
        }
        _ => None,
    }
}

/// A write to this coil does something.
pub fn writable_coil(address: u16) -> bool {
    matches!(address, 16..=63 | 136..=159) || INPUT_REGISTERS.contains(&address)
}

/// Writes a coil; false if it is not [`writable_coil`].
pub fn write_coil(core: &mut Core, address: u16, on: bool) -> bool {
    // To the registers that set and clear bits.
    let (register, number) = match (address, on) {
        (16..=31, true) => (2, address - 16),
        (16..=31, false) => (3, address - 16),
        (32..=47, true) => (2, address - 32),
        (48..=63, true) => (3, address - 48),
        (136..=143, true) => (32, address - 136),
        (136..=143, false) => (33, address - 136),
        (144..=151, true) => (32, address - 144),
        (152..=159, true) => (33, address - 152),
        (32..=63 | 144..=159, false) => return true,
        _ if INPUT_REGISTERS.contains(&address) => {
            core.registers.input_bits[usize::from(address) - 300] = on;
            return true;
        }
        _ => return false,
    };
    write(core, register, 1 << number)
}

/// Registers and coils 260 to 265, which hold the same.
fn state(core: &Core, address: u16) -> bool {
    let modes = &core.modes;
    match address {
        260 => modes.powered(),
        261 => modes.protective_stopped(),
        262 => modes.emergency_stopped(),
        263 => core.pendant.freedrive,
        265 => !matches!(modes.safety_mode(), SafetyMode::Normal | SafetyMode::Reduced),
        _ => false,
    }
}
