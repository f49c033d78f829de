//! Standstill before a picture is judged by joint positions, not by measured speeds.

use super::rounds::round_under_way;
use super::*;
use crate::stillness::STILL_RAD;

/// States in which one joint swings by this much, rad, every 20 ms.
fn sway(bench: &mut Bench, joint: usize, by_rad: f64, states: usize) -> Vec<Action> {
    let rest = bench.robot.q.0[joint];
    let mut all = Vec::new();
    for state in 0..states {
        bench.robot.q.0[joint] = rest + if state % 2 == 0 { by_rad } else { 0.0 };
        all.extend(bench.feed(Input::Tick));
    }
    bench.robot.q.0[joint] = rest;
    all
}

/// On the way to the first look pose.
fn on_the_way() -> Bench {
    let mut bench = Bench::new();
    bench.job(false);
    bench.feed(order(Order::Arm));
    assert_eq!(streams(&bench.ticks(20)), 1);
    bench
}

fn captures(actions: &[Action]) -> usize {
    actions.iter().filter(|action| matches!(action, Action::Capture { .. })).count()
}

fn notices(actions: &[Action], words: &str) -> usize {
    let says = |action: &&Action| matches!(action, Action::Say(notice) if notice.text.contains(words));
    actions.iter().filter(says).count()
}

#[test]
fn noise_of_the_measured_speed_delays_no_picture() {
    let mut bench = on_the_way();
    bench.robot.qd = [2.8e-3; 6];
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    assert_eq!(captures(&sway(&mut bench, 4, 0.9 * STILL_RAD, 10)), 1);
}

#[test]
fn a_waiting_look_names_the_restless_joint_once_and_when_it_fails() {
    let mut bench = on_the_way();
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    let mut all = sway(&mut bench, 3, 1.5 * STILL_RAD, 90);
    assert_eq!((captures(&all), notices(&all, "is not at rest")), (0, 0), "not before two seconds");
    all.extend(sway(&mut bench, 3, 1.5 * STILL_RAD, 900));
    assert_eq!(notices(&all, "wrist 1 moves by 0.30 mrad (limit 0.20); the picture waits"), 1);
    all.extend(sway(&mut bench, 3, 1.5 * STILL_RAD, 20));
    let end = all.iter().find_map(|action| match action {
        Action::Commit { record: Record::Ended(report), .. } => Some(report.message.clone()),
        _ => None,
    });
    assert!(end.as_ref().is_some_and(|end| end.contains("wrist 1 moves by 0.30 mrad")), "{end:?}");
}

#[test]
fn a_picture_is_taken_once_the_arm_rests() {
    let mut bench = on_the_way();
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    assert_eq!(captures(&sway(&mut bench, 0, 5e-4, 200)), 0);
    assert_eq!(captures(&bench.ticks(10)), 1);
}

#[test]
fn bring_up_fails_while_a_joint_shakes() {
    let mut bench = Bench::new();
    bench.job(false);
    let mut all = bench.feed(order(Order::Arm));
    all.extend(sway(&mut bench, 1, 4e-4, 1600));
    assert_eq!((streams(&all), notices(&all, "shoulder moves by 0.40 mrad") > 0), (0, true), "{all:?}");
    assert_eq!(ended(&all).map(|(status, _)| status), Some(JobStatus::Failed));
    let mut quiet = Bench::new();
    quiet.job(false);
    let mut all = quiet.feed(order(Order::Arm));
    all.extend(sway(&mut quiet, 1, 0.9 * STILL_RAD, 50));
    assert_eq!(streams(&all), 1);
}

#[test]
fn a_calibration_picture_waits_for_still_positions_and_ignores_speeds() {
    let mut bench = round_under_way();
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    bench.robot.qd = [2.8e-3; 6];
    let pictures =
        |actions: &[Action]| actions.iter().filter(|action| matches!(action, Action::Picture { .. })).count();
    let restless = sway(&mut bench, 5, 1.5 * STILL_RAD, 150);
    assert_eq!((pictures(&restless), notices(&restless, "wrist 3 moves by 0.30 mrad")), (0, 1));
    assert_eq!(pictures(&bench.ticks(30)), 1);
}
