//! A stronger lower bound where the table has no room: what it costs at least to put an object aside.
//!
//! In: a scene, the cost of a move of each object, steps to spend. Out: a number no valid plan is cheaper
//! than, which grows with the steps. The feedback vertex set assumes that an object put aside finds a place.
//! Here, for one object after the other, every pose it could first be put aside at is covered by boxes of
//! positions and angles. All poses of a box have a core in common, the footprint shrunk by what position and
//! angle may differ; who meets that core at his start has to leave before, who meets it at his goal has to
//! wait, and the feedback vertex set of the graph with the stop in it bounds every plan that stops there.
//! The box of the lowest bound is halved until it is too small or the lowest bound is high enough. As the
//! boxes cover every pose and every angle, and a second stop of the same object is allowed to cost its move
//! alone, nothing is sampled or assumed.
//!
//! The objects looked at are a small set X of large ones without which every feedback vertex set costs more.
//! Then either no object of X is put aside, and the set has to do without them; or one of X is put aside
//! first. That one alone, and then the others of X move once; or another one later, and then that one still
//! was at its start. The cheapest of these cases is a bound, whatever X is.

use crate::geometry::collision::{Placed, overhang};
use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::planning::bound::Parts;
use crate::planning::effort::{Effort, Watch};
use crate::planning::feedback;
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::Scene;
use std::collections::{BinaryHeap, HashMap};
use std::f64::consts::{FRAC_PI_2, PI};

/// The core is this much smaller than it has to be, m: far more than rounding.
const MARGIN_M: f64 = 1e-6;

/// Boxes whose poses differ by less, as a share of the core's radius, are not halved any more.
const FINEST: f64 = 0.02;

/// Boxes for one object.
const MOST_BOXES: usize = 60_000;

/// Steps that a box counts for.
const STEPS_OF_A_BOX: u64 = 16;

/// Nodes of the first search for the feedback vertex set of the whole problem, where the bound that it
/// begins with is not exact; each search has twice as many as the one before.
const FIRST_EXACT: u64 = 10_000;

/// Nodes of the longest of these searches.
const LONGEST_EXACT: u64 = 10_000_000;

/// Steps that one of these nodes counts for.
const STEPS_OF_A_NODE: u64 = 16;

/// Sets X that are tried.
const MOST_SETS: usize = 40;

/// Nodes of each search for a feedback vertex set.
fn node_limit(vertices: usize) -> u64 {
    if vertices <= 64 { 5_000 } else { 500 }
}

/// The proof as far as it has come.
pub struct BufferSpaceBound<'a> {
    scene: &'a Scene<'a>,
    costs: &'a [f64],
    parts: Parts,
    /// No plan is cheaper.
    pub value: f64,
    /// Who is looked at, and who of them still has to be.
    set: ObjectSet,
    waiting: ObjectSet,
    cover: Option<Cover>,
    /// What plans cost at least that put the first of the set aside, by set and first.
    prices: HashMap<(ObjectSet, usize), f64>,
    /// Who is known to cost no more than the bound.
    cheap: ObjectSet,
    sets_left: usize,
    slack: f64,
    /// The bound that the cycles give will not get better.
    settled: bool,
    /// Nodes of the next search for the exact feedback vertex set, and the steps saved for it.
    next_exact: u64,
    saved: u64,
}

impl<'a> BufferSpaceBound<'a> {
    /// The bound without anything proved about room. `costs` are positive; `parts` are those of the scene.
    pub fn new(
        scene: &'a Scene<'a>,
        costs: &'a [f64],
        parts: Parts,
        watch: &mut Watch,
    ) -> BufferSpaceBound<'a> {
        let value = parts.bound().value;
        let slack = 1e-9 * costs.iter().sum::<f64>();
        let mut proof = BufferSpaceBound {
            scene,
            costs,
            parts,
            value,
            set: ObjectSet::EMPTY,
            waiting: ObjectSet::EMPTY,
            cover: None,
            prices: HashMap::new(),
            cheap: ObjectSet::EMPTY,
            sets_left: MOST_SETS,
            slack,
            settled: false,
            next_exact: FIRST_EXACT,
            saved: 0,
        };
        proof.settled = proof.parts.is_exact;
        if proof.settled {
            proof.choose(watch);
        }
        proof
    }

    /// Goes on until the effort is spent, or nothing more can be proved. `enough`: the cost of a plan that
    /// is known.
    pub fn work(&mut self, enough: f64, effort: &mut Effort) {
        while self.value < (1.0 - 1e-9) * enough && !self.is_done() && !effort.is_over() {
            if !self.settled {
                if !self.work_on_cycles(effort) {
                    return;
                }
                continue;
            }
            let Some(first) = self.waiting.smallest() else {
                self.conclude(effort.watch());
                continue;
            };
            let known = self.prices.get(&(self.set.clone(), first)).copied();
            let Some(price) = known.or_else(|| self.price_of(first, enough, effort)) else { return };
            self.prices.insert((self.set.clone(), first), price);
            self.waiting.remove(first);
            if price <= self.value + self.slack {
                self.cheap.insert(first);
                self.choose(effort.watch());
            }
        }
    }

    /// Is there nothing more to prove?
    pub fn is_done(&self) -> bool {
        self.set.is_empty() && self.settled
    }

    /// Searches once more for the feedback vertex set that the bound began without, for longer than before;
    /// false while there are too few steps for that, which are saved then.
    fn work_on_cycles(&mut self, effort: &mut Effort) -> bool {
        while self.saved < STEPS_OF_A_NODE * self.next_exact {
            if !effort.step() {
                return false;
            }
            self.saved += 1;
        }
        let found = feedback::minimum_within(&self.parts.graph, self.costs, self.next_exact, effort.watch());
        if effort.is_over() {
            return false;
        }
        self.parts.cycle_cost = self.parts.cycle_cost.max(found.lower_bound);
        self.value = self.value.max(self.parts.bound().value);
        (self.saved, self.next_exact) = (0, 2 * self.next_exact);
        self.settled = found.is_minimum() || self.next_exact > LONGEST_EXACT;
        if self.settled {
            self.choose(effort.watch());
        }
        true
    }

    /// None when the effort is spent before it is known.
    fn price_of(&mut self, first: usize, enough: f64, effort: &mut Effort) -> Option<f64> {
        let mut cover = self.cover.take().unwrap_or_else(|| Cover::new(self, first));
        loop {
            if let Some(price) = cover.price(enough) {
                return Some(price);
            }
            if !(0..STEPS_OF_A_BOX).all(|_| effort.step()) {
                self.cover = Some(cover);
                return None;
            }
            cover.halve_the_cheapest(self, effort.watch());
        }
    }

    /// Takes the largest object of a cheapest feedback vertex set without those taken, until such a set
    /// costs more.
    fn choose(&mut self, watch: &mut Watch) {
        (self.set, self.waiting) = (ObjectSet::EMPTY, ObjectSet::EMPTY);
        if self.sets_left == 0 {
            return;
        }
        self.sets_left -= 1;
        let area = |o: &usize| self.scene.problem.objects[*o].footprint.area();
        let mut set = ObjectSet::EMPTY;
        while self.without(&set, watch) <= self.value + self.slack {
            let weights = self.weights(&set, self.costs.len());
            let cheapest =
                feedback::minimum_within(&self.parts.graph, &weights, node_limit(weights.len()), watch)
                    .vertices;
            if watch.is_stopped() {
                return;
            }
            let candidates = cheapest - &set - &self.cheap;
            let Some(largest) = candidates.iter().max_by(|a, b| area(a).total_cmp(&area(b))) else { return };
            set.insert(largest);
        }
        (self.set, self.waiting) = (set.clone(), set);
    }

    /// All of the set are dear: so is every plan.
    fn conclude(&mut self, watch: &mut Watch) {
        let prices = self.set.iter().filter_map(|o| self.prices.get(&(self.set.clone(), o)));
        let least = prices.copied().fold(self.without(&self.set, watch), f64::min);
        // Without end: there is no plan at all. That result needs a reason, which this is not.
        if least.is_finite() {
            self.value = self.value.max(least);
            self.choose(watch);
        } else {
            (self.set, self.waiting) = (ObjectSet::EMPTY, ObjectSet::EMPTY);
        }
    }

    /// What plans cost at least that put no object of the set aside.
    fn without(&self, set: &ObjectSet, watch: &mut Watch) -> f64 {
        self.parts.required_cost + self.feedback(&self.parts.graph, set, watch)
    }

    fn weights(&self, kept: &ObjectSet, count: usize) -> Vec<f64> {
        let forbidden = self.forbidden();
        (0..count).map(|v| if kept.contains(v) { forbidden } else { self.costs[v] }).collect()
    }

    /// More than all others together.
    fn forbidden(&self) -> f64 {
        4.0 * self.costs.iter().sum::<f64>() + 1.0
    }

    /// Weight of the cheapest feedback vertex set without any of `kept`; infinite if there is none.
    fn feedback(&self, graph: &DependencyGraph, kept: &ObjectSet, watch: &mut Watch) -> f64 {
        let weights = self.weights(kept, graph.len());
        let least = feedback::minimum_within(graph, &weights, node_limit(weights.len()), watch).lower_bound;
        if least >= self.forbidden() { f64::INFINITY } else { least }
    }
}

/// Poses of an object: all that differ from the middle by no more than the reach.
#[derive(Clone)]
struct PoseBox {
    middle: Pose2,
    /// In x, y (m) and angle (rad).
    reach: [f64; 3],
    /// Who is met at his start, at all poses.
    starts: ObjectSet,
    /// Who is met at his goal, at all poses.
    goals: ObjectSet,
    price: f64,
    /// How far the poses differ, m.
    spread: f64,
}

/// The cheapest first, and the smallest of these: where there is room after all, it is soon found.
impl Ord for PoseBox {
    fn cmp(&self, other: &PoseBox) -> std::cmp::Ordering {
        other.price.total_cmp(&self.price).then(other.spread.total_cmp(&self.spread))
    }
}

impl PartialOrd for PoseBox {
    fn partial_cmp(&self, other: &PoseBox) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for PoseBox {
    fn eq(&self, other: &PoseBox) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for PoseBox {}

/// All poses that an object could first be put aside at.
struct Cover {
    object: usize,
    /// Those whose goal is as near to the object's as no object may be elsewhere: they wait for nothing.
    given: ObjectSet,
    finest: f64,
    boxes: BinaryHeap<PoseBox>,
    seen: usize,
    /// Prices by who is met at start and goal.
    known: HashMap<(ObjectSet, ObjectSet), f64>,
}

impl Cover {
    fn new(proof: &BufferSpaceBound, object: usize) -> Cover {
        let problem = proof.scene.problem;
        let (width, height) = (problem.workspace.width, problem.workspace.height);
        let turn = half_turn(&problem.objects[object].footprint);
        let all = PoseBox {
            middle: Pose2::new(width / 2.0, height / 2.0, 0.0),
            reach: [width / 2.0, height / 2.0, turn],
            starts: ObjectSet::EMPTY,
            goals: ObjectSet::EMPTY,
            price: 0.0,
            spread: f64::INFINITY,
        };
        let scene = proof.scene;
        let near = |other: usize| match (scene.goal(object), scene.goal(other)) {
            (Some(mine), Some(theirs)) => !scene.apart(mine, theirs),
            _ => false,
        };
        Cover {
            object,
            given: proof.parts.single.iter().filter(|&other| near(other)).collect(),
            finest: FINEST * Scene::core(&problem.objects[object].footprint),
            boxes: BinaryHeap::from([all]),
            seen: 0,
            known: HashMap::new(),
        }
    }

    /// What it costs at least to put the object aside, once that is known well enough.
    fn price(&self, enough: f64) -> Option<f64> {
        let Some(cheapest) = self.boxes.peek() else { return Some(f64::INFINITY) };
        let over = cheapest.price >= enough || cheapest.spread < self.finest || self.seen >= MOST_BOXES;
        over.then_some(cheapest.price)
    }

    fn halve_the_cheapest(&mut self, proof: &BufferSpaceBound, watch: &mut Watch) {
        let Some(parent) = self.boxes.pop() else { return };
        let radius = proof.scene.problem.objects[self.object].footprint.bounding_radius();
        let [x, y, turn] = parent.reach;
        let sizes = [x, y, radius * turn];
        let axis = (0..3).max_by(|&a, &b| sizes[a].total_cmp(&sizes[b])).unwrap_or(0);
        for side in [-0.5, 0.5] {
            let mut half = parent.clone();
            half.reach[axis] = parent.reach[axis] / 2.0;
            let by = side * parent.reach[axis];
            match axis {
                0 => half.middle.x += by,
                1 => half.middle.y += by,
                _ => half.middle.theta += by,
            }
            self.seen += 1;
            if self.look(&mut half, proof, watch) {
                self.boxes.push(half);
            }
        }
    }

    /// Finds who is met in the whole box, and its price; false if the object can be at none of its poses.
    fn look(&mut self, half: &mut PoseBox, proof: &BufferSpaceBound, watch: &mut Watch) -> bool {
        let (scene, problem) = (proof.scene, proof.scene.problem);
        let footprint = &problem.objects[self.object].footprint;
        half.spread = half.reach[0].hypot(half.reach[1]) + footprint.bounding_radius() * half.reach[2];
        let Some(core) = shrunk(footprint, half.spread + MARGIN_M) else { return true };
        let (width, height) = (problem.workspace.width, problem.workspace.height);
        if overhang(&core, &half.middle, width, height) > MARGIN_M {
            return false;
        }
        let placed = Placed::new(&core, half.middle);
        if scene.meets_what_stays(&placed) {
            return false;
        }
        for other in proof.parts.single.without(self.object) {
            if !half.starts.contains(other) && scene.meets(&placed, scene.start(other)) {
                half.starts.insert(other);
            }
            let open = !half.goals.contains(other) && !self.given.contains(other);
            let goal = scene.goal(other).filter(|_| open);
            if goal.is_some_and(|goal| scene.meets(&placed, goal)) {
                half.goals.insert(other);
            }
        }
        let met = (half.starts.clone(), half.goals.clone());
        let price = match self.known.get(&met) {
            Some(price) => *price,
            None => {
                let (starts, goals) = met.clone();
                let price = Stop { proof, object: self.object, starts, goals }.price(watch);
                self.known.insert(met, price);
                price
            }
        };
        half.price = half.price.max(price);
        half.price.is_finite()
    }
}

/// An object is put aside where it meets some at their starts and some at their goals.
struct Stop<'a> {
    proof: &'a BufferSpaceBound<'a>,
    object: usize,
    starts: ObjectSet,
    goals: ObjectSet,
}

impl Stop<'_> {
    /// What a plan costs at least in which the object's first move leads there, and no object of the set was
    /// put aside before: with one more move of the object or with more, with no other of the set put aside
    /// or with another one.
    fn price(&self, watch: &mut Watch) -> f64 {
        let proof = self.proof;
        let cost = proof.costs[self.object];
        let others = proof.set.without(self.object);
        // An object put aside later was at its start until then.
        let later = &others - &self.starts;
        let mut rest = |more: bool| {
            let alone = self.cycles(more, &others, None, watch);
            let kept = &others - &later;
            let with = |other: usize| proof.costs[other] + self.cycles(more, &kept, Some(other), watch);
            later.iter().map(with).fold(alone, f64::min)
        };
        let known = proof.parts.required_cost + self.forced();
        (known + cost + rest(false)).min(known + 2.0 * cost + rest(true))
    }

    /// Moves of those in the way who would not have to move otherwise: away, and back to where they belong.
    fn forced(&self) -> f64 {
        let proof = self.proof;
        let idle = self.starts.iter().filter(|&o| !proof.parts.required.contains(o));
        let back = |o: usize| if proof.scene.goal(o).is_some() { 2.0 } else { 1.0 };
        idle.map(|o| back(o) * proof.costs[o]).sum()
    }

    /// The feedback vertex set without `kept`, with the first move as a vertex of its own, and the second
    /// one if there are `more`; `gone` is put aside anyway.
    fn cycles(&self, more: bool, kept: &ObjectSet, gone: Option<usize>, watch: &mut Watch) -> f64 {
        let (parts, object, count) = (&self.proof.parts, self.object, self.proof.costs.len());
        let (first, second) = (count, count + 1);
        // Who comes after the object has left the place again.
        let left = if more { second } else { object };
        let required = &parts.required;
        let blockers = |i: usize| {
            if i == first {
                return (&self.starts & required).without(object);
            }
            if i == second {
                return if more { ObjectSet::EMPTY.with(first) } else { ObjectSet::EMPTY };
            }
            let mut set = parts.graph.blockers(i).clone();
            if i == object {
                return set.with(if more { second } else { first });
            }
            if !required.contains(i) {
                return ObjectSet::EMPTY;
            }
            if set.contains(object) {
                set = set.without(object).with(first);
            }
            if self.goals.contains(i) { set.with(left) } else { set }
        };
        let graph = DependencyGraph::from_blockers((0..count + 2).map(blockers).collect());
        let graph = match gone {
            Some(gone) => graph.restricted(&ObjectSet::first(count + 2).without(gone)),
            None => graph,
        };
        self.proof.feedback(&graph, &kept.with(object).with(first).with(second), watch)
    }
}

/// Half of the angles after which the footprint looks the same.
fn half_turn(footprint: &Footprint) -> f64 {
    match footprint {
        Footprint::Disc { .. } => 0.0,
        Footprint::Rectangle { length, width } if length == width => FRAC_PI_2 / 2.0,
        Footprint::Rectangle { .. } | Footprint::Ellipse { .. } => FRAC_PI_2,
        Footprint::Polygon(_) => PI,
    }
}

/// A shape within the footprint that is `by` away from all of its outline; None if there is no simple one.
fn shrunk(footprint: &Footprint, by: f64) -> Option<Footprint> {
    let core = Scene::core(footprint);
    if core <= 1.01 * by {
        return None;
    }
    match footprint {
        Footprint::Disc { radius } => Footprint::disc(radius - by),
        Footprint::Rectangle { length, width } => Footprint::rectangle(length - 2.0 * by, width - 2.0 * by),
        // A convex shape holds its copy scaled by 1 - by / core, and round each point of that a disc of
        // radius `by`.
        Footprint::Ellipse { .. } => footprint.scaled(1.0 - by / core),
        Footprint::Polygon(polygon) if polygon.parts().len() == 1 => footprint.scaled(1.0 - by / core),
        Footprint::Polygon(_) => Footprint::disc(core - by),
    }
    .ok()
}

#[cfg(test)]
mod tests;
