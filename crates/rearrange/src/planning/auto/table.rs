//! A table on its way to an arrangement: what is where, what still has to go, and what blocks what.
//!
//! In: an arrangement to leave, one to reach, moves. Out: the dependency graph of the moment, kept up to
//! date move by move. A vertex is a move that has to be made: that of an object to its end, or, after these
//! in number, to a stop that was planned on its way. What waits for an object to go away waits for its stop,
//! what waits for the stop to be free again waits for its end: so what is at a place that a large object
//! needs leaves in time, and what belongs there stays away. Objects that may end anywhere take the first
//! place that is in no object's way.

use crate::planning::buffers::Arrangement;
use crate::planning::effort::Watch;
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::{Scene, Spot};
use crate::planning::trlb::Move;
use std::sync::Arc;

/// The state of a roll-out.
pub struct Table<'a> {
    /// The scene behind it.
    pub scene: &'a Scene<'a>,
    /// Where everything is.
    pub now: Arrangement,
    /// Where each vertex leads.
    pub ends: Vec<Arc<Spot>>,
    /// Vertices that are still to come.
    pub remaining: ObjectSet,
    /// The moves that led here.
    pub moves: Vec<Move>,
    flexible: ObjectSet,
    blockers: Vec<ObjectSet>,
    /// Whose move each vertex is.
    owner: Vec<usize>,
    /// The next vertex of each object.
    next: Vec<usize>,
}

impl<'a> Table<'a> {
    /// Nothing moved yet. Objects of `flexible` may also end elsewhere than `ends` says. None where `watch`
    /// ends the work.
    pub fn new(
        scene: &'a Scene<'a>,
        from: &Arrangement,
        ends: &Arrangement,
        flexible: ObjectSet,
        watch: &mut Watch,
    ) -> Option<Table<'a>> {
        let remaining: ObjectSet =
            scene.movable.iter().copied().filter(|&o| from[o].pose != ends[o].pose).collect();
        let blockers_of = |i: usize| {
            if !remaining.contains(i) {
                return Some(ObjectSet::EMPTY);
            }
            let others = remaining.iter().filter(|&j| j != i);
            let row = || others.filter(|&j| !scene.clear(&ends[i], &from[j])).collect();
            watch.go_on(scene.row_ticks()).then(row)
        };
        let blockers: Option<Vec<ObjectSet>> = (0..from.len()).map(blockers_of).collect();
        let blockers = blockers?;
        let all: Vec<usize> = (0..from.len()).collect();
        let (now, ends) = (from.clone(), ends.clone());
        Some(Table {
            scene,
            now,
            ends,
            remaining,
            moves: Vec::new(),
            flexible,
            blockers,
            owner: all.clone(),
            next: all,
        })
    }

    /// The vertices that have to come before this one.
    pub fn blockers(&self, vertex: usize) -> &ObjectSet {
        &self.blockers[vertex]
    }

    /// Whose move a vertex is.
    pub fn owner(&self, vertex: usize) -> usize {
        self.owner[vertex]
    }

    /// Is the vertex a stop, or the end of an object that has a stop before it?
    pub fn is_planned(&self, vertex: usize) -> bool {
        vertex >= self.now.len() || self.next[vertex] != vertex
    }

    /// Vertices that can be made at once.
    pub fn free_to_go(&self) -> ObjectSet {
        self.remaining.iter().filter(|&o| self.blockers[o].is_empty()).collect()
    }

    /// Arc i -> j: j has to come before i.
    pub fn graph(&self) -> DependencyGraph {
        DependencyGraph::from_blockers(self.blockers.clone())
    }

    /// Everything that has to come before `vertex`, if the vertices of `aside` are thought away.
    pub fn before(&self, vertex: usize, aside: &ObjectSet) -> ObjectSet {
        let mut seen = &self.blockers[vertex] - aside;
        let mut fringe: Vec<usize> = seen.iter().collect();
        while let Some(v) = fringe.pop() {
            for new in self.blockers[v].iter().filter(|&u| !aside.contains(u)) {
                if !seen.contains(new) {
                    seen.insert(new);
                    fringe.push(new);
                }
            }
        }
        seen
    }

    /// Vertices of other objects that still have to lead where `spot` would be in the way.
    pub fn blocked_by(&self, object: usize, spot: &Spot) -> ObjectSet {
        let others = self.remaining.iter().filter(|&i| self.owner[i] != object);
        others.filter(|&i| !self.scene.clear(&self.ends[i], spot)).collect()
    }

    /// Makes the vertex's move; false, and a stop is given up, if another object came to be there.
    pub fn follow(&mut self, vertex: usize) -> bool {
        let object = self.owner[vertex];
        if !self.is_free(object, &self.ends[vertex]) {
            self.give_up_stop(object);
            return false;
        }
        self.put(object, self.ends[vertex].clone());
        true
    }

    /// Moves the object; a stop that was planned for it is past, or given up.
    pub fn put(&mut self, object: usize, spot: Arc<Spot>) {
        let blocked = self.blocked_by(object, &spot);
        if blocked.is_empty() && self.flexible.contains(object) {
            self.ends[object] = spot.clone();
        }
        self.forget_stop(object);
        self.block(object, &blocked);
        let from = std::mem::replace(&mut self.now[object], spot.clone());
        if spot.pose == self.ends[object].pose {
            self.remaining.remove(object);
            self.blockers[object] = ObjectSet::EMPTY;
        } else if !self.remaining.contains(object) {
            self.remaining.insert(object);
            self.blockers[object] = self.waiting_for(&self.standing_at(object, &self.ends[object]));
        }
        self.moves.push(Move { object, from, to: spot });
    }

    /// Plans that the object goes to `spot` before its end; false where an object at its end is there.
    pub fn plan_stop(&mut self, object: usize, spot: Arc<Spot>) -> bool {
        let vertex = self.ends.len();
        let standing = self.standing_at(object, &spot);
        let fits = self.remaining.contains(object) && !self.is_planned(object);
        if !fits || !standing.is_subset(&self.remaining) {
            return false;
        }
        let blocked = self.blocked_by(object, &spot);
        for i in self.remaining.iter().filter(|&i| i != object) {
            if self.blockers[i].contains(object) {
                self.blockers[i].insert(vertex);
            }
        }
        self.block(object, &blocked);
        self.blockers.push(self.waiting_for(&standing));
        self.blockers[object].insert(vertex);
        self.ends.push(spot);
        self.owner.push(object);
        self.next[object] = vertex;
        self.remaining.insert(vertex);
        true
    }

    /// The object goes to its end without the stop planned.
    pub fn give_up_stop(&mut self, object: usize) {
        self.forget_stop(object);
        let blocked = self.blocked_by(object, &self.now[object]);
        self.block(object, &blocked);
    }

    fn forget_stop(&mut self, object: usize) {
        let stop = std::mem::replace(&mut self.next[object], object);
        if stop != object {
            self.remaining.remove(stop);
            self.blockers.iter_mut().for_each(|set| set.remove(stop));
            self.blockers[stop] = ObjectSet::EMPTY;
        }
    }

    /// Exactly the vertices of `blocked` wait for the object's end.
    fn block(&mut self, object: usize, blocked: &ObjectSet) {
        for i in self.remaining.iter().filter(|&i| i != object) {
            if blocked.contains(i) {
                self.blockers[i].insert(object);
            } else {
                self.blockers[i].remove(object);
            }
        }
    }

    /// The vertices that take these objects away.
    fn waiting_for(&self, standing: &ObjectSet) -> ObjectSet {
        standing.iter().map(|o| self.next[o]).collect()
    }

    /// Other movable objects that are in the way of `object` at `spot`.
    pub fn standing_at(&self, object: usize, spot: &Spot) -> ObjectSet {
        let others = self.scene.movable.iter().copied().filter(|&o| o != object);
        others.filter(|&o| !self.scene.clear(spot, &self.now[o])).collect()
    }

    /// No object is in the way of `object` at `spot`.
    pub fn is_free(&self, object: usize, spot: &Spot) -> bool {
        let mut others = self.scene.movable.iter().filter(|&&o| o != object);
        others.all(|&o| self.scene.clear(spot, &self.now[o]))
    }
}
