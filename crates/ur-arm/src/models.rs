//! The vendor's arms: nominal Denavit-Hartenberg parameters and joint speeds.
//!
//! In: nothing. Out: [`ARM_MODELS`]. Plain data, apart from the kinematics that are computed from it.

use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Denavit-Hartenberg parameters, standard convention, base to wrist 3: m and rad.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub struct DhParameters {
    /// Link lengths a, m.
    pub a: [f64; 6],
    /// Link offsets d, m.
    pub d: [f64; 6],
    /// Link twists alpha, rad.
    pub alpha: [f64; 6],
    /// Joint angle offsets, rad.
    pub theta: [f64; 6],
}

impl DhParameters {
    /// Nominal UR5e (the vendor's published table).
    pub const UR5E: DhParameters = DhParameters::of([0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996]);

    /// The six lengths (m) in which the vendor's arms differ: d1, a2, a3, d4, d5, d6.
    const fn of([d1, a2, a3, d4, d5, d6]: [f64; 6]) -> DhParameters {
        DhParameters {
            a: [0.0, a2, a3, 0.0, 0.0, 0.0],
            d: [d1, 0.0, 0.0, d4, d5, d6],
            alpha: [FRAC_PI_2, 0.0, 0.0, FRAC_PI_2, -FRAC_PI_2, 0.0],
            theta: [0.0; 6],
        }
    }
}

/// One of the vendor's arms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmModel {
    /// The vendor's name.
    pub name: &'static str,
    /// Nominal parameters.
    pub dh: DhParameters,
    /// Fastest speed of each joint, rad/s.
    pub joint_speed: [f64; 6],
}

const SLOW: f64 = 120.0 / 180.0 * PI;
const WRIST: f64 = 210.0 / 180.0 * PI;
const LARGE: [f64; 6] = [SLOW, SLOW, PI, PI, PI, PI];
const SMALL: [f64; 6] = [PI, PI, PI, TAU, TAU, TAU];
const HEAVY: [f64; 6] = [SLOW, SLOW, 150.0 / 180.0 * PI, WRIST, WRIST, WRIST];

/// The arms whose published figures two sources agree on: the vendor's article on DH parameters, and the
/// vendor's public robot descriptions or the parameter tables of others. Speeds: the vendor's joint limits.
pub const ARM_MODELS: &[ArmModel] = &[
    ArmModel { name: "UR5e", dh: DhParameters::UR5E, joint_speed: [PI; 6] },
    ArmModel {
        name: "UR3e",
        dh: DhParameters::of([0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921]),
        joint_speed: SMALL,
    },
    ArmModel {
        name: "UR10e",
        dh: DhParameters::of([0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655]),
        joint_speed: LARGE,
    },
    ArmModel {
        name: "UR16e",
        dh: DhParameters::of([0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655]),
        joint_speed: LARGE,
    },
    ArmModel {
        name: "UR20",
        dh: DhParameters::of([0.2363, -0.862, -0.7287, 0.201, 0.1593, 0.1543]),
        joint_speed: HEAVY,
    },
    ArmModel {
        name: "UR30",
        dh: DhParameters::of([0.2363, -0.637, -0.5037, 0.201, 0.1593, 0.1543]),
        joint_speed: HEAVY,
    },
    ArmModel {
        name: "UR3",
        dh: DhParameters::of([0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819]),
        joint_speed: SMALL,
    },
    ArmModel {
        name: "UR5",
        dh: DhParameters::of([0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823]),
        joint_speed: [PI; 6],
    },
    ArmModel {
        name: "UR10",
        dh: DhParameters::of([0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922]),
        joint_speed: LARGE,
    },
];
