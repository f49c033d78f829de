//! Lazy buffer allocation: poses for the objects that a primitive plan sends out of the way.
//!
//! In: an arrangement to leave, one to reach, a primitive plan between them. Out: a pose for every buffer
//! stay, or the longest prefix of the plan for which poses were found. Walks the plan step by step; whenever
//! a step makes poses of objects in buffers impossible, these are chosen anew for their whole stay, as if
//! they had been put there from the beginning. Source: the paper, section TRLB. Deviation: a sampled pose
//! that also avoids everything that will still arrive during the stay is preferred, as the plan already
//! shows.

use crate::planning::effort::Effort;
use crate::planning::primitive::{Step, Target};
use crate::planning::scene::{Scene, Spot};
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Joint attempts to choose poses anew after a step.
const RESTARTS: usize = 40;

/// Poses sampled for one object in one attempt.
const SAMPLES: usize = 25;

const NEVER: usize = usize::MAX;

/// A position for every object of the problem.
pub type Arrangement = Vec<Arc<Spot>>;

/// One object's time in a buffer: from the end of step `begin` to the start of step `end`.
struct Stay {
    object: usize,
    begin: usize,
    end: usize,
    spot: Option<Arc<Spot>>,
}

impl Stay {
    fn is_open_after(&self, step: usize) -> bool {
        self.begin <= step && step < self.end
    }

    fn overlaps(&self, other: &Stay) -> bool {
        self.begin < other.end && other.begin < self.end
    }
}

/// A primitive plan with poses, as far as they were found.
pub struct Allocated {
    /// Where each executed step puts its object.
    pub moves: Vec<(usize, Arc<Spot>)>,
    /// Every step of the plan is among them.
    pub complete: bool,
    /// The object whose stay found no pose.
    pub stuck: Option<usize>,
}

/// Chooses poses for `steps`, which lead from `from` to `to`; `steps` name objects of the problem.
pub fn allocate(
    scene: &Scene,
    from: &Arrangement,
    to: &Arrangement,
    steps: &[Step],
    rng: &mut ChaCha8Rng,
    effort: &mut Effort,
) -> Allocated {
    let mut allocator = Allocator::new(scene, from, to, steps);
    let failed = (0..steps.len()).find(|&step| !allocator.settle(step, rng, effort));
    let stuck = failed.filter(|_| !effort.is_over()).and_then(|step| allocator.stuck(step));
    let done = failed.unwrap_or(steps.len());
    Allocated { moves: allocator.moves(&steps[..done]), complete: failed.is_none(), stuck }
}

struct Allocator<'a> {
    scene: &'a Scene<'a>,
    from: &'a Arrangement,
    to: &'a Arrangement,
    /// Step at which each object leaves its place in `from`.
    leaves: Vec<usize>,
    /// Step at which each object reaches its place in `to`.
    arrives: Vec<usize>,
    stays: Vec<Stay>,
}

impl<'a> Allocator<'a> {
    fn new(scene: &'a Scene, from: &'a Arrangement, to: &'a Arrangement, steps: &[Step]) -> Allocator<'a> {
        let mut leaves = vec![NEVER; from.len()];
        let mut arrives = vec![NEVER; from.len()];
        let mut stays = Vec::new();
        for (at, step) in steps.iter().enumerate() {
            leaves[step.object] = leaves[step.object].min(at);
            match step.target {
                Target::Goal => arrives[step.object] = at,
                Target::Buffer => stays.push(Stay { object: step.object, begin: at, end: NEVER, spot: None }),
            }
        }
        for stay in &mut stays {
            stay.end = arrives[stay.object];
        }
        Allocator { scene, from, to, leaves, arrives, stays }
    }

    /// Makes the poses of all stays hold up to the end of `step`; false, and nothing changed, if none do.
    fn settle(&mut self, step: usize, rng: &mut ChaCha8Rng, effort: &mut Effort) -> bool {
        let mut open: Vec<usize> =
            (0..self.stays.len()).filter(|&s| self.stays[s].is_open_after(step)).collect();
        let row_ticks = self.scene.row_ticks();
        if open.iter().all(|&s| effort.watch().go_on(row_ticks) && self.holds(s, step)) {
            return true;
        }
        let before: Vec<Option<Arc<Spot>>> = open.iter().map(|&s| self.stays[s].spot.clone()).collect();
        let slots = open.clone();
        for _ in 0..RESTARTS {
            if effort.is_over() {
                return false;
            }
            open.shuffle(rng);
            let mut old: Vec<Option<Arc<Spot>>> = open.iter().map(|&s| self.stays[s].spot.take()).collect();
            let all_placed =
                open.iter().zip(&mut old).all(|(&s, old)| self.place(s, step, old.take(), rng, effort));
            if all_placed {
                return true;
            }
            slots.iter().zip(&before).for_each(|(&s, spot)| self.stays[s].spot = spot.clone());
            if effort.is_over() {
                return false;
            }
        }
        false
    }

    /// Has this stay a pose that nothing disturbs up to the end of `step`?
    fn holds(&self, stay: usize, step: usize) -> bool {
        self.stays[stay].spot.as_ref().is_some_and(|spot| self.fits(stay, spot, step))
    }

    /// The first object whose pose the step makes impossible.
    fn stuck(&self, step: usize) -> Option<usize> {
        let mut open = (0..self.stays.len()).filter(|&s| self.stays[s].is_open_after(step));
        open.find(|&s| !self.holds(s, step)).map(|s| self.stays[s].object)
    }

    /// Keeps the old pose if it still fits, else samples another.
    fn place(
        &mut self,
        stay: usize,
        step: usize,
        old: Option<Arc<Spot>>,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> bool {
        let kept = old.filter(|spot| self.fits(stay, spot, step));
        let chosen = kept.or_else(|| self.sample(stay, step, rng, effort));
        self.stays[stay].spot = chosen;
        self.stays[stay].spot.is_some()
    }

    fn sample(
        &self,
        stay: usize,
        step: usize,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Option<Arc<Spot>> {
        let mut short_sighted = None;
        for _ in 0..SAMPLES {
            if !effort.step() {
                return None;
            }
            let Some(spot) = self.scene.sample(self.stays[stay].object, rng) else { continue };
            if !self.scene.admissible(&spot) || !self.fits(stay, &spot, step) {
                continue;
            }
            if self.fits_arrivals(stay, &spot, step, NEVER) {
                return Some(spot);
            }
            short_sighted.get_or_insert(spot);
        }
        short_sighted
    }

    /// Nothing that is on the table between the stay's begin and the end of `step` is in the way.
    fn fits(&self, stay: usize, spot: &Spot, step: usize) -> bool {
        let Stay { object, begin, .. } = self.stays[stay];
        let clear_of_waiting = (0..self.from.len())
            .all(|o| o == object || self.leaves[o] < begin || self.scene.clear(spot, &self.from[o]));
        clear_of_waiting && self.fits_arrivals(stay, spot, 0, step) && self.fits_other_stays(stay, spot)
    }

    /// Clear of the final places that are taken from step `first` to step `last`, while the stay lasts.
    fn fits_arrivals(&self, stay: usize, spot: &Spot, first: usize, last: usize) -> bool {
        let Stay { object, end, .. } = self.stays[stay];
        (0..self.to.len()).all(|o| {
            let arrives = self.arrives[o];
            o == object
                || arrives >= end
                || arrives < first
                || arrives > last
                || self.scene.clear(spot, &self.to[o])
        })
    }

    fn fits_other_stays(&self, stay: usize, spot: &Spot) -> bool {
        self.stays.iter().enumerate().all(|(at, other)| {
            let Some(taken) = &other.spot else { return true };
            at == stay || !other.overlaps(&self.stays[stay]) || self.scene.clear(spot, taken)
        })
    }

    fn moves(&self, steps: &[Step]) -> Vec<(usize, Arc<Spot>)> {
        let spot = |at: usize, step: &Step| match step.target {
            Target::Goal => Some(self.to[step.object].clone()),
            Target::Buffer => {
                self.stays.iter().find(|stay| stay.begin == at).and_then(|stay| stay.spot.clone())
            }
        };
        steps.iter().enumerate().filter_map(|(at, step)| Some((step.object, spot(at, step)?))).collect()
    }
}
