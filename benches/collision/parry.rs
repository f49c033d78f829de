//! The same questions put to `parry2d`, in the same run.
//!
//! In: the pairs of the table before, and arrangements with poses to check as in `broad`. Out: nanoseconds a
//! pair of poses, ours and parry's, how often the two differ, and nanoseconds a check of a pose with parry's
//! tree of boxes as broad phase. Parry gets what suits it best: discs as balls, rectangles as cuboids, other
//! polygons as compounds of their convex parts, ellipses (which it lacks) as polygons of 64 corners.

use crate::broad::{Ball, Broad};
use crate::{PAIRS, nanoseconds, pairs, pose_pairs, shapes};
use parry2d_f64::bounding_volume::Aabb;
use parry2d_f64::math::{Pose, Vector};
use parry2d_f64::partitioning::Bvh;
use parry2d_f64::query::intersection_test;
use parry2d_f64::shape::{Compound, SharedShape};
use rearrange::geometry::collision::Placed;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;

/// Corners of the polygon that replaces an ellipse.
const ELLIPSE_CORNERS: usize = 64;

/// The convex parts of the tee in `shapes`.
const TEE: [([f64; 2], [f64; 2]); 2] = [([-0.1, 0.0], [0.1, 0.07]), ([-0.035, 0.07], [0.035, 0.14])];

fn shape_of(name: &str, footprint: &Footprint) -> SharedShape {
    match name {
        "disc" => SharedShape::ball(footprint.bounding_radius()),
        "rectangle" => SharedShape::cuboid(0.1, 0.05),
        "tee" => {
            let part = |&(low, high): &([f64; 2], [f64; 2])| {
                let middle = Vector::new((low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0);
                let half = SharedShape::cuboid((high[0] - low[0]) / 2.0, (high[1] - low[1]) / 2.0);
                (Pose::from_translation(middle), half)
            };
            SharedShape::new(Compound::new(TEE.iter().map(part).collect()))
        }
        _ => {
            let outline: Vec<Vector> =
                footprint.outline(ELLIPSE_CORNERS).iter().map(|p| Vector::new(p[0], p[1])).collect();
            SharedShape::convex_hull(&outline).expect("a convex outline")
        }
    }
}

fn pose_of(pose: &Pose2) -> Pose {
    Pose::new(Vector::new(pose.x, pose.y), pose.theta)
}

/// Objects in a tree of axis-aligned boxes around their discs.
pub struct Tree(Bvh);

impl Tree {
    pub fn new() -> Tree {
        Tree(Bvh::new())
    }

    fn square(ball: Ball) -> Aabb {
        let half = Vector::new(ball.radius, ball.radius);
        let middle = Vector::new(ball.x, ball.y);
        Aabb::new(middle - half, middle + half)
    }
}

impl Broad for Tree {
    fn insert(&mut self, object: usize, ball: Ball) {
        self.0.insert(Tree::square(ball), object as u32);
    }

    fn remove(&mut self, object: usize, _: Ball) {
        self.0.remove(object as u32);
    }

    fn any(&self, ball: Ball, test: &mut dyn FnMut(usize) -> bool) -> bool {
        self.0.intersect_aabb(&Tree::square(ball)).any(|object| test(object as usize))
    }
}

fn times(near: &[(Placed, Placed)]) -> f64 {
    nanoseconds(|k| near[k].0.collides(&near[k].1))
}

/// Prints the table of pairs.
pub fn run() {
    let made: Vec<(&str, Footprint, SharedShape)> = shapes()
        .into_iter()
        .map(|(name, footprint)| (name, footprint.clone(), shape_of(name, &footprint)))
        .collect();
    println!("\n{:<22} {:>10} {:>10} {:>10}", "ns a near pair", "celld", "parry2d", "differ");
    for (at, (name, footprint, shape)) in made.iter().enumerate() {
        for (other_name, other, other_shape) in &made[at..] {
            let near = pairs(footprint, other, true);
            let poses: Vec<(Pose, Pose)> =
                pose_pairs(footprint, other, true).iter().map(|(a, b)| (pose_of(a), pose_of(b))).collect();
            let meet = |k: usize| {
                let (a, b) = &poses[k];
                intersection_test(a, shape.as_ref(), b, other_shape.as_ref())
                    .is_ok_and(|found| found.intersecting)
            };
            let differ = (0..PAIRS).filter(|k| meet(*k) != near[*k].0.collides(&near[*k].1)).count();
            println!(
                "{:<22} {:>10.1} {:>10.1} {:>9.2}%",
                format!("{name}-{other_name}"),
                times(&near),
                nanoseconds(meet),
                100.0 * differ as f64 / PAIRS as f64
            );
        }
    }
}
