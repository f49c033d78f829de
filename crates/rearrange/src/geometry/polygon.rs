//! Simple polygons, convex or not: validation, area, and the convex parts that collision tests work on.
//!
//! In: points in either orientation, m. Out: a [`Polygon`] with points counter-clockwise, or a
//! [`PolygonFault`] that names the edges at fault. The parts come from an ear-cut triangulation whose
//! triangles are merged while they stay convex; their areas are checked to add up to the polygon's.

use geo::TriangulateEarcut;
use serde::{Deserialize, Serialize};

/// A point or vector in the plane, m.
pub type Point = [f64; 2];

/// Why points do not make a footprint.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PolygonFault {
    /// Fewer than three points.
    #[error("a polygon needs at least 3 points, this one has {0}")]
    TooFewPoints(usize),
    /// A coordinate is not a finite number.
    #[error("point {0} is not a finite pair of numbers")]
    NotFinite(usize),
    /// Two consecutive points coincide.
    #[error("points {0} and {1} coincide")]
    Coincident(usize, usize),
    /// Two edges cross or touch.
    #[error("the outline crosses itself: the edge from point {0} meets the edge from point {1}")]
    SelfCrossing(usize, usize),
    /// The polygon has no area to speak of.
    #[error("the polygon has no area")]
    NoArea,
    /// The triangulation failed to cover the polygon.
    #[error("the polygon could not be cut into convex parts")]
    NoParts,
}

/// A simple polygon, counter-clockwise, with its convex parts.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct Polygon {
    points: Vec<Point>,
    parts: Vec<Vec<Point>>,
}

impl Polygon {
    /// Checks the points and cuts them into convex parts.
    ///
    /// # Errors
    /// What is wrong with the outline; point numbers count from 0.
    pub fn new(points: &[Point]) -> Result<Polygon, PolygonFault> {
        if points.len() < 3 {
            return Err(PolygonFault::TooFewPoints(points.len()));
        }
        if let Some(bad) = points.iter().position(|p| !p[0].is_finite() || !p[1].is_finite()) {
            return Err(PolygonFault::NotFinite(bad));
        }
        let n = points.len();
        if let Some(i) = (0..n).find(|&i| distance(points[i], points[(i + 1) % n]) < 1e-9) {
            return Err(PolygonFault::Coincident(i, (i + 1) % n));
        }
        if let Some((i, j)) = crossing(points) {
            return Err(PolygonFault::SelfCrossing(i, j));
        }
        let mut points = points.to_vec();
        if signed_area(&points) < 0.0 {
            points.reverse();
        }
        let area = signed_area(&points);
        if area < 1e-12 {
            return Err(PolygonFault::NoArea);
        }
        let parts = convex_parts(&points);
        let covered: f64 = parts.iter().map(|part| signed_area(part)).sum();
        if (covered - area).abs() > 1e-9 * area {
            return Err(PolygonFault::NoParts);
        }
        Ok(Polygon { points, parts })
    }

    /// Corners, counter-clockwise.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// Convex parts, counter-clockwise; one if the polygon is convex.
    pub fn parts(&self) -> &[Vec<Point>] {
        &self.parts
    }

    /// Area, m2.
    pub fn area(&self) -> f64 {
        signed_area(&self.points)
    }
}

/// Area by the shoelace formula, positive when counter-clockwise, m2.
pub fn signed_area(points: &[Point]) -> f64 {
    let n = points.len();
    (0..n).map(|i| cross(points[i], points[(i + 1) % n])).sum::<f64>() / 2.0
}

/// Length of the closed outline, m.
pub fn perimeter(points: &[Point]) -> f64 {
    let n = points.len();
    (0..n).map(|i| distance(points[i], points[(i + 1) % n])).sum()
}

/// Centre of area.
pub fn centroid(points: &[Point]) -> Point {
    let n = points.len();
    let area = signed_area(points);
    let mut sum = [0.0; 2];
    for i in 0..n {
        let (p, q) = (points[i], points[(i + 1) % n]);
        let weight = cross(p, q) / (6.0 * area);
        sum = [sum[0] + (p[0] + q[0]) * weight, sum[1] + (p[1] + q[1]) * weight];
    }
    sum
}

/// Convex hull, counter-clockwise (Andrew's monotone chain).
pub fn convex_hull(points: &[Point]) -> Vec<Point> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let mut hull: Vec<Point> = Vec::with_capacity(sorted.len() * 2);
    let half = |hull: &mut Vec<Point>, points: &mut dyn Iterator<Item = Point>| {
        let start = hull.len();
        for p in points {
            while hull.len() >= start + 2 && turn(hull[hull.len() - 2], hull[hull.len() - 1], p) <= 0.0 {
                hull.pop();
            }
            hull.push(p);
        }
        hull.pop();
    };
    half(&mut hull, &mut sorted.iter().copied());
    half(&mut hull, &mut sorted.iter().rev().copied());
    hull
}

/// Distance of `p` to the closed outline, m.
pub fn distance_to_outline(points: &[Point], p: Point) -> f64 {
    let n = points.len();
    (0..n).map(|i| distance_to_segment(p, points[i], points[(i + 1) % n])).fold(f64::INFINITY, f64::min)
}

/// True when `p` is inside the simple polygon (crossing number; on the outline either answer may come).
pub fn contains(points: &[Point], p: Point) -> bool {
    let n = points.len();
    let mut inside = false;
    for i in 0..n {
        let (a, b) = (points[i], points[(i + 1) % n]);
        if (a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
            inside = !inside;
        }
    }
    inside
}

/// Distance of `p` to the segment from `a` to `b`, m.
pub fn distance_to_segment(p: Point, a: Point, b: Point) -> f64 {
    distance(p, closest_on_segment(p, a, b))
}

/// The point of the segment from `a` to `b` nearest to `p`.
pub fn closest_on_segment(p: Point, a: Point, b: Point) -> Point {
    let along = sub(b, a);
    let share = (dot(sub(p, a), along) / dot(along, along)).clamp(0.0, 1.0);
    [a[0] + share * along[0], a[1] + share * along[1]]
}

/// a - b.
pub fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

/// Scalar product.
pub fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// z of the vector product.
pub fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// Distance of two points, m.
pub fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Twice the area of the triangle a, b, c; positive for a left turn.
fn turn(a: Point, b: Point, c: Point) -> f64 {
    cross(sub(b, a), sub(c, a))
}

/// The first two edges that cross or touch without being neighbours.
fn crossing(points: &[Point]) -> Option<(usize, usize)> {
    let n = points.len();
    for i in 0..n {
        for j in i + 1..n {
            let neighbours = j == i + 1 || (i == 0 && j == n - 1);
            let (a, b) = (points[i], points[(i + 1) % n]);
            let (c, d) = (points[j], points[(j + 1) % n]);
            if neighbours {
                // Neighbours share one point; they are at fault if one folds back onto the other.
                let (shared, first, second) = if j == i + 1 { (b, a, d) } else { (a, b, c) };
                let (u, v) = (sub(first, shared), sub(second, shared));
                if cross(u, v).abs() < 1e-12 * dot(u, u).max(dot(v, v)) && dot(u, v) > 0.0 {
                    return Some((i, j));
                }
            } else if segments_meet(a, b, c, d) {
                return Some((i, j));
            }
        }
    }
    None
}

fn segments_meet(a: Point, b: Point, c: Point, d: Point) -> bool {
    let (c_side, d_side) = (turn(a, b, c), turn(a, b, d));
    let (a_side, b_side) = (turn(c, d, a), turn(c, d, b));
    if c_side * d_side < 0.0 && a_side * b_side < 0.0 {
        return true;
    }
    let touch = |p, u, v| distance_to_segment(p, u, v) < 1e-12;
    touch(c, a, b) || touch(d, a, b) || touch(a, c, d) || touch(b, c, d)
}

/// Convex parts: triangles of an ear cut, merged over shared edges while the union stays convex.
fn convex_parts(points: &[Point]) -> Vec<Vec<Point>> {
    if is_convex(points) {
        return vec![points.to_vec()];
    }
    let outline = geo::LineString::from(points.iter().map(|p| (p[0], p[1])).collect::<Vec<_>>());
    let cut = geo::Polygon::new(outline, Vec::new()).earcut_triangles();
    let mut parts: Vec<Vec<Point>> = cut
        .iter()
        .map(|triangle| {
            let mut corners: Vec<Point> = triangle.to_array().iter().map(|c| [c.x, c.y]).collect();
            if signed_area(&corners) < 0.0 {
                corners.reverse();
            }
            corners
        })
        .filter(|corners| signed_area(corners) > 0.0)
        .collect();
    while let Some(merger) = mergeable(&parts) {
        parts[merger.kept] = merger.union;
        parts.swap_remove(merger.removed);
    }
    parts
}

/// Two convex parts whose union is convex too.
struct Merger {
    /// Index of the part that the union replaces.
    kept: usize,
    /// Index of the other part, larger than `kept`.
    removed: usize,
    /// Corners of the union, counter-clockwise.
    union: Vec<Point>,
}

fn mergeable(parts: &[Vec<Point>]) -> Option<Merger> {
    for i in 0..parts.len() {
        for j in i + 1..parts.len() {
            if let Some(union) = merged(&parts[i], &parts[j]) {
                return Some(Merger { kept: i, removed: j, union });
            }
        }
    }
    None
}

/// The union of two parts that share an edge, if it is convex.
fn merged(a: &[Point], b: &[Point]) -> Option<Vec<Point>> {
    let (n, m) = (a.len(), b.len());
    for i in 0..n {
        for j in 0..m {
            if a[i] == b[(j + 1) % m] && a[(i + 1) % n] == b[j] {
                // Round a from the end of the shared edge to its start, then the rest of b.
                let mut union: Vec<Point> = (0..n).map(|k| a[(i + 1 + k) % n]).collect();
                union.extend((2..m).map(|k| b[(j + k) % m]));
                return is_convex(&union).then_some(union);
            }
        }
    }
    None
}

fn is_convex(points: &[Point]) -> bool {
    let n = points.len();
    (0..n).all(|i| {
        let (a, b, c) = (points[i], points[(i + 1) % n], points[(i + 2) % n]);
        // Straight corners are allowed; the tolerance is relative to the edges.
        turn(a, b, c) >= -1e-12 * distance(a, b) * distance(b, c)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const L: [Point; 6] = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]];

    #[test]
    fn an_l_falls_into_two_parts_in_either_orientation() {
        for reverse in [false, true] {
            let mut points = L.to_vec();
            if reverse {
                points.reverse();
            }
            let polygon = Polygon::new(&points).expect("valid");
            assert_eq!(polygon.parts().len(), 2, "{:?}", polygon.parts());
            assert!((polygon.area() - 3.0).abs() < 1e-12);
        }
    }

    #[test]
    fn faults_name_the_points() {
        assert_eq!(Polygon::new(&L[..2]), Err(PolygonFault::TooFewPoints(2)));
        let bow_tie = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]];
        assert_eq!(Polygon::new(&bow_tie), Err(PolygonFault::SelfCrossing(0, 2)));
        let nan = [[0.0, 0.0], [1.0, f64::NAN], [1.0, 0.0]];
        assert_eq!(Polygon::new(&nan), Err(PolygonFault::NotFinite(1)));
        let flat = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]];
        assert!(Polygon::new(&flat).is_err());
        let twice = [[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
        assert_eq!(Polygon::new(&twice), Err(PolygonFault::Coincident(0, 1)));
        let spike = [[0.0, 0.0], [2.0, 0.0], [1.0, 0.0], [1.0, 1.0]];
        assert!(Polygon::new(&spike).is_err());
    }

    #[test]
    fn hull_centroid_and_distances() {
        assert_eq!(convex_hull(&L).len(), 5);
        let c = centroid(&L);
        assert!((c[0] - 5.0 / 6.0).abs() < 1e-12 && (c[1] - 5.0 / 6.0).abs() < 1e-12);
        assert!(contains(&L, [0.5, 1.5]) && !contains(&L, [1.5, 1.5]));
        assert!((distance_to_outline(&L, [1.5, 1.5]) - 0.5).abs() < 1e-12);
    }
}
