//! A joint that jumps: the arm is stopped and the cell disarmed, whatever it does.

use super::faults::{said, working};
use super::*;

fn jump() -> Input {
    Input::Robot(RobotEvent::JointJump { detail: "elbow by 11.5 degrees in 2 ms".into() })
}

fn stops(actions: &[Action]) -> usize {
    actions.iter().filter(|action| matches!(action, Action::Robot(RobotCommand::Stop))).count()
}

#[test]
fn a_jump_in_a_motion_stops_the_arm_in_the_same_step_and_names_the_joint() {
    let mut bench = working();
    let actions = bench.feed(jump());
    assert_eq!(stops(&actions), 1);
    assert_eq!(ended(&actions), Some((JobStatus::Interrupted, "joint_jump".into())));
    assert!(said(&actions, "the arm's position jumped: elbow by 11.5 degrees"), "{actions:?}");
    assert!(!bench.cell.status().armed);
    assert!(!actions.iter().any(|action| matches!(action, Action::Gripper(_))), "the vacuum stays");
}

#[test]
fn a_jump_while_an_armed_cell_waits_stops_the_arm_and_disarms() {
    let mut bench = Bench::new();
    bench.feed(order(Order::Arm));
    assert!(bench.cell.status().armed);
    assert_eq!(stops(&bench.feed(jump())), 1, "others may be moving the arm");
    assert!(!bench.cell.status().armed);
}

#[test]
fn a_jump_in_a_disarmed_cell_is_reported_and_orders_nothing() {
    let mut bench = Bench::new();
    let actions = bench.feed(jump());
    assert!(said(&actions, "elbow by 11.5 degrees"), "{actions:?}");
    assert!(!actions.iter().any(|action| matches!(action, Action::Robot(_))), "{actions:?}");
}
