//! What takes back a person's leave to move, and that nothing moves for it later; that another robot locks
//! the cell.

use super::faults::{said, working};
use super::*;
use crate::device::robot_types::{KnownRobot, RobotIdentity};
use crate::supervisor::lapse::MOVED_RAD;
use crate::supervisor::phase::Phase;

/// What happens, and a word of the sentence about it.
type Cause = (&'static str, fn(&mut Bench));

const CAUSES: &[Cause] = &[
    ("the dashboard link was lost", |bench| bench.link_down = Some(Link::Dashboard)),
    ("the primary interface link was lost", |bench| bench.link_down = Some(Link::Primary)),
    ("gripper not responding", |bench| bench.gripper_answers = false),
    ("guided by hand", |bench| bench.robot.guided = true),
    ("guided by hand", |bench| bench.robot.robot_mode = RobotMode::Backdrive),
    ("power or brakes were switched", |bench| bench.robot.robot_mode = RobotMode::PowerOff),
    ("power or brakes were switched", |bench| bench.robot.robot_mode = RobotMode::Idle),
    ("the arm was moved", |bench| bench.robot.q.0[3] += MOVED_RAD * 1.1),
];

#[test]
fn arming_lapses_and_what_comes_back_moves_nothing() {
    for (word, cause) in CAUSES {
        let mut bench = Bench::new();
        bench.feed(order(Order::Arm));
        bench.ticks(2);
        let before = bench.robot.clone();
        cause(&mut bench);
        let mut all = bench.ticks(2);
        assert!(!bench.cell.status().armed && said(&all, word), "{word}: {all:?}");
        assert!(said(&all, "celld arm"), "{word}: what to do");
        (bench.robot, bench.link_down, bench.gripper_answers) = (before, None, true);
        all.extend(bench.job(false));
        all.extend(bench.ticks(500));
        assert!(!all.iter().any(|action| matches!(action, Action::Robot(_))), "{word}: {all:?}");
        assert_eq!(ended(&all), None, "{word}: the job waits for a person");
        assert!(answer(&bench.feed(order(Order::Arm))).expect("an answer").accepted, "{word}");
        assert_eq!(streams(&bench.ticks(20)), 1, "{word}: and goes on");
    }
}

#[test]
fn a_pick_n_place_under_way_is_finished_when_a_link_is_lost_and_nothing_follows() {
    let mut bench = working();
    bench.link_down = Some(Link::Dashboard);
    let lost = bench.ticks(3);
    assert!(said(&lost, "the pick-n-place under way is finished first"), "{lost:?}");
    assert!(!lost.iter().any(|action| matches!(action, Action::Robot(RobotCommand::Stop))), "{lost:?}");
    assert!(!bench.cell.status().armed);
    let over = bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    assert!(
        over.iter().any(|action| matches!(action, Action::Gripper(GripperCommand::Grip { .. }))),
        "{over:?}"
    );
}

#[test]
fn arming_lapses_after_its_time_without_motion_and_not_in_motion() {
    let limit = tolerances().arm_lapse;
    let mut bench = Bench::new();
    bench.feed(order(Order::Arm));
    bench.ticks(1);
    bench.now += limit - Duration::from_secs(1);
    bench.ticks(1);
    assert!(bench.cell.status().armed);
    bench.now += Duration::from_secs(1);
    let lapsed = bench.ticks(2);
    assert!(!bench.cell.status().armed && said(&lapsed, "nothing has moved for 600 s"), "{lapsed:?}");
    // A plan that waits for a person waits on, and what is moving is moving.
    let mut bench = Bench::new();
    bench.job(true);
    bench.until_planning();
    bench.plan();
    bench.ticks(1);
    bench.now += limit;
    let lapsed = bench.ticks(2);
    assert!(said(&lapsed, "nothing has moved") && ended(&lapsed).is_none(), "{lapsed:?}");
    let reply = answer(&bench.feed(order(bench.approval()))).expect("an answer");
    assert!(reply.accepted && reply.message.contains("celld arm"), "{}", reply.message);
    assert_eq!(streams(&bench.ticks(50)), 0);
}

#[test]
fn an_arm_that_is_off_while_a_plan_waits_is_powered_at_the_order_to_arm() {
    let mut bench = Bench::new();
    bench.job(true);
    bench.until_planning();
    bench.plan();
    bench.robot.robot_mode = RobotMode::PowerOff;
    bench.ticks(2);
    assert!(!bench.cell.status().armed);
    let armed = bench.feed(order(Order::Arm));
    assert!(armed.iter().any(|action| matches!(action, Action::Robot(RobotCommand::PowerOn))), "{armed:?}");
    let off = bench.feed(order(Order::Disarm));
    assert!(off.iter().any(|action| matches!(action, Action::Robot(RobotCommand::Stop))), "{off:?}");
    let approved = bench.feed(Input::Order { number: 2, order: bench.approval() });
    let reply = answer(&approved).expect("an answer");
    assert!(reply.accepted, "the plan has waited on: {}", reply.message);
}

#[test]
fn an_arm_that_a_person_switches_off_while_it_is_started_is_not_powered_again() {
    for (from, to) in [
        (RobotMode::Running, RobotMode::PowerOff),
        (RobotMode::Running, RobotMode::Idle),
        (RobotMode::Idle, RobotMode::PowerOff),
        (RobotMode::Booting, RobotMode::PowerOff),
    ] {
        let mut bench = Bench::new();
        let boots = from == RobotMode::Booting;
        bench.robot.robot_mode = if boots { RobotMode::PowerOff } else { from };
        bench.job(false);
        bench.feed(order(Order::Arm));
        bench.ticks(3);
        if boots {
            // celld has switched the power on, and the joints boot.
            bench.robot.robot_mode = from;
            bench.ticks(3);
        }
        assert!(bench.cell.status().armed && matches!(bench.cell.phase, Phase::BringUp(_)), "{from:?}");
        bench.robot.robot_mode = to;
        let mut after = bench.ticks(200);
        // Who switched it off may switch it on again: no brake is released then.
        bench.robot.robot_mode = RobotMode::Idle;
        after.extend(bench.ticks(200));
        let powers = |action: &Action| {
            matches!(action, Action::Robot(RobotCommand::PowerOn | RobotCommand::ReleaseBrakes))
        };
        assert!(!after.iter().any(powers), "{from:?} to {to:?}: {after:?}");
        assert!(!bench.cell.status().armed, "{from:?} to {to:?}");
        assert!(bench.cell.status().job.is_some(), "the job waits for a person");
    }
}

#[test]
fn no_event_before_the_next_tick_powers_an_arm_that_a_person_switched_off() {
    let mut bench = Bench::new();
    bench.feed(order(Order::Arm));
    bench.ticks(3);
    bench.robot.robot_mode = RobotMode::PowerOff;
    let mut after = bench.job(false);
    after.extend(bench.feed(Input::Robot(RobotEvent::Mode { mode: RobotMode::PowerOff })));
    after.extend(bench.ticks(50));
    let powers = |action: &Action| matches!(action, Action::Robot(RobotCommand::PowerOn));
    assert!(!after.iter().any(powers), "{after:?}");
    assert!(!bench.cell.status().armed);
}

#[test]
fn a_simulated_cell_that_arms_itself_powers_an_arm_that_is_off() {
    let mut bench = Bench::new();
    bench.robot.robot_mode = RobotMode::PowerOff;
    bench.cell.arm_at_start();
    let armed = bench.ticks(1);
    assert!(armed.iter().any(|action| matches!(action, Action::Robot(RobotCommand::PowerOn))), "{armed:?}");
    assert!(bench.cell.status().armed);
}

fn identity(model: &str, serial: &str, version: &str) -> RobotEvent {
    RobotEvent::Identity { serial: serial.into(), model: model.into(), version: version.into() }
}

#[test]
fn another_robot_locks_the_cell_and_both_are_named() {
    let known = RobotIdentity { model: "UR5".into(), serial: "1".into(), version: "5.9".into() };
    let others = [
        (identity("UR10", "1", "5.9"), "UR10", "celld calibrate"),
        (identity("UR5", "2", "5.9"), "UR5 2 with 5.9", "celld calibrate"),
        (identity("UR5", "1", "5.4"), "5.4", "start it again"),
        (RobotEvent::SafetyChecksum { checksum: 8 }, "00000008, it was 00000007", "risk assessment"),
    ];
    for (event, word, hint) in others {
        let mut bench = Bench::new();
        bench.cell.commissioned_for(KnownRobot { identity: Some(known.clone()), safety_checksum: Some(7) });
        bench.feed(Input::Robot(identity("UR5", "1", "5.9")));
        bench.feed(Input::Robot(RobotEvent::SafetyChecksum { checksum: 7 }));
        assert!(answer(&bench.feed(order(Order::Arm))).expect("an answer").accepted);
        let other = bench.feed(Input::Robot(event));
        assert!(said(&other, word) && !bench.cell.status().armed, "{word}: {other:?}");
        let reply = answer(&bench.feed(order(Order::Arm))).expect("an answer");
        assert!(!reply.accepted && reply.message.contains(word), "{}", reply.message);
        assert!(reply.message.contains(hint), "{}", reply.message);
        let locked = |bench: &Bench| bench.cell.status().text().contains("the cell is locked");
        assert!(locked(&bench), "{}", bench.cell.status().text());
        bench.job(false);
        let all = bench.ticks(200);
        assert_eq!(streams(&all), 0, "{word}");
        assert!(locked(&bench) && !said(&all, "`celld arm`"), "no text names an order that is refused");
    }
}

#[test]
fn a_controller_that_sends_no_safety_checksum_at_first_is_held_to_the_first_it_sends() {
    let mut bench = Bench::new();
    bench.feed(order(Order::Arm));
    bench.feed(Input::Robot(RobotEvent::SafetyChecksum { checksum: 7 }));
    assert!(bench.cell.status().armed);
    bench.feed(Input::Robot(RobotEvent::SafetyChecksum { checksum: 8 }));
    assert!(!bench.cell.status().armed);
}
