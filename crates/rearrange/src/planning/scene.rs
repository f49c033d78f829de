//! The table as the solvers see it: objects placed at poses, and which two of them may be there at once.
//!
//! In: a [`Problem`] and, for every object, the goal it is to take (its own, one of its group's, or a free
//! pose found for it). Out: [`Spot`]s, shared and never changed, that know whether they are the object's
//! start or its goal: given arrangements may overlap a little, and only those pairs, in exactly those poses,
//! are exempt. Pairs are decided by `geometry::collision`; the plan checker decides again by other means.

use crate::geometry::collision::{Placed, inside};
use crate::geometry::footprint::Footprint;
use crate::geometry::polygon::{contains, distance_to_outline};
use crate::geometry::pose::Pose2;
use crate::planning::problem::Problem;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Discs that overlap by less are left to the exact test, m: far more than rounding.
const CORE_MARGIN_M: f64 = 1e-6;

/// An object at a pose.
#[derive(Debug)]
pub struct Spot {
    /// Where, in the table frame.
    pub pose: Pose2,
    object: usize,
    placed: Placed,
    /// Radius of a disc about the pose that the footprint covers, m; 0 where there is none.
    core: f64,
    at_start: bool,
    /// Whose goal this is, among those the object may take.
    goal_of: Option<usize>,
}

/// A problem with its footprints placed once for all that does not change.
pub struct Scene<'a> {
    /// The problem behind the scene.
    pub problem: &'a Problem,
    /// Objects that may be moved, in increasing order.
    pub movable: Vec<usize>,
    starts: Vec<Arc<Spot>>,
    goals: Vec<Option<Arc<Spot>>>,
    fixed: Vec<Arc<Spot>>,
    keep_out: Vec<Placed>,
    cores: Vec<f64>,
    row_ticks: u64,
}

impl<'a> Scene<'a> {
    /// Places everything that the problem gives.
    pub fn new(problem: &'a Problem) -> Scene<'a> {
        let cores: Vec<f64> = problem.objects.iter().map(|object| Scene::core(&object.footprint)).collect();
        let spots = |pose: &dyn Fn(usize) -> Option<Pose2>| -> Vec<Option<Arc<Spot>>> {
            (0..problem.objects.len())
                .map(|i| pose(i).map(|pose| Arc::new(new_spot(problem, i, pose, cores[i]))))
                .collect()
        };
        let starts: Vec<Arc<Spot>> =
            spots(&|i| Some(problem.objects[i].start)).into_iter().flatten().collect();
        let is_fixed = |i: &usize| problem.objects[*i].fixed;
        let all = || 0..problem.objects.len();
        Scene {
            problem,
            movable: all().filter(|i| !is_fixed(i)).collect(),
            goals: spots(&|i| problem.objects[i].goal),
            fixed: all().filter(is_fixed).map(|i| starts[i].clone()).collect(),
            keep_out: problem.keep_out.iter().map(|k| Placed::new(&k.footprint, k.pose)).collect(),
            starts,
            cores,
            row_ticks: row_ticks(problem),
        }
    }

    /// What it takes to test one object at one pose against all others, in ticks of
    /// [`Watch`](crate::planning::effort::Watch).
    pub fn row_ticks(&self) -> u64 {
        self.row_ticks
    }

    /// The object's start.
    pub fn start(&self, object: usize) -> &Arc<Spot> {
        &self.starts[object]
    }

    /// Where every object of the problem starts.
    pub fn starts(&self) -> &[Arc<Spot>] {
        &self.starts
    }

    /// The object's own goal, if it has one.
    pub fn goal(&self, object: usize) -> Option<&Arc<Spot>> {
        self.goals[object].as_ref()
    }

    /// The object at any pose.
    pub fn spot(&self, object: usize, pose: Pose2) -> Arc<Spot> {
        Arc::new(new_spot(self.problem, object, pose, self.cores[object]))
    }

    /// May two objects be at these spots at the same time?
    pub fn clear(&self, a: &Spot, b: &Spot) -> bool {
        let goals = a.goal_of.is_some() && b.goal_of.is_some() && a.goal_of != b.goal_of;
        let given = (a.at_start && b.at_start) || goals;
        given || self.apart(a, b)
    }

    /// The same for poses that were not given together.
    pub fn apart(&self, a: &Spot, b: &Spot) -> bool {
        !cores_meet(a, b) && !self.near(&a.placed, &b.placed)
    }

    /// Would this shape, at a pose that is not given, be too near to the object at its spot?
    pub fn meets(&self, shape: &Placed, spot: &Spot) -> bool {
        self.near(shape, &spot.placed)
    }

    /// The same for the keep-out areas and everything that never moves.
    pub fn meets_what_stays(&self, shape: &Placed) -> bool {
        self.keep_out.iter().any(|area| self.near(shape, area))
            || self.fixed.iter().any(|fixed| self.near(shape, &fixed.placed))
    }

    /// Clear of the keep-out areas and of everything that never moves, and within reach. Given poses are so
    /// by definition.
    pub fn admissible(&self, spot: &Spot) -> bool {
        let given = spot.at_start || spot.goal_of.is_some();
        let reached =
            || self.problem.reach.as_ref().is_none_or(|reach| reach.serves(spot.object, &spot.pose));
        !self.keep_out.iter().any(|area| self.near(&spot.placed, area))
            && self.fixed.iter().all(|fixed| self.clear(spot, fixed))
            && (given || reached())
    }

    /// Does the object lie within the table's edge at this pose?
    pub fn on_table(&self, object: usize, pose: &Pose2) -> bool {
        let (width, height) = (self.problem.workspace.width, self.problem.workspace.height);
        inside(&self.problem.objects[object].footprint, pose, width, height)
    }

    fn near(&self, a: &Placed, b: &Placed) -> bool {
        let clearance = self.problem.clearance;
        if clearance > 0.0 { a.closer_than(b, clearance) } else { a.collides(b) }
    }

    /// Radius of the largest disc about the origin that the footprint covers, m; 0 if the origin lies
    /// outside.
    pub fn core(footprint: &Footprint) -> f64 {
        match footprint {
            Footprint::Disc { radius } => *radius,
            Footprint::Ellipse { length, width } | Footprint::Rectangle { length, width } => {
                length.min(*width) / 2.0
            }
            Footprint::Polygon(polygon) if contains(polygon.points(), [0.0, 0.0]) => {
                distance_to_outline(polygon.points(), [0.0, 0.0])
            }
            Footprint::Polygon(_) => 0.0,
        }
    }

    /// A uniformly random pose of the object inside the table's edge; None if it does not fit at the angle
    /// drawn. A disc keeps its angle, since turning it would serve nothing.
    pub fn sample(&self, object: usize, rng: &mut ChaCha8Rng) -> Option<Arc<Spot>> {
        let footprint = &self.problem.objects[object].footprint;
        let theta = match footprint {
            Footprint::Disc { .. } => self.problem.objects[object].start.theta,
            _ => rng.random_range(-std::f64::consts::PI..std::f64::consts::PI),
        };
        let ([x_min, y_min], [x_max, y_max]) = footprint.bounds(&Pose2::new(0.0, 0.0, theta));
        let (width, height) = (self.problem.workspace.width, self.problem.workspace.height);
        let x = between(rng, -x_min, width - x_max)?;
        let y = between(rng, -y_min, height - y_max)?;
        Some(self.spot(object, Pose2::new(x, y, theta)))
    }
}

/// A pair of discs takes a tick, one of other shapes more by their corners, of which every pair counts.
fn row_ticks(problem: &Problem) -> u64 {
    /// Pairs of corners that take as long as a pair of discs.
    const CORNERS_OF_A_TICK: usize = 16;
    /// For the caller's check of reach.
    const TICKS_OF_REACH: u64 = 1000;
    let corners = |footprint: &Footprint| match footprint {
        Footprint::Disc { .. } => 1,
        Footprint::Rectangle { .. } => 4,
        // Two of them take as long as two polygons of so many corners.
        Footprint::Ellipse { .. } => 16,
        Footprint::Polygon(polygon) => polygon.parts().iter().map(Vec::len).sum(),
    };
    let all = || problem.objects.iter().map(|o| corners(&o.footprint));
    let most = all().max().unwrap_or(0);
    let reach = if problem.reach.is_some() { TICKS_OF_REACH } else { 0 };
    all().map(|of_one| 1 + (of_one * most / CORNERS_OF_A_TICK) as u64).sum::<u64>() + reach
}

fn between(rng: &mut ChaCha8Rng, low: f64, high: f64) -> Option<f64> {
    (low < high).then(|| rng.random_range(low..high))
}

/// The discs within the footprints overlap: most pairs that collide are detected by that, at a tenth of the
/// price.
fn cores_meet(a: &Spot, b: &Spot) -> bool {
    let reach = a.core + b.core - CORE_MARGIN_M;
    let (dx, dy) = (a.pose.x - b.pose.x, a.pose.y - b.pose.y);
    reach > 0.0 && dx * dx + dy * dy < reach * reach
}

fn new_spot(problem: &Problem, object: usize, pose: Pose2, core: f64) -> Spot {
    let given = &problem.objects[object];
    Spot {
        pose,
        object,
        core,
        placed: Placed::new(&given.footprint, pose),
        at_start: pose == given.start,
        goal_of: goal_of(problem, object, &pose),
    }
}

/// The object whose goal the pose is: the object itself, or a member of its group.
fn goal_of(problem: &Problem, object: usize, pose: &Pose2) -> Option<usize> {
    let objects = &problem.objects;
    let given = &objects[object];
    if given.goal == Some(*pose) {
        return Some(object);
    }
    given.group.as_ref()?;
    objects.iter().position(|other| other.goal == Some(*pose) && other.group == given.group)
}
