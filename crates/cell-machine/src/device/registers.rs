//! Which RTDE register means what between celld and its program on the robot.
//!
//! In: a command. Out: the values of the input registers in recipe order. All registers are 24 and up, as
//! lower ones belong to field buses. The table for people is in hardware/ur5e/README.md; a test holds the
//! two together, and the program's text is held to them by the simulator, which runs it.

use serde::{Deserialize, Serialize};
use ur_wire::rtde_values::Value;
use ur_wire::rtde_variables::Register;

/// In int: number of the command; a new number makes the program look at the others.
pub const SEQUENCE: u8 = 24;
/// In int: what to do.
pub const OPCODE: u8 = 25;
/// In int: bit 0 = no segment follows, bit 1 = to a waiting place.
pub const OPTIONS: u8 = 26;
/// In int: changes at least every 20 ms while celld lives.
pub const HEARTBEAT: u8 = 27;
/// In int: the process that writes the others, see [`mark_of`].
pub const OWNER: u8 = 28;
/// In double: first of six arguments.
pub const ARGUMENTS: u8 = 24;
/// In double: speed, rad/s or m/s.
pub const SPEED: u8 = 30;
/// In double: acceleration, rad/s2 or m/s2.
pub const ACCELERATION: u8 = 31;
/// In double: blend radius, m.
pub const BLEND: u8 = 32;

/// Out int: the number baked into the running program's text.
pub const NONCE: u8 = 24;
/// Out int: number of the last command taken.
pub const ACCEPTED: u8 = 25;
/// Out int: number of the last command carried out.
pub const FINISHED: u8 = 26;
/// Out int: see [`ProgramStatus`].
pub const STATUS: u8 = 27;
/// Out int: last heartbeat seen.
pub const HEARTBEAT_ECHO: u8 = 28;

/// Commands the on-robot program holds besides the one it is carrying out.
pub const QUEUE_DEPTH: i32 = 8;

/// What distinguishes the mark of a celld from any number of another client.
const SIGNATURE: i32 = 0x4C << 24;
const TURN: i32 = 1 << 23;
const PROCESS_BITS: i32 = TURN - 1;

/// The mark of a celld in [`OWNER`]: a signature, a bit that changes while it is connected, and the number
/// of its process (Linux gives no more than 22 bits).
pub fn mark_of(process: u32, turn: bool) -> i32 {
    SIGNATURE | if turn { TURN } else { 0 } | (process.cast_signed() & PROCESS_BITS)
}

/// The process of the celld whose marks these are, one after the other; `None` for any other numbers, and
/// for a mark that does not change: who left it is gone.
pub fn process_of(before: i32, now: i32) -> Option<u32> {
    let signed = |mark: i32| mark & !(PROCESS_BITS | TURN) == SIGNATURE;
    (signed(now) && before ^ now == TURN).then_some((now & PROCESS_BITS).cast_unsigned())
}

/// What a command requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum Opcode {
    /// movej to the joint target.
    MoveJoint,
    /// movel to the joint target.
    MoveLinear,
    /// Payload: mass (kg), centre of gravity (m).
    SetPayload,
    /// TCP in the flange frame: m and rotation vector.
    SetTcp,
    /// Stop the arm now.
    Stop,
    /// End the program.
    End,
}

impl Opcode {
    /// Every opcode.
    pub const ALL: [Opcode; 6] = [
        Opcode::MoveJoint,
        Opcode::MoveLinear,
        Opcode::SetPayload,
        Opcode::SetTcp,
        Opcode::Stop,
        Opcode::End,
    ];

    /// The number in the register.
    pub fn code(self) -> i32 {
        match self {
            Opcode::MoveJoint => 1,
            Opcode::MoveLinear => 2,
            Opcode::SetPayload => 3,
            Opcode::SetTcp => 4,
            Opcode::Stop => 5,
            Opcode::End => 6,
        }
    }
}

/// How the program is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum ProgramStatus {
    /// Everything taken is done.
    Idle,
    /// At work.
    Moving,
    /// The heartbeat stayed away; the arm was stopped and the program has ended.
    HeartbeatLost,
    /// A command was refused; the arm was stopped and takes nothing more.
    Rejected,
    /// Stopped, or stopping, by command.
    Stopped,
    /// A number the program does not have: a fault.
    Unknown(i32),
}

impl ProgramStatus {
    /// The status of a register value.
    pub fn from_code(code: i32) -> ProgramStatus {
        match code {
            0 => ProgramStatus::Idle,
            1 => ProgramStatus::Moving,
            2 => ProgramStatus::HeartbeatLost,
            3 => ProgramStatus::Rejected,
            4 => ProgramStatus::Stopped,
            other => ProgramStatus::Unknown(other),
        }
    }
}

/// One command as it is in the registers.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub struct CommandRegisters {
    /// Number of the command.
    pub sequence: i32,
    /// What to do.
    pub opcode: Opcode,
    /// No segment follows.
    pub last: bool,
    /// To a waiting place: left out where another command is there when its turn comes.
    pub waits: bool,
    /// Joint target (rad), payload or TCP.
    pub arguments: [f64; 6],
    /// rad/s or m/s.
    pub speed: f64,
    /// rad/s2 or m/s2.
    pub acceleration: f64,
    /// m.
    pub blend: f64,
}

impl CommandRegisters {
    /// A command without numbers.
    pub fn bare(sequence: i32, opcode: Opcode) -> CommandRegisters {
        let arguments = [0.0; 6];
        CommandRegisters {
            sequence,
            opcode,
            last: false,
            waits: false,
            arguments,
            speed: 0.0,
            acceleration: 0.0,
            blend: 0.0,
        }
    }

    /// Names of the registers, in the order of [`CommandRegisters::values`].
    pub fn names() -> Vec<String> {
        let ints = [SEQUENCE, OPCODE, OPTIONS].map(Register::InputInt);
        let doubles = (ARGUMENTS..=BLEND).map(Register::InputDouble);
        ints.into_iter().chain(doubles).map(Register::name).collect()
    }

    /// Values for the recipe of [`CommandRegisters::names`]. Everything goes out in one package, which the
    /// controller takes over within one frame.
    pub fn values(&self) -> Vec<Value> {
        let options = i32::from(self.last) | i32::from(self.waits) << 1;
        let ints = [self.sequence, self.opcode.code(), options].map(Value::Int32);
        let doubles = [self.speed, self.acceleration, self.blend].map(Value::Double);
        ints.into_iter().chain(self.arguments.map(Value::Double)).chain(doubles).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const README: &str = include_str!("../../../../hardware/ur5e/README.md");

    #[test]
    fn names_and_values_go_together() {
        let command = CommandRegisters::bare(7, Opcode::Stop);
        assert_eq!(CommandRegisters::names().len(), command.values().len());
        assert_eq!(CommandRegisters::names()[0], "input_int_register_24");
        assert_eq!(CommandRegisters::names().last().unwrap(), "input_double_register_32");
        assert_eq!(command.values()[1], Value::Int32(5));
    }

    #[test]
    fn a_mark_names_its_process_and_no_other_number_does() {
        for process in [1, 4711, (1 << 22) - 1] {
            let [one, other] = [false, true].map(|turn| mark_of(process, turn));
            assert_eq!([process_of(one, other), process_of(other, one)], [Some(process); 2]);
            assert_eq!(process_of(one, one), None, "who left it is gone");
            assert_eq!(process_of(one, mark_of(process + 1, true)), None);
        }
        for other in [0, 1, -1, i32::MAX, i32::MIN, 4711] {
            assert_eq!(process_of(other, other ^ TURN), None, "{other}");
        }
    }

    #[test]
    fn the_register_map_for_people_says_the_same() {
        let row = |direction: &str, kind: &str, number: u8, name: &str| {
            let start = format!("| {direction} | {kind} {number} | {name} |");
            assert!(README.contains(&start), "hardware/ur5e/README.md lacks the row {start:?}");
        };
        row("in", "int", SEQUENCE, "sequence");
        row("in", "int", OPCODE, "opcode");
        row("in", "int", OPTIONS, "options");
        row("in", "int", HEARTBEAT, "heartbeat");
        row("in", "int", OWNER, "owner");
        row("in", "double", SPEED, "speed");
        row("in", "double", ACCELERATION, "acceleration");
        row("in", "double", BLEND, "blend");
        row("out", "int", NONCE, "nonce");
        row("out", "int", ACCEPTED, "accepted");
        row("out", "int", FINISHED, "finished");
        row("out", "int", STATUS, "status");
        row("out", "int", HEARTBEAT_ECHO, "heartbeat echo");
        assert!(README.contains(&format!("| in | double {ARGUMENTS} to {} | arguments |", ARGUMENTS + 5)));
        for (opcode, name) in
            Opcode::ALL.iter().zip(["movej", "movel", "set payload", "set tcp", "stop", "end"])
        {
            assert!(README.contains(&format!("| {} | {name} |", opcode.code())), "{name}");
        }
        assert!(README.contains(&format!("{QUEUE_DEPTH} commands")));
    }
}
