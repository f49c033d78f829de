//! Every built-in that the conformance page calls real is judged: by a line here that must say what the
//! script manual promises, or by the test named in [`ELSEWHERE`]. In: the table of built-ins. A row without
//! a judge fails.

use super::*;
use std::path::Path;

/// Expressions and what `textmsg` says of them on an arm at rest, the inputs being those of [`prepared`].
/// Numbers that are not exact are compared in the script.
const LINES: &[(&str, &str)] = &[
    // Mathematics.
    (
        "[abs(-2), abs(2.5), ceil(1.2), floor(-1.2), round(2.5), int(-2.7), float(3)]",
        "[2, 2.5, 2, -2, 3, -2, 3]",
    ),
    ("abs(acos(0.5) - d2r(60)) + abs(asin(0.5) - d2r(30)) + abs(atan(1) - d2r(45)) < 0.000000001", "True"),
    (
        "abs(atan2(1, -1) - d2r(135)) + abs(cos(d2r(60)) - 0.5) + abs(sin(d2r(30)) - 0.5) < 0.000000001",
        "True",
    ),
    (
        "abs(tan(d2r(45)) - 1) + abs(r2d(d2r(10)) - 10) + abs(log(2, 8) - 3) + abs(exp(1) - 2.718281828459) \
         < 0.000000001",
        "True",
    ),
    ("[pow(2, 10), sqrt(16), min(3, -4), max(3, -4)]", "[1024, 4, -4, 3]"),
    ("random() >= 0 and random() < 1 and random() != random()", "True"),
    // Lists, matrices, strings.
    (
        "[norm([3, 4]), dot([1, 2, 3], [4, 5, 6]), sum([1, 2, 3.5]), length([7, 8]), get_list_length([7, 8, \
         9])]",
        "[5, 32, 6.5, 2, 3]",
    ),
    ("normalize([3, 4])", "[0.6, 0.8]"),
    ("cross([1, 0, 0], [0, 1, 0])", "[0, 0, 1]"),
    ("size([[1, 2, 3], [4, 5, 6]])", "[2, 3]"),
    ("transpose([[1, 2], [3, 4]])", "[[1, 3], [2, 4]]"),
    ("[transpose([1, 2]), transpose([[1], [2]])]", "[[[1], [2]], [1, 2]]"),
    ("to_str(2.123456123456)", "2.123456"),
    ("str_cat(\"\", 1 / 3)", "0.333333"),
    ("norm(inv([[2, 0], [0, 4]]) * [2, 4] - [1, 1]) < 0.000000001", "True"),
    ("make_list(3, 7)", "[7, 7, 7]"),
    ("[binary_list_to_integer([True, False, True]), length(integer_to_binary_list(5))]", "[5, 32]"),
    ("integer_to_binary_list(6)[1]", "True"),
    ("str_cat(str_at(\"abc\", 1), str_sub(\"abcdef\", 2, 3))", "bcde"),
    (
        "[str_len(\"abcd\"), str_find(\"abcabc\", \"c\"), str_find(\"abcabc\", \"c\", 3), \
         str_find(\"abc\", \"x\")]",
        "[4, 2, 5, -1]",
    ),
    ("str_empty(\"\") and not str_empty(\"a\")", "True"),
    ("to_num(\"3.5\") * 2 + to_num(\"0x10\")", "23"),
    ("str_len(to_str(12))", "2"),
    // Poses.
    ("point_dist(p[0,0,0,1,0,0], p[3,4,0,0,0,0])", "5"),
    ("abs(pose_dist(p[0,0,0,0,0,0], p[3,4,0,0,0,0]) - 5) < 0.000000001", "True"),
    ("pose_add(p[1,2,3,0,0,0], p[1,0,0,0,0,0])", "p[2, 2, 3, 0, 0, 0]"),
    ("pose_sub(p[1,2,3,0,0,0], p[1,0,0,0,0,0])", "p[0, 2, 3, 0, 0, 0]"),
    (
        "pose_dist(pose_trans(p[1,0,0,0,0,d2r(90)], p[1,0,0,0,0,0]), p[1,1,0,0,0,d2r(90)]) < 0.000000001",
        "True",
    ),
    (
        "pose_dist(pose_trans(p[1,2,3,0.1,0.2,0.3], pose_inv(p[1,2,3,0.1,0.2,0.3])), p[0,0,0,0,0,0]) < \
         0.000000001",
        "True",
    ),
    (
        "pose_dist(interpolate_pose(p[0,0,0,0,0,0], p[2,0,0,0,0,1], 0.25), p[0.5,0,0,0,0,0.25]) < \
         0.000000001",
        "True",
    ),
    (
        "norm(rpy2rotvec([0, 0, 1]) - [0, 0, 1]) + norm(rotvec2rpy([0, 1, 0]) - [0, 1, 0]) < 0.000000001",
        "True",
    ),
    ("norm(rotvec2rpy(rpy2rotvec([0.3, -0.2, 0.5])) - [0.3, -0.2, 0.5]) < 0.000000001", "True"),
    // A force along x seen from 1 m along y is also a torque about z.
    ("norm(wrench_trans(p[0,1,0,0,0,0], [1,0,0,0,0,0]) - [1,0,0,0,0,1]) < 0.000000001", "True"),
    // State of an arm at rest.
    ("is_steady()", "True"),
    ("get_steptime()", "0.002"),
    ("norm(get_actual_joint_positions() - get_target_joint_positions()) == 0", "True"),
    ("norm(get_joint_positions() - get_actual_joint_positions_history(5)) == 0", "True"),
    (
        "pose_dist(get_forward_kin(), get_actual_tcp_pose()) + pose_dist(get_target_tcp_pose(), \
         get_actual_tcp_pose()) < 0.000001",
        "True",
    ),
    ("pose_dist(get_target_tcp_pose_along_path(), get_target_waypoint()) < 0.000001", "True"),
    ("norm(get_inverse_kin(get_actual_tcp_pose()) - get_actual_joint_positions()) < 0.00001", "True"),
    (
        "get_inverse_kin_has_solution(get_actual_tcp_pose()) and not \
         get_inverse_kin_has_solution(p[9,0,0,0,0,0])",
        "True",
    ),
    // The tool's speed is the Jacobian times that of the joints.
    ("abs((get_jacobian() * [1,0,0,0,0,0])[0] + get_actual_tcp_pose()[1]) < 0.000001", "True"),
    ("size(get_jacobian_time_derivative())", "[6, 6]"),
    (
        "abs(get_jacobian_time_derivative(get_actual_joint_positions(), [1,0,0,0,0,0])[0, 0] + \
         get_actual_tcp_pose()[0]) < 0.00001",
        "True",
    ),
    ("get_freedrive_status()", "0"),
    // Registers, inputs and outputs.
    ("[read_input_integer_register(30), read_input_float_register(31)]", "[-7, 2.5]"),
    ("read_input_boolean_register(70)", "True"),
    (
        "get_digital_in(3) and get_standard_digital_in(3) and get_configurable_digital_in(1) and \
         get_tool_digital_in(0)",
        "True",
    ),
    (
        "get_digital_in(4) or get_standard_digital_in(4) or get_configurable_digital_in(2) or \
         get_tool_digital_in(1)",
        "False",
    ),
];

/// Statements that change something, then an expression that shows it.
const CHANGES: &[(&str, &str, &str)] = &[
    ("encoder_enable_set_tick_count(0, 2)", "encoder_unwind_delta_tick_count(0, -65530)", "6"),
    ("encoder_enable_pulse_decode(1, 1, 8, 9)", "encoder_unwind_delta_tick_count(1, -65530)", "6"),
    ("encoder_set_tick_count(0, 77)", "encoder_get_tick_count(0, opt=\"raw\")", "77"),
    ("set_conveyor_tick_count(300, 2)", "encoder_get_tick_count(0, opt=\"raw\")", "300"),
    ("set_digital_out(2, True)", "get_digital_out(2) and get_standard_digital_out(2)", "True"),
    ("set_standard_digital_out(2, False)", "get_digital_out(2)", "False"),
    ("set_configurable_digital_out(5, True)", "get_configurable_digital_out(5)", "True"),
    ("set_tool_digital_out(1, True)", "get_tool_digital_out(1)", "True"),
    ("set_analog_out(0, 0.25)", "[get_analog_out(0), get_standard_analog_out(0)]", "[0.25, 0.25]"),
    ("set_standard_analog_out(1, 0.5)", "get_analog_out(1)", "0.5"),
    ("set_flag(4, True)", "get_flag(4)", "True"),
    ("write_output_integer_register(5, -3)", "read_output_integer_register(5)", "-3"),
    ("write_output_float_register(6, 1.5)", "read_output_float_register(6)", "1.5"),
    ("write_output_boolean_register(7, True)", "read_output_boolean_register(7)", "True"),
    ("set_tcp(p[0,0,0.125,0,0,0])", "get_tcp_offset()", "p[0, 0, 0.125, 0, 0, 0]"),
    (
        "set_tcp(p[0,0,0.125,0,0,0])",
        "abs(point_dist(get_actual_tool_flange_pose(), get_actual_tcp_pose()) - 0.125) < 0.000001",
        "True",
    ),
    // Where it was sent, not where it says that it is.
    (
        "movej([0.1,-1.5,1.4,-1.5,-1.5,0.2], a=3, v=2)",
        "norm(get_target_joint_positions() - [0.1,-1.5,1.4,-1.5,-1.5,0.2]) < 0.000001",
        "True",
    ),
    (
        "movej(p[-0.3,-0.4,0.4,0,3.14,0], a=3, v=2)",
        "pose_dist(get_target_tcp_pose(), p[-0.3,-0.4,0.4,0,3.14,0]) < 0.000001",
        "True",
    ),
    ("set_payload(1.5, [0, 0, 0.25])", "get_target_payload()", "1.5"),
    ("set_payload_cog([0, 0.5, 0])", "get_target_payload_cog()", "[0, 0.5, 0]"),
    ("set_payload_mass(2.5)", "get_target_payload()", "2.5"),
    (
        "set_target_payload(1, [0, 0, 0], [1, 2, 3, 0, 0, 0])",
        "get_target_payload_inertia()",
        "[1, 2, 3, 0, 0, 0]",
    ),
    ("set_base_acceleration([1, 0, 0])", "get_base_acceleration()", "[1, 0, 0]"),
    (
        "set_target_payload(1, [0, 0, 0], [1, 2, 3, 0, 0, 0]) set_payload(1)",
        "norm(get_target_payload_inertia())",
        "0",
    ),
    (
        "l = make_list(1, 5, 3) l.append(6) l.insert(0, 4)",
        "[l.length(), l.capacity(), l.excess_capacity(), l[0]]",
        "[3, 3, 0, 4]",
    ),
    ("set_gravity([0, 5, 0])", "get_gravity()", "[0, 5, 0]"),
];

/// What takes time, moves, ends the program or needs a peer: the test that judges it.
const ELSEWHERE: &[(&str, &str)] = &[
    ("movej", "a_move_arrives_and_the_program_ends"),
    ("movel", "tool_moves_take_poses_and_joints_and_reach_what_the_client_sees"),
    ("movep", "process_moves_round_their_corners_at_constant_speed"),
    ("movec", "a_circle_is_driven_at_its_speed_and_ends_at_its_target"),
    ("speedj", "a_timed_speed_leads_as_far_at_half_the_slider_and_takes_twice_as_long"),
    ("speedl", "contact_is_felt_and_the_way_back_is_remembered"),
    ("get_actual_joint_speeds", "speeds_are_reported_while_the_arm_speeds_up"),
    ("get_target_joint_speeds", "speeds_are_reported_while_the_arm_speeds_up"),
    ("get_target_joint_accelerations", "speeds_are_reported_while_the_arm_speeds_up"),
    ("get_actual_tcp_speed", "speeds_are_reported_while_the_arm_speeds_up"),
    ("get_target_tcp_speed", "speeds_are_reported_while_the_arm_speeds_up"),
    ("get_target_tcp_speed_along_path", "speeds_are_reported_while_the_arm_speeds_up"),
    ("path_offset_disable", "a_standing_arm_follows_its_offset_and_jerks_stop_it"),
    ("path_offset_get", "a_standing_arm_follows_its_offset_and_jerks_stop_it"),
    ("path_offset_set_alpha_filter", "a_standing_arm_follows_its_offset_and_jerks_stop_it"),
    ("stopj", "a_killed_motion_brakes_by_itself_and_stopj_takes_it_over"),
    ("stopl", "contact_is_felt_and_the_way_back_is_remembered"),
    ("textmsg", "programs_report_their_start_and_end"),
    ("popup", "a_blocking_popup_waits_until_it_is_closed"),
    ("protective_stop", "scripts_stop_the_arm_and_cut_its_power"),
    ("set_tool_voltage", "scripts_set_what_clients_see_of_the_tool_and_the_analog_outputs"),
    ("set_analog_outputdomain", "scripts_set_what_clients_see_of_the_tool_and_the_analog_outputs"),
    ("rtde_set_watchdog", "a_watchdog_acts_when_its_client_falls_silent"),
    ("sync", "a_script_and_rtde_exchange_registers"),
    ("assert", "a_false_assertion_ends_the_program_and_sleep_takes_its_time"),
    ("sleep", "a_false_assertion_ends_the_program_and_sleep_takes_its_time"),
    ("socket_open", "a_refused_connection_and_a_closed_peer_are_values_not_exceptions"),
    ("socket_close", "every_way_of_sending_arrives_as_documented"),
    ("socket_read_binary_integer", "every_way_of_reading_takes_its_part_of_the_stream"),
    ("socket_read_byte_list", "every_way_of_reading_takes_its_part_of_the_stream"),
    ("socket_read_ascii_float", "every_way_of_reading_takes_its_part_of_the_stream"),
    ("socket_read_string", "every_way_of_reading_takes_its_part_of_the_stream"),
    ("socket_read_line", "every_way_of_reading_takes_its_part_of_the_stream"),
    ("socket_send_int", "every_way_of_sending_arrives_as_documented"),
    ("socket_send_byte", "every_way_of_sending_arrives_as_documented"),
    ("socket_send_string", "every_way_of_sending_arrives_as_documented"),
    ("socket_send_line", "every_way_of_sending_arrives_as_documented"),
    ("socket_get_var", "a_variable_is_requested_and_answered"),
    ("socket_set_var", "every_way_of_sending_arrives_as_documented"),
];

/// An arm whose clients have set inputs.
fn prepared() -> Controller {
    let mut controller = running();
    let registers = &mut controller.core.registers;
    registers.input_ints[30] = -7;
    registers.input_doubles[31] = 2.5;
    registers.input_bits[70] = true;
    // Standard input 3, configurable input 1, tool input 0.
    registers.digital_inputs = 1 << 3 | 1 << 9 | 1 << 16;
    controller
}

#[test]
fn real_built_ins_do_what_the_manual_says() {
    let lines = LINES.iter().map(|(expression, expected)| (String::new(), *expression, *expected));
    let changes =
        CHANGES.iter().map(|(change, expression, expected)| (format!(" {change}\n"), *expression, *expected));
    let mut wrong = Vec::new();
    for (change, expression, expected) in lines.chain(changes) {
        let mut controller = prepared();
        // A change is seen by the frame after it; an arm is steady after a while.
        upload(&mut controller, &format!("def judge():\n{change} sleep(1)\n textmsg({expression})\nend\n"));
        controller.frame();
        step_until(&mut controller, stopped);
        let said = messages(&mut controller);
        if !said.contains(&format!("text:{expected}")) {
            wrong.push(format!("{change} {expression}: {said:?}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn speeds_are_reported_while_the_arm_speeds_up() {
    // Half a second at 0.1 rad/s2 about the base: along the circle the tool is on.
    let script = "def s():\n speedj([1,0,0,0,0,0], 0.1, 0.5)\n qd = get_actual_joint_speeds()\n \
                  v = get_actual_tcp_speed()\n textmsg(abs(qd[0] - 0.05) < 0.001)\n \
                  textmsg(norm(qd - get_target_joint_speeds()) == 0)\n \
                  textmsg(abs(get_target_joint_accelerations()[0] - 0.1) < 0.000001)\n \
                  textmsg(abs(v[0] + qd[0] * get_actual_tcp_pose()[1]) < 0.00001 and abs(v[5] - qd[0]) < \
                  0.000001)\n \
                  textmsg(norm(v - get_target_tcp_speed()) + norm(v - get_target_tcp_speed_along_path()) == \
                  0)\nend\n";
    let mut controller = running();
    upload(&mut controller, script);
    controller.frame();
    step_until(&mut controller, stopped);
    let said = messages(&mut controller);
    assert_eq!(said.iter().filter(|text| *text == "text:True").count(), 5, "{said:?}");
}

#[test]
fn a_false_assertion_ends_the_program_and_sleep_takes_its_time() {
    let mut controller = running();
    upload(
        &mut controller,
        "def a():\n assert(True)\n sleep(0.5)\n assert(1 > 2, \"no\")\n textmsg(1)\nend\n",
    );
    controller.frame();
    let frames = step_until(&mut controller, stopped);
    assert!((249..=251).contains(&frames), "{frames}");
    let said = messages(&mut controller);
    assert!(
        said.iter().any(|text| text.contains("assertion failed: no")) && !said.contains(&"text:1".into())
    );
}

#[test]
fn a_program_that_pauses_goes_on_behind_it_when_it_is_played() {
    let mut controller = running();
    upload(&mut controller, "def p():\n textmsg(1)\n pause\n textmsg(2)\nend\n");
    step_until(&mut controller, |c| c.programs.paused());
    (0..50).for_each(|_| controller.frame());
    assert!(!messages(&mut controller).contains(&"text:2".into()));
    assert!(controller.programs.play(&mut controller.core));
    step_until(&mut controller, stopped);
    assert!(messages(&mut controller).contains(&"text:2".into()));
}

#[test]
fn scripts_stop_the_arm_and_cut_its_power() {
    let mut controller = running();
    upload(&mut controller, "def s():\n protective_stop()\n sleep(1)\nend\n");
    step_until(&mut controller, |c| c.core.modes.safety_mode() == SafetyMode::ProtectiveStop);
    assert_eq!(messages(&mut controller), ["STARTED:s", "C209", "safety 3"]);
    let mut controller = running();
    upload(&mut controller, "def p():\n powerdown()\n sleep(1)\nend\n");
    step_until(&mut controller, |c| !c.core.modes.powered());
}

#[test]
fn scripts_set_what_clients_see_of_the_tool_and_the_analog_outputs() {
    let mut controller = running();
    upload(&mut controller, "def v():\n set_tool_voltage(12)\n set_analog_outputdomain(1, 1)\nend\n");
    controller.frame();
    step_until(&mut controller, stopped);
    assert_eq!(controller.core.registers.tool_voltage, 12);
    assert_eq!(controller.core.registers.analog_output_voltage, [false, true]);
}

/// All sources below a folder, as one text.
fn sources(folder: &Path, text: &mut String) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, text);
        } else {
            text.push_str(&std::fs::read_to_string(&path).unwrap());
        }
    }
}

#[test]
fn every_real_built_in_has_a_judge() {
    let mut tests = String::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    ["src", "../urscript/src"].into_iter().for_each(|folder| sources(&root.join(folder), &mut tests));
    let calls = |text: &str, name: &str| {
        text.match_indices(&format!("{name}("))
            .any(|(at, _)| !text[..at].ends_with(|before: char| before.is_alphanumeric() || before == '_'))
    };
    for (name, test) in ELSEWHERE {
        let body = tests.split(&format!("fn {test}()")).nth(1).and_then(|rest| rest.split("\n}\n").next());
        let body = body.unwrap_or_else(|| panic!("{name}: there is no test {test}"));
        // In a nested string the line before ends in `n`: " sleep(" or "\\nsleep(".
        assert!(calls(&body.replace("\\n", "\n"), name), "{test} does not call {name}");
    }
    for entry in builtins::all().iter().filter(|entry| entry.grade == builtins::Grade::Real) {
        let name = entry.builtin.name;
        let here = LINES.iter().any(|(line, _)| calls(line, name))
            || CHANGES.iter().any(|(change, expression, _)| calls(change, name) || calls(expression, name));
        let elsewhere = ELSEWHERE.iter().any(|(known, _)| *known == name);
        assert!(here || elsewhere, "{name} is called real and nothing judges it");
    }
}
