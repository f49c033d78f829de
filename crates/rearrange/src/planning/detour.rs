//! Clears a place for an object that finds no buffer: what is there makes way first.
//!
//! In: an arrangement, the one to reach, the object. Out: moves that end with the object at a place of its
//! own, and the objects it displaced elsewhere. A primitive plan moves only objects that block a goal; where
//! a large object finds no room among the others, no order of such moves helps, and TRLB as the paper has it
//! fails. Ours, not the paper's; `Control::strict_paper` switches it off.

use crate::planning::buffers::Arrangement;
use crate::planning::effort::Effort;
use crate::planning::scene::{Scene, Spot};
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Poses compared for the object itself.
const PLACES: usize = 60;

/// Poses tried for each displaced object.
const SAMPLES: usize = 40;

/// Moves from `from` that put `object` where the least area is in its way, now and at the places of `to`
/// that are still to be filled. None if a displaced object found no room.
pub fn clear_a_place(
    scene: &Scene,
    from: &Arrangement,
    to: &Arrangement,
    object: usize,
    rng: &mut ChaCha8Rng,
    effort: &mut Effort,
) -> Option<Vec<(usize, Arc<Spot>)>> {
    let detour = Detour { scene, to, object };
    let place = detour.least_disputed(from, rng, effort)?;
    let mut displaced: Vec<usize> = detour.standing_at(&place, from).collect();
    displaced.shuffle(rng);
    let mut now = from.clone();
    let mut moves = Vec::new();
    for other in displaced {
        let spot = detour.out_of_the_way(&now, other, &place, rng, effort)?;
        now[other] = spot.clone();
        moves.push((other, spot));
    }
    moves.push((object, place));
    Some(moves)
}

struct Detour<'a> {
    scene: &'a Scene<'a>,
    to: &'a Arrangement,
    object: usize,
}

impl Detour<'_> {
    /// Other movable objects that cannot stay where `arrangement` has them while the object is at `place`.
    fn standing_at<'b>(
        &'b self,
        place: &'b Spot,
        arrangement: &'b Arrangement,
    ) -> impl Iterator<Item = usize> + 'b {
        let others = self.scene.movable.iter().copied().filter(|&o| o != self.object);
        others.filter(|&o| !self.scene.clear(place, &arrangement[o]))
    }

    fn least_disputed(
        &self,
        from: &Arrangement,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Option<Arc<Spot>> {
        let area = |o: usize| self.scene.problem.objects[o].footprint.area();
        let mut best: Option<(f64, Arc<Spot>)> = None;
        for _ in 0..PLACES {
            if !effort.step() {
                return None;
            }
            let Some(spot) = self.scene.sample(self.object, rng) else { continue };
            if !self.scene.admissible(&spot) {
                continue;
            }
            let now: f64 = self.standing_at(&spot, from).map(area).sum();
            let later = self.standing_at(&spot, self.to).filter(|&o| from[o].pose != self.to[o].pose);
            let disputed = now + later.map(area).sum::<f64>();
            if best.as_ref().is_none_or(|(least, _)| disputed < *least) {
                best = Some((disputed, spot));
            }
        }
        best.map(|(_, spot)| spot)
    }

    /// A free place for a displaced object: its final one if that is open, else one that blocks no other
    /// object's, else any.
    fn out_of_the_way(
        &self,
        now: &Arrangement,
        displaced: usize,
        place: &Spot,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Option<Arc<Spot>> {
        let free = |spot: &Spot| {
            let mut others = (0..now.len()).filter(|&o| o != displaced);
            self.scene.clear(spot, place) && others.all(|o| self.scene.clear(spot, &now[o]))
        };
        if free(&self.to[displaced]) {
            return Some(self.to[displaced].clone());
        }
        let mut any = None;
        for _ in 0..SAMPLES {
            if !effort.step() {
                return None;
            }
            let Some(spot) = self.scene.sample(displaced, rng) else { continue };
            if !self.scene.admissible(&spot) || !free(&spot) {
                continue;
            }
            let mut others = self.scene.movable.iter().filter(|&&o| o != displaced);
            if others.all(|&o| self.scene.clear(&spot, &self.to[o])) {
                return Some(spot);
            }
            any.get_or_insert(spot);
        }
        any
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::footprint::Footprint;
    use crate::geometry::pose::Pose2;
    use crate::planning::problem::Problem;
    use crate::tabletop::instance::{Instance, ObjectSpec, Workspace};
    use rand::SeedableRng;

    /// A square of 0.3 m and four of 0.1 m on a table of 0.7 m x 0.4 m; nothing large is free but by
    /// clearing.
    fn crowded() -> Instance {
        let places =
            [(0.16, 0.2, 0.3), (0.38, 0.1, 0.1), (0.38, 0.3, 0.1), (0.52, 0.2, 0.1), (0.64, 0.34, 0.1)];
        let objects = places.iter().enumerate().map(|(k, &(x, y, size))| {
            let mut object = ObjectSpec::new(format!("o{k}"), Footprint::rectangle(size, size).unwrap());
            object.start = Some(Pose2::new(x, y, 0.0));
            object
        });
        Instance {
            workspace: Workspace { width: 0.7, height: 0.4 },
            clearance: 0.0,
            overlap_tolerance: 0.0,
            keep_out: Vec::new(),
            objects: objects.collect(),
        }
    }

    #[test]
    fn every_move_goes_to_a_free_place_and_the_last_one_is_the_objects() {
        let problem = Problem::new(&crowded()).unwrap();
        let scene = Scene::new(&problem);
        let start: Arrangement = (0..5).map(|o| scene.start(o).clone()).collect();
        let mut displacing = 0;
        for seed in 0..30 {
            let mut effort = Effort::new(None, &|| false);
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let Some(moves) = clear_a_place(&scene, &start, &start, 0, &mut rng, &mut effort) else {
                continue;
            };
            let mut now = start.clone();
            for (object, spot) in &moves {
                assert!((0..5).all(|o| o == *object || scene.clear(spot, &now[o])), "seed {seed}");
                now[*object] = spot.clone();
            }
            assert_eq!(moves.last().map(|(object, _)| *object), Some(0));
            displacing += usize::from(moves.len() > 1);
        }
        assert!(displacing > 5, "{displacing} detours that displace somebody");
    }
}
