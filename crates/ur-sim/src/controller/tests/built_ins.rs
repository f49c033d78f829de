//! What the built-ins of motion, force and settings do to the arm, and what they give back.

use super::*;
use crate::controller::robot_state::control_mode;
use std::f64::consts::PI;

/// Runs a script to its end and gives what it said by `textmsg`.
#[track_caller]
fn said(script: &str) -> Vec<String> {
    let mut controller = running();
    upload(&mut controller, script);
    controller.frame();
    step_until(&mut controller, stopped);
    let all = messages(&mut controller);
    all.into_iter().filter(|m| !m.starts_with("STARTED") && !m.starts_with("STOPPED")).collect()
}

#[test]
fn a_circle_is_driven_at_its_speed_and_ends_at_its_target() {
    let mut controller = running();
    let script = "def c():\n a = get_actual_tcp_pose()\n \
                  movec(pose_add(a, p[0.05,0.05,0,0,0,0]), pose_add(a, p[0,0.1,0,0,0,0]), a=2, v=0.2)\n \
                  textmsg(pose_dist(get_actual_tcp_pose(), pose_add(a, p[0,0.1,0,0,0,0])) < 0.000001)\nend\n";
    upload(&mut controller, script);
    controller.frame();
    let start = controller.core.mover.arm.tcp(&controller.core.config.start).translation.vector;
    let mut fastest = 0.0f64;
    while !stopped(&controller) {
        controller.frame();
        let at = controller.core.mover.tcp().translation.vector;
        let radius = (at - start - nalgebra::Vector3::new(0.0, 0.05, 0.0)).norm();
        assert!((radius - 0.05).abs() < 1e-6, "{radius}");
        fastest = fastest.max(controller.core.mover.tcp_speed().fixed_rows::<3>(0).norm());
    }
    assert!((fastest - 0.2).abs() < 2e-3, "{fastest}");
    assert!(messages(&mut controller).contains(&"text:True".to_owned()));
}

#[test]
fn process_moves_round_their_corners_at_constant_speed() {
    let mut controller = running();
    let script = "def p():\n a = get_actual_tcp_pose()\n movep(pose_add(a, p[0.1,0,0,0,0,0]), a=2, v=0.2, \
                  r=0.03)\n \
                  movep(pose_add(a, p[0.1,0.1,0,0,0,0]), a=2, v=0.2, r=0.03)\n \
                  movep(pose_add(a, p[0,0.1,0.05,0,0,0]), a=2, v=0.2)\nend\n";
    upload(&mut controller, script);
    controller.frame();
    let start = controller.core.mover.arm.tcp(&controller.core.config.start).translation.vector;
    let position = |c: &Controller| c.core.mover.tcp().translation.vector - start;
    step_until(&mut controller, |c| position(c).x > 0.03);
    let mut nearest = f64::INFINITY;
    while position(&controller).y < 0.06 {
        controller.frame();
        let speed = controller.core.mover.tcp_speed().fixed_rows::<3>(0).norm();
        assert!((speed - 0.2).abs() < 4e-3, "{speed} m/s at {}", position(&controller));
        nearest = nearest.min((position(&controller) - nalgebra::Vector3::new(0.1, 0.0, 0.0)).norm());
    }
    // An arc of radius 0.03 passes its corner at 0.03 (sqrt 2 - 1).
    assert!((nearest - 0.03 * (2f64.sqrt() - 1.0)).abs() < 1.5e-3, "{nearest}");
    step_until(&mut controller, stopped);
    assert!((position(&controller) - nalgebra::Vector3::new(0.0, 0.1, 0.05)).norm() < 1e-6);
}

#[test]
fn the_tool_is_slowed_down_to_the_safety_configurations_speed() {
    let mut controller = running();
    controller.core.set_tcp([0.0, 0.0, 0.3, 0.0, 0.0, 0.0]);
    upload(
        &mut controller,
        "def f():\n movej([0,-0.4,0.2,-1.57,-1.57,0])\n movej([2,-0.4,0.2,-1.57,-1.57,0], a=10, v=3)\nend\n",
    );
    controller.frame();
    let mut fastest = 0.0f64;
    while !stopped(&controller) {
        controller.frame();
        fastest = fastest.max(controller.core.mover.tcp_speed().fixed_rows::<3>(0).norm());
    }
    assert!((1.45..1.53).contains(&fastest), "{fastest} m/s");
    assert_eq!(controller.core.mover.q().0[0], 2.0);
    assert!(!controller.core.modes.protective_stopped());
}

#[test]
fn optimal_moves_take_shares_and_refuse_more_than_all() {
    assert!(
        said(
            "def o():\n optimovej([0.5,-1.57,1.57,-1.57,-1.57,0], a=0.5, v=0.5)\n \
                  optimovel(pose_trans(get_actual_tcp_pose(), p[0,0,-0.05,0,0,0]), 0.3, 0.3)\nend\n"
        )
        .is_empty()
    );
    let refused = said("def o():\n optimovej([0.5,-1.57,1.57,-1.57,-1.57,0], a=1.4, v=1.05)\nend\n");
    assert!(refused[0].contains("1.4 is not a share"), "{refused:?}");
}

#[test]
fn optimal_moves_came_to_polyscope_x_with_10_8() {
    for (minor, refused) in [(7, true), (8, false)] {
        let mut controller = running();
        controller.core.pendant.pretend_version(Some([10, minor, 0, 0]));
        upload(&mut controller, "def o():\n optimovej([0.5,-1.57,1.57,-1.57,-1.57,0], 0.5, 0.5)\nend\n");
        controller.frame();
        step_until(&mut controller, stopped);
        let said = messages(&mut controller);
        let refusal = said.iter().any(|message| message.contains("not there before software 10.8"));
        assert_eq!(refusal, refused, "{said:?}");
    }
}

#[test]
fn torque_accelerates_and_silence_brakes() {
    let mut controller = running();
    upload(
        &mut controller,
        "def t():\n i = 0\n while i < 100:\n  direct_torque([5,0,0,0,0,0])\n  i = i + 1\n end\n sleep(1)\n \
         textmsg(is_steady())\nend\n",
    );
    (0..100).for_each(|_| controller.frame());
    // 5 Nm move an inertia of about 1 kg m2 for 0.2 s, less what friction and the other joints take.
    let speed = controller.core.mover.qd()[0];
    assert!((0.4..1.2).contains(&speed), "{speed} rad/s");
    assert!(!controller.core.modes.protective_stopped());
    step_until(&mut controller, stopped);
    assert!(messages(&mut controller).contains(&"text:True".to_owned()));
}

/// A wall at `height` (m) with a spring of 20 kN/m under the tool.
fn press(controller: &mut Controller, height: f64) {
    let depth = height - controller.core.mover.tcp().translation.z;
    controller.core.sensing.set_contact_wrench([0.0, 0.0, (depth * 20_000.0).max(0.0), 0.0, 0.0, 0.0]);
}

#[test]
fn force_mode_runs_at_its_limit_in_the_air_and_rests_at_its_force_on_a_wall() {
    let mut controller = running();
    upload(
        &mut controller,
        "def f():\n force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-20,0,0,0], 2, \
         [0.1,0.1,0.05,0.5,0.5,0.5])\n \
         sleep(4)\n end_force_mode()\n sleep(1)\nend\n",
    );
    let start = controller.core.mover.tcp().translation.z;
    let step = |controller: &mut Controller, frames: u32| {
        for _ in 0..frames {
            press(controller, start - 0.05);
            controller.frame();
        }
    };
    step(&mut controller, 250);
    assert_eq!(control_mode(&controller), 2, "force");
    let speed = controller.core.mover.tcp_speed();
    assert!((speed[2] + 0.05).abs() < 1e-3 && speed.fixed_rows::<2>(0).norm() < 1e-3, "{speed}");
    step(&mut controller, 1500);
    assert!((controller.core.tcp_force()[2] - 20.0).abs() < 0.5, "{:?}", controller.core.tcp_force());
    assert!(controller.core.mover.tcp_speed().norm() < 1e-3);
    let torque = controller.core.joint_moments();
    assert!(torque.iter().all(|value| value.is_finite()));
    step(&mut controller, 800);
    assert!(stopped(&controller) || controller.core.compliance.is_none());
}

#[test]
fn freedrive_follows_a_push_on_its_free_axes_and_stands_without_one() {
    let mut controller = running();
    upload(
        &mut controller,
        "def f():\n freedrive_mode([1,0,0,0,0,0])\n sleep(5)\n end_freedrive_mode()\nend\n",
    );
    (0..100).for_each(|_| controller.frame());
    assert!(controller.core.mover.stands());
    controller.core.sensing.set_contact_wrench([10.0, 10.0, 10.0, 0.0, 0.0, 0.0]);
    (0..300).for_each(|_| controller.frame());
    let speed = controller.core.mover.tcp_speed();
    assert!(speed[0] > 0.01 && speed[1].abs() < 1e-4 && speed[2].abs() < 1e-4, "{speed}");
    controller.programs.stop(&mut controller.core);
    controller.core.sensing.set_contact_wrench([0.0; 6]);
    step_until(&mut controller, |c| c.core.mover.stands());
}

#[test]
fn contact_is_felt_and_the_way_back_is_remembered() {
    let mut controller = running();
    let script = "def c():\n speedl([0,0,-0.05,0,0,0], 0.5, 0.4)\n while \
                  tool_contact(get_target_tcp_speed()) == 0:\n  \
                  speedl([0,0,-0.05,0,0,0], 0.5, 0.002)\n end\n back = tool_contact()\n q = \
                  get_actual_joint_positions_history(back)\n \
                  stopl(3)\n movel(q)\n textmsg(force() > 10)\nend\n";
    upload(&mut controller, script);
    let start = controller.core.mover.tcp().translation.z;
    while !stopped(&controller) || controller.core.step < 5 {
        press(&mut controller, start - 0.03);
        controller.frame();
        assert!(controller.core.step < 5000, "no contact");
    }
    assert_eq!(messages(&mut controller)[1], "text:False", "back where the contact began");
    let height = controller.core.mover.tcp().translation.z;
    assert!((height - (start - 0.03)).abs() < 5e-4, "{}", height - start);
}

#[test]
fn matrices_and_state_have_their_shapes_and_meaning() {
    let script = "def m():\n j = get_jacobian()\n textmsg(size(j))\n textmsg(size(get_mass_matrix()))\n \
                  textmsg(size(get_jacobian_time_derivative()))\n \
                  textmsg(get_list_length(get_coriolis_and_centrifugal_torques()))\n \
                  x = get_target_waypoint()\n textmsg(pose_dist(x, get_actual_tcp_pose()) < 0.000001)\n \
                  textmsg(get_freedrive_status())\n \
                  textmsg(norm(get_joint_torques()) < 0.000001)\n \
                  textmsg(norm(get_tool_accelerometer_reading() - get_gravity()) > 1)\nend\n";
    let expected = ["[6, 6]", "[6, 6]", "[6, 6]", "6", "True", "0", "True", "True"];
    assert_eq!(said(script), expected.map(|text| format!("text:{text}")));
}

#[test]
fn a_blocking_popup_waits_until_it_is_closed() {
    let mut controller = running();
    upload(
        &mut controller,
        "def p():\n popup(\"look\")\n popup(\"wait\", blocking=True)\n textmsg(\"on\")\nend\n",
    );
    (0..100).for_each(|_| controller.frame());
    assert_eq!(controller.core.popup.as_deref(), Some("wait"));
    assert!(!stopped(&controller));
    controller.core.popup = None;
    step_until(&mut controller, stopped);
    assert!(messages(&mut controller).contains(&"text:on".to_owned()));
}

#[test]
fn settings_are_kept_and_unknown_ones_refused() {
    let script = "def s():\n set_flag(3, True)\n textmsg(get_flag(3))\n write_port_register(128, 7)\n \
                  textmsg(read_port_register(128))\n \
                  modbus_add_signal(\"1.2.3.4\", 255, 5, 0, \"valve\")\n \
                  modbus_set_output_signal(\"valve\", True)\n \
                  textmsg(modbus_get_signal_status(\"valve\"))\n encoder_enable_set_tick_count(0, 2)\n textmsg(encoder_unwind_delta_tick_count(0, \
                  -65530))\n \
                  set_standard_digital_input_action(0, \"default\")\n set_tool_communication(True, 115200, \
                  1, 1, 1.0, 3.5)\n \
                  get_flag(99)\nend\n";
    assert_eq!(
        said(script),
        ["text:True", "text:7", "text:1", "text:6", "exception 13:2 get_flag: there is no flag 99"]
    );
}

/// 2 ticks a frame, 10000 ticks a metre: a belt at 0.1 m/s along y.
const BELT: &str = "def b():\n thread feed():\n  n = 0\n  while True:\n   encoder_set_tick_count(0, n)\n   n = \
                    n + 2\n   sync()\n  end\n end\n encoder_enable_set_tick_count(0, 0)\n \
                    encoder_set_tick_count(0, 0)\n run feed()\n sleep(1)\n \
                    track_conveyor_linear(p[0,2,0,0,0,0], 10000)\n a = get_target_tcp_pose_along_path()\n \
                    movel(pose_add(a, p[0,0,0.05,0,0,0]))\n sleep(1)\n \
                    textmsg(pose_dist(get_target_tcp_pose_along_path(), pose_add(a, p[0,0,0.05,0,0,0])) < \
                    0.000001)\n set_digital_out(1, True)\n stop_conveyor_tracking(10)\nend\n";

#[test]
fn moves_are_carried_along_by_the_conveyor_until_it_is_left() {
    let mut controller = running();
    upload(&mut controller, BELT);
    controller.frame();
    let start = controller.core.mover.tcp().translation.vector;
    step_until(&mut controller, |c| c.core.mover.tracks());
    let began = controller.core.step;
    step_until(&mut controller, |c| c.core.registers.digital_outputs & 2 != 0);
    let seconds = (controller.core.step - began) as f64 * 0.002;
    let moved = controller.core.mover.tcp().translation.vector - start;
    // The filtered count lags behind no steady motion.
    assert!((moved - nalgebra::Vector3::new(0.0, 0.1 * seconds, 0.05)).norm() < 1e-3, "{moved} {seconds}");
    step_until(&mut controller, stopped);
    assert!(controller.core.mover.stands() && !controller.core.mover.tracks());
    assert!(messages(&mut controller).contains(&"text:True".to_owned()));
    assert_eq!(controller.core.settings.encoders[0].raw() % 2, 0);
}

#[test]
fn an_arm_that_is_held_stays_behind_the_conveyor_and_goes_on_from_there() {
    let mut controller = running();
    upload(&mut controller, BELT);
    controller.frame();
    let speed = |c: &Controller| c.core.mover.tcp_speed()[1];
    step_until(&mut controller, |c| (speed(c) - 0.1).abs() < 1e-4);
    controller.protective_stop("test");
    (0..500).for_each(|_| controller.frame());
    let stood = controller.core.mover.tcp().translation.vector;
    controller.frame();
    assert_eq!(controller.core.mover.tcp().translation.vector, stood);
    controller.unlock_at_once();
    let Controller { core, programs } = &mut controller;
    assert!(programs.play(core));
    let mut fastest = 0.0f64;
    while !stopped(&controller) {
        controller.frame();
        fastest = fastest.max(speed(&controller));
    }
    assert!((0.09..0.11).contains(&fastest), "{fastest}");
}

#[test]
fn a_program_that_ends_leaves_its_round_conveyor() {
    let mut controller = running();
    let script = "def c():\n set_conveyor_tick_count(0)\n n = 0\n \
                  track_conveyor_circular(p[0,0,0,0,0,0], 1000, True)\n while n < 125:\n  n = n + 1\n  \
                  set_conveyor_tick_count(n)\n  sleep(0.008)\n end\n sleep(1)\nend\n";
    upload(&mut controller, script);
    controller.frame();
    let start = controller.core.mover.tcp();
    step_until(&mut controller, stopped);
    (0..100).for_each(|_| controller.frame());
    assert!(!controller.core.mover.tracks() && controller.core.mover.stands());
    // An eighth of a revolution about the base.
    let turn = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), PI / 4.0);
    let at = controller.core.mover.tcp();
    assert!((at.translation.vector - turn * start.translation.vector).norm() < 1e-3, "{at}");
    assert!(at.rotation.angle_to(&(turn * start.rotation)) < 1e-3);
}

#[test]
fn pulses_of_a_conveyor_that_runs_are_decoded_and_tracked() {
    let mut config = running().core.config;
    config.encoders = [0.0, 1000.0];
    let mut controller = Controller::new(config);
    let script = "def p():\n encoder_enable_pulse_decode(1, 1, 8, 9)\n sleep(1)\n textmsg(abs(\
                  encoder_get_tick_count(1) - 1000) < 5)\n track_conveyor_linear(p[1,0,0,0,0,0], 20000, 1)\n \
                  sleep(2)\n set_digital_out(1, True)\n sleep(1)\nend\n";
    upload(&mut controller, script);
    controller.frame();
    let start = controller.core.mover.tcp().translation.vector;
    step_until(&mut controller, |c| c.core.registers.digital_outputs & 2 != 0);
    let moved = controller.core.mover.tcp().translation.vector - start;
    assert!((moved - nalgebra::Vector3::new(0.1, 0.0, 0.0)).norm() < 1e-3, "{moved}");
    assert!(messages(&mut controller).contains(&"text:True".to_owned()));
}

#[test]
fn a_conveyor_is_counted_while_the_arm_has_no_power() {
    let mut config = running().core.config;
    config.encoders = [0.0, 1000.0];
    let mut controller = Controller::new(config);
    let script = "def p():\n encoder_enable_pulse_decode(1, 1, 8, 9)\nend\n";
    upload(&mut controller, script);
    controller.frame();
    step_until(&mut controller, stopped);
    let before = controller.core.settings.encoders[1].raw();
    controller.power_off();
    (0..500).for_each(|_| controller.frame());
    let counted = controller.core.settings.encoders[1].raw() - before;
    assert!((999..=1001).contains(&counted), "{counted}");
}

#[test]
fn values_that_become_text_are_bounded() {
    let long =
        "s = \"x\"\n i = 0\n while i < 16:\n  s = str_cat(s, s)\n  i = i + 1\n end\n l = make_list(1000, s)";
    assert_eq!(said(&format!("def t():\n {long}\n textmsg(l, l)\nend\n")), ["text:[...][...]"]);
    for call in ["socket_send_string", "socket_send_line"] {
        let refused = said(&format!("def t():\n {long}\n {call}(l)\nend\n"));
        assert!(refused[0].ends_with("too long"), "{refused:?}");
    }
}

#[test]
fn a_secondary_program_that_would_wait_leaves_the_main_one_its_move_and_its_connections() {
    let mut controller = running();
    upload(&mut controller, "def m():\n movej([1,-1.57,1.57,-1.57,-1.57,0])\nend\n");
    (0..10).for_each(|_| controller.frame());
    let owner = controller.core.owner;
    assert!(owner.is_some());
    upload(&mut controller, "sec s():\n popup(\"wait\", blocking=True)\nend\n");
    controller.frame();
    assert_eq!(controller.core.owner, owner);
    messages(&mut controller);
    let call = "sec s():\n r = rpc_factory(\"xmlrpc\", \"http://127.0.0.1:1/RPC2\")\n r.f()\nend\n";
    upload(&mut controller, call);
    controller.frame();
    let said = messages(&mut controller);
    assert!(said[0].contains("a secondary program must not wait"), "{said:?}");
}

#[test]
fn what_is_no_conveyor_or_encoder_is_refused() {
    for (call, refusal) in [
        ("track_conveyor_linear(p[0,0,0,1,0,0], 1000)", "a conveyor has a direction"),
        ("track_conveyor_linear(p[1,0,0,0,0,0], 0)", "0 ticks are no measure"),
        ("track_conveyor_circular(p[1,0,0,0,0,0], 10, False, 2)", "there is no encoder 2"),
        ("encoder_enable_pulse_decode(0, 1, 8, 12)", "pin 12 takes no pulses"),
        ("encoder_enable_pulse_decode(0, 5, 8, 9)", "there is no decoder 5"),
        ("encoder_enable_set_tick_count(0, 5)", "there is no range 5"),
        ("set_conveyor_tick_count(256, 1)", "out of the encoder's range"),
        ("stop_conveyor_tracking(0)", "an acceleration is positive"),
    ] {
        let said = said(&format!("def r():\n {call}\nend\n"));
        assert!(said.len() == 1 && said[0].contains(refusal), "{call}: {said:?}");
    }
    assert_eq!(said("def r():\n conveyor_pulse_decode(0, 0)\n stop_conveyor_tracking()\nend\n"), [""; 0]);
}

#[test]
fn other_models_have_their_reach_and_their_name() {
    let config = |name: &str| {
        let model = ARM_MODELS.iter().find(|model| model.name == name).unwrap();
        ControllerConfig { running: true, ..ControllerConfig::of(model, 3) }
    };
    let mut controller = Controller::new(config("UR10e"));
    upload(
        &mut controller,
        "def r():\n textmsg(get_inverse_kin_has_solution(p[-1.1,-0.17,0.3,0,3.14,0]))\n \
         movej([2,-1.57,1.57,-1.57,-1.57,0], a=10, v=3)\nend\n",
    );
    controller.frame();
    let mut fastest = 0.0f64;
    while !stopped(&controller) {
        controller.frame();
        fastest = fastest.max(controller.core.mover.qd()[0]);
    }
    assert!(messages(&mut controller).contains(&"text:True".to_owned()));
    assert!(fastest <= 120.0 / 180.0 * PI + 1e-9, "{fastest} rad/s");
    assert_eq!(controller.core.config.model, "UR10");
}

/// The script manual's example: a cosine across a line, 5 mm wide.
const WEAVE: &str = "def w():\n thread weave():\n  p = 0\n  while True:\n   p = p + 4 * 3.14159 / 500\n   \
                     path_offset_set([0,0,0.005*(cos(p)-1),0,0,0], 1)\n   sync()\n  end\n end\n \
                     path_offset_enable()\n run weave()\n a = get_target_tcp_pose_along_path()\n \
                     movel(pose_add(a, p[0,0.2,0,0,0,0]), v=0.1)\n \
                     textmsg(pose_dist(get_target_tcp_pose_along_path(), pose_add(a, p[0,0.2,0,0,0,0])) < \
                     0.000001)\n set_digital_out(1, True)\n path_offset_disable(10)\n textmsg(path_offset_get(1))\nend\n";

#[test]
fn a_weaving_offset_is_laid_over_a_move_and_left_at_its_end() {
    let mut controller = running();
    upload(&mut controller, WEAVE);
    let start = controller.core.mover.tcp().translation.vector;
    let (mut lowest, mut highest) = (0.0f64, f64::NEG_INFINITY);
    while controller.core.registers.digital_outputs & 2 == 0 {
        controller.frame();
        let at = controller.core.mover.tcp().translation.vector - start;
        (lowest, highest) = (lowest.min(at.z), highest.max(at.z));
        assert!(at.x.abs() < 1e-6, "{at}");
    }
    assert!((lowest + 0.01).abs() < 1e-4 && highest.abs() < 1e-6, "{lowest} {highest}");
    step_until(&mut controller, stopped);
    (0..500).for_each(|_| controller.frame());
    assert!(controller.core.mover.stands() && !controller.core.mover.is_offset());
    let said = messages(&mut controller);
    assert!(said.contains(&"text:True".to_owned()), "{said:?}");
    assert!(said.contains(&"text:p[0, 0, 0, 0, 0, 0]".to_owned()), "{said:?}");
}

#[test]
fn a_standing_arm_follows_its_offset_and_jerks_stop_it() {
    let script = |step: f64, filter: &str| {
        format!(
            "def o():\n path_offset_enable()\n {filter}\n path_offset_set([0,0,{step},0,0,0], 2)\n sleep(1)\n \
             textmsg(abs(path_offset_get(2)[2] - 0.05) < 0.00001)\n textmsg(abs(path_offset_get(1)[2] + 0.05) < 0.00001)\n path_offset_disable()\n textmsg(path_offset_get(2)[2])\nend\n"
        )
    };
    let mut controller = running();
    upload(&mut controller, &script(0.05, "path_offset_set_alpha_filter(0.02)"));
    let start = controller.core.mover.tcp().translation.vector;
    controller.frame();
    step_until(&mut controller, stopped);
    let moved = controller.core.mover.tcp().translation.vector - start;
    // The tool looks down.
    assert!((moved.z + 0.05).abs() < 1e-4, "{moved}");
    assert_eq!(messages(&mut controller)[1..4], ["text:True", "text:True", "text:0"]);
    let mut controller = running();
    upload(&mut controller, &script(0.05, ""));
    step_until(&mut controller, |c| c.core.modes.protective_stopped());
}

#[test]
fn offsets_and_conveyors_exclude_each_other_and_nonsense_is_refused() {
    for (statements, complaint) in [
        ("path_offset_enable()\n track_conveyor_linear(p[1,0,0,0,0,0], 100)", "a path offset is enabled"),
        ("track_conveyor_linear(p[1,0,0,0,0,0], 100)\n path_offset_enable()", "a conveyor is tracked"),
        ("path_offset_set([0,0,0,0,0,0], 5)", "there is no type 5"),
        ("path_offset_set_alpha_filter(1.1)", "not between 0 and 1"),
        ("path_offset_set_max_offset(-1, 0)", "are no limits"),
    ] {
        let said = said(&format!("def n():\n {statements}\nend\n"));
        assert!(said.iter().any(|text| text.contains(complaint)), "{statements}: {said:?}");
    }
}

#[test]
fn turns_of_an_endless_wrist_are_taken_back_and_others_have_none() {
    let script = "def r():\n movej([0,-1.57,1.57,-1.57,-1.57,14], a=20, v=6)\n reset_revolution_counter()\n textmsg(abs(get_actual_joint_positions()[5] - 1.4336) < 0.001)\n \
                  reset_revolution_counter([0,0,0,0,0,7])\n textmsg(abs(get_actual_joint_positions()[5] - 7.7168) < \
                  0.001)\nend\n";
    let ur3e = ARM_MODELS.iter().find(|model| model.name == "UR3e").unwrap();
    let config = ControllerConfig { running: true, ..ControllerConfig::of(ur3e, 3) };
    let mut controller = Controller::new(config);
    upload(&mut controller, script);
    controller.frame();
    step_until(&mut controller, stopped);
    let said = messages(&mut controller);
    assert_eq!(said.iter().filter(|text| *text == "text:True").count(), 2, "{said:?}");
    let mut controller = running();
    upload(&mut controller, script);
    controller.frame();
    step_until(&mut controller, stopped);
    assert!(messages(&mut controller)[1].contains("out of its range"), "a UR5e stops at a turn");
}
