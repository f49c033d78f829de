//! The running-buffer solvers on small tables where the answer is known.

use super::*;
use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::planning::plan::{Action, ActionKind};
use crate::tabletop::instance::{Instance, KeepOut, ObjectSpec, Workspace};
use std::sync::Mutex;

/// Squares of 0.1 m on a table of `width` x 0.3 m: (start, goal) along the middle line.
fn row(width: f64, places: &[(f64, Option<f64>)]) -> Instance {
    let at = |x: f64| Pose2::new(x, 0.15, 0.0);
    let objects = places
        .iter()
        .enumerate()
        .map(|(k, (start, goal))| {
            let mut object = ObjectSpec::new(format!("o{k}"), Footprint::rectangle(0.1, 0.1).unwrap());
            object.start = Some(at(*start));
            object.goal = goal.map(at);
            object
        })
        .collect();
    Instance {
        workspace: Workspace { width, height: 0.3 },
        clearance: 0.0,
        overlap_tolerance: 0.0,
        keep_out: Vec::new(),
        objects,
    }
}

fn solve_within(
    instance: &Instance,
    solver: SolverKind,
    objective: Objective,
    work: u64,
    seed: u64,
) -> Outcome {
    let problem = Problem::new(instance).unwrap();
    let control = Control { work_limit: Some(work), ..Control::until(&|| false) };
    solve(&problem, solver, objective, &control, seed).unwrap()
}

#[track_caller]
fn check(instance: &Instance, cost: f64, lower_bound: f64) -> Outcome {
    let outcome = solve_within(instance, SolverKind::Erbm, Objective::Pp, 200_000, 1);
    assert_eq!((outcome.cost, outcome.lower_bound), (Some(cost), lower_bound));
    outcome
}

#[test]
fn nothing_to_do_is_an_empty_optimal_plan() {
    let outcome = check(&row(1.0, &[(0.2, Some(0.2)), (0.5, None)]), 0.0, 0.0);
    assert_eq!(outcome.status, Status::Optimal);
    assert!(outcome.plan.unwrap().actions().is_empty());
}

#[test]
fn a_swap_needs_one_buffer() {
    let outcome = check(&row(1.0, &[(0.2, Some(0.5)), (0.5, Some(0.2))]), 3.0, 3.0);
    let kinds: Vec<ActionKind> = outcome.plan.unwrap().actions().iter().map(|a| a.kind).collect();
    assert_eq!(kinds, [ActionKind::Buffer, ActionKind::Goal, ActionKind::Goal]);
}

#[test]
fn impedance_decides_who_makes_way() {
    let mut swap = row(1.0, &[(0.2, Some(0.5)), (0.5, Some(0.2))]);
    swap.objects[0].impedance = Some(10.0);
    swap.objects[1].impedance = Some(1.0);
    let outcome = solve_within(&swap, SolverKind::Erbm, Objective::Ti, 200_000, 1);
    assert_eq!((outcome.cost, outcome.lower_bound, outcome.status), (Some(12.0), 12.0, Status::Optimal));
}

#[test]
fn an_object_without_a_goal_moves_only_when_it_blocks_one() {
    check(&row(1.0, &[(0.2, Some(0.5)), (0.5, None), (0.8, None)]), 2.0, 2.0);
}

#[test]
fn a_fixed_object_stays_and_a_keep_out_area_stays_free() {
    let mut task = row(0.6, &[(0.1, Some(0.3)), (0.3, Some(0.1)), (0.5, None)]);
    task.objects[2].fixed = true;
    task.keep_out.push(KeepOut {
        footprint: Footprint::rectangle(0.6, 0.1).unwrap(),
        pose: Pose2::new(0.3, 0.05, 0.0),
    });
    for seed in 0..10 {
        let outcome = solve_within(&task, SolverKind::Rbm, Objective::Pp, 500_000, seed);
        let plan = outcome.plan.expect("0.1 m are free above the row");
        assert!(plan.actions().iter().all(|a| a.object != 2 && a.to.y > 0.149));
    }
}

#[test]
fn the_clearance_is_kept_around_buffers() {
    let mut task = row(1.0, &[(0.2, Some(0.5)), (0.5, Some(0.2)), (0.8, Some(0.8))]);
    task.clearance = 0.05;
    for seed in 0..10 {
        let outcome = solve_within(&task, SolverKind::Erbm, Objective::Pp, 500_000, seed);
        let plan = outcome.plan.expect("there is room");
        let problem = Problem::new(&task).unwrap();
        let buffer = plan.actions()[0];
        let moved = &problem.objects[buffer.object].footprint;
        for other in problem.objects.iter().filter(|o| o.id != problem.objects[buffer.object].id) {
            let gap = crate::geometry::collision::distance_between(
                moved,
                &buffer.to,
                &other.footprint,
                &other.start,
            );
            assert!(gap >= 0.05 - 1e-9, "{gap}");
        }
    }
}

#[test]
fn members_of_a_group_share_their_goals() {
    let mut task = row(1.0, &[(0.2, Some(0.5)), (0.5, Some(0.2)), (0.8, None)]);
    for object in &mut task.objects {
        object.group = Some("same".to_string());
    }
    let outcome = check(&task, 0.0, 0.0);
    assert_eq!(outcome.status, Status::Optimal);
    task.objects[1].start = Some(Pose2::new(0.35, 0.15, 0.0));
    check(&task, 1.0, 1.0);
}

#[test]
fn overlapping_goals_are_infeasible_with_a_witness() {
    let outcome = solve_within(
        &row(1.0, &[(0.2, Some(0.5)), (0.8, Some(0.55))]),
        SolverKind::Erbm,
        Objective::Pp,
        1000,
        0,
    );
    assert_eq!(outcome.status, Status::Infeasible);
    let witness = outcome.witness.expect("two goals overlap");
    assert_eq!((witness.object.as_str(), witness.meets.as_str()), ("o0", "o1"));
    assert!(outcome.plan.is_none() && outcome.cost.is_none());
}

#[test]
fn a_failed_search_is_a_timeout_and_never_infeasible() {
    // Two squares fill a table of 0.2 m x 0.1 m: no object can make way.
    let mut full = row(0.2, &[(0.05, Some(0.15)), (0.15, Some(0.05))]);
    full.workspace.height = 0.1;
    for object in &mut full.objects {
        object.start = object.start.map(|p| Pose2::new(p.x, 0.05, 0.0));
        object.goal = object.goal.map(|p| Pose2::new(p.x, 0.05, 0.0));
    }
    let outcome = solve_within(&full, SolverKind::Erbm, Objective::Pp, 20_000, 0);
    assert_eq!((outcome.status, outcome.lower_bound), (Status::Timeout, 3.0));
}

/// Nine squares of 0.09 m, rotated by one place each on a table with little room.
fn ring() -> Instance {
    let places: Vec<(f64, f64)> =
        (0..9).map(|k| (0.06 + 0.11 * f64::from(k % 3), 0.06 + 0.11 * f64::from(k / 3))).collect();
    let objects = (0..9)
        .map(|k| {
            let mut object = ObjectSpec::new(format!("o{k}"), Footprint::rectangle(0.09, 0.09).unwrap());
            let (start, goal) = (places[k], places[(k + 1) % 9]);
            object.start = Some(Pose2::new(start.0, start.1, 0.0));
            object.goal = Some(Pose2::new(goal.0, goal.1, 0.5 * std::f64::consts::PI));
            object
        })
        .collect();
    Instance {
        workspace: Workspace { width: 0.45, height: 0.34 },
        clearance: 0.0,
        overlap_tolerance: 0.0,
        keep_out: Vec::new(),
        objects,
    }
}

#[test]
fn same_seed_and_work_limit_same_plan() {
    let actions = |seed| {
        let outcome = solve_within(&ring(), SolverKind::Rbm, Objective::Pp, 300_000, seed);
        outcome.plan.expect("a strip beside the ring is free").actions().to_vec()
    };
    assert_eq!(actions(4), actions(4));
    assert_ne!(actions(4), actions(5));
}

#[test]
fn the_callback_receives_the_plan_and_a_stop_is_obeyed() {
    let problem = Problem::new(&ring()).unwrap();
    let reported = Mutex::new(Vec::new());
    let on_plan = |actions: &[Action], cost: f64| reported.lock().unwrap().push((actions.len(), cost));
    let control = Control { on_plan: &on_plan, work_limit: Some(300_000), ..Control::until(&|| false) };
    let outcome = solve(&problem, SolverKind::Erbm, Objective::Pp, &control, 0).unwrap();
    assert_eq!(*reported.lock().unwrap(), [(outcome.plan.unwrap().actions().len(), outcome.cost.unwrap())]);
    let stopped = solve(&problem, SolverKind::Erbm, Objective::Pp, &Control::until(&|| true), 0).unwrap();
    assert_eq!(stopped.status, Status::Timeout);
}

#[test]
fn the_objective_time_needs_known_times() {
    let problem = Problem::new(&ring()).unwrap();
    let control = Control::until(&|| false);
    for solver in [SolverKind::Erbm, SolverKind::Auto] {
        assert_eq!(solve(&problem, solver, Objective::Time, &control, 0).unwrap_err(), SolveError::NoTimes);
    }
}
