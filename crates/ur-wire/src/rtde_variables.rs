//! The variables of RTDE with their types: what may be in an output and in an input recipe.
//!
//! In: a name. Out: its type. Clients unpack by tables of their own, so a simulator has to use exactly these
//! types. Source: the vendor's RTDE guide and client libraries (reference on UR interfaces, 1.6 and 1.7).

use crate::rtde_values::VariableType::{
    self, Bool, Double, Int32, Uint8, Uint32, Uint64, Vector3D, Vector6D, Vector6Int32,
};

/// Registers of each kind (`int`, `double`) and direction; 24 to 47 are for external clients like celld,
/// below that they belong to field buses.
pub const REGISTERS: u8 = 48;

/// First register that no field bus claims.
pub const FIRST_EXTERNAL_REGISTER: u8 = 24;

/// Single bit registers are numbered 64 to 127; 0 to 63 come as two words and belong to field buses.
pub const BIT_REGISTERS: std::ops::Range<u8> = 64..128;

/// Output variables, registers aside.
pub const OUTPUTS: &[(&str, VariableType)] = &[
    ("timestamp", Double),
    ("target_q", Vector6D),
    ("target_qd", Vector6D),
    ("target_qdd", Vector6D),
    ("target_current", Vector6D),
    ("target_moment", Vector6D),
    ("actual_q", Vector6D),
    ("actual_qd", Vector6D),
    ("actual_current", Vector6D),
    ("actual_current_window", Vector6D),
    ("actual_current_as_torque", Vector6D),
    ("joint_control_output", Vector6D),
    ("actual_TCP_pose", Vector6D),
    ("target_TCP_pose", Vector6D),
    ("actual_TCP_speed", Vector6D),
    ("target_TCP_speed", Vector6D),
    ("actual_TCP_force", Vector6D),
    ("actual_TCP_acceleration", Vector6D),
    ("target_TCP_acceleration", Vector6D),
    ("tcp_offset", Vector6D),
    ("actual_digital_input_bits", Uint64),
    ("actual_digital_output_bits", Uint64),
    ("actual_configurable_digital_input_bits", Uint64),
    ("actual_configurable_digital_output_bits", Uint64),
    ("joint_temperatures", Vector6D),
    ("actual_execution_time", Double),
    ("target_execution_time", Double),
    ("robot_mode", Int32),
    ("joint_mode", Vector6Int32),
    ("safety_mode", Int32),
    ("safety_status", Int32),
    ("robot_status_bits", Uint32),
    ("safety_status_bits", Uint32),
    ("runtime_state", Uint32),
    ("actual_tool_accelerometer", Vector3D),
    ("elbow_position", Vector3D),
    ("elbow_velocity", Vector3D),
    ("speed_scaling", Double),
    ("target_speed_fraction", Double),
    ("actual_momentum", Double),
    ("actual_main_voltage", Double),
    ("actual_robot_voltage", Double),
    ("actual_robot_current", Double),
    ("actual_joint_voltage", Vector6D),
    ("analog_io_types", Uint32),
    ("standard_analog_input0", Double),
    ("standard_analog_input1", Double),
    ("standard_analog_output0", Double),
    ("standard_analog_output1", Double),
    ("io_current", Double),
    ("tool_mode", Uint32),
    ("tool_analog_input_types", Uint32),
    ("tool_analog_input0", Double),
    ("tool_analog_input1", Double),
    ("tool_output_voltage", Int32),
    ("tool_output_current", Double),
    ("tool_temperature", Double),
    ("tool_output_mode", Uint8),
    ("tool_digital_output0_mode", Uint8),
    ("tool_digital_output1_mode", Uint8),
    ("tcp_force_scalar", Double),
    ("output_bit_registers0_to_31", Uint32),
    ("output_bit_registers32_to_63", Uint32),
    ("input_bit_registers0_to_31", Uint32),
    ("input_bit_registers32_to_63", Uint32),
    ("payload", Double),
    ("payload_cog", Vector3D),
    ("payload_inertia", Vector6D),
    ("ft_raw_wrench", Vector6D),
    ("script_control_line", Uint32),
    ("joint_position_deviation_ratio", Double),
    ("collision_detection_ratio", Double),
    ("time_scale_source", Int32),
    ("control_step", Uint64),
    ("encoder0_raw", Int32),
    ("encoder1_raw", Int32),
    ("euromap67_input_bits", Uint32),
    ("euromap67_output_bits", Uint32),
    ("euromap67_24V_voltage", Double),
    ("euromap67_24V_current", Double),
    ("actual_robot_energy_consumed", Double),
    ("actual_robot_braking_energy_dissipated", Double),
    ("wrench_calc_from_currents", Vector6D),
    ("target_base_wrench", Vector6D),
    ("target_base_acceleration", Vector6D),
    ("target_gravity", Vector3D),
];

/// Input variables, registers aside.
pub const INPUTS: &[(&str, VariableType)] = &[
    ("speed_slider_mask", Uint32),
    ("speed_slider_fraction", Double),
    ("standard_digital_output_mask", Uint8),
    ("standard_digital_output", Uint8),
    ("configurable_digital_output_mask", Uint8),
    ("configurable_digital_output", Uint8),
    ("tool_digital_output_mask", Uint8),
    ("tool_digital_output", Uint8),
    ("standard_analog_output_mask", Uint8),
    ("standard_analog_output_type", Uint8),
    ("standard_analog_output_0", Double),
    ("standard_analog_output_1", Double),
    ("input_bit_registers0_to_31", Uint32),
    ("input_bit_registers32_to_63", Uint32),
    ("external_force_torque", Vector6D),
];

/// A numbered register.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Register {
    /// `input_int_register_N`, N < 48.
    InputInt(u8),
    /// `input_double_register_N`, N < 48.
    InputDouble(u8),
    /// `input_bit_register_N`, 64 <= N < 128.
    InputBit(u8),
    /// `output_int_register_N`, N < 48.
    OutputInt(u8),
    /// `output_double_register_N`, N < 48.
    OutputDouble(u8),
    /// `output_bit_register_N`, 64 <= N < 128.
    OutputBit(u8),
}

/// Start of a register's name, and the register of a number.
type Prefix = (&'static str, fn(u8) -> Register);

const PREFIXES: [Prefix; 6] = [
    ("input_int_register_", Register::InputInt),
    ("input_double_register_", Register::InputDouble),
    ("input_bit_register_", Register::InputBit),
    ("output_int_register_", Register::OutputInt),
    ("output_double_register_", Register::OutputDouble),
    ("output_bit_register_", Register::OutputBit),
];

impl Register {
    /// The register of a name; `None` if the name is no register or its number is out of range. The number
    /// is written without sign and leading zeros.
    pub fn from_name(name: &str) -> Option<Register> {
        let (prefix, make) = PREFIXES.iter().find(|(prefix, _)| name.starts_with(prefix))?;
        let digits = name.get(prefix.len()..)?;
        let number: u8 = digits.parse().ok()?;
        let register = make(number);
        (register.in_range() && digits == number.to_string()).then_some(register)
    }

    /// The name in recipes.
    pub fn name(self) -> String {
        let (prefix, number) = match self {
            Register::InputInt(n) => (PREFIXES[0].0, n),
            Register::InputDouble(n) => (PREFIXES[1].0, n),
            Register::InputBit(n) => (PREFIXES[2].0, n),
            Register::OutputInt(n) => (PREFIXES[3].0, n),
            Register::OutputDouble(n) => (PREFIXES[4].0, n),
            Register::OutputBit(n) => (PREFIXES[5].0, n),
        };
        format!("{prefix}{number}")
    }

    /// Type of the register.
    pub fn kind(self) -> VariableType {
        match self {
            Register::InputInt(_) | Register::OutputInt(_) => Int32,
            Register::InputDouble(_) | Register::OutputDouble(_) => Double,
            Register::InputBit(_) | Register::OutputBit(_) => Bool,
        }
    }

    /// True for a register that clients write.
    pub fn is_input(self) -> bool {
        matches!(self, Register::InputInt(_) | Register::InputDouble(_) | Register::InputBit(_))
    }

    fn in_range(self) -> bool {
        match self {
            Register::InputInt(n)
            | Register::InputDouble(n)
            | Register::OutputInt(n)
            | Register::OutputDouble(n) => n < REGISTERS,
            Register::InputBit(n) | Register::OutputBit(n) => BIT_REGISTERS.contains(&n),
        }
    }
}

/// Type of a variable in an output recipe; input registers may be read back there.
pub fn output_type(name: &str) -> Option<VariableType> {
    Register::from_name(name).map(Register::kind).or_else(|| look_up(OUTPUTS, name))
}

/// Type of a variable in an input recipe.
pub fn input_type(name: &str) -> Option<VariableType> {
    match Register::from_name(name) {
        Some(register) => register.is_input().then(|| register.kind()),
        None => look_up(INPUTS, name),
    }
}

fn look_up(table: &[(&str, VariableType)], name: &str) -> Option<VariableType> {
    table.iter().find(|(known, _)| *known == name).map(|(_, kind)| *kind)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(name: &str, output: Option<VariableType>, input: Option<VariableType>) {
        assert_eq!((output_type(name), input_type(name)), (output, input), "{name}");
    }

    #[test]
    fn names_have_the_types_of_the_guide() {
        check("actual_q", Some(Vector6D), None);
        check("runtime_state", Some(Uint32), None);
        check("safety_mode", Some(Int32), None);
        check("speed_slider_mask", None, Some(Uint32));
        check("input_int_register_24", Some(Int32), Some(Int32));
        check("input_double_register_47", Some(Double), Some(Double));
        check("output_int_register_0", Some(Int32), None);
        check("output_bit_register_64", Some(Bool), None);
        check("input_bit_registers0_to_31", Some(Uint32), Some(Uint32));
    }

    #[test]
    fn numbers_out_of_range_are_no_registers() {
        check("input_int_register_48", None, None);
        check("input_int_register_024", None, None);
        check("input_int_register_+24", None, None);
        check("input_bit_register_63", None, None);
        check("output_bit_register_128", None, None);
        check("input_double_register_", None, None);
        check("output_int_register_300", None, None);
    }

    #[test]
    fn no_name_stands_twice_and_registers_come_back() {
        for table in [OUTPUTS, INPUTS] {
            let names: std::collections::BTreeSet<_> = table.iter().map(|(name, _)| name).collect();
            assert_eq!(names.len(), table.len());
        }
        for register in [Register::InputInt(24), Register::OutputDouble(0), Register::InputBit(127)] {
            assert_eq!(Register::from_name(&register.name()), Some(register));
        }
    }
}
