//! The controller frame by frame: programs that run, move and fail; stops; the messages clients wait for.

use super::*;
use crate::controller::config::calibrated;
use crate::controller::registers::{ClientId, Input};
use crate::motion::safety::{SafetyLimits, SafetyPlane};
use cell_values::units::Joints;
use ur_arm::kinematics::{ARM_MODELS, DhParameters, forward};
use ur_wire::enumerations::{RobotMode, RuntimeState, SafetyMode};
use ur_wire::primary_message::{MessageBody, PROGRAM_STARTED, PROGRAM_STOPPED};
use ur_wire::rtde_values::Value;

mod blends;
mod built_ins;
mod interpreter;
mod judged;

fn running() -> Controller {
    Controller::new(ControllerConfig { running: true, ..ControllerConfig::ur5e(3) })
}

fn upload(controller: &mut Controller, text: &str) {
    assert!(controller.programs.upload(builtins::compile_program(text)));
}

/// Steps until `done`, at most a simulated minute.
#[track_caller]
fn step_until(controller: &mut Controller, done: impl Fn(&Controller) -> bool) -> u64 {
    let start = controller.core.step;
    while !done(controller) {
        controller.frame();
        assert!(controller.core.step - start < 30_000, "did not happen within a minute");
    }
    controller.core.step - start
}

fn stopped(controller: &Controller) -> bool {
    controller.programs.runtime_state() == RuntimeState::Stopped
}

/// The messages since the last call, one word each.
fn messages(controller: &mut Controller) -> Vec<String> {
    let one = |body: MessageBody| match body {
        MessageBody::Key { title, text, .. } => match title.as_str() {
            PROGRAM_STARTED => format!("STARTED:{text}"),
            PROGRAM_STOPPED => format!("STOPPED:{text}"),
            _ => format!("{title}:{text}"),
        },
        MessageBody::Text(text) => format!("text:{text}"),
        MessageBody::RuntimeException { line, column, text } => format!("exception {line}:{column} {text}"),
        MessageBody::Error { code, .. } => format!("C{code}"),
        MessageBody::SafetyMode { mode, .. } => format!("safety {mode}"),
        other => format!("{other:?}"),
    };
    controller.core.take_messages().into_iter().map(one).collect()
}

#[track_caller]
fn check(script: &str, expected: &[&str]) {
    let mut controller = running();
    upload(&mut controller, script);
    controller.frame();
    step_until(&mut controller, stopped);
    assert_eq!(messages(&mut controller), expected, "{script}");
}

#[test]
fn programs_report_their_start_and_end() {
    check("def hello():\n textmsg(\"x=\", 3)\nend\n", &["STARTED:hello", "text:x=3", "STOPPED:hello"]);
    check("textmsg(1)\n", &["STARTED:unnamed", "text:1", "STOPPED:unnamed"]);
    check(
        "def bad():\n  x = 1\n  y = [0][5]\nend\n",
        &["STARTED:bad", "exception 3:10 index 5 is out of range, the list has 1 elements", "STOPPED:bad"],
    );
    check("def f():\n  nowhere()\nend\n", &["exception 2:3 compile_error_name_not_found:nowhere:"]);
    check(
        "def f():\n  x = = 2\nend\n",
        &["exception 2:7 syntax_error_on_line:2:expected an expression, found `=`"],
    );
    check(
        "def f():\n  get_euromap_input(0)\nend\n",
        &["STARTED:f", "exception 2:3 get_euromap_input is not available in the simulation", "STOPPED:f"],
    );
}

#[test]
fn a_new_program_replaces_the_running_one() {
    let mut controller = running();
    upload(&mut controller, "def a():\n sleep(100)\nend\n");
    controller.frame();
    upload(&mut controller, "def b():\n sync()\nend\n");
    controller.frame();
    assert_eq!(messages(&mut controller), ["STARTED:a", "STOPPED:a", "STARTED:b"]);
    assert_eq!(controller.programs.name(), Some("b"));
}

#[test]
fn a_secondary_program_runs_beside_the_main_one() {
    let mut controller = running();
    upload(&mut controller, "def a():\n sleep(100)\nend\n");
    upload(&mut controller, "sec s():\n set_payload(1.5, [0, 0, 0.1])\nend\n");
    upload(&mut controller, "sec t():\n sync()\nend\n");
    controller.frame();
    assert_eq!(controller.core.payload.mass, 1.5);
    assert!(controller.programs.playing());
    let said = messages(&mut controller);
    assert_eq!(said[0], "STARTED:a");
    assert!(said[1].starts_with("exception 2:"), "{said:?}");
}

#[test]
fn a_move_arrives_and_the_program_ends() {
    let mut controller = running();
    let target = [0.2, -1.4, 1.5, -1.6, -1.5, 0.3];
    upload(
        &mut controller,
        &format!("def m():\n movej({target:?})\n write_output_integer_register(24, 7)\nend\n"),
    );
    controller.frame();
    step_until(&mut controller, stopped);
    assert_eq!(controller.core.mover.q().0, target);
    assert_eq!(controller.core.registers.output_ints[24], 7);
}

#[test]
fn tool_moves_take_poses_and_joints_and_reach_what_the_client_sees() {
    let mut controller = running();
    let script = "def m():\n set_tcp(p[0,0,0.2,0,0,0])\n a = get_actual_tcp_pose()\n \
                  b = pose_trans(a, p[0,0.05,-0.1,0,0,0])\n movel(b, v=0.5)\n \
                  textmsg(pose_dist(get_actual_tcp_pose(), b) < 0.000001)\n \
                  movel([0.1,-1.5,1.5,-1.57,-1.57,0], v=0.5)\nend\n";
    upload(&mut controller, script);
    controller.frame();
    step_until(&mut controller, stopped);
    assert_eq!(messages(&mut controller), ["STARTED:m", "text:True", "STOPPED:m"]);
    assert!(controller.core.mover.q().max_difference(&Joints([0.1, -1.5, 1.5, -1.57, -1.57, 0.0])) < 1e-6);
}

#[test]
fn kinematics_agree_both_ways() {
    check(
        "def k():\n q = [0.3,-1.2,1.7,-2.0,-1.4,0.6]\n x = get_forward_kin(q)\n \
         back = get_inverse_kin(x, q)\n textmsg(norm(back - q) < 0.000001)\n \
         textmsg(get_inverse_kin_has_solution(p[3,0,0,0,0,0]))\n get_inverse_kin(p[3,0,0,0,0,0])\nend\n",
        &[
            "STARTED:k",
            "text:True",
            "text:False",
            "exception 7:2 get_inverse_kin: unable to find an inverse kinematics solution",
            "STOPPED:k",
        ],
    );
}

#[test]
fn impossible_moves_stop_protectively_and_pause_the_program() {
    for script in ["movel(p[5,0,0,0,0,0])", "movec(p[0.3,0.1,0.4,0,0,0], p[5,0,0,0,0,0])"] {
        let mut controller = running();
        upload(&mut controller, &format!("def m():\n {script}\n sleep(1)\nend\n"));
        controller.frame();
        assert_eq!(controller.core.modes.safety_mode(), SafetyMode::ProtectiveStop, "{script}");
        assert_eq!(controller.programs.runtime_state(), RuntimeState::Paused);
        assert_eq!(messages(&mut controller), ["STARTED:m", "C204", "safety 3"]);
        assert!(controller.unlock_protective_stop().is_err());
        (0..2500).for_each(|_| controller.frame());
        assert!(controller.unlock_protective_stop().is_ok());
        assert_eq!(controller.programs.runtime_state(), RuntimeState::Paused, "unlocking does not resume");
        assert!(controller.programs.play(&mut controller.core));
    }
}

#[test]
fn an_impossible_move_in_reduced_mode_stops_protectively_too() {
    let mut controller = running();
    controller.show_safety(Some(2));
    upload(&mut controller, "def m():\n movel(p[5,0,0,0,0,0])\n sleep(1)\nend\n");
    controller.frame();
    assert_eq!(controller.core.modes.safety_mode(), SafetyMode::ProtectiveStop);
    controller.unlock_at_once();
    assert_eq!(controller.core.modes.safety_mode(), SafetyMode::Reduced);
}

#[test]
fn numbers_that_are_not_finite_are_exceptions() {
    let mut controller = running();
    controller.core.registers.write(&[Input::Double(24)], &[Value::Double(f64::NAN)]);
    upload(&mut controller, "def m():\n x = read_input_float_register(24)\n movej([x,0,0,0,0,0])\nend\n");
    controller.frame();
    let said = messages(&mut controller);
    assert!(said[1].contains("not finite") && stopped(&controller), "{said:?}");
}

#[test]
fn a_tool_and_a_gravity_that_cannot_be_are_exceptions() {
    for call in [
        "set_tcp(p[1e200,0,0,0,0,0])",
        "set_gravity([0,0,1e9])",
        "set_payload(1,[0,101,0])",
        "set_payload_cog([0,0,1e9])",
    ] {
        let mut controller = running();
        upload(&mut controller, &format!("def m():\n {call}\nend\n"));
        controller.frame();
        let said = messages(&mut controller);
        assert!(said[1].contains("is not possible") && stopped(&controller), "{said:?}");
    }
}

#[test]
fn a_payload_with_a_transition_time_changes_in_equal_steps() {
    let mut controller = running();
    let before = controller.core.payload.mass;
    upload(
        &mut controller,
        "def p():\n  set_target_payload(2.5, [0, 0, 0.1], [0, 0, 0, 0, 0, 0], 0.1)\n  sleep(1)\nend\n",
    );
    step_until(&mut controller, |controller| controller.core.payload.mass != before);
    let first = controller.core.payload.mass;
    let half = step_until(&mut controller, |controller| controller.core.payload.mass >= 0.5 * (before + 2.5));
    let whole = half + step_until(&mut controller, |controller| controller.core.payload.mass == 2.5);
    assert!((first - before - (2.5 - before) / 50.0).abs() < 1e-9, "{first} kg in the first frame");
    assert!((23..=25).contains(&half) && (48..=50).contains(&whole), "{half} and {whole} frames");
    assert_eq!(controller.core.payload.centre, [0.0, 0.0, 0.1]);
}

#[test]
fn a_secondary_program_does_not_move_the_arm() {
    for script in ["movej([1,-1.57,1.57,-1.57,-1.57,0])", "speedj([0.2,0,0,0,0,0], 1.4)", "stopj(1)"] {
        let mut controller = running();
        let start = controller.core.mover.q();
        upload(&mut controller, &format!("sec s():\n {script}\nend\n"));
        (0..100).for_each(|_| controller.frame());
        assert_eq!(controller.core.mover.q(), start, "{script}");
        assert!(messages(&mut controller)[0].contains("must not move the arm"), "{script}");
    }
}

#[test]
fn a_stop_keeps_programs_from_starting_that_came_before_it() {
    let mut controller = running();
    upload(&mut controller, "def m():\n movej([1,-1.57,1.57,-1.57,-1.57,0])\nend\n");
    controller.programs.cancel(&mut controller.core);
    (0..10).for_each(|_| controller.frame());
    assert!(stopped(&controller) && controller.core.mover.stands());
}

#[test]
fn stopping_within_force_mode_slows_down() {
    for end in ["", "stopj(2)"] {
        let mut controller = running();
        let force = "force_mode(p[0,0,0,0,0,0],[0,0,1,0,0,0],[0,0,-20,0,0,0],2,[.1,.1,.05,.5,.5,.5])";
        upload(&mut controller, &format!("def m():\n {force}\n sleep(1)\n {end}\nend\n"));
        controller.frame();
        while !stopped(&controller) || !controller.core.mover.stands() {
            controller.frame();
            let speed = controller.core.mover.tcp_speed().fixed_rows::<3>(0).norm();
            assert!(speed < 0.06, "{speed} m/s {end}");
            assert!(controller.core.step < 20_000, "{end}");
        }
        assert_eq!(controller.core.modes.safety_mode(), SafetyMode::Normal);
    }
}

#[test]
fn a_speed_without_a_time_is_reached_at_half_the_slider() {
    let mut controller = running();
    controller.core.registers.set_speed_fraction(0.5);
    upload(&mut controller, "def m():\n speedj([0.2,0,0,0,0,0], 0.5)\n stopj(2)\nend\n");
    controller.frame();
    step_until(&mut controller, stopped);
}

/// Client libraries wait for the end of the program then, not for a stop of the arm.
#[test]
fn a_target_out_of_the_joint_range_ends_the_program() {
    let mut controller = running();
    upload(&mut controller, "def m():\n movej([-123,0,0,0,0,0])\nend\n");
    controller.frame();
    let said = messages(&mut controller);
    assert!(said[1].contains("out of its range") && stopped(&controller), "{said:?}");
    assert_eq!(controller.core.modes.safety_mode(), SafetyMode::Normal);
}

#[test]
fn a_move_in_too_short_a_time_takes_longer() {
    let mut controller = running();
    upload(&mut controller, "def m():\n movej([3,-1.57,1.57,-1.57,-1.57,0], t=0.1)\nend\n");
    controller.frame();
    let frames = step_until(&mut controller, stopped);
    assert_eq!(controller.core.mover.q().0[0], 3.0);
    assert!(frames > 500, "{frames} frames for 3 rad");
}

/// The controller slows down to what the joints can do; it stops protectively where a line leads past a
/// singularity, however much time it was given.
#[test]
fn a_line_in_too_short_a_time_takes_longer() {
    let mut controller = running();
    let start = controller.core.tcp_pose();
    let script = "def m():\n b = pose_trans(get_actual_tcp_pose(), p[0,0.3,0,0,0,1.2])\n \
                  movel(b, t=0.05)\n textmsg(pose_dist(get_actual_tcp_pose(), b) < 0.00001)\nend\n";
    upload(&mut controller, script);
    controller.frame();
    let mut fastest = 0.0f64;
    while !stopped(&controller) {
        controller.frame();
        fastest = controller.core.mover.qd().iter().fold(fastest, |most, speed| most.max(speed.abs()));
        assert!(controller.core.step < 5000);
    }
    assert_eq!(messages(&mut controller), ["STARTED:m", "text:True", "STOPPED:m"]);
    let limit = controller.core.mover.arm.joint_speed[5];
    assert!(fastest <= limit * 1.01 && fastest > limit * 0.8, "{fastest} of {limit} rad/s");
    assert!(controller.core.step < 800, "{} frames from {start:?}", controller.core.step);
}

#[test]
fn a_line_past_a_singularity_stops_protectively_also_with_a_time() {
    let mut controller = running();
    // Past the base's axis, 2 cm from where no posture reaches.
    let script = "def m():\n movej([0.0, -2.2, 2.3, -1.67, -1.57, 0])\n \
                  movel(pose_add(get_actual_tcp_pose(), p[0.6,0,0,0,0,0]), t=0.1)\nend\n";
    upload(&mut controller, script);
    controller.frame();
    step_until(&mut controller, |c| c.core.modes.protective_stopped() || stopped(c));
    assert!(controller.core.modes.protective_stopped());
}

/// Assumed: what comes before the brakes are open is not kept for later.
#[test]
fn a_script_that_comes_while_the_brakes_are_released_is_refused() {
    let mut controller = Controller::new(ControllerConfig::ur5e(3));
    controller.core.modes.release_brakes();
    for _ in 0..300 {
        upload(&mut controller, "def m():\n sleep(100)\nend\n");
        controller.frame();
        assert_eq!(messages(&mut controller), ["C169"]);
    }
    step_until(&mut controller, |c| c.core.modes.robot_mode() == RobotMode::Running);
    (0..10).for_each(|_| controller.frame());
    assert!(stopped(&controller));
}

#[test]
fn an_arm_that_meets_itself_or_a_safety_plane_stops_and_may_go_back() {
    let plane = SafetyPlane { point: [0.0, 0.0, 0.4], normal: [0.0, 0.0, 1.0] };
    let fold = "movej([0,-1.57,3.0,0,0,0])";
    let sink = "movel(pose_add(get_actual_tcp_pose(), p[0,0,-0.3,0,0,0]))";
    for (planes, script, code) in [(vec![], fold, "C157"), (vec![plane], sink, "C152"), (vec![], sink, "")] {
        let safety = SafetyLimits { planes, ..SafetyLimits::default() };
        let config = ControllerConfig { running: true, safety, ..ControllerConfig::ur5e(3) };
        let mut controller = Controller::new(config);
        upload(&mut controller, &format!("def m():\n {script}\nend\n"));
        controller.frame();
        step_until(&mut controller, |c| c.core.modes.protective_stopped() || stopped(c));
        let said = messages(&mut controller);
        if code.is_empty() {
            assert!(stopped(&controller), "{said:?}");
            continue;
        }
        assert_eq!(said[1..], [code, "safety 3"]);
        (0..2500).for_each(|_| controller.frame());
        controller.unlock_protective_stop().unwrap();
        controller.programs.stop(&mut controller.core);
        let home = controller.core.config.start.0;
        upload(&mut controller, &format!("def back():\n movej({home:?})\nend\n"));
        controller.frame();
        step_until(&mut controller, stopped);
        assert!(!controller.core.modes.protective_stopped(), "{script}: the way back is free");
    }
}

#[test]
fn momentum_and_power_slow_moves_down_and_stop_what_cannot_be_slowed() {
    let most = |momentum: Option<f64>, script: &str| {
        let safety = SafetyLimits { momentum, ..SafetyLimits::default() };
        let config = ControllerConfig { running: true, safety, ..ControllerConfig::ur5e(3) };
        let mut controller = Controller::new(config);
        upload(&mut controller, &format!("def m():\n {script}\nend\n"));
        controller.frame();
        let mut most = 0.0f64;
        while !stopped(&controller) && !controller.core.modes.protective_stopped() {
            controller.frame();
            most = most.max(controller.core.momentum());
        }
        (most, messages(&mut controller))
    };
    let swing = "movej([1.5,-1.57,1.57,-1.57,-1.57,0], a=2, v=2)";
    let (free, _) = most(None, swing);
    let (held, said) = most(Some(2.0), swing);
    assert!(free > 4.0, "{free}");
    assert!((1.95..2.05).contains(&held), "{held} of {free}");
    assert_eq!(said.last().map(String::as_str), Some("STOPPED:m"), "it arrives");
    let (_, said) = most(Some(2.0), "speedj([2,0,0,0,0,0], 2, 5)");
    assert!(said.contains(&"C191".to_owned()), "{said:?}");
}

#[test]
fn power_is_what_the_tool_does_to_what_it_pushes_against() {
    let speed = |power: Option<f64>| {
        let safety = SafetyLimits { power, ..SafetyLimits::default() };
        let config = ControllerConfig { running: true, safety, ..ControllerConfig::ur5e(3) };
        let mut controller = Controller::new(config);
        let script =
            "def m():\n movel(pose_add(get_actual_tcp_pose(), p[0,0,-0.2,0,0,0]), a=3, v=0.5)\nend\n";
        upload(&mut controller, script);
        // As long as it moves something presses back with 50 N.
        controller.core.sensing.set_contact_wrench([0.0, 0.0, 50.0, 0.0, 0.0, 0.0]);
        controller.frame();
        let mut fastest = 0.0f64;
        while !stopped(&controller) {
            controller.frame();
            fastest = fastest.max(controller.core.mover.tcp_speed().fixed_rows::<3>(0).norm());
        }
        fastest
    };
    assert!((speed(None) - 0.5).abs() < 1e-3);
    let slowed = speed(Some(10.0));
    assert!((slowed - 0.2).abs() < 1e-2, "10 W at 50 N: {slowed} m/s");
}

#[test]
fn a_loop_of_stops_lets_time_pass() {
    let mut controller = running();
    upload(&mut controller, "def m():\n while True:\n  stopj(2)\n end\nend\n");
    (0..100).for_each(|_| controller.frame());
    assert!(controller.programs.playing());
}

#[test]
fn a_timed_speed_leads_as_far_at_half_the_slider_and_takes_twice_as_long() {
    let way = |fraction: f64| {
        let mut controller = running();
        controller.core.registers.set_speed_fraction(fraction);
        upload(&mut controller, "def m():\n speedj([0.5,0,0,0,0,0], 40, 1)\n stopj(40)\nend\n");
        controller.frame();
        (step_until(&mut controller, stopped) as f64, controller.core.mover.q().0[0])
    };
    let ((full, far), (half, same)) = (way(1.0), way(0.5));
    // The slider takes a fifth of a second to get there.
    assert!((half / full - 2.0).abs() < 0.1, "{half} {full} frames");
    assert!((far - same).abs() < 0.02 && far > 0.4, "{far} {same}");
}

#[test]
fn the_slider_does_not_go_to_nothing() {
    let mut controller = running();
    controller.core.registers.set_speed_fraction(0.5);
    controller.core.registers.set_speed_fraction(0.0);
    assert_eq!(controller.core.registers.speed_fraction(), 0.5);
}

#[test]
fn pausing_holds_the_arm_on_its_way_and_play_goes_on() {
    let mut controller = running();
    upload(&mut controller, "def m():\n movej([1,-1.57,1.57,-1.57,-1.57,0])\nend\n");
    (0..300).for_each(|_| controller.frame());
    assert!(controller.programs.pause());
    (0..300).for_each(|_| controller.frame());
    let held = controller.core.mover.q();
    assert!(controller.core.mover.stands() && held.0[0] > 0.05 && held.0[0] < 0.95);
    assert!(controller.programs.play(&mut controller.core));
    step_until(&mut controller, stopped);
    assert_eq!(controller.core.mover.q().0[0], 1.0);
}

#[test]
fn stopping_a_program_brakes_the_arm_and_forgets_its_move() {
    let mut controller = running();
    upload(&mut controller, "def m():\n movej([1,-1.57,1.57,-1.57,-1.57,0])\nend\n");
    (0..300).for_each(|_| controller.frame());
    assert!(controller.programs.stop(&mut controller.core));
    assert!(!controller.core.mover.stands());
    step_until(&mut controller, |c| c.core.mover.stands());
    let rest = controller.core.mover.q();
    (0..100).for_each(|_| controller.frame());
    assert_eq!(controller.core.mover.q(), rest);
}

#[test]
fn a_move_paused_and_stopped_does_not_come_back_with_the_next_program() {
    let mut controller = running();
    upload(&mut controller, "def m():\n movej([1,-1.57,1.57,-1.57,-1.57,0])\nend\n");
    (0..300).for_each(|_| controller.frame());
    controller.programs.pause();
    (0..300).for_each(|_| controller.frame());
    controller.programs.stop(&mut controller.core);
    let held = controller.core.mover.q();
    upload(&mut controller, "def n():\n sleep(1)\nend\n");
    (0..300).for_each(|_| controller.frame());
    assert_eq!(controller.core.mover.q(), held);
}

#[test]
fn a_killed_motion_brakes_by_itself_and_stopj_takes_it_over() {
    for stop in ["", "stopj(2)"] {
        let mut controller = running();
        let script = format!(
            "def m():\n thread t():\n  movej([1,-1.57,1.57,-1.57,-1.57,0])\n end\n h = run t()\n \
             sleep(0.5)\n \
             kill h\n {stop}\n sleep(2)\n textmsg(is_steady())\nend\n"
        );
        upload(&mut controller, &script);
        controller.frame();
        step_until(&mut controller, stopped);
        assert_eq!(messages(&mut controller), ["STARTED:m", "text:True", "STOPPED:m"], "{stop}");
        assert!(controller.core.mover.q().0[0] < 0.9);
    }
}

#[test]
fn two_threads_may_not_move_the_arm_at_once() {
    let mut controller = running();
    upload(
        &mut controller,
        "def m():\n thread t():\n  movej([1,-1.57,1.57,-1.57,-1.57,0])\n end\n run t()\n sync()\n \
         movej([0,-1,1,-1.57,-1.57,0])\nend\n",
    );
    (0..3).for_each(|_| controller.frame());
    let said = messages(&mut controller);
    assert!(said[1].contains("another thread is already controlling the robot"), "{said:?}");
}

#[test]
fn an_emergency_stop_ends_the_program_and_the_power() {
    let mut controller = running();
    upload(&mut controller, "def m():\n sleep(100)\nend\n");
    controller.frame();
    controller.emergency_stop(true);
    controller.frame();
    assert_eq!(controller.core.modes.robot_mode(), RobotMode::PowerOff);
    assert_eq!(messages(&mut controller), ["STARTED:m", "STOPPED:m", "safety 7"]);
    upload(&mut controller, "def n():\n sleep(100)\nend\n");
    controller.frame();
    assert_eq!(messages(&mut controller), ["C169"]);
}

#[test]
fn a_safeguard_pauses_and_resumes_by_itself() {
    let mut controller = running();
    upload(&mut controller, "def m():\n sleep(0.1)\nend\n");
    controller.frame();
    controller.safeguard_stop(true);
    (0..100).for_each(|_| controller.frame());
    assert_eq!(controller.programs.runtime_state(), RuntimeState::Paused);
    controller.safeguard_stop(false);
    assert!(step_until(&mut controller, stopped) < 60);
}

#[test]
fn a_watchdog_acts_when_its_client_falls_silent() {
    let mut controller = running();
    let name = "input_int_register_27".to_owned();
    controller.core.registers.claim(ClientId(1), std::slice::from_ref(&name));
    upload(
        &mut controller,
        "def m():\n rtde_set_watchdog(\"input_int_register_27\", 10, \"stop\")\n while True:\n  sync()\n \
         end\nend\n",
    );
    for frame in 0..200 {
        if frame % 20 == 0 {
            controller.core.registers.write(&[Input::Int(27)], &[Value::Int32(0)]);
        }
        controller.frame();
    }
    assert!(controller.programs.playing(), "a value that does not change still counts as written");
    let silent = step_until(&mut controller, stopped);
    assert!(silent <= 52, "{silent} frames");
}

#[test]
fn time_starts_late_enough_and_advances_by_frames() {
    let mut controller = running();
    let start = controller.core.timestamp();
    (0..500).for_each(|_| controller.frame());
    assert!(start >= 41.0 && (controller.core.timestamp() - start - 1.0).abs() < 1e-9);
}

#[test]
fn the_calibrated_arm_deviates_by_its_seed_and_little() {
    let nominal = forward(&DhParameters::UR5E, &ControllerConfig::ur5e(1).start);
    let deviation = |seed: u64| {
        let arm =
            forward(&calibrated(&DhParameters::UR5E, seed, 5e-4, 9e-4), &ControllerConfig::ur5e(seed).start);
        (arm.translation.vector - nominal.translation.vector).norm()
    };
    assert_eq!(
        calibrated(&DhParameters::UR5E, 5, 5e-4, 9e-4),
        calibrated(&DhParameters::UR5E, 5, 5e-4, 9e-4)
    );
    assert_eq!(calibrated(&DhParameters::UR5E, 5, 0.0, 0.0), DhParameters::UR5E);
    for seed in 0..20 {
        assert!((1e-5..6e-3).contains(&deviation(seed)), "{} m with seed {seed}", deviation(seed));
    }
    // As the tables of real arms, which put two frames far away along the parallel axes.
    let offset = |seed: u64| calibrated(&DhParameters::UR5E, seed, 5e-4, 9e-4).d[1].abs();
    let far = (0..20).filter(|seed| offset(*seed) > 20.0).count();
    assert!(far > 10, "{far} of 20 arms");
}
