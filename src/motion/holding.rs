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

/// The cups that hold an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Suction {
    /// Force of all of them at the least vacuum that counts as gripped, N.
    pub force_n: f64,
    /// How far the outermost lip is from the tool's axis, m.
    pub reach_m: f64,
}

impl Suction {
    /// Force (N) that an object takes which is accelerated by `acceleration` (m/s2) against its weight,
    /// with its centre of mass `off_m` (m) beside the tool's axis.
    pub fn needed_n(&self, mass_kg: f64, off_m: f64, acceleration: f64) -> f64 {
        let lever = self.lever(off_m);
        let at_rest = FACTOR_AT_REST * mass_kg * GRAVITY * lever;
        at_rest.max(FACTOR_ACCELERATING * mass_kg * (GRAVITY + acceleration) * lever)
    }

    /// The largest acceleration of the tool (m/s2), upwards or sideways, that holds it; not positive where
    /// the cups do not even carry it.
    pub fn acceleration(&self, mass_kg: f64, off_m: f64) -> f64 {
        let lever = self.lever(off_m);
        let up = self.force_n / (FACTOR_ACCELERATING * mass_kg * lever) - GRAVITY;
        let left = self.force_n - mass_kg * GRAVITY * lever;
        let sideways = FRICTION * left / (FACTOR_ACCELERATING * mass_kg);
        up.min(sideways)
    }

    fn lever(&self, off_m: f64) -> f64 {
        1.0 + off_m / self.reach_m.max(1e-6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_acceleration_is_the_one_at_which_the_force_is_used_up() {
        let cup = Suction { force_n: 16.0, reach_m: 0.01 };
        let up = 16.0 / 4.0 / 0.3 - GRAVITY;
        assert!((cup.acceleration(0.3, 0.0) - up).abs() < 1e-9, "heavy: upwards counts");
        assert!((cup.needed_n(0.3, 0.0, up) - 16.0).abs() < 1e-9);
        let sideways = 0.5 * (16.0 - 0.05 * GRAVITY) / 4.0 / 0.05;
        assert!((cup.acceleration(0.05, 0.0) - sideways).abs() < 1e-9, "light: friction counts");
        assert!(cup.acceleration(0.3, 0.005) < cup.acceleration(0.3, 0.0), "off the centre");
        assert!(cup.acceleration(0.6, 0.0) < 0.0 && cup.needed_n(0.6, 0.0, 0.0) > 16.0);
    }
}
