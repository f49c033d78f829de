//! A way over a crowded table: everything is pressed away from one goal after the other.
//!
//! In: two arrangements. Out: moves from the one to the other, more than needed. Where free space lies about
//! in pieces too small for anything, a search over places to park has none to choose from. Here it is
//! gathered: an object that is not at its end yet is taken, and everything that is not at its end for good
//! is shifted, by steps of any size at any angle, as far as it will go from where that one is to end, until
//! no object is there. Of all these shifts only those are made that the one object needs, at once as far as
//! they go. It goes home and stays, and the next one is taken. Mostly these go from one side of the table to
//! the other, so that what is still loose keeps its room in one piece; large ones come before small ones
//! beside them. Shifts take long: the work may stop at any step.

use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::planning::auto::parking;
use crate::planning::buffers::Arrangement;
use crate::planning::effort::{Effort, Watch};
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::{Scene, Spot};
use crate::planning::trlb::{Move, tidy};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::sync::Arc;

/// Rounds over all objects to open one goal.
const ROUNDS: usize = 60;

/// Small steps tried for one object in one round.
const SHIFTS: usize = 30;

/// Poses anywhere on the table tried for one object in one round.
const JUMPS: usize = 10;

/// A step takes an object its own size far, or half as far, and so on to this number of halves.
const HALVINGS: i32 = 7;

/// How much more the side counts than the size when objects are put in order: the least and the most.
const SWEEP: (f64, f64) = (1.0, 10.0);

/// An object where none may be is worse than any object far off, m.
const IN_THE_WAY_M: f64 = 1e3;

/// How far it came.
pub enum Progress {
    /// There are the moves, all of them.
    Arrived(Vec<Move>),
    /// Some goal could not be opened.
    Stuck,
    /// The effort was spent before either was known.
    Interrupted,
}

/// Few moves from one arrangement to another; None if there are none to be had.
pub type Shortcut<'a> =
    dyn Fn(&Arrangement, &Arrangement, &mut ChaCha8Rng, &mut Effort) -> Option<Vec<Move>> + 'a;

/// A table on which everything is pressed.
pub struct Compaction<'a> {
    scene: &'a Scene<'a>,
    now: Arrangement,
    ends: Arrangement,
    moves: Vec<Move>,
    /// Who is not home for good, the next one last.
    loose: Vec<usize>,
    /// Where everything was when the next one was taken, and the shifts since.
    opening: Option<(Arrangement, Vec<Move>)>,
    rounds: usize,
}

impl<'a> Compaction<'a> {
    /// Nothing moved yet.
    pub fn new(
        scene: &'a Scene<'a>,
        from: &Arrangement,
        to: &Arrangement,
        rng: &mut ChaCha8Rng,
    ) -> Compaction<'a> {
        let (sin, cos) = rng.random_range(0.0..TAU).sin_cos();
        let sweep = SWEEP.0 * (SWEEP.1 / SWEEP.0).powf(rng.random_range(0.0..1.0));
        let area = |o: usize| scene.problem.objects[o].footprint.area();
        let largest = scene.movable.iter().map(|&o| area(o)).fold(0.0, f64::max);
        let rank = |o: usize, chance: f64| {
            let Pose2 { x, y, .. } = to[o].pose;
            area(o) / largest * chance + sweep * (cos * x + sin * y)
        };
        let away = scene.movable.iter().filter(|&&o| from[o].pose != to[o].pose);
        let mut order: Vec<(f64, usize)> = away.map(|&o| (rank(o, rng.random_range(0.7..1.0)), o)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let loose = order.into_iter().map(|(_, o)| o).collect();
        let (now, ends) = (from.clone(), to.clone());
        Compaction { scene, now, ends, moves: Vec::new(), loose, opening: None, rounds: 0 }
    }

    /// Goes on until it arrives, is stuck, or the effort is spent.
    pub fn run(&mut self, shortcut: &Shortcut, rng: &mut ChaCha8Rng, effort: &mut Effort) -> Progress {
        while let Some(&object) = self.loose.last() {
            let place = self.ends[object].clone();
            if self.now[object].pose == place.pose {
                self.loose.pop();
            } else if !effort.watch().go_on(self.scene.row_ticks()) {
                return Progress::Interrupted;
            } else if self.is_free(object, &place) {
                self.put(object, place);
                self.condense(object, shortcut, rng, effort);
                self.rounds = 0;
            } else if self.rounds == ROUNDS {
                return Progress::Stuck;
            } else {
                self.press(object, &place, rng, effort);
            }
            if effort.is_over() {
                return Progress::Interrupted;
            }
        }
        Progress::Arrived(std::mem::take(&mut self.moves))
    }

    fn put(&mut self, object: usize, spot: Arc<Spot>) {
        let from = std::mem::replace(&mut self.now[object], spot.clone());
        let moves = self.opening.as_mut().map_or(&mut self.moves, |(_, shifts)| shifts);
        moves.push(Move { object, from, to: spot });
    }

    fn is_free(&self, object: usize, spot: &Spot) -> bool {
        let mut others = self.scene.movable.iter().filter(|&&o| o != object);
        others.all(|&o| self.scene.clear(spot, &self.now[o]))
    }

    /// Undoes the shifts that `object` can do without to be where it is now, and makes the others with few
    /// moves.
    fn condense(&mut self, object: usize, shortcut: &Shortcut, rng: &mut ChaCha8Rng, effort: &mut Effort) {
        let Some((before, shifts)) = self.opening.take() else { return };
        let mut needed = before.clone();
        self.needed_by(object, &before, effort.watch()).iter().for_each(|o| needed[o] = self.now[o].clone());
        match shortcut(&before, &needed, rng, effort) {
            Some(moves) if moves.len() <= shifts.len() => {
                self.moves.extend(moves);
                self.now = needed;
            }
            _ => self.moves.extend(tidy(shifts)),
        }
    }

    /// The object, those that were `before` where it is now, those that were where these are, and so on.
    /// All that are loose where `watch` ends the work.
    fn needed_by(&self, object: usize, before: &Arrangement, watch: &mut Watch) -> ObjectSet {
        let mut needed = ObjectSet::EMPTY.with(object);
        let mut fringe = vec![object];
        while let Some(o) = fringe.pop() {
            if !watch.go_on(self.scene.row_ticks()) {
                return self.scene.movable.iter().copied().collect();
            }
            for &j in &self.scene.movable {
                if !needed.contains(j) && !self.scene.clear(&self.now[o], &before[j]) {
                    needed.insert(j);
                    fringe.push(j);
                }
            }
        }
        needed
    }

    /// Shifts every object once away from `place`, where `object` is to be.
    fn press(&mut self, object: usize, place: &Spot, rng: &mut ChaCha8Rng, effort: &mut Effort) {
        self.rounds += 1;
        if self.opening.is_none() {
            self.opening = Some((self.now.clone(), Vec::new()));
        }
        let far = |o: usize| self.now[o].pose.distance(&place.pose);
        let mut order: Vec<(f64, usize)> =
            self.loose.iter().map(|&o| (far(o) * rng.random_range(0.5..1.0), o)).collect();
        // Those far away first, so that they make room for the others.
        order.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, o) in order {
            let spot = self.further(o, (object, place), rng, effort);
            if spot.pose != self.now[o].pose {
                self.put(o, spot);
            }
        }
    }

    /// A free spot for `o` that is further from the place, or the one that it has.
    fn further(
        &self,
        o: usize,
        (object, place): (usize, &Spot),
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Arc<Spot> {
        let scene = self.scene;
        let nuisance = |spot: &Spot| {
            let far = spot.pose.distance(&place.pose);
            if o != object && !scene.clear(place, spot) { IN_THE_WAY_M - far } else { -far }
        };
        let mut best = self.now[o].clone();
        let mut least = nuisance(&best);
        for k in 0..SHIFTS + JUMPS {
            if !effort.step() {
                break;
            }
            let spot =
                if k < SHIFTS { shifted(scene, o, &best.pose, rng) } else { parking::propose(scene, o, rng) };
            let Some(spot) = spot else { continue };
            let new = nuisance(&spot);
            if new < least && scene.admissible(&spot) && self.is_free(o, &spot) {
                (best, least) = (spot, new);
            }
        }
        best
    }
}

/// A spot near a pose, at another angle or not; None beyond the table's edge.
fn shifted(scene: &Scene, object: usize, from: &Pose2, rng: &mut ChaCha8Rng) -> Option<Arc<Spot>> {
    let footprint = &scene.problem.objects[object].footprint;
    let size = footprint.bounding_radius();
    let turns = !matches!(footprint, Footprint::Disc { .. }) && rng.random_bool(0.5);
    let reach = 0.5f64.powi(rng.random_range(0..HALVINGS));
    let mut off = || reach * rng.random_range(-1.0..1.0);
    let (x, y) = (from.x + size * off(), from.y + size * off());
    let theta = from.theta + if turns { FRAC_PI_2 * off() } else { 0.0 };
    let pose = Pose2::new(x, y, theta);
    scene.on_table(object, &pose).then(|| scene.spot(object, pose))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planning::auto::polish::carried_out;
    use crate::planning::problem::Problem;
    use crate::planning::random_tables::table;
    use crate::tabletop::instance::ObjectSpec;
    use rand::SeedableRng;

    /// A large disc has to go to the middle, where eight small ones are in its way, and they to the walls.
    fn crowd() -> Problem {
        let mut objects = Vec::new();
        let mut add = |id: String, radius: f64, start: Pose2, goal: Pose2| {
            let mut disc = ObjectSpec::new(id, Footprint::disc(radius).unwrap());
            (disc.start, disc.goal) = (Some(start), Some(goal));
            objects.push(disc);
        };
        let at = |x: f64, y: f64| Pose2::new(x, y, 0.0);
        add("large".into(), 0.25, at(0.26, 0.26), at(0.5, 0.5));
        for k in 0..8u32 {
            let (row, b) = (f64::from(k % 4), f64::from(k) / 8.0 * TAU);
            let start = if k < 4 { at(0.6 + 0.112 * row, 0.4) } else { at(0.1 + 0.13 * row, 0.62) };
            let reach = if k % 2 == 0 { 0.4 } else { 0.5 };
            add(format!("small {k}"), 0.055, start, at(0.5 + reach * b.cos(), 0.5 + reach * b.sin()));
        }
        Problem::new(&table(objects)).unwrap()
    }

    #[test]
    fn it_arrives_over_free_places_however_often_it_is_interrupted() {
        let problem = crowd();
        let scene = Scene::new(&problem);
        let start: Arrangement = (0..9).map(|o| scene.start(o).clone()).collect();
        let goal: Arrangement = (0..9).map(|o| scene.goal(o).unwrap().clone()).collect();
        let mut arrived = 0;
        for seed in 0..20u64 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut compaction = Compaction::new(&scene, &start, &goal, &mut rng);
            let moves = loop {
                let mut effort = Effort::new(Some(50 + 1000 * (seed % 3)), &|| false);
                match compaction.run(&|_, _, _, _| None, &mut rng, &mut effort) {
                    Progress::Arrived(moves) => break moves,
                    Progress::Stuck => break Vec::new(),
                    Progress::Interrupted => {}
                }
            };
            let steps: Vec<(usize, Arc<Spot>)> = moves.iter().map(|m| (m.object, m.to.clone())).collect();
            assert!(carried_out(&scene, &start, &steps, &mut Watch::new(&|| false)).is_some(), "seed {seed}");
            let mut now = start.clone();
            moves.iter().for_each(|m| now[m.object] = m.to.clone());
            arrived += usize::from(now.iter().zip(&goal).all(|(a, b)| a.pose == b.pose));
        }
        assert!(arrived > 10, "{arrived} of 20");
    }

    #[test]
    fn unneeded_shifts_are_not_made() {
        let problem = crowd();
        let scene = Scene::new(&problem);
        let start: Arrangement = (0..9).map(|o| scene.start(o).clone()).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut compaction = Compaction::new(&scene, &start, &start, &mut rng);
        compaction.opening = Some((start.clone(), Vec::new()));
        // One goes where it was in no object's way, one out of the way of the large one.
        compaction.put(1, scene.spot(1, Pose2::new(0.9, 0.9, 0.0)));
        compaction.put(5, scene.spot(5, Pose2::new(0.06, 0.94, 0.0)));
        compaction.put(0, scene.spot(0, Pose2::new(0.26, 0.5, 0.0)));
        let all = |from: &Arrangement, to: &Arrangement, _: &mut ChaCha8Rng, _: &mut Effort| {
            let differ = (0..from.len()).filter(|&o| from[o].pose != to[o].pose);
            Some(differ.map(|o| Move { object: o, from: from[o].clone(), to: to[o].clone() }).collect())
        };
        compaction.condense(0, &all, &mut rng, &mut Effort::new(None, &|| false));
        let moved: Vec<usize> = compaction.moves.iter().map(|m| m.object).collect();
        assert!(moved.contains(&0) && moved.contains(&5) && !moved.contains(&1), "{moved:?}");
        assert!(compaction.now[1].pose == start[1].pose);
    }
}
