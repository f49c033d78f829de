//! Do two placed footprints overlap, how deep, and how far apart are they: the solvers' collision kernel.
//!
//! In: footprints and poses, m and rad. Out: yes or no, or metres. Two steps, as in the paper (section on
//! the efficient collision checker): bounding discs first, then exact tests of convex parts; the paper's
//! narrow phase works on polygonal approximations, ours is exact for ellipses too. What touches does not
//! collide: penetration up to [`TOUCH_M`] counts as touching.

use crate::geometry::ellipse::PlacedEllipse;
use crate::geometry::footprint::{Footprint, rectangle_corners};
use crate::geometry::polygon::{Point, closest_on_segment, distance, dot, sub};
use crate::geometry::pose::Pose2;
use std::f64::consts::TAU;

/// Penetration up to here is touching, m.
pub const TOUCH_M: f64 = 1e-9;

/// A convex polygon at its pose, with outward unit normals (`normals[i]` belongs to the edge from
/// `corners[i]` to the next).
#[derive(Clone, Debug)]
struct Convex {
    corners: Vec<Point>,
    normals: Vec<Point>,
}

#[derive(Clone, Debug)]
enum Shape {
    Disc(f64),
    Ellipse(PlacedEllipse),
    Parts(Vec<Convex>),
}

/// A footprint at a pose, turned and moved once so that it can be tested many times.
#[derive(Clone, Debug)]
pub struct Placed {
    centre: Point,
    radius: f64,
    shape: Shape,
}

impl Placed {
    /// Places a footprint.
    pub fn new(footprint: &Footprint, pose: Pose2) -> Placed {
        let centre = [pose.x, pose.y];
        let shape = match footprint {
            Footprint::Disc { radius } => Shape::Disc(*radius),
            Footprint::Ellipse { length, width } => {
                let (sin, cos) = pose.theta.sin_cos();
                Shape::Ellipse(PlacedEllipse { centre, semi: [length / 2.0, width / 2.0], turn: [cos, sin] })
            }
            Footprint::Rectangle { length, width } => {
                Shape::Parts(vec![convex(&rectangle_corners(*length, *width), &pose)])
            }
            Footprint::Polygon(polygon) => {
                Shape::Parts(polygon.parts().iter().map(|part| convex(part, &pose)).collect())
            }
        };
        Placed { centre, radius: footprint.bounding_radius(), shape }
    }

    /// True when the interiors overlap by more than touching.
    pub fn collides(&self, other: &Placed) -> bool {
        !self.discs_apart(other, 0.0) && self.any_pair(other, |a, b| separation(a, b) < -TOUCH_M)
    }

    /// True when the distance to `other` is less than `clearance` (m), touching allowed for.
    pub fn closer_than(&self, other: &Placed, clearance: f64) -> bool {
        if clearance <= 0.0 {
            return self.collides(other);
        }
        !self.discs_apart(other, clearance) && self.any_pair(other, |a, b| gap(a, b) < clearance - TOUCH_M)
    }

    /// Distance between the two, m; 0 when they touch or overlap.
    pub fn distance(&self, other: &Placed) -> f64 {
        let mut least = f64::INFINITY;
        self.any_pair(other, |a, b| {
            least = least.min(gap(a, b));
            false
        });
        least.max(0.0)
    }

    /// How deep the two overlap, m; 0 when they touch or are apart.
    ///
    /// For convex shapes this is the shortest translation that parts them. For others it is the largest such
    /// value over the pairs of convex parts: exact while the overlap stays within one pair of parts, and
    /// never more than the shortest translation.
    pub fn penetration(&self, other: &Placed) -> f64 {
        if self.discs_apart(other, 0.0) {
            return 0.0;
        }
        let mut deepest: f64 = 0.0;
        self.any_pair(other, |a, b| {
            deepest = deepest.max(depth(a, b));
            false
        });
        if deepest <= TOUCH_M { 0.0 } else { deepest }
    }

    /// Least and largest x of the disc about it, m.
    pub fn span_x(&self) -> [f64; 2] {
        [self.centre[0] - self.radius, self.centre[0] + self.radius]
    }

    fn discs_apart(&self, other: &Placed, clearance: f64) -> bool {
        let reach = self.radius + other.radius + clearance;
        let (dx, dy) = (self.centre[0] - other.centre[0], self.centre[1] - other.centre[1]);
        dx * dx + dy * dy >= reach * reach
    }

    fn any_pair(&self, other: &Placed, mut test: impl FnMut(Part, Part) -> bool) -> bool {
        for i in 0..self.part_count() {
            for j in 0..other.part_count() {
                if test(self.part(i), other.part(j)) {
                    return true;
                }
            }
        }
        false
    }

    fn part_count(&self) -> usize {
        match &self.shape {
            Shape::Parts(parts) => parts.len(),
            Shape::Disc(_) | Shape::Ellipse(_) => 1,
        }
    }

    fn part(&self, index: usize) -> Part<'_> {
        match &self.shape {
            Shape::Disc(radius) => Part::Disc(self.centre, *radius),
            Shape::Ellipse(ellipse) => Part::Ellipse(*ellipse),
            Shape::Parts(parts) => Part::Convex(&parts[index]),
        }
    }
}

/// True when the two footprints overlap by more than touching.
pub fn collides(a: &Footprint, pose_a: &Pose2, b: &Footprint, pose_b: &Pose2) -> bool {
    Placed::new(a, *pose_a).collides(&Placed::new(b, *pose_b))
}

/// True when the two footprints are nearer to each other than `clearance`, m.
pub fn closer_than(a: &Footprint, pose_a: &Pose2, b: &Footprint, pose_b: &Pose2, clearance: f64) -> bool {
    Placed::new(a, *pose_a).closer_than(&Placed::new(b, *pose_b), clearance)
}

/// Depth of the overlap, m; see [`Placed::penetration`].
pub fn penetration(a: &Footprint, pose_a: &Pose2, b: &Footprint, pose_b: &Pose2) -> f64 {
    Placed::new(a, *pose_a).penetration(&Placed::new(b, *pose_b))
}

/// Distance, m; 0 when they touch or overlap.
pub fn distance_between(a: &Footprint, pose_a: &Pose2, b: &Footprint, pose_b: &Pose2) -> f64 {
    Placed::new(a, *pose_a).distance(&Placed::new(b, *pose_b))
}

/// How far a placed footprint reaches over the edge of a `width` x `height` table, m; 0 when it is inside.
pub fn overhang(footprint: &Footprint, pose: &Pose2, width: f64, height: f64) -> f64 {
    let (low, high) = footprint.bounds(pose);
    let most = (-low[0]).max(-low[1]).max(high[0] - width).max(high[1] - height);
    if most <= 0.0 { 0.0 } else { most }
}

/// True when the footprint lies on the table; overhang up to touching is allowed.
pub fn inside(footprint: &Footprint, pose: &Pose2, width: f64, height: f64) -> bool {
    overhang(footprint, pose, width, height) <= TOUCH_M
}

#[derive(Clone, Copy)]
enum Part<'a> {
    Disc(Point, f64),
    Ellipse(PlacedEllipse),
    Convex(&'a Convex),
}

fn convex(corners: &[Point], pose: &Pose2) -> Convex {
    let corners: Vec<Point> = corners.iter().map(|p| pose.transform(*p)).collect();
    let n = corners.len();
    let normals = (0..n)
        .map(|i| {
            let edge = sub(corners[(i + 1) % n], corners[i]);
            let length = edge[0].hypot(edge[1]);
            [edge[1] / length, -edge[0] / length]
        })
        .collect();
    Convex { corners, normals }
}

fn disc_as_ellipse(centre: Point, radius: f64) -> PlacedEllipse {
    PlacedEllipse { centre, semi: [radius, radius], turn: [1.0, 0.0] }
}

/// Signed separation of two convex parts along the best axis known, m. Its sign is exact; its size is exact
/// at zero, and a lower bound of the distance when positive.
fn separation(a: Part, b: Part) -> f64 {
    match (a, b) {
        (Part::Disc(p, r), Part::Disc(q, s)) => distance(p, q) - r - s,
        (Part::Disc(p, r), Part::Convex(c)) | (Part::Convex(c), Part::Disc(p, r)) => {
            signed_distance(c, p) - r
        }
        (Part::Convex(c), Part::Convex(d)) => axis_separation(c, d).max(axis_separation(d, c)),
        (Part::Ellipse(e), Part::Convex(c)) | (Part::Convex(c), Part::Ellipse(e)) => {
            e.separation_from_convex(&c.corners).0
        }
        (Part::Ellipse(e), Part::Ellipse(f)) => e.separation_from_ellipse(&f).0,
        (Part::Ellipse(e), Part::Disc(p, r)) | (Part::Disc(p, r), Part::Ellipse(e)) => {
            e.separation_from_ellipse(&disc_as_ellipse(p, r)).0
        }
    }
}

/// Largest gap between the two along a normal of `a` (separating axis test; negative: overlap along all).
fn axis_separation(a: &Convex, b: &Convex) -> f64 {
    let mut best = f64::NEG_INFINITY;
    for (corner, normal) in a.corners.iter().zip(&a.normals) {
        let base = dot(*corner, *normal);
        let nearest = b.corners.iter().map(|p| dot(*p, *normal)).fold(f64::INFINITY, f64::min);
        best = best.max(nearest - base);
        if best > 0.0 {
            return best;
        }
    }
    best
}

/// Distance of a point to a convex polygon, negative inside, m.
fn signed_distance(c: &Convex, p: Point) -> f64 {
    let n = c.corners.len();
    let inner = (0..n).map(|i| dot(sub(p, c.corners[i]), c.normals[i])).fold(f64::NEG_INFINITY, f64::max);
    if inner <= 0.0 {
        return inner;
    }
    (0..n)
        .map(|i| distance(p, closest_on_segment(p, c.corners[i], c.corners[(i + 1) % n])))
        .fold(f64::INFINITY, f64::min)
}

/// Distance of two convex parts, m; 0 or negative when they overlap.
fn gap(a: Part, b: Part) -> f64 {
    let quick = separation(a, b);
    if quick <= 0.0 {
        return quick;
    }
    match (a, b) {
        (Part::Convex(c), Part::Convex(d)) => corner_distance(c, d).min(corner_distance(d, c)),
        (Part::Disc(..), Part::Disc(..) | Part::Convex(_)) | (Part::Convex(_), Part::Disc(..)) => quick,
        (Part::Ellipse(_), _) | (_, Part::Ellipse(_)) => best_direction(a, b),
    }
}

/// Least distance of the corners of `a` to the edges of `b`.
fn corner_distance(a: &Convex, b: &Convex) -> f64 {
    let n = b.corners.len();
    let mut least = f64::INFINITY;
    for p in &a.corners {
        for i in 0..n {
            least = least.min(distance(*p, closest_on_segment(*p, b.corners[i], b.corners[(i + 1) % n])));
        }
    }
    least
}

/// Depth of the overlap of two convex parts, m; negative or 0 when they are apart.
fn depth(a: Part, b: Part) -> f64 {
    let quick = -separation(a, b);
    if quick <= 0.0 {
        return quick;
    }
    match (a, b) {
        (Part::Ellipse(_), _) | (_, Part::Ellipse(_)) => -best_direction(a, b),
        _ => quick,
    }
}

/// How far `b` lies beyond `a` along the unit vector `n`, m: the separation of their supports.
fn along(a: Part, b: Part, n: Point) -> f64 {
    low(b, n) - high(a, n)
}

fn high(part: Part, n: Point) -> f64 {
    match part {
        Part::Disc(centre, radius) => dot(centre, n) + radius,
        Part::Ellipse(ellipse) => dot(ellipse.centre, n) + ellipse.reach(n),
        Part::Convex(c) => c.corners.iter().map(|p| dot(*p, n)).fold(f64::NEG_INFINITY, f64::max),
    }
}

fn low(part: Part, n: Point) -> f64 {
    -high(part, [-n[0], -n[1]])
}

/// Directions scanned before the best one is refined; between two of them the support functions of shapes
/// with aspect ratios up to about 20 have one maximum.
const DIRECTIONS: usize = 96;

/// The largest separation over all directions: the distance when positive, minus the penetration otherwise.
fn best_direction(a: Part, b: Part) -> f64 {
    let value = |angle: f64| along(a, b, [angle.cos(), angle.sin()]);
    let step = TAU / DIRECTIONS as f64;
    let mut best = (0.0, f64::NEG_INFINITY);
    for k in 0..DIRECTIONS {
        let angle = step * k as f64;
        let at = value(angle);
        if at > best.1 {
            best = (angle, at);
        }
    }
    golden_maximum(&value, best.0 - step, best.0 + step).max(best.1)
}

/// Largest value of a function with one maximum in the interval (golden-section search).
fn golden_maximum(value: &dyn Fn(f64) -> f64, low: f64, high: f64) -> f64 {
    let ratio = (5.0f64.sqrt() - 1.0) / 2.0;
    let (mut low, mut high) = (low, high);
    let (mut a, mut b) = (high - ratio * (high - low), low + ratio * (high - low));
    let (mut at_a, mut at_b) = (value(a), value(b));
    for _ in 0..48 {
        if at_a > at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - ratio * (high - low);
            at_a = value(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + ratio * (high - low);
            at_b = value(b);
        }
    }
    at_a.max(at_b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shapes() -> Vec<Footprint> {
        vec![
            Footprint::rectangle(0.2, 0.1).expect("valid"),
            Footprint::disc(0.06).expect("valid"),
            Footprint::ellipse(0.24, 0.1).expect("valid"),
            Footprint::polygon(&[
                [0.0, 0.0],
                [0.2, 0.0],
                [0.2, 0.05],
                [0.05, 0.05],
                [0.05, 0.15],
                [0.0, 0.15],
            ])
            .expect("valid"),
        ]
    }

    /// Moves `b` along x until the bisection finds where the collision begins.
    fn touch_along_x(a: &Footprint, b: &Footprint, theta: f64, y: f64) -> f64 {
        let (mut hit, mut free) = (0.0, 1.0);
        let placed = Placed::new(a, Pose2::new(0.0, 0.0, 0.3));
        for _ in 0..60 {
            let middle = 0.5 * (hit + free);
            if placed.collides(&Placed::new(b, Pose2::new(middle, y, theta))) {
                hit = middle;
            } else {
                free = middle;
            }
        }
        free
    }

    #[test]
    fn distance_and_depth_agree_with_the_contact_for_all_pairs() {
        for a in shapes() {
            for b in shapes() {
                for k in 0..7 {
                    let theta = 0.9 * k as f64;
                    let x = touch_along_x(&a, &b, theta, 0.01);
                    let at = |dx: f64| Placed::new(&b, Pose2::new(x + dx, 0.01, theta));
                    let placed = Placed::new(&a, Pose2::new(0.0, 0.0, 0.3));
                    assert!(placed.distance(&at(0.0)) < 1e-8, "{a:?} {b:?} {theta}");
                    let (gap, deep) = (placed.distance(&at(1e-4)), placed.penetration(&at(-1e-4)));
                    assert!(gap > 1e-6 && gap <= 1.0001e-4, "{a:?} {b:?} {theta}: {gap}");
                    assert!(deep > 1e-6 && deep <= 1.0001e-4, "{a:?} {b:?} {theta}: {deep}");
                    assert!(
                        placed.closer_than(&at(1e-4), 1.1 * gap) && !placed.closer_than(&at(1e-4), 0.9 * gap)
                    );
                }
            }
        }
    }

    #[test]
    fn touching_is_no_collision() {
        let square = Footprint::rectangle(0.1, 0.1).expect("valid");
        let at = |x: f64| Pose2::new(x, 0.0, 0.0);
        assert!(!collides(&square, &at(0.0), &square, &at(0.1)));
        assert!(collides(&square, &at(0.0), &square, &at(0.1 - 1e-8)));
        assert!(collides(&square, &at(0.0), &square, &at(0.0)));
        assert_eq!(penetration(&square, &at(0.0), &square, &at(0.1)), 0.0);
        assert!((penetration(&square, &at(0.0), &square, &at(0.09)) - 0.01).abs() < 1e-12);
    }

    #[test]
    fn a_disc_in_the_bay_of_an_l_is_free() {
        let l = &shapes()[3];
        let disc = Footprint::disc(0.04).expect("valid");
        assert!(!collides(l, &Pose2::default(), &disc, &Pose2::new(0.09, 0.09, 0.0)));
        assert!(collides(l, &Pose2::default(), &disc, &Pose2::new(0.085, 0.09, 0.0)));
    }

    #[test]
    fn the_edge_of_the_table_counts_like_an_object() {
        let disc = Footprint::disc(0.1).expect("valid");
        assert!(inside(&disc, &Pose2::new(0.1, 0.1, 0.0), 1.0, 1.0));
        assert!(!inside(&disc, &Pose2::new(0.1 - 1e-6, 0.1, 0.0), 1.0, 1.0));
        assert!((overhang(&disc, &Pose2::new(0.95, 0.5, 0.0), 1.0, 1.0) - 0.05).abs() < 1e-12);
    }
}
