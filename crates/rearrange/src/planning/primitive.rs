//! Primitive plans of minimum running buffer: which object goes home or makes way, in which order.
//!
//! In: a dependency graph, an integer buffer weight and a cost for each object, random numbers. Out: steps
//! "object to goal" and "object to buffer", without poses. Depth-first dynamic programming (DFDP) over the
//! sets of objects at their goals: the running buffer limit grows until a set of all objects can be reached.
//! Source: the paper, sections TRLB and ETRLB. Deviations: an object whose goal is open goes home at once
//! (never worse for peak or count: it can only leave a buffer); the limit grows to the next value at which
//! anything changes instead of by one; among plans of that peak fewer (cheaper) buffered objects are
//! preferred until a fixed number of nodes is spent, unless [`Preference::FirstFound`] selects the paper's
//! first find.

use crate::planning::effort::{Effort, Watch};
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::ObjectSet;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::collections::HashMap;

/// Nodes spent on one limit before it counts as too small. Far above what the public instances need; it
/// keeps a pathological component from stopping the search (the peak is then no longer proved minimal).
const NODES_PER_LIMIT: u64 = 50_000;

/// Nodes spent on fewer buffered objects once the first plan of a component is there.
const NODES_FOR_FEWER: u64 = 2_000;

/// Objects sent home one after the other below which the search does not go: each takes stack.
const DEEPEST: usize = 1_000;

/// Where a step takes its object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// To its goal.
    Goal,
    /// To a place of its own choice, out of the way.
    Buffer,
}

/// One move of a primitive plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Vertex of the dependency graph.
    pub object: usize,
    /// Goal or buffer.
    pub target: Target,
}

/// Which of the plans of minimum peak is returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preference {
    /// The one with the smallest total cost of buffered objects found within a fixed number of nodes.
    FewerBuffers,
    /// The first one met in the seed's order, as the paper's code does.
    FirstFound,
}

/// What a running-buffer search needs to know of the objects.
pub struct RunningBuffer<'a> {
    /// Who blocks whom.
    pub graph: &'a DependencyGraph,
    /// Space an object takes in the buffer; all 1 for RBM.
    pub weights: &'a [u32],
    /// Cost of one more move of an object; orders plans of the same peak.
    pub costs: &'a [f64],
    /// Which of them is taken.
    pub preference: Preference,
}

impl RunningBuffer<'_> {
    /// A primitive plan for all objects of the graph, component by component; None if `effort` ran out.
    pub fn plan(&self, rng: &mut ChaCha8Rng, effort: &mut Effort) -> Option<Vec<Step>> {
        let mut order: Vec<usize> = (0..self.graph.len()).collect();
        order.shuffle(rng);
        let mut steps = Vec::new();
        for component in self.graph.components(&order) {
            steps.extend(self.plan_component(&component, rng, effort)?.steps);
        }
        Some(steps)
    }

    /// The plan of one strongly connected component, as if all other objects were out of the way.
    pub fn plan_component(
        &self,
        component: &[usize],
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Option<ComponentPlan> {
        let all: ObjectSet = component.iter().copied().collect();
        let mut order = component.to_vec();
        order.shuffle(rng);
        let mut limit = 0;
        loop {
            let mut search = Search::new(self, all.clone(), &order, limit);
            let complete = search.descend(State::default(), effort);
            if let Some(best) = search.best {
                return Some(best);
            }
            if effort.is_over() {
                return None;
            }
            // After a cut search small increments would repeat the same failure many times.
            let after_cut = if complete { 0 } else { limit + limit / 8 + 1 };
            limit = search.next_limit.max(after_cut);
        }
    }
}

/// A component's plan and its two measures.
#[derive(Clone, Debug, PartialEq)]
pub struct ComponentPlan {
    /// The steps in order.
    pub steps: Vec<Step>,
    /// Largest total weight in buffers at one time.
    pub peak: u32,
    /// Total cost of the objects that go through a buffer.
    pub cost: f64,
}

/// Objects at home, objects in buffers, and what the latter have cost on the way here.
#[derive(Clone, Default)]
struct State {
    home: ObjectSet,
    parked: ObjectSet,
    cost: f64,
    peak: u32,
}

/// An object that could go home next.
struct Successor {
    /// Who.
    object: usize,
    /// The blockers that would have to make way first.
    parked: ObjectSet,
    /// What parking them costs.
    cost: f64,
}

struct Search<'a> {
    buffer: &'a RunningBuffer<'a>,
    all: ObjectSet,
    order: &'a [usize],
    limit: u32,
    /// The smallest peak above the limit that a step would have had.
    next_limit: u32,
    /// Sets at home, with the cost from which on they need not be entered again.
    seen: HashMap<ObjectSet, f64>,
    path: Vec<Step>,
    nodes: u64,
    depth: usize,
    best: Option<ComponentPlan>,
}

impl<'a> Search<'a> {
    fn new(buffer: &'a RunningBuffer<'a>, all: ObjectSet, order: &'a [usize], limit: u32) -> Search<'a> {
        Search {
            buffer,
            all,
            order,
            limit,
            next_limit: u32::MAX,
            seen: HashMap::new(),
            path: Vec::new(),
            nodes: NODES_PER_LIMIT,
            depth: 0,
            best: None,
        }
    }

    /// Explores everything below `state`; false if nodes or effort ran out first, or nothing better is
    /// wanted.
    fn descend(&mut self, mut state: State, effort: &mut Effort) -> bool {
        let mark = self.path.len();
        self.send_home_what_can_go(&mut state, effort.watch());
        let complete = self.descend_settled(state, effort);
        self.path.truncate(mark);
        complete
    }

    fn descend_settled(&mut self, state: State, effort: &mut Effort) -> bool {
        if state.home == self.all {
            return self.accept(state);
        }
        if self.seen.get(&state.home).is_some_and(|&cost| cost <= state.cost) {
            return true;
        }
        if self.nodes == 0 || self.depth == DEEPEST || !effort.step() {
            return false;
        }
        self.nodes -= 1;
        self.depth += 1;
        let complete = self.descend_children(&state, effort);
        self.depth -= 1;
        if !complete {
            return false;
        }
        // Exhausted before any plan was known means dead, whatever was paid on the way here.
        let dead = if self.best.is_none() { f64::NEG_INFINITY } else { state.cost };
        self.seen.insert(state.home, dead);
        true
    }

    fn descend_children(&mut self, state: &State, effort: &mut Effort) -> bool {
        for Successor { object, parked, cost } in self.children(state) {
            if self.best.as_ref().is_some_and(|best| state.cost + cost >= best.cost) {
                continue;
            }
            let steps = parked.len() + 1;
            let child = self.enter(state, object, &parked, cost);
            if !self.descend(child, effort) {
                return false;
            }
            self.path.truncate(self.path.len() - steps);
        }
        true
    }

    /// Records a complete plan; false when the search should end with it.
    fn accept(&mut self, state: State) -> bool {
        if self.best.is_none() {
            self.nodes = self.nodes.min(NODES_FOR_FEWER);
        }
        if self.best.as_ref().is_none_or(|best| state.cost < best.cost) {
            self.best = Some(ComponentPlan { steps: self.path.clone(), peak: state.peak, cost: state.cost });
        }
        self.buffer.preference == Preference::FewerBuffers
    }

    fn send_home_what_can_go(&mut self, state: &mut State, watch: &mut Watch) {
        let mut going = true;
        while going && watch.go_on(self.order.len() as u64) {
            going = false;
            for &object in self.order {
                let open = self.blockers(object).is_subset(&(&state.home | &state.parked));
                if open && !state.home.contains(object) {
                    state.home.insert(object);
                    state.parked.remove(object);
                    self.path.push(Step { object, target: Target::Goal });
                    going = true;
                }
            }
        }
    }

    fn blockers(&self, object: usize) -> ObjectSet {
        self.buffer.graph.blockers(object) & &self.all
    }

    /// Objects that could go home next, with the blockers that would have to make way and their cost, those
    /// within the limit only; cheapest first if fewer buffers are preferred, else in the seed's order.
    fn children(&mut self, state: &State) -> Vec<Successor> {
        let mut children = Vec::new();
        for &object in self.order {
            if state.home.contains(object) {
                continue;
            }
            let parked = self.blockers(object) - &state.home - &state.parked;
            let peak = (&state.parked | &parked).weight(self.buffer.weights);
            if peak > self.limit {
                self.next_limit = self.next_limit.min(peak);
                continue;
            }
            let cost = parked.weight(self.buffer.costs);
            children.push(Successor { object, parked, cost });
        }
        if self.buffer.preference == Preference::FewerBuffers {
            children.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        }
        children
    }

    /// Parks `parked`, then sends `object` home.
    fn enter(&mut self, state: &State, object: usize, parked: &ObjectSet, cost: f64) -> State {
        for &blocker in self.order.iter().filter(|&&o| parked.contains(o)) {
            self.path.push(Step { object: blocker, target: Target::Buffer });
        }
        self.path.push(Step { object, target: Target::Goal });
        let in_buffers = &state.parked | parked;
        State {
            home: state.home.with(object),
            parked: in_buffers.without(object),
            cost: state.cost + cost,
            peak: state.peak.max(in_buffers.weight(self.buffer.weights)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use std::collections::BTreeSet;

    fn plan_all(
        graph: &DependencyGraph,
        weights: &[u32],
        preference: Preference,
        seed: u64,
    ) -> ComponentPlan {
        let costs = vec![1.0; graph.len()];
        let buffer = RunningBuffer { graph, weights, costs: &costs, preference };
        let all: Vec<usize> = (0..graph.len()).collect();
        let mut effort = Effort::new(None, &|| false);
        buffer.plan_component(&all, &mut ChaCha8Rng::seed_from_u64(seed), &mut effort).expect("no limit")
    }

    /// Replays a plan on the graph alone; returns its peak.
    fn replay(graph: &DependencyGraph, weights: &[u32], steps: &[Step]) -> u32 {
        let (mut home, mut parked, mut peak) = (ObjectSet::EMPTY, ObjectSet::EMPTY, 0);
        for step in steps {
            match step.target {
                Target::Buffer => {
                    assert!(!home.contains(step.object) && !parked.contains(step.object));
                    parked.insert(step.object);
                    peak = peak.max(parked.weight(weights));
                }
                Target::Goal => {
                    assert!(graph.blockers(step.object).is_subset(&(&home | &parked)), "{step:?}");
                    home.insert(step.object);
                    parked.remove(step.object);
                }
            }
        }
        assert_eq!(home.len(), graph.len());
        peak
    }

    /// Minimum peak over every order of going home.
    fn brute_force_peak(
        graph: &DependencyGraph,
        weights: &[u32],
        home: &ObjectSet,
        parked: &ObjectSet,
    ) -> u32 {
        let rest = ObjectSet::first(graph.len()) - home;
        rest.iter()
            .map(|i| {
                let parked = parked | (graph.blockers(i) - home);
                let after = brute_force_peak(graph, weights, &home.with(i), &parked.without(i));
                parked.weight(weights).max(after)
            })
            .min()
            .unwrap_or(0)
    }

    #[test]
    fn the_peak_is_the_brute_force_minimum() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for case in 0..200 {
            let count = rng.random_range(1..7);
            let density = rng.random_range(0.1..0.8);
            let graph = DependencyGraph::from_fn(count, |_, _| rng.random_bool(density));
            let weights: Vec<u32> = (0..count).map(|_| rng.random_range(1..5)).collect();
            let plan = plan_all(&graph, &weights, Preference::FewerBuffers, case);
            assert_eq!(replay(&graph, &weights, &plan.steps), plan.peak);
            let wanted = brute_force_peak(&graph, &weights, &ObjectSet::EMPTY, &ObjectSet::EMPTY);
            assert_eq!(plan.peak, wanted, "case {case}: {graph:?}");
        }
    }

    #[test]
    fn fewer_buffers_are_preferred_at_the_same_peak() {
        // Two swaps that share object 0, which takes as much room as 1 and 2 together: parking 0, or 1 and
        // 2.
        let graph = DependencyGraph::from_fn(3, |i, j| (i == 0) != (j == 0));
        let costs = |preference| -> BTreeSet<u32> {
            (0..20).map(|seed| plan_all(&graph, &[2, 1, 1], preference, seed).cost as u32).collect()
        };
        assert_eq!(costs(Preference::FewerBuffers), BTreeSet::from([1]));
        assert_eq!(costs(Preference::FirstFound), BTreeSet::from([1, 2]));
    }

    #[test]
    fn seeds_give_different_plans_of_one_peak() {
        let graph = DependencyGraph::from_fn(8, |i, j| j == (i + 1) % 8 || j == (i + 3) % 8);
        let plans: Vec<ComponentPlan> =
            (0..20).map(|seed| plan_all(&graph, &[1; 8], Preference::FewerBuffers, seed)).collect();
        let peaks: BTreeSet<u32> = plans.iter().map(|plan| plan.peak).collect();
        assert_eq!(peaks.len(), 1);
        let orders: BTreeSet<Vec<usize>> =
            plans.iter().map(|plan| plan.steps.iter().map(|step| step.object).collect()).collect();
        assert!(orders.len() > 5, "only {} different plans", orders.len());
    }

    #[test]
    fn the_effort_ends_it() {
        let graph = DependencyGraph::from_fn(30, |i, j| (i * 7 + j * 13) % 5 < 2);
        let (weights, costs) = ([1; 30], [1.0; 30]);
        let buffer = RunningBuffer {
            graph: &graph,
            weights: &weights,
            costs: &costs,
            preference: Preference::FirstFound,
        };
        let mut effort = Effort::new(Some(3), &|| false);
        assert!(buffer.plan(&mut ChaCha8Rng::seed_from_u64(0), &mut effort).is_none());
    }
}
