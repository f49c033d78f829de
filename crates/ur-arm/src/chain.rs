//! The chain of an arm's six links, with what is the same in every position computed once.
//!
//! In: DH parameters (m, rad, standard convention), joint positions. Out: the poses of the links. For
//! callers that compute many positions of one arm; `kinematics` has the same for a single one. Pure.

use crate::models::DhParameters;
use cell_values::units::Joints;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2};

/// An arm's parameters, and sine and cosine of half of each twist.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain {
    dh: DhParameters,
    half_twists: [(f64, f64); 6],
}

impl Chain {
    /// The chain of an arm.
    pub fn of(dh: &DhParameters) -> Chain {
        Chain { dh: *dh, half_twists: dh.alpha.map(half_twist) }
    }

    /// Its parameters.
    pub fn dh(&self) -> &DhParameters {
        &self.dh
    }

    /// `base_from_flange` for joint positions `q`.
    pub fn forward(&self, q: &Joints) -> Isometry3<f64> {
        (0..6).fold(Isometry3::identity(), |base_from_link, i| base_from_link * self.link(i, q.0[i]))
    }

    /// `base_from_link` of the six links, base to flange.
    pub fn frames(&self, q: &Joints) -> [Isometry3<f64>; 6] {
        let mut base_from_link = Isometry3::identity();
        std::array::from_fn(|i| {
            base_from_link *= self.link(i, q.0[i]);
            base_from_link
        })
    }

    /// Rz(theta) Tz(d) Tx(a) Rx(alpha) of joint `i`: everything that moves is computed from this, so the
    /// product of the two turns is written out in half angles.
    pub(crate) fn link(&self, i: usize, q: f64) -> Isometry3<f64> {
        link(&self.dh, i, q, self.half_twists[i])
    }
}

fn link(dh: &DhParameters, i: usize, q: f64, (st, ct): (f64, f64)) -> Isometry3<f64> {
    let (s, c) = (0.5 * (q + dh.theta[i])).sin_cos();
    let turn = UnitQuaternion::new_unchecked(Quaternion::new(c * ct, c * st, s * st, s * ct));
    let (sin, cos) = (2.0 * s * c, (c - s) * (c + s));
    Isometry3::from_parts(Translation3::new(dh.a[i] * cos, dh.a[i] * sin, dh.d[i]), turn)
}

/// Sine and cosine of half a twist; those of the nominal table are known.
fn half_twist(alpha: f64) -> (f64, f64) {
    if alpha == 0.0 {
        (0.0, 1.0)
    } else if alpha.abs() == FRAC_PI_2 {
        (FRAC_1_SQRT_2.copysign(alpha), FRAC_1_SQRT_2)
    } else {
        (0.5 * alpha).sin_cos()
    }
}
