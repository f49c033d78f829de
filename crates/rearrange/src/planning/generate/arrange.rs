//! A random arrangement of given footprints on the table, without contact.
//!
//! In: footprints, their density, random numbers. Out: poses, and how they were found; None when the bounded
//! search gave up. Up to [`DENSEST_REJECTION`] the paper's rejection sampling is tried: objects in order,
//! each pose uniform over the table and all angles, drawn anew while it meets the edge or an object already
//! there, all of it afresh when an object finds no place. Above, or when that gives up, push-apart: shrunken
//! copies are placed by rejection sampling and then grow step by step, while each is pushed about by small
//! random moves that keep it free; more of these moves follow at full size. Every arrangement is free of
//! contact by [`GAP_M`] in the solvers' exact collision kernel.

use crate::geometry::collision::{Placed, inside};
use crate::geometry::footprint::Footprint;
use crate::geometry::pose::Pose2;
use crate::planning::generate::recipe::TABLE;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// The highest density at which rejection sampling is tried, as in the paper.
pub const DENSEST_REJECTION: f64 = 0.4;

/// Distance kept between objects, m: rounding must not turn touching into overlap.
const GAP_M: f64 = 1e-6;

/// Poses drawn for one object before the arrangement is given up.
const MOST_TRIES: usize = 10_000;

/// Arrangements begun by rejection sampling before push-apart takes over.
const MOST_RESTARTS: usize = 40;

/// Times push-apart is begun.
const MOST_PUSHES: usize = 3;

/// Density of the shrunken copies that push-apart begins with.
const SHRUNKEN_DENSITY: f64 = 0.2;

/// Rounds of small moves in which the copies have to reach full size.
const MOST_ROUNDS: usize = 6000;

/// Rounds of small moves after that, so that what just grew together comes apart again.
const LAST_ROUNDS: usize = 60;

/// Steps of growth tried after each round, largest first.
const GROWTH: [f64; 3] = [1.02, 1.005, 1.001];

/// How an arrangement was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Uniform poses, drawn anew on contact (the paper's way).
    Rejection,
    /// Grown from shrunken copies with small random moves.
    PushApart,
}

/// An arrangement and how it was found.
#[derive(Clone, Debug)]
pub struct Arranged {
    /// One pose an object.
    pub poses: Vec<Pose2>,
    /// By which method.
    pub method: Method,
    /// Which attempt of that method it was, from 1.
    pub attempt: usize,
}

impl Arranged {
    /// For the file: method and attempt.
    pub fn how(&self) -> String {
        let method = match self.method {
            Method::Rejection => "rejection sampling",
            Method::PushApart => "push-apart",
        };
        format!("{method} (attempt {})", self.attempt)
    }
}

/// Arranges the footprints; None when no arrangement was found.
pub fn arrange(shapes: &[Footprint], density: f64, rng: &mut ChaCha8Rng) -> Option<Arranged> {
    if density <= DENSEST_REJECTION + 1e-9 {
        for attempt in 1..=MOST_RESTARTS {
            if let Some(poses) = by_rejection(shapes, rng) {
                return Some(Arranged { poses, method: Method::Rejection, attempt });
            }
        }
    }
    (1..=MOST_PUSHES).find_map(|attempt| {
        let poses = by_push_apart(shapes, density, rng)?;
        Some(Arranged { poses, method: Method::PushApart, attempt })
    })
}

fn by_rejection(shapes: &[Footprint], rng: &mut ChaCha8Rng) -> Option<Vec<Pose2>> {
    let mut poses = Vec::with_capacity(shapes.len());
    let mut placed: Vec<Placed> = Vec::with_capacity(shapes.len());
    for shape in shapes {
        let (pose, spot) = (0..MOST_TRIES).find_map(|_| {
            let x = rng.random_range(0.0..TABLE.width);
            let y = rng.random_range(0.0..TABLE.height);
            let pose = Pose2::new(x, y, rng.random_range(0.0..TAU));
            free_spot(shape, pose, placed.iter()).map(|spot| (pose, spot))
        })?;
        poses.push(pose);
        placed.push(spot);
    }
    Some(poses)
}

/// The footprint at the pose, if it lies on the table and clear of the others.
fn free_spot<'a>(
    shape: &Footprint,
    pose: Pose2,
    mut others: impl Iterator<Item = &'a Placed>,
) -> Option<Placed> {
    if !inside(shape, &pose, TABLE.width, TABLE.height) {
        return None;
    }
    let spot = Placed::new(shape, pose);
    others.all(|other| !spot.closer_than(other, GAP_M)).then_some(spot)
}

fn by_push_apart(shapes: &[Footprint], density: f64, rng: &mut ChaCha8Rng) -> Option<Vec<Pose2>> {
    let size = (SHRUNKEN_DENSITY / density).sqrt().min(1.0);
    let small = scaled(shapes, size)?;
    let poses = by_rejection(&small, rng)?;
    let mut crowd = Crowd::new(small, poses, size)?;
    for _ in 0..MOST_ROUNDS {
        crowd.push(rng);
        if crowd.grow(shapes) {
            for _ in 0..LAST_ROUNDS {
                crowd.push(rng);
            }
            return Some(crowd.poses);
        }
    }
    None
}

/// At full size the very footprints requested, not ones with rounded extents.
fn scaled(shapes: &[Footprint], size: f64) -> Option<Vec<Footprint>> {
    if size >= 1.0 {
        return Some(shapes.to_vec());
    }
    shapes.iter().map(|shape| shape.scaled(size).ok()).collect()
}

/// Objects at less than their full size, free of contact at all times.
struct Crowd {
    shapes: Vec<Footprint>,
    poses: Vec<Pose2>,
    placed: Vec<Placed>,
    /// Share of the full size.
    size: f64,
    /// Reach of a small move, m.
    step: f64,
}

impl Crowd {
    /// None when the objects are in contact.
    fn new(shapes: Vec<Footprint>, poses: Vec<Pose2>, size: f64) -> Option<Crowd> {
        let mut placed: Vec<Placed> = Vec::with_capacity(shapes.len());
        for (shape, pose) in shapes.iter().zip(&poses) {
            let spot = free_spot(shape, *pose, placed.iter())?;
            placed.push(spot);
        }
        Some(Crowd { shapes, poses, placed, size, step: 0.1 })
    }

    /// One small random move of every object; what would meet something stays where it is. The reach follows
    /// the share of moves that succeed.
    fn push(&mut self, rng: &mut ChaCha8Rng) {
        for k in 0..self.shapes.len() {
            let reach = self.step;
            let turn = (reach / self.shapes[k].bounding_radius()).min(PI);
            let mut within = |most: f64| rng.random_range(-most..=most);
            let (dx, dy, dtheta) = (within(reach), within(reach), within(turn));
            let here = self.poses[k];
            let pose = Pose2::new(here.x + dx, here.y + dy, (here.theta + dtheta).rem_euclid(TAU));
            let others = self.placed.iter().enumerate().filter(|(j, _)| *j != k).map(|(_, spot)| spot);
            let moved = free_spot(&self.shapes[k], pose, others);
            self.step = (self.step * if moved.is_some() { 1.004 } else { 0.998 }).clamp(1e-4, 0.5);
            if let Some(spot) = moved {
                self.poses[k] = pose;
                self.placed[k] = spot;
            }
        }
    }

    /// Grows all objects by the largest step that leaves them free; true at full size.
    fn grow(&mut self, full: &[Footprint]) -> bool {
        if self.size >= 1.0 {
            return true;
        }
        for factor in GROWTH {
            let size = (self.size * factor).min(1.0);
            let grown = scaled(full, size).and_then(|shapes| Crowd::new(shapes, self.poses.clone(), size));
            if let Some(grown) = grown {
                *self = Crowd { step: self.step, ..grown };
                return self.size >= 1.0;
            }
        }
        false
    }
}
