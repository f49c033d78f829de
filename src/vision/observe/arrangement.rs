//! What goes into an observation and what comes out of it.
//!
//! In: nothing. Out: the types that `observe` takes and gives: views, objects, limits, estimates with their
//! uncertainty, and the headings under which everything that cannot be trusted is filed. Poses are in the
//! table frame. Pure data.

use crate::geometry::pose::Pose2;
use crate::time::Timestamp;
use crate::vision::detect::Detection;
use crate::vision::foreign::{ForeignReport, HeightMap};
use crate::vision::observe::reference;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The detections of one picture and where the camera was.
#[derive(Clone, Debug)]
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

/// Where an object lies.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObjectEstimate {
    /// The object's name.
    pub id: String,
    /// The object's frame in the table frame.
    pub pose: Pose2,
    /// Standard deviation of the position along the worse axis, m.
    pub std_xy_m: f64,
    /// Standard deviation of the angle, rad.
    pub std_theta_rad: f64,
    /// Pictures that contributed.
    pub views: usize,
    /// Pictures left out as outliers or misread.
    pub rejected_views: usize,
    /// Angle between the marker's normal and the vertical, rad: noise below `tilt_std_rad` or so.
    pub tilt_rad: f64,
    /// Standard deviation of the tilt in its worse direction, rad.
    pub tilt_std_rad: f64,
    /// How much higher the marker seems than it should be, m.
    pub height_error_m: f64,
    /// Standard deviation of that, m.
    pub height_std_m: f64,
    /// When the newest contributing picture was taken.
    pub time: Timestamp,
}

/// An object that was seen but must not be handled as if it lay flat.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Suspicious {
    /// The object's name.
    pub id: String,
    /// What is wrong, in words.
    pub reason: String,
    /// Best guess of where it is, where there is one: for pictures and recovery, not for planning.
    pub estimate: Option<ObjectEstimate>,
}

/// One marker id seen at several places.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Duplicate {
    /// The object's name.
    pub id: String,
    /// The marker's number.
    pub marker_id: u32,
    /// Where it was seen, object frame in the table frame.
    pub poses: Vec<Pose2>,
}

/// What the pictures say about the table.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Observation {
    /// Objects whose pose can be trusted, in the order they were asked for.
    pub objects: Vec<ObjectEstimate>,
    /// Objects whose marker was not seen at all.
    pub missing: Vec<String>,
    /// Marker ids seen at more than one place; their objects are not in `objects`.
    pub duplicates: Vec<Duplicate>,
    /// Marker ids that belong to no object and no reference, ascending.
    pub unknown: Vec<u32>,
    /// Objects seen tilted, at a wrong height, or inconsistently; not in `objects`.
    pub suspicious: Vec<Suspicious>,
    /// The reference markers against their survey; `None` when none was seen.
    pub reference: Option<reference::ReferenceCheck>,
    /// Root mean square error of the reference markers' centres, m; `None` when none was seen.
    pub reference_residual_m: Option<f64>,
    /// What stands there and carries no marker; `None` where no depth was measured. Whoever has depth fills
    /// it in.
    pub foreign: Option<ForeignReport>,
}

impl Observation {
    /// The estimate of the object called `id`, if it is trusted.
    pub fn object(&self, id: &str) -> Option<&ObjectEstimate> {
        self.objects.iter().find(|object| object.id == id)
    }

    /// True when every object was seen and can be trusted.
    pub fn complete(&self) -> bool {
        self.missing.is_empty() && self.duplicates.is_empty() && self.suspicious.is_empty()
    }
}
