//! A table on its way to an arrangement: what stands where, who still has to go, and who is in whose way.
//!
//! In: an arrangement to leave, one to reach, moves. Out: the dependency graph of the moment, kept up to date move
//! by move. Objects that may end anywhere take the first place that is in nobody's way as their end.

use crate::planning::buffers::Arrangement;
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::{Scene, Spot};
use crate::planning::trlb::Move;
use std::sync::Arc;

/// The state of a roll-out.
pub struct Table<'a> {
    /// The scene behind it.
    pub scene: &'a Scene<'a>,
    /// Where everything stands.
    pub now: Arrangement,
    /// Where everything is to end.
    pub ends: Arrangement,
    /// Objects that are not at their ends.
    pub remaining: ObjectSet,
    /// The moves that led here.
    pub moves: Vec<Move>,
    flexible: ObjectSet,
    blockers: Vec<ObjectSet>,
}

impl<'a> Table<'a> {
    /// Nothing moved yet. Objects of `flexible` may also end elsewhere than `ends` says.
    pub fn new(scene: &'a Scene<'a>, from: &Arrangement, ends: &Arrangement, flexible: ObjectSet) -> Table<'a> {
        let remaining: ObjectSet =
            scene.movable.iter().copied().filter(|&o| from[o].pose != ends[o].pose).collect();
        let blockers = (0..from.len())
            .map(|i| {
                let others = remaining.without(i).iter();
                let stands = |&j: &usize| !scene.clear(&ends[i], &from[j]);
                if remaining.contains(i) { others.filter(stands).collect() } else { ObjectSet::EMPTY }
            })
            .collect();
        let (now, ends) = (from.clone(), ends.clone());
        Table { scene, now, ends, remaining, moves: Vec::new(), flexible, blockers }
    }

    /// Who stands where the object is to end.
    pub fn blockers(&self, object: usize) -> ObjectSet {
        self.blockers[object]
    }

    /// Objects that can go to their ends at once.
    pub fn free_to_go(&self) -> ObjectSet {
        self.remaining.iter().filter(|&o| self.blockers[o].is_empty()).collect()
    }

    /// Arc i -> j: j stands where i is to end.
    pub fn graph(&self) -> DependencyGraph {
        DependencyGraph::from_blockers(self.blockers.clone())
    }

    /// Everything that has to reach its end before `object` can, if the objects of `aside` are thought away.
    pub fn before(&self, object: usize, aside: ObjectSet) -> ObjectSet {
        let mut seen = self.blockers[object] - aside;
        let mut fringe = seen;
        while let Some(v) = fringe.smallest() {
            fringe.remove(v);
            let new = (self.blockers[v] - aside) - seen;
            seen = seen | new;
            fringe = fringe | new;
        }
        seen
    }

    /// Other objects that still have to go where `spot` would be in the way.
    pub fn blocked_by(&self, object: usize, spot: &Spot) -> ObjectSet {
        let others = self.remaining.without(object).iter();
        others.filter(|&i| !self.scene.clear(&self.ends[i], spot)).collect()
    }

    /// Moves the object to its end.
    pub fn send_home(&mut self, object: usize) {
        self.put(object, self.ends[object].clone());
    }

    /// Moves the object.
    pub fn put(&mut self, object: usize, spot: Arc<Spot>) {
        let blocked = self.blocked_by(object, &spot);
        if blocked.is_empty() && self.flexible.contains(object) {
            self.ends[object] = spot.clone();
        }
        for i in self.remaining.without(object) {
            if blocked.contains(i) {
                self.blockers[i].insert(object);
            } else {
                self.blockers[i].remove(object);
            }
        }
        let from = std::mem::replace(&mut self.now[object], spot.clone());
        if spot.pose == self.ends[object].pose {
            self.remaining.remove(object);
            self.blockers[object] = ObjectSet::EMPTY;
        } else if !self.remaining.contains(object) {
            self.remaining.insert(object);
            self.blockers[object] = self.standing_at(object, &self.ends[object]) & self.remaining;
        }
        self.moves.push(Move { object, from, to: spot });
    }

    /// Other movable objects that stand in the way of `object` at `spot`.
    pub fn standing_at(&self, object: usize, spot: &Spot) -> ObjectSet {
        let others = self.scene.movable.iter().copied().filter(|&o| o != object);
        others.filter(|&o| !self.scene.clear(spot, &self.now[o])).collect()
    }

    /// Nobody stands in the way of `object` at `spot`.
    pub fn is_free(&self, object: usize, spot: &Spot) -> bool {
        let mut others = self.scene.movable.iter().filter(|&&o| o != object);
        others.all(|&o| self.scene.clear(spot, &self.now[o]))
    }
}
