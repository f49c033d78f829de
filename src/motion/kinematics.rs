//! Forward and inverse kinematics of UR arms.

use crate::units::Joints;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Denavit-Hartenberg parameters, standard convention, base to wrist 3: m and rad.
#[derive(Clone, Copy, Debug, PartialEq)]
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
    pub const UR5E: DhParameters = DhParameters {
        a: [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0],
        d: [0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996],
        alpha: [
            std::f64::consts::FRAC_PI_2,
            0.0,
            0.0,
            std::f64::consts::FRAC_PI_2,
            -std::f64::consts::FRAC_PI_2,
            0.0,
        ],
        theta: [0.0; 6],
    };
}

/// `base_from_flange` for joint positions `q`.
pub fn forward(dh: &DhParameters, q: &Joints) -> Isometry3<f64> {
    (0..6).fold(Isometry3::identity(), |base_from_link, i| base_from_link * link(dh, i, q.0[i]))
}

/// Rz(theta) Tz(d) Tx(a) Rx(alpha) of joint `i`.
fn link(dh: &DhParameters, i: usize, q: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q + dh.theta[i]);
    let twist = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), dh.alpha[i]);
    let along_x = turn * Vector3::new(dh.a[i], 0.0, 0.0);
    Isometry3::from_parts(Translation3::new(along_x.x, along_x.y, dh.d[i]), turn * twist)
}
