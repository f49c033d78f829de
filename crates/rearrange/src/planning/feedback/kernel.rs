//! A digraph that shrinks: the reductions of the feedback vertex set search.
//!
//! In: a dependency graph. Out: an equivalent smaller graph and the vertices that some cheapest set
//! contains. `take` puts a vertex into the set; `keep` decides against it, which joins its predecessors to
//! its successors (a vertex that thereby gets an arc to itself has to be taken).

use crate::planning::effort::Watch;
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::Bits;

/// A graph under reduction; vertices that are decided are no longer alive.
#[derive(Clone, Debug)]
pub struct Kernel<const WORDS: usize> {
    out: Vec<Bits<WORDS>>,
    into: Vec<Bits<WORDS>>,
    alive: Bits<WORDS>,
}

impl<const WORDS: usize> Kernel<WORDS> {
    /// The whole graph, nothing decided. It has at most as many vertices as the sets hold.
    pub fn new(graph: &DependencyGraph) -> Kernel<WORDS> {
        let mut kernel = Kernel {
            out: (0..graph.len()).map(|v| graph.blockers(v).bits()).collect(),
            into: vec![Bits::EMPTY; graph.len()],
            alive: Bits::first(graph.len()),
        };
        for (i, j) in graph.arcs() {
            kernel.into[j].insert(i);
        }
        kernel
    }

    /// Vertices not decided yet.
    pub fn alive(&self) -> Bits<WORDS> {
        self.alive
    }

    /// Vertices that `v` has an arc to.
    pub fn out(&self, v: usize) -> Bits<WORDS> {
        self.out[v]
    }

    /// Vertices that have an arc to `v`.
    pub fn into(&self, v: usize) -> Bits<WORDS> {
        self.into[v]
    }

    /// Vertices joined to `v` by arcs both ways: one of the two has to be taken.
    pub fn partners(&self, v: usize) -> Bits<WORDS> {
        self.out[v] & self.into[v]
    }

    /// Puts `v` into the feedback vertex set.
    pub fn take(&mut self, v: usize) {
        for u in self.into[v] {
            self.out[u].remove(v);
        }
        for u in self.out[v] {
            self.into[u].remove(v);
        }
        self.out[v] = Bits::EMPTY;
        self.into[v] = Bits::EMPTY;
        self.alive.remove(v);
    }

    /// Decides that `v` is not in the set: every path through it becomes an arc.
    pub fn keep(&mut self, v: usize) {
        let (before, after) = (self.into[v].without(v), self.out[v].without(v));
        self.take(v);
        for u in before {
            self.out[u] = self.out[u] | after;
        }
        for u in after {
            self.into[u] = self.into[u] | before;
        }
    }

    /// The part of the graph on `vertices`.
    pub fn restricted(&self, vertices: Bits<WORDS>) -> Kernel<WORDS> {
        let cut = |sets: &[Bits<WORDS>]| {
            let cut = |(v, set): (usize, &Bits<WORDS>)| {
                if vertices.contains(v) { *set & vertices } else { Bits::EMPTY }
            };
            sets.iter().enumerate().map(cut).collect()
        };
        Kernel { out: cut(&self.out), into: cut(&self.into), alive: self.alive & vertices }
    }

    /// Strongly connected components of what is alive; None if `watch` ends the search for them.
    pub fn components(&self, watch: &mut Watch) -> Option<Vec<Bits<WORDS>>> {
        components_of(self.alive, &self.out, &self.into, watch)
    }

    /// The vertex with the most paths through it for its weight; partners count double, as taking or keeping
    /// such a vertex decides them. None when nothing is alive.
    pub fn busiest(&self, weights: &[f64]) -> Option<usize> {
        let score = |v: usize| {
            let paths = self.out[v].len() * self.into[v].len() + 2 * self.partners(v).len();
            paths as f64 / weights[v]
        };
        self.alive.iter().max_by(|&a, &b| score(a).total_cmp(&score(b)).then(b.cmp(&a)))
    }

    /// Reduces as far as the rules go, or as `watch` lets them; returns the vertices that were taken.
    pub fn reduce(&mut self, weights: &[f64], watch: &mut Watch) -> Bits<WORDS> {
        let mut taken = Bits::EMPTY;
        loop {
            while watch.go_on(self.ticks_of_a_pass()) && self.reduce_vertices(weights, &mut taken) {}
            if !(self.drop_idle_arcs(watch) || self.drop_dominated_arcs(watch)) {
                return taken;
            }
        }
    }

    /// What it takes to look at every vertex once.
    pub fn ticks_of_a_pass(&self) -> u64 {
        (self.alive.len() * WORDS) as u64
    }

    /// One pass of the vertex rules; true if anything changed.
    fn reduce_vertices(&mut self, weights: &[f64], taken: &mut Bits<WORDS>) -> bool {
        let mut changed = false;
        for v in self.alive {
            if self.out[v].contains(v) {
                self.take(v);
                taken.insert(v);
            } else if self.out[v].is_empty() || self.into[v].is_empty() {
                self.take(v);
            } else if self.may_be_kept(v, weights) {
                self.keep(v);
            } else {
                continue;
            }
            changed = true;
        }
        changed
    }

    /// Some cheapest set does without `v`: all its cycles pass a vertex that is no heavier, or its
    /// neighbours are partners of each other, so that all but one are taken anyway, and v is the dearest of
    /// them.
    fn may_be_kept(&self, v: usize, weights: &[f64]) -> bool {
        let lone = |set: Bits<WORDS>| if set.len() == 1 { set.smallest() } else { None };
        if [self.into[v], self.out[v]].into_iter().filter_map(lone).any(|u| weights[u] <= weights[v]) {
            return true;
        }
        let partners = self.partners(v);
        partners == (self.out[v] | self.into[v])
            && partners
                .iter()
                .all(|u| weights[u] <= weights[v] && partners.without(u).is_subset(&self.partners(u)))
    }

    /// Drops one-way arcs that lie on no cycle of one-way arcs: every longer cycle over a two-way arc
    /// contains two partners, whose own cycle of two has to be broken anyway.
    fn drop_idle_arcs(&mut self, watch: &mut Watch) -> bool {
        let one_way_out: Vec<Bits<WORDS>> = (0..self.out.len()).map(|v| self.out[v] - self.into[v]).collect();
        let one_way_into: Vec<Bits<WORDS>> =
            (0..self.out.len()).map(|v| self.into[v] - self.out[v]).collect();
        let mut changed = false;
        for component in components_of(self.alive, &one_way_out, &one_way_into, watch).unwrap_or_default() {
            for v in component {
                for w in one_way_out[v] - component {
                    self.remove_arc(v, w);
                    changed = true;
                }
            }
        }
        changed
    }

    /// Drops a one-way arc u -> w when every one-way cycle over it has a shortcut past u or past w.
    fn drop_dominated_arcs(&mut self, watch: &mut Watch) -> bool {
        let mut changed = false;
        for u in self.alive {
            if !watch.go_on((self.out[u].len() * WORDS) as u64) {
                break;
            }
            for w in self.out[u] - self.into[u] {
                let before = self.into[u] - self.out[u];
                let after = self.out[w] - self.into[w];
                if before.is_subset(&self.into[w]) || after.is_subset(&self.out[u]) {
                    self.remove_arc(u, w);
                    changed = true;
                }
            }
        }
        changed
    }

    fn remove_arc(&mut self, from: usize, to: usize) {
        self.out[from].remove(to);
        self.into[to].remove(from);
    }
}

fn components_of<const WORDS: usize>(
    alive: Bits<WORDS>,
    out: &[Bits<WORDS>],
    into: &[Bits<WORDS>],
    watch: &mut Watch,
) -> Option<Vec<Bits<WORDS>>> {
    let mut rest = alive;
    let mut components = Vec::new();
    while let Some(v) = rest.smallest() {
        let (after, before) = (reach(v, out, rest), reach(v, into, rest));
        if !watch.go_on(((after.len() + before.len()) * WORDS) as u64) {
            return None;
        }
        let component = after & before;
        rest = rest - component;
        components.push(component);
    }
    Some(components)
}

fn reach<const WORDS: usize>(from: usize, arcs: &[Bits<WORDS>], within: Bits<WORDS>) -> Bits<WORDS> {
    let mut seen = Bits::EMPTY.with(from);
    let mut fringe = seen;
    while let Some(v) = fringe.smallest() {
        fringe.remove(v);
        let new = (arcs[v] & within) - seen;
        seen = seen | new;
        fringe = fringe | new;
    }
    seen
}
