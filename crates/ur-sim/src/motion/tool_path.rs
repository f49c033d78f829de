//! The geometry of a tool's way: lines, circles, and corners rounded at constant speed.
//!
//! In: poses of the TCP in the base frame. Out: the pose at any fraction of the way. The way is measured
//! along the TCP's position; the tool turns in step with it, by the shortest rotation or, on a circle with
//! fixed orientation, with the circle.

use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// Metres of a tool move that one radian of turning counts as, where turning takes longer than travelling.
const METRES_PER_RADIAN: f64 = 0.25;

/// Turns of a corner that are no corner (rad), and that are too sharp for a round one.
const STRAIGHT: f64 = 1e-4;
pub(crate) const REVERSAL: f64 = PI - 0.1;

#[derive(Clone, Copy, Debug)]
enum Piece {
    Line {
        from: Vector3<f64>,
        travel: Vector3<f64>,
    },
    /// `centre + cos(s) u + sin(s) v`, s from 0 to `angle`.
    Arc {
        centre: Vector3<f64>,
        u: Vector3<f64>,
        v: Vector3<f64>,
        angle: f64,
    },
}

impl Piece {
    fn length(&self) -> f64 {
        match self {
            Piece::Line { travel, .. } => travel.norm(),
            Piece::Arc { u, angle, .. } => u.norm() * angle,
        }
    }

    fn at(&self, fraction: f64) -> Vector3<f64> {
        match self {
            Piece::Line { from, travel } => from + travel * fraction,
            Piece::Arc { centre, u, v, angle } => {
                let s = angle * fraction;
                centre + u * s.cos() + v * s.sin()
            }
        }
    }
}

/// A way of the TCP.
#[derive(Clone, Debug)]
pub struct ToolPath {
    pieces: Vec<Piece>,
    from: UnitQuaternion<f64>,
    /// Rotation vector of the whole way, in the frame it starts with.
    turn: Vector3<f64>,
    travel: f64,
}

impl ToolPath {
    fn new(pieces: Vec<Piece>, from: UnitQuaternion<f64>, turn: Vector3<f64>) -> ToolPath {
        let travel = pieces.iter().map(Piece::length).sum();
        ToolPath { pieces, from, turn, travel }
    }

    /// Straight from one pose to the other.
    pub fn line(from: &Isometry3<f64>, to: &Isometry3<f64>) -> ToolPath {
        let (start, end) = (from.translation.vector, to.translation.vector);
        let turn = (from.rotation.inverse() * to.rotation).scaled_axis();
        ToolPath::new(vec![Piece::Line { from: start, travel: end - start }], from.rotation, turn)
    }

    /// Along the circle through three positions. With `fixed` the tool keeps its orientation to the circle's
    /// tangent; else it turns from that of `from` to that of `to`. Three positions on one line are a line.
    pub fn circle(from: &Isometry3<f64>, via: &Isometry3<f64>, to: &Isometry3<f64>, fixed: bool) -> ToolPath {
        let [a, b, c] = [from, via, to].map(|pose| pose.translation.vector);
        let Some((centre, normal)) = circle_through(&a, &b, &c) else { return ToolPath::line(from, to) };
        let u = a - centre;
        let v = normal.cross(&u);
        let angle = |point: &Vector3<f64>| {
            let out = point - centre;
            out.dot(&v).atan2(out.dot(&u)).rem_euclid(2.0 * PI)
        };
        // The normal is chosen so that `via` comes before `to`.
        let angle = angle(&c);
        let turn = if fixed {
            from.rotation.inverse() * (normal.into_inner() * angle)
        } else {
            (from.rotation.inverse() * to.rotation).scaled_axis()
        };
        ToolPath::new(vec![Piece::Arc { centre, u, v, angle }], from.rotation, turn)
    }

    /// On from `from`, where the tool moves along `direction`, to `to`: straight until the corner `ahead`
    /// (m) away can be rounded by an arc, then straight to `to`. `None` where the way turns back on itself.
    pub fn corner(
        from: &Isometry3<f64>,
        direction: &Unit<Vector3<f64>>,
        ahead: f64,
        to: &Isometry3<f64>,
    ) -> Option<ToolPath> {
        let start = from.translation.vector;
        let corner = start + direction.into_inner() * ahead;
        let leaving = to.translation.vector - corner;
        let (length, onwards) = (leaving.norm(), leaving.try_normalize(1e-9)?);
        let turned = direction.angle(&onwards);
        if turned > REVERSAL {
            return None;
        }
        let rounded = ahead.min(length);
        let mut pieces =
            vec![Piece::Line { from: start, travel: direction.into_inner() * (ahead - rounded) }];
        if turned > STRAIGHT {
            let normal = direction.cross(&onwards).normalize();
            let inwards = normal.cross(direction);
            let radius = rounded / (turned / 2.0).tan();
            let centre = corner - direction.into_inner() * rounded + inwards * radius;
            pieces.push(Piece::Arc {
                centre,
                u: -inwards * radius,
                v: direction.into_inner() * radius,
                angle: turned,
            });
        } else {
            pieces.push(Piece::Line {
                from: corner - direction.into_inner() * rounded,
                travel: direction.into_inner() * rounded * 2.0,
            });
        }
        pieces.push(Piece::Line { from: corner + onwards * rounded, travel: onwards * (length - rounded) });
        let turn = (from.rotation.inverse() * to.rotation).scaled_axis();
        Some(ToolPath::new(pieces, from.rotation, turn))
    }

    /// How far the TCP travels, m.
    pub fn travel(&self) -> f64 {
        self.travel
    }

    /// How far it turns, rad.
    pub fn turning(&self) -> f64 {
        self.turn.norm()
    }

    /// What counts for the time it takes, m: travelling, or turning where that is more.
    pub fn length(&self) -> f64 {
        self.travel.max(self.turn.norm() * METRES_PER_RADIAN)
    }

    /// The pose at a fraction of the way, 0 to 1.
    pub fn pose(&self, fraction: f64) -> Isometry3<f64> {
        let mut left = self.travel * fraction;
        let mut position = self.pieces.first().map_or(Vector3::zeros(), |piece| piece.at(0.0));
        for piece in &self.pieces {
            let length = piece.length();
            position = piece.at(if length > 0.0 { (left / length).min(1.0) } else { 1.0 });
            left -= length;
            if left <= 0.0 {
                break;
            }
        }
        if fraction > 1.0
            && let Some((direction, _)) = self.final_line()
        {
            position += direction.into_inner() * (self.travel * (fraction - 1.0));
        }
        let turned = self.from * UnitQuaternion::from_scaled_axis(self.turn * fraction);
        Isometry3::from_parts(Translation3::from(position), turned)
    }

    /// Direction and length (m) of the straight piece at the end; `None` if the way ends otherwise.
    pub fn final_line(&self) -> Option<(Unit<Vector3<f64>>, f64)> {
        match self.pieces.iter().rev().find(|piece| piece.length() > 1e-9)? {
            Piece::Line { travel, .. } => Unit::try_new_and_get(*travel, 1e-9),
            Piece::Arc { .. } => None,
        }
    }
}

/// Centre and normal of the circle through three points, the normal such that a, b, c follow each other
/// counter-clockwise about it; `None` on a line.
fn circle_through(
    a: &Vector3<f64>,
    b: &Vector3<f64>,
    c: &Vector3<f64>,
) -> Option<(Vector3<f64>, Unit<Vector3<f64>>)> {
    let (ab, ac) = (b - a, c - a);
    let cross = ab.cross(&ac);
    let square = cross.norm_squared();
    if square < 1e-16 || square < 1e-8 * ab.norm_squared() * ac.norm_squared() {
        return None;
    }
    let to_centre =
        (cross.cross(&ab) * ac.norm_squared() + ac.cross(&cross) * ab.norm_squared()) / (2.0 * square);
    Some((a + to_centre, Unit::new_normalize(cross)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose(x: f64, y: f64, z: f64) -> Isometry3<f64> {
        Isometry3::translation(x, y, z)
    }

    #[test]
    fn a_circle_passes_its_points_and_keeps_its_radius() {
        let path = ToolPath::circle(&pose(1.0, 0.0, 0.2), &pose(0.0, 1.0, 0.2), &pose(0.0, -1.0, 0.2), true);
        assert!((path.travel() - 1.5 * PI).abs() < 1e-9, "{}", path.travel());
        for k in 0..=30 {
            let p = path.pose(f64::from(k) / 30.0);
            assert!((p.translation.vector.xy().norm() - 1.0).abs() < 1e-9);
            // Fixed orientation turns with the way.
            let tangent = p.rotation * Vector3::y();
            assert!(tangent.dot(&p.translation.vector).abs() < 1e-9, "{tangent}");
        }
        assert!((path.pose(1.0).translation.vector - Vector3::new(0.0, -1.0, 0.2)).norm() < 1e-9);
        let line = ToolPath::circle(&pose(0.0, 0.0, 0.0), &pose(0.1, 0.0, 0.0), &pose(0.3, 0.0, 0.0), false);
        assert!((line.travel() - 0.3).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn a_corner_is_smooth_and_ends_where_it_should(
            x in 0.0..0.5f64, y in -0.5..0.5f64, z in -0.5..0.5f64, ahead in 0.01..0.1f64
        ) {
            let direction = Unit::new_normalize(Vector3::x());
            let Some(path) = ToolPath::corner(&pose(0.0, 0.0, 0.0), &direction, ahead, &pose(x, y, z)) else {
                return Ok(());
            };
            prop_assert!((path.pose(1.0).translation.vector - Vector3::new(x, y, z)).norm() < 1e-9);
            let n = 4000;
            let point = |k: i32| path.pose(f64::from(k) / f64::from(n)).translation.vector;
            let step = path.travel() / f64::from(n);
            prop_assert!((point(1) - point(0)).normalize().dot(&direction) > 0.999);
            for k in 0..n {
                prop_assert!(((point(k + 1) - point(k)).norm() / step - 1.0).abs() < 0.02, "no jump, constant speed");
            }
        }
    }
}
