//! What the choice of objects to be put aside goes by, wherever a roll-out makes it.
//!
//! In: the number of vertices of a dependency graph. Out: how long the cheapest feedback vertex set is
//! looked for, and the weights by which one set is preferred to another. Roll-outs, stops and contests price
//! alike only as long as they share these.

/// Nodes of the search for a feedback vertex set: enough for a proof on the tables that the paper has. Of
/// more vertices than a machine word holds a proof may take seconds, and a step of a roll-out is to take
/// less than milliseconds.
pub fn node_limit(vertices: usize) -> u64 {
    if vertices <= 64 { 20_000 } else { 500 }
}

/// Weight of a move that is not to be put aside, in moves.
pub const STEADFAST: f64 = 30.0;

/// Weights are changed by this share to choose among sets of equal cost.
pub const NUDGE: f64 = 1e-7;
