//! The feedback vertex set against brute force on small graphs and an integer programme on larger ones.

use super::*;
use crate::planning::object_set::ObjectSet;
use good_lp::{Expression, ProblemVariables, Solution, SolverModel, constraint, microlp, variable};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::atomic::{AtomicU64, Ordering};

fn free() -> Watch<'static> {
    Watch::new(&|| false)
}

fn random_graph(rng: &mut ChaCha8Rng, count: usize, density: f64) -> DependencyGraph {
    DependencyGraph::from_fn(count, |_, _| rng.random_bool(density))
}

fn is_acyclic(graph: &DependencyGraph, without: &ObjectSet) -> bool {
    let kept = ObjectSet::first(graph.len()) - without;
    let order: Vec<usize> = (0..graph.len()).collect();
    graph.restricted(&kept).components(&order).iter().all(|component| component.len() == 1)
}

fn brute_force(graph: &DependencyGraph, weights: &[f64]) -> f64 {
    (0u32..1 << graph.len())
        .map(|mask| (0..graph.len()).filter(|v| mask >> v & 1 == 1).collect::<ObjectSet>())
        .filter(|set| is_acyclic(graph, set))
        .map(|set| set.weight(weights))
        .fold(f64::INFINITY, f64::min)
}

/// A cycle of `graph` that avoids `without`, by walking until a vertex comes twice.
fn any_cycle(graph: &DependencyGraph, without: &ObjectSet) -> Option<ObjectSet> {
    let kept = graph.restricted(&(ObjectSet::first(graph.len()) - without));
    let order: Vec<usize> = (0..graph.len()).collect();
    let component = kept.components(&order).into_iter().find(|c| c.len() > 1)?;
    let inside: ObjectSet = component.iter().copied().collect();
    let mut walk = vec![component[0]];
    loop {
        let next = (kept.blockers(walk[walk.len() - 1]) & &inside).smallest()?;
        if let Some(at) = walk.iter().position(|&v| v == next) {
            return Some(walk[at..].iter().copied().collect());
        }
        walk.push(next);
    }
}

/// The same optimum as an integer programme: cover every cycle, cycles added as they turn up.
fn by_integer_programme(graph: &DependencyGraph, weights: &[f64]) -> f64 {
    let mut cycles: Vec<ObjectSet> = Vec::new();
    loop {
        let mut variables = ProblemVariables::new();
        let taken = variables.add_vector(variable().binary(), graph.len());
        let cost: Expression = taken.iter().zip(weights).map(|(&x, &w)| w * x).sum();
        let mut model = variables.minimise(cost).using(microlp);
        for cycle in &cycles {
            let sum: Expression = cycle.iter().map(|v| taken[v]).sum();
            model = model.with(constraint!(sum >= 1.0));
        }
        let solution = model.solve().expect("covering every vertex is feasible");
        let mut set: ObjectSet = (0..graph.len()).filter(|&v| solution.value(taken[v]) > 0.5).collect();
        let weight = set.weight(weights);
        let before = cycles.len();
        while let Some(cycle) = any_cycle(graph, &set) {
            set.insert(cycle.smallest().expect("a cycle has vertices"));
            cycles.push(cycle);
        }
        if cycles.len() == before {
            return weight;
        }
    }
}

fn random_weights(rng: &mut ChaCha8Rng, count: usize, kind: usize) -> Vec<f64> {
    (0..count)
        .map(|_| match kind {
            0 => 1.0,
            1 => f64::from(rng.random_range(1..4u32)),
            _ => rng.random_range(0.05..1.0),
        })
        .collect()
}

#[test]
fn equals_brute_force_on_small_graphs() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for case in 0..600 {
        let count = rng.random_range(1..10);
        let density = rng.random_range(0.05..0.7);
        let graph = random_graph(&mut rng, count, density);
        let weights = random_weights(&mut rng, count, case % 3);
        let found = minimum(&graph, &weights, &mut free());
        let wanted = brute_force(&graph, &weights);
        assert!(is_acyclic(&graph, &found.vertices), "case {case}: {graph:?}");
        assert!(
            (found.weight - wanted).abs() < 1e-9,
            "case {case}: {} not {wanted}; {graph:?}",
            found.weight
        );
        assert_eq!(found.weight, found.lower_bound);
    }
}

#[test]
fn equals_the_integer_programme_on_random_graphs() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for case in 0..45 {
        let count = rng.random_range(12..26);
        let density = rng.random_range(0.06..0.25);
        let graph = random_graph(&mut rng, count, density);
        let weights = random_weights(&mut rng, count, case % 3);
        let found = minimum(&graph, &weights, &mut free());
        let wanted = by_integer_programme(&graph, &weights);
        assert!(is_acyclic(&graph, &found.vertices), "case {case}");
        assert!(
            (found.weight - wanted).abs() < 1e-7,
            "case {case}: {} not {wanted}; {graph:?}",
            found.weight
        );
    }
}

#[test]
fn a_cut_search_keeps_a_valid_bound() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..20 {
        let graph = random_graph(&mut rng, 30, 0.15);
        let weights = random_weights(&mut rng, 30, 2);
        let exact = minimum(&graph, &weights, &mut free());
        let cut = minimum_within(&graph, &weights, 1, &mut free());
        assert!(is_acyclic(&graph, &cut.vertices));
        assert!(cut.lower_bound <= exact.weight + 1e-9 && exact.weight <= cut.weight + 1e-9);
    }
}

#[test]
fn more_than_64_vertices_make_no_difference() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..40 {
        let narrow = random_graph(&mut rng, 14, 0.25);
        let weights = random_weights(&mut rng, 14, 1);
        let has = |i: usize, j: usize| narrow.blockers(i).contains(j);
        // The same graph on the vertices 60 to 73, across the border of a machine word.
        let wide = DependencyGraph::from_fn(80, |i, j| {
            (60..74).contains(&i) && (60..74).contains(&j) && has(i - 60, j - 60)
        });
        let shifted: Vec<f64> =
            (0..80usize).map(|v| if v < 60 { 1.0 } else { weights[(v - 60) % 14] }).collect();
        assert_eq!(
            minimum(&wide, &shifted, &mut free()).weight,
            minimum(&narrow, &weights, &mut free()).weight
        );
    }
}

/// Graphs of some components side by side.
fn side_by_side(parts: &[DependencyGraph]) -> DependencyGraph {
    let mut blockers = Vec::new();
    for part in parts {
        let first = blockers.len();
        blockers.extend((0..part.len()).map(|v| part.blockers(v).iter().map(|j| first + j).collect()));
    }
    DependencyGraph::from_blockers(blockers)
}

#[test]
fn more_vertices_than_the_bitsets_hold_are_solved_component_by_component() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let parts: Vec<DependencyGraph> = (0..40).map(|_| random_graph(&mut rng, 10, 0.3)).collect();
    let graph = side_by_side(&parts);
    let weights = random_weights(&mut rng, graph.len(), 2);
    let found = minimum(&graph, &weights, &mut free());
    let wanted: f64 = (0..parts.len()).map(|k| brute_force(&parts[k], &weights[10 * k..10 * k + 10])).sum();
    assert!(is_acyclic(&graph, &found.vertices));
    assert!((found.weight - wanted).abs() < 1e-9 && found.is_minimum(), "{found:?}, not {wanted}");
}

#[test]
fn a_component_of_any_size_gets_a_set_and_a_bound() {
    // Swaps along a line: every second vertex has to be taken, and no cheaper set exists. What a component
    // of more than 1024 vertices loses before it is searched adds nothing to the bound.
    for count in [257, 1030, 3000] {
        let line = DependencyGraph::from_fn(count, |i, j| i.abs_diff(j) == 1);
        let found = minimum(&line, &vec![1.0; count], &mut free());
        assert!(is_acyclic(&line, &found.vertices), "{count}");
        assert!(
            found.lower_bound > 0.14 * count as f64 && found.lower_bound <= (count / 2) as f64,
            "{count}"
        );
        assert!(found.weight >= (count / 2) as f64 && found.weight < 0.6 * count as f64, "{count}");
    }
}

#[test]
fn a_set_that_is_had_soon_breaks_all_cycles_and_is_not_far_from_the_cheapest() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for (count, density) in [(70, 0.03), (200, 0.01), (600, 0.004), (1500, 0.002)] {
        let graph = random_graph(&mut rng, count, density);
        let weights = random_weights(&mut rng, count, 0);
        let soon = large::approximate(&graph, &weights, &mut free());
        let best = minimum(&graph, &weights, &mut free());
        assert!(is_acyclic(&graph, &soon), "{count} vertices");
        assert!(soon.len() as f64 <= 1.1 * best.weight + 2.0, "{count}: {} of {}", soon.len(), best.weight);
        let stopped = large::approximate(&graph, &weights, &mut Watch::new(&|| true));
        assert!(is_acyclic(&graph, &stopped), "{count} vertices, stopped");
    }
}

#[test]
fn a_search_that_is_stopped_at_any_question_keeps_a_valid_bound_and_ends() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for (count, density) in [(40, 0.12), (100, 0.04), (400, 0.008)] {
        let graph = random_graph(&mut rng, count, density);
        let weights = random_weights(&mut rng, count, 2);
        let best = minimum(&graph, &weights, &mut free());
        for questions in 0..30 {
            let asked = AtomicU64::new(0);
            let stop = || asked.fetch_add(1, Ordering::Relaxed) >= questions;
            let cut = minimum_within(&graph, &weights, u64::MAX, &mut Watch::new(&stop));
            assert!(is_acyclic(&graph, &cut.vertices), "{count} vertices, {questions} questions");
            assert!(cut.lower_bound <= best.weight + 1e-9, "{count} vertices, {questions} questions");
            assert!(asked.load(Ordering::Relaxed) <= questions + 1, "no question after the answer");
        }
    }
}
