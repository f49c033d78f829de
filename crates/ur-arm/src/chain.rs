//! The chain of an arm's six links, with what is the same in every position computed once.
//!
//! In: DH parameters (m, rad, standard convention), joint positions. Out: the poses of the links. For
//! callers that compute many positions of one arm; `kinematics` has the same for a single one. Pure.
//!
//! The axes of shoulder, elbow and wrist 1 are almost parallel. Their common normals are ill-conditioned, so
//! the DH tables of real arms put frames 2 and 3 hundreds of metres along those axes, at any angle. Here
//! both frames slide along their own axes to the height of the previous joint and turn until x points back
//! to it, as in the nominal table. Joint axes and flange do not change. A body sits at its frame's origin
//! without the tilt of the next axis: that tilts the bearing, not the whole link.

use crate::models::DhParameters;
use cell_values::units::Joints;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};

/// The joints whose axes are parallel to the next one's, counted from 0.
pub(crate) const PARALLEL_JOINTS: [usize; 2] = [1, 2];

/// Twists of the nominal arms, rad: all have the same.
pub(crate) const TWISTS: [f64; 6] = [FRAC_PI_2, 0.0, 0.0, FRAC_PI_2, -FRAC_PI_2, 0.0];

/// An arm's links.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub struct Chain {
    /// `joint_from_link` of each link with its joint at zero.
    links: [Isometry3<f64>; 6],
    /// The same of its body.
    bodies: [Isometry3<f64>; 6],
}

/// The links in one position of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// `base_from_link`, base to flange: z is the next joint's axis.
    pub frames: [Isometry3<f64>; 6],
    /// `base_from_body`: what is fixed to a link, in the frame of a nominal arm's link.
    pub bodies: [Isometry3<f64>; 6],
}

impl Chain {
    /// The chain of an arm.
    pub fn of(dh: &DhParameters) -> Chain {
        let mut links = std::array::from_fn(|i| steps(dh, i));
        for i in 0..5 {
            let slide = if PARALLEL_JOINTS.contains(&i) { slide(&links[i]) } else { half_turn(&links[i]) };
            links[i] *= slide;
            links[i + 1] = slide.inverse() * links[i + 1];
        }
        let body = |i: usize| match i {
            5 => links[5],
            i => Isometry3::from_parts(links[i].translation, untilted(&links[i].rotation, TWISTS[i])),
        };
        Chain { links, bodies: std::array::from_fn(body) }
    }

    /// `joint_from_link` of each link with its joint at zero.
    pub fn links(&self) -> &[Isometry3<f64>; 6] {
        &self.links
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

    /// Where links and bodies are.
    pub fn placed(&self, q: &Joints) -> Placed {
        let mut base_from_joint = Isometry3::identity();
        let mut bodies = [base_from_joint; 6];
        let frames = std::array::from_fn(|i| {
            let half = half_angle(q.0[i]);
            bodies[i] = base_from_joint * turned(&self.bodies[i], half);
            base_from_joint *= turned(&self.links[i], half);
            base_from_joint
        });
        Placed { frames, bodies }
    }

    /// Link `i` with its joint at `q`.
    pub(crate) fn link(&self, i: usize, q: f64) -> Isometry3<f64> {
        turned(&self.links[i], half_angle(q))
    }
}

/// `base_from_flange` of a table for joint positions `q`: sliding the frames, as [`Chain`] does, leaves the
/// flange where it is.
pub fn flange_of(dh: &DhParameters, q: &Joints) -> Isometry3<f64> {
    (0..6).fold(Isometry3::identity(), |base_from_link, i| {
        base_from_link * turned(&steps(dh, i), half_angle(q.0[i]))
    })
}

/// Sine and cosine of half an angle.
fn half_angle(q: f64) -> (f64, f64) {
    (0.5 * q).sin_cos()
}

/// A pose turned about z by the angle whose half has this sine and cosine: everything that moves is computed
/// from this, so the product is written out.
fn turned(pose: &Isometry3<f64>, (s, c): (f64, f64)) -> Isometry3<f64> {
    let (sin, cos) = (2.0 * s * c, (c - s) * (c + s));
    let (at, by) = (&pose.translation, pose.rotation.quaternion());
    let [w, i, j, k] = [c * by.w - s * by.k, c * by.i - s * by.j, c * by.j + s * by.i, c * by.k + s * by.w];
    let moved = Translation3::new(cos * at.x - sin * at.y, sin * at.x + cos * at.y, at.z);
    Isometry3::from_parts(moved, UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k)))
}

/// The turn about z and then by the twist about x that is nearest to a rotation.
pub(crate) fn untilted(rotation: &UnitQuaternion<f64>, twist: f64) -> UnitQuaternion<f64> {
    let (s, c) = half_twist(twist);
    let twist = UnitQuaternion::new_unchecked(Quaternion::new(c, s, 0.0, 0.0));
    let turn = rotation * twist.inverse();
    // Its part about z (swing and twist).
    let about_z = Quaternion::new(turn.w, 0.0, 0.0, turn.k);
    UnitQuaternion::from_quaternion(about_z) * twist
}

/// Rz(theta) Tz(d) Tx(a) Rx(alpha) of joint `i`.
fn steps(dh: &DhParameters, i: usize) -> Isometry3<f64> {
    let (st, ct) = half_twist(dh.alpha[i]);
    let (s, c) = (0.5 * dh.theta[i]).sin_cos();
    let turn = UnitQuaternion::new_unchecked(Quaternion::new(c * ct, c * st, s * st, s * ct));
    let (sin, cos) = (2.0 * s * c, (c - s) * (c + s));
    Isometry3::from_parts(Translation3::new(dh.a[i] * cos, dh.a[i] * sin, dh.d[i]), turn)
}

/// Between two axes at right angles a table may have either direction of the common normal: half a turn
/// about the link's own axis, where x is not that of a nominal arm.
fn half_turn(joint_from_link: &Isometry3<f64>) -> Isometry3<f64> {
    if (joint_from_link.rotation * Vector3::x()).x < 0.0 {
        Isometry3::rotation(Vector3::z() * PI)
    } else {
        Isometry3::identity()
    }
}

/// Along the link's own axis to the height of its joint, then about it until x points back to the joint.
fn slide(joint_from_link: &Isometry3<f64>) -> Isometry3<f64> {
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| joint_from_link.rotation * axis);
    let along = -joint_from_link.translation.z / z.z;
    let origin = joint_from_link.translation.vector + along * z;
    let back = -origin.xy();
    let across = |axis: &Vector2<f64>| back.x * axis.y - back.y * axis.x;
    let turn = (-across(&x.xy())).atan2(across(&y.xy()));
    Isometry3::from_parts(
        Translation3::new(0.0, 0.0, along),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn),
    )
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
