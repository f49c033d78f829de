//! How fast a moving body comes nearer to one that stands, on a straight way in joint space.
//!
//! In: the arm's frames, the joints' way, a direction in which the two are apart. Out: a bound on how far
//! they come nearer up to a share of the way. Pure.
//!
//! Two convex bodies whose distance was measured are parted by it along the line between their nearest
//! points. Only motion along that line uses it up: what moves past the other, or away from it, need not be
//! measured again soon (directed motion bounds: Tang, Kim and Manocha, "C2A: controlled conservative
//! advancement for continuous collision detection", 2009, section 3). The velocity along the line is known
//! where the distance is measured; how much it changes on the way is bounded by the joints' ways and levers.

use crate::bodies::shape::placed;
use nalgebra::Isometry3;
use parry3d_f64::math::{Pose, Vector};

/// How a frame moves while the joints go the whole way: base frame, its unit of time is the way.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Twist {
    /// Angular velocity, rad.
    turn: Vector,
    /// Velocity of the point of the frame that is at the base's origin, m.
    shift: Vector,
}

impl Twist {
    /// Velocity of a point of the frame, m.
    pub fn velocity(&self, point: Vector) -> Vector {
        self.turn.cross(point) + self.shift
    }

    /// How fast a body with this middle (m, base frame) gets on along a unit direction at most, m: a ball of
    /// radius `reach` (m) round the middle that turns with the frame.
    pub fn speed_along(&self, direction: Vector, middle: Vector, reach: f64) -> f64 {
        direction.dot(self.velocity(middle)) + self.turn.cross(direction).length() * reach
    }
}

/// The twists of the base and of the six links; `way` is what each joint turns, rad.
pub(super) fn twists(base_from_link: &[Isometry3<f64>; 6], way: &[f64; 6]) -> [Twist; 7] {
    let mut twist = Twist::default();
    let mut base_from_joint = Pose::IDENTITY;
    std::array::from_fn(|link| {
        let Some(joint) = link.checked_sub(1) else { return twist };
        // Joint and link are numbered alike: a joint turns about z of the frame before its own link's.
        let axis = base_from_joint.rotation * Vector::Z * way[joint];
        twist.turn += axis;
        twist.shift += base_from_joint.translation.cross(axis);
        base_from_joint = placed(&base_from_link[joint]);
        twist
    })
}

/// How much a velocity changes at most over the whole way, m: no point of a body is farther from the axis of
/// a joint than its lever.
///
/// A point's velocity is the sum of `way[j] axis[j] x (point - origin[j])`. Joints before `j` turn that term
/// as a whole, and `j` and those after it move the point: the change of each term is at most its own way
/// times that of the other joint times the lever of the later one of the two.
pub(super) fn bend(levers: &[f64; 6], way: &[f64; 6]) -> f64 {
    let mut sum = 0.0;
    let mut before = 0.0;
    for (lever, way) in levers.iter().zip(way) {
        let way = way.abs();
        sum += lever * way * (way + 2.0 * before);
        before += way;
    }
    sum
}

/// A bound on how far two bodies have come nearer after a share `t` of the way: `rate t + bend t^2 / 2`, m.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearing {
    pub rate: f64,
    pub bend: f64,
}

impl Nearing {
    /// How far they have come nearer after this share at most, m; negative where they surely part.
    pub fn after(&self, share: f64) -> f64 {
        share * (self.rate + 0.5 * self.bend * share)
    }

    /// The share after which a distance (m, not negative) may be used up.
    pub fn lasts(&self, distance: f64) -> f64 {
        let divisor = self.rate + (self.rate * self.rate + 2.0 * self.bend * distance).sqrt();
        if divisor > 0.0 { 2.0 * distance / divisor } else { f64::INFINITY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bodies::cell::CellBodies;
    use crate::bodies::chains::{moving, poses};
    use crate::bodies::{Bodies, Surroundings};
    use cell_values::units::Joints;
    use rand::{RngExt, SeedableRng};
    use ur_arm::kinematics::DhParameters;
    use ur_arm::testing::PUBLISHED;

    /// An arm with the nominal table's look, and tables of real arms.
    #[test]
    fn no_point_gets_on_along_a_direction_farther_than_bounded() {
        let mut dh = DhParameters::UR5E;
        dh.a[1] += 2e-3;
        dh.alpha[3] += 1e-3;
        for (seed, dh) in (5..).zip([dh].into_iter().chain(PUBLISHED)) {
            no_point_gets_on_farther(seed, &dh);
        }
    }

    fn no_point_gets_on_farther(seed: u64, dh: &DhParameters) {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let surroundings = Surroundings {
            base_from_table: Isometry3::translation(0.0, 0.0, -1.0),
            flange_from_tool: Isometry3::identity(),
            table: [1.0, 1.0],
            link_floor: 0.0,
            cell: CellBodies::bare(),
        };
        let bodies = Bodies::new(dh, &surroundings);
        let chain = &bodies.chain;
        let mut tight = 0;
        for case in 0..4000 {
            let size = [0.01, 0.1, 0.5, 2.0][case % 4];
            let from = Joints(std::array::from_fn(|_| random.random_range(-3.1..3.1)));
            let way: [f64; 6] = std::array::from_fn(|_| random.random_range(-size..size));
            let body = &bodies.moving[case % bodies.moving.len()];
            let levers = bodies.levers(body, 0);
            let (frames, twists) = moving(chain, &from, &way);
            let direction = std::array::from_fn(|_| random.random_range(-1.0..1.0));
            let Some(direction) = Vector::from(direction).try_normalize() else { continue };
            let middle = frames[body.frame] * body.shape.middle();
            let reach = body.shape.reach();
            let rate = twists[body.frame].speed_along(direction, middle, reach);
            let nearing = Nearing { rate, bend: bend(&levers, &way) };
            let offset: [f64; 3] = std::array::from_fn(|_| random.random_range(-1.0..1.0));
            let offset = Vector::from(offset).try_normalize().unwrap_or(Vector::X) * reach;
            let point = body.shape.middle() + offset;
            let begin = direction.dot(frames[body.frame] * point);
            for k in 1..=10 {
                let share = f64::from(k) / 10.0;
                let q = Joints(std::array::from_fn(|j| from.0[j] + share * way[j]));
                let on = direction.dot(poses(chain, &q)[body.frame] * point) - begin;
                let most = nearing.after(share);
                assert!(on <= most + 1e-9, "case {case}: {on} of {most} m");
                tight += usize::from(on > 0.8 * most);
            }
            let distance = random.random_range(0.0..0.2);
            let lasts = nearing.lasts(distance);
            let used = if lasts.is_finite() { nearing.after(lasts) } else { nearing.after(1e3) };
            assert!(used <= distance + 1e-9 || lasts.is_infinite() && used <= 0.0, "{nearing:?} {distance}");
        }
        assert!(tight > 2_000, "a bound that is never reached is no use: {tight}");
    }
}
