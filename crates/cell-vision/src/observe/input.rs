//! What goes into an observation.
//!
//! In: nothing. Out: the types that `observe` takes: views, objects, reference markers, limits. Poses are in
//! the table frame. Pure data.

use crate::detect::Detection;
use crate::foreign::HeightMap;
use crate::region::Region;
use cell_values::time::Timestamp;
use nalgebra::Isometry3;
use rearrange::geometry::pose::Pose2;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The detections of one picture and where the camera was.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct View {
    /// The camera frame seen from the table.
    pub table_from_camera: Isometry3<f64>,
    /// What was found in the picture.
    pub detections: Vec<Detection>,
    /// When the picture was taken.
    pub time: Timestamp,
    /// What the depth picture of the same moment says about the table, where there is one.
    pub heights: Option<Arc<HeightMap>>,
}

/// A look at a part of the table, and what is remembered of the rest.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
pub struct PartialLook {
    /// What the look has to show.
    pub region: Region,
    /// Where objects were seen earlier: those that this look does not show explain what is there still.
    pub remembered: Vec<(String, Pose2)>,
}

/// An object and the marker on its top.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkedObject {
    /// The object's name.
    pub id: String,
    /// Its marker's number.
    pub marker_id: u32,
    /// Edge of the marker's black square, m.
    pub marker_size: f64,
    /// Height of the top, and so of the marker, above the table, m.
    pub height: f64,
    /// The marker's pose in the object's frame.
    pub offset: Pose2,
}

/// A marker fixed on the table at a surveyed pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReferenceMarker {
    /// Its number.
    pub id: u32,
    /// Edge of its black square, m.
    pub size: f64,
    /// Where it lies, table frame.
    pub pose: Pose2,
}

/// Noise model and thresholds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObserveLimits {
    /// Corner noise that differs from frame to frame, standard deviation along each axis, pixels.
    pub corner_noise_px: f64,
    /// Corner error that repeats while camera and object stay (pixel grid, edge refinement), pixels.
    pub corner_bias_px: f64,
    /// What no number of pictures improves, per axis: camera pose, marker glued on by hand; m.
    pub systematic_xy_m: f64,
    /// The same for the angle, rad.
    pub systematic_theta_rad: f64,
    /// Uncertainty of an object's height and of the camera's height above it, m.
    pub height_std_m: f64,
    /// Uncertainty of an object's top being level, about either axis, rad.
    pub tilt_std_rad: f64,
    /// An object tilted by more than this is suspicious, rad.
    pub tilt_max_rad: f64,
    /// An object higher or lower than it should be by more than this is suspicious, m.
    pub height_error_max_m: f64,
    /// How many standard deviations a tilt or height error must have before it counts.
    pub significance: f64,
    /// Corners that fit no square of any pose better than this (rms) are not used, pixels.
    pub shape_residual_max_px: f64,
    /// The same marker at two places further apart than this is a duplicate, m.
    pub duplicate_m: f64,
    /// A view further from the others than this many standard deviations is an outlier.
    pub outlier_sigmas: f64,
}

impl Default for ObserveLimits {
    fn default() -> ObserveLimits {
        ObserveLimits {
            corner_noise_px: 0.018,
            corner_bias_px: 0.012,
            systematic_xy_m: 3e-4,
            systematic_theta_rad: 5e-4,
            height_std_m: 3e-4,
            tilt_std_rad: 0.5_f64.to_radians(),
            tilt_max_rad: 4.0_f64.to_radians(),
            height_error_max_m: 3e-3,
            significance: 5.0,
            shape_residual_max_px: 0.6,
            duplicate_m: 5e-3,
            outlier_sigmas: 5.0,
        }
    }
}

impl ObserveLimits {
    /// Standard deviation of a corner in one picture along each axis, pixels.
    pub fn corner_std_px(&self) -> f64 {
        self.corner_noise_px.hypot(self.corner_bias_px)
    }
}
