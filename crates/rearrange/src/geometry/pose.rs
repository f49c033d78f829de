//! Poses on the table (SE(2)) and in space (SE(3)).
//!
//! In and out: metres and radians. Transforms are named `to_from_from` (`table_from_object`), so that a
//! wrong product looks wrong. SE(3) is nalgebra's [`Isometry3`]; SE(2) has a type of its own because an
//! object's angle is kept as it was given (a goal's numbers are repeated exactly), not wrapped.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A pose in the plane: position in m, `theta` in rad, counter-clockwise from the x axis, not wrapped.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Pose2 {
    /// x in m.
    pub x: f64,
    /// y in m.
    pub y: f64,
    /// Angle in rad.
    pub theta: f64,
}

impl Pose2 {
    /// A pose from its three numbers (m, m, rad).
    pub const fn new(x: f64, y: f64, theta: f64) -> Pose2 {
        Pose2 { x, y, theta }
    }

    /// The point `p` of this pose's frame, seen from the frame the pose is given in.
    pub fn transform(&self, p: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.theta.sin_cos();
        [self.x + cos * p[0] - sin * p[1], self.y + sin * p[0] + cos * p[1]]
    }

    /// The point `p` of the outer frame, seen from this pose's frame.
    pub fn inverse_transform(&self, p: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.theta.sin_cos();
        let (dx, dy) = (p[0] - self.x, p[1] - self.y);
        [cos * dx + sin * dy, -sin * dx + cos * dy]
    }

    /// The pose that undoes this one: `pose.inverse().compose(&pose)` is the identity.
    pub fn inverse(&self) -> Pose2 {
        let [x, y] = self.inverse_transform([0.0, 0.0]);
        Pose2::new(x, y, -self.theta)
    }

    /// `self * other`: `other`, given in this pose's frame, seen from the outer frame. Angles add.
    pub fn compose(&self, other: &Pose2) -> Pose2 {
        let [x, y] = self.transform([other.x, other.y]);
        Pose2::new(x, y, self.theta + other.theta)
    }

    /// Distance of the two origins, m.
    pub fn distance(&self, other: &Pose2) -> f64 {
        (self.x - other.x).hypot(self.y - other.y)
    }

    /// Smallest absolute difference of the two angles modulo 2 pi, rad, in [0, pi].
    pub fn angle_difference(&self, other: &Pose2) -> f64 {
        wrap_angle(self.theta - other.theta).abs()
    }

    /// Same place and same angle modulo 2 pi, within 1e-9 m and 1e-9 rad.
    pub fn same(&self, other: &Pose2) -> bool {
        self.distance(other) <= 1e-9 && self.angle_difference(other) <= 1e-9
    }

    /// True when all three numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.theta.is_finite()
    }

    /// This pose as an SE(3) transform with z = `z_m` and the rotation about z.
    pub fn at_height(&self, z_m: f64) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(self.x, self.y, z_m),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.theta),
        )
    }
}

impl Serialize for Pose2 {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        [self.x, self.y, self.theta].serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Pose2 {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Pose2, D::Error> {
        let [x, y, theta] = <[f64; 3]>::deserialize(deserializer)?;
        Ok(Pose2::new(x, y, theta))
    }
}

/// The angle brought into (-pi, pi].
pub fn wrap_angle(angle: f64) -> f64 {
    let wrapped = angle.rem_euclid(std::f64::consts::TAU);
    if wrapped > std::f64::consts::PI { wrapped - std::f64::consts::TAU } else { wrapped }
}

/// Rotation whose columns are the given axes; used where a frame is built from directions.
pub fn rotation_from_axes(x: Vector3<f64>, y: Vector3<f64>, z: Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI, TAU};

    #[test]
    fn a_point_goes_there_and_back() {
        let pose = Pose2::new(0.3, -0.2, 1.1);
        let back = pose.inverse_transform(pose.transform([0.05, 0.07]));
        assert!((back[0] - 0.05).abs() < 1e-15 && (back[1] - 0.07).abs() < 1e-15);
    }

    #[test]
    fn angles_compare_modulo_a_turn() {
        let a = Pose2::new(0.0, 0.0, 0.1);
        assert!(a.same(&Pose2::new(0.0, 0.0, 0.1 - TAU)));
        assert!((a.angle_difference(&Pose2::new(0.0, 0.0, 0.1 + PI)) - PI).abs() < 1e-12);
        assert_eq!(wrap_angle(-PI), PI);
    }

    #[test]
    fn height_adds_z_only() {
        let lifted = Pose2::new(1.0, 2.0, FRAC_PI_2).at_height(0.5);
        let p = lifted * nalgebra::Point3::new(1.0, 0.0, 0.0);
        assert!((p - nalgebra::Point3::new(1.0, 3.0, 0.5)).norm() < 1e-12);
    }
}
