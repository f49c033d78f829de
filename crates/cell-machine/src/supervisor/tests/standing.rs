//! What waits for the arm to come to rest: the answer to an abort, and the air after a release in motion.

use super::faults::{said, working};
use super::*;
use crate::code::Code;
use crate::device::gripper_types::GripperEvent;
use crate::device::robot_types::ProgramEnd;
use crate::orders::WayBack;
use crate::supervisor::free_place::Searched;
use crate::supervisor::model::{CutOff, HeldBefore};
use cell_motion::pick_n_place::tool_down;
use rearrange::geometry::collision::penetration;

fn vents(actions: &[Action]) -> bool {
    actions.iter().any(|action| matches!(action, Action::Gripper(GripperCommand::Release { .. })))
}

pub(super) fn moving_arm(bench: &mut Bench) {
    bench.robot.qd = [0.4, 0.0, 0.0, 0.0, 0.0, 0.0];
}

#[test]
fn an_abort_is_answered_when_the_arm_stands() {
    let mut bench = working();
    moving_arm(&mut bench);
    let mut actions = bench.feed(order(Order::Abort));
    assert!(actions.iter().any(|action| matches!(action, Action::Robot(RobotCommand::Stop))), "{actions:?}");
    actions.extend(bench.ticks(10));
    actions.extend(bench.feed(Input::Robot(RobotEvent::Stopped)));
    assert_eq!(answer(&actions), None, "the joints still turn");
    bench.robot.qd = [0.0; 6];
    assert_eq!(answer(&bench.ticks(1)), Some(Reply::accept("stopped and disarmed")));
    assert_eq!(answer(&bench.ticks(500)), None, "once");
}

#[test]
fn an_abort_that_stops_nothing_is_refused() {
    for silent in [false, true] {
        let mut bench = working();
        moving_arm(&mut bench);
        bench.feed(order(Order::Abort));
        bench.silent = silent;
        // 5.5 s, a tick being 20 ms.
        assert_eq!(answer(&bench.ticks(270)), None);
        let reply = answer(&bench.ticks(10)).expect("an answer");
        assert!(!reply.accepted && reply.message.contains("use the emergency stop"), "{reply:?}");
        assert_eq!(reply.message.contains("does not answer"), silent, "{reply:?}");
    }
}

#[test]
fn an_arm_that_stands_with_a_program_that_cannot_be_ended_is_not_called_stopped() {
    let mut bench = working();
    bench.feed(order(Order::Abort));
    let reply = answer(&bench.ticks(280)).expect("an answer");
    assert!(!reply.accepted && reply.message.contains("the arm is at rest, but its program"), "{reply:?}");
}

#[test]
fn a_release_in_motion_stops_the_arm_first() {
    let mut bench = working();
    moving_arm(&mut bench);
    let mut actions = bench.feed(order(Order::Release(Channels::Both)));
    assert_eq!(ended(&actions), Some((JobStatus::Interrupted, "released".into())));
    actions.extend(bench.ticks(20));
    // A second one, in haste.
    actions.extend(bench.feed(order(Order::Release(Channels::Both))));
    assert!(!vents(&actions), "the arm still moves: {actions:?}");
    bench.robot.qd = [0.0; 6];
    assert!(!vents(&bench.ticks(1)), "the robot has not reported standstill");
    assert!(vents(&bench.feed(Input::Robot(RobotEvent::Stopped))));
    let released = bench.feed(Input::Gripper(GripperEvent::Released));
    assert!(answer(&released).expect("an answer").accepted);
}

#[test]
fn a_release_waits_for_whatever_moves_the_arm_and_not_for_ever() {
    let mut bench = Bench::new();
    moving_arm(&mut bench);
    let mut actions = bench.feed(order(Order::Release(Channels::Both)));
    actions.extend(bench.ticks(290));
    assert!(!vents(&actions), "{actions:?}");
    let reply = answer(&actions).expect("an answer");
    assert!(!reply.accepted && reply.message.contains("not come to rest"), "{reply:?}");
}

#[test]
fn what_hangs_on_a_silent_robot_can_be_taken() {
    let mut bench = working();
    bench.silent = true;
    let mut actions = bench.feed(order(Order::Release(Channels::Both)));
    actions.extend(bench.ticks(270));
    assert!(!vents(&actions), "the program's watchdog may still be stopping the arm");
    assert!(vents(&bench.ticks(10)));
}

#[test]
fn arming_is_refused_while_a_stop_is_under_way() {
    let mut bench = working();
    moving_arm(&mut bench);
    bench.feed(order(Order::Release(Channels::Both)));
    let reply = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    assert!(!reply.accepted && reply.message.contains("a stop is under way"), "{reply:?}");
    bench.robot.qd = [0.0; 6];
    assert!(vents(&bench.feed(Input::Robot(RobotEvent::Stopped))));
    bench.feed(Input::Gripper(GripperEvent::Released));
    assert!(answer(&bench.feed(order(Order::Arm))).expect("an answer").accepted);
}

#[test]
fn who_waits_for_standstill_is_answered_when_celld_ends() {
    let mut bench = working();
    moving_arm(&mut bench);
    bench.feed(order(Order::Abort));
    let mut all = bench.feed(Input::Shutdown);
    all.extend(bench.ticks(200));
    assert!(all.iter().any(|action| matches!(action, Action::End(_))), "{all:?}");
    let reply = answer(&all).expect("an answer");
    assert!(!reply.accepted && reply.message.contains("not come to rest"), "{reply:?}");
}

#[test]
fn an_arm_that_is_held_after_disarming_does_not_go_on() {
    let mut bench = working();
    assert!(answer(&bench.feed(order(Order::Disarm))).expect("an answer").message.contains("finished first"));
    assert_eq!(ended(&bench.ticks(50)), None);
    bench.robot.runtime_state = RuntimeState::Paused;
    let held = bench.ticks(3);
    assert!(held.iter().any(|a| matches!(a, Action::Robot(RobotCommand::Stop))), "{held:?}");
    assert_eq!(ended(&held), Some((JobStatus::Interrupted, "aborted".into())));
}

#[test]
fn disarming_a_held_arm_stops_it_for_good() {
    let mut bench = working();
    bench.robot.runtime_state = RuntimeState::Paused;
    let paused = bench.feed(Input::Robot(RobotEvent::Paused));
    let reported = paused.iter().any(|a| matches!(a, Action::Say(notice) if notice.alarm));
    assert!(reported, "a person reads that play goes on with the motion: {paused:?}");
    let disarmed = bench.feed(order(Order::Disarm));
    assert!(disarmed.iter().any(|a| matches!(a, Action::Robot(RobotCommand::Stop))), "{disarmed:?}");
    assert_eq!(ended(&disarmed), Some((JobStatus::Interrupted, "aborted".into())));
    assert_eq!(answer(&disarmed), None, "the arm is not known to stand for good yet");
    let stopped = bench.feed(Input::Robot(RobotEvent::Stopped));
    assert_eq!(answer(&stopped), Some(Reply::accept("stopped and disarmed")));
    bench.robot.runtime_state = RuntimeState::Playing;
    assert_eq!(streams(&bench.ticks(200)), 0);
}

#[test]
fn a_release_disarms_a_cell_that_could_move_off_at_once() {
    let mut bench = Bench::new();
    bench.feed(order(Order::Arm));
    let ordered = bench.feed(order(Order::Release(Channels::Both)));
    assert!(ordered.iter().any(|a| matches!(a, Action::Robot(RobotCommand::Stop))), "{ordered:?}");
    assert!(!bench.cell.mode().armed(), "hands are at the gripper");
    assert!(vents(&bench.feed(Input::Robot(RobotEvent::Stopped))));
    bench.job(false);
    assert_eq!(streams(&bench.ticks(100)), 0);
    let reply = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    assert!(!reply.accepted && reply.message.contains("a release is under way"), "{reply:?}");
    assert!(answer(&bench.feed(Input::Gripper(GripperEvent::Released))).expect("an answer").accepted);
    assert!(answer(&bench.feed(order(Order::Arm))).expect("an answer").accepted);
}

#[test]
fn both_of_two_releases_are_answered_by_what_the_gripper_says() {
    let mut bench = Bench::new();
    bench.feed(Input::Order { number: 1, order: Order::Release(Channels::A) });
    let second = bench.feed(Input::Order { number: 2, order: Order::Release(Channels::B) });
    assert_eq!(answer(&second), None, "{second:?}");
    let failed = bench.feed(Input::Gripper(GripperEvent::ReleaseFailed { vacuum: 0.4 }));
    let refused = |action: &Action| matches!(action, Action::Reply { reply, .. } if !reply.accepted);
    assert_eq!(failed.iter().filter(|action| refused(action)).count(), 2, "{failed:?}");
}

#[test]
fn disarming_while_the_robot_is_started_takes_everything_back_before_the_answer() {
    let mut bench = Bench::new();
    bench.robot.robot_mode = RobotMode::PowerOff;
    bench.robot.runtime_state = RuntimeState::Stopped;
    bench.job(false);
    let armed = bench.feed(order(Order::Arm));
    assert!(armed.iter().any(|a| matches!(a, Action::Robot(RobotCommand::PowerOn))), "{armed:?}");
    let disarmed = bench.feed(order(Order::Disarm));
    assert!(disarmed.iter().any(|a| matches!(a, Action::Robot(RobotCommand::Stop))), "{disarmed:?}");
    assert_eq!((answer(&disarmed), ended(&disarmed)), (None, None), "the job waits for a person");
    // The session has sent `power off`, and the arm is not off yet.
    bench.arm_settled = false;
    assert_eq!(answer(&bench.ticks(10)), None);
    let reply = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    assert!(!reply.accepted && reply.message.contains("a stop is under way"), "{reply:?}");
    bench.arm_settled = true;
    assert_eq!(answer(&bench.ticks(1)), Some(Reply::accept("stopped and disarmed")));
    let after = bench.ticks(100);
    assert!(!after.iter().any(|action| matches!(action, Action::Robot(_))), "{after:?}");
}

#[test]
fn power_and_brakes_that_may_still_come_are_not_called_stopped() {
    let mut bench = Bench::new();
    bench.robot.runtime_state = RuntimeState::Stopped;
    bench.feed(order(Order::Abort));
    bench.arm_settled = false;
    let reply = answer(&bench.ticks(300)).expect("an answer");
    assert!(!reply.accepted && reply.message.contains("may still come on"), "{reply:?}");
}

#[test]
fn disarmed_is_not_said_while_an_earlier_stop_still_brakes() {
    let mut bench = working();
    moving_arm(&mut bench);
    bench.feed(order(Order::Abort));
    let disarmed = bench.feed(Input::Order { number: 2, order: Order::Disarm });
    assert_eq!(answer(&disarmed), None, "{disarmed:?}");
    bench.robot.qd = [0.0; 6];
    let stopped = bench.feed(Input::Robot(RobotEvent::Stopped));
    let reported =
        |a: &&Action| matches!(a, Action::Reply { reply, .. } if reply.message == "stopped and disarmed");
    assert_eq!(stopped.iter().filter(reported).count(), 2, "{stopped:?}");
}

#[test]
fn arming_is_refused_while_the_arm_brakes_after_a_fault() {
    let mut bench = working();
    moving_arm(&mut bench);
    bench.feed(Input::Robot(RobotEvent::Safety { mode: SafetyMode::ProtectiveStop }));
    let reply = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    assert!(!reply.accepted && reply.message.contains("a stop is under way"), "{reply:?}");
    bench.robot.qd = [0.0; 6];
    bench.feed(Input::Robot(RobotEvent::Stopped));
    assert!(answer(&bench.feed(order(Order::Arm))).expect("an answer").accepted);
}

#[test]
fn what_was_seen_before_the_cell_was_disarmed_is_seen_anew() {
    // In the last pose, on the way to one, and with everything known.
    for stage in 0..3 {
        let mut bench = Bench::new();
        bench.job(true);
        bench.feed(order(Order::Arm));
        assert_eq!(streams(&bench.ticks(20)), 1);
        if stage > 0 {
            bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
            bench.ticks(10);
        }
        if stage > 1 {
            bench.feed(Input::Captured(Ok(Vec::new())));
        }
        // On its way the arm moves; a way on which it has not set out is withdrawn.
        bench.robot.qd[0] = if stage == 0 { 0.4 } else { 0.0 };
        bench.ticks(1);
        bench.feed(order(Order::Disarm));
        bench.robot.qd[0] = 0.0;
        bench.ticks(1);
        let late = match stage {
            0 => Input::Robot(RobotEvent::PathFinished { batch: 1 }),
            1 => Input::Captured(Ok(Vec::new())),
            _ => Input::Observed(Ok(Box::default())),
        };
        let late = bench.feed(late);
        assert!(
            !late.iter().any(|a| matches!(a, Action::Observe { .. } | Action::Plan(_))),
            "{stage}: {late:?}"
        );
        let mut after = bench.feed(order(Order::Arm));
        after.extend(bench.ticks(20));
        assert!(!after.iter().any(|a| matches!(a, Action::Plan(_))), "{stage}: {after:?}");
        let looks = streams(&after) + after.iter().filter(|a| matches!(a, Action::Capture { .. })).count();
        assert!(looks > 0, "{stage}: the table is looked at: {after:?}");
    }
    let mut bench = working();
    assert!(bench.cell.observation().is_some());
    bench.cell.mode.disarm();
    bench.feed(order(Order::Arm));
    assert!(bench.cell.observation().is_none());
}

#[test]
fn a_way_on_which_the_arm_has_not_set_out_is_withdrawn_when_the_cell_is_disarmed() {
    for lapses in [false, true] {
        let mut bench = Bench::new();
        bench.job(true);
        bench.feed(order(Order::Arm));
        assert_eq!(streams(&bench.ticks(20)), 1, "the way to the first look");
        let all = if lapses {
            bench.gripper_answers = false;
            bench.ticks(1)
        } else {
            bench.feed(order(Order::Disarm))
        };
        let stops = all.iter().filter(|action| matches!(action, Action::Robot(RobotCommand::Stop))).count();
        assert_eq!((stops, ended(&all)), (1, None), "{all:?}");
        let goes_on =
            |action: &Action| matches!(action, Action::Say(notice) if notice.text.contains("motion"));
        assert!(!all.iter().any(goes_on), "{all:?}");
        let mut after = bench.feed(Input::Robot(RobotEvent::Stopped));
        after.extend(bench.ticks(5));
        let replied = all.iter().chain(&after).find_map(|action| match action {
            Action::Reply { reply, .. } => Some(reply.message.clone()),
            _ => None,
        });
        assert_eq!(replied.as_deref(), (!lapses).then_some("stopped and disarmed"), "{after:?}");
        assert!(streams(&after) == 0 && bench.cell.status().text().starts_with("waiting"), "{after:?}");
    }
}

#[test]
fn celld_ends_after_the_gripper_has_confirmed_a_release_and_not_never() {
    for confirmed in [true, false] {
        let mut bench = working();
        moving_arm(&mut bench);
        bench.feed(order(Order::Release(Channels::Both)));
        bench.feed(Input::Shutdown);
        bench.robot.qd = [0.0; 6];
        let mut all = bench.feed(Input::Robot(RobotEvent::Stopped));
        all.extend(bench.ticks(20));
        assert!(vents(&all) && !all.iter().any(|action| matches!(action, Action::End(_))), "{all:?}");
        if confirmed {
            let released = bench.feed(Input::Gripper(GripperEvent::Released));
            assert!(answer(&released).expect("an answer").accepted, "{released:?}");
        }
        let end = bench.ticks(if confirmed { 2 } else { 310 });
        assert!(end.iter().any(|action| matches!(action, Action::End(_))), "{end:?}");
        assert_eq!(answer(&end).map(|reply| reply.accepted), (!confirmed).then_some(false), "{end:?}");
    }
}

#[test]
fn what_the_other_channel_still_holds_is_not_forgotten_with_a_release_of_one() {
    let mut bench = working();
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    bench.vacuum = [0.6, 0.6];
    bench.feed(Input::Gripper(GripperEvent::Gripped { vacuum: 0.6 }));
    bench.feed(order(Order::Release(Channels::A)));
    bench.feed(Input::Robot(RobotEvent::Stopped));
    bench.vacuum = [0.0, 0.6];
    let released = bench.feed(Input::Gripper(GripperEvent::Released));
    assert!(answer(&released).expect("an answer").accepted);
    assert_eq!(bench.cell.status().held.as_deref(), Some("holds a"));
    bench.vacuum = [0.0, 0.0];
    bench.feed(Input::Gripper(GripperEvent::VacuumLost { vacuum: 0.0 }));
    let refused = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    assert!(!refused.accepted && refused.message.contains("celld release --yes"), "{refused:?}");
    bench.feed(order(Order::Release(Channels::Both)));
    bench.feed(Input::Gripper(GripperEvent::Released));
    assert!(answer(&bench.feed(order(Order::Arm))).expect("an answer").accepted);
}

#[test]
fn a_release_takes_back_arming_at_the_start() {
    let mut bench = Bench::new();
    bench.cell.arm_at_start();
    bench.gripper_answers = false;
    bench.feed(order(Order::Release(Channels::Both)));
    bench.feed(Input::Gripper(GripperEvent::Released));
    bench.gripper_answers = true;
    bench.ticks(10);
    assert!(!bench.cell.status().armed);
}

#[test]
fn beside_the_workspace_too_the_arm_goes_up_before_it_goes_aside() {
    let bench = Bench::new();
    let arm = &bench.cell.model().arm;
    let at = |x: f64, z: f64| arm.joints_at(&tool_down(x, 0.25, z, 0.0), &HOME).expect("reachable");
    for (x, z, low) in [(-0.07, 0.02, true), (-0.07, 0.2, false), (0.25, 0.02, true), (0.25, 0.2, false)] {
        let up = bench.cell.straight_up_path(&at(x, z)).expect("free");
        assert_eq!(up.is_some(), low, "x {x}, z {z}");
    }
}

#[test]
fn what_was_held_before_the_start_may_be_any_object() {
    let mut bench = Bench::new();
    assert_eq!((bench.cell.hold(), bench.cell.held_depth()), (f64::INFINITY, 0.0));
    bench.vacuum = [0.5, 0.0];
    bench.ticks(1);
    let model = bench.cell.model();
    assert_eq!((bench.cell.hold(), bench.cell.held_depth()), (model.objects[0].hold, model.cycle.tallest));
}

#[test]
fn what_an_earlier_celld_had_gripped_is_named_where_there_is_vacuum() {
    let before = HeldBefore {
        object: "a".into(),
        to: Pose2::new(0.3, 0.3, 0.0),
        tool_from_object: None,
        table: vec![("b".into(), Pose2::new(0.1, 0.1, 0.0))],
    };
    let fell = "a may have fallen before celld started, or hangs on the cups";
    for (vacuum, held) in [([0.5, 0.0], Some("holds a")), ([0.12, 0.0], Some(fell)), ([0.0, 0.0], None)] {
        let mut bench = Bench::new();
        bench.cell.model.held_before = Some(before.clone());
        bench.gripper_answers = false;
        bench.ticks(3);
        let may = Some("a may hang on the cups");
        assert_eq!(bench.cell.status().held.as_deref(), may, "before the gripper answers");
        (bench.gripper_answers, bench.vacuum) = (true, [0.0, 0.0]);
        bench.ticks(3);
        assert_eq!(bench.cell.status().held.as_deref(), may, "a gripper whose power was cut shows no vacuum");
        bench.feed(order(Order::Arm));
        assert!(!bench.cell.mode().armed(), "it may hang there");
        bench.gripper_answers = false;
        bench.ticks(150);
        bench.gripper_answers = true;
        bench.ticks(1);
        assert_eq!(bench.cell.status().held.as_deref(), may, "silence is no second without vacuum");
        bench.vacuum = vacuum;
        let all = bench.ticks(150);
        let let_go =
            all.iter().any(|action| matches!(action, Action::Commit { record: Record::LetGo { .. }, .. }));
        assert_eq!(let_go, held.is_none(), "what has gone is not taken for held at a later start");
        assert_eq!(bench.cell.back.table.is_empty(), held.is_none(), "what it hides from a look is known");
        assert_eq!(bench.cell.status().held.as_deref(), held);
        let mass = if held.is_some() { bench.cell.model().objects[0].mass } else { 0.0 };
        assert_eq!(bench.cell.held_mass(), mass);
        // What hangs there later is another thing.
        bench.vacuum = [0.5, 0.0];
        bench.ticks(3);
        assert_eq!(bench.cell.status().held.as_deref(), held);
    }
}

#[test]
fn where_an_object_was_that_is_not_seen_now_nothing_is_put_down() {
    let there = Pose2::new(0.3, 0.3, 0.0);
    for (table, free) in [(vec![("b".into(), there)], false), (Vec::new(), true)] {
        let mut bench = Bench::new();
        let second = CellObject { id: "b".into(), ..object() };
        bench.cell = Supervisor::new(CellModel { objects: vec![object(), second], ..model() }, 7);
        let hangs = Pose2::default();
        let before = HeldBefore { object: "a".into(), to: there, tool_from_object: Some(hangs), table };
        bench.cell.model.held_before = Some(before);
        bench.vacuum = [0.6, 0.0];
        bench.ticks(3);
        assert_eq!(bench.cell.status().held.as_deref(), Some("holds a"));
        let seen = Observation::default();
        let mut search = bench.cell.places_for_held(there, &seen).expect("something is held");
        let tried = |ms: u64| match bench.cell.try_place(
            Timestamp::ZERO + Duration::from_millis(ms),
            &HOME,
            &seen,
            &mut search,
        ) {
            Searched::Found(place, meant, _) => Some((place, meant)),
            Searched::NotYet => None,
            Searched::Nowhere(why) => panic!("there is room: {why}"),
        };
        let (place, meant) = (0..20).find_map(tried).expect("there is room");
        assert_eq!(meant, free, "{place:?}");
        let meets = penetration(&object().footprint, &place, &object().footprint, &there) > 0.0;
        assert_eq!(meets, free, "{place:?}");
    }
}

#[test]
fn a_new_look_is_announced_only_where_the_arm_goes_on() {
    let rejected = || {
        let mut bench = Bench::new();
        bench.job(false);
        bench.feed(order(Order::Arm));
        bench.ticks(20);
        bench.unknown = vec![33];
        bench
    };
    let again = "looks again now";
    let mut bench = rejected();
    let first = bench.look();
    assert!(said(&first, again) && ended(&first).is_none(), "{first:?}");
    assert_eq!(streams(&first) + streams(&bench.ticks(20)), 1, "as announced");
    for stop in [Order::Pause, Order::Abort, Order::Disarm, Order::Cancel("j".into())] {
        let mut bench = rejected();
        bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
        bench.ticks(10);
        bench.feed(Input::Captured(Ok(Vec::new())));
        let mut all = bench.feed(order(stop.clone()));
        let unknown = Observation { unknown: vec![33], ..Observation::default() };
        all.extend(bench.feed(Input::Observed(Ok(Box::new(unknown)))));
        all.extend(bench.ticks(200));
        assert!(!said(&all, again) && streams(&all) == 0, "{stop:?}: {all:?}");
    }
}

#[test]
fn a_place_out_of_reach_ends_the_job_with_what_to_do_about_it() {
    let mut bench = Bench::new();
    let mut far = model();
    far.arm.base_from_table = Isometry3::translation(-0.25, 0.6, 0.0);
    bench.cell = Supervisor::new(far, 7);
    bench.at = Pose2::new(0.25, 0.45, 0.0);
    bench.job(false);
    bench.until_planning();
    let all = bench.plan();
    let report = all.iter().find_map(|action| match action {
        Action::Commit { record: Record::Ended(report), .. } => Some(report),
        _ => None,
    });
    let report = report.expect("the job ends before its first move");
    assert_eq!((report.code_text(), report.object.as_deref()), ("unreachable".into(), Some("a")));
    assert!(report.hint.contains("without being stretched out"), "{report:?}");
    assert_eq!(streams(&all), 0);
}

#[test]
fn a_job_that_was_cut_off_is_a_stop_that_is_left_like_any_other() {
    for (carrying, code, way) in
        [(true, Code::InterruptedCarrying, "shows the ways back"), (false, Code::Interrupted, "`celld arm`")]
    {
        let message = "job j was cut off in step 2 (a) when an earlier celld ended".to_string();
        let cut_off = Some(CutOff { object: "a".into(), carrying, message });
        let mut bench = Bench::new();
        bench.cell = Supervisor::new(CellModel { cut_off, ..model() }, 7);
        bench.ticks(3);
        let status = bench.cell.status();
        let stopped = status.stopped.expect("a stop that is still to be left");
        assert_eq!((stopped.code, stopped.hint.contains(way)), (code, true), "{stopped:?}");
        assert!(status.hint.contains("celld recover"), "{}", status.hint);
        let all = bench.feed(order(Order::Recover(WayBack::Show)));
        let said = answer(&all).expect("an answer").message;
        assert!(said.contains("job j was cut off in step 2"), "{said}");
    }
}

#[test]
fn where_an_object_was_before_it_was_gripped_is_no_result() {
    for gripped in [false, true] {
        let mut bench = working();
        bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
        if gripped {
            bench.vacuum = [0.6, 0.6];
            bench.feed(Input::Gripper(GripperEvent::Gripped { vacuum: 0.6 }));
        }
        let all = bench.feed(order(Order::Abort));
        let measured = all.iter().find_map(|action| match action {
            Action::Commit { record: Record::Ended(report), .. } => Some(report.objects[0].measured),
            _ => None,
        });
        let (pose, age) =
            (measured.expect("the job has ended").map(|m| m.0), measured.flatten().map(|m| m.1));
        assert_eq!(pose, (!gripped).then_some(bench.at), "{all:?}");
        assert!(gripped || age.is_some_and(|age| age > Duration::ZERO), "{age:?}");
    }
}

/// The arm stops, the job stays; what is said of it is so while it is so. A heartbeat that is missed at rest
/// stops nothing, and ends a job that may not outlive it.
#[test]
fn a_kept_job_is_named_until_it_is_cancelled_and_nothing_goes_on_by_itself() {
    let missed = || Input::Robot(RobotEvent::ProgramEnded { reason: ProgramEnd::HeartbeatLost });
    let mut bench = working();
    bench.cell.model.tolerances.stop_retries = 1;
    let all = bench.feed(missed());
    assert!(all.iter().any(|action| matches!(action, Action::Robot(RobotCommand::Stop))), "{all:?}");
    assert_eq!(ended(&all), None);
    let stopped = bench.ticks(100);
    assert_eq!(streams(&stopped), 0, "{stopped:?}");
    let status = bench.cell.status();
    assert!(!status.armed && status.job.is_some());
    assert!(status.stopped.is_some_and(|stop| stop.hint.contains("`celld arm` has job j look")));
    let mut ending = working();
    ending.cell.model.tolerances.stop_retries = 1;
    ending.feed(missed());
    assert_eq!(ended(&ending.feed(Input::Shutdown)), Some((JobStatus::Interrupted, "shutdown".into())));
    ending.robot.robot_mode = RobotMode::PowerOff;
    ending.feed(Input::Robot(RobotEvent::Mode { mode: RobotMode::PowerOff }));
    let stopped = ending.cell.status().stopped.expect("the stop before the end");
    assert_eq!(stopped.code, Code::HeartbeatLost);
    assert!(stopped.hint.ends_with("then `celld arm` and submit again"), "{stopped:?}");
    let mut all = bench.feed(order(Order::Cancel("j".into())));
    all.extend(bench.ticks(3));
    assert_eq!(ended(&all), Some((JobStatus::Cancelled, "cancelled".into())));
    let status = bench.cell.status();
    assert!(status.stopped.is_some_and(|stop| !stop.hint.contains("go on")), "there is no job to go on");

    for (retries, end) in [(0, Some((JobStatus::Interrupted, "heartbeat_lost".to_string()))), (1, None)] {
        let mut bench = Bench::new();
        bench.cell.model.tolerances.stop_retries = retries;
        bench.job(true);
        bench.until_planning();
        bench.plan();
        assert_eq!(ended(&bench.feed(missed())), end, "it waits for approval");
        assert!(!bench.cell.status().armed);
    }
}
