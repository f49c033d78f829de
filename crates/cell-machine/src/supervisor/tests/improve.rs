//! The rest of a plan that is planned again while the arm moves.

use super::*;
use crate::device::gripper_types::GripperEvent;
use crate::device::robot_types::ProgramEnd;
use crate::supervisor::input::PlanRequest;
use crate::supervisor::order::RouteAction;

/// Where the objects are, and where each goes.
const AT: [Pose2; 3] = [
    Pose2 { x: 0.15, y: 0.3, theta: 0.0 },
    Pose2 { x: 0.15, y: 0.1, theta: 0.0 },
    Pose2 { x: 0.05, y: 0.45, theta: 0.0 },
];
const GOALS: [Pose2; 3] = [
    Pose2 { x: 0.35, y: 0.3, theta: 0.0 },
    Pose2 { x: 0.35, y: 0.1, theta: 0.0 },
    Pose2 { x: 0.25, y: 0.45, theta: 0.0 },
];

fn action(object: usize) -> PlanAction {
    PlanAction { object, from: AT[object], to: GOALS[object], kind: ActionKind::Goal }
}

fn found(objects: &[usize], cost: f64) -> Input {
    let actions = objects.iter().map(|object| action(*object)).collect();
    Input::Planned(Box::new(PlanAnswer::Found { actions, cost, lower_bound: 3.0, seconds: 0.1 }))
}

fn request(actions: &[Action]) -> Option<PlanRequest> {
    actions.iter().find_map(|action| match action {
        Action::Plan(request) => Some((**request).clone()),
        _ => None,
    })
}

/// A job with three objects whose plan costs so much, of at least 3: what the cell does when it is found,
/// and once a person has agreed to it.
fn begun(approval: Approval, cost: f64) -> (Bench, Vec<Action>) {
    let mut bench = Bench::new();
    let named = |(id, marker): (&str, u32)| {
        let object = object();
        CellObject { id: id.into(), marker: MarkerSpec { id: marker, ..object.marker.clone() }, ..object }
    };
    let objects = [("a", 0), ("b", 1), ("c", 2)].map(named).to_vec();
    bench.cell = Supervisor::new(CellModel { objects, ..model() }, 7);
    bench.job_with(approval);
    let goals = ["a", "b", "c"].map(str::to_string).into_iter().zip(GOALS).collect();
    let order_of_three = &mut bench.cell.job.as_mut().expect("a job").order;
    (order_of_three.goals, order_of_three.time_limit) = (goals, Duration::from_secs(60));
    bench.feed(order(Order::Arm));
    bench.ticks(20);
    for step in [Input::Robot(RobotEvent::PathFinished { batch: 1 }), Input::Tick] {
        bench.feed(step);
    }
    bench.ticks(10);
    bench.feed(Input::Captured(Ok(Vec::new())));
    let objects = ["a", "b", "c"].into_iter().zip(AT).map(|(id, at)| estimate(id, at, bench.now)).collect();
    let reference = Some(bench.reference.clone());
    let seen = Observation { objects, reference, ..Observation::default() };
    let requested = bench.feed(Input::Observed(Ok(Box::new(seen))));
    assert!(request(&requested).is_some_and(|request| request.known_plan.is_empty()), "{requested:?}");
    let mut all = bench.feed(found(&[0, 1, 2], cost));
    if approval != Approval::Never {
        all.extend(bench.feed(order(bench.approval())));
    }
    assert_eq!(streams(&all), 1, "{all:?}");
    (bench, all)
}

fn route(bench: &Bench) -> Vec<String> {
    bench.cell.route().into_iter().map(|action: RouteAction| action.object).collect()
}

#[test]
fn what_comes_after_the_pick_n_place_under_way_is_planned_again_and_improved() {
    for approval in [Approval::Never, Approval::Job] {
        let (mut bench, all) = begun(approval, 4.0);
        let again = request(&all).expect("the rest is planned");
        assert_eq!(again.known_plan, [action(1), action(2)]);
        assert_eq!(again.instance.objects[0].start, Some(GOALS[0]), "as it will be");
        let lasts_s = again.times.seconds([(AT[0], GOALS[0])]);
        let searched_s = again.time_limit.as_secs_f64();
        assert!((searched_s - 0.5 * lasts_s).abs() < 1e-6, "{searched_s} of {lasts_s} s");
        let better = bench.feed(found(&[2, 1], 3.0));
        assert_eq!(streams(&better), 0, "the arm is on its way");
        assert_eq!(route(&bench), ["a", "c", "b"]);
        let note = better.iter().find_map(|action| match action {
            Action::Commit { record: Record::Planned(note), .. } => Some(note),
            _ => None,
        });
        let note = note.expect("written down");
        // It begins with what is under way, on the table before that.
        let noted: Vec<&str> = note.actions.iter().map(|action| action.object.as_str()).collect();
        assert_eq!((noted, note.made), (vec!["a", "c", "b"], 0));
        assert_eq!(note.table[0], ("a".to_string(), AT[0]));
        assert!(!bench.cell.job.as_ref().expect("a job").improvable, "it is the best now");
        bench.feed(found(&[1, 2], 3.0));
        assert_eq!(route(&bench), ["a", "c", "b"], "an answer counts once");
    }
}

#[test]
fn what_is_as_good_changes_nothing_and_is_not_said() {
    let (mut bench, _) = begun(Approval::Never, 4.0);
    let same = bench.feed(found(&[1, 2], 3.5));
    assert_eq!(route(&bench), ["a", "b", "c"]);
    assert!(!same.iter().any(|action| matches!(action, Action::Commit { .. } | Action::Say(_))), "{same:?}");
    for answer in [PlanAnswer::Timeout, PlanAnswer::Refused("a lies on b".into())] {
        let (mut bench, _) = begun(Approval::Never, 4.0);
        let none = bench.feed(Input::Planned(Box::new(answer)));
        assert_eq!((route(&bench).len(), streams(&none), ended(&none)), (3, 0, None));
    }
}

#[test]
fn a_plan_that_is_the_best_or_that_a_person_approves_is_not_planned_again() {
    for (approval, cost) in [(Approval::Never, 3.0), (Approval::Always, 4.0)] {
        let (mut bench, all) = begun(approval, cost);
        assert!(request(&all).is_none(), "{approval:?}: {all:?}");
        bench.feed(found(&[2, 1], 3.0));
        assert_eq!(route(&bench), ["a", "b", "c"], "{approval:?}");
    }
}

/// From the release on the next pick-n-place is written down, and the answer is one for a table that was.
#[test]
fn what_comes_after_the_object_was_put_down_changes_nothing() {
    let (mut bench, _) = begun(Approval::Never, 4.0);
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    bench.vacuum = [0.6, 0.0];
    bench.feed(Input::Gripper(GripperEvent::Gripped { vacuum: 0.6 }));
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    bench.vacuum = [0.0, 0.0];
    let released = bench.feed(Input::Gripper(GripperEvent::Released));
    assert_eq!((route(&bench).join(""), streams(&released)), ("bc".to_string(), 1), "{released:?}");
    bench.feed(found(&[2, 1], 3.0));
    assert_eq!(route(&bench), ["b", "c"]);
}

/// What is under way is finished, and nothing follows: there is nothing to be better.
#[test]
fn a_job_that_does_not_go_on_gets_no_other_plan() {
    for stays in [order(Order::Cancel("j".into())), order(Order::Pause), order(Order::Disarm)] {
        let (mut bench, _) = begun(Approval::Never, 4.0);
        bench.feed(stays.clone());
        let late = bench.feed(found(&[2, 1], 3.0));
        assert_eq!(route(&bench), ["a", "b", "c"], "{stays:?}");
        assert!(!late.iter().any(|action| matches!(action, Action::Say(_))), "{stays:?}: {late:?}");
    }
}

/// The job outlives the stop, and so does its route.
#[test]
fn what_comes_after_a_stop_changes_nothing() {
    let (mut bench, _) = begun(Approval::Never, 4.0);
    bench.cell.model.tolerances.stop_retries = 1;
    bench.feed(Input::Robot(RobotEvent::ProgramEnded { reason: ProgramEnd::HeartbeatLost }));
    assert_eq!(bench.cell.status().job.as_deref(), Some("j"));
    let before = bench.cell.route();
    let late = bench.feed(found(&[2, 1], 3.0));
    assert_eq!((bench.cell.route(), streams(&late)), (before, 0), "{late:?}");
}
