//! A stop planned ahead: where an object is to be parked later, so that room is made and kept for it.
//!
//! In: a table, an object that has to be put aside. Out: the place after which the least must follow. What
//! is there has to go first, what belongs there waits until the object has left, and every cycle this closes
//! costs a feedback vertex: the place is priced by the minimum feedback vertex set of the graph with the
//! stop in it.

use crate::planning::auto::aside::{STEADFAST, feedback_set};
use crate::planning::auto::parking;
use crate::planning::auto::table::Table;
use crate::planning::effort::{Effort, Watch};
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::Spot;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Places compared by how many they concern.
const PLACES: usize = 60;

/// Places priced by the feedback vertex set.
const CONTENDERS: usize = 8;

/// The question.
pub struct Stop<'a> {
    /// The table.
    pub table: &'a Table<'a>,
    /// Cost of each vertex.
    pub costs: &'a [f64],
    /// What putting a vertex aside counts when a set is chosen.
    pub weights: Vec<f64>,
    /// Who is to stop.
    pub object: usize,
    /// Places known from before.
    pub hints: &'a [Arc<Spot>],
}

/// A place, which objects are there, and which vertices lead there.
struct Place {
    spot: Arc<Spot>,
    standing: ObjectSet,
    blocked: ObjectSet,
}

impl Stop<'_> {
    /// The place after which the least must follow, if that is no more than `most`.
    pub fn cheapest(&self, most: f64, rng: &mut ChaCha8Rng, effort: &mut Effort) -> Option<Arc<Spot>> {
        let mut places: Vec<Place> = self.hints.iter().filter_map(|spot| self.place(spot.clone())).collect();
        for _ in 0..PLACES {
            if !effort.step() {
                return None;
            }
            let spot = parking::propose(self.table.scene, self.object, rng);
            places.extend(spot.and_then(|spot| self.place(spot)));
        }
        let concerned = |place: &Place| place.standing.len() + place.blocked.len();
        places.sort_by_key(concerned);
        let priced = places.into_iter().take(CONTENDERS);
        let priced = priced.filter_map(|place| Some((self.price(&place, effort.watch())?, place.spot)));
        let best = priced.min_by(|a, b| a.0.total_cmp(&b.0));
        best.filter(|(price, _)| *price <= most).map(|(_, spot)| spot)
    }

    /// None where an object at its end, or something fixed, is in the way.
    fn place(&self, spot: Arc<Spot>) -> Option<Place> {
        let standing = self.table.standing_at(self.object, &spot);
        let possible = standing.is_subset(&self.table.remaining) && self.table.scene.admissible(&spot);
        possible.then(|| Place { standing, blocked: self.table.blocked_by(self.object, &spot), spot })
    }

    /// What must follow from here with the stop planned; None if that would have to be given up.
    fn price(&self, place: &Place, watch: &mut Watch) -> Option<f64> {
        let (table, object, stop) = (self.table, self.object, self.table.ends.len());
        let mut blockers: Vec<ObjectSet> = (0..stop)
            .map(|i| {
                let waits = table.blockers(i).clone();
                let waits = if waits.contains(object) { waits.with(stop).without(object) } else { waits };
                if place.blocked.contains(i) { waits.with(object) } else { waits }
            })
            .collect();
        blockers[object] = blockers[object].with(stop);
        blockers.push(place.standing.clone());
        let mut weights = self.weights.clone();
        weights[object] = STEADFAST * self.costs[object];
        weights.push(weights[object]);
        let graph = DependencyGraph::from_blockers(blockers);
        let set = feedback_set(&graph, &weights, watch);
        let kept = set.iter().all(|v| v != object && v != stop && !table.is_planned(v));
        kept.then(|| table.remaining.weight(self.costs) + self.costs[object] + set.weight(&weights))
    }
}
