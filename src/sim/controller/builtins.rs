//! The built-ins of the controller, by name and parameters.
//!
//! In: a name. Out: its signature, for the compiler. Names that clients' scripts mention without calling them
//! in what is simulated are here too, so that a script loads; calling one is a runtime exception
//! ([`MODELLED`] says which ones do something).

use crate::urscript::code::Code;
use crate::urscript::compile::compile;
use crate::urscript::fault::CompileError;
use crate::urscript::host::{Builtin, urscript_builtins};

/// Built-ins that do what they say, or are modelled as documented where they are carried out.
pub const MODELLED: &[Builtin] = urscript_builtins![
    movej(q; a, v, t, r), movel(pose; a, v, t, r), movep(pose; a, v, r), servoj(q; a, v, t, lookahead_time, gain),
    speedj(qd; a, t), speedl(xd; a, t, aRot), stopj(a), stopl(a; aRot),
    is_steady(), get_steptime(),
    get_actual_joint_positions(), get_target_joint_positions(), get_joint_positions(), get_actual_joint_speeds(),
    get_target_joint_speeds(), get_target_joint_accelerations(), get_actual_tcp_pose(), get_target_tcp_pose(),
    get_actual_tcp_speed(), get_target_tcp_speed(), get_actual_tool_flange_pose(), get_tcp_offset(),
    get_forward_kin(; q, tcp), get_inverse_kin(x; qnear, maxPositionError, maxOrientationError, tcp),
    get_inverse_kin_has_solution(pose; qnear, maxPositionError, maxOrientationError, tcp),
    is_within_safety_limits(pose; qnear, maxPositionError, maxOrientationError, tcp),
    get_joint_torques(), get_tcp_force(), force(), get_joint_temp(j), get_controller_temp(),
    set_tcp(pose; tcp_name), set_payload(m; cog), set_target_payload(m; cog, inertia), set_payload_mass(m),
    set_payload_cog(cog), set_gravity(d), get_target_payload(), get_target_payload_cog(),
    get_target_payload_inertia(),
    read_input_boolean_register(address), read_input_integer_register(address), read_input_float_register(address),
    read_output_boolean_register(address), read_output_integer_register(address),
    read_output_float_register(address), write_output_boolean_register(address, value),
    write_output_integer_register(address, value), write_output_float_register(address, value),
    set_digital_out(n, b), set_standard_digital_out(n, b), set_configurable_digital_out(n, b),
    set_tool_digital_out(n, b), get_digital_in(n), get_standard_digital_in(n), get_configurable_digital_in(n),
    get_tool_digital_in(n), get_digital_out(n), get_standard_digital_out(n), get_configurable_digital_out(n),
    get_tool_digital_out(n), set_analog_out(n, f), set_standard_analog_out(n, f), get_standard_analog_out(n),
    get_standard_analog_in(n), set_tool_voltage(voltage), textmsg(s1; s2), popup(s; title, warning, error, blocking),
    protective_stop(), powerdown(), rtde_set_watchdog(variable_name; min_frequency, action),
    zero_ftsensor(), force_mode_set_damping(damping), force_mode_set_gain_scaling(scaling), end_force_mode(),
    end_freedrive_mode(), end_teach_mode(), ft_rtde_input_enable(enable; sensor_mass, sensor_measuring_offset, sensor_cog),
    enable_external_ft_sensor(enable; sensor_mass, sensor_measuring_offset, sensor_cog), tool_contact(; direction),
];

/// Built-ins that are known and not carried out.
pub const KNOWN: &[Builtin] = urscript_builtins![
    movec(pose_via, pose_to; a, v, r, mode), servoc(pose; a, v, r), optimovej(goal; a, v, r), optimovel(goal; a, v, r),
    direct_torque(torque; friction_comp, viscous_scale, coulomb_scale),
    force_mode(task_frame, selection_vector, wrench, type, limits), freedrive_mode(; freeAxes, feature), teach_mode(),
    get_freedrive_status(), get_actual_joint_positions_history(; steps), get_coriolis_and_centrifugal_torques(; q, qd),
    get_jacobian(; q, tcp), get_jacobian_time_derivative(; q, qd, tcp), get_mass_matrix(; q, include_rotors_inertia),
    get_target_waypoint(), set_tool_communication(enabled, baud_rate, parity, stop_bits, rx_idle_chars, tx_idle_chars),
    socket_open(address, port; socket_name), socket_close(; socket_name),
    socket_read_binary_integer(number; socket_name, timeout), socket_send_int(value; socket_name),
    socket_send_string(str; socket_name), socket_send_line(str; socket_name), socket_send_byte(value; socket_name),
    socket_read_string(; socket_name, prefix, suffix, interpret_escape, timeout),
    socket_read_line(; socket_name, timeout), socket_read_ascii_float(number; socket_name, timeout),
    socket_read_byte_list(number; socket_name, timeout), socket_get_var(name; socket_name),
    socket_set_var(name, value; socket_name), interpreter_mode(; clearQueueOnEnter, clearOnEnd),
];

/// The signature of a built-in of the controller.
pub fn find(name: &str) -> Option<&'static Builtin> {
    MODELLED.iter().chain(KNOWN).find(|builtin| builtin.name == name)
}

/// Parses and checks a program as the controller does when it is uploaded.
///
/// # Errors
/// The first thing that keeps it from being loaded, with line and column.
pub fn compile_program(text: &str) -> Result<Code, CompileError> {
    compile(text, &find)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_is_there_twice_or_belongs_to_the_language() {
        let all: Vec<&str> = MODELLED.iter().chain(KNOWN).map(|builtin| builtin.name).collect();
        for (index, name) in all.iter().enumerate() {
            assert!(!all[..index].contains(name), "{name} is there twice");
            assert!(crate::urscript::library::find(name).is_none(), "{name} belongs to the language");
        }
    }
}
