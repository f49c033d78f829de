//! The exact free region of a footprint at one angle, by no-fit polygons, and its corners as places to park.
//!
//! In: convex outlines of what is on the table. Out: positions at which the outline touches two of these, or
//! one and the table's edge: the vertices of the free region, where a parked object wastes the least room.
//! The positions that a convex obstacle forbids are its Minkowski sum with the mirrored outline; of
//! non-convex shapes every convex part counts, so that bays are used. Curves count as circumscribed
//! polygons, so a position is a proposal that `scene` has the last word on, and where curves decide, some
//! places are missed.

use crate::geometry::footprint::Footprint;
use crate::geometry::polygon::{Point, convex_hull, cross, sub};
use crate::geometry::pose::Pose2;
use crate::planning::effort::Watch;
use std::f64::consts::TAU;

/// Corners of the polygon about a curve: 2 % of the radius is given away at most.
const CURVE_CORNERS: usize = 16;

/// A position this far inside a forbidden polygon touches it, m.
const TOUCH_M: f64 = 1e-9;

/// The convex parts of a footprint in the object's frame, counter-clockwise, each held off by `clearance`
/// all round.
pub fn convex_parts(footprint: &Footprint, clearance: f64) -> Vec<Vec<Point>> {
    let curve = |a: f64, b: f64| {
        let grown = 1.0 / (TAU / 2.0 / CURVE_CORNERS as f64).cos();
        let angle = |k: usize| TAU * k as f64 / CURVE_CORNERS as f64;
        (0..CURVE_CORNERS).map(|k| [a * grown * angle(k).cos(), b * grown * angle(k).sin()]).collect()
    };
    let parts = match footprint {
        Footprint::Disc { radius } => vec![curve(*radius, *radius)],
        Footprint::Ellipse { length, width } => vec![curve(length / 2.0, width / 2.0)],
        Footprint::Rectangle { .. } => vec![convex_hull(&footprint.outline(0))],
        // Cut anew, for corners in a line would have no mitre.
        Footprint::Polygon(polygon) => polygon.parts().iter().map(|part| convex_hull(part)).collect(),
    };
    if clearance > 0.0 { parts.iter().map(|part| held_off(part, clearance)).collect() } else { parts }
}

/// Every edge moved outwards, the corners mitred.
fn held_off(hull: &[Point], by: f64) -> Vec<Point> {
    let n = hull.len();
    let unit = |k: usize| {
        let edge = sub(hull[(k + 1) % n], hull[k % n]);
        let length = edge[0].hypot(edge[1]);
        [edge[0] / length, edge[1] / length]
    };
    let corner = |k: usize| {
        let (before, after) = (unit(k + n - 1), unit(k));
        let share = by / (1.0 + before[0] * after[0] + before[1] * after[1]);
        let out = [before[1] + after[1], -before[0] - after[0]];
        [hull[k][0] + share * out[0], hull[k][1] + share * out[1]]
    };
    (0..n).map(corner).collect()
}

/// An outline at a pose.
pub fn placed(outline: &[Point], pose: &Pose2) -> Vec<Point> {
    let (sin, cos) = pose.theta.sin_cos();
    outline.iter().map(|p| [pose.x + cos * p[0] - sin * p[1], pose.y + sin * p[0] + cos * p[1]]).collect()
}

/// A convex polygon that the position may not be inside of.
struct NoFit {
    corners: Vec<Point>,
    low: Point,
    high: Point,
}

impl NoFit {
    /// Of an obstacle, for a mover whose outline at its angle, mirrored through its origin, is `mirrored`.
    fn new(obstacle: &[Point], mirrored: &[Point]) -> NoFit {
        let corners = minkowski_sum(obstacle, mirrored);
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in &corners {
            for k in 0..2 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        NoFit { corners, low, high }
    }

    fn forbids(&self, p: Point) -> bool {
        let inside_box = (0..2).all(|k| p[k] > self.low[k] && p[k] < self.high[k]);
        inside_box
            && edges(&self.corners).all(|(a, b)| {
                let edge = sub(b, a);
                let side = cross(edge, sub(p, a));
                side > 0.0 && side * side > TOUCH_M * TOUCH_M * (edge[0] * edge[0] + edge[1] * edge[1])
            })
    }

    /// Where the segment from `a` to `b` crosses the outline.
    fn crossings(&self, a: Point, b: Point, found: &mut Vec<Point>) {
        let apart = (0..2).any(|k| a[k].max(b[k]) < self.low[k] || a[k].min(b[k]) > self.high[k]);
        if apart {
            return;
        }
        let along = sub(b, a);
        let side = |p: Point| cross(along, sub(p, a));
        let Some(&last) = self.corners.last() else { return };
        let (mut c, mut side_c) = (last, side(last));
        for &d in &self.corners {
            let side_d = side(d);
            if (side_c <= 0.0) != (side_d <= 0.0) {
                found.extend(crossing(a, b, c, d));
            }
            (c, side_c) = (d, side_d);
        }
    }

    fn meets(&self, other: &NoFit) -> bool {
        (0..2).all(|k| self.low[k] <= other.high[k] && other.low[k] <= self.high[k])
    }
}

fn edges(corners: &[Point]) -> impl Iterator<Item = (Point, Point)> + '_ {
    corners.iter().copied().zip(corners.iter().copied().cycle().skip(1))
}

/// Sum of two convex counter-clockwise polygons, by merging their edges in the order of their directions.
fn minkowski_sum(a: &[Point], b: &[Point]) -> Vec<Point> {
    let lowest = |polygon: &[Point]| {
        let below = |p: &Point, q: &Point| p[1].total_cmp(&q[1]).then(p[0].total_cmp(&q[0]));
        (0..polygon.len()).min_by(|&i, &j| below(&polygon[i], &polygon[j])).unwrap_or(0)
    };
    let (first_a, first_b) = (lowest(a), lowest(b));
    let at = |polygon: &[Point], first: usize, k: usize| polygon[(first + k) % polygon.len()];
    let (mut i, mut j) = (0, 0);
    let mut sum = Vec::with_capacity(a.len() + b.len());
    while i < a.len() || j < b.len() {
        let (p, q) = (at(a, first_a, i), at(b, first_b, j));
        sum.push([p[0] + q[0], p[1] + q[1]]);
        let turn = cross(sub(at(a, first_a, i + 1), p), sub(at(b, first_b, j + 1), q));
        let (more_a, more_b) = (i < a.len(), j < b.len());
        i += usize::from(more_a && (turn >= 0.0 || !more_b));
        j += usize::from(more_b && (turn <= 0.0 || !more_a));
    }
    sum
}

/// Free positions of one footprint at one angle.
pub struct Region {
    forbidden: Vec<NoFit>,
    low: Point,
    high: Point,
}

impl Region {
    /// Positions between `low` and `high` (where the footprint is on the table) of a mover with these
    /// convex parts at its angle, among convex obstacles. None if it does not fit on the table, or where
    /// `watch` ends the work.
    pub fn new(
        mover: &[Vec<Point>],
        low: Point,
        high: Point,
        obstacles: impl Iterator<Item = Vec<Point>>,
        watch: &mut Watch,
    ) -> Option<Region> {
        let mirror = |part: &Vec<Point>| part.iter().map(|p| [-p[0], -p[1]]).collect();
        let mirrored: Vec<Vec<Point>> = mover.iter().map(mirror).collect();
        let corners: usize = mirrored.iter().map(Vec::len).sum();
        let mut forbidden = Vec::new();
        for obstacle in obstacles {
            if !watch.go_on((corners + mirrored.len() * obstacle.len()) as u64) {
                return None;
            }
            forbidden.extend(mirrored.iter().map(|part| NoFit::new(&obstacle, part)));
        }
        (low[0] <= high[0] && low[1] <= high[1]).then_some(Region { forbidden, low, high })
    }

    /// How many obstacles there are.
    pub fn obstacle_count(&self) -> usize {
        self.forbidden.len()
    }

    /// Corners of the free region on the table's corners.
    pub fn table_corners(&self) -> Vec<Point> {
        let corners = [self.low, [self.high[0], self.low[1]], self.high, [self.low[0], self.high[1]]];
        corners.into_iter().filter(|p| self.is_free(*p)).collect()
    }

    /// Corners of the free region on the outline of one obstacle's forbidden polygon; those found until
    /// `watch` ends the work.
    pub fn corners_at(&self, obstacle: usize, watch: &mut Watch) -> Vec<Point> {
        let mine = &self.forbidden[obstacle];
        let mut found = mine.corners.clone();
        for (a, b) in edges(&mine.corners) {
            self.crossings_with_bounds(a, b, &mut found);
        }
        for (at, other) in self.forbidden.iter().enumerate() {
            if at == obstacle || !mine.meets(other) {
                continue;
            }
            if !watch.go_on((mine.corners.len() * other.corners.len()) as u64) {
                return Vec::new();
            }
            for (a, b) in edges(&mine.corners) {
                other.crossings(a, b, &mut found);
            }
        }
        let ticks = self.forbidden.len() as u64;
        found.retain(|p| watch.go_on(ticks) && self.is_free(*p));
        found
    }

    fn crossings_with_bounds(&self, a: Point, b: Point, found: &mut Vec<Point>) {
        for axis in 0..2 {
            for bound in [self.low[axis], self.high[axis]] {
                if (a[axis] < bound) != (b[axis] < bound) {
                    let share = (bound - a[axis]) / (b[axis] - a[axis]);
                    let across = a[1 - axis] + share * (b[1 - axis] - a[1 - axis]);
                    found.push(if axis == 0 { [bound, across] } else { [across, bound] });
                }
            }
        }
    }

    fn is_free(&self, p: Point) -> bool {
        (0..2).all(|k| p[k] >= self.low[k] && p[k] <= self.high[k])
            && !self.forbidden.iter().any(|f| f.forbids(p))
    }
}

/// Where two segments cross; parallel ones do not.
fn crossing(a: Point, b: Point, c: Point, d: Point) -> Option<Point> {
    let (along, other) = (sub(b, a), sub(d, c));
    let across = cross(along, other);
    if across == 0.0 {
        return None;
    }
    let between = sub(c, a);
    let (s, t) = (cross(between, other) / across, cross(between, along) / across);
    let on_both = (0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t);
    on_both.then(|| [a[0] + s * along[0], a[1] + s * along[1]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sum_of_two_squares_is_a_square() {
        let square = |r: f64| vec![[-r, -r], [r, -r], [r, r], [-r, r]];
        assert_eq!(minkowski_sum(&square(1.0), &square(2.0)), square(3.0));
        let diamond = vec![[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]];
        assert_eq!(minkowski_sum(&square(1.0), &diamond).len(), 8);
    }

    fn region(
        mover: &[Vec<Point>],
        low: Point,
        high: Point,
        obstacles: impl Iterator<Item = Vec<Point>>,
    ) -> Option<Region> {
        Region::new(mover, low, high, obstacles, &mut Watch::new(&|| false))
    }

    fn all_corners(region: &Region) -> Vec<Point> {
        let mut watch = Watch::new(&|| false);
        (0..region.obstacle_count()).flat_map(|k| region.corners_at(k, &mut watch)).collect()
    }

    #[test]
    fn a_gap_of_exactly_the_right_width_is_found() {
        // Two walls leave a gap of 0.1 m; a square of 0.1 m fits at x = 0.5 only.
        let walls = [(0.0, 0.45), (0.55, 1.0)];
        let boxed = |(x0, x1): (f64, f64)| vec![[x0, 0.0], [x1, 0.0], [x1, 0.2], [x0, 0.2]];
        let mover = convex_parts(&Footprint::rectangle(0.1, 0.1).unwrap(), 0.0);
        let region = region(&mover, [0.05, 0.05], [0.95, 0.15], walls.into_iter().map(boxed));
        let found = all_corners(&region.unwrap());
        assert!(!found.is_empty());
        assert!(found.iter().all(|p| (p[0] - 0.5).abs() < 1e-9), "{found:?}");
    }

    #[test]
    fn a_bay_is_free() {
        // A square fits exactly into the bay of a U, and nowhere else in these bounds.
        let u =
            [[0.0, 0.0], [0.3, 0.0], [0.3, 0.2], [0.2, 0.2], [0.2, 0.1], [0.1, 0.1], [0.1, 0.2], [0.0, 0.2]];
        let obstacle = convex_parts(&Footprint::polygon(&u).unwrap(), 0.0);
        let mover = convex_parts(&Footprint::rectangle(0.1, 0.1).unwrap(), 0.0);
        let region = region(&mover, [0.05, 0.05], [0.25, 0.15], obstacle.into_iter());
        let found = all_corners(&region.unwrap());
        assert!(!found.is_empty());
        assert!(found.iter().all(|p| (p[0] - 0.15).abs() + (p[1] - 0.15).abs() < 1e-9), "{found:?}");
    }

    #[test]
    fn an_outline_held_off_keeps_the_clearance() {
        let parts = convex_parts(&Footprint::rectangle(0.2, 0.1).unwrap(), 0.01);
        let bounds = parts[0].iter().fold([0.0f64; 2], |b, p| [b[0].max(p[0]), b[1].max(p[1])]);
        assert!((bounds[0] - 0.11).abs() < 1e-12 && (bounds[1] - 0.06).abs() < 1e-12);
    }
}
