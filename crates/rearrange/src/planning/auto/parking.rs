//! Places to park one object: free now, and out of the way of every object that has to go home before it.
//!
//! In: a table, the object, who else is put aside. Out: the best place found. A place is *ideal* when it
//! closes no new cycle of objects that wait for each other: then parking there is worth one vertex of the
//! feedback vertex set. Tried in turn: places where the object was parked in an earlier plan; random poses,
//! many of them pushed against the table's edge; the corners of the exact free region at some angles
//! (`regions`).

use crate::geometry::footprint::Footprint;
use crate::geometry::polygon::Point;
use crate::geometry::pose::Pose2;
use crate::planning::auto::regions::{Region, convex_parts, placed};
use crate::planning::auto::table::Table;
use crate::planning::effort::{Effort, Watch};
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::{Scene, Spot};
use rand::RngExt;
use rand::seq::{IndexedRandom, SliceRandom};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

/// Outlines of everything, once for a whole search. A shape is the union of convex parts.
pub struct Shapes {
    /// Of each object, held off by the clearance.
    movers: Vec<Vec<Vec<Point>>>,
    /// Of each object as it is.
    obstacles: Vec<Vec<Vec<Point>>>,
    /// Parts of keep-out areas and fixed objects, placed.
    standing: Vec<Vec<Point>>,
}

impl Shapes {
    /// The shapes of a scene.
    pub fn new(scene: &Scene) -> Shapes {
        let problem = scene.problem;
        let outlines = |clearance: f64| -> Vec<Vec<Vec<Point>>> {
            problem.objects.iter().map(|o| convex_parts(&o.footprint, clearance)).collect()
        };
        let obstacles = outlines(0.0);
        let areas = problem.keep_out.iter().map(|k| all_placed(&convex_parts(&k.footprint, 0.0), &k.pose));
        let fixed = problem.objects.iter().zip(&obstacles).filter(|(o, _)| o.fixed);
        let standing = areas.chain(fixed.map(|(o, parts)| all_placed(parts, &o.start))).flatten().collect();
        Shapes { movers: outlines(problem.clearance), obstacles, standing }
    }
}

fn all_placed(parts: &[Vec<Point>], pose: &Pose2) -> Vec<Vec<Point>> {
    parts.iter().map(|part| placed(part, pose)).collect()
}

/// How hard to look for a place.
#[derive(Clone, Copy, Debug)]
pub struct Care {
    /// Random poses.
    pub samples: usize,
    /// Angles at which the free region is looked at.
    pub angles: usize,
    /// Obstacles whose corners of the region are looked at, for each angle.
    pub pivots: usize,
}

/// What a place is wanted for.
pub struct Wish<'a> {
    /// Who is to be parked.
    pub object: usize,
    /// The others that are put aside sooner or later.
    pub aside: ObjectSet,
    /// A place that has to stay free, and whose.
    pub reserved: Option<&'a (usize, Arc<Spot>)>,
    /// Places known from before.
    pub hints: &'a [Arc<Spot>],
}

/// The places found.
#[derive(Default)]
pub struct Found {
    /// The ideal place that blocks the fewest.
    pub ideal: Option<Arc<Spot>>,
    /// The place that closes the fewest cycles, and how many objects wait in these.
    pub compromise: Option<(usize, Arc<Spot>)>,
    fewest: usize,
}

/// Looks for a place.
pub fn find(
    table: &Table,
    shapes: &Shapes,
    wish: &Wish,
    care: Care,
    rng: &mut ChaCha8Rng,
    effort: &mut Effort,
) -> Found {
    let before = table.before(wish.object, &wish.aside);
    let mut search = Search { table, shapes, wish, before, found: Found::default() };
    search.run(care, rng, effort);
    search.found
}

struct Search<'a> {
    table: &'a Table<'a>,
    shapes: &'a Shapes,
    wish: &'a Wish<'a>,
    /// Who has to go home before the object can.
    before: ObjectSet,
    found: Found,
}

impl Search<'_> {
    fn run(&mut self, care: Care, rng: &mut ChaCha8Rng, effort: &mut Effort) {
        for spot in self.wish.hints {
            if self.offer(spot.clone()) || !effort.step() {
                return;
            }
        }
        for _ in 0..care.samples {
            let spot = propose(self.table.scene, self.wish.object, rng);
            if spot.is_some_and(|spot| self.offer(spot)) || !effort.step() {
                return;
            }
        }
        for _ in 0..care.angles {
            if self.found.ideal.is_some() || self.search_region(care.pivots, rng, effort) {
                return;
            }
        }
    }

    /// Keeps the place if it is the best of its kind; true if there can be no better one.
    fn offer(&mut self, spot: Arc<Spot>) -> bool {
        let (table, object) = (self.table, self.wish.object);
        if !table.scene.admissible(&spot) || !table.is_free(object, &spot) {
            return false;
        }
        if self.wish.reserved.is_some_and(|(_, place)| !table.scene.clear(place, &spot)) {
            return false;
        }
        let blocked = table.blocked_by(object, &spot);
        let closing = (&blocked & &self.before).len();
        if closing > 0 {
            if self.found.compromise.as_ref().is_none_or(|(fewest, _)| closing < *fewest) {
                self.found.compromise = Some((closing, spot));
            }
            return false;
        }
        if self.found.ideal.is_none() || blocked.len() < self.found.fewest {
            self.found.fewest = blocked.len();
            self.found.ideal = Some(spot);
        }
        blocked.is_empty()
    }

    /// Offers corners of the free region at one angle; true if the search is over.
    fn search_region(&mut self, pivots: usize, rng: &mut ChaCha8Rng, effort: &mut Effort) -> bool {
        let theta = self.angle(rng);
        let Some(region) = self.region(theta, effort.watch()) else { return false };
        let mut order: Vec<usize> = (0..region.obstacle_count()).collect();
        order.shuffle(rng);
        let mut corners = region.table_corners();
        for pivot in order.into_iter().take(pivots) {
            corners.shuffle(rng);
            for [x, y] in corners {
                let spot = self.table.scene.spot(self.wish.object, Pose2::new(x, y, theta));
                if self.offer(spot) || !effort.step() {
                    return true;
                }
            }
            if self.found.ideal.is_some() || !effort.step() {
                return true;
            }
            corners = region.corners_at(pivot, effort.watch());
        }
        false
    }

    /// The region free of everything on the table and of the ends that must stay open.
    fn region(&self, theta: f64, watch: &mut Watch) -> Option<Region> {
        let (table, object) = (self.table, self.wish.object);
        let parts = |o: usize, pose: &Pose2| all_placed(&self.shapes.obstacles[o], pose);
        let here = table.scene.movable.iter().filter(|&&o| o != object);
        let here = here.flat_map(|&o| parts(o, &table.now[o].pose));
        let ends = self.before.iter().map(|v| (table.owner(v), &table.ends[v].pose));
        let ends = ends.filter(|(o, _)| *o != object).flat_map(|(o, pose)| parts(o, pose));
        let reserved = self.wish.reserved.iter().flat_map(|(o, spot)| parts(*o, &spot.pose));
        let standing = self.shapes.standing.iter().cloned();
        let mover = all_placed(&self.shapes.movers[object], &Pose2::new(0.0, 0.0, theta));
        let (low, high) = bounds(table.scene, object, theta);
        Region::new(&mover, low, high, standing.chain(here).chain(ends).chain(reserved), watch)
    }

    /// Parallel to the table's edge, to another object, or any.
    fn angle(&self, rng: &mut ChaCha8Rng) -> f64 {
        let object = self.wish.object;
        let turn = FRAC_PI_2 * f64::from(rng.random_range(0..4u8));
        match rng.random_range(0..4u8) {
            0 | 1 => wall_angle(self.table.scene, object, rng) + turn,
            2 => {
                let other =
                    self.table.scene.movable.choose(rng).map_or(0.0, |&o| self.table.now[o].pose.theta);
                other + turn
            }
            _ => rng.random_range(-PI..PI),
        }
    }
}

/// An angle that lays an edge, or an axis, of the footprint along the x axis.
fn wall_angle(scene: &Scene, object: usize, rng: &mut ChaCha8Rng) -> f64 {
    let Footprint::Polygon(polygon) = &scene.problem.objects[object].footprint else { return 0.0 };
    let outline = polygon.points();
    let k = rng.random_range(0..outline.len());
    let (a, b) = (outline[k], outline[(k + 1) % outline.len()]);
    -(b[1] - a[1]).atan2(b[0] - a[0])
}

/// Where the origin may be for the footprint to lie on the table.
fn bounds(scene: &Scene, object: usize, theta: f64) -> (Point, Point) {
    let problem = scene.problem;
    let (low, high) = problem.objects[object].footprint.bounds(&Pose2::new(0.0, 0.0, theta));
    let (width, height) = (problem.workspace.width, problem.workspace.height);
    ([-low[0], -low[1]], [width - high[0], height - high[1]])
}

/// A random pose on the table; most of them have an edge at the table's edge.
pub fn propose(scene: &Scene, object: usize, rng: &mut ChaCha8Rng) -> Option<Arc<Spot>> {
    if rng.random_bool(0.4) {
        return scene.sample(object, rng);
    }
    let theta = wall_angle(scene, object, rng) + FRAC_PI_2 * f64::from(rng.random_range(-2..2i8));
    let (low, high) = bounds(scene, object, theta);
    if low[0] > high[0] || low[1] > high[1] {
        return None;
    }
    let mut at = [0, 1].map(|k| if low[k] < high[k] { rng.random_range(low[k]..high[k]) } else { low[k] });
    let axis = rng.random_range(0..2usize);
    at[axis] = if rng.random_bool(0.5) { low[axis] } else { high[axis] };
    if rng.random_bool(0.2) {
        at[1 - axis] = if rng.random_bool(0.5) { low[1 - axis] } else { high[1 - axis] };
    }
    Some(scene.spot(object, Pose2::new(at[0], at[1], theta)))
}
