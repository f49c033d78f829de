//! Planted faults, and agreement with the solvers' kernel on random and near-touching pairs of every shape.

use super::*;
use crate::geometry::collision::Placed;
use crate::geometry::footprint::Footprint;
use crate::tabletop::instance::{Instance, ObjectSpec, Workspace};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_2, TAU};

fn shapes() -> Vec<Footprint> {
    vec![
        Footprint::rectangle(0.2, 0.1).expect("valid"),
        Footprint::disc(0.06).expect("valid"),
        Footprint::ellipse(0.24, 0.1).expect("valid"),
        // A Tetris T and a mug with its handle: one with right angles, one without.
        Footprint::polygon(&[
            [-0.09, -0.03],
            [0.09, -0.03],
            [0.09, 0.03],
            [0.03, 0.03],
            [0.03, 0.09],
            [-0.03, 0.09],
            [-0.03, 0.03],
            [-0.09, 0.03],
        ])
        .expect("valid"),
        Footprint::polygon(&[
            [-0.05, -0.02],
            [-0.02, -0.05],
            [0.03, -0.05],
            [0.05, -0.02],
            [0.09, -0.03],
            [0.09, 0.03],
            [0.05, 0.02],
            [0.07, 0.015],
            [0.07, -0.01],
            [0.055, 0.0],
            [0.03, 0.05],
            [-0.02, 0.05],
        ])
        .expect("valid"),
    ]
}

/// Both answers for a pair of shapes at poses.
fn both(a: &Footprint, pose_a: Pose2, b: &Footprint, pose_b: Pose2) -> (bool, bool) {
    let kernel = Placed::new(a, pose_a).collides(&Placed::new(b, pose_b));
    (kernel, deeper_than(&Body::new(a, pose_a), &Body::new(b, pose_b), TOUCH_M))
}

#[test]
fn kernel_and_checker_agree_on_random_pairs() {
    let shapes = shapes();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut hits = 0;
    const PAIRS: usize = 2_000;
    for k in 0..PAIRS {
        let (a, b) = (&shapes[k % 5], &shapes[(k / 5) % 5]);
        let mut pose = || {
            Pose2::new(rng.random_range(0.0..0.25), rng.random_range(0.0..0.25), rng.random_range(0.0..TAU))
        };
        let (pose_a, pose_b) = (pose(), pose());
        let (kernel, checker) = both(a, pose_a, b, pose_b);
        assert_eq!(kernel, checker, "seed 1, pair {k}: {a:?} at {pose_a:?}, {b:?} at {pose_b:?}");
        hits += usize::from(kernel);
    }
    assert!(hits > PAIRS / 10 && hits < PAIRS * 9 / 10, "{hits} of {PAIRS} overlap");
}

/// Poses at which `b` touches `a`, found by bisection on the kernel along a random direction; `None` if the
/// two collide at both ends.
fn contact(a: &Footprint, b: &Footprint, rng: &mut ChaCha8Rng) -> (Pose2, Pose2, [f64; 2]) {
    let pose_a = Pose2::new(0.5, 0.5, rng.random_range(0.0..TAU));
    let theta = rng.random_range(0.0..TAU);
    let angle: f64 = rng.random_range(0.0..TAU);
    let direction = [angle.cos(), angle.sin()];
    let placed = Placed::new(a, pose_a);
    let at = |t: f64| Pose2::new(0.5 + t * direction[0], 0.5 + t * direction[1], theta);
    let (mut hit, mut free) = (0.0, 0.5);
    for _ in 0..60 {
        let middle = 0.5 * (hit + free);
        if placed.collides(&Placed::new(b, at(middle))) {
            hit = middle;
        } else {
            free = middle;
        }
    }
    (pose_a, at(free), direction)
}

#[test]
fn kernel_and_checker_agree_on_near_touching_pairs() {
    let shapes = shapes();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut undecided = 0;
    const PAIRS: usize = 250;
    for k in 0..PAIRS {
        let (a, b) = (&shapes[k % 5], &shapes[(k / 5) % 5]);
        let (pose_a, touching, direction) = contact(a, b, &mut rng);
        for step in [3e-8, 1e-6, 1e-4] {
            for sign in [1.0, -1.0] {
                let shift = [sign * step * direction[0], sign * step * direction[1]];
                let pose_b = Pose2::new(touching.x + shift[0], touching.y + shift[1], touching.theta);
                let (kernel, checker) = both(a, pose_a, b, pose_b);
                if kernel != checker {
                    // A graze along the surface moves the shapes apart by less than the rule's nanometre.
                    let depth = Placed::new(a, pose_a).penetration(&Placed::new(b, pose_b));
                    assert!(
                        depth < 5e-9,
                        "seed 2, pair {k}, {step}: {a:?} at {pose_a:?}, {b:?} at {pose_b:?}"
                    );
                    undecided += 1;
                }
            }
        }
    }
    assert!(undecided < PAIRS / 100, "{undecided} pairs within the nanometre");
}

fn problem(objects: &[(Footprint, [f64; 3], Option<[f64; 3]>)], clearance: f64) -> Problem {
    let objects = objects
        .iter()
        .enumerate()
        .map(|(k, (footprint, start, goal))| {
            let mut object = ObjectSpec::new(format!("o{k}"), footprint.clone());
            object.start = Some(Pose2::new(start[0], start[1], start[2]));
            object.goal = goal.map(|g| Pose2::new(g[0], g[1], g[2]));
            object
        })
        .collect();
    let instance = Instance {
        workspace: Workspace { width: 1.0, height: 1.0 },
        clearance,
        overlap_tolerance: 0.0,
        keep_out: Vec::new(),
        objects,
    };
    Problem::new(&instance).expect("valid start")
}

fn action(object: usize, from: [f64; 3], to: [f64; 3], kind: ActionKind) -> Action {
    let pose = |p: [f64; 3]| Pose2::new(p[0], p[1], p[2]);
    Action { object, from: pose(from), to: pose(to), kind }
}

/// Two squares that have to swap: a three-action plan by way of a buffer.
fn swap() -> (Problem, Vec<Action>) {
    let square = Footprint::rectangle(0.1, 0.1).expect("valid");
    let (a, b, side) = ([0.2, 0.2, 0.0], [0.5, 0.2, 0.0], [0.5, 0.7, 0.3]);
    let problem = problem(&[(square.clone(), a, Some(b)), (square, b, Some(a))], 0.0);
    let plan = vec![
        action(0, a, side, ActionKind::Buffer),
        action(1, b, a, ActionKind::Goal),
        action(0, side, b, ActionKind::Goal),
    ];
    (problem, plan)
}

#[test]
fn a_good_plan_passes_and_is_priced() {
    let (problem, plan) = swap();
    let checked = CheckedPlan::new(&problem, &plan).expect("good");
    assert_eq!(checked.cost_pp(), 3);
    assert!((checked.cost_ti() - 0.03).abs() < 1e-12);
}

#[track_caller]
fn refused(problem: &Problem, plan: &[Action], word: &str) {
    let fault = CheckedPlan::new(problem, plan).expect_err("planted fault");
    assert!(fault.to_string().contains(word), "{fault}");
}

#[test]
fn planted_faults_are_all_refused() {
    let (problem, plan) = swap();
    let with = |k: usize, change: &dyn Fn(&mut Action)| {
        let mut plan = plan.clone();
        change(&mut plan[k]);
        plan
    };
    refused(&problem, &plan[1..], "overlap");
    refused(&problem, &plan[..2], "o0 does not end at its goal");
    refused(&problem, &with(0, &|a| a.object = 1), "not at `from`");
    refused(&problem, &with(0, &|a| a.object = 7), "no object number 7");
    refused(&problem, &with(0, &|a| a.to.x = f64::NAN), "finite");
    refused(&problem, &with(0, &|a| a.kind = ActionKind::Goal), "said to go to its goal");
    refused(&problem, &with(2, &|a| a.kind = ActionKind::Buffer), "said to go to a buffer");
    refused(&problem, &with(2, &|a| a.to.x += 1e-12), "said to go to its goal");
    refused(&problem, &with(2, &|a| a.from.y += 2e-9), "not at `from`");
    // The buffer over the edge by a micrometre.
    let edge = |a: &mut Action| a.to = Pose2::new(0.05 - 1e-6, 0.7, 0.0);
    refused(&problem, &with(0, &edge), "over the table's edge");
}

#[test]
fn an_overlap_of_a_micrometre_is_refused_for_every_shape() {
    let shapes = shapes();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut planted = 0;
    while planted < 250 {
        let (a, b) = (&shapes[planted % 5], &shapes[(planted / 5) % 5]);
        let (pose_a, touching, direction) = contact(a, b, &mut rng);
        let back =
            |t: f64| Pose2::new(touching.x - t * direction[0], touching.y - t * direction[1], touching.theta);
        let placed = Placed::new(a, pose_a);
        // As far back as makes the depth, not the way, a micrometre; grazing contacts are drawn again.
        let Some(way) = (0..6)
            .map(|k| 1e-6 * 2f64.powi(k))
            .find(|t| placed.penetration(&Placed::new(b, back(*t))) >= 1e-6)
        else {
            continue;
        };
        let away = [0.12, 0.12, 0.0];
        let start_a = [pose_a.x, pose_a.y, pose_a.theta];
        let task = problem(&[(a.clone(), start_a, None), (b.clone(), away, None)], 0.0);
        let to = back(way);
        let plan = [action(1, away, [to.x, to.y, to.theta], ActionKind::Buffer)];
        refused(&task, &plan, "overlap");
        let apart = back(-1e-4);
        let fine = [action(1, away, [apart.x, apart.y, apart.theta], ActionKind::Buffer)];
        assert!(CheckedPlan::new(&task, &fine).is_ok());
        planted += 1;
    }
}

#[test]
fn clearance_is_checked_at_new_places_only() {
    let square = Footprint::rectangle(0.1, 0.1).expect("valid");
    let start = [0.5, 0.7, 0.0];
    let task = problem(
        &[(square.clone(), [0.2, 0.2, 0.0], Some([0.2, 0.2, 0.0])), (square, start, Some([0.301, 0.2, 0.0]))],
        0.01,
    );
    let to_goal = [action(1, start, [0.301, 0.2, 0.0], ActionKind::Goal)];
    assert!(CheckedPlan::new(&task, &to_goal).is_ok(), "two given goals may be close");
    let near = [0.3099, 0.2, 0.0];
    let by_way =
        [action(1, start, near, ActionKind::Buffer), action(1, near, [0.301, 0.2, 0.0], ActionKind::Goal)];
    refused(&task, &by_way, "nearer");
}

#[test]
fn a_turn_of_a_whole_circle_is_no_move() {
    let square = Footprint::rectangle(0.1, 0.1).expect("valid");
    let task = problem(&[(square, [0.2, 0.2, FRAC_PI_2], Some([0.2, 0.2, FRAC_PI_2 - TAU]))], 0.0);
    assert!(CheckedPlan::new(&task, &[]).is_ok());
}
