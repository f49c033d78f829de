//! How hard the arm may accelerate with an object on its cups.
//!
//! In: the cups' force at the least vacuum, their reach, the object's mass and where it hangs. Out: the
//! largest acceleration of the tool in any direction, m/s2. Pure.
//!
//! The force has to be twice the load at rest and four times while accelerating (design, section 4.4).
//! Upwards the cups carry weight and acceleration; sideways only friction holds, of what the weight leaves
//! of the force. A load off the cups' centre levers them off at the far side, which counts as so much more
//! load.

use cell_values::units::GRAVITY;

/// Force over load at rest.
const FACTOR_AT_REST: f64 = 2.0;

/// Force over load while accelerating.
const FACTOR_ACCELERATING: f64 = 4.0;

/// Rubber on a dry, smooth top; makers of cups calculate with 0.5.
const FRICTION: f64 = 0.5;

/// What is carried is accelerated by so much at least, m/s2: what the cups hold more slowly is too heavy.
pub const LEAST_ACCELERATION: f64 = 0.5;

/// One cup: its middle in the tool's plane, and the radius of its lip, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lip {
    /// x and y in the tool frame, m.
    pub middle: [f64; 2],
    /// m.
    pub radius: f64,
}

/// The cups that hold an object.
#[derive(Clone, Debug, PartialEq)]
pub struct Suction {
    /// Force of all of them at the least vacuum with which an object counts as held, N.
    pub force_n: f64,
    /// The cups.
    pub lips: Vec<Lip>,
}

/// Where an object's centre of mass hangs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Offset {
    /// In the tool's plane, m, seen along the tool's z axis.
    At([f64; 2]),
    /// So far from the tool's axis, m, in a direction that the grip leaves open.
    Anywhere(f64),
}

/// Directions in which the outline of all lips is looked at.
const DIRECTIONS: usize = 180;

impl Suction {
    /// Force (N) that an object takes which is accelerated by `acceleration` (m/s2) against its weight.
    pub fn needed_n(&self, mass_kg: f64, off: Offset, acceleration: f64) -> f64 {
        let lever = self.lever(off);
        let at_rest = FACTOR_AT_REST * mass_kg * GRAVITY * lever;
        at_rest.max(FACTOR_ACCELERATING * mass_kg * (GRAVITY + acceleration) * lever)
    }

    /// The largest acceleration of the tool (m/s2), upwards or sideways, that holds it; not positive where
    /// the cups do not even carry it.
    pub fn acceleration(&self, mass_kg: f64, off: Offset) -> f64 {
        let lever = self.lever(off);
        let up = self.force_n / (FACTOR_ACCELERATING * mass_kg * lever) - GRAVITY;
        let left = self.force_n - mass_kg * GRAVITY * lever;
        let sideways = FRICTION * left / (FACTOR_ACCELERATING * mass_kg);
        up.min(sideways)
    }

    /// How much more force the load takes for hanging beside the middle of the suction: it pulls down on one
    /// side of it and is levered off against the lips on the other, as far away as these are.
    fn lever(&self, off: Offset) -> f64 {
        let middle = self.middle();
        match off {
            Offset::Anywhere(off_m) => {
                let off_m = off_m + middle[0].hypot(middle[1]);
                let reach = turns().map(|u| self.extent(middle, u)).fold(f64::INFINITY, f64::min);
                1.0 + off_m / reach.max(1e-6)
            }
            Offset::At([x, y]) => {
                let pull = [x - middle[0], y - middle[1]];
                let off_m = pull[0].hypot(pull[1]);
                if off_m < 1e-9 {
                    return 1.0;
                }
                let away = [-pull[0] / off_m, -pull[1] / off_m];
                // How far the outline of the lips reaches from the middle on the other side.
                let reach = turns().filter_map(|u| {
                    let along = u[0] * away[0] + u[1] * away[1];
                    (along > 1e-6).then(|| self.extent(middle, u) / along)
                });
                1.0 + off_m / reach.fold(f64::INFINITY, f64::min).max(1e-6)
            }
        }
    }

    /// Where the suction of all cups together acts, tool frame, m.
    fn middle(&self) -> [f64; 2] {
        let area = |lip: &Lip| lip.radius * lip.radius;
        let sum = self.lips.iter().map(area).sum::<f64>().max(1e-12);
        [0, 1].map(|i: usize| self.lips.iter().map(|lip| area(lip) * lip.middle[i]).sum::<f64>() / sum)
    }

    /// How far the lips reach from `middle` in the direction `u`, m.
    fn extent(&self, middle: [f64; 2], u: [f64; 2]) -> f64 {
        let reach =
            |lip: &Lip| (lip.middle[0] - middle[0]) * u[0] + (lip.middle[1] - middle[1]) * u[1] + lip.radius;
        self.lips.iter().map(reach).fold(0.0, f64::max)
    }
}

/// Unit vectors all round.
fn turns() -> impl Iterator<Item = [f64; 2]> {
    (0..DIRECTIONS).map(|k| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / DIRECTIONS as f64).sin_cos();
        [cos, sin]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_acceleration_is_the_one_at_which_the_force_is_used_up() {
        let cup = Suction { force_n: 16.0, lips: vec![Lip { middle: [0.0; 2], radius: 0.01 }] };
        let here = Offset::At([0.0; 2]);
        let up = 16.0 / 4.0 / 0.3 - GRAVITY;
        assert!((cup.acceleration(0.3, here) - up).abs() < 1e-9, "heavy: upwards counts");
        assert!((cup.needed_n(0.3, here, up) - 16.0).abs() < 1e-9);
        let sideways = 0.5 * (16.0 - 0.05 * GRAVITY) / 4.0 / 0.05;
        assert!((cup.acceleration(0.05, here) - sideways).abs() < 1e-9, "light: friction counts");
        assert!(
            cup.acceleration(0.3, Offset::At([0.005, 0.0])) < cup.acceleration(0.3, here),
            "off the centre"
        );
        assert!(cup.acceleration(0.6, here) < 0.0 && cup.needed_n(0.6, here, 0.0) > 16.0);
    }

    /// Moments about the lips, by hand.
    #[test]
    fn a_load_levers_itself_off_over_the_nearest_lips_opposite() {
        let lip = |x: f64| Lip { middle: [x, 0.0], radius: 0.01 };
        let pair = Suction { force_n: 16.0, lips: vec![lip(-0.05), lip(0.05)] };
        let lever = |off: Offset| pair.lever(off);
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-3, "{a}, not {b}");
        near(lever(Offset::At([0.02, 0.0])), 1.0 + 0.02 / 0.06);
        near(lever(Offset::At([0.0, 0.02])), 1.0 + 0.02 / 0.01);
        near(lever(Offset::Anywhere(0.02)), 1.0 + 0.02 / 0.01);
        // A cup beside the tool's axis: what hangs on the axis hangs beside the cup.
        let aside = Suction { force_n: 16.0, lips: vec![lip(0.05)] };
        near(aside.lever(Offset::At([0.05, 0.0])), 1.0);
        near(aside.lever(Offset::At([0.0, 0.0])), 1.0 + 0.05 / 0.01);
    }
}
