//! Exact tests of ellipses against discs, ellipses and convex polygons.
//!
//! Overlap is invariant under affine maps, so the ellipse is mapped to the unit disc and the question
//! becomes how far the origin is from the other shape. The separation in the original metric follows from
//! the normal at the nearest point; it is exact where it is zero, and to first order near zero, which is all
//! that a decision at 1e-9 m needs.
//! In: placed shapes, m. Out: signed separation, m: negative inside.

use crate::geometry::polygon::{Point, closest_on_segment, cross, distance, dot, sub};

/// An ellipse at a pose: semi-axes along its own x and y, m, and the cosine and sine of its angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedEllipse {
    /// Centre, m.
    pub centre: Point,
    /// Semi-axes, m.
    pub semi: [f64; 2],
    /// Cosine and sine of the angle of the first axis.
    pub turn: [f64; 2],
}

impl PlacedEllipse {
    /// Support function: how far the ellipse reaches from its centre along the unit vector `n`, m.
    pub fn reach(&self, n: Point) -> f64 {
        let local = self.to_axes(n);
        (self.semi[0] * local[0]).hypot(self.semi[1] * local[1])
    }

    /// A vector seen along the ellipse's axes.
    fn to_axes(self, v: Point) -> Point {
        let [c, s] = self.turn;
        [c * v[0] + s * v[1], -s * v[0] + c * v[1]]
    }

    /// A point mapped by the affine map that makes this ellipse the unit disc.
    fn to_unit(self, p: Point) -> Point {
        let v = self.to_axes(sub(p, self.centre));
        [v[0] / self.semi[0], v[1] / self.semi[1]]
    }

    /// A direction of the unit-disc space as unit normal of the original space, and the factor from
    /// distances along it there to distances here.
    fn normal_from_unit(self, n: Point) -> (Point, f64) {
        let scaled = [n[0] / self.semi[0], n[1] / self.semi[1]];
        let factor = 1.0 / scaled[0].hypot(scaled[1]);
        let [c, s] = self.turn;
        let world = [c * scaled[0] - s * scaled[1], s * scaled[0] + c * scaled[1]];
        ([world[0] * factor, world[1] * factor], factor)
    }

    /// Separation from a convex polygon (counter-clockwise), with the unit normal from here to there; the
    /// normal is arbitrary when the centre is inside the polygon.
    pub fn separation_from_convex(&self, polygon: &[Point]) -> (f64, Point) {
        let n = polygon.len();
        let mut nearest: Option<Point> = None;
        let mut inside = true;
        let mut previous = self.to_unit(polygon[n - 1]);
        for corner in polygon {
            let corner = self.to_unit(*corner);
            inside &= cross(sub(corner, previous), previous) <= 0.0;
            let candidate = closest_on_segment([0.0, 0.0], previous, corner);
            if nearest.is_none_or(|known| dot(candidate, candidate) < dot(known, known)) {
                nearest = Some(candidate);
            }
            previous = corner;
        }
        self.separation_at(nearest.unwrap_or([0.0, 0.0]), inside)
    }

    /// Separation from another ellipse (or disc, with equal semi-axes), with the unit normal.
    pub fn separation_from_ellipse(&self, other: &PlacedEllipse) -> (f64, Point) {
        // The other's axes, mapped; then the mapped ellipse's own axes by a 2 x 2 singular value
        // decomposition of the matrix whose columns they are.
        let [c, s] = other.turn;
        let origin = self.to_unit(other.centre);
        let first = [other.centre[0] + c * other.semi[0], other.centre[1] + s * other.semi[0]];
        let second = [other.centre[0] - s * other.semi[1], other.centre[1] + c * other.semi[1]];
        let (u, v) = (sub(self.to_unit(first), origin), sub(self.to_unit(second), origin));
        let (axis, semi) = principal_axes(u, v);
        // The origin of the unit disc, seen along the mapped ellipse's axes.
        let away = [-origin[0], -origin[1]];
        let local = [dot(away, axis), cross(axis, away)];
        let on = closest_on_ellipse(semi, local);
        let inside = (local[0] / semi[0]).powi(2) + (local[1] / semi[1]).powi(2) < 1.0;
        let nearest =
            [origin[0] + on[0] * axis[0] - on[1] * axis[1], origin[1] + on[0] * axis[1] + on[1] * axis[0]];
        self.separation_at(nearest, inside)
    }

    fn separation_at(self, nearest: Point, inside: bool) -> (f64, Point) {
        let length = nearest[0].hypot(nearest[1]);
        let unit = if length > 1e-15 { [nearest[0] / length, nearest[1] / length] } else { [1.0, 0.0] };
        let (normal, factor) = self.normal_from_unit(unit);
        let signed = if inside { -length - 1.0 } else { length - 1.0 };
        (signed * factor, normal)
    }
}

/// Longer principal axis (unit vector) and both semi-axes of the image of the unit circle under the matrix
/// with columns `u` and `v`.
fn principal_axes(u: Point, v: Point) -> (Point, [f64; 2]) {
    // Eigenvectors of M M^T, which is symmetric.
    let (xx, yy) = (u[0] * u[0] + v[0] * v[0], u[1] * u[1] + v[1] * v[1]);
    let xy = u[0] * u[1] + v[0] * v[1];
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    let axis = [angle.cos(), angle.sin()];
    let major = (dot(axis, u)).hypot(dot(axis, v));
    // The product of the semi-axes is |det M|: no cancellation for thin ellipses.
    (axis, [major, cross(u, v).abs() / major])
}

/// The point of the axis-aligned ellipse with these semi-axes nearest to `p` (Eberly, "Distance from a point
/// to an ellipse": a bisection that converges for every point).
pub fn closest_on_ellipse(semi: [f64; 2], p: Point) -> Point {
    let swap = semi[0] < semi[1];
    let (e0, e1) = if swap { (semi[1], semi[0]) } else { (semi[0], semi[1]) };
    let (y0, y1) = if swap { (p[1].abs(), p[0].abs()) } else { (p[0].abs(), p[1].abs()) };
    let (x0, x1) = closest_in_quadrant(e0, e1, y0, y1);
    let (x, y) = if swap { (x1, x0) } else { (x0, x1) };
    [x.copysign(p[0]), y.copysign(p[1])]
}

fn closest_in_quadrant(e0: f64, e1: f64, y0: f64, y1: f64) -> (f64, f64) {
    if y1 > 0.0 {
        if y0 > 0.0 {
            let (z0, z1) = (y0 / e0, y1 / e1);
            let g = z0 * z0 + z1 * z1 - 1.0;
            if g == 0.0 {
                return (y0, y1);
            }
            let ratio = (e0 / e1).powi(2);
            let root = bisect(ratio, z0, z1, g);
            (ratio * y0 / (root + ratio), y1 / (root + 1.0))
        } else {
            (0.0, e1)
        }
    } else {
        let (numerator, denominator) = (e0 * y0, e0 * e0 - e1 * e1);
        if numerator < denominator {
            let share = numerator / denominator;
            (e0 * share, e1 * (1.0 - share * share).max(0.0).sqrt())
        } else {
            (e0, 0.0)
        }
    }
}

fn bisect(ratio: f64, z0: f64, z1: f64, g: f64) -> f64 {
    let n0 = ratio * z0;
    let mut low = z1 - 1.0;
    let mut high = if g < 0.0 { 0.0 } else { n0.hypot(z1) - 1.0 };
    let mut middle = low;
    for _ in 0..1074 {
        middle = 0.5 * (low + high);
        if middle == low || middle == high {
            break;
        }
        let (r0, r1) = (n0 / (middle + ratio), z1 / (middle + 1.0));
        let value = r0 * r0 + r1 * r1 - 1.0;
        if value > 0.0 {
            low = middle;
        } else if value < 0.0 {
            high = middle;
        } else {
            break;
        }
    }
    middle
}

/// Distance of `p` (in the ellipse's own frame) to the outline of the ellipse with these semi-axes, m.
pub fn distance_to_ellipse(semi: [f64; 2], p: Point) -> f64 {
    distance(closest_on_ellipse(semi, p), p)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64, angle: f64, a: f64, b: f64) -> PlacedEllipse {
        PlacedEllipse { centre: [x, y], semi: [a, b], turn: [angle.cos(), angle.sin()] }
    }

    #[test]
    fn separation_is_exact_where_ellipses_touch() {
        // Touching end to end, side to side, and at an angle.
        let check = |other: PlacedEllipse, expected: f64| {
            let (separation, _) = at(0.0, 0.0, 0.0, 2.0, 1.0).separation_from_ellipse(&other);
            assert!((separation - expected).abs() < 1e-9, "{separation}, expected {expected}");
        };
        check(at(4.0, 0.0, 0.0, 2.0, 1.0), 0.0);
        check(at(0.0, 2.0, 0.0, 2.0, 1.0), 0.0);
        check(at(3.0, 0.0, std::f64::consts::FRAC_PI_2, 2.0, 1.0), 0.0);
        check(at(5.0, 0.0, 0.0, 1.0, 1.0), 2.0);
    }

    #[test]
    fn nearest_point_is_on_the_ellipse_and_normal_to_it() {
        for p in [[3.0, 2.0], [0.1, 0.1], [-1.0, 0.2], [0.0, 0.5], [0.4, 0.0], [-5.0, -0.001]] {
            let on = closest_on_ellipse([2.0, 1.0], p);
            assert!(((on[0] / 2.0).powi(2) + on[1].powi(2) - 1.0).abs() < 1e-12, "{on:?}");
            let gradient = [on[0] / 4.0, on[1]];
            assert!(cross(gradient, sub(p, on)).abs() < 1e-9, "{p:?} {on:?}");
        }
    }

    #[test]
    fn a_square_beside_an_ellipse() {
        let square = [[2.5, -1.0], [4.5, -1.0], [4.5, 1.0], [2.5, 1.0]];
        let (separation, normal) = at(0.0, 0.0, 0.0, 2.0, 1.0).separation_from_convex(&square);
        assert!((separation - 0.5).abs() < 1e-9 && (normal[0] - 1.0).abs() < 1e-9);
        let (inside, _) = at(3.0, 0.0, 0.3, 0.2, 0.1).separation_from_convex(&square);
        assert!(inside < 0.0);
    }
}
