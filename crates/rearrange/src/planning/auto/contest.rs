//! A place for an object where others are: which one costs the least, all things considered.
//!
//! In: a table on which the object finds no free place. Out: a place, who has to leave it first, and what
//! has to be put aside after that. A place is priced by what must still follow: a move for each object
//! displaced, two if it was at its end already, and the feedback vertex set of what remains, so that
//! displacing objects that have to be put aside anyway costs nothing. Many places are priced roughly, the
//! best of them by that bound.

use crate::planning::auto::aside::feedback_set;
use crate::planning::auto::parking;
use crate::planning::auto::table::Table;
use crate::planning::effort::{Effort, Watch};
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::Spot;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Places priced roughly.
const PLACES: usize = 150;

/// Places priced by the bound.
const CONTENDERS: usize = 10;

/// The question.
pub struct Contest<'a> {
    /// The table.
    pub table: &'a Table<'a>,
    /// Cost of a move of each object.
    pub costs: &'a [f64],
    /// What putting a vertex aside counts when a set is chosen.
    pub weights: Vec<f64>,
    /// Who is to be parked.
    pub object: usize,
    /// Others that have to be put aside anyway.
    pub others: ObjectSet,
}

/// The answer.
pub struct Contested {
    /// The place.
    pub spot: Arc<Spot>,
    /// The objects that are there.
    pub displaced: ObjectSet,
    /// The displaced, and who else has to be put aside then.
    pub aside: ObjectSet,
}

/// A place priced roughly.
struct Candidate {
    /// What must still follow, in the unit of the costs, roughly.
    price: f64,
    /// The place.
    spot: Arc<Spot>,
    /// The objects that are there.
    displaced: ObjectSet,
}

impl Contest<'_> {
    /// A place after which little must follow, no more than `most`; mostly the cheapest found.
    pub fn cheapest(&self, most: f64, rng: &mut ChaCha8Rng, effort: &mut Effort) -> Option<Contested> {
        let mut places = self.places(rng, effort);
        places.sort_by(|a, b| a.price.total_cmp(&b.price));
        // One place for each set of displaced objects: places beside each other would crowd out all others.
        let mut seen: Vec<ObjectSet> = Vec::new();
        places.retain(|place| {
            let new = !seen.contains(&place.displaced);
            seen.push(place.displaced.clone());
            new
        });
        let priced = places.into_iter().take(CONTENDERS).map(|Candidate { spot, displaced, .. }| {
            let (price, aside) = self.price(&spot, &displaced, effort.watch());
            (price, Contested { spot, displaced, aside })
        });
        let mut affordable: Vec<(f64, Contested)> = priced.filter(|(price, _)| *price <= most).collect();
        affordable.sort_by(|a, b| a.0.total_cmp(&b.0));
        // The displaced may find no room: the cheapest place is not always one that can be had.
        let chosen = if rng.random_bool(0.6) { 0 } else { rng.random_range(0..affordable.len().max(1)) };
        affordable.into_iter().nth(chosen).map(|(_, contested)| contested)
    }

    /// Places with a rough price.
    fn places(&self, rng: &mut ChaCha8Rng, effort: &mut Effort) -> Vec<Candidate> {
        let (table, scene) = (self.table, self.table.scene);
        let before = table.before(self.object, &self.others);
        let mut places = Vec::new();
        for _ in 0..PLACES {
            if !effort.step() {
                break;
            }
            let Some(spot) = parking::propose(scene, self.object, rng) else { continue };
            if !scene.admissible(&spot) {
                continue;
            }
            let displaced = table.standing_at(self.object, &spot);
            // Free places that cost no more than these have been looked for already.
            if displaced.is_empty() {
                continue;
            }
            let closing = (table.blocked_by(self.object, &spot) & &before).weight(self.costs);
            let area: f64 = displaced.iter().map(|o| scene.problem.objects[o].footprint.area()).sum();
            let price = (self.rough(&displaced) + closing + 0.5 * area) * rng.random_range(1.0..2.5);
            places.push(Candidate { price, spot, displaced });
        }
        places
    }

    fn rough(&self, displaced: &ObjectSet) -> f64 {
        let home = displaced - &self.table.remaining;
        let willing = 0.7 * (displaced & &self.others).weight(self.costs);
        displaced.weight(self.costs) + home.weight(self.costs) - willing
    }

    /// What must follow once the displaced are parked and the object is at the place, in all, and who is
    /// aside then.
    fn price(&self, spot: &Spot, displaced: &ObjectSet, watch: &mut Watch) -> (f64, ObjectSet) {
        let table = self.table;
        let blocked = table.blocked_by(self.object, spot);
        let blockers = |i: usize| {
            let waits = table.remaining.contains(i) && !displaced.contains(i);
            let rest = if waits { table.blockers(i) - displaced } else { ObjectSet::EMPTY };
            if waits && blocked.contains(i) { rest.with(self.object) } else { rest.without(self.object) }
        };
        let graph = DependencyGraph::from_blockers((0..table.ends.len()).map(blockers).collect());
        let set = feedback_set(&graph, &self.weights, watch);
        let home = displaced - &table.remaining;
        let moves = displaced.weight(self.costs) + home.weight(self.costs) + self.costs[self.object];
        (table.remaining.weight(self.costs) + moves + set.weight(self.costs), set | displaced)
    }
}
