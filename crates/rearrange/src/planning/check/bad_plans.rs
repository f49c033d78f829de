//! Plans that must be refused, each a good plan with one thing wrong, and good ones that must not be.

use std::f64::consts::TAU;

use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::planning::check::{CheckedPlan, GivenIn, PlanFault};
use crate::planning::plan::{Action, ActionKind};
use crate::planning::problem::Problem;
use crate::tabletop::parse::parse_instance;

/// Two squares that swap places, an ellipse that stays, a pillar, a keep-out disc.
const SWAP: &str = "\
workspace: {width: 1.0, height: 1.0}
keep_out: [{footprint: {disc: {radius: 0.05}}, pose: [0.9, 0.9, 0]}]
objects:
  - {id: a, footprint: {rectangle: {length: 0.2, width: 0.2}}, start: [0.2, 0.2, 0], goal: [0.6, 0.2, 0]}
  - {id: b, footprint: {rectangle: {length: 0.2, width: 0.2}}, start: [0.6, 0.2, 0], goal: [0.2, 0.2, 0]}
  - {id: e, footprint: {ellipse: {length: 0.2, width: 0.1}}, start: [0.2, 0.6, 0]}
  - {id: p, footprint: {disc: {radius: 0.05}}, start: [0.5, 0.9, 0], fixed: true}
";

fn problem(text: &str) -> Problem {
    let instance = parse_instance(text, "t.yaml", &|_| None).unwrap_or_else(|faults| panic!("{faults}"));
    Problem::new(&instance).expect("valid start")
}

fn action(object: usize, from: [f64; 3], to: [f64; 3], kind: ActionKind) -> Action {
    let pose = |p: [f64; 3]| Pose2::new(p[0], p[1], p[2]);
    Action { object, from: pose(from), to: pose(to), kind }
}

fn good() -> Vec<Action> {
    vec![
        action(0, [0.2, 0.2, 0.0], [0.6, 0.5, 0.3], ActionKind::Buffer),
        action(1, [0.6, 0.2, 0.0], [0.2, 0.2, 0.0], ActionKind::Goal),
        action(0, [0.6, 0.5, 0.3], [0.6, 0.2, 0.0], ActionKind::Goal),
    ]
}

/// The fault of the good plan after a change.
fn fault(change: impl FnOnce(&mut Vec<Action>)) -> PlanFault {
    let mut actions = good();
    change(&mut actions);
    CheckedPlan::new(&problem(SWAP), &actions).expect_err("refused")
}

/// Parks object 0 somewhere else.
fn parked_at(to: [f64; 3]) -> Result<CheckedPlan, PlanFault> {
    let mut actions = good();
    actions[0].to = Pose2::new(to[0], to[1], to[2]);
    actions[2].from = actions[0].to;
    CheckedPlan::new(&problem(SWAP), &actions)
}

#[test]
fn the_good_plan_passes() {
    let plan = CheckedPlan::new(&problem(SWAP), &good()).expect("good");
    assert_eq!(plan.actions().len(), 3);
    assert!(plan.exempt().is_empty());
    assert_eq!(plan.final_poses()[0], Pose2::new(0.6, 0.2, 0.0));
}

#[test]
fn an_overlap_of_a_micrometre_is_found_for_every_shape() {
    // Beside square b (right edge at 0.7), the ellipse (right end at 0.3), the pillar (lower end at 0.85),
    // the keep-out.
    for (touching, away, meets) in [
        ([0.8, 0.2, 0.0], [1.0, 0.0], "b"),
        ([0.4, 0.6, 0.0], [1.0, 0.0], "e"),
        ([0.5, 0.75, 0.0], [0.0, -1.0], "p"),
        ([0.9, 0.75, 0.0], [0.0, -1.0], "keep_out[0]"),
    ] {
        let at = |d: f64| [touching[0] + d * away[0], touching[1] + d * away[1], touching[2]];
        parked_at(at(0.0)).unwrap_or_else(|fault| panic!("touching {meets}: {fault}"));
        parked_at(at(-0.9e-9)).unwrap_or_else(|fault| panic!("1e-9 into {meets}: {fault}"));
        match parked_at(at(-1e-6)) {
            Err(PlanFault::Overlap { action: 0, object, meets: found, depth_um }) => {
                assert_eq!((object.as_str(), found.as_str()), ("a", meets));
                assert!((depth_um - 1.0).abs() < 0.01, "{depth_um}");
            }
            other => panic!("{meets}: {other:?}"),
        }
        assert!(parked_at(at(-1.2e-8)).is_err(), "{meets}");
    }
}

#[test]
fn the_edge_counts_to_the_micrometre() {
    parked_at([0.9, 0.5, 0.0]).expect("touching the edge");
    for (to, side) in [
        ([0.9 + 1e-6, 0.5, 0.0], "right"),
        ([0.1 - 1e-6, 0.4, 0.0], "left"),
        ([0.3, 1.0 - 0.1 + 1e-6, 0.0], "top"),
    ] {
        match parked_at(to) {
            Err(PlanFault::Edge { action: 0, object, depth_um }) => {
                assert_eq!(object, "a");
                assert!((depth_um - 1.0).abs() < 0.01, "{side}: {depth_um}");
            }
            other => panic!("{side}: {other:?}"),
        }
    }
    // The ellipse turned by 30 degrees: its exact half width is hypot(0.1 cos, 0.05 sin).
    let half = (0.1 * (TAU / 12.0).cos()).hypot(0.05 * (TAU / 12.0).sin());
    let turned = |x: f64| {
        let mut actions = good();
        actions.push(action(2, [0.2, 0.6, 0.0], [x, 0.7, TAU / 12.0], ActionKind::Buffer));
        CheckedPlan::new(&problem(SWAP), &actions)
    };
    turned(half).expect("touching");
    assert!(matches!(turned(half - 1e-6), Err(PlanFault::Edge { action: 3, .. })));
    assert!(matches!(turned(half - 1e-8), Err(PlanFault::Edge { .. })));
}

#[test]
fn wrong_objects_are_found() {
    assert!(matches!(fault(|plan| plan[1].object = 9), PlanFault::NoSuchObject { action: 1, object: 9 }));
    assert!(matches!(fault(|plan| plan[0].object = 1), PlanFault::From { action: 0, .. }));
    assert!(matches!(fault(|plan| plan[0].object = 3), PlanFault::Fixed { action: 0, .. }));
}

#[test]
fn what_is_missing_is_found() {
    assert!(matches!(fault(|plan| plan.truncate(2)), PlanFault::Goal { object, .. } if object == "a"));
    assert!(
        matches!(fault(|plan| *plan = plan[1..].to_vec()), PlanFault::Overlap { action: 0, meets, .. } if meets == "a")
    );
    assert!(matches!(fault(Vec::clear), PlanFault::Goal { object, .. } if object == "a"));
}

#[test]
fn an_object_is_picked_where_it_lies() {
    let PlanFault::From { action, object, off_um, .. } = fault(|plan| plan[2].from.x += 1e-6) else {
        panic!("not noticed")
    };
    assert_eq!((action, object.as_str()), (2, "a"));
    assert!((off_um - 1.0).abs() < 1e-6);
    assert!(matches!(fault(|plan| plan[2].from.theta += 1e-6), PlanFault::From { .. }));
    let mut turned = good();
    turned[2].from.theta += TAU;
    CheckedPlan::new(&problem(SWAP), &turned).expect("angles compare modulo a turn");
}

#[test]
fn the_last_action_repeats_the_goal_exactly() {
    let last = |change: fn(&mut Pose2), kind: ActionKind| {
        fault(|plan| {
            change(&mut plan[2].to);
            plan[2].kind = kind;
        })
    };
    let tiny: fn(&mut Pose2) = |pose| pose.x = f64::from_bits(pose.x.to_bits() + 1);
    assert!(matches!(last(tiny, ActionKind::Goal), PlanFault::NotItsGoal { action: 2, .. }));
    assert!(matches!(last(tiny, ActionKind::Buffer), PlanFault::Goal { object, .. } if object == "a"));
    let turn: fn(&mut Pose2) = |pose| pose.theta += TAU;
    assert!(matches!(last(turn, ActionKind::Buffer), PlanFault::Goal { .. }));
    assert!(matches!(fault(|plan| plan[0].kind = ActionKind::Goal), PlanFault::NotItsGoal { action: 0, .. }));
    assert!(matches!(fault(|plan| plan[0].to.y = f64::NAN), PlanFault::NotFinite { action: 0, .. }));
}

#[test]
fn clearance_is_kept_at_new_places_only() {
    let text = SWAP.replace("keep_out", "clearance: 0.01\nkeep_out");
    let near = problem(&text);
    let mut actions = good();
    CheckedPlan::new(&near, &actions).expect("far enough");
    actions[0].to = Pose2::new(0.6, 0.405, 0.0);
    actions[2].from = actions[0].to;
    match CheckedPlan::new(&near, &actions) {
        Err(PlanFault::Clearance { action: 0, meets, gap_um, clearance_um, .. }) => {
            assert_eq!(meets, "b");
            assert!((gap_um - 5000.0).abs() < 0.01 && (clearance_um - 10_000.0).abs() < 1e-6, "{gap_um}");
        }
        other => panic!("{other:?}"),
    }
    // The ellipse's top is at 0.65; the clearance is not kept to the table's edge.
    for (y, fine) in [(0.76, true), (0.76 - 1e-6, false)] {
        actions[0].to = Pose2::new(0.2, y, 0.0);
        actions[2].from = actions[0].to;
        assert_eq!(CheckedPlan::new(&near, &actions).is_ok(), fine, "{y}");
    }
    actions[0].to = Pose2::new(0.6, 0.9, 0.0);
    actions[2].from = actions[0].to;
    assert!(CheckedPlan::new(&near, &actions).is_err(), "0.5 mm from the pillar");
}

#[test]
fn given_overlaps_are_exempt_where_they_are_given() {
    let text = "\
workspace: {width: 1.0, height: 1.0}
overlap_tolerance: 0.002
objects:
  - {id: a, footprint: {disc: {radius: 0.1}}, start: [0.2, 0.2, 0], goal: [0.7, 0.7, 0]}
  - {id: b, footprint: {disc: {radius: 0.1}}, start: [0.399, 0.2, 0], goal: [0.7, 0.501, 0]}
  - {id: c, footprint: {disc: {radius: 0.1}}, start: [0.0995, 0.6, 0], goal: [0.0995, 0.6, 0]}
";
    let given = problem(text);
    let to_goal = |k: usize| {
        let object = &given.objects[k];
        Action { object: k, from: object.start, to: object.goal.expect("given"), kind: ActionKind::Goal }
    };
    let plan = CheckedPlan::new(&given, &[to_goal(0), to_goal(1)]).expect("exempt");
    let listed: Vec<(&str, &str, GivenIn)> =
        plan.exempt().iter().map(|e| (e.object.as_str(), e.meets.as_str(), e.given)).collect();
    assert_eq!(
        listed,
        [("b", "a", GivenIn::Start), ("c", "the table's edge", GivenIn::Start), ("b", "a", GivenIn::Goal)]
    );
    assert!((plan.exempt()[0].depth_m - 0.001).abs() < 1e-9);
    // A micrometre beside the given pose the same overlap is a fault.
    let mut shifted = to_goal(1);
    shifted.to.x += 1e-6;
    shifted.kind = ActionKind::Buffer;
    assert!(matches!(
        CheckedPlan::new(&given, &[to_goal(0), shifted]),
        Err(PlanFault::Overlap { action: 1, .. })
    ));
    // Goals that overlap beyond the tolerance are no exemption.
    let deep = problem(&text.replace("0.501", "0.6"));
    let last = Action { to: deep.objects[1].goal.expect("given"), ..to_goal(1) };
    assert!(matches!(
        CheckedPlan::new(&deep, &[to_goal(0), last]),
        Err(PlanFault::Overlap { action: 1, .. })
    ));
}

#[test]
fn group_members_take_each_others_goals() {
    let text = "\
workspace: {width: 1.0, height: 1.0}
objects:
  - {id: a, footprint: {disc: {radius: 0.1}}, group: g, start: [0.2, 0.2, 0], goal: [0.5, 0.2, 0]}
  - {id: b, footprint: {disc: {radius: 0.1}}, group: g, start: [0.5, 0.2, 0], goal: [0.8, 0.2, 0]}
  - {id: c, footprint: {disc: {radius: 0.1}}, group: g, start: [0.2, 0.6, 0]}
";
    let group = problem(text);
    let one = action(0, [0.2, 0.2, 0.0], [0.8, 0.2, 0.0], ActionKind::Goal);
    CheckedPlan::new(&group, &[one]).expect("b stays on a's goal, a takes b's");
    let other = action(2, [0.2, 0.6, 0.0], [0.8, 0.2, 0.0], ActionKind::Goal);
    CheckedPlan::new(&group, &[other]).expect("c has no goal of its own");
    let none = action(0, [0.2, 0.2, 0.0], [0.8, 0.6, 0.0], ActionKind::Buffer);
    assert!(
        matches!(CheckedPlan::new(&group, &[none]), Err(PlanFault::GroupGoal { object, .. }) if object == "b")
    );
}

#[test]
fn a_start_that_got_past_the_problem_is_refused_here() {
    let mut broken = problem(SWAP);
    broken.objects[2].footprint = Footprint::ellipse(0.2, 0.7).expect("valid");
    match CheckedPlan::new(&broken, &good()) {
        Err(PlanFault::Start { object, meets, depth_um, .. }) => {
            assert_eq!((object.as_str(), meets.as_str()), ("e", "a"));
            assert!(depth_um > 1000.0);
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn two_equal_goals_of_a_group_need_two_members() {
    let text = "\
workspace: {width: 1.0, height: 1.0}
overlap_tolerance: 0.5
objects:
  - {id: a, group: g, footprint: {disc: {radius: 0.05}}, start: [0.2, 0.2, 0], goal: [0.6, 0.6, 0]}
  - {id: b, group: g, footprint: {disc: {radius: 0.05}}, start: [0.8, 0.2, 0], goal: [0.6, 0.6, 0]}
";
    let problem = problem(text);
    let mut actions = vec![action(0, [0.2, 0.2, 0.0], [0.6, 0.6, 0.0], ActionKind::Goal)];
    let fault = CheckedPlan::new(&problem, &actions).expect_err("one disc does not fill two places");
    assert_eq!(fault, PlanFault::GroupGoal { group: "g".into(), object: "b".into() });
    actions.push(action(1, [0.8, 0.2, 0.0], [0.6, 0.6, 0.0], ActionKind::Goal));
    CheckedPlan::new(&problem, &actions).expect("both are there, as given");
}
