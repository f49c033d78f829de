//! RTDE output variables: from a name to the value of this frame.
//!
//! In: names of an output recipe, resolved once; then the controller's state at the end of a frame. Out:
//! wire values of exactly the documented types (client libraries unpack with type tables of their own).
//! What is not simulated has a constant that a healthy robot could send; see `CONSTANT`.

use crate::controller::Controller;
use crate::controller::drives;
use crate::controller::registers::bits_word;
use ur_arm::pose::ur_pose_from_isometry;
use ur_wire::rtde_values::Value;
use ur_wire::rtde_variables::{self, Register};

/// Computes a variable from the state.
type Compute = fn(&Controller) -> Value;

/// How a variable is sampled.
#[derive(Clone, Copy, Debug)]
pub enum Output {
    /// A numbered register.
    Register(Register),
    /// Computed from the state.
    Computed(Compute),
    /// Not simulated.
    Constant(Value),
}

/// Variables that follow the simulation.
const COMPUTED: &[(&str, Compute)] = &[
    ("timestamp", |c| Value::Double(c.core.timestamp())),
    ("control_step", |c| Value::Uint64(c.core.step)),
    ("target_q", |c| Value::Vector6D(c.core.mover.q().0)),
    ("actual_q", |c| Value::Vector6D(c.core.actual_q().0)),
    ("target_qd", |c| Value::Vector6D(c.core.mover.qd())),
    ("actual_qd", |c| Value::Vector6D(c.core.actual_qd())),
    ("target_qdd", |c| Value::Vector6D(c.core.mover.qdd())),
    ("target_moment", |c| Value::Vector6D(c.core.target_moments())),
    ("target_current", |c| Value::Vector6D(drives::target_currents(c))),
    ("actual_current", |c| Value::Vector6D(drives::actual_currents(c))),
    ("joint_control_output", |c| Value::Vector6D(drives::actual_currents(c))),
    ("actual_current_as_torque", |c| Value::Vector6D(c.core.joint_moments())),
    ("actual_momentum", |c| Value::Double(c.core.momentum())),
    ("actual_tool_accelerometer", |c| Value::Vector3D(c.core.tool_accelerometer())),
    ("actual_TCP_acceleration", |c| Value::Vector6D(c.core.tcp_acceleration())),
    ("target_TCP_acceleration", |c| Value::Vector6D(c.core.tcp_acceleration())),
    ("actual_TCP_pose", |c| Value::Vector6D(c.core.tcp_pose())),
    ("target_TCP_pose", |c| Value::Vector6D(ur_pose_from_isometry(&c.core.mover.tcp()))),
    ("actual_TCP_speed", |c| Value::Vector6D(c.core.mover.tcp_speed().into())),
    ("target_TCP_speed", |c| Value::Vector6D(c.core.mover.tcp_speed().into())),
    ("actual_TCP_force", |c| Value::Vector6D(c.core.tcp_force())),
    ("ft_raw_wrench", |c| Value::Vector6D(c.core.raw_wrench())),
    ("tcp_offset", |c| Value::Vector6D(c.core.tcp_offset)),
    ("elbow_position", |c| Value::Vector3D(elbow(c))),
    ("elbow_velocity", |c| Value::Vector3D(elbow_velocity(c))),
    ("tcp_force_scalar", |c| {
        let [x, y, z, ..] = c.core.tcp_force();
        Value::Double(x.hypot(y).hypot(z))
    }),
    ("actual_digital_input_bits", |c| Value::Uint64(c.core.registers.digital_inputs)),
    ("actual_digital_output_bits", |c| Value::Uint64(c.core.registers.digital_outputs)),
    ("actual_configurable_digital_input_bits", |c| {
        Value::Uint64(c.core.registers.digital_inputs >> 8 & 0xff)
    }),
    ("actual_configurable_digital_output_bits", |c| {
        Value::Uint64(c.core.registers.digital_outputs >> 8 & 0xff)
    }),
    ("robot_mode", |c| Value::Int32(c.core.modes.robot_mode().code())),
    ("joint_mode", |c| Value::Vector6Int32([joint_mode(c); 6])),
    ("safety_mode", |c| Value::Int32(c.core.modes.safety_mode().code())),
    ("safety_status", |c| Value::Int32(c.core.modes.safety_mode().code())),
    ("robot_status_bits", |c| Value::Uint32(robot_status_bits(c))),
    ("safety_status_bits", |c| Value::Uint32(c.core.modes.safety_status_bits())),
    ("runtime_state", |c| Value::Uint32(c.programs.runtime_state().code() as u32)),
    ("speed_scaling", |c| Value::Double(speed_scaling(c))),
    ("target_speed_fraction", |c| Value::Double(c.core.registers.speed_fraction())),
    ("time_scale_source", |c| Value::Int32(i32::from(c.programs.playing()))),
    ("standard_analog_output0", |c| Value::Double(analog_output(c, 0))),
    ("standard_analog_output1", |c| Value::Double(analog_output(c, 1))),
    ("analog_io_types", |c| {
        let [a, b] = c.core.registers.analog_output_voltage.map(u32::from);
        Value::Uint32(0b11 | a << 2 | b << 3)
    }),
    ("tool_output_voltage", |c| Value::Int32(c.core.registers.tool_voltage)),
    ("output_bit_registers0_to_31", |c| Value::Uint32(bits_word(&c.core.registers.output_bits[..32]))),
    ("output_bit_registers32_to_63", |c| Value::Uint32(bits_word(&c.core.registers.output_bits[32..64]))),
    ("input_bit_registers0_to_31", |c| Value::Uint32(bits_word(&c.core.registers.input_bits[..32]))),
    ("input_bit_registers32_to_63", |c| Value::Uint32(bits_word(&c.core.registers.input_bits[32..64]))),
    ("payload", |c| Value::Double(c.core.payload.mass)),
    ("payload_cog", |c| Value::Vector3D(c.core.payload.centre)),
    ("payload_inertia", |c| Value::Vector6D(c.core.payload.inertia)),
    ("target_gravity", |c| Value::Vector3D(c.core.payload.gravity)),
    ("encoder0_raw", |c| Value::Int32(c.core.settings.encoders[0].raw())),
    ("encoder1_raw", |c| Value::Int32(c.core.settings.encoders[1].raw())),
    ("script_control_line", |c| Value::Uint32(c.programs.line())),
];

/// Variables that are not simulated, where zero would not be what a healthy robot sends.
const CONSTANT: &[(&str, Value)] = &[
    ("joint_temperatures", Value::Vector6D([35.0; 6])),
    ("actual_main_voltage", Value::Double(48.0)),
    ("actual_robot_voltage", Value::Double(48.0)),
    ("actual_robot_current", Value::Double(0.6)),
    ("actual_joint_voltage", Value::Vector6D([48.0; 6])),
    ("actual_execution_time", Value::Double(0.0002)),
    ("tool_mode", Value::Uint32(253)),
    ("tool_temperature", Value::Double(35.0)),
];

/// How to sample the variable called `name`; `None` if this controller does not have it.
pub fn find(name: &str) -> Option<Output> {
    if let Some(register) = Register::from_name(name) {
        return Some(Output::Register(register));
    }
    if let Some((_, compute)) = COMPUTED.iter().find(|(known, _)| *known == name) {
        return Some(Output::Computed(*compute));
    }
    if let Some((_, value)) = CONSTANT.iter().find(|(known, _)| *known == name) {
        return Some(Output::Constant(*value));
    }
    rtde_variables::output_type(name).map(|kind| Output::Constant(kind.zero()))
}

impl Output {
    /// The value of this frame.
    pub fn sample(&self, controller: &Controller) -> Value {
        match self {
            Output::Register(register) => register_value(controller, *register),
            Output::Computed(compute) => compute(controller),
            Output::Constant(value) => *value,
        }
    }
}

/// Whether an output follows the simulation, has a constant of a healthy robot, or is always zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grade {
    /// Follows the simulation.
    Computed,
    /// What a healthy robot could send, always.
    Constant,
    /// Zero: nothing in the simulation corresponds to it.
    Zero,
}

/// The grade of a variable; `None` if this controller does not have it.
pub fn grade(name: &str) -> Option<Grade> {
    Some(match find(name)? {
        Output::Register(_) | Output::Computed(_) => Grade::Computed,
        Output::Constant(value) if value == value.kind().zero() => Grade::Zero,
        Output::Constant(_) => Grade::Constant,
    })
}

/// Elbow (origin of the third joint's frame) in the base frame, m.
pub fn elbow(controller: &Controller) -> [f64; 3] {
    let mover = &controller.core.mover;
    mover.placed().frames[1].translation.vector.into()
}

/// Speed of the elbow in the base frame, m/s: a difference over a step of the joints that no rounding
/// spoils.
pub fn elbow_velocity(controller: &Controller) -> [f64; 3] {
    const STEP_S: f64 = 1e-5;
    let mover = &controller.core.mover;
    let mut ahead = mover.q();
    ahead.0.iter_mut().zip(mover.qd()).for_each(|(q, qd)| *q += qd * STEP_S);
    let ahead = mover.arm.kinematics.chain().frames(&ahead)[1].translation.vector;
    let now = elbow(controller);
    std::array::from_fn(|axis| (ahead[axis] - now[axis]) / STEP_S)
}

fn register_value(controller: &Controller, register: Register) -> Value {
    let registers = &controller.core.registers;
    let at = |n: u8| usize::from(n);
    match register {
        Register::InputInt(n) => Value::Int32(registers.input_ints[at(n)]),
        Register::InputDouble(n) => Value::Double(registers.input_doubles[at(n)]),
        Register::InputBit(n) => Value::Bool(registers.input_bits[at(n)]),
        Register::OutputInt(n) => Value::Int32(registers.output_ints[at(n)]),
        Register::OutputDouble(n) => Value::Double(registers.output_doubles[at(n)]),
        Register::OutputBit(n) => Value::Bool(registers.output_bits[at(n)]),
    }
}

/// Number of the mode all joints are in.
pub fn joint_mode(controller: &Controller) -> i32 {
    controller.core.modes.joint_mode()
}

/// Momentary scaling of the trajectory: 0 while paused.
pub fn speed_scaling(controller: &Controller) -> f64 {
    controller.core.mover.scaling()
}

fn robot_status_bits(controller: &Controller) -> u32 {
    let bits =
        [controller.core.modes.powered(), controller.programs.playing(), controller.core.pendant.freedrive];
    bits.into_iter().enumerate().map(|(number, set)| u32::from(set) << number).sum()
}

/// 0 to 10 V or 4 to 20 mA.
fn analog_output(controller: &Controller, n: usize) -> f64 {
    let registers = &controller.core.registers;
    let ratio = registers.analog_outputs[n];
    if registers.analog_output_voltage[n] { ratio * 10.0 } else { 0.004 + ratio * 0.016 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::ControllerConfig;

    #[test]
    fn the_elbow_turns_with_the_base() {
        let mut controller = Controller::new(ControllerConfig { running: true, ..ControllerConfig::ur5e(1) });
        let script = "def m():\n speedj([0.5,0,0,0,0,0], 40, 10)\nend\n";
        controller.programs.upload(crate::controller::builtins::compile_program(script));
        (0..200).for_each(|_| controller.frame());
        let ([x, y, _], [vx, vy, vz]) = (elbow(&controller), elbow_velocity(&controller));
        let qd = controller.core.mover.qd()[0];
        assert!((qd - 0.5).abs() < 1e-6, "{qd}");
        assert!((vx + qd * y).abs() < 1e-4 && (vy - qd * x).abs() < 1e-4 && vz.abs() < 1e-4);
    }

    #[test]
    fn every_documented_variable_has_its_documented_type() {
        let controller = Controller::new(ControllerConfig::ur5e(1));
        for (name, kind) in rtde_variables::OUTPUTS {
            let output = find(name).unwrap_or_else(|| panic!("{name} is missing"));
            assert_eq!(output.sample(&controller).kind(), *kind, "{name}");
        }
        for (name, _) in COMPUTED {
            assert!(rtde_variables::output_type(name).is_some(), "{name} is not documented");
        }
        for (name, _) in CONSTANT {
            assert!(rtde_variables::output_type(name).is_some(), "{name} is not documented");
        }
        assert!(find("no_such_variable").is_none());
        assert!(matches!(find("output_int_register_24"), Some(Output::Register(Register::OutputInt(24)))));
    }
}
