//! A lower bound on every feedback vertex set, by packing cliques of partners and short cycles.
//!
//! In: a reduced graph and its weights. Out: a number no feedback vertex set can weigh less than. Each
//! clique of k mutual partners charges the smallest weight left in it to all its members and counts it k - 1
//! times; each cycle does the same and counts it once. No vertex is ever charged more than its weight, so
//! what was counted is a feasible solution of the linear programme's dual.

use crate::planning::effort::Watch;
use crate::planning::feedback::kernel::Kernel;
use crate::planning::object_set::Bits;

/// Passes over the vertices by growing cycle length; the last takes cycles of any length.
const CYCLE_LENGTHS: [usize; 3] = [3, 4, usize::MAX];

/// The bound; 0 for an acyclic graph.
pub fn lower_bound<const WORDS: usize>(kernel: &Kernel<WORDS>, weights: &[f64], watch: &mut Watch) -> f64 {
    dual(kernel, weights, watch).bound
}

/// A solution of the linear programme's dual.
pub struct Dual {
    /// Its value: no feedback vertex set weighs less.
    pub bound: f64,
    /// What is left of each vertex's weight: no feedback vertex set with vertex v weighs less than the bound
    /// and `left[v]`.
    pub left: Vec<f64>,
}

/// The bound and how far each vertex is from being part of it. Where `watch` ends the packing, what was
/// packed until then is a lower bound as well.
pub fn dual<const WORDS: usize>(kernel: &Kernel<WORDS>, weights: &[f64], watch: &mut Watch) -> Dual {
    let mut packing = Packing { kernel, left: weights.to_vec(), active: kernel.alive(), bound: 0.0 };
    packing.pack_cliques(watch);
    for longest in CYCLE_LENGTHS {
        packing.pack_cycles(longest, watch);
    }
    Dual { bound: packing.bound, left: packing.left }
}

struct Packing<'a, const WORDS: usize> {
    kernel: &'a Kernel<WORDS>,
    left: Vec<f64>,
    active: Bits<WORDS>,
    bound: f64,
}

impl<const WORDS: usize> Packing<'_, WORDS> {
    /// Charges the smallest weight left among `members` to each of them; it counts `times` in the bound.
    fn charge(&mut self, members: Bits<WORDS>, times: usize) {
        let least = members.iter().map(|v| self.left[v]).fold(f64::INFINITY, f64::min);
        self.bound += times as f64 * least;
        for v in members {
            self.left[v] -= least;
            if self.left[v] <= 0.0 {
                self.active.remove(v);
            }
        }
    }

    fn pack_cliques(&mut self, watch: &mut Watch) {
        while watch.go_on(2 * self.kernel.ticks_of_a_pass()) {
            let partners = |v: usize| self.kernel.partners(v) & self.active;
            let seed = self.active.iter().max_by_key(|&v| partners(v).len());
            let Some(seed) = seed.filter(|&v| !partners(v).is_empty()) else { return };
            let mut clique = Bits::EMPTY.with(seed);
            let mut candidates = partners(seed);
            while let Some(v) = candidates.iter().max_by_key(|&v| (partners(v) & candidates).len()) {
                clique.insert(v);
                candidates = candidates & partners(v);
            }
            self.charge(clique, clique.len() - 1);
        }
    }

    fn pack_cycles(&mut self, longest: usize, watch: &mut Watch) {
        for v in self.active {
            while self.active.contains(v) {
                if !watch.go_on(self.kernel.ticks_of_a_pass()) {
                    return;
                }
                let Some(cycle) = self.shortest_cycle(v, longest) else { break };
                self.charge(cycle, 1);
            }
        }
    }

    /// A shortest cycle through `v` among active vertices, of at most `longest` vertices.
    fn shortest_cycle(&self, v: usize, longest: usize) -> Option<Bits<WORDS>> {
        let back = self.kernel.into(v) & self.active;
        let mut layers = vec![Bits::EMPTY.with(v)];
        let mut seen = layers[0];
        while layers.len() < longest {
            let last = layers[layers.len() - 1];
            let next = last.iter().fold(Bits::EMPTY, |set, u| set | self.kernel.out(u));
            let next = (next & self.active) - seen;
            if next.is_empty() {
                return None;
            }
            seen = seen | next;
            layers.push(next);
            if let Some(end) = (next & back).smallest() {
                return Some(self.trace_back(&layers, end));
            }
        }
        None
    }

    fn trace_back(&self, layers: &[Bits<WORDS>], end: usize) -> Bits<WORDS> {
        let mut cycle = Bits::EMPTY.with(end);
        let mut at = end;
        for layer in layers[..layers.len() - 1].iter().rev() {
            if let Some(u) = (self.kernel.into(at) & *layer).smallest() {
                cycle.insert(u);
                at = u;
            }
        }
        cycle
    }
}
