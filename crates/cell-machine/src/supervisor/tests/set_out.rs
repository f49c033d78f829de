//! Setting out for the next object while the last picture is searched: when, and what becomes of it.

use super::foreign::{report, thing};
use super::sight::{AT_B, AT_C, GOAL_A, carried_out, reach_and_expose, records, seen, until_looking};
use super::*;
use crate::supervisor::input::CameraFault;
use cell_motion::path::CheckedPath;
use cell_motion::pick_n_place::tool_down;
use cell_motion::put_down::Grasp;
use cell_vision::observe::Suspicious;

/// `a` is put down, the picture of the places of `a` and `b` is exposed, and the arm on its way to `b`.
fn set_out() -> (Bench, CheckedPath) {
    let mut bench = carried_out();
    until_looking(&mut bench);
    let exposed = reach_and_expose(&mut bench);
    let ways: Vec<CheckedPath> = exposed.iter().filter_map(way).collect();
    let [path] = ways.as_slice() else { panic!("{exposed:?}") };
    (bench, path.clone())
}

/// The arm on its way down to `b`, without a stop, and the time.
pub(crate) fn goes_on() -> (Supervisor, Timestamp) {
    let (mut bench, _) = set_out();
    shows(&mut bench, AT_B);
    assert_eq!(bench.cell.status().text(), "approaching b");
    (bench.cell, bench.now)
}

fn way(action: &Action) -> Option<CheckedPath> {
    let Action::Robot(RobotCommand::SetOut(path)) = action else { return None };
    Some(path.clone())
}

/// The picture is searched, and shows `a` where it was put and `b` here.
fn shows(bench: &mut Bench, b: Pose2) -> Vec<Action> {
    let mut all = bench.feed(Input::Captured(Ok(Vec::new())));
    assert!(all.iter().any(|action| matches!(action, Action::Observe { partial: Some(_), .. })), "{all:?}");
    let shown = seen(bench, &[("a", GOAL_A), ("b", b), ("c", AT_C)]);
    all.extend(bench.feed(Input::Observed(Ok(Box::new(shown)))));
    all
}

/// It is at the waiting place.
fn arrives(bench: &mut Bench) -> Vec<Action> {
    let mut all = bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 6 }));
    all.extend(bench.ticks(3));
    all
}

#[test]
fn the_arm_goes_on_with_what_the_look_shows() {
    let (mut bench, out) = set_out();
    let goes = shows(&mut bench, AT_B);
    assert_eq!(
        (streams(&goes), records(&goes)),
        (1, vec![]),
        "what is meant was written down before: {goes:?}"
    );
    let path = goes.iter().find_map(|action| match action {
        Action::Robot(RobotCommand::Stream(path)) => Some(path.clone()),
        _ => None,
    });
    assert_eq!(path.map(|path| path.start()), Some(out.end()));
    assert_eq!(bench.cell.status().text(), "approaching b");
    let corner = bench.feed(Input::Robot(RobotEvent::SegmentFinished { batch: 5, index: 0 }));
    assert_eq!(streams(&corner), 0);
    let touches = bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 6 }));
    assert!(touches.iter().any(|action| matches!(action, Action::Gripper(GripperCommand::Grip { .. }))));
}

#[test]
fn what_is_not_as_expected_is_judged_when_the_arm_rests() {
    // Straight down it would miss; a plan would have to be made; it is not there.
    let elsewhere = [Pose2::new(AT_B.x + 1.5e-3, AT_B.y, 0.0), Pose2::new(AT_B.x + 0.01, AT_B.y, 0.0)];
    for at in elsewhere {
        let (mut bench, _) = set_out();
        let shown = shows(&mut bench, at);
        assert_eq!((streams(&shown), records(&shown)), (0, vec![]), "{shown:?}");
        assert!(bench.cell.status().moving && bench.cell.pick_n_place().is_none());
        let decided = arrives(&mut bench);
        assert_eq!(streams(&decided), 1, "a pick from where it waits, or a look: {decided:?}");
        assert_eq!(bench.cell.pick_n_place().is_some(), at == elsewhere[0]);
    }
    let (mut bench, _) = set_out();
    bench.feed(Input::Captured(Ok(Vec::new())));
    let missing = seen(&bench, &[("a", GOAL_A), ("c", AT_C)]);
    assert_eq!(streams(&bench.feed(Input::Observed(Ok(Box::new(missing))))), 0);
    assert!(bench.cell.observation().is_some_and(|seen| seen.object("b").is_some()), "not judged yet");
    assert_eq!(streams(&arrives(&mut bench)), 1);
    assert!(bench.cell.observation().is_none(), "it looks again");
}

/// A reason, and what the look shows then.
type Doubt = (&'static str, fn(&mut Observation));

/// What a look would be doubted for, however it comes about, is doubted before the tool goes down.
#[test]
fn what_a_look_is_doubted_for_keeps_the_arm_from_going_on() {
    let doubts: [Doubt; 5] = [
        ("a may hang on the cups", |seen| {
            seen.objects.retain(|object| object.id != "a");
            seen.missing.push("a".into());
        }),
        ("b is tilted", |seen| {
            let reason = "tilted by 12 degrees".into();
            seen.suspicious.push(Suspicious { id: "b".into(), reason, estimate: None });
        }),
        ("the camera was bumped", |seen| seen.reference = Some(reference(4, 5e-3))),
        ("something without a marker", |seen| seen.foreign = report(vec![thing(0.3, 0.4, 0.05)], 1.0)),
        ("a marker of nothing known", |seen| seen.unknown.push(99)),
    ];
    for (why, doubt) in doubts {
        let (mut bench, _) = set_out();
        bench.feed(Input::Captured(Ok(Vec::new())));
        let mut shown = seen(&bench, &[("a", GOAL_A), ("b", AT_B), ("c", AT_C)]);
        doubt(&mut shown);
        let keeps = bench.feed(Input::Observed(Ok(Box::new(shown))));
        assert_eq!((streams(&keeps), ended(&keeps)), (0, None), "{why}: {keeps:?}");
        let rests = arrives(&mut bench);
        assert!(
            bench.cell.pick_n_place().is_none() && streams(&rests) == 1,
            "it looks again: {why}: {rests:?}"
        );
    }
}

/// `c` was seen with the whole table alone, and what is remembered of it became too old on the way.
#[test]
fn what_is_remembered_and_too_old_now_is_looked_at_first() {
    let (mut bench, _) = set_out();
    bench.feed(Input::Captured(Ok(Vec::new())));
    bench.cell.model.tolerances.observation_age = Duration::from_millis(100);
    let shown = seen(&bench, &[("a", GOAL_A), ("b", AT_B)]);
    let shown = bench.feed(Input::Observed(Ok(Box::new(shown))));
    assert_eq!((streams(&shown), records(&shown)), (0, vec![]), "{shown:?}");
    assert!(bench.cell.status().moving && bench.cell.pick_n_place().is_none());
    assert_eq!(streams(&arrives(&mut bench)), 1);
    assert!(bench.cell.pick_n_place().is_none(), "a look at the whole table");
}

/// The arm was held on the way for longer than a look counts.
#[test]
fn what_waits_for_the_arm_to_rest_is_as_old_as_it_is() {
    let (mut bench, _) = set_out();
    bench.robot.runtime_state = RuntimeState::Paused;
    assert_eq!(streams(&shows(&mut bench, AT_B)), 0);
    bench.now += Duration::from_secs(31);
    bench.robot.runtime_state = RuntimeState::Playing;
    let rests = arrives(&mut bench);
    assert!(bench.cell.pick_n_place().is_none(), "{rests:?}");
    assert_eq!(streams(&rests), 1, "it looks again");
}

#[test]
fn an_answer_that_comes_after_the_arm_rests_is_taken_as_any_other() {
    let (mut bench, _) = set_out();
    assert_eq!(streams(&arrives(&mut bench)), 0);
    assert!(!bench.cell.follows_a_path());
    let goes = shows(&mut bench, AT_B);
    assert_eq!((streams(&goes), records(&goes)), (1, vec![]), "{goes:?}");
    assert_eq!(bench.cell.status().text(), "approaching b");
}

#[test]
fn an_order_on_the_way_counts_before_the_pick() {
    let reply = |actions: &[Action]| {
        let reply = actions.iter().find_map(|action| match action {
            Action::Reply { reply, .. } => Some(reply.message.clone()),
            _ => None,
        });
        reply.expect("an answer")
    };
    let cases = [
        (Order::Disarm, "the motion under way goes on to its next stop"),
        (Order::Pause, "the arm goes on to over the next object, then it rests"),
        (Order::Cancel("j".into()), "cancelled after the present pick-n-place or look"),
        (Order::Park, "parks as soon as the present motion is over"),
    ];
    for (given, says) in cases {
        let (mut bench, _) = set_out();
        bench.robot.qd = [0.2; 6];
        let answer = bench.feed(order(given.clone()));
        assert!(reply(&answer).contains(says), "{given:?}: {answer:?}");
        let shown = shows(&mut bench, AT_B);
        assert_eq!(streams(&shown), 0, "{given:?}: {shown:?}");
        bench.robot.qd = [0.0; 6];
        let rests = arrives(&mut bench);
        assert_eq!(streams(&rests), usize::from(given == Order::Park), "{given:?}: {rests:?}");
        assert!(bench.cell.pick_n_place().is_none());
        assert_eq!(ended(&rests).is_some(), matches!(given, Order::Cancel(_)), "{rests:?}");
    }
    // It has its orders and has not begun to move.
    let (mut bench, _) = set_out();
    let answer = bench.feed(order(Order::Disarm));
    assert!(answer.iter().any(|action| matches!(action, Action::Robot(RobotCommand::Stop))), "{answer:?}");
    let (mut bench, _) = set_out();
    let stopped = bench.feed(order(Order::Abort));
    assert!(stopped.iter().any(|action| matches!(action, Action::Robot(RobotCommand::Stop))));
    assert_eq!(streams(&shows_nothing(&mut bench)), 0);
}

/// The answer to a picture that is not awaited any more.
fn shows_nothing(bench: &mut Bench) -> Vec<Action> {
    let shown = seen(bench, &[("a", GOAL_A), ("b", AT_B), ("c", AT_C)]);
    bench.feed(Input::Observed(Ok(Box::new(shown))))
}

/// A picture was taken and shows nothing, for this reason.
fn not_searched(code: Code) -> Input {
    let (message, hint) = ("the picture shows nothing".into(), "look at the camera".into());
    Input::Captured(Err(CameraFault { code, message, hint, lasting: true }))
}

#[test]
fn a_picture_that_cannot_be_searched_ends_the_look_at_the_next_stop() {
    let mut bench = Bench::new();
    bench.cell = Supervisor::new(CellModel { look_poses: vec![HOME, HOME], ..model() }, 7);
    bench.job(false);
    bench.feed(order(Order::Arm));
    bench.ticks(20);
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    bench.ticks(10);
    bench.feed(Input::Exposed);
    let on_the_way = bench.feed(not_searched(Code::DetectionFailed));
    assert_eq!(ended(&on_the_way), None, "the arm moves");
    let rests = bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 2 }));
    assert_eq!(ended(&rests), Some((JobStatus::Failed, Code::DetectionFailed.as_str().into())));
}

#[test]
fn a_picture_that_cannot_be_searched_ends_the_job_when_the_arm_rests() {
    let (mut bench, _) = set_out();
    let failed = bench.feed(not_searched(Code::CameraDark));
    assert_eq!((ended(&failed), streams(&failed)), (None, 0));
    let rests = arrives(&mut bench);
    assert_eq!(ended(&rests), Some((JobStatus::Failed, "camera_dark".into())));
}

/// A reason, and how it comes about.
type Keeps = (&'static str, fn(&mut Bench));

/// Nothing is known to be free, or to be worth it.
#[test]
fn the_arm_waits_for_the_answer_where_it_may_not_set_out() {
    let keeps: [Keeps; 6] = [
        ("a pause", |bench| drop(bench.feed(order(Order::Pause)))),
        ("vacuum in the cups", |bench| bench.vacuum = [0.2, 0.0]),
        ("a search that takes long", |bench| bench.cell.sight.searched_s = 2.0),
        ("nothing known of the search", |bench| bench.cell.sight.searched_s = 0.0),
        ("what may hang lower than things lie", hangs_low),
        ("a record that is not on disk", |bench| {
            bench.cell.meant.as_mut().expect("written down").on_disk = false;
        }),
    ];
    for (why, keep) in keeps {
        let mut bench = carried_out();
        until_looking(&mut bench);
        keep(&mut bench);
        let exposed = reach_and_expose(&mut bench);
        assert!(exposed.iter().filter_map(way).next().is_none(), "{why}: {exposed:?}");
    }
}

/// What was just let go reaches 60 mm below the cups, if it hangs there.
fn hangs_low(bench: &mut Bench) {
    let task = CellObject { height: 0.06, ..object() }.pick_n_place(GOAL_A, GOAL_A);
    let arm = bench.cell.model.arm.clone();
    let over = tool_down(GOAL_A.x, GOAL_A.y, 0.06, 0.0);
    let q = arm.joints_in_work_posture(&over, &HOME).expect("in reach");
    let held = bench.cell.back.held.as_mut().expect("just let go");
    held.grasp = Grasp::new(&arm, &q, &task.lying_at(GOAL_A), 20.0);
}
