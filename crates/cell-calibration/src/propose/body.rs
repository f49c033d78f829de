//! The arm's body as lines along its links: what it hides from a fixed camera, and how near it comes to it.
//!
//! In: the arm's model and joints. Out: a `Body` in the base frame, distances in m. A drawing to propose
//! poses by, wide enough for that; the path check's heights and the person who gives `--yes` guard the arm.
//! Pure.

use cell_motion::path::ArmModel;
use cell_values::units::Joints;
use nalgebra::{Point3, Vector3};

/// Half a link's width, m: a UR5e's widest joint.
const HALF_WIDTH_M: f64 = 0.06;
/// The upper arm lies beside the plane of the links' frames, along the shoulder's axis, m (UR5e).
const UPPER_ARM_BESIDE_M: f64 = 0.138;

/// A straight piece of it, between two points in the base frame.
/// A straight piece, by its ends.
pub type Line = [Point3<f64>; 2];

/// The arm in one posture.
pub(super) struct Body {
    /// Upper arm, forearm, the three wrists.
    links: Vec<Line>,
    /// From the flange to the tool.
    tool: Line,
}

impl Body {
    /// The arm with these joints.
    pub(super) fn new(model: &ArmModel, q: &Joints) -> Body {
        let frames = model.kinematics.chain().frames(q);
        let at = frames.map(|frame| Point3::from(frame.translation.vector));
        let beside = frames[0].rotation * Vector3::z() * UPPER_ARM_BESIDE_M;
        let mut links = vec![[at[0] + beside, at[1] + beside]];
        links.extend(at.windows(2).skip(1).map(|pair| [pair[0], pair[1]]));
        Body { links, tool: [at[5], frames[5] * model.flange_from_tool * Point3::origin()] }
    }

    /// Something on the line of sight between two points, the tool apart: the person who clamps a board to
    /// it sees that it is free.
    pub(super) fn hides(&self, from: &Point3<f64>, to: &Point3<f64>) -> bool {
        self.links.iter().any(|link| apart_m(link, &[*from, *to]) < HALF_WIDTH_M)
    }

    /// How near its middle lines come to a point, m.
    pub(super) fn clears_m(&self, point: &Point3<f64>) -> f64 {
        let lines = self.links.iter().chain([&self.tool]);
        lines.map(|line| apart_m(line, &[*point, *point])).fold(f64::INFINITY, f64::min)
    }
}

/// Least distance of two straight pieces, m: of their lines, held within both pieces (Ericson, Real-Time
/// Collision Detection, section 5.1.9).
pub fn apart_m([a, b]: &Line, [c, d]: &Line) -> f64 {
    let (u, v, w) = (b - a, d - c, a - c);
    let (uu, vv, uv) = (u.norm_squared(), v.norm_squared(), u.dot(&v));
    let (uw, vw) = (u.dot(&w), v.dot(&w));
    let share = |above: f64, below: f64| if below > 1e-12 { (above / below).clamp(0.0, 1.0) } else { 0.0 };
    let s = share(uv * vw - vv * uw, uu * vv - uv * uv);
    let t = share(uv * s + vw, vv);
    // The second may have been held at an end: the first once more for it.
    let s = share(uv * t - uw, uu);
    ((a + u * s) - (c + v * t)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn pieces_are_as_far_apart_as_their_nearest_points() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let mut point = || Point3::from([0; 3].map(|_| random.random_range(-1.0..1.0)));
        for _ in 0..200 {
            let (one, two) = ([point(), point()], [point(), point()]);
            let on = |line: &Line, k: i32| line[0] + (line[1] - line[0]) * (f64::from(k) / 200.0);
            let pairs = (0..=200).flat_map(|i| (0..=200).map(move |k| (i, k)));
            let tried = pairs.map(|(i, k)| (on(&one, i) - on(&two, k)).norm()).fold(f64::INFINITY, f64::min);
            let found = apart_m(&one, &two);
            assert!(found <= tried + 1e-12 && tried - found < 0.02, "{found} {tried} {one:?} {two:?}");
        }
        let at = point();
        assert_eq!(apart_m(&[at, at], &[at, at]), 0.0);
    }
}
