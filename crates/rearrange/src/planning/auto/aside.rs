//! What the choice of objects to be put aside goes by, wherever a roll-out makes it.
//!
//! In: the number of vertices of a dependency graph. Out: how long the cheapest feedback vertex set is
//! looked for, and the weights by which one set is preferred to another. Roll-outs, stops and contests price
//! alike only as long as they share these.

use crate::planning::effort::Watch;
use crate::planning::feedback;
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::ObjectSet;

/// Nodes of the search for a feedback vertex set: enough for a proof on the tables that the paper has.
const NODE_LIMIT: u64 = 20_000;

/// Vertices up to which the cheapest set is searched for: as many as a machine word has bits. Of more a
/// proof may take seconds, and a step of a roll-out is to take less than milliseconds.
const FEW: usize = 64;

/// The cheapest feedback vertex set, or a cheap one of a large graph.
pub fn feedback_set(graph: &DependencyGraph, weights: &[f64], watch: &mut Watch) -> ObjectSet {
    if graph.len() <= FEW {
        return feedback::minimum_within(graph, weights, NODE_LIMIT, watch).vertices;
    }
    feedback::large::approximate(graph, weights, watch)
}

/// Weight of a move that is not to be put aside, in moves.
pub const STEADFAST: f64 = 30.0;

/// Weights are changed by this share to choose among sets of equal cost.
pub const NUDGE: f64 = 1e-7;
