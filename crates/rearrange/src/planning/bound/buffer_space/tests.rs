//! The bound where there is no room: known tables, and never over what plans cost.

use super::*;
use crate::planning::bound;
use crate::planning::plan::Objective;
use crate::planning::problem::Problem;
use crate::planning::random_tables::table;
use crate::planning::solver::{Control, SolverKind, solve};
use crate::tabletop::instance::{Instance, ObjectSpec};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn begun<'a>(scene: &'a Scene<'a>, costs: &'a [f64]) -> BufferSpaceBound<'a> {
    let mut watch = Watch::new(&|| false);
    let parts = Parts::new(scene, costs, &mut watch);
    BufferSpaceBound::new(scene, costs, parts, &mut watch)
}

fn proved(instance: &Instance) -> f64 {
    let problem = Problem::new(instance).expect("valid");
    let scene = Scene::new(&problem);
    let costs = vec![1.0; problem.objects.len()];
    let mut proof = begun(&scene, &costs);
    proof.work(f64::INFINITY, &mut Effort::new(None, &|| false));
    assert!(proof.is_done());
    proof.value
}

fn square(id: &str, size: f64, start: (f64, f64), goal: (f64, f64)) -> ObjectSpec {
    let mut object = ObjectSpec::new(id, Footprint::rectangle(size, size).expect("valid"));
    object.start = Some(Pose2::new(start.0, start.1, 0.0));
    object.goal = Some(Pose2::new(goal.0, goal.1, 0.0));
    object
}

/// Two squares of 0.3 m change places on a table with `spare` metres beside them.
fn swap(spare: f64) -> Instance {
    let mut swap = table(vec![
        square("a", 0.3, (0.15, 0.15), (0.45, 0.15)),
        square("b", 0.3, (0.45, 0.15), (0.15, 0.15)),
    ]);
    (swap.workspace.width, swap.workspace.height) = (0.6 + spare, 0.3);
    swap
}

#[test]
fn a_swap_with_room_costs_what_it_always_did() {
    assert_eq!(proved(&swap(0.3)), 3.0);
}

#[test]
fn a_swap_without_room_is_known_to_cost_more() {
    // 0.2 m beside two squares of 0.3 m: one of them alone cannot be put aside, so that both would have to
    // be.
    assert_eq!(proved(&swap(0.2)), 4.0);
}

#[test]
fn who_has_to_make_room_counts() {
    let mut crowded = swap(0.3);
    crowded.objects.push(square("small", 0.1, (0.75, 0.15), (0.75, 0.15)));
    // The small one would have to leave and come back, or both squares to be put aside.
    assert_eq!(proved(&crowded), 4.0);
    crowded.objects[2].goal = None;
    assert_eq!(proved(&crowded), 4.0);
}

/// Crowded tables of `count` objects: discs, ellipses, rectangles, an L.
fn crowded(rng: &mut ChaCha8Rng, count: usize) -> Option<Problem> {
    let mut objects: Vec<ObjectSpec> = Vec::new();
    let place = |shape: &Footprint, others: &[Placed], rng: &mut ChaCha8Rng| {
        (0..300).find_map(|_| {
            let pose = Pose2::new(
                rng.random_range(0.0..0.8),
                rng.random_range(0.0..0.5),
                rng.random_range(0.0..6.2),
            );
            let placed = Placed::new(shape, pose);
            let free = overhang(shape, &pose, 0.8, 0.5) <= 0.0 && !others.iter().any(|o| o.collides(&placed));
            free.then_some((pose, placed))
        })
    };
    let (mut starts, mut goals) = (Vec::new(), Vec::new());
    for k in 0..count {
        let (a, b) = (rng.random_range(0.2..0.34), rng.random_range(0.16..0.28));
        let shape = match rng.random_range(0..5) {
            0 => Footprint::disc(a / 2.0),
            1 => Footprint::ellipse(a, b),
            2 => Footprint::polygon(&[
                [0.0, 0.0],
                [a, 0.0],
                [a, b / 2.0],
                [a / 2.0, b / 2.0],
                [a / 2.0, b],
                [0.0, b],
            ]),
            _ => Footprint::rectangle(a, b),
        }
        .expect("valid");
        let mut object = ObjectSpec::new(format!("o{k}"), shape.clone());
        let ((start, here), (goal, there)) = (place(&shape, &starts, rng)?, place(&shape, &goals, rng)?);
        starts.push(here);
        goals.push(there);
        (object.start, object.goal) = (Some(start), Some(goal));
        objects.push(object);
    }
    let mut instance = table(objects);
    (instance.workspace.width, instance.workspace.height) = (0.8, 0.5);
    if rng.random_bool(0.3) {
        instance.objects[0].goal = instance.objects[0].start;
    }
    Problem::new(&instance).ok().filter(|problem| problem.goal_conflict().is_none())
}

#[test]
fn no_plan_is_cheaper_and_often_more_is_proved() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut compared, mut raised) = (0, 0);
    while compared < 60 {
        let count = rng.random_range(3..=5);
        let Some(problem) = crowded(&mut rng, count) else { continue };
        let scene = Scene::new(&problem);
        let costs = vec![1.0; count];
        let simple = bound::lower_bound(&scene, &costs, &mut Watch::new(&|| false)).value;
        if simple == count as f64 {
            continue;
        }
        let mut proof = begun(&scene, &costs);
        proof.work(f64::INFINITY, &mut Effort::new(Some(400_000), &|| false));
        assert!(proof.value >= simple);
        // Any plan will do, and the first ones are not the best: the more of them, the sharper the test.
        let control = Control { work_limit: Some(20_000), ..Control::until(&|| false) };
        for (solver, seed) in [(SolverKind::Emcts, 1), (SolverKind::Auto, 2)] {
            let cost = solve(&problem, solver, Objective::Pp, &control, seed).expect("built").cost;
            assert!(
                cost.is_none_or(|cost| cost >= proof.value),
                "case {compared}: {cost:?}, {}",
                proof.value
            );
        }
        compared += 1;
        raised += usize::from(proof.value > simple);
    }
    assert!(raised >= 5, "{raised} of {compared} bounds were raised");
}
