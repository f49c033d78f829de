//! States that no arm can be in: jumps, and numbers beyond what is possible.

use super::{HOME, Rig, path};
use crate::device::program::Nonce;
use crate::device::robot_types::{Link, RobotCommand, RobotEvent};
use ur_wire::rtde_values::Value;

/// The opcode as the program reads it.
const STOP: i32 = 5;

/// The arm as it is, with the elbow turned by so much, rad.
fn elbow_turned(rig: &Rig, by_rad: f64) -> Option<(&'static str, Value)> {
    let mut q = rig.fake.q;
    q[2] += by_rad;
    Some(("actual_q", Value::Vector6D(q)))
}

fn jumps(rig: &Rig) -> Vec<&str> {
    let details = rig.events.iter().filter_map(|event| match event {
        RobotEvent::JointJump { detail } => Some(detail.as_str()),
        _ => None,
    });
    details.collect()
}

#[test]
fn a_jump_in_a_motion_is_reported_and_the_stop_is_at_the_arm_two_frames_later() {
    let mut rig = Rig::running();
    rig.command(RobotCommand::Stream(path(HOME, 3)));
    rig.run_ms(60);
    assert_eq!(jumps(&rig), [""; 0], "a motion is no jump");
    rig.fake.broken = elbow_turned(&rig, 0.2);
    rig.run_ms(4);
    assert!(jumps(&rig)[0].starts_with("elbow by 11."), "{:?}", rig.events);
    let (_, opcode) = rig.fake.taken.last().unwrap();
    assert_eq!(*opcode, STOP, "no order of anybody is needed");
    rig.run_ms(10);
    assert_eq!(rig.ended().unwrap(), "stopped by celld");
    assert!(rig.up.contains(&Link::Rtde), "the link is what the arm is stopped over");
}

#[test]
fn positions_that_jump_with_every_package_are_reported_once_a_second() {
    let mut rig = Rig::running();
    let away = elbow_turned(&rig, 0.5);
    for frame in 0..1000 {
        rig.fake.broken = away.filter(|_| frame % 2 == 0);
        rig.run_ms(2);
    }
    assert_eq!(jumps(&rig).len(), 2, "in 2 s");
}

#[test]
fn a_jump_right_after_a_new_start_is_reported_again() {
    let mut rig = Rig::running();
    rig.fake.broken = elbow_turned(&rig, 0.5);
    rig.run_ms(100);
    let nonce = Nonce::new(8);
    rig.command(RobotCommand::StartProgram { nonce });
    rig.run_ms(100);
    assert!(rig.saw(&RobotEvent::ProgramRunning { nonce }), "{:?}", rig.events);
    rig.fake.broken = None;
    rig.run_ms(4);
    assert_eq!(jumps(&rig).len(), 2, "{:?}", rig.events);
}

#[test]
fn lost_packages_are_no_jump() {
    let mut rig = Rig::running();
    rig.fake.time_s += 0.05;
    rig.fake.broken = elbow_turned(&rig, 0.15);
    rig.run_ms(50);
    assert_eq!(jumps(&rig), [""; 0]);
}

#[test]
fn positions_that_come_with_the_power_are_no_jump() {
    let mut rig = Rig::new();
    rig.fake.robot_mode = 3;
    rig.fake.broken = Some(("actual_q", Value::Vector6D([0.0; 6])));
    rig.connect_all();
    rig.run_ms(100);
    assert!(rig.saw(&RobotEvent::RtdeReady));
    rig.fake.robot_mode = 7;
    rig.fake.broken = None;
    rig.run_ms(100);
    assert_eq!(jumps(&rig), [""; 0]);
    rig.fake.broken = elbow_turned(&rig, 0.2);
    rig.run_ms(4);
    assert_eq!(jumps(&rig).len(), 1, "it is watched from then on");
}

#[test]
fn an_impossible_number_in_any_field_drops_the_link() {
    const HUGE: f64 = 1e308;
    for (name, value) in [
        ("timestamp", Value::Double(HUGE)),
        ("actual_q", Value::Vector6D([0.0, 0.0, 0.0, HUGE, 0.0, 0.0])),
        ("actual_qd", Value::Vector6D([-HUGE; 6])),
        ("actual_TCP_pose", Value::Vector6D([HUGE; 6])),
        ("tcp_offset", Value::Vector6D([0.0, 0.0, 0.0, 0.0, 0.0, HUGE])),
        ("speed_scaling", Value::Double(HUGE)),
        ("target_speed_fraction", Value::Double(f64::INFINITY)),
        ("payload", Value::Double(-1.0)),
        ("payload_cog", Value::Vector3D([0.0, 0.0, f64::NAN])),
    ] {
        let mut rig = Rig::running();
        rig.reconnect = None;
        rig.fake.broken = Some((name, value));
        rig.run_ms(4);
        let faults = rig.faults();
        assert!(
            faults.len() == 1 && faults[0].starts_with(&format!("RTDE: {name} is ")),
            "{name}: {faults:?}"
        );
        assert!(faults[0].len() < 120, "{faults:?}");
        assert!(rig.saw(&RobotEvent::RtdeLost) && !rig.up.contains(&Link::Rtde), "{name}");
        assert!(rig.fake.dashboard_lines.iter().any(|line| line == "stop"), "{name}: the arm is stopped");
    }
}

#[test]
fn impossible_kinematics_drop_the_link() {
    for (link_m, faults) in [(350.0, 0), (1e308, 1)] {
        let mut rig = Rig::new();
        rig.reconnect = None;
        rig.fake.link_m = link_m;
        rig.connect_all();
        rig.run_ms(100);
        assert_eq!(rig.faults().len(), faults, "{link_m}: {:?}", rig.faults());
    }
}
