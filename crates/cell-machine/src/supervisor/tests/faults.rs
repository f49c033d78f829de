//! Stops, faults and hands on the table: when the cell may go on by itself, and when a person has to say so.

use super::*;
use crate::device::robot_types::ProgramEnd;
use crate::supervisor::input::CameraFault;
use cell_motion::path::Segment;
use cell_motion::pick_n_place::tool_down;
use rearrange::geometry::footprint::Footprint;
use ur_arm::kinematics::DhParameters;

/// At the plan request, then on the way to the pick.
pub(super) fn working() -> Bench {
    let mut bench = Bench::new();
    bench.job(false);
    bench.until_planning();
    assert_eq!(streams(&bench.plan()), 1);
    bench
}

pub(super) fn said(actions: &[Action], what: &str) -> bool {
    actions.iter().any(|action| matches!(action, Action::Say(notice) if notice.text.contains(what)))
}

#[test]
fn after_a_stop_and_arming_a_new_program_is_started_and_the_next_job_runs() {
    let mut bench = working();
    let stopped = bench.feed(order(Order::Abort));
    assert_eq!(ended(&stopped), Some((JobStatus::Interrupted, "aborted".into())));
    bench.feed(Input::Robot(RobotEvent::Stopped));
    // The register keeps the old program's number; the controller says that it ended.
    let reason = ProgramEnd::StoppedByUs;
    bench.feed(Input::Robot(RobotEvent::ProgramEnded { reason }));
    bench.job(false);
    bench.feed(order(Order::Arm));
    // Starting ours ends whatever is left of the old one, which is no fault.
    let reason = ProgramEnd::AsRequested;
    bench.feed(Input::Robot(RobotEvent::ProgramEnded { reason }));
    let actions = bench.ticks(20);
    assert_eq!(ended(&actions), None, "{actions:?}");
    assert_eq!(streams(&actions), 1, "the look begins");
    assert!(bench.look().iter().any(|action| matches!(action, Action::Plan(_))));
}

#[test]
fn a_stop_while_nothing_moves_disarms_and_nothing_starts_by_itself() {
    let events = [
        RobotEvent::Safety { mode: SafetyMode::RobotEmergencyStop },
        RobotEvent::ProgramEnded { reason: ProgramEnd::FromOutside },
        RobotEvent::RtdeLost,
        RobotEvent::RemoteControl { on: false },
    ];
    for event in events {
        let mut bench = Bench::new();
        bench.feed(order(Order::Arm));
        bench.feed(Input::Robot(event.clone()));
        assert!(!bench.cell.status().armed, "{event:?}");
        // The stop is released, power is off, a job waits: the cell must not wake up.
        bench.robot.robot_mode = RobotMode::PowerOff;
        let mut all = bench.job(false);
        all.extend(bench.ticks(200));
        assert!(!all.iter().any(|action| matches!(action, Action::Robot(_))), "{event:?}: {all:?}");
    }
}

#[test]
fn an_emergency_stop_while_a_plan_is_made_ends_the_job() {
    let mut bench = Bench::new();
    bench.job(false);
    bench.until_planning();
    let stopped = bench.feed(Input::Robot(RobotEvent::Safety { mode: SafetyMode::RobotEmergencyStop }));
    assert_eq!(ended(&stopped), Some((JobStatus::Interrupted, "emergency_stop".into())));
    assert_eq!(streams(&bench.plan()), 0, "the plan comes too late");
}

#[test]
fn a_planner_that_fails_ends_its_job_with_the_reason_and_the_next_job_is_planned() {
    let mut bench = Bench::new();
    bench.job(false);
    bench.until_planning();
    let failed = bench.feed(Input::Planned(Box::new(PlanAnswer::Failed("index 256 of 256".into()))));
    assert_eq!(ended(&failed), Some((JobStatus::Failed, "planner_stuck".into())));
    let told = failed.iter().any(|action| match action {
        Action::Commit { record: Record::Ended(report), .. } => {
            report.message.contains("index 256 of 256") && report.hint.contains("another seed or solver")
        }
        _ => false,
    });
    assert!(told, "{failed:?}");
    bench.feed(order(Order::Disarm));
    bench.job(false);
    assert!(bench.until_planning().iter().any(|action| matches!(action, Action::Plan(_))));
}

#[test]
fn disarming_in_the_middle_of_a_look_keeps_the_arm_where_it_is() {
    let mut bench = Bench::new();
    bench.cell = Supervisor::new(CellModel { look_poses: vec![HOME, HOME], ..model() }, 7);
    bench.job(false);
    bench.feed(order(Order::Arm));
    bench.ticks(20);
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    bench.ticks(10);
    let reported = bench.feed(order(Order::Disarm));
    assert!(said(&reported, "disarmed"));
    let mut all = bench.feed(Input::Captured(Ok(Vec::new())));
    all.extend(bench.ticks(200));
    assert_eq!(streams(&all), 0, "{all:?}");
    // Armed again, the look begins anew: nothing of the first pose is kept.
    let again = bench.feed(order(Order::Arm));
    assert_eq!(streams(&again), 1);
    assert!(bench.look().iter().any(|action| matches!(action, Action::Plan(_))));
}

#[test]
fn disarming_while_the_arm_is_powered_up_leaves_its_brakes_shut() {
    let mut bench = Bench::new();
    bench.robot.robot_mode = RobotMode::PowerOff;
    bench.job(false);
    bench.feed(order(Order::Arm));
    bench.feed(order(Order::Disarm));
    bench.robot.robot_mode = RobotMode::Idle;
    let all = bench.ticks(100);
    assert!(!all.iter().any(|action| matches!(action, Action::Robot(_))), "{all:?}");
}

#[test]
fn from_between_the_objects_the_arm_goes_straight_up_first() {
    let mut bench = Bench::new();
    let arm = &bench.cell.model().arm;
    let low = arm.joints_in_work_posture(&tool_down(0.2, 0.2, 0.015, 0.0), &HOME).expect("in reach");
    bench.robot.q = low;
    bench.job(false);
    bench.feed(order(Order::Arm));
    let actions = bench.ticks(20);
    let path = actions.iter().find_map(|action| match action {
        Action::Robot(RobotCommand::Stream(path)) => Some(path),
        _ => None,
    });
    let segments = path.expect("the look begins").segments();
    let Segment::Linear { target, .. } = &segments[0] else { panic!("not straight: {segments:?}") };
    let arm = &bench.cell.model().arm;
    let (from, to) = (arm.tool_at(&low).translation, arm.tool_at(target).translation);
    assert!((from.x - to.x).hypot(from.y - to.y) < 1e-6 && to.z > 0.045, "{from} to {to}");
}

#[test]
fn nothing_moves_while_something_may_hang_on_the_gripper() {
    let mut bench = Bench::new();
    bench.feed(order(Order::Arm));
    bench.vacuum = [0.0, 0.4];
    bench.job(false);
    let mut all = bench.ticks(3);
    all.extend(bench.feed(order(Order::Park)));
    all.extend(bench.ticks(200));
    assert_eq!(streams(&all), 0, "{all:?}");
    assert!(said(&all, "there is vacuum") && said(&all, "celld recover"), "{all:?}");
    bench.vacuum = [0.0, 0.0];
    assert_eq!(streams(&bench.ticks(20)), 1, "empty again, it goes on");
}

#[test]
fn a_gripper_that_stops_answering_disarms_the_cell_and_the_job_waits() {
    let mut bench = Bench::new();
    bench.feed(order(Order::Arm));
    bench.gripper_answers = false;
    let mut all = bench.ticks(1);
    all.extend(bench.job(false));
    all.extend(bench.ticks(50));
    for part in ["disarmed: gripper not responding", "10.0.0.3:502", "celld arm"] {
        assert!(said(&all, part), "{part}: {all:?}");
    }
    let reply = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    for part in ["the gripper does not answer", "10.0.0.3:502", "devices.gripper", "ping"] {
        assert!(!reply.accepted && reply.message.contains(part), "{part}: {}", reply.message);
    }
    bench.gripper_answers = true;
    all.extend(bench.ticks(500));
    assert_eq!((streams(&all), ended(&all)), (0, None), "the job waits for a person");
    bench.feed(order(Order::Arm));
    assert_eq!(streams(&bench.ticks(20)), 1);
}

#[test]
fn the_pendant_in_local_control_stops_a_motion() {
    let mut bench = working();
    bench.robot.remote_control = Some(false);
    let actions = bench.feed(Input::Tick);
    assert!(matches!(actions.first(), Some(Action::Robot(RobotCommand::Stop))), "{actions:?}");
}

#[test]
fn a_short_pause_costs_no_deadline_and_a_long_one_ends_the_motion() {
    let mut bench = working();
    bench.robot.runtime_state = RuntimeState::Paused;
    let short = bench.ticks(29 * 50);
    assert_eq!(ended(&short), None, "{short:?}");
    bench.robot.runtime_state = RuntimeState::Playing;
    let on = bench.ticks(19 * 50);
    assert_eq!(ended(&on), None, "29 s of pause are not counted against the 20 s of the phase: {on:?}");
    bench.robot.runtime_state = RuntimeState::Paused;
    let long = bench.ticks(31 * 50);
    assert_eq!(ended(&long), Some((JobStatus::Interrupted, "paused_too_long".into())));
}

#[test]
fn letting_go_in_mid_carry_stops_the_arm_first_and_opens_only_that_channel() {
    let mut bench = working();
    let mut actions = bench.feed(order(Order::Release(Channels::B)));
    actions.extend(bench.feed(Input::Robot(RobotEvent::Stopped)));
    let stop = actions.iter().position(|a| matches!(a, Action::Robot(RobotCommand::Stop)));
    let open = actions.iter().position(
        |a| matches!(a, Action::Gripper(GripperCommand::Release { channels }) if *channels == Channels::B),
    );
    assert!(stop.is_some() && stop < open, "{actions:?}");
    assert_eq!(ended(&actions), Some((JobStatus::Interrupted, "released".into())));
}

#[test]
fn a_disarmed_cell_does_not_remember_an_order_to_park() {
    let mut bench = Bench::new();
    let reported = bench.feed(order(Order::Park));
    assert!(answer(&reported).is_some_and(|reply| !reply.accepted), "{reported:?}");
    let mut all = bench.feed(order(Order::Arm));
    all.extend(bench.ticks(100));
    assert_eq!(streams(&all), 0, "{all:?}");
}

#[test]
fn a_second_job_looks_for_itself() {
    let mut bench = Bench::new();
    bench.job(true);
    bench.until_planning();
    bench.plan();
    bench.feed(order(Order::Reject("j".into())));
    let actions = bench.job(false);
    assert_eq!(streams(&actions), 1, "{actions:?}");
    assert!(!actions.iter().any(|action| matches!(action, Action::Plan(_))), "{actions:?}");
}

#[test]
fn another_arm_cannot_be_armed() {
    let mut bench = Bench::new();
    bench.feed(order(Order::Arm));
    let mut dh = DhParameters::UR5E;
    bench.feed(Input::Robot(RobotEvent::Kinematics { dh, checksum: [0; 6] }));
    assert!(bench.cell.status().armed, "the same arm connected again");
    dh.a[1] += 1e-4;
    bench.feed(Input::Robot(RobotEvent::Kinematics { dh, checksum: [1; 6] }));
    let reported = bench.feed(order(Order::Arm));
    let refused =
        answer(&reported).is_some_and(|reply| !reply.accepted && reply.message.contains("not armed"));
    assert!(!bench.cell.status().armed && refused, "{reported:?}");
}

#[test]
fn an_unknown_marker_on_the_table_is_not_free_room() {
    let mut bench = Bench::new();
    bench.unknown = vec![77];
    bench.job(false);
    let mut all = bench.until_planning();
    all.extend(bench.look());
    assert_eq!(ended(&all), Some((JobStatus::Failed, "unknown_marker".into())), "{all:?}");

    let mut ignoring = Bench::new();
    ignoring.unknown = vec![78];
    ignoring.job(false);
    assert!(ignoring.until_planning().iter().any(|action| matches!(action, Action::Plan(_))));
}

#[test]
fn objects_of_the_catalogue_that_are_not_seen_are_reported_once() {
    let mut bench = Bench::new();
    bench.missing = vec!["b".into()];
    bench.job(false);
    let all = bench.until_planning();
    let reported = all
        .iter()
        .filter(|a| matches!(a, Action::Say(n) if n.alarm && n.text.starts_with("not seen: b;")))
        .count();
    assert_eq!(reported, 1, "{all:?}");
    bench.plan();
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    assert!(!said(&bench.ticks(50), "not seen: b"));
}

#[test]
fn the_gripper_does_not_come_down_onto_a_taller_neighbour() {
    let tall = CellObject {
        id: "tower".into(),
        footprint: Footprint::rectangle(0.04, 0.04).expect("valid"),
        height: 0.1,
        ..model().objects.remove(0)
    };
    for (y, fits) in [(0.39, true), (0.36, false)] {
        let mut bench = Bench::new();
        let mut model = model();
        model.objects.push(tall.clone());
        bench.cell = Supervisor::new(model, 7);
        bench.other = Some(("tower".into(), Pose2::new(0.15, y, 0.0)));
        bench.job(false);
        bench.until_planning();
        let actions = bench.plan();
        let end = ended(&actions);
        assert_eq!(end.is_none(), fits, "tower at {y}: {actions:?}");
        assert!(fits || end == Some((JobStatus::Failed, "unpickable:a".into())));
    }
}

#[test]
fn approval_of_the_first_plan_covers_the_next_for_the_same_goal() {
    for (approval, waits) in [(Approval::Job, false), (Approval::Always, true)] {
        let mut bench = Bench::new();
        bench.job_with(approval);
        bench.until_planning();
        assert_eq!(streams(&bench.plan()), 0, "the first plan waits");
        bench.feed(order(Order::Pause));
        bench.feed(order(bench.approval()));
        // Meanwhile the object was moved by hand: the plan does not fit any more.
        bench.at = Pose2::new(0.15, 0.2, 0.0);
        bench.now += Duration::from_secs(40);
        let looking = bench.feed(order(Order::Resume));
        assert_eq!(streams(&looking), 1, "{looking:?}");
        assert!(bench.look().iter().any(|action| matches!(action, Action::Plan(_))));
        let actions = bench.plan();
        assert_eq!(streams(&actions) == 0, waits, "{approval:?}: {actions:?}");
    }
}

fn camera_fault(code: Code, lasting: bool) -> Input {
    let message = "the camera is frozen".to_string();
    Input::Captured(Err(CameraFault { code, message, hint: "look at its cable".into(), lasting }))
}

/// At the first look pose, with a picture requested.
fn looking() -> Bench {
    let mut bench = Bench::new();
    bench.job(false);
    bench.feed(order(Order::Arm));
    bench.ticks(20);
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    let settled = bench.ticks(10);
    assert!(settled.iter().any(|action| matches!(action, Action::Capture { .. })), "{settled:?}");
    bench
}

#[test]
fn a_camera_without_pictures_is_waited_for_and_named_once() {
    let mut bench = looking();
    let mut all = Vec::new();
    for _ in 0..5 {
        all.extend(bench.feed(camera_fault(Code::CameraFrozen, false)));
        all.extend(bench.ticks(10));
    }
    assert_eq!(streams(&all), 0, "the arm rests");
    let requested = all.iter().filter(|action| matches!(action, Action::Capture { .. })).count();
    let reported = all.iter().filter(|action| matches!(action, Action::Say(notice) if notice.alarm)).count();
    assert_eq!((requested, reported, ended(&all)), (5, 1, None), "{all:?}");
    assert_eq!(bench.cell.status().text(), "looking 1/1, waiting: camera_frozen");
    all.extend(bench.feed(camera_fault(Code::CameraDark, false)));
    assert!(said(&all, "camera_dark"), "another fault is reported again");
    bench.ticks(10);
    let back = bench.feed(Input::Captured(Ok(Vec::new())));
    assert!(said(&back, "gives pictures again"));
    assert!(back.iter().any(|action| matches!(action, Action::Observe { .. })), "{back:?}");
}

#[test]
fn a_camera_that_stays_away_fails_the_job_by_its_name_and_leaves_the_cell_armed() {
    let mut bench = looking();
    let mut all = bench.feed(camera_fault(Code::CameraUnplugged, false));
    // The look's deadline is 20 s; a tick here is 20 ms.
    all.extend(bench.ticks(1100));
    assert_eq!(ended(&all), Some((JobStatus::Failed, "camera_unplugged".into())));
    assert!(bench.cell.status().armed && !all.iter().any(|a| matches!(a, Action::Robot(_))), "{all:?}");
    let mut next = bench.job(false);
    next.extend(bench.ticks(5));
    assert_eq!(streams(&next), 1, "the next job looks again");
}

#[test]
fn another_camera_than_the_calibrated_one_is_not_waited_for() {
    let mut bench = looking();
    let reported = bench.feed(camera_fault(Code::CameraMisfit, true));
    assert_eq!(ended(&reported), Some((JobStatus::Failed, "camera_misfit".into())));
}

#[test]
fn a_camera_that_says_nothing_at_all_fails_the_job_and_leaves_the_cell_armed() {
    let mut bench = looking();
    // The look's deadline is 20 s; a tick here is 20 ms.
    let all = bench.ticks(1_100);
    assert_eq!(ended(&all), Some((JobStatus::Failed, "camera_unplugged".into())));
    assert!(bench.cell.status().armed);
}

#[test]
fn an_order_is_answered_by_what_it_led_to() {
    let reported = |bench: &mut Bench, given: Order| {
        let reply = answer(&bench.feed(order(given))).expect("an answer");
        (reply.accepted, reply.message)
    };
    let mut bench = Bench::new();
    assert_eq!(reported(&mut bench, Order::Resume), (true, "nothing was paused".into()));
    assert_eq!(reported(&mut bench, Order::Pause), (true, "paused; no job is under way".into()));
    assert_eq!(reported(&mut bench, Order::Pause), (true, "paused already".into()));
    assert!(!reported(&mut bench, Order::Park).0 && !reported(&mut bench, Order::Step).0, "disarmed");
    let armed = reported(&mut bench, Order::Arm);
    assert!(armed.0 && armed.1.contains("a pause is in force"), "{armed:?}");
    assert_eq!(reported(&mut bench, Order::Arm), (true, "armed already".into()));
    assert_eq!(reported(&mut bench, Order::Resume), (true, "goes on".into()));
    assert!(!reported(&mut bench, Order::Cancel("j".into())).0, "there is no job");
    bench.job(true);
    bench.ticks(20);
    let early = reported(&mut bench, Order::Approve { id: "j".into(), plan: 0 });
    assert!(!early.0 && early.1.contains("does not wait for approval"), "{early:?}");
    bench.robot.qd[0] = 0.4;
    bench.ticks(1);
    assert!(reported(&mut bench, Order::Disarm).1.contains("goes on to its next stop"));
    let armed = reported(&mut bench, Order::Arm);
    let looks = "armed: the arm moves to look at the table now; the plan then waits for approval";
    assert_eq!(armed, (true, looks.into()));
    let mut bench = working();
    for (given, parks) in [(Order::Pause, false), (Order::Park, true), (Order::Pause, false)] {
        let (_, message) = reported(&mut bench, given);
        assert_eq!(bench.cell.mode.parks(), parks, "{message}");
    }
    bench.feed(order(Order::Disarm));
    let armed = reported(&mut bench, Order::Arm);
    assert!(armed.1.contains("the pick-n-place under way goes on"), "{armed:?}");
    let mut bench = working();
    assert_eq!(
        reported(&mut bench, Order::Step),
        (true, "the pick-n-place under way is this step; then a pause".into())
    );
    let on = "goes on: no pause follows this pick-n-place";
    assert_eq!(reported(&mut bench, Order::Resume), (true, on.into()), "before the pause has come");
    assert!(bench.cell.mode.runs());
    let mut bench = working();
    assert!(reported(&mut bench, Order::Disarm).1.contains("finished first"));
}

#[test]
fn a_release_is_answered_by_what_the_gripper_says() {
    let mut bench = Bench::new();
    let ordered = bench.feed(order(Order::Release(Channels::Both)));
    assert_eq!(answer(&ordered), None, "not before the air is in: {ordered:?}");
    let released = bench.feed(Input::Gripper(crate::device::gripper_types::GripperEvent::Released));
    assert!(answer(&released).expect("an answer").accepted);
    bench.feed(order(Order::Release(Channels::A)));
    let failed = crate::device::gripper_types::GripperEvent::ReleaseFailed { vacuum: 0.4 };
    let reply = answer(&bench.feed(Input::Gripper(failed))).expect("an answer");
    assert!(!reply.accepted && reply.message.contains("40 %"), "{reply:?}");
}

#[test]
fn a_cell_that_cannot_be_armed_says_so_to_every_order_about_motion() {
    let mut bench = Bench::new();
    let mut dh = *bench.cell.model().arm.kinematics.dh();
    dh.d[0] += 0.001;
    bench.feed(Input::Robot(RobotEvent::Kinematics { dh, checksum: [0; 6] }));
    for wanted in [Order::Arm, Order::Pause, Order::Step, Order::Park] {
        let reply = answer(&bench.feed(order(wanted.clone()))).expect("an answer");
        assert!(!reply.accepted && reply.message.contains("another arm answers"), "{wanted:?}: {reply:?}");
    }
}

#[test]
fn parking_is_not_held_back_by_a_pause_and_a_pause_takes_it_back() {
    let mut bench = Bench::new();
    bench.job(false);
    bench.feed(order(Order::Arm));
    bench.ticks(20);
    bench.feed(order(Order::Pause));
    bench.feed(order(Order::Park));
    assert_eq!(streams(&bench.look()), 1);
    assert!(answer(&bench.feed(order(Order::Park))).expect("an answer").message == "parks now");
    let mut bench = working();
    bench.feed(order(Order::Park));
    bench.feed(order(Order::Pause));
    assert!(!bench.cell.mode().parks(), "who pauses expects that nothing moves after the pick-n-place");
}

#[test]
fn what_falls_while_no_job_is_under_way_is_an_alarm() {
    let mut bench = Bench::new();
    let lost = crate::device::gripper_types::GripperEvent::VacuumLost { vacuum: 0.1 };
    let fallen = bench.feed(Input::Gripper(lost));
    assert!(said(&fallen, "fell near x ") && said(&fallen, "see where it lies"), "{fallen:?}");
    assert!(bench.cell.status().held.expect("in the status").contains("fell near x "));
}

#[test]
fn a_vacuum_that_falls_while_no_job_is_under_way_is_an_alarm() {
    let mut bench = Bench::new();
    let weak = crate::device::gripper_types::GripperEvent::VacuumWeak { vacuum: 0.4, best: 0.6 };
    let warned = bench.feed(Input::Gripper(weak));
    assert!(said(&warned, "fell from 60 to 40 %") && said(&warned, "it may fall"), "{warned:?}");
    bench.job(false);
    bench.until_planning();
    assert_eq!(streams(&bench.plan()), 1, "it was none of this job's");
}
