//! The RTDE recipes: which fields are agreed with the controller, and the robot's state out of one package.
//!
//! In: the controller's offers for the names that were requested, values of a state package. Out: a recipe
//! or why there is none, a [`RobotState`]. Apart from the session because nothing here depends on time or on
//! the step of the handshake.

use crate::device::registers::{self, CommandRegisters, ProgramStatus};
use crate::device::robot_types::RobotState;
use cell_values::time::Timestamp;
use cell_values::units::Joints;
use ur_wire::enumerations::{RobotMode, RuntimeState, SafetyMode};
use ur_wire::rtde_values::{Offer, Recipe, Value};
use ur_wire::rtde_variables::Register;

/// Input recipe of the heartbeat alone.
pub(super) const HEARTBEAT: usize = 0;
/// Input recipe of the command with its arguments.
pub(super) const COMMAND: usize = 1;
/// Input recipe of the mark of who writes: the last.
pub(super) const OWNER: usize = 2;

/// Bit of `robot_status_bits`: the freedrive button is pressed (reference: ur-interfaces, 1.8).
const TEACH_BUTTON: u32 = 1 << 2;

/// Why a recipe was not agreed.
pub(super) enum Refusal {
    InUse(Vec<String>),
    NotFound(Vec<String>),
    Broken(String),
}

impl Refusal {
    /// For sentences; `direction` is `input` or `output`.
    pub(super) fn text(&self, direction: &str) -> String {
        match self {
            Refusal::InUse(names) => format!(
                "{direction} registers are in use by another RTDE client or a field bus (EtherNet/IP, \
                 PROFINET): {}",
                names.join(", ")
            ),
            Refusal::NotFound(names) => {
                format!("the controller has no {direction} {}; its software may be too old", names.join(", "))
            }
            Refusal::Broken(detail) => format!("{direction} set-up: {detail}"),
        }
    }
}

/// The recipe if everything requested was offered.
pub(super) fn agree(id: u8, names: &[String], offers: &[Offer]) -> Result<Recipe, Refusal> {
    if offers.len() != names.len() {
        return Err(Refusal::Broken(format!(
            "{} names were asked for, {} came back",
            names.len(),
            offers.len()
        )));
    }
    let with = |wanted: Offer| -> Vec<String> {
        names
            .iter()
            .zip(offers)
            .filter(|(_, offer)| **offer == wanted)
            .map(|(name, _)| name.clone())
            .collect()
    };
    let missing = with(Offer::NotFound);
    if !missing.is_empty() {
        return Err(Refusal::NotFound(missing));
    }
    let taken = with(Offer::InUse);
    if !taken.is_empty() {
        return Err(Refusal::InUse(taken));
    }
    if id == 0 {
        return Err(Refusal::Broken("refused without naming a variable".into()));
    }
    let fields = names.iter().zip(offers).filter_map(|(name, offer)| match offer {
        Offer::Type(kind) => Some((name.clone(), *kind)),
        Offer::NotFound | Offer::InUse => None,
    });
    Ok(Recipe { id, fields: fields.collect() })
}

/// Fields of an input recipe.
pub(super) fn input_names(index: usize) -> Vec<String> {
    match index {
        HEARTBEAT => vec![Register::InputInt(registers::HEARTBEAT).name()],
        COMMAND => CommandRegisters::names(),
        _ => vec![Register::InputInt(registers::OWNER).name()],
    }
}

/// Fields of the output recipe, in the order `state_of` reads them; after them the mark of who writes the
/// inputs.
pub fn output_names() -> Vec<String> {
    let fixed = [
        "timestamp",
        "actual_q",
        "actual_qd",
        "actual_TCP_pose",
        "tcp_offset",
        "robot_mode",
        "safety_mode",
        "runtime_state",
        "robot_status_bits",
        "speed_scaling",
        "target_speed_fraction",
        "payload",
        "payload_cog",
    ];
    let registers = [
        registers::NONCE,
        registers::ACCEPTED,
        registers::FINISHED,
        registers::STATUS,
        registers::HEARTBEAT_ECHO,
    ];
    let registers = registers.map(|number| Register::OutputInt(number).name());
    let mark = Register::InputInt(registers::OWNER).name();
    fixed.into_iter().map(String::from).chain(registers).chain([mark]).collect()
}

/// The mark in the inputs, of the values of one package.
pub(super) fn mark_in(values: &[Value]) -> Option<i32> {
    match values.last() {
        Some(Value::Int32(mark)) => Some(*mark),
        _ => None,
    }
}

/// The state of one package; `None` if the fields are not those of [`output_names`].
pub(super) fn state_of(now: Timestamp, values: &[Value]) -> Option<RobotState> {
    use Value::{Double, Int32, Uint32, Vector3D, Vector6D};
    let &[
        Double(controller_time_s),
        Vector6D(q),
        Vector6D(qd),
        Vector6D(tcp_pose),
        Vector6D(tcp_offset),
        Int32(robot_mode),
        Int32(safety_mode),
        Uint32(runtime_state),
        Uint32(robot_status_bits),
        Double(speed_scaling),
        Double(target_speed_fraction),
        Double(payload),
        Vector3D(payload_cog),
        Int32(nonce),
        Int32(accepted),
        Int32(finished),
        Int32(status),
        Int32(heartbeat_echo),
        Int32(_),
    ] = values
    else {
        return None;
    };
    Some(RobotState {
        received: now,
        controller_time_s,
        q: Joints(q),
        qd,
        tcp_pose,
        robot_mode: RobotMode::from_code(robot_mode),
        safety_mode: SafetyMode::from_code(safety_mode),
        runtime_state: RuntimeState::from_code(i32::try_from(runtime_state).unwrap_or(i32::MAX)),
        guided: robot_status_bits & TEACH_BUTTON != 0,
        speed_scaling,
        target_speed_fraction,
        payload,
        payload_cog,
        tcp_offset,
        nonce,
        accepted,
        finished,
        program_status: ProgramStatus::from_code(status),
        heartbeat_echo,
        remote_control: None,
    })
}
