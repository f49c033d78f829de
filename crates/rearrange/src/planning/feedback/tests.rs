//! The feedback vertex set against brute force on small graphs and an integer programme on larger ones.

use super::*;
use good_lp::{Expression, ProblemVariables, Solution, SolverModel, constraint, microlp, variable};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn random_graph(rng: &mut ChaCha8Rng, count: usize, density: f64) -> DependencyGraph {
    DependencyGraph::from_fn(count, |_, _| rng.random_bool(density))
}

fn is_acyclic(graph: &DependencyGraph, without: ObjectSet) -> bool {
    let kept = ObjectSet::first(graph.len()) - without;
    let order: Vec<usize> = (0..graph.len()).collect();
    graph.restricted(kept).components(&order).iter().all(|component| component.len() == 1)
}

fn brute_force(graph: &DependencyGraph, weights: &[f64]) -> f64 {
    (0u32..1 << graph.len())
        .map(|mask| (0..graph.len()).filter(|v| mask >> v & 1 == 1).collect::<ObjectSet>())
        .filter(|set| is_acyclic(graph, *set))
        .map(|set| set.weight(weights))
        .fold(f64::INFINITY, f64::min)
}

/// A cycle of `graph` that avoids `without`, by walking until a vertex comes twice.
fn any_cycle(graph: &DependencyGraph, without: ObjectSet) -> Option<ObjectSet> {
    let kept = graph.restricted(ObjectSet::first(graph.len()) - without);
    let order: Vec<usize> = (0..graph.len()).collect();
    let component = kept.components(&order).into_iter().find(|c| c.len() > 1)?;
    let inside: ObjectSet = component.iter().copied().collect();
    let mut walk = vec![component[0]];
    loop {
        let next = (kept.blockers(walk[walk.len() - 1]) & inside).smallest()?;
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
        while let Some(cycle) = any_cycle(graph, set) {
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
        let found = minimum(&graph, &weights);
        let wanted = brute_force(&graph, &weights);
        assert!(is_acyclic(&graph, found.vertices), "case {case}: {graph:?}");
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
        let found = minimum(&graph, &weights);
        let wanted = by_integer_programme(&graph, &weights);
        assert!(is_acyclic(&graph, found.vertices), "case {case}");
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
        let exact = minimum(&graph, &weights);
        let cut = minimum_within(&graph, &weights, 1);
        assert!(is_acyclic(&graph, cut.vertices));
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
        assert_eq!(minimum(&wide, &shifted).weight, minimum(&narrow, &weights).weight);
    }
}
