//! Looks at parts of the table: what has to be seen when, what is remembered, and what is written down
//! meanwhile.

use super::*;
use crate::device::gripper_types::GripperEvent;
use crate::supervisor::holding::outline_in_tool;
use crate::supervisor::input::CameraFault;
use crate::supervisor::status::Doing;
use crate::views::SightModel;
use cell_motion::bodies::Standing;
use cell_motion::put_down::Grasp;
use cell_vision::camera::CameraModel;
use cell_vision::observe::{PartialLook, ReferenceMarker, View};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use std::sync::Arc;

/// The goals of a job with two objects, and where `b` is.
pub(super) const GOAL_A: Pose2 = Pose2 { x: 0.35, y: 0.3, theta: 0.0 };
pub(super) const AT_B: Pose2 = Pose2 { x: 0.15, y: 0.1, theta: 0.0 };
pub(super) const GOAL_B: Pose2 = Pose2 { x: 0.35, y: 0.1, theta: 0.0 };
/// `c` is no object of the job, and lies far from where the others go.
pub(super) const AT_C: Pose2 = Pose2 { x: 0.05, y: 0.45, theta: 0.0 };

fn wrist_camera() -> SightModel {
    let camera = CameraModel {
        serial: "test".into(),
        width: 1280,
        height: 720,
        fx: 650.0,
        fy: 650.0,
        cx: 639.5,
        cy: 359.5,
        distortion: [0.0; 5],
    };
    let sides = [-0.045, 0.167, 0.333, 0.545];
    let places = sides.into_iter().flat_map(|at| [[at, -0.045], [at, 0.545], [-0.045, at], [0.545, at]]);
    let marker =
        |(id, [x, y]): (u32, [f64; 2])| ReferenceMarker { id, size: 0.03, pose: Pose2::new(x, y, 0.0) };
    let references = (500..).zip(places).map(marker).collect();
    SightModel { camera, references, smallest_m: 0.03, own: None, views: Arc::default() }
}

/// A cell with a camera on its wrist and three objects, `a` and `b` to be moved: the arm sets out to look.
fn about_to_look(look_poses: Vec<Joints>) -> Bench {
    let mut bench = Bench::new();
    let named = |id: &str, marker: u32| {
        let object = object();
        CellObject { id: id.into(), marker: MarkerSpec { id: marker, ..object.marker.clone() }, ..object }
    };
    let objects = vec![named("a", 0), named("b", 1), named("c", 2)];
    bench.cell =
        Supervisor::new(CellModel { objects, sight: Some(wrist_camera()), look_poses, ..model() }, 7);
    let order_of_two = JobOrder {
        id: "j".into(),
        goals: vec![("a".into(), GOAL_A), ("b".into(), GOAL_B)],
        objective: Objective::Pp,
        solver: SolverKind::Erbm,
        time_limit: Duration::from_secs(1),
        seed: 0,
        approval: Approval::Never,
        rule: None,
        agreed: Vec::new(),
    };
    bench.feed(Input::Job(Box::new(order_of_two)));
    bench.feed(order(Order::Arm));
    bench.ticks(20);
    bench
}

/// The same with the whole table seen and the plan found: the arm sets out for `a`.
pub(super) fn carried_out() -> Bench {
    let mut bench = about_to_look(vec![HOME]);
    reach_and_picture(&mut bench);
    bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &[("a", bench.at), ("b", AT_B), ("c", AT_C)])))));
    let action = |object, from, to| PlanAction { object, from, to, kind: ActionKind::Goal };
    let actions = vec![action(0, bench.at, GOAL_A), action(1, AT_B, GOAL_B)];
    let answer = PlanAnswer::Found { actions, cost: 2.0, lower_bound: 2.0, seconds: 0.01 };
    assert_eq!(streams(&bench.feed(Input::Planned(Box::new(answer)))), 1);
    bench
}

/// The arm comes to its look pose, the frames are exposed and searched, and the arm rests; what the cell
/// does then.
fn reach_and_picture(bench: &mut Bench) -> Vec<Action> {
    let exposed = reach_and_expose(bench);
    if exposed.iter().any(|action| matches!(action, Action::Robot(RobotCommand::SetOut(_)))) {
        bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 2 }));
    }
    bench.feed(Input::Captured(Ok(Vec::new())))
}

/// The arm comes to its look pose and the frames are exposed; what the cell does then.
pub(super) fn reach_and_expose(bench: &mut Bench) -> Vec<Action> {
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    let settled = bench.ticks(10);
    assert!(settled.iter().any(|action| matches!(action, Action::Capture { .. })), "{settled:?}");
    bench.feed(Input::Exposed)
}

pub(super) fn seen(bench: &Bench, objects: &[(&str, Pose2)]) -> Observation {
    let missing = ["a", "b", "c"].into_iter().filter(|id| !objects.iter().any(|(seen, _)| seen == id));
    Observation {
        objects: objects.iter().map(|(id, pose)| estimate(id, *pose, bench.now)).collect(),
        missing: missing.map(str::to_string).collect(),
        reference: Some(bench.reference.clone()),
        ..Observation::default()
    }
}

/// From the pick of `a` to where its vacuum has gone; what the cell does then.
fn until_released(bench: &mut Bench) -> Vec<Action> {
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 2 }));
    bench.vacuum = [0.6, 0.0];
    let carries = bench.feed(Input::Gripper(GripperEvent::Gripped { vacuum: 0.6 }));
    assert_eq!(streams(&carries), 1);
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 3 }));
    bench.vacuum = [0.0, 0.0];
    bench.feed(Input::Gripper(GripperEvent::Released))
}

/// The same, to where the arm is on its way to look.
pub(super) fn until_looking(bench: &mut Bench) {
    until_released(bench);
    bench.feed(Input::Robot(RobotEvent::SegmentFinished { batch: 4, index: 0 }));
    assert!(bench.cell.status().text().starts_with("looking"), "{}", bench.cell.status().text());
}

pub(super) fn records(actions: &[Action]) -> Vec<&'static str> {
    let name = |record: &Record| match record {
        Record::Found { .. } => "found",
        Record::Planned(_) => "planned",
        Record::Approved => "approved",
        Record::Intent { .. } => "intent",
        Record::Gripped { .. } => "gripped",
        Record::Released { .. } => "released",
        Record::Done { .. } => "done",
        Record::Withdrawn { .. } => "withdrawn",
        Record::LetGo { .. } => "let go",
        Record::Ended(_) => "ended",
    };
    let committed = actions.iter().filter_map(|action| match action {
        Action::Commit { record, .. } => Some(name(record)),
        _ => None,
    });
    committed.collect()
}

fn partial(actions: &[Action]) -> Option<PartialLook> {
    actions.iter().find_map(|action| match action {
        Action::Observe { partial, .. } => partial.clone(),
        _ => None,
    })
}

#[test]
fn from_the_place_the_arm_goes_on_to_look_and_what_comes_next_is_written_meanwhile() {
    let mut bench = carried_out();
    let released = until_released(&mut bench);
    assert_eq!(records(&released), ["released", "done", "intent"]);
    let path = released.iter().find_map(|action| match action {
        Action::Robot(RobotCommand::Stream(path)) => Some(path.clone()),
        _ => None,
    });
    assert_eq!(path.expect("one motion").segments().len(), 2, "up, and on to where the look is");
    // The intent is on disk: after the look nothing is waited for.
    bench.feed(Input::Robot(RobotEvent::SegmentFinished { batch: 4, index: 0 }));
    reach_and_picture(&mut bench);
    let near_b = Pose2::new(AT_B.x + 4e-4, AT_B.y, 0.0);
    let all = [("a", GOAL_A), ("b", near_b), ("c", AT_C)];
    bench.slow_disk = true;
    let goes = bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &all)))));
    assert_eq!((records(&goes), streams(&goes)), (vec![], 1), "{goes:?}");
}

#[test]
fn an_object_that_lies_elsewhere_than_was_meant_is_meant_anew_before_the_arm_sets_out() {
    let mut bench = carried_out();
    until_looking(&mut bench);
    reach_and_picture(&mut bench);
    let moved = Pose2::new(AT_B.x, AT_B.y, 0.03);
    bench.cell.model.tolerances.expected_angle = 0.1;
    bench.slow_disk = true;
    let all = [("a", GOAL_A), ("b", moved), ("c", AT_C)];
    let goes = bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &all)))));
    assert_eq!((records(&goes), streams(&goes)), (vec!["intent"], 0), "{goes:?}");
}

#[test]
fn the_look_shows_what_was_disturbed_what_is_picked_and_where_it_goes() {
    let mut bench = carried_out();
    let picked = bench.at;
    until_looking(&mut bench);
    let look = partial(&reach_and_picture(&mut bench)).expect("a look at a part of the table");
    for pose in [picked, GOAL_A, AT_B, GOAL_B] {
        assert!(look.region.contains([pose.x, pose.y]), "{pose:?}");
    }
    assert!(!look.region.contains([AT_C.x, AT_C.y]));
    let remembered: Vec<&str> = look.remembered.iter().map(|(id, _)| id.as_str()).collect();
    assert_eq!(remembered, ["b", "c"], "where `a` is has to be seen");
}

#[test]
fn what_a_part_need_not_show_is_remembered_and_what_it_should_show_and_does_not_is_missing() {
    // `c` is out of the picture: the arm goes on.
    let mut bench = carried_out();
    until_looking(&mut bench);
    reach_and_picture(&mut bench);
    let goes = bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &[("a", GOAL_A), ("b", AT_B)])))));
    assert_eq!(streams(&goes), 1, "{goes:?}");
    assert!(bench.cell.observation().unwrap().object("c").is_some());
    // `b` is not where the picture should show it: the whole table is looked at.
    let mut bench = carried_out();
    until_looking(&mut bench);
    reach_and_picture(&mut bench);
    let looks = bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &[("a", GOAL_A), ("c", AT_C)])))));
    assert_eq!(streams(&looks), 1, "{looks:?}");
    let again = reach_and_picture(&mut bench);
    assert_eq!(partial(&again), None, "of the whole table: {again:?}");
    assert!(again.iter().any(|action| matches!(action, Action::Observe { .. })));
}

/// Whoever shows it has to know which of its moves are over: none, though the job has made one.
#[test]
fn a_plan_that_is_made_in_the_middle_of_its_job_says_after_how_many_moves() {
    let mut bench = carried_out();
    until_looking(&mut bench);
    reach_and_picture(&mut bench);
    let pushed = Pose2::new(AT_B.x + 0.02, AT_B.y, 0.0);
    let all = [("a", GOAL_A), ("b", pushed), ("c", AT_C)];
    bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &all)))));
    reach_and_picture(&mut bench);
    bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &all)))));
    let actions = vec![PlanAction { object: 1, from: pushed, to: GOAL_B, kind: ActionKind::Goal }];
    let answer = PlanAnswer::Found { actions, cost: 1.0, lower_bound: 1.0, seconds: 0.01 };
    let planned = bench.feed(Input::Planned(Box::new(answer)));
    let note = planned.iter().find_map(|action| match action {
        Action::Commit { record: Record::Planned(note), .. } => Some((note.actions.len(), note.made)),
        _ => None,
    });
    assert_eq!(note, Some((1, 1)), "{planned:?}");
}

/// How long ago `c` was seen, s.
fn age_of_c(bench: &Bench) -> f64 {
    let c = bench.cell.observation().and_then(|seen| seen.object("c")).expect("remembered");
    bench.now.since(c.time).as_secs_f64()
}

#[test]
fn what_will_soon_be_too_old_is_seen_with_the_next_look() {
    let mut bench = carried_out();
    bench.ticks(50);
    bench.cell.model.tolerances.observation_age = Duration::from_secs_f64(1.5 * age_of_c(&bench));
    until_looking(&mut bench);
    let look = partial(&reach_and_picture(&mut bench)).expect("a look at a part of the table");
    assert!(look.region.contains([AT_C.x, AT_C.y]));
}

/// Behind something high, for example: that is no reason to doubt where it is before it is too old.
#[test]
fn what_is_not_seen_although_it_will_soon_be_too_old_is_remembered_as_old_as_it_is() {
    let mut bench = carried_out();
    bench.ticks(50);
    bench.cell.model.tolerances.retries = 0;
    bench.cell.model.tolerances.observation_age = Duration::from_secs_f64(1.5 * age_of_c(&bench));
    until_looking(&mut bench);
    reach_and_picture(&mut bench);
    let before = age_of_c(&bench);
    let goes = bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &[("a", GOAL_A), ("b", AT_B)])))));
    assert_eq!((streams(&goes), ended(&goes)), (1, None), "{goes:?}");
    assert_eq!(bench.cell.pick_n_place().map(|work| work.object), Some("b"));
    assert!(age_of_c(&bench) > before, "it was not seen");
    let missing = &bench.cell.observation().expect("seen").missing;
    assert!(missing.is_empty(), "{missing:?}");
}

#[test]
fn nothing_is_picked_while_a_part_of_the_table_was_seen_too_long_ago() {
    let mut bench = carried_out();
    until_looking(&mut bench);
    reach_and_picture(&mut bench);
    // The look did not have to show `c`, which has just become too old.
    bench.cell.model.tolerances.observation_age = Duration::from_secs_f64(0.99 * age_of_c(&bench));
    let looks = bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &[("a", GOAL_A), ("b", AT_B)])))));
    assert_eq!((streams(&looks), records(&looks)), (1, Vec::new()), "{looks:?}");
    assert!(bench.cell.pick_n_place().is_none());
    // Of the whole table: with parts alone one could be old whenever the other is seen.
    let look = reach_and_picture(&mut bench);
    assert!(look.iter().any(|action| matches!(action, Action::Observe { partial: None, .. })), "{look:?}");
    let all = [("a", GOAL_A), ("b", AT_B), ("c", AT_C)];
    let goes = bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &all)))));
    assert_eq!(streams(&goes), 1, "{goes:?}");
    assert_eq!(bench.cell.pick_n_place().map(|work| work.object), Some("b"));
}

/// A slow arm takes longer from stop to stop than a look holds: what it has shown counts from its end.
#[test]
fn a_look_that_takes_long_is_no_reason_for_another() {
    let mut bench = carried_out();
    until_looking(&mut bench);
    reach_and_picture(&mut bench);
    let shown = seen(&bench, &[("a", GOAL_A), ("b", AT_B), ("c", AT_C)]);
    bench.ticks(5);
    let age = bench.now.since(shown.objects[0].time).as_secs_f64();
    bench.cell.model.tolerances.observation_age = Duration::from_secs_f64(0.5 * age);
    let goes = bench.feed(Input::Observed(Ok(Box::new(shown))));
    assert_eq!(streams(&goes), 1, "{goes:?}");
    assert_eq!(bench.cell.pick_n_place().map(|work| work.object), Some("b"));
}

/// A look from two stops, the second of which shows `a` or is far from it; `a` is in the first picture
/// alone.
fn seen_from_the_first_stop_alone(bench: &mut Bench, first: u32, shows: bool, gone: usize) -> Vec<Action> {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let mut taken = Vec::new();
    for (batch, y) in (first..).zip([0.25, if shows { 0.2 } else { 2.0 }]) {
        bench.feed(Input::Robot(RobotEvent::PathFinished { batch }));
        bench.ticks(10);
        bench.feed(Input::Exposed);
        let table_from_camera = Isometry3::from_parts(Translation3::new(0.25, y, 0.5), down);
        taken.push(bench.now);
        let view = View { table_from_camera, detections: Vec::new(), time: bench.now, heights: None };
        bench.feed(Input::Captured(Ok(vec![view])));
    }
    let mut observed = seen(bench, &[("a", bench.at), ("b", AT_B), ("c", AT_C)]);
    observed.objects[..gone].iter_mut().for_each(|object| object.time = taken[0]);
    bench.feed(Input::Observed(Ok(Box::new(observed))))
}

#[test]
fn what_is_not_in_a_later_picture_that_shows_its_place_is_looked_for_once_more() {
    let plans = |actions: &[Action]| actions.iter().any(|action| matches!(action, Action::Plan(_)));
    let mut bench = about_to_look(vec![HOME, HOME]);
    assert!(plans(&seen_from_the_first_stop_alone(&mut bench, 1, false, 1)));
    let mut bench = about_to_look(vec![HOME, HOME]);
    let looks = seen_from_the_first_stop_alone(&mut bench, 1, true, 1);
    assert!(!plans(&looks) && streams(&looks) == 1, "{looks:?}");
    assert!(bench.cell.observation().is_none());
    // What is before it stays there.
    assert!(plans(&seen_from_the_first_stop_alone(&mut bench, 3, true, 1)));
}

#[test]
fn what_a_second_object_does_is_not_covered_by_the_first_and_looks_end() {
    let mut bench = about_to_look(vec![HOME, HOME]);
    seen_from_the_first_stop_alone(&mut bench, 1, true, 1);
    let because = bench.cell.status().because.expect("why it looks again");
    assert!(because.contains("a is in one picture"), "{because}");
    // `a` is before the second stop for good; now `b` is gone too.
    let over = seen_from_the_first_stop_alone(&mut bench, 3, true, 2);
    assert_eq!(ended(&over), Some((JobStatus::Failed, "object_uncertain:a".into())), "{over:?}");
}

#[test]
fn no_hint_sends_a_person_to_an_armed_arm() {
    let mut bench = about_to_look(vec![HOME]);
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    bench.ticks(10);
    let fault = CameraFault {
        code: Code::CameraDark,
        message: "the picture is dark".into(),
        hint: "uncover the lens".into(),
        lasting: false,
    };
    bench.feed(Input::Captured(Err(fault)));
    assert_eq!(bench.cell.status().hint, "`celld disarm` before going to it; uncover the lens");
    bench.feed(order(Order::Abort));
    let status = bench.cell.status();
    assert_eq!((status.doing, status.hint.as_str()), (Doing::Stopping, "wait until the arm is at rest"));
    assert_eq!(status.stopped.map(|stop| stop.code), Some(Code::Aborted));
}

#[test]
fn an_object_that_was_put_down_and_is_not_seen_is_not_remembered() {
    let mut bench = carried_out();
    until_looking(&mut bench);
    reach_and_picture(&mut bench);
    // One picture is no proof: the whole table is looked at first.
    let others = seen(&bench, &[("b", AT_B), ("c", AT_C)]);
    let looks = bench.feed(Input::Observed(Ok(Box::new(others.clone()))));
    assert_eq!((ended(&looks), streams(&looks)), (None, 1), "{looks:?}");
    assert_eq!(partial(&reach_and_picture(&mut bench)), None);
    let stuck = bench.feed(Input::Observed(Ok(Box::new(others))));
    assert_eq!(ended(&stuck), Some((JobStatus::Failed, "object_stuck:a".into())));
    assert_eq!(streams(&stuck), 0);
}

#[test]
fn a_job_ends_on_a_look_at_the_whole_table() {
    let mut bench = carried_out();
    until_looking(&mut bench);
    reach_and_picture(&mut bench);
    let there = [("a", GOAL_A), ("b", GOAL_B), ("c", AT_C)];
    // A hand has done the rest; a part of the table is no proof.
    let looks = bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &there)))));
    assert_eq!((ended(&looks), streams(&looks)), (None, 1), "{looks:?}");
    assert_eq!(partial(&reach_and_picture(&mut bench)), None);
    let over = bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &there)))));
    assert_eq!(ended(&over), Some((JobStatus::Done, "done".into())));
}

#[test]
fn the_whole_table_is_looked_at_every_so_many_moves() {
    let mut bench = carried_out();
    bench.cell.model.tolerances.full_look_every = 1;
    until_looking(&mut bench);
    let look = reach_and_picture(&mut bench);
    assert!(look.iter().any(|action| matches!(action, Action::Observe { partial: None, .. })), "{look:?}");
}

#[test]
fn what_was_meant_is_withdrawn_where_the_job_waits() {
    for wait in [Order::Disarm, Order::Pause, Order::Park] {
        let mut bench = carried_out();
        until_looking(&mut bench);
        let mut all = bench.feed(order(wait.clone()));
        if wait != Order::Disarm {
            all.extend(reach_and_picture(&mut bench));
            let table = [("a", GOAL_A), ("b", AT_B), ("c", AT_C)];
            let observed = Input::Observed(Ok(Box::new(seen(&bench, &table))));
            all.extend(bench.feed(observed));
        } else {
            all.extend(bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 4 })));
        }
        all.extend(bench.ticks(5));
        assert_eq!(records(&all), ["withdrawn"], "{wait:?}: {all:?}");
    }
}

#[test]
fn the_arm_leaves_a_look_pose_when_its_frames_are_exposed_and_moved_ones_do_not_count() {
    let mut bench = Bench::new();
    bench.cell = Supervisor::new(CellModel { look_poses: vec![HOME, HOME], ..model() }, 7);
    bench.job(false);
    bench.feed(order(Order::Arm));
    bench.ticks(20);
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    bench.ticks(10);
    // The arm moved meanwhile: what these frames show is dropped, and others are taken.
    bench.robot.q.0[0] += 1e-3;
    assert_eq!(streams(&bench.feed(Input::Exposed)), 0);
    assert!(bench.ticks(10).iter().any(|action| matches!(action, Action::Capture { first: false, .. })));
    assert_eq!(streams(&bench.feed(Input::Exposed)), 1, "on to the second pose");
    let view = |tag: u64| cell_vision::observe::View {
        table_from_camera: Isometry3::identity(),
        detections: Vec::new(),
        time: Timestamp::from_nanos(tag),
        heights: None,
    };
    bench.feed(Input::Captured(Ok(vec![view(1)])));
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 2 }));
    bench.ticks(10);
    bench.feed(Input::Exposed);
    let first = bench.feed(Input::Captured(Ok(vec![view(2)])));
    assert!(!first.iter().any(|action| matches!(action, Action::Observe { .. })), "one is still searched");
    let last = bench.feed(Input::Captured(Ok(vec![view(3)])));
    let tags = last.iter().find_map(|action| match action {
        Action::Observe { views, .. } => Some(views.iter().map(|view| view.time.nanos()).collect::<Vec<_>>()),
        _ => None,
    });
    assert_eq!(tags, Some(vec![2, 3]), "{last:?}");
}

#[test]
fn what_reaches_into_what_was_disturbed_has_to_be_seen_again() {
    // `c` lies beside the place of `a`: it may have been tipped when that was put down.
    let mut bench = carried_out();
    let beside = Pose2::new(GOAL_A.x + 0.085, GOAL_A.y, 0.0);
    let seen_before = bench.cell.seen.as_mut().expect("the whole table is seen");
    seen_before.objects.iter_mut().filter(|object| object.id == "c").for_each(|object| object.pose = beside);
    until_looking(&mut bench);
    reach_and_picture(&mut bench);
    let looks = bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &[("a", GOAL_A), ("b", AT_B)])))));
    assert_eq!(streams(&looks), 1, "{looks:?}");
    assert_eq!(partial(&reach_and_picture(&mut bench)), None, "the whole table");
}

#[test]
fn what_is_ordered_on_the_way_from_a_place_ends_it_where_the_arm_would_look() {
    for (wanted, answered) in [
        (Order::Pause, "the arm goes on to where it looks from, then it rests; `celld abort` stops it now"),
        (
            Order::Disarm,
            "disarmed; the motion under way goes on to its next stop, `celld abort` stops it now",
        ),
    ] {
        let mut bench = carried_out();
        until_released(&mut bench);
        bench.robot.qd = [0.4; 6];
        let reply = answer(&bench.feed(order(wanted.clone()))).expect("an answer");
        assert_eq!(reply.message, answered);
        bench.feed(Input::Robot(RobotEvent::SegmentFinished { batch: 4, index: 0 }));
        bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 4 }));
        bench.robot.qd = [0.0; 6];
        let rests = bench.ticks(200);
        assert!(
            !rests.iter().any(|action| matches!(action, Action::Capture { .. })),
            "{wanted:?}: {rests:?}"
        );
        assert_eq!((streams(&rests), ended(&rests)), (0, None), "{wanted:?}");
    }
}

#[test]
fn what_is_meant_is_written_with_where_the_object_was_just_put() {
    let mut bench = carried_out();
    let table = until_released(&mut bench).into_iter().find_map(|action| match action {
        Action::Commit { record: Record::Intent { table, .. }, .. } => Some(table),
        _ => None,
    });
    let table = table.expect("an intent");
    let at = |id: &str| table.iter().find(|(known, _)| known == id).map(|(_, pose)| *pose);
    assert_eq!((at("a"), at("b")), (Some(GOAL_A), Some(AT_B)));
}

#[test]
fn a_pick_that_is_not_begun_is_withdrawn() {
    // Disarmed while the record is on its way to the disk.
    let mut bench = carried_out();
    until_looking(&mut bench);
    reach_and_picture(&mut bench);
    bench.cell.model.tolerances.expected_angle = 0.1;
    bench.slow_disk = true;
    let all = [("a", GOAL_A), ("b", Pose2::new(AT_B.x, AT_B.y, 0.03)), ("c", AT_C)];
    let meant = bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &all)))));
    assert_eq!(records(&meant), ["intent"]);
    assert_eq!(records(&bench.feed(order(Order::Disarm))), ["withdrawn"]);
    // The table is not as the plan expects: while a new plan is made, nothing is meant.
    let mut bench = carried_out();
    until_looking(&mut bench);
    reach_and_picture(&mut bench);
    let elsewhere = [("a", GOAL_A), ("b", Pose2::new(AT_B.x + 0.02, AT_B.y, 0.0)), ("c", AT_C)];
    bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &elsewhere)))));
    reach_and_picture(&mut bench);
    let plans = bench.feed(Input::Observed(Ok(Box::new(seen(&bench, &elsewhere)))));
    assert!(plans.iter().any(|action| matches!(action, Action::Plan(_))), "{plans:?}");
    assert_eq!(records(&plans), ["withdrawn"]);
}

/// `goal: {look: true}`: the whole table is looked at, nothing is gripped, and what lies there is on record.
#[test]
fn a_job_without_a_goal_looks_and_touches_nothing() {
    let mut bench = Bench::new();
    bench.feed(Input::Job(Box::new(JobOrder {
        id: "look".into(),
        goals: Vec::new(),
        rule: None,
        agreed: Vec::new(),
        objective: Objective::Pp,
        solver: SolverKind::Auto,
        time_limit: Duration::from_secs(1),
        seed: 0,
        approval: Approval::Always,
    })));
    let mut all = bench.until_planning();
    all.extend(bench.ticks(10));
    assert_eq!(ended(&all), Some((JobStatus::Done, "done".into())), "{all:?}");
    assert_eq!(streams(&all), 0, "the look itself is all that moved: {all:?}");
    assert!(!all.iter().any(|action| matches!(action, Action::Gripper(_) | Action::Plan(_))), "{all:?}");
    let found = all.iter().find_map(|action| match action {
        Action::Commit { record: Record::Found { objects, .. }, .. } => Some(objects.clone()),
        _ => None,
    });
    assert_eq!(found, Some(vec![("a".to_string(), bench.at)]));
}

/// The outline of what is held lies in the tool's frame where the object is: an outline without symmetry,
/// off the cups' axis and turned, so that no sign can be wrong.
#[test]
fn what_is_held_is_known_in_the_tool_s_frame() {
    let arm = model().arm;
    let corners = [[0.0, 0.0], [0.09, 0.0], [0.09, 0.02], [0.03, 0.02], [0.03, 0.06], [0.0, 0.06]];
    let footprint = Footprint::polygon(&corners).expect("an L");
    let pose = Pose2::new(0.22, 0.17, 0.5);
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.9);
    let tool = Isometry3::from_parts(Translation3::new(0.25, 0.2, 0.02), turned * down);
    let pick = arm.joints_at(&tool, &HOME).expect("within reach");
    let object = Standing { name: "l".into(), footprint: footprint.clone(), pose, height: 0.02 };
    let grasp = Grasp::new(&arm, &pick, &object, 10.0).expect("it points down");
    let outline = outline_in_tool(grasp.load());
    for (found, corner) in outline.iter().zip(footprint.outline(32)) {
        let on_table = tool * nalgebra::Point3::new(found[0], found[1], 0.0);
        let [x, y] = pose.transform(corner);
        assert!((on_table.x - x).hypot(on_table.y - y) < 1e-6, "{on_table} is not {x}, {y}");
    }
}
