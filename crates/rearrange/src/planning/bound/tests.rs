//! The lower bound against exhaustive search in which objects may wait beside the table.

use super::*;
use crate::planning::plan::Objective;
use crate::planning::problem::Problem;
use crate::planning::random_tables::{optimum_with_outside, random_instance};
use crate::planning::solver;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Costs of one move and the bound, under PP and TI.
fn bounds(problem: &Problem) -> [(Vec<f64>, LowerBound); 2] {
    let scene = Scene::new(problem);
    let impedances = problem.objects.iter().map(|object| object.impedance).collect();
    let bound = |objective| solver::lower_bound(&scene, objective, 0.0, &mut Watch::new(&|| false));
    [(vec![1.0; problem.objects.len()], bound(Objective::Pp)), (impedances, bound(Objective::Ti))]
}

#[test]
fn equals_the_optimum_with_room_beside_the_table() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut with_cycles = 0;
    for case in 0..150 {
        let count = rng.random_range(1..6);
        let mut instance = random_instance(&mut rng, count);
        for object in &mut instance.objects {
            match rng.random_range(0..10) {
                0 => object.goal = None,
                1 => object.goal = object.start,
                _ => {}
            }
        }
        let Ok(problem) = Problem::new(&instance) else { panic!("case {case}: starts overlap") };
        if problem.goal_conflict().is_some() {
            continue;
        }
        for (costs, bound) in bounds(&problem) {
            let optimum = optimum_with_outside(&problem, &costs);
            assert!((bound.value - optimum).abs() < 1e-9, "case {case}: {bound:?}, optimum {optimum}");
            with_cycles += usize::from(bound.cycle_cost > 0.0);
        }
    }
    assert!(with_cycles > 40, "only {with_cycles} cases with cycles");
}

#[test]
fn never_exceeds_the_optimum_of_groups() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let mut reached = 0;
    for case in 0..60 {
        let mut instance = random_instance(&mut rng, 4);
        let (footprint, impedance) = (instance.objects[0].footprint.clone(), instance.objects[0].impedance);
        for object in &mut instance.objects[1..3] {
            (object.footprint, object.impedance) = (footprint.clone(), impedance);
        }
        for object in &mut instance.objects[..3] {
            object.group = Some("alike".to_string());
        }
        let Ok(problem) = Problem::new(&instance) else { continue };
        if problem.goal_conflict().is_some() {
            continue;
        }
        for (costs, bound) in bounds(&problem) {
            let optimum = optimum_with_outside(&problem, &costs);
            assert!(bound.value <= optimum + 1e-9, "case {case}: {bound:?}, optimum {optimum}");
            reached += usize::from(bound.value > optimum - 1e-9);
        }
    }
    assert!(reached > 20, "only {reached} bounds are reached");
}
