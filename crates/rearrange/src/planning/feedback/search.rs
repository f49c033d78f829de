//! Branch and bound for a minimum weight feedback vertex set, on bitsets of a width that fits the graph.

use crate::planning::effort::Watch;
use crate::planning::feedback::kernel::Kernel;
use crate::planning::feedback::packing;
use crate::planning::feedback::set::FeedbackSet;
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::{Bits, ObjectSet};

/// Nested decisions after which a graph of more than 256 vertices is given up: each takes stack.
const DEEPEST: usize = 600;

/// Two sums of weights closer than this, relative to the total weight, are the same.
const RELATIVE_TOLERANCE: f64 = 1e-12;

/// The set that the search begins with.
pub(super) fn greedy<const WORDS: usize>(
    graph: &DependencyGraph,
    weights: &[f64],
    watch: &mut Watch,
) -> ObjectSet {
    let mut search = Search { weights, nodes_left: 0, depth: 0, tolerance: 0.0, watch };
    search.greedy(Kernel::<WORDS>::new(graph)).into()
}

pub(super) fn search<const WORDS: usize>(
    graph: &DependencyGraph,
    weights: &[f64],
    node_limit: u64,
    watch: &mut Watch,
) -> FeedbackSet {
    let root = Kernel::<WORDS>::new(graph);
    let tolerance = RELATIVE_TOLERANCE * weights.iter().sum::<f64>();
    let mut search = Search { weights, nodes_left: node_limit, depth: 0, tolerance, watch };
    let mut reduced = root.clone();
    let forced = reduced.reduce(weights, search.watch);
    let floor = forced.weight(weights) + packing::lower_bound(&reduced, weights, search.watch);
    let greedy = search.greedy(root.clone());
    let ceiling = greedy.weight(weights);
    let found = search.solve(root, ceiling);
    let vertices = ObjectSet::from(found.unwrap_or(greedy));
    let weight = vertices.weight(weights);
    let proved = search.nodes_left > 0 && !search.watch.is_stopped();
    let lower_bound = if proved { weight } else { floor.min(weight) };
    FeedbackSet { vertices, weight, lower_bound, nodes: node_limit - search.nodes_left }
}

struct Search<'a, 'w> {
    weights: &'a [f64],
    nodes_left: u64,
    /// Nested decisions.
    depth: usize,
    tolerance: f64,
    watch: &'a mut Watch<'w>,
}

impl Search<'_, '_> {
    /// A feedback vertex set by taking, again and again, the vertex on most paths for its weight; what the
    /// watch leaves undecided is taken as a whole.
    fn greedy<const WORDS: usize>(&mut self, mut kernel: Kernel<WORDS>) -> Bits<WORDS> {
        let mut taken = kernel.reduce(self.weights, self.watch);
        while let Some(v) = kernel.busiest(self.weights) {
            if self.watch.is_stopped() {
                return taken | kernel.alive();
            }
            kernel.take(v);
            taken = taken.with(v) | kernel.reduce(self.weights, self.watch);
        }
        taken
    }

    /// The cheapest feedback vertex set that weighs less than `ceiling`, if there is one.
    fn solve<const WORDS: usize>(&mut self, mut kernel: Kernel<WORDS>, ceiling: f64) -> Option<Bits<WORDS>> {
        if self.depth == DEEPEST {
            self.nodes_left = 0;
        }
        if self.nodes_left == 0 || self.watch.is_stopped() {
            return None;
        }
        self.nodes_left -= 1;
        let forced = kernel.reduce(self.weights, self.watch);
        let paid = forced.weight(self.weights);
        if paid >= ceiling - self.tolerance {
            return None;
        }
        self.depth += 1;
        let rest = self.solve_reduced(kernel, ceiling - paid);
        self.depth -= 1;
        Some(forced | rest?)
    }

    fn solve_reduced<const WORDS: usize>(
        &mut self,
        kernel: Kernel<WORDS>,
        ceiling: f64,
    ) -> Option<Bits<WORDS>> {
        let components = kernel.components(self.watch)?;
        if components.len() > 1 {
            return self.solve_components(&kernel, &components, ceiling);
        }
        let Some(v) = kernel.busiest(self.weights) else { return Some(Bits::EMPTY) };
        let dual = packing::dual(&kernel, self.weights, self.watch);
        let slack = ceiling - self.tolerance - dual.bound;
        if slack <= 0.0 {
            return None;
        }
        let too_dear: Vec<usize> = kernel.alive().iter().filter(|&u| dual.left[u] >= slack).collect();
        if !too_dear.is_empty() {
            return self.solve_without(kernel, &too_dear, ceiling);
        }
        let mut best = None;
        let mut ceiling = ceiling;
        let mut taken = kernel.clone();
        taken.take(v);
        if let Some(set) = self.solve(taken, ceiling - self.weights[v]) {
            let set = set.with(v);
            ceiling = set.weight(self.weights);
            best = Some(set);
        }
        let mut kept = kernel;
        kept.keep(v);
        self.solve(kept, ceiling).or(best)
    }

    /// No set with one of `too_dear` weighs less than the ceiling, so all of these are kept.
    fn solve_without<const WORDS: usize>(
        &mut self,
        mut kernel: Kernel<WORDS>,
        too_dear: &[usize],
        ceiling: f64,
    ) -> Option<Bits<WORDS>> {
        for &v in too_dear {
            if kernel.out(v).contains(v) {
                // A cycle of kept vertices closes here.
                return None;
            }
            kernel.keep(v);
        }
        self.solve(kernel, ceiling)
    }

    /// Components are independent: each gets what the bounds of the others leave of the ceiling.
    fn solve_components<const WORDS: usize>(
        &mut self,
        kernel: &Kernel<WORDS>,
        parts: &[Bits<WORDS>],
        ceiling: f64,
    ) -> Option<Bits<WORDS>> {
        let bounded = |part: &Bits<WORDS>| {
            let part = kernel.restricted(*part);
            let bound = packing::lower_bound(&part, self.weights, self.watch);
            (part, bound)
        };
        let mut parts: Vec<(Kernel<WORDS>, f64)> = parts.iter().map(bounded).collect();
        parts.sort_by_key(|(part, _)| part.alive().len());
        let mut expected: f64 = parts.iter().map(|(_, bound)| bound).sum();
        let mut all = Bits::EMPTY;
        for (part, bound) in parts {
            expected -= bound;
            let left = ceiling - all.weight(self.weights) - expected;
            all = all | self.solve(part, left)?;
        }
        Some(all)
    }
}
