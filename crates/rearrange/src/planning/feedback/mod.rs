//! Minimum weight feedback vertex set: the cheapest objects that have to make way a second time.
//!
//! In: a dependency graph, a positive weight for each vertex, a watch. Out: a vertex set whose removal
//! leaves no cycle, proved cheapest, or, when the node limit or the caller ends the search, the best one
//! found with a valid lower bound. Branch and bound on bitsets: `kernel` shrinks a graph without changing
//! its optimum, `packing` bounds from below by cliques and cycles, `search` branches, splits into
//! components, and keeps what the bound shows to be too dear (reduced cost fixing); `large` takes graphs of
//! more vertices than the bitsets hold apart first. Source: the reductions are those of Levy and Low (1988)
//! and Lin and Jou (2000), with the side conditions that weights need.

pub mod kernel;

pub mod large;

pub mod packing;

mod search;
mod set;

pub use set::FeedbackSet;

use crate::planning::effort::Watch;
use crate::planning::feedback::search::search;
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::Bits;

/// Nodes after which the search gives up its claim of optimality; the public graphs need far fewer.
const NODE_LIMIT: u64 = 2_000_000;

/// The same for graphs of more than 64 vertices, whose nodes take about ten times as long.
const NODE_LIMIT_OF_MANY: u64 = 5_000;

/// The minimum weight feedback vertex set of `graph`; `weights` are positive and finite, one a vertex.
pub fn minimum(graph: &DependencyGraph, weights: &[f64], watch: &mut Watch) -> FeedbackSet {
    let few = graph.len() <= Bits::<1>::CAPACITY;
    minimum_within(graph, weights, if few { NODE_LIMIT } else { NODE_LIMIT_OF_MANY }, watch)
}

/// As [`minimum`], giving up the proof after `node_limit` nodes of the search.
pub fn minimum_within(
    graph: &DependencyGraph,
    weights: &[f64],
    node_limit: u64,
    watch: &mut Watch,
) -> FeedbackSet {
    // One word a set where that is enough: it is what the search spends its time on.
    if graph.len() <= Bits::<1>::CAPACITY {
        search::<1>(graph, weights, node_limit, watch)
    } else if graph.len() <= Bits::<4>::CAPACITY {
        search::<4>(graph, weights, node_limit, watch)
    } else {
        large::by_components(graph, weights, node_limit, watch)
    }
}

#[cfg(test)]
mod tests;
