//! Convex shapes of the cell's bodies, and how far apart two of them are.
//!
//! In: segments and point sets with a radius round them, half-spaces, poses in one frame. Out: distances,
//! m; zero or less where two overlap. `parry3d` computes them; this file is the border to its vector types.
//! Pure.

use glamx::DPose3;
use nalgebra::Isometry3;
use parry3d_f64::math::{Pose, Vector};
use parry3d_f64::query::details::distance_segment_segment;
use parry3d_f64::query::gjk::{CsoPoint, GJKResult, VoronoiSimplex, closest_points};
use parry3d_f64::shape::{Segment, SupportMap};
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Corners of the prism that contains a cylinder.
const CYLINDER_CORNERS: usize = 24;

/// Corners of the prism that contains a disc or an ellipse: 2 % wider.
const CURVE_CORNERS: usize = 16;

/// Cores that are nearer than this meet, m.
const TOUCHING_M: f64 = 1e-6;

/// The convex hull of some points.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
struct Hull(Vec<Vector>);

impl SupportMap for Hull {
    fn local_support_point(&self, direction: Vector) -> Vector {
        let mut best = Vector::ZERO;
        let mut most = f64::NEG_INFINITY;
        for point in &self.0 {
            let along = point.dot(direction);
            if along > most {
                (best, most) = (*point, along);
            }
        }
        best
    }
}

#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
enum Core {
    Segment(Segment),
    Hull(Hull),
    /// Everything on the side of the origin that `normal` points away from.
    HalfSpace {
        normal: Vector,
        offset: f64,
    },
}

/// A convex shape in the frame of what it belongs to: a core, and everything within `radius` of it.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct Shape {
    core: Core,
    radius: f64,
    /// A sphere round all of it; a half-space has none.
    centre: Vector,
    reach: f64,
}

/// A shape for a drawing: everything within `radius` (m) of the convex hull of `points`.
#[derive(Clone, Debug, PartialEq)]
pub struct Outline {
    /// Two of a capsule.
    pub points: Vec<[f64; 3]>,
    /// m.
    pub radius: f64,
}

impl Shape {
    /// Its points and their radius; `None` for a half-space, which has no end.
    pub fn outline(&self) -> Option<Outline> {
        let points = match &self.core {
            Core::Segment(segment) => vec![segment.a.into(), segment.b.into()],
            Core::Hull(hull) => hull.0.iter().map(|point| (*point).into()).collect(),
            Core::HalfSpace { .. } => return None,
        };
        Some(Outline { points, radius: self.radius })
    }

    /// Everything within `radius` (m) of a segment.
    pub fn capsule(a: [f64; 3], b: [f64; 3], radius: f64) -> Shape {
        let (a, b) = (Vector::from(a), Vector::from(b));
        let reach = 0.5 * (b - a).length() + radius;
        Shape { core: Core::Segment(Segment::new(a, b)), radius, centre: 0.5 * (a + b), reach }
    }

    /// The convex hull of points (m), and everything within `radius` of it.
    /// One without points, or with one that is no number, is too near to everything.
    pub fn hull(points: impl IntoIterator<Item = [f64; 3]>, radius: f64) -> Shape {
        let points: Vec<Vector> = points.into_iter().map(Vector::from).collect();
        let sound = !points.is_empty() && points.iter().all(|point| point.is_finite());
        let radius = if sound { radius } else { f64::NAN };
        let low = points.iter().fold(Vector::INFINITY, |low, point| low.min(*point));
        let high = points.iter().fold(Vector::NEG_INFINITY, |high, point| high.max(*point));
        let centre = 0.5 * (low + high);
        let farthest = points.iter().map(|point| (*point - centre).length()).fold(0.0, f64::max);
        Shape { core: Core::Hull(Hull(points)), radius, centre, reach: farthest + radius }
    }

    /// A box with these edges (m) about the origin of `frame`.
    pub fn cuboid(size: [f64; 3], frame: &Isometry3<f64>) -> Shape {
        let signs = [-0.5, 0.5];
        let corners = signs.iter().flat_map(|x| signs.iter().flat_map(move |y| signs.map(|z| [*x, *y, z])));
        let corner = |share: [f64; 3]| {
            let local = nalgebra::Point3::from([0, 1, 2].map(|i: usize| share[i] * size[i]));
            (frame * local).into()
        };
        Shape::hull(corners.map(corner), 0.0)
    }

    /// A cylinder along z of `frame`, from its origin up; the prism that contains it.
    pub fn cylinder(radius: f64, height: f64, frame: &Isometry3<f64>) -> Shape {
        let corners = CYLINDER_CORNERS as f64;
        let outer = radius / (PI / corners).cos();
        let ring = (0..CYLINDER_CORNERS).map(move |k| {
            let (sin, cos) = (TAU * k as f64 / corners).sin_cos();
            [outer * cos, outer * sin]
        });
        let ends = ring.flat_map(|[x, y]| [[x, y, 0.0], [x, y, height]]);
        Shape::hull(ends.map(|point| (frame * nalgebra::Point3::from(point)).into()), 0.0)
    }

    /// What lies behind a plane through `point` whose `normal` points to where the arm may be.
    pub fn half_space(point: [f64; 3], normal: [f64; 3]) -> Shape {
        let normal = Vector::from(normal).normalize();
        let offset = normal.dot(Vector::from(point));
        let core = Core::HalfSpace { normal, offset };
        Shape { core, radius: 0.0, centre: Vector::ZERO, reach: f64::INFINITY }
    }

    /// The convex hull of a footprint at `pose`, from `low` to `high` (m), seen in `frame`.
    pub fn prism(
        footprint: &Footprint,
        pose: &Pose2,
        (low, high): (f64, f64),
        frame: &Isometry3<f64>,
    ) -> Shape {
        let outline = corners(footprint).into_iter().map(|point| pose.transform(point));
        let ends = outline.flat_map(|[x, y]| [[x, y, low], [x, y, high]]);
        Shape::hull(ends.map(|point| (frame * nalgebra::Point3::from(point)).into()), 0.0)
    }

    /// The same shape, wider by `more` (m) on all sides.
    pub fn widened(mut self, more: f64) -> Shape {
        self.radius += more;
        self.reach += more;
        if let Core::HalfSpace { offset, .. } = &mut self.core {
            *offset += more;
        }
        self
    }

    /// How far its farthest point is from the origin of its frame, m.
    pub fn farthest(&self) -> f64 {
        self.centre.length() + self.reach
    }

    /// Radius round its core, m.
    pub fn thickness(&self) -> f64 {
        self.radius
    }

    /// The part of a unit motion along the plane of a half-space that counts: how far its normal is from
    /// `axis`, as a sine; 1 for all other shapes.
    pub fn across(&self, axis: [f64; 3]) -> f64 {
        match &self.core {
            Core::HalfSpace { normal, .. } => normal.cross(Vector::from(axis)).length(),
            Core::Segment(_) | Core::Hull(_) => 1.0,
        }
    }

    /// Radius of the ball round its middle that holds all of it, m; infinite for a half-space.
    pub fn reach(&self) -> f64 {
        self.reach
    }

    /// The point of its frame round which it lies; the origin for a half-space.
    pub fn middle(&self) -> Vector {
        self.centre
    }
}

/// Corners that contain a footprint, few of them: distances cost by the corner.
fn corners(footprint: &Footprint) -> Vec<[f64; 2]> {
    let [a, b] = match footprint {
        Footprint::Disc { radius } => [*radius, *radius],
        Footprint::Ellipse { length, width } => [length / 2.0, width / 2.0],
        Footprint::Rectangle { .. } | Footprint::Polygon(_) => return footprint.outline(0),
    };
    let count = CURVE_CORNERS as f64;
    let grown = 1.0 / (PI / count).cos();
    let corner = |k: usize| {
        let (sin, cos) = (TAU * k as f64 / count).sin_cos();
        [a * grown * cos, b * grown * sin]
    };
    (0..CURVE_CORNERS).map(corner).collect()
}

/// A pose as `parry3d` takes it.
pub fn placed(pose: &Isometry3<f64>) -> Pose {
    DPose3::from(*pose)
}

/// A distance that two shapes surely have, m, with their middles at these places: that of the spheres round
/// them; negative infinity for a half-space.
pub fn surely_apart(a: &Shape, a_middle: Vector, b: &Shape, b_middle: Vector) -> f64 {
    (a_middle - b_middle).length() - a.reach - b.reach
}

/// Distance of two shapes, m; where their cores meet, minus both radii and a hair.
pub fn apart(a: &Shape, a_at: &Pose, b: &Shape, b_at: &Pose) -> f64 {
    let mut direction = Vector::ZERO;
    apart_from(a, a_at, b, b_at, &mut direction)
}

/// The same with the direction, in the frame of `a`, in which `b` was found last: from there the search
/// takes fewer steps. Zero where it is not known. Afterwards it is that of the line between the nearest
/// points, along which the two are so far apart, or zero.
pub fn apart_from(a: &Shape, a_at: &Pose, b: &Shape, b_at: &Pose, towards: &mut Vector) -> f64 {
    let between = a_at.inv_mul(b_at);
    if *towards == Vector::ZERO {
        *towards = between * b.centre - a.centre;
    }
    let cores = match (&a.core, &b.core) {
        (Core::Segment(one), Core::Segment(other)) => {
            *towards = Vector::ZERO;
            distance_segment_segment(&between, one, other)
        }
        (Core::Segment(one), Core::Hull(other)) => nearest(&between, one, other, towards),
        (Core::Hull(one), Core::Segment(other)) => nearest(&between, one, other, towards),
        (Core::Hull(one), Core::Hull(other)) => nearest(&between, one, other, towards),
        (Core::HalfSpace { normal, offset }, _) => {
            *towards = *normal;
            over(*normal, *offset, b, &between)
        }
        (_, Core::HalfSpace { normal, offset }) => {
            *towards = between.rotation * -*normal;
            over(*normal, *offset, a, &between.inverse())
        }
    };
    // How deep cores lie in each other is not computed: that they meet is enough.
    let cores = if cores > TOUCHING_M { cores } else { cores.min(-TOUCHING_M) };
    cores - a.radius - b.radius
}

/// Distance of two cores, m, 0 where they meet, by the algorithm of Gilbert, Johnson and Keerthi.
fn nearest(between: &Pose, one: &impl SupportMap, other: &impl SupportMap, towards: &mut Vector) -> f64 {
    let first = towards.try_normalize().unwrap_or(Vector::X);
    let mut simplex = VoronoiSimplex::new();
    simplex.reset(CsoPoint::from_shapes(between, one, other, first));
    match closest_points(between, one, other, f64::MAX, true, &mut simplex) {
        GJKResult::ClosestPoints(from, to, _) => {
            *towards = to - from;
            towards.length()
        }
        // Without a bound on the distance the search never ends early; where it does not converge, the two
        // are taken to meet.
        GJKResult::Intersection | GJKResult::Proximity(_) | GJKResult::NoIntersection(_) => {
            *towards = Vector::ZERO;
            0.0
        }
    }
}

/// True where a distance that [`apart`] has found says how deep the two overlap: not where their cores meet,
/// unless one is a half-space.
pub fn depth_is_known(a: &Shape, b: &Shape, distance: f64) -> bool {
    let plane = [a, b].iter().any(|shape| matches!(shape.core, Core::HalfSpace { .. }));
    (plane && !distance.is_nan()) || distance > -(a.radius + b.radius)
}

/// The lowest point of a shape over a plane, m; `plane_from_shape` places it.
fn over(normal: Vector, offset: f64, shape: &Shape, plane_from_shape: &Pose) -> f64 {
    let height = |point: Vector| normal.dot(*plane_from_shape * point) - offset;
    match &shape.core {
        Core::Segment(segment) => height(segment.a).min(height(segment.b)),
        Core::Hull(Hull(points)) => points.iter().map(|point| height(*point)).fold(f64::INFINITY, f64::min),
        // Two of them never move against each other.
        Core::HalfSpace { .. } => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn at(x: f64, y: f64, z: f64) -> Pose {
        placed(&Isometry3::translation(x, y, z))
    }

    #[test]
    fn distances_are_those_of_the_drawing() {
        let block = Shape::cuboid([0.2, 0.2, 0.2], &Isometry3::identity());
        let post = Shape::capsule([0.0; 3], [0.0, 0.0, 1.0], 0.05);
        assert!((apart(&block, &at(0.0, 0.0, 0.0), &post, &at(0.3, 0.0, -0.5)) - 0.15).abs() < 1e-9);
        assert!((apart(&post, &at(0.0, 0.0, 0.0), &post, &at(0.3, 0.0, 0.0)) - 0.2).abs() < 1e-9);
        assert!(apart(&block, &at(0.0, 0.0, 0.0), &post, &at(0.1, 0.0, -0.5)) <= -0.05);
        assert!(
            apart(&block, &at(0.0, 0.0, 0.0), &block, &at(0.1, 0.0, 0.0)) < 0.0,
            "no radius between them"
        );
        let table = Shape::half_space([0.0, 0.0, 0.1], [0.0, 0.0, 2.0]);
        assert!((apart(&table, &at(0.0, 0.0, 0.0), &post, &at(5.0, 0.0, 0.3)) - 0.15).abs() < 1e-12);
        assert!((apart(&post, &at(5.0, 0.0, 0.3), &table, &at(0.0, 0.0, 0.0)) - 0.15).abs() < 1e-12);
        let can = Shape::cylinder(0.1, 0.4, &Isometry3::identity());
        let beside = apart(&can, &at(0.0, 0.0, 0.0), &block, &at(0.3, 0.0, 0.2));
        assert!((0.099..=0.1).contains(&beside), "{beside}");
    }

    #[test]
    fn the_spheres_never_say_farther_than_the_shapes_are() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut number = |to: f64| random.random_range(-to..to);
        for _ in 0..2000 {
            let mut point = |to: f64| [number(to), number(to), number(to)];
            let turn = nalgebra::Vector3::from(point(3.0));
            let pose = placed(&Isometry3::new(nalgebra::Vector3::from(point(1.0)), turn));
            let a = Shape::capsule(point(0.3), point(0.3), 0.05);
            let b = Shape::hull((0..6).map(|_| point(0.3)).collect::<Vec<_>>(), 0.01);
            let (sure, found) =
                (surely_apart(&a, a.middle(), &b, pose * b.middle()), apart(&a, &Pose::IDENTITY, &b, &pose));
            assert!(sure <= found + 1e-9 || found <= -0.05, "{sure} {found}");
        }
    }

    /// A distance that the two surely have, and one that they surely do not exceed, m, by nothing but their
    /// points: the point nearest to the origin in the set of all differences, approached one straight line
    /// at a time (Gilbert, "An iterative procedure for computing the minimum of a quadratic form on a convex
    /// set", 1966).
    fn bounds(a: &Shape, b: &Shape, b_at: &Pose) -> [f64; 2] {
        let points = |shape: &Shape| match &shape.core {
            Core::Segment(segment) => vec![segment.a, segment.b],
            Core::Hull(Hull(points)) => points.clone(),
            Core::HalfSpace { .. } => Vec::new(),
        };
        let ones = points(a);
        let others: Vec<Vector> = points(b).into_iter().map(|point| *b_at * point).collect();
        let least = |of: &[Vector], along: Vector| {
            of.iter().copied().min_by(|p, q| along.dot(*p).total_cmp(&along.dot(*q))).expect("points")
        };
        let (mut nearest, mut sure) = (others[0] - ones[0], f64::NEG_INFINITY);
        for _ in 0..20_000 {
            let corner = least(&others, nearest) - least(&ones, -nearest);
            sure = sure.max(nearest.dot(corner) / nearest.length());
            if nearest.length() - sure < 1e-4 || nearest.length() < 1e-4 {
                break;
            }
            let way = corner - nearest;
            nearest += way * (-nearest.dot(way) / way.length_squared()).clamp(0.0, 1.0);
        }
        [sure, nearest.length()].map(|distance| distance - a.radius - b.radius)
    }

    #[test]
    fn distances_lie_between_two_bounds_found_by_another_method() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let mut separate = 0;
        for case in 0..2000 {
            let mut point = |to: f64| [0, 1, 2].map(|_| random.random_range(-to..to));
            let turn = nalgebra::Vector3::from(point(3.0));
            let pose = placed(&Isometry3::new(nalgebra::Vector3::from(point(0.4)), turn));
            let frame = Isometry3::new(nalgebra::Vector3::from(point(0.1)), turn.yxz());
            let (a, b) = match case % 4 {
                0 => (
                    Shape::capsule(point(0.3), point(0.3), 0.05),
                    Shape::hull((0..6).map(|_| point(0.3)).collect::<Vec<_>>(), 0.01),
                ),
                1 => (
                    Shape::cuboid([0.16, 0.05, 0.02], &frame),
                    Shape::cylinder(0.02, 0.15, &Isometry3::identity()),
                ),
                2 => (Shape::cuboid([0.5, 0.5, 0.001], &frame), Shape::capsule(point(0.3), point(0.3), 0.04)),
                _ => (
                    Shape::cuboid([0.5, 0.5, 0.035], &Isometry3::identity()),
                    Shape::cuboid([0.07, 0.07, 0.12], &frame),
                ),
            };
            let found = apart(&a, &Pose::IDENTITY, &b, &pose);
            let [sure, most] = bounds(&a, &b, &pose);
            assert!(found <= most + 1e-9, "case {case}: {found}, at most {most}");
            // Where the cores are apart it is not nearer than they are either.
            if sure > 0.0 {
                separate += 1;
                assert!(found >= sure - 1e-9, "case {case}: {found}, surely {sure}");
            }
        }
        assert!(separate > 700, "{separate}");
    }
}
