//! One randomised way from an arrangement to another, given up as soon as it cannot be cheap enough.
//!
//! In: two arrangements, the cost of a move of each object, a ceiling. Out: moves that cost no more than the
//! ceiling. Whatever can go home goes; when nothing can, a member of a minimum feedback vertex set of the
//! objects in each other's way is parked (`parking`). What the remaining objects and that set must still
//! cost is a lower bound for all that can follow from here, and cuts. Where no member finds an ideal place,
//! sets without it are tried, then places that cost another move, then places that others have to leave
//! first.

use crate::planning::auto::aside::{NUDGE, STEADFAST, feedback_set};
use crate::planning::auto::contest::{Contest, Contested};
use crate::planning::auto::parking::{self, Care, Shapes, Wish};
use crate::planning::auto::stops::Stop;
use crate::planning::auto::table::Table;
use crate::planning::buffers::Arrangement;
use crate::planning::effort::{Effort, Watch};
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::{Scene, Spot};
use crate::planning::trlb::Move;
use rand::RngExt;
use rand::seq::{IndexedRandom, SliceRandom};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Feedback vertex sets tried before an object is parked at a price.
const SETS: usize = 3;

/// Stops planned in one roll-out.
const MOST_STOPS: usize = 4;

/// Where to, and at what price.
pub struct Task<'a> {
    /// The scene.
    pub scene: &'a Scene<'a>,
    /// Its outlines.
    pub shapes: &'a Shapes,
    /// Cost of a move of each object.
    pub costs: &'a [f64],
    /// Where everything is.
    pub from: &'a Arrangement,
    /// Where it is to go.
    pub to: &'a Arrangement,
    /// Objects that may also end elsewhere.
    pub flexible: ObjectSet,
    /// The most that the moves may cost.
    pub ceiling: f64,
}

/// How this roll-out goes about it.
pub struct Style {
    /// For the search for places.
    pub care: Care,
    /// From 0 to 3: objects with little are put aside rather than others, among sets of equal cost.
    pub bias: Vec<f64>,
    /// Places known for each object.
    pub hints: Vec<Vec<Arc<Spot>>>,
    /// Chance that an object that could go home is kept waiting.
    pub hold: f64,
    /// Stops planned from the beginning.
    pub stops: usize,
    /// May pay for places that cost another move.
    pub detours: bool,
}

/// The moves, if the roll-out got there.
pub fn roll_out(task: &Task, style: &Style, rng: &mut ChaCha8Rng, effort: &mut Effort) -> Option<Vec<Move>> {
    let table = Table::new(task.scene, task.from, task.to, task.flexible.clone(), effort.watch())?;
    let nudged = task.costs.iter().zip(&style.bias).map(|(cost, bias)| cost * (1.0 + NUDGE * bias)).collect();
    let slack = 1e-6 * task.costs.iter().sum::<f64>();
    let (costs, stops) = (task.costs.to_vec(), MOST_STOPS);
    RollOut { task, style, table, costs, nudged, stops, slack, spent: 0.0 }.run(rng, effort)
}

/// A place that closes cycles, for want of an ideal one.
struct Compromise {
    /// Objects that wait in these cycles.
    closing: usize,
    /// Who is parked there.
    object: usize,
    /// The place.
    spot: Arc<Spot>,
}

struct RollOut<'a> {
    task: &'a Task<'a>,
    style: &'a Style,
    table: Table<'a>,
    /// Cost of each vertex.
    costs: Vec<f64>,
    /// The same, changed a little.
    nudged: Vec<f64>,
    /// Stops that may still be planned.
    stops: usize,
    slack: f64,
    spent: f64,
}

impl RollOut<'_> {
    fn run(mut self, rng: &mut ChaCha8Rng, effort: &mut Effort) -> Option<Vec<Move>> {
        let most = 6 * self.table.now.len() + 20;
        for _ in 0..self.style.stops {
            self.plan_a_stop(rng, effort);
        }
        loop {
            if !self.go_home(rng, effort.watch()) {
                return None;
            }
            if self.table.remaining.is_empty() {
                return Some(self.table.moves);
            }
            if self.table.moves.len() > most || !effort.step() || !self.park(rng, effort) {
                return None;
            }
        }
    }

    fn pay(&mut self, object: usize, spot: Arc<Spot>) {
        self.spent += self.costs[object];
        self.table.put(object, spot);
    }

    /// Makes the vertex's move; false if an end is taken by an object that is at its own, so that it never
    /// comes free.
    fn follow(&mut self, vertex: usize) -> bool {
        let stop = vertex >= self.table.now.len();
        let done = self.table.follow(vertex);
        if done {
            self.spent += self.costs[vertex];
        }
        done || stop
    }

    /// Makes all moves that are open; false if one turns out to be impossible, or where `watch` ends the
    /// work.
    fn go_home(&mut self, rng: &mut ChaCha8Rng, watch: &mut Watch) -> bool {
        let mut held = ObjectSet::EMPTY;
        loop {
            let mut free: Vec<usize> = (self.table.free_to_go() - &held).iter().collect();
            if free.is_empty() {
                break;
            }
            free.shuffle(rng);
            for object in free {
                if !watch.go_on(2 * self.task.scene.row_ticks()) {
                    return false;
                }
                if self.style.hold > 0.0 && rng.random_bool(self.style.hold) {
                    held.insert(object);
                } else if !self.follow(object) {
                    return false;
                }
            }
        }
        // Held objects wait for a parked one only; where no object has to be parked, nothing would ever free
        // them.
        if !held.is_empty() && self.feedback(&ObjectSet::EMPTY, watch).is_empty() {
            while let Some(object) = self.table.free_to_go().smallest() {
                if !watch.go_on(2 * self.task.scene.row_ticks()) || !self.follow(object) {
                    return false;
                }
            }
        }
        true
    }

    /// What putting a vertex aside counts: an object with a stop planned is not to be parked elsewhere.
    fn weights(&self) -> Vec<f64> {
        let weight =
            |v: usize| if self.table.is_planned(v) { STEADFAST * self.costs[v] } else { self.nudged[v] };
        (0..self.costs.len()).map(weight).collect()
    }

    /// A cheapest set whose parking lets all others go home, avoiding `dear` where that costs nothing much.
    fn feedback(&self, dear: &ObjectSet, watch: &mut Watch) -> ObjectSet {
        let mut weights = self.weights();
        dear.iter().for_each(|o| weights[o] *= 4.0);
        feedback_set(&self.table.graph(), &weights, watch)
    }

    fn too_dear(&self, aside: &ObjectSet) -> bool {
        let rest = self.table.remaining.weight(&self.costs) + aside.weight(&self.costs);
        self.spent + rest > self.task.ceiling + self.slack
    }

    /// Parks one object; false when nothing affordable is left.
    fn park(&mut self, rng: &mut ChaCha8Rng, effort: &mut Effort) -> bool {
        let mut tried = ObjectSet::EMPTY;
        let mut compromises: Vec<Compromise> = Vec::new();
        for _ in 0..SETS {
            let aside = self.feedback(&tried, effort.watch());
            if self.too_dear(&aside) {
                // The first set is the cheapest there is.
                if tried.is_empty() {
                    return false;
                }
                break;
            }
            if let Some(vertex) = aside.iter().find(|&v| self.table.is_planned(v)) {
                self.table.give_up_stop(self.table.owner(vertex));
                return true;
            }
            for object in self.order(&aside - &tried, rng) {
                let wish = Wish {
                    object,
                    aside: aside.without(object),
                    reserved: None,
                    hints: &self.style.hints[object],
                };
                let found = parking::find(&self.table, self.task.shapes, &wish, self.style.care, rng, effort);
                if let Some(spot) = found.ideal {
                    self.pay(object, spot);
                    return true;
                }
                let compromise = found.compromise;
                compromises.extend(compromise.map(|(closing, spot)| Compromise { closing, object, spot }));
                if effort.is_over() {
                    return false;
                }
            }
            let new = !(&aside - &tried).is_empty();
            tried.extend(&aside);
            if !new {
                break;
            }
        }
        self.style.detours && self.park_at_a_price(compromises, rng, effort)
    }

    /// Those first whose absence lets another object go, mostly.
    fn order(&self, aside: ObjectSet, rng: &mut ChaCha8Rng) -> Vec<usize> {
        let mut order: Vec<usize> = aside.iter().collect();
        order.shuffle(rng);
        if rng.random_bool(0.6) {
            let blockers = self.table.remaining.iter().map(|i| self.table.blockers(i));
            let lone: ObjectSet = blockers.filter(|b| b.len() == 1).flatten().collect();
            order.sort_by_key(|&o| !lone.contains(o));
        }
        order
    }

    fn park_at_a_price(
        &mut self,
        compromises: Vec<Compromise>,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> bool {
        if rng.random_bool(0.5) && self.plan_a_stop(rng, effort) {
            return true;
        }
        let cheapest = compromises.into_iter().min_by_key(|compromise| compromise.closing);
        if rng.random_bool(0.5) && self.clear_a_place(rng, effort) {
            return true;
        }
        if let Some(Compromise { object, spot, .. }) = cheapest {
            self.pay(object, spot);
            return true;
        }
        self.clear_a_place(rng, effort)
    }

    /// Plans a stop for an object that has to be put aside anyway, the large ones rather than the small;
    /// false where that is not affordable.
    fn plan_a_stop(&mut self, rng: &mut ChaCha8Rng, effort: &mut Effort) -> bool {
        if self.stops == 0 {
            return false;
        }
        self.stops -= 1;
        let aside: Vec<usize> = self
            .feedback(&ObjectSet::EMPTY, effort.watch())
            .into_iter()
            .filter(|&v| !self.table.is_planned(v))
            .collect();
        let area = |o: &usize| self.task.scene.problem.objects[*o].footprint.area();
        let Ok(&object) = aside.choose_weighted(rng, area) else { return false };
        let (table, costs, hints) = (&self.table, &self.costs[..], &self.style.hints[object][..]);
        let choice = Stop { table, costs, weights: self.weights(), object, hints };
        let most = self.task.ceiling + self.slack - self.spent;
        let Some(spot) = choice.cheapest(most, rng, effort) else { return false };
        if !self.table.plan_stop(object, spot) {
            return false;
        }
        self.costs.push(self.costs[object]);
        self.nudged.push(self.nudged[object]);
        true
    }

    /// Parks an object where others have to make way first.
    fn clear_a_place(&mut self, rng: &mut ChaCha8Rng, effort: &mut Effort) -> bool {
        let aside = self.feedback(&ObjectSet::EMPTY, effort.watch());
        let mut order: Vec<usize> = aside.iter().collect();
        order.shuffle(rng);
        order.into_iter().take(2).any(|object| self.clear_a_place_for(object, &aside, rng, effort))
    }

    fn clear_a_place_for(
        &mut self,
        object: usize,
        aside: &ObjectSet,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> bool {
        let others = aside.without(object);
        let (table, costs) = (&self.table, &self.costs[..]);
        let contest = Contest { table, costs, weights: self.weights(), object, others };
        let most = self.task.ceiling + self.slack - self.spent;
        let Some(Contested { spot, displaced, aside }) = contest.cheapest(most, rng, effort) else {
            return false;
        };
        let reserved = (object, spot);
        let mut displaced: Vec<usize> = displaced.iter().collect();
        displaced.shuffle(rng);
        let mut moved = false;
        for other in displaced {
            let hints = &self.style.hints[other];
            let wish = Wish { object: other, aside: aside.without(other), reserved: Some(&reserved), hints };
            let found = parking::find(&self.table, self.task.shapes, &wish, self.style.care, rng, effort);
            let Some(place) = found.ideal.or(found.compromise.map(|(_, spot)| spot)) else { return moved };
            self.pay(other, place);
            moved = true;
        }
        if self.table.is_free(object, &reserved.1) {
            self.pay(object, reserved.1);
            moved = true;
        }
        moved
    }
}
