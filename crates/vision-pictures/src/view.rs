//! The lens of the benchmark, what it loses, and cameras over a table.
//!
//! In: where a camera is and how it is turned. Out: its pose on the table, numbers of the lens. Pure.

use crate::render::Degrade;
use cell_vision::camera::CameraModel;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// The benchmark's blur, noise and light.
pub const DEGRADE: Degrade = Degrade { blur_px: 0.8, noise: 3.0, gradient: 0.3 };

/// The benchmark's lens.
pub fn bench_camera() -> CameraModel {
    CameraModel {
        serial: "bench".into(),
        width: 1280,
        height: 720,
        fx: 650.0,
        fy: 651.3,
        cx: 644.7,
        cy: 355.4,
        distortion: [-0.05, 0.06, 0.0, 0.0, 0.0],
    }
}

/// A camera over the table point (x, y), `height_m` up, tilted about the table's axes and turned.
pub fn looking_down(at: [f64; 2], height_m: f64, tilt: [f64; 2], turn: f64) -> Isometry3<f64> {
    let down = UnitQuaternion::from_scaled_axis(Vector3::x() * PI);
    let turned = UnitQuaternion::from_scaled_axis(Vector3::z() * turn);
    let tilted = UnitQuaternion::from_scaled_axis(Vector3::new(tilt[0], tilt[1], 0.0));
    Isometry3::from_parts(Translation3::new(at[0], at[1], height_m), tilted * turned * down)
}
