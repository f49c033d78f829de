//! What the tree search knows of the table: every place an object ever had, by number, and which goals it
//! blocks.
//!
//! In: start and goal arrangement, objects to move. Out: a state's actions carried out: the object goes
//! home, or the object that really blocks it is put somewhere else. A state is one place number for each
//! object, so that two orders of the same moves lead to the same state. The collision check has the paper's
//! two steps (bounding discs, then shapes; `geometry::collision`), and the check of a goal is done once for
//! each new place.

use crate::planning::buffers::Arrangement;
use crate::planning::effort::{Effort, Watch};
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::{Scene, Spot};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Poses sampled for one relocation before it counts as impossible.
const SAMPLES: usize = 100;

/// Place numbers, one for each object of the problem.
pub(super) type State = [u32];

/// A pose that an object has or had.
struct Place {
    spot: Arc<Spot>,
    /// Objects that cannot go home while another object is here.
    blocks: ObjectSet,
}

/// All places so far.
pub(super) struct Table<'a> {
    scene: &'a Scene<'a>,
    places: Vec<Place>,
    /// Place number of every object's goal.
    goals: Vec<u32>,
}

impl<'a> Table<'a> {
    /// Numbers the starts and the goals. An object that starts at its goal has one place for both. None
    /// where `watch` ends the work.
    pub(super) fn new(
        scene: &'a Scene<'a>,
        start: &Arrangement,
        goal: &Arrangement,
        watch: &mut Watch,
    ) -> Option<Table<'a>> {
        let mut table = Table { scene, places: Vec::new(), goals: Vec::new() };
        for (object, spot) in start.iter().enumerate() {
            if !watch.go_on(scene.row_ticks()) {
                return None;
            }
            table.add(object, spot.clone(), goal);
        }
        for (object, spot) in goal.iter().enumerate() {
            if !watch.go_on(scene.row_ticks()) {
                return None;
            }
            let stays = spot.pose == start[object].pose;
            let place = if stays { object as u32 } else { table.add(object, spot.clone(), goal) };
            table.goals.push(place);
        }
        Some(table)
    }

    fn add(&mut self, object: usize, spot: Arc<Spot>, goal: &Arrangement) -> u32 {
        let movable = self.scene.movable.iter().copied();
        let blocks = movable.filter(|&o| o != object && !self.scene.clear(&goal[o], &spot)).collect();
        self.places.push(Place { spot, blocks });
        (self.places.len() - 1) as u32
    }

    /// The state at the start.
    pub(super) fn start(&self) -> Vec<u32> {
        (0..self.goals.len() as u32).collect()
    }

    /// Objects that are at their goals, x, y and angle.
    pub(super) fn home(&self, state: &State) -> ObjectSet {
        (0..state.len()).filter(|&o| state[o] == self.goals[o]).collect()
    }

    /// The spot behind a place number.
    pub(super) fn spot(&self, place: u32) -> &Arc<Spot> {
        &self.places[place as usize].spot
    }

    /// The action that serves `object`: it goes home if no object blocks its goal; else the nearest of those
    /// that do is put at a free random pose clear of that goal. Which object moves to which place; None if
    /// there is none.
    pub(super) fn act(
        &mut self,
        state: &State,
        object: usize,
        goal: &Arrangement,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Option<(usize, u32)> {
        let blocks = |o: usize| self.places[state[o] as usize].blocks.contains(object);
        let mut blocked = false;
        let mut nearest: Option<(f64, usize)> = None;
        for o in (0..state.len()).filter(|&o| o != object && blocks(o)) {
            blocked = true;
            let distance = self.spot(state[o]).pose.distance(&goal[object].pose);
            // At home no object blocks a goal; a fixed object that does leaves this action without effect.
            let movable = state[o] != self.goals[o];
            if movable && nearest.is_none_or(|(least, _)| distance < least) {
                nearest = Some((distance, o));
            }
        }
        if !blocked {
            return Some((object, self.goals[object]));
        }
        let (_, blocker) = nearest?;
        let spot = self.free_spot(state, blocker, &goal[object], rng, effort)?;
        Some((blocker, self.add(blocker, spot, goal)))
    }

    /// A random pose of `object` clear of everything on the table and of the goal to be opened.
    fn free_spot(
        &self,
        state: &State,
        object: usize,
        open: &Spot,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Option<Arc<Spot>> {
        for _ in 0..SAMPLES {
            if !effort.step() {
                return None;
            }
            let Some(spot) = self.scene.sample(object, rng) else { continue };
            let others = (0..state.len()).filter(|&o| o != object);
            let free = self.scene.clear(&spot, open)
                && others.into_iter().all(|o| self.scene.clear(&spot, self.spot(state[o])))
                && self.scene.admissible(&spot);
            if free {
                return Some(spot);
            }
        }
        None
    }
}
