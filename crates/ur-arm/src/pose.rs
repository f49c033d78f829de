//! Poses as a UR controller writes them: a position and a rotation vector.
//!
//! In and out: metres and radians; SE(3) is nalgebra's [`Isometry3`]. Source: `p[x, y, z, rx, ry, rz]` of
//! the script manual.

use nalgebra::{Isometry3, Vector3};

/// A pose as the UR controller writes it: x, y, z in m, then the rotation vector (axis x angle, rad).
pub fn isometry_from_ur_pose(pose: [f64; 6]) -> Isometry3<f64> {
    Isometry3::new(Vector3::new(pose[0], pose[1], pose[2]), Vector3::new(pose[3], pose[4], pose[5]))
}

/// The inverse of [`isometry_from_ur_pose`]; the rotation vector's length is in [0, pi].
pub fn ur_pose_from_isometry(transform: &Isometry3<f64>) -> [f64; 6] {
    let t = transform.translation.vector;
    let r = transform.rotation.scaled_axis();
    [t.x, t.y, t.z, r.x, r.y, r.z]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn ur_poses_keep_the_rotation() {
        let pose = [0.1, 0.2, 0.3, 0.0, PI - 0.1, 0.0];
        let back = ur_pose_from_isometry(&isometry_from_ur_pose(pose));
        assert!(pose.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}
