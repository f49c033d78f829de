//! A feedback vertex set, with what is proved of it.

use crate::planning::object_set::ObjectSet;

/// A feedback vertex set and what is known about it.
#[derive(Clone, Debug, PartialEq)]
pub struct FeedbackSet {
    /// The vertices; removing them leaves no cycle.
    pub vertices: ObjectSet,
    /// Their total weight.
    pub weight: f64,
    /// No feedback vertex set weighs less; equal to `weight` when the search was completed.
    pub lower_bound: f64,
    /// Nodes the search spent.
    pub nodes: u64,
}

impl FeedbackSet {
    /// No set is cheaper, but for the rounding of sums.
    pub fn is_minimum(&self) -> bool {
        self.lower_bound >= self.weight * (1.0 - 1e-9)
    }
}
