//! Plans that people see before anything moves, plans that were agreed to, goals that follow from a rule.

use super::*;
use crate::supervisor::input::PlanNote;
use crate::supervisor::order::RouteAction;
use rearrange::tabletop::rule::{GoalRule, Members};

const GOAL: Pose2 = Pose2 { x: 0.35, y: 0.3, theta: 0.0 };

fn plan_notes(actions: &[Action]) -> Vec<PlanNote> {
    let note = |action: &Action| match action {
        Action::Commit { record: Record::Planned(note), .. } => Some((**note).clone()),
        _ => None,
    };
    actions.iter().filter_map(note).collect()
}

fn plans(actions: &[Action]) -> usize {
    actions.iter().filter(|action| matches!(action, Action::Plan(_))).count()
}

fn moves(actions: &[Action]) -> bool {
    actions.iter().any(|action| matches!(action, Action::Robot(_) | Action::Gripper(_)))
}

/// A job with these goals and this rule.
fn job_of(goals: Vec<(String, Pose2)>, rule: Option<GoalRule>, approval: Approval) -> Box<JobOrder> {
    Box::new(JobOrder {
        id: "j".into(),
        goals,
        rule,
        objective: Objective::Pp,
        solver: SolverKind::Erbm,
        time_limit: Duration::from_secs(1),
        seed: 0,
        approval,
        agreed: Vec::new(),
    })
}

/// A cell that has seen the table for a job that was then cancelled, and is disarmed.
fn after_a_look() -> Bench {
    let mut bench = Bench::new();
    bench.job(true);
    bench.until_planning();
    bench.plan();
    bench.feed(order(Order::Reject("j".into())));
    bench.feed(order(Order::Disarm));
    bench.ticks(3);
    bench
}

#[test]
fn a_disarmed_cell_previews_a_job_and_moves_nothing() {
    let mut bench = after_a_look();
    bench.now += Duration::from_secs(40);
    let mut all = bench.job(true);
    all.extend(bench.ticks(5));
    assert_eq!(plans(&all), 1, "one preview: {all:?}");
    all.extend(bench.plan());
    all.extend(bench.ticks(50));
    let [note] = &plan_notes(&all)[..] else { panic!("one plan is noted: {all:?}") };
    assert!(note.preview && note.sight_age_s >= 40.0 && note.seconds > 0.0, "{note:?}");
    assert_eq!((note.actions.len(), note.table.len()), (1, 1));
    assert!(!moves(&all) && plans(&all) == 1, "{all:?}");
    assert!(bench.cell.status().awaits_approval);
    let hint = bench.cell.status().hint;
    assert!(hint.contains("celld arm") && hint.contains("celld approve j"), "{hint}");
}

#[test]
fn without_a_sight_of_the_table_there_is_no_preview() {
    let mut bench = Bench::new();
    let mut all = bench.job(true);
    all.extend(bench.ticks(50));
    assert_eq!(plans(&all), 0);
    assert!(!bench.cell.status().awaits_approval);
    let refused = answer(&bench.feed(order(bench.approval()))).expect("an answer");
    assert!(!refused.accepted, "{refused:?}");
}

#[test]
fn once_something_was_picked_the_sight_is_no_base_for_a_preview() {
    let (mut bench, number) = intent_under_way();
    bench.feed(Input::Committed { number, result: Ok(()) });
    bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    bench.feed(order(Order::Abort));
    bench.ticks(5);
    bench.slow_disk = false;
    let mut all = bench.job(true);
    all.extend(bench.ticks(20));
    assert_eq!(plans(&all), 0, "{all:?}");
}

/// Approves the preview, arms, looks with the object at `at` then, and plans the same moves.
fn approved_then_armed(approval: Approval, at: Pose2) -> (Bench, Vec<Action>) {
    let mut bench = after_a_look();
    bench.job_with(approval);
    bench.ticks(2);
    bench.plan();
    let reply = answer(&bench.feed(order(bench.approval()))).expect("an answer");
    assert!(reply.accepted && reply.message.contains("nothing moves before `celld arm`"), "{reply:?}");
    assert!(!bench.cell.status().awaits_approval);
    bench.at = at;
    let mut all = bench.until_planning();
    assert_eq!(plans(&all), 1, "the cell plans for what it sees now: {all:?}");
    all = bench.plan();
    all.extend(bench.ticks(20));
    (bench, all)
}

fn intents(actions: &[Action]) -> usize {
    let intent = |a: &&Action| matches!(a, Action::Commit { record: Record::Intent { .. }, .. });
    actions.iter().filter(intent).count()
}

#[test]
fn what_was_approved_is_carried_out_and_what_differs_is_requested_again() {
    let here = Bench::new().at;
    let moved = Pose2::new(here.x + 0.05, here.y, here.theta);
    let (_, all) = approved_then_armed(Approval::Always, here);
    assert_eq!(intents(&all), 1, "the same moves: {all:?}");
    let (bench, all) = approved_then_armed(Approval::Always, moved);
    assert_eq!(intents(&all), 0, "another move: {all:?}");
    assert!(bench.cell.status().awaits_approval);
    let (_, all) = approved_then_armed(Approval::Job, moved);
    assert_eq!(intents(&all), 1, "the job is approved, whatever it takes: {all:?}");
}

/// Whoever arms it knows that no other word is needed before the arm picks.
#[test]
fn a_cell_that_carries_out_an_approved_plan_once_it_is_armed_says_so() {
    let mut bench = Bench::new();
    let (from, job) = (bench.at, job_of(vec![("a".into(), GOAL)], None, Approval::Always));
    let agreed = vec![RouteAction { object: "a".into(), from, to: GOAL, to_goal: true }];
    bench.feed(Input::Job(Box::new(JobOrder { agreed, ..*job })));
    bench.ticks(1);
    let hint = bench.cell.status().hint;
    assert!(hint.contains("carries out what was approved"), "{hint}");
    let armed = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    assert!(armed.message.contains("carries out the approved plan"), "{armed:?}");
}

#[test]
fn an_agreement_from_before_a_restart_holds_for_the_same_moves_only() {
    for (dx, carried_out) in [(0.0, 1), (0.05, 0)] {
        let mut bench = Bench::new();
        let from = Pose2::new(bench.at.x + dx, bench.at.y, bench.at.theta);
        let agreed = vec![
            RouteAction { object: "b".into(), from, to: GOAL, to_goal: true },
            RouteAction { object: "a".into(), from, to: GOAL, to_goal: true },
        ];
        let job = job_of(vec![("a".into(), GOAL)], None, Approval::Always);
        bench.feed(Input::Job(Box::new(JobOrder { agreed, ..*job })));
        bench.until_planning();
        let mut all = bench.plan();
        all.extend(bench.ticks(20));
        assert_eq!(intents(&all), carried_out, "off by {dx} m: {all:?}");
    }
}

fn found(actions: &[Action]) -> Option<Vec<(String, Pose2)>> {
    actions.iter().find_map(|action| match action {
        Action::Commit { record: Record::Found { goals, .. }, .. } => Some(goals.clone()),
        _ => None,
    })
}

#[test]
fn a_rule_is_resolved_by_the_first_look_and_written_down_before_the_plan() {
    let mut bench = Bench::new();
    let polygon = vec![[0.3, 0.25], [0.45, 0.25], [0.45, 0.4], [0.3, 0.4]];
    let region = GoalRule::Region { members: Members::Objects(vec!["a".into()]), polygon };
    bench.feed(Input::Job(job_of(Vec::new(), Some(region.clone()), Approval::Never)));
    let all = bench.until_planning();
    let goals = found(&all).expect("the goals are written down");
    let place = |wanted: fn(&Action) -> bool| all.iter().position(wanted);
    let noted = place(|a| matches!(a, Action::Commit { record: Record::Found { .. }, .. }));
    assert!(noted < place(|a| matches!(a, Action::Plan(_))), "{all:?}");
    let [(id, pose)] = &goals[..] else { panic!("{goals:?}") };
    assert!(id == "a" && (0.3..0.45).contains(&pose.x) && (0.25..0.4).contains(&pose.y), "{goals:?}");
    // After a restart the goals are those of before, wherever the object lies by now.
    let mut bench = Bench::new();
    bench.at = Pose2::new(0.4, 0.3, 0.0);
    bench.feed(Input::Job(job_of(goals.clone(), Some(region), Approval::Never)));
    assert_eq!(found(&bench.until_planning()), Some(goals));
}

#[test]
fn a_rule_that_the_table_cannot_follow_ends_the_job_with_its_reason() {
    let end_of = |rule| {
        let mut bench = Bench::new();
        bench.feed(Input::Job(job_of(Vec::new(), Some(rule), Approval::Never)));
        let mut all = bench.until_planning();
        for _ in 0..3 {
            if ended(&all).is_none() {
                all.extend(bench.look());
            }
        }
        assert_eq!(plans(&all), 0, "{all:?}");
        ended(&all).expect("the job has ended").1
    };
    assert_eq!(end_of(GoalRule::Swap("a".into(), "b".into())), "object_missing:b");
    let members = Members::Objects(vec!["a".into()]);
    let polygon = vec![[0.0, 0.0], [0.01, 0.0], [0.01, 0.01]];
    assert_eq!(end_of(GoalRule::Region { members, polygon: polygon.clone() }), "no_arrangement");
    let members = Members::Group("nuts".into());
    assert_eq!(end_of(GoalRule::Region { members, polygon }), "no_arrangement");
}

#[test]
fn a_plan_that_needs_approval_waits_for_it() {
    let mut bench = Bench::new();
    bench.job(true);
    bench.until_planning();
    let mut waiting = bench.plan();
    waiting.extend(bench.ticks(500));
    assert_eq!(streams(&waiting), 0);
    let number = waiting.iter().find_map(|action| match action {
        Action::Commit { record: Record::Planned(note), .. } => Some(note.number),
        _ => None,
    });
    let number = number.expect("the plan is written down");
    let another = number + 1;
    let refused = bench.feed(order(Order::Approve { id: "j".into(), plan: another }));
    assert!(answer(&refused).is_some_and(|reply| reply.message.contains("has changed")), "{refused:?}");
    assert_eq!(streams(&bench.ticks(500)), 0, "what a person saw is not what waits");
    assert_eq!(streams(&bench.feed(order(Order::Approve { id: "j".into(), plan: number }))), 1);
}

/// A person who saw plan 7 before a restart does not agree to the next celld's first one.
#[test]
fn plans_are_numbered_on_from_those_of_an_earlier_celld() {
    let mut bench = Bench::new();
    bench.cell = Supervisor::new(CellModel { plans_before: 7, ..model() }, 7);
    bench.job(true);
    bench.until_planning();
    let numbers: Vec<u64> = plan_notes(&bench.plan()).iter().map(|note| note.number).collect();
    assert_eq!(numbers, [8]);
}
