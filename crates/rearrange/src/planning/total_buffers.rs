//! Primitive plans of least total buffer weight: the cheapest objects make way once, all others go straight
//! home.
//!
//! In: a dependency graph, a positive weight for each object, random numbers. Out: steps "object to goal"
//! and "object to buffer", without poses. Component by component the minimum weight feedback vertex set says
//! who goes through a buffer; without these the graph has no cycle, so the others can follow its topological
//! order. Source: the paper, sections TRLB (TBM) and ETRLB (ETBM); the paper solves the feedback vertex set
//! by dynamic or integer programming, this is an exact branch and bound. Deviations: a component that is not
//! solved within `NODE_LIMIT` nodes takes the best set found; the paper leaves open when the objects of the
//! set make way, here each does as late, and goes home as early, as the order allows, so that few wait at
//! the same time.

use crate::planning::effort::{Effort, Watch};
use crate::planning::feedback;
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::ObjectSet;
use crate::planning::primitive::{Step, Target};
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Nodes of the feedback vertex set search for one component; no public graph at density 0.4 needs as many.
const NODE_LIMIT: u64 = 20_000;

/// The same for one of more than 64 objects, whose nodes take about ten times as long.
const NODE_LIMIT_OF_MANY: u64 = 2_000;

/// What a total-buffer search needs to know of the objects.
pub struct TotalBuffers<'a> {
    /// Who blocks whom.
    pub graph: &'a DependencyGraph,
    /// What one buffer stay of an object counts, positive; all 1 for TBM.
    pub weights: &'a [f64],
}

impl TotalBuffers<'_> {
    /// A primitive plan for all objects of the graph; None if `effort` ran out. Another state of `rng` gives
    /// another order and, where several sets are cheapest, may give another of them.
    pub fn plan(&self, rng: &mut ChaCha8Rng, effort: &mut Effort) -> Option<Vec<Step>> {
        let mut order: Vec<usize> = (0..self.graph.len()).collect();
        order.shuffle(rng);
        let mut steps = Vec::new();
        for mut component in self.graph.components(&order) {
            component.shuffle(rng);
            let making_way = self.feedback_set(&component, effort)?;
            steps.extend(Ordering::new(self, &component, making_way).run(rng, effort.watch())?);
        }
        Some(steps)
    }

    /// The cheapest set that breaks all cycles of the component. The search breaks ties by vertex number,
    /// and vertices are numbered in the component's (shuffled) order.
    fn feedback_set(&self, component: &[usize], effort: &mut Effort) -> Option<ObjectSet> {
        if component.len() == 1 {
            return Some(ObjectSet::EMPTY);
        }
        let graph = self.graph.part(component);
        let weights: Vec<f64> = component.iter().map(|&o| self.weights[o]).collect();
        let nodes = if component.len() <= 64 { NODE_LIMIT } else { NODE_LIMIT_OF_MANY };
        let found = feedback::minimum_within(&graph, &weights, nodes, effort.watch());
        for _ in 0..found.nodes {
            if !effort.step() {
                return None;
            }
        }
        Some(found.vertices.iter().map(|v| component[v]).collect())
    }
}

/// Puts the moves of one component in order, once it is known who makes way.
struct Ordering<'a> {
    plan: &'a TotalBuffers<'a>,
    objects: Vec<usize>,
    all: ObjectSet,
    making_way: ObjectSet,
    home: ObjectSet,
    parked: ObjectSet,
    steps: Vec<Step>,
}

impl<'a> Ordering<'a> {
    fn new(plan: &'a TotalBuffers<'a>, component: &[usize], making_way: ObjectSet) -> Ordering<'a> {
        Ordering {
            plan,
            objects: component.to_vec(),
            all: component.iter().copied().collect(),
            making_way,
            home: ObjectSet::EMPTY,
            parked: ObjectSet::EMPTY,
            steps: Vec::new(),
        }
    }

    fn run(mut self, rng: &mut ChaCha8Rng, watch: &mut Watch) -> Option<Vec<Step>> {
        while self.home != self.all {
            if !watch.go_on(self.objects.len() as u64) {
                return None;
            }
            self.objects.shuffle(rng);
            let open = self.objects.iter().copied().find(|&o| self.in_the_way(o).is_empty());
            // Without the objects that make way the rest has no cycle: some object is blocked by these
            // alone.
            let Some(next) = open.or_else(|| self.cheapest_to_open()) else { break };
            for blocker in self.in_the_way(next) {
                self.steps.push(Step { object: blocker, target: Target::Buffer });
                self.parked.insert(blocker);
            }
            self.steps.push(Step { object: next, target: Target::Goal });
            self.home.insert(next);
            self.parked.remove(next);
            self.objects.retain(|&o| o != next);
        }
        Some(self.steps)
    }

    /// Objects at their old place that block the goal of `object`.
    fn in_the_way(&self, object: usize) -> ObjectSet {
        (self.plan.graph.blockers(object) & &self.all) - &self.home - &self.parked
    }

    /// The object that can go home once the cheapest objects of the set have made way; first of these in the
    /// present (random) order.
    fn cheapest_to_open(&self) -> Option<usize> {
        let may_open = self.objects.iter().filter(|&&o| self.in_the_way(o).is_subset(&self.making_way));
        let cost = |o: usize| self.in_the_way(o).weight(self.plan.weights);
        may_open.copied().min_by(|&a, &b| cost(a).total_cmp(&cost(b)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use std::collections::BTreeSet;

    fn plan(graph: &DependencyGraph, weights: &[f64], seed: u64) -> Vec<Step> {
        let mut effort = Effort::new(None, &|| false);
        let buffers = TotalBuffers { graph, weights };
        buffers.plan(&mut ChaCha8Rng::seed_from_u64(seed), &mut effort).expect("no limit")
    }

    /// Replays a plan on the graph alone; returns who went through a buffer.
    fn replay(graph: &DependencyGraph, steps: &[Step]) -> ObjectSet {
        let (mut home, mut parked, mut ever) = (ObjectSet::EMPTY, ObjectSet::EMPTY, ObjectSet::EMPTY);
        for step in steps {
            assert!(!home.contains(step.object), "{step:?} after it went home");
            match step.target {
                Target::Buffer => {
                    assert!(!ever.contains(step.object), "{step:?} twice");
                    parked.insert(step.object);
                    ever.insert(step.object);
                }
                Target::Goal => {
                    assert!(graph.blockers(step.object).is_subset(&(&home | &parked)), "{step:?}");
                    home.insert(step.object);
                    parked.remove(step.object);
                }
            }
        }
        assert_eq!(home.len(), graph.len());
        ever
    }

    /// Least weight of objects that move twice, over every order of going home: who blocks makes way.
    fn brute_force(graph: &DependencyGraph, weights: &[f64], home: &ObjectSet, parked: &ObjectSet) -> f64 {
        let rest = ObjectSet::first(graph.len()) - home;
        rest.iter()
            .map(|i| {
                let new = graph.blockers(i) - home - parked;
                let after = brute_force(graph, weights, &home.with(i), &(parked | &new).without(i));
                new.weight(weights) + after
            })
            .min_by(f64::total_cmp)
            .unwrap_or(0.0)
    }

    #[test]
    fn the_buffered_weight_is_the_brute_force_minimum() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        for case in 0..200 {
            let count = rng.random_range(1..7);
            let density = rng.random_range(0.1..0.8);
            let graph = DependencyGraph::from_fn(count, |_, _| rng.random_bool(density));
            let weights: Vec<f64> = (0..count).map(|_| f64::from(rng.random_range(1..5u32))).collect();
            let buffered = replay(&graph, &plan(&graph, &weights, case)).weight(&weights);
            let wanted = brute_force(&graph, &weights, &ObjectSet::EMPTY, &ObjectSet::EMPTY);
            assert!((buffered - wanted).abs() < 1e-9, "case {case}: {buffered} not {wanted}; {graph:?}");
        }
    }

    #[test]
    fn weights_decide_who_makes_way() {
        // Two swaps that share object 0: parking 0 alone breaks both, unless it is dearer than 1 and 2.
        let graph = DependencyGraph::from_fn(3, |i, j| (i == 0) != (j == 0));
        for seed in 0..20 {
            assert_eq!(replay(&graph, &plan(&graph, &[1.0; 3], seed)), ObjectSet::EMPTY.with(0));
            let others: ObjectSet = [1, 2].into_iter().collect();
            assert_eq!(replay(&graph, &plan(&graph, &[9.0, 1.0, 1.0], seed)), others);
        }
    }

    #[test]
    fn seeds_vary_the_set_and_the_order() {
        // Four separate cycles of three: any object of each may make way.
        let graph = DependencyGraph::from_fn(12, |i, j| i / 3 == j / 3 && j == i / 3 * 3 + (i + 1) % 3);
        let plans: Vec<Vec<Step>> = (0..40).map(|seed| plan(&graph, &[1.0; 12], seed)).collect();
        let sets: BTreeSet<ObjectSet> = plans.iter().map(|steps| replay(&graph, steps)).collect();
        assert!(sets.iter().all(|set| set.len() == 4) && sets.len() > 10, "{} sets", sets.len());
        let orders: BTreeSet<Vec<usize>> =
            plans.iter().map(|steps| steps.iter().map(|step| step.object).collect()).collect();
        assert!(orders.len() > 30, "{} orders", orders.len());
    }

    #[test]
    fn no_object_makes_way_before_it_has_to() {
        // Six swaps (even, odd), every even object blocked by the next even one too: one component, six
        // buffers.
        let graph = DependencyGraph::from_fn(12, |i, j| i ^ 1 == j || (i % 2 == 0 && j == (i + 2) % 12));
        for seed in 0..20 {
            let (mut parked, mut most) = (ObjectSet::EMPTY, 0);
            let steps = plan(&graph, &[1.0; 12], seed);
            for step in &steps {
                match step.target {
                    Target::Buffer => parked.insert(step.object),
                    Target::Goal => parked.remove(step.object),
                }
                most = most.max(parked.len());
            }
            assert_eq!(replay(&graph, &steps).len(), 6);
            assert!(most <= 4, "seed {seed}: {most} at the same time");
        }
    }

    #[test]
    fn the_effort_ends_it() {
        let graph = DependencyGraph::from_fn(30, |i, j| (i * 7 + j * 13) % 5 < 2);
        let mut effort = Effort::new(Some(1), &|| false);
        let buffers = TotalBuffers { graph: &graph, weights: &[1.0; 30] };
        assert!(buffers.plan(&mut ChaCha8Rng::seed_from_u64(0), &mut effort).is_none());
    }
}
