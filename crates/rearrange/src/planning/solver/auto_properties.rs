//! What holds for `auto` beyond the paper: groups, obstacles, clearance, loose objects, time, plans made
//! before.
//!
//! Small random tables, judged by exhaustive search in which objects may also wait beside the table: no plan
//! can be better, and where there is room on the table a plan as good exists.

use super::properties::{actions, mixed, random_problems, run};
use super::*;
use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::planning::plan::Action;
use crate::planning::random_tables::{optimum_with_outside, random_instance, table};
use crate::planning::travel::NOMINAL;
use crate::tabletop::instance::{Instance, KeepOut, ObjectSpec};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Mutex;

/// Changes random instances, and compares what `auto` finds with the optimum.
fn against_brute_force(
    seed: u64,
    cases: usize,
    objects: usize,
    change: impl Fn(&mut Instance, &mut ChaCha8Rng),
) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut compared, mut reached) = (0, 0);
    while compared < cases {
        let mut instance = random_instance(&mut rng, objects);
        change(&mut instance, &mut rng);
        let Ok(problem) = Problem::new(&instance) else { continue };
        if problem.goal_conflict().is_some() {
            continue;
        }
        compared += 1;
        let impedances: Vec<f64> = problem.objects.iter().map(|object| object.impedance).collect();
        for (objective, costs) in [(Objective::Pp, vec![1.0; objects]), (Objective::Ti, impedances)] {
            let outcome = run(&problem, SolverKind::Auto, objective, compared as u64);
            let optimum = optimum_with_outside(&problem, &costs);
            let cost = outcome.cost.unwrap_or_else(|| panic!("case {compared}: no plan, {objective:?}"));
            assert!(cost >= optimum - 1e-9, "case {compared}: {cost}, optimum {optimum}");
            assert!(cost >= outcome.lower_bound - 1e-9, "case {compared}: bound {}", outcome.lower_bound);
            reached += usize::from(cost <= optimum + 1e-9);
        }
    }
    // Some tables have no room for what could be done beside them.
    assert!(10 * reached >= 9 * 2 * cases, "{reached} of {} reach the optimum", 2 * cases);
}

/// Makes the first `count` objects alike and interchangeable.
fn group(instance: &mut Instance, count: usize) {
    let (footprint, impedance) = (instance.objects[0].footprint.clone(), instance.objects[0].impedance);
    for object in &mut instance.objects[..count] {
        (object.footprint, object.impedance) = (footprint.clone(), impedance);
        object.group = Some("alike".to_string());
    }
}

#[test]
fn groups_take_the_best_assignment() {
    against_brute_force(41, 12, 5, |instance, _| group(instance, 3));
}

#[test]
fn a_group_may_have_fewer_goals_than_members() {
    against_brute_force(42, 12, 5, |instance, _| {
        group(instance, 3);
        instance.objects[1].goal = None;
    });
}

#[test]
fn fixed_obstacles_and_keep_outs_stay_free() {
    against_brute_force(43, 12, 5, |instance, _| {
        instance.objects[0].fixed = true;
        instance.objects[0].goal = None;
        let footprint = Footprint::rectangle(0.1, 0.1).expect("valid");
        instance.keep_out.push(KeepOut { footprint, pose: Pose2::new(0.05, 0.95, 0.0) });
    });
}

#[test]
fn the_clearance_is_kept_but_not_from_given_neighbours() {
    against_brute_force(44, 12, 4, |instance, _| instance.clearance = 0.01);
}

#[test]
fn objects_without_a_goal_move_only_if_they_must() {
    against_brute_force(45, 12, 5, |instance, rng| {
        let loose = rng.random_range(1..=3);
        instance.objects[..loose].iter_mut().for_each(|object| object.goal = None);
    });
}

#[test]
fn obstacles_clearance_bays_and_loose_objects_go_together() {
    let mut rng = ChaCha8Rng::seed_from_u64(31);
    let problems = (0..200).filter_map(|_| Problem::new(&mixed(&mut rng)).ok());
    let problems: Vec<Problem> = problems.filter(|p| p.goal_conflict().is_none()).take(12).collect();
    assert!(problems.len() >= 6, "{} of 200 stand", problems.len());
    let mut solved = 0;
    for (case, problem) in problems.iter().enumerate() {
        let outcome = run(problem, SolverKind::Auto, Objective::Pp, case as u64);
        let Some(cost) = outcome.cost else { continue };
        solved += 1;
        assert!(CheckedPlan::new(problem, &actions(&outcome)).is_ok(), "case {case}");
        assert!(cost >= outcome.lower_bound - 1e-9, "case {case}");
    }
    assert!(solved + 1 >= problems.len(), "{solved} of {}", problems.len());
}

#[test]
fn members_of_a_group_may_take_goals_nearer_than_the_clearance() {
    // Two goals 1 mm apart, clearance 5 mm: exempt whichever of the two takes which.
    let disc = |id: &str, start: (f64, f64), goal: (f64, f64)| {
        let mut object = ObjectSpec::new(id, Footprint::disc(0.1).expect("valid"));
        object.start = Some(Pose2::new(start.0, start.1, 0.0));
        object.goal = Some(Pose2::new(goal.0, goal.1, 0.0));
        object.group = Some("alike".to_string());
        object
    };
    let mut close = table(vec![disc("a", (0.2, 0.2), (0.801, 0.5)), disc("b", (0.8, 0.8), (0.6, 0.5))]);
    close.clearance = 0.005;
    let problem = Problem::new(&close).expect("valid");
    let outcome = run(&problem, SolverKind::Auto, Objective::Pp, 1);
    assert_eq!((outcome.cost, outcome.status), (Some(2.0), Status::Optimal));
}

#[test]
fn a_bay_is_used_as_a_buffer() {
    // Two squares change places on a table whose only free place is the bay of a fixed U.
    let u = [
        [0.0, 0.0],
        [0.5, 0.0],
        [0.5, 0.3],
        [0.35, 0.3],
        [0.35, 0.08],
        [0.15, 0.08],
        [0.15, 0.3],
        [0.0, 0.3],
    ];
    let mut bay = ObjectSpec::new("bay", Footprint::polygon(&u).expect("valid"));
    bay.start = Some(Pose2::new(0.0, 0.0, 0.0));
    bay.fixed = true;
    let square = |id: &str, x: f64, goal: f64| {
        let mut object = ObjectSpec::new(id, Footprint::rectangle(0.199, 0.199).expect("valid"));
        (object.start, object.goal) = (Some(Pose2::new(x, 0.4, 0.0)), Some(Pose2::new(goal, 0.4, 0.0)));
        object
    };
    let mut narrow = table(vec![square("a", 0.1, 0.4), square("b", 0.4, 0.1), bay]);
    (narrow.workspace.width, narrow.workspace.height) = (0.5, 0.5);
    let problem = Problem::new(&narrow).expect("valid");
    let outcome = run(&problem, SolverKind::Auto, Objective::Pp, 1);
    assert_eq!(outcome.cost, Some(3.0));
}

/// What `auto` needs under `time`, seconds and moves.
fn timed(problem: &Problem, seed: u64) -> (f64, usize) {
    let seconds = |actions: &[Action]| NOMINAL.seconds(actions);
    let control = Control {
        work_limit: Some(20_000),
        seconds: Some(&seconds),
        least_move_seconds: NOMINAL.least_move_seconds(),
        ..Control::until(&|| false)
    };
    let outcome = solve(problem, SolverKind::Auto, Objective::Time, &control, seed).expect("times are known");
    let cost = outcome.cost.expect("a plan");
    assert!(cost >= outcome.lower_bound);
    (cost, actions(&outcome).len())
}

#[test]
fn under_time_the_arm_travels_less_for_as_many_moves() {
    let mut less = 0;
    let problems = random_problems(46, 6);
    for (case, problem) in problems.iter().enumerate() {
        let plan = actions(&run(problem, SolverKind::Auto, Objective::Pp, case as u64));
        let (seconds, moves) = timed(problem, case as u64);
        let before = NOMINAL.seconds(&plan);
        assert!(moves == plan.len() && seconds <= before + 1e-9, "case {case}: {seconds} s, {before} s");
        less += usize::from(seconds < 0.99 * before);
    }
    assert!(less >= 4, "{less} of {} take less time", problems.len());
}

/// The problem after the first action of a plan, everything a little off.
fn after_one_action(problem: &Problem, plan: &[Action], rng: &mut ChaCha8Rng) -> Option<Problem> {
    let mut objects = Vec::new();
    for (k, given) in problem.objects.iter().enumerate() {
        let mut object = ObjectSpec::new(given.id.clone(), given.footprint.clone());
        let at = if k == plan[0].object { plan[0].to } else { given.start };
        let mut off = || rng.random_range(-1e-4..1e-4);
        object.start = Some(Pose2::new(at.x + off(), at.y + off(), at.theta + off()));
        object.goal = given.goal;
        objects.push(object);
    }
    Problem::new(&table(objects)).ok()
}

#[test]
fn a_known_plan_is_continued_where_it_is_still_good() {
    let mut rng = ChaCha8Rng::seed_from_u64(47);
    let mut continued = 0;
    for (case, problem) in random_problems(47, 10).iter().enumerate() {
        let plan = actions(&run(problem, SolverKind::Auto, Objective::Pp, case as u64));
        let Some(changed) = after_one_action(problem, &plan, &mut rng) else { continue };
        let reported = Mutex::new(Vec::new());
        let on_plan =
            |actions: &[Action], _: f64| reported.lock().expect("one thread").push(actions.to_vec());
        let control = Control {
            known_plan: &plan[1..],
            first: true,
            on_plan: &on_plan,
            work_limit: Some(2000),
            ..Control::until(&|| false)
        };
        solve(&changed, SolverKind::Auto, Objective::Pp, &control, 1).expect("built");
        let first = reported.into_inner().expect("one thread").remove(0);
        let who = |plan: &[Action]| plan.iter().map(|action| (action.object, action.to)).collect::<Vec<_>>();
        // Who had been home already has to be set right; the rest goes on as it was.
        let rest: Vec<_> = who(&plan[1..]);
        continued += usize::from(rest.iter().all(|step| who(&first).contains(step)));
    }
    assert!(continued >= 6, "{continued} plans were continued");
}

#[test]
fn a_known_plan_that_is_nonsense_does_no_harm() {
    let problem = &random_problems(48, 1)[0];
    let off = |object: usize, x: f64| Action {
        object,
        from: Pose2::default(),
        to: Pose2::new(x, x, 0.0),
        kind: crate::planning::plan::ActionKind::Buffer,
    };
    let known = [off(999, 0.5), off(0, f64::NAN), off(1, -3.0), off(2, 0.5)];
    let control = Control { known_plan: &known, work_limit: Some(4000), ..Control::until(&|| false) };
    let outcome = solve(problem, SolverKind::Auto, Objective::Pp, &control, 1).expect("built");
    assert!(outcome.cost.is_some());
}
