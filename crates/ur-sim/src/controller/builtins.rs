//! The built-ins of the controller as one table: name, parameters, how real each one is, and what to know.
//!
//! In: a name. Out: its signature, for the compiler, and the rows of the conformance table ([`all`]). A name
//! that is here and [`Grade::Absent`] lets a script load that mentions it without calling it; calling it is
//! a runtime exception. Names and parameters are those of the script manual; a test calls every row.

use std::fmt;
use urscript::code::Code;
use urscript::compile::compile;
use urscript::extend::extend;
use urscript::fault::CompileError;
use urscript::host::{Builtin, urscript_builtins};
use urscript::library;

/// How much of a built-in is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grade {
    /// Does what the manual says.
    Real,
    /// Does something simpler, which the note names.
    Modelled,
    /// Known by name; calling it is a runtime exception.
    Absent,
}

impl Grade {
    /// The word in the conformance table.
    pub fn as_str(self) -> &'static str {
        match self {
            Grade::Real => "real",
            Grade::Modelled => "modelled",
            Grade::Absent => "absent",
        }
    }
}

impl fmt::Display for Grade {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// A row of the table.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Name and parameters.
    pub builtin: Builtin,
    /// How much of it is there.
    pub grade: Grade,
    /// What deviates, or why; empty where nothing does.
    pub note: &'static str,
}

/// `Grade name(required, ...; optional, ...) "note";`
macro_rules! entries {
    ($($grade:ident $name:ident($($required:ident),* $(; $($optional:ident),+)?) $note:literal;)*) => {
        &[$(Entry {
            builtin: urscript_builtins![$name($($required),* $(; $($optional),+)?)][0],
            grade: Grade::$grade,
            note: $note,
        }),*]
    };
}

/// The built-ins that touch the robot; those of the language are [`library::BUILTINS`].
pub const TABLE: &[Entry] = entries![
    // Motion.
    Real movej(q; a, v, t, r) "";
    Real movel(pose; a, v, t, r) "";
    Real movep(pose; a, v, r) "corners are arcs at constant speed when the next movep follows";
    Real movec(pose_via, pose_to; a, v, r, mode) "";
    Modelled optimovej(goal; a, v, r) "trapezoid instead of a jerk-limited profile; shares of the fastest \
                                       joint's limits; on PolyScope X from 10.8";
    Modelled optimovel(goal; a, v, r) "trapezoid instead of a jerk-limited profile; on PolyScope X from 10.8";
    Modelled servoj(q; a, v, t, lookahead_time, gain) "first-order lag of lookahead_time; gain has no effect";
    Modelled servoc(pose; a, v, r) "as movep towards each new target";
    Real speedj(qd, a; t) "";
    Real speedl(xd, a; t, aRot) "";
    Real stopj(a) "";
    Real stopl(a; aRot) "";
    Modelled direct_torque(torque; friction_comp, viscous_scale, coulomb_scale) "rigid bodies with a little \
        friction; the compensation's arguments have no effect";
    Modelled set_pos(q) "places the standing arm";
    Modelled reset_revolution_counter(; qNear) "wrist 3 of a UR3 or UR3e, which has no limit; the other joints have one, \
        and nothing to reset";
    Modelled path_offset_enable() "assumed: begins at no offset; an exception while a conveyor is tracked";
    Real path_offset_disable(; a) "";
    Modelled path_offset_set(offset, type) "assumed: turns about the tool centre point; the motion frame is the tool's \
        until the path has moved";
    Real path_offset_get(type) "";
    Modelled path_offset_set_max_offset(transLimit, rotLimit) "assumed: each axis is cut off there";
    Real path_offset_set_alpha_filter(alpha) "";
    Modelled track_conveyor_linear(direction, ticks_per_meter; encoder_index) "while the arm is held the belt \
        leaves it behind";
    Modelled track_conveyor_circular(center, ticks_per_revolution; rotate_tool, encoder_index) "likewise";
    Modelled stop_conveyor_tracking(; a) "";
    Modelled tool_wrench_limit_set(frame_offset; Fx, Fy, Fz, Mx, My, Mz) "accepted; no motion is slowed by \
        it";
    Modelled tool_wrench_limit_disable() "accepted";
    Modelled conveyor_pulse_decode(type, A; B) "as encoder_enable_pulse_decode";
    Modelled get_conveyor_tick_count() "the filter is assumed";
    Real set_conveyor_tick_count(tick_count; absolute_encoder_resolution) "";
    Modelled encoder_enable_pulse_decode(encoder_index, decoder_type, A, B) "from inputs up to 250 Hz, or \
        from the configured conveyor; a quadrature encoder counts four times a period, which is assumed";
    Real encoder_enable_set_tick_count(encoder_index, range_id) "";
    Real encoder_set_tick_count(encoder_index, count) "";
    Modelled encoder_get_tick_count(encoder_index; opt) "the filter is assumed";
    Real encoder_unwind_delta_tick_count(encoder_index, delta_tick_count) "";
    // Force.
    Modelled force_mode(task_frame, selection_vector, wrench, type, limits) "speed in proportion to the \
        missing force";
    Modelled end_force_mode() "";
    Modelled force_mode_set_damping(damping) "scales the speed";
    Modelled force_mode_set_gain_scaling(scaling) "scales the speed";
    Modelled freedrive_mode(; freeAxes, feature) "gives way to the forces of the world";
    Modelled freedrive_mode_no_incorrect_payload_check() "freedrive on all axes";
    Modelled end_freedrive_mode() "";
    Modelled get_freedrive_status() "how near a singularity is: assumed singular values of the Jacobian";
    Modelled teach_mode() "freedrive on all axes";
    Modelled end_teach_mode() "";
    Modelled screw_driving(f, v_limit) "force mode along the tool's z";
    Modelled end_screw_driving() "";
    Modelled force() "without noise";
    Modelled get_tcp_force() "without noise";
    Modelled zero_ftsensor() "";
    Modelled tool_contact(; direction) "force above 5 N against the direction";
    Modelled ft_rtde_input_enable(enable; sensor_mass, sensor_measuring_offset, sensor_cog) "the sensor's \
        own mass is not compensated";
    Modelled enable_external_ft_sensor(enable; sensor_mass, sensor_measuring_offset, sensor_cog) "as ft_rtde_input_enable";
    Modelled get_joint_torques() "from the force at the tool";
    // Dynamics.
    Real get_jacobian(; q, tcp) "";
    Real get_jacobian_time_derivative(; q, qd, tcp) "";
    Modelled get_mass_matrix(; q, include_rotors_inertia) "published link masses, UR5e; no rotors";
    Modelled get_coriolis_and_centrifugal_torques(; q, qd) "published link masses, UR5e";
    // State.
    Real is_steady() "";
    Real get_steptime() "";
    Real get_actual_joint_positions() "the arm follows its targets exactly";
    Real get_target_joint_positions() "";
    Real get_joint_positions() "";
    Real get_actual_joint_positions_history(; steps) "3 s";
    Real get_actual_joint_speeds() "";
    Real get_target_joint_speeds() "";
    Real get_target_joint_accelerations() "";
    Real get_actual_tcp_pose() "";
    Real get_target_tcp_pose() "";
    Real get_target_tcp_pose_along_path() "without conveyor and path offset";
    Real get_actual_tcp_speed() "";
    Real get_target_tcp_speed() "";
    Real get_target_tcp_speed_along_path() "";
    Real get_target_waypoint() "";
    Real get_actual_tool_flange_pose() "";
    Real get_tcp_offset() "";
    Real get_forward_kin(; q, tcp) "";
    Real get_inverse_kin(x; qnear, maxPositionError, maxOrientationError, tcp) "nearest by the largest \
        joint difference";
    Real get_inverse_kin_has_solution(pose; qnear, maxPositionError, maxOrientationError, tcp) "";
    Modelled is_within_safety_limits(position; qNear, maxPositionError, maxOrientationError, tcp) "joint ranges, reach, safety planes and the arm itself";
    Modelled get_joint_temp(j) "35 degrees";
    Modelled get_controller_temp() "40 degrees";
    Modelled get_tool_accelerometer_reading() "gravity and motion in the flange frame, without noise";
    Modelled get_tool_current() "0";
    Modelled get_tool_temp() "35 degrees";
    Modelled time(; mode) "mode 0: of the simulation since its controller started; mode 2: the same, \
                           counted from 2026-01-01";
    // Tool and installation.
    Real set_tcp(pose; tcp_name) "";
    Real set_payload(m; cog) "";
    Modelled set_target_payload(m, cog; inertia, transition_time) "in equal steps over the transition time, and reported so";
    Real set_payload_mass(m) "";
    Real set_payload_cog(CoG) "";
    Real get_target_payload() "";
    Real get_target_payload_cog() "";
    Real get_target_payload_inertia() "";
    Real set_gravity(d) "";
    Real get_gravity() "";
    Real set_base_acceleration(a) "";
    Real get_base_acceleration() "";
    Modelled estimate_payload(poses, wrenches) "least squares with the sensor's zero; assumed: the active payload is not \
        added";
    Modelled set_safety_mode_transition_hardness(type) "accepted";
    Modelled high_holding_torque_enable() "accepted";
    Modelled high_holding_torque_disable() "accepted";
    Modelled position_deviation_warning(enabled; threshold) "accepted";
    Modelled pause_on_error_code(code; argument) "accepted";
    Modelled set_baselight_off() "accepted";
    Modelled set_baselight_iec() "accepted";
    Modelled set_baselight_solid(r, g, b) "accepted";
    // Messages and program.
    Real textmsg(s1; s2) "";
    Real popup(s; title, warning, error, blocking) "blocking: until the popup is closed";
    Real protective_stop() "";
    Modelled powerdown() "the arm only; the servers go on";
    Real rtde_set_watchdog(variable_name, min_frequency; action) "";
    Modelled interpreter_mode(; clearQueueOnEnter, clearOnEnd) "in the main thread; up to 2000 statements until clear_interpreter()";
    Modelled end_interpreter() "";
    Modelled clear_interpreter() "";
    Modelled rpc_factory(type, url) "XML-RPC over HTTP; assumed: an exception when there is no answer within 10 s";
    Modelled request_boolean_from_primary_client(message) "answered at the control server; assumed: the layout of the \
        message to clients";
    Modelled request_integer_from_primary_client(message) "likewise";
    Modelled request_float_from_primary_client(message) "likewise";
    Modelled request_string_from_primary_client(message) "likewise";
    Absent eip_reader_factory(instance_name, data_size) "";
    Absent eip_writer_factory(instance_name, data_size) "";
    // Registers, inputs and outputs.
    Real read_input_boolean_register(address) "";
    Real read_input_integer_register(address) "";
    Real read_input_float_register(address) "";
    Real read_output_boolean_register(address) "";
    Real read_output_integer_register(address) "";
    Real read_output_float_register(address) "";
    Real write_output_boolean_register(address, value) "";
    Real write_output_integer_register(address, value) "";
    Real write_output_float_register(address, value) "";
    Real set_digital_out(n, b) "";
    Real set_standard_digital_out(n, b) "";
    Real set_configurable_digital_out(n, b) "";
    Real set_tool_digital_out(n, b) "";
    Real get_digital_in(n) "";
    Real get_standard_digital_in(n) "";
    Real get_configurable_digital_in(n) "";
    Real get_tool_digital_in(n) "";
    Real get_digital_out(n) "";
    Real get_standard_digital_out(n) "";
    Real get_configurable_digital_out(n) "";
    Real get_tool_digital_out(n) "";
    Real set_analog_out(n, f) "";
    Real set_standard_analog_out(n, f) "";
    Real get_analog_out(n) "";
    Real get_standard_analog_out(n) "";
    Real set_analog_outputdomain(port, domain) "";
    Modelled get_analog_in(n) "0: nothing is wired";
    Modelled get_standard_analog_in(n) "0: nothing is wired";
    Modelled get_tool_analog_in(n) "0: nothing is wired";
    Modelled set_analog_inputrange(port, range) "accepted";
    Modelled set_standard_analog_input_domain(port, domain) "accepted";
    Modelled set_tool_analog_input_domain(port, domain) "accepted";
    Real set_tool_voltage(voltage) "";
    Modelled set_tool_output_mode(mode) "accepted";
    Modelled set_tool_digital_output_mode(n, mode) "accepted";
    Modelled set_tool_communication(enabled, baud_rate, parity, stop_bits, rx_idle_chars, tx_idle_chars) "a line for a VGC10 on the tool connector; what is plugged in else is silent";
    Modelled set_input_actions_to_default() "accepted";
    Modelled set_standard_digital_input_action(port, action) "accepted";
    Modelled set_configurable_digital_input_action(port, action) "accepted";
    Modelled set_tool_digital_input_action(port, action) "accepted";
    Modelled set_gp_boolean_input_action(port, action) "accepted";
    Modelled set_runstate_outputs(outputs) "accepted; scripts of older software call it";
    Modelled set_runstate_standard_digital_output_to_value(outputId, state) "accepted";
    Modelled set_runstate_configurable_digital_output_to_value(outputId, state) "accepted";
    Modelled set_runstate_tool_digital_output_to_value(outputId, state) "accepted";
    Modelled set_runstate_standard_analog_output_to_value(outputId, state) "accepted";
    Modelled set_runstate_gp_boolean_output_to_value(outputId, state) "accepted";
    Real get_flag(n) "";
    Real set_flag(n, b) "";
    Modelled read_port_bit(address) "coils of the Modbus server; 0 where it has none";
    Modelled write_port_bit(address, value) "an exception for a coil that is read-only";
    Modelled read_port_register(address) "registers of the Modbus server; 0 where it has none";
    Modelled write_port_register(address, value) "an exception for a register that is read-only";
    Absent get_euromap_input(port_number) "";
    Absent get_euromap_output(port_number) "";
    Absent set_euromap_output(port_number, signal_value) "";
    Absent set_euromap_runstate_dependent_choice(port_number, runstate_choice) "";
    Modelled modbus_add_signal(IP, slave_number, signal_address, signal_type, signal_name; sequential_mode, register_count) "a value by name; no device is polled";
    Modelled modbus_add_rw_signal(IP, slave_number, read_address, read_register_count, write_address, write_register_count, signal_name; sequential_mode) "a value by name; no device is polled";
    Modelled modbus_get_error(signal_name; error_source) "0: none";
    Modelled modbus_get_time_since_signal_invalid(signal_name) "0";
    Modelled modbus_request_update_signal_value(signal_name) "accepted";
    Modelled modbus_reset_connection(connection_id; is_blocking) "accepted";
    Modelled modbus_set_signal_watchdog(signal_name, new_timeout_in_sec) "accepted";
    Modelled modbus_delete_signal(signal_name) "";
    Modelled modbus_get_signal_status(signal_name; is_secondary_program) "what scripts wrote, at first 0";
    Modelled modbus_set_output_register(signal_name, register_value; is_secondary_program) "kept for scripts";
    Modelled modbus_set_output_signal(signal_name, digital_value; is_secondary_program) "kept for scripts";
    Modelled modbus_set_signal_update_frequency(signal_name, update_frequency) "accepted";
    Modelled modbus_set_runstate_dependent_choice(signal_name, runstate_choice) "accepted";
    Modelled modbus_set_digital_input_action(signal_name, action) "accepted";
    Modelled modbus_send_custom_command(IP, slave_number, function_code, data) "assumed: waits for the answer, 2 s at most; \
        the address may name a port";
    // Sockets.
    Real socket_open(address, port; socket_name) "";
    Real socket_close(; socket_name) "";
    Real socket_read_binary_integer(number; socket_name, timeout) "";
    Real socket_read_byte_list(number; socket_name, timeout) "";
    Real socket_read_ascii_float(number; socket_name, timeout) "";
    Real socket_read_string(; socket_name, prefix, suffix, interpret_escape, timeout) "";
    Real socket_read_line(; socket_name, timeout) "";
    Real socket_send_int(value; socket_name) "";
    Real socket_send_byte(value; socket_name) "";
    Real socket_send_string(str; socket_name) "";
    Real socket_send_line(str; socket_name) "";
    Real socket_get_var(name; socket_name) "";
    Real socket_set_var(name, value; socket_name) "";
];

/// What deviates in built-ins of the language.
const LANGUAGE_NOTES: &[(&[&str], &str)] = &[
    (
        &["str_at", "str_find", "str_len", "str_sub"],
        "counted in characters; the controller counts bytes, which differ outside ASCII",
    ),
    (&["str_cat", "to_str"], "up to 65,536 bytes; the controller refuses more than 1023 characters"),
];

/// The whole conformance table: the robot's built-ins, then the language's.
pub fn all() -> Vec<Entry> {
    let note = |name: &str| {
        LANGUAGE_NOTES.iter().find(|(names, _)| names.contains(&name)).map_or("", |(_, note)| note)
    };
    let language = library::BUILTINS.iter().map(|builtin| Entry {
        builtin: *builtin,
        grade: Grade::Real,
        note: note(builtin.name),
    });
    TABLE.iter().copied().chain(language).collect()
}

/// The signature of a built-in of the controller.
pub fn find(name: &str) -> Option<&'static Builtin> {
    TABLE.iter().map(|entry| &entry.builtin).find(|builtin| builtin.name == name)
}

/// Adds a statement to a program's code; the new code and the number of the function to call.
///
/// # Errors
/// It is not URScript, or names something that is not there.
pub fn compile_statement(code: &Code, text: &str) -> Result<(Code, usize), CompileError> {
    extend(code, text, &find)
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
    use crate::controller::{Controller, ControllerConfig};
    use urscript::host::{Call, Host};
    use urscript::value::ThreadId;

    #[test]
    fn no_name_is_there_twice() {
        let all = all();
        for (index, entry) in all.iter().enumerate() {
            let name = entry.builtin.name;
            assert!(!all[..index].iter().any(|other| other.builtin.name == name), "{name} is there twice");
        }
    }

    /// Without arguments a call is refused for one of them, or does something; an absent one says so.
    #[test]
    fn every_row_is_carried_out_as_its_grade_says() {
        for entry in TABLE {
            let mut controller =
                Controller::new(ControllerConfig { running: true, ..ControllerConfig::ur5e(1) });
            let arguments = vec![None; entry.builtin.parameters.len()];
            let call = Call {
                name: entry.builtin.name,
                arguments: &arguments,
                thread: ThreadId(1),
                frames: 0,
                note: &mut 0,
            };
            let answer = controller.core.call(call);
            let absent = answer.is_err_and(|message| message.contains("not available in the simulation"));
            assert_eq!(absent, entry.grade == Grade::Absent, "{}", entry.builtin.name);
        }
    }

    #[test]
    fn every_built_in_of_the_language_is_carried_out() {
        let mut random = library::Random::new(1);
        for builtin in library::BUILTINS {
            let arguments = vec![None; builtin.parameters.len()];
            let (thread, frames) = (ThreadId(1), 0);
            let call = Call { name: builtin.name, arguments: &arguments, thread, frames, note: &mut 0 };
            let scheduled = matches!(builtin.name, "sync" | "sleep");
            assert_eq!(library::call(&call, &mut random).is_none(), scheduled, "{}", builtin.name);
        }
    }
}
