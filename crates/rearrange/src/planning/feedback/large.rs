//! Feedback vertex sets of graphs of more vertices than the bitsets of the search hold.
//!
//! In: a graph of any size. Out: as the search gives it. A cycle lies within one strongly connected
//! component, so each component is searched alone, in sets as wide as it needs. A component that is still
//! too large loses its busiest vertices to the set until it falls apart; the pieces have no vertex in
//! common, so the sum of their bounds is a bound, if not a tight one.

use crate::planning::effort::Watch;
use crate::planning::feedback::search::{greedy, search};
use crate::planning::feedback::set::FeedbackSet;
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::{Bits, ObjectSet};

/// The widest sets that are searched.
const WIDEST: usize = 16;

/// A node of so wide a search takes as long as so many others.
const WIDE_NODE: u64 = 16;

/// Nodes of the search in a small component where a set is to be had soon.
const NODES_OF_A_PART: u64 = 200;

/// A component that is too large loses one in so many of its vertices at a time.
const PEELED: usize = 16;

/// What the components need together; `node_limit` is for all of them.
pub(super) fn by_components(
    graph: &DependencyGraph,
    weights: &[f64],
    node_limit: u64,
    watch: &mut Watch,
) -> FeedbackSet {
    let mut found = FeedbackSet { vertices: ObjectSet::EMPTY, weight: 0.0, lower_bound: 0.0, nodes: 0 };
    let mut waiting = cyclic_components(graph, 0..graph.len());
    while let Some(component) = waiting.pop() {
        if !watch.go_on((component.len() * WIDEST) as u64) {
            found.vertices.extend(&component.into_iter().collect());
        } else if component.len() <= Bits::<WIDEST>::CAPACITY {
            let left = (node_limit - found.nodes).max(1);
            let part = solved(graph, weights, &component, left, watch);
            found.vertices.extend(&part.vertices.iter().map(|v| component[v]).collect());
            found.lower_bound += part.lower_bound;
            found.nodes = node_limit.min(found.nodes + part.nodes);
        } else {
            let (peeled, rest) = peel(graph, weights, &component);
            found.vertices.extend(&peeled);
            waiting.extend(cyclic_components(graph, rest));
        }
    }
    found.weight = found.vertices.weight(weights);
    found.lower_bound = found.lower_bound.min(found.weight);
    found
}

/// Strongly connected components of more than one vertex of the graph on these vertices.
fn cyclic_components(graph: &DependencyGraph, vertices: impl IntoIterator<Item = usize>) -> Vec<Vec<usize>> {
    let order: Vec<usize> = vertices.into_iter().collect();
    let part = graph.restricted(&order.iter().copied().collect());
    let mut components = part.components(&order);
    components.retain(|component| component.len() > 1);
    components.iter_mut().for_each(|component| component.sort_unstable());
    components
}

/// A set without a bound, soon: small components are solved, of the others the busiest vertices are taken.
pub fn approximate(graph: &DependencyGraph, weights: &[f64], watch: &mut Watch) -> ObjectSet {
    let mut set = ObjectSet::EMPTY;
    let mut waiting = cyclic_components(graph, 0..graph.len());
    while let Some(component) = waiting.pop() {
        if component.len() > Bits::<WIDEST>::CAPACITY && watch.go_on(component.len() as u64) {
            let (peeled, rest) = peel(graph, weights, &component);
            set.extend(&peeled);
            waiting.extend(cyclic_components(graph, rest));
            continue;
        }
        let part = graph.part(&component);
        let weights: Vec<f64> = component.iter().map(|&v| weights[v]).collect();
        let found = match component.len() {
            _ if watch.is_stopped() => ObjectSet::first(component.len()),
            0..=64 => search::<1>(&part, &weights, NODES_OF_A_PART, watch).vertices,
            65..=256 => greedy::<4>(&part, &weights, watch),
            _ => greedy::<WIDEST>(&part, &weights, watch),
        };
        set.extend(&found.iter().map(|v| component[v]).collect());
    }
    set
}

/// The set of one component, whose vertices are numbered in its order.
fn solved(
    graph: &DependencyGraph,
    weights: &[f64],
    component: &[usize],
    node_limit: u64,
    watch: &mut Watch,
) -> FeedbackSet {
    let part = graph.part(component);
    let weights: Vec<f64> = component.iter().map(|&v| weights[v]).collect();
    match component.len() {
        0..=64 => search::<1>(&part, &weights, node_limit, watch),
        65..=256 => search::<4>(&part, &weights, node_limit, watch),
        _ => search::<WIDEST>(&part, &weights, node_limit.div_ceil(WIDE_NODE), watch),
    }
}

/// The vertices on most paths for their weight, no two of them neighbours, and the others: neighbours of a
/// vertex that is gone have lost paths.
fn peel(graph: &DependencyGraph, weights: &[f64], component: &[usize]) -> (ObjectSet, Vec<usize>) {
    let part = graph.part(component);
    let mut into = vec![0; part.len()];
    part.arcs().for_each(|(_, j)| into[j] += 1);
    let paths = |v: usize| (part.blockers(v).len() * into[v]) as f64 / weights[component[v]];
    let mut order: Vec<(f64, usize)> = (0..part.len()).map(|v| (paths(v), component[v])).collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let most = order.len().div_ceil(PEELED);
    let (mut peeled, mut rest) = (ObjectSet::EMPTY, Vec::new());
    let mut count = 0;
    let mut beside = ObjectSet::EMPTY;
    for (_, v) in order {
        if count == most || beside.contains(v) || !graph.blockers(v).is_disjoint(&peeled) {
            rest.push(v);
        } else {
            peeled.insert(v);
            beside.extend(graph.blockers(v));
            count += 1;
        }
    }
    (peeled, rest)
}
