//! From marker corners to an arrangement: where each object lies, how sure that is, and what cannot be trusted.
//!
//! In: the objects and reference markers that exist, the lens, [`View`]s (camera pose and detections), [`ObserveLimits`]. Out:
//! [`Observation`]. Each view's corners are laid on the known plane of the marker (`planar`), the views are fused with
//! outliers out (`fuse`), and all views together must agree that the marker lies level at its height (`level`): an object
//! that landed on another one is *suspicious* and never among the trusted ones. Poses are in the table frame.

pub mod fuse;
pub mod level;
pub mod planar;
pub mod reference;
pub mod square;

use crate::geometry::pose::Pose2;
use crate::time::Timestamp;
use crate::vision::camera::CameraModel;
use crate::vision::cv::CvError;
use crate::vision::detect::Detection;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The detections of one picture and where the camera was.
#[derive(Clone, Debug)]
pub struct View {
    /// The camera frame seen from the table.
    pub table_from_camera: Isometry3<f64>,
    /// What was found in the picture.
    pub detections: Vec<Detection>,
    /// When the picture was taken.
    pub time: Timestamp,
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
            corner_noise_px: 0.03,
            corner_bias_px: 0.07,
            systematic_xy_m: 3e-4,
            systematic_theta_rad: 5e-4,
            height_std_m: 3e-4,
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

/// Why there is no observation.
#[derive(Debug, thiserror::Error)]
pub enum ObserveError {
    /// Two objects or references share a marker id.
    #[error("marker {marker_id} belongs to both {first} and {second}; give one of them another marker")]
    SharedMarker {
        /// The id.
        marker_id: u32,
        /// Who has it.
        first: String,
        /// Who has it too.
        second: String,
    },
    /// The camera's numbers are broken.
    #[error("the camera's calibration cannot be used")]
    Camera(#[from] crate::vision::camera::CameraModelError),
    /// OpenCV failed.
    #[error("the marker corners could not be undistorted")]
    Cv(#[from] CvError),
}

/// Works out the arrangement from one or more pictures.
///
/// Every detection whose marker belongs to no object and no reference is reported as unknown.
///
/// # Errors
/// `SharedMarker`, `Camera`, `Cv`; what is seen or not seen is never an error.
pub fn observe(
    objects: &[MarkedObject],
    reference: &[ReferenceMarker],
    camera: &CameraModel,
    views: &[View],
    limits: &ObserveLimits,
) -> Result<Observation, ObserveError> {
    camera.check()?;
    let owners = owners(objects, reference)?;
    let sightings = planar::sightings(camera, views)?;
    let mut observation = Observation::default();
    for object in objects {
        let seen = sightings.get(&object.marker_id).map_or(&[][..], Vec::as_slice);
        place(object, seen, views, limits, &mut observation);
    }
    let unknown: BTreeSet<u32> = sightings.keys().copied().filter(|id| !owners.contains_key(id)).collect();
    observation.unknown = unknown.into_iter().collect();
    observation.reference = reference::check(reference, &sightings, views, limits);
    observation.reference_residual_m = observation.reference.as_ref().map(|check| check.residual_rms_m);
    Ok(observation)
}

/// Who owns each marker id.
fn owners(
    objects: &[MarkedObject],
    reference: &[ReferenceMarker],
) -> Result<BTreeMap<u32, String>, ObserveError> {
    let mut owners = BTreeMap::new();
    let named = objects.iter().map(|object| (object.marker_id, format!("object {:?}", object.id)));
    let fixed = reference.iter().map(|marker| (marker.id, "the reference markers".to_owned()));
    for (marker_id, name) in named.chain(fixed) {
        if let Some(first) = owners.insert(marker_id, name.clone()) {
            return Err(ObserveError::SharedMarker { marker_id, first, second: name });
        }
    }
    Ok(owners)
}

/// Decides where one object lies and files it under the right heading of the observation.
fn place(
    object: &MarkedObject,
    seen: &[planar::Sighting],
    views: &[View],
    limits: &ObserveLimits,
    observation: &mut Observation,
) {
    if seen.is_empty() {
        observation.missing.push(object.id.clone());
        return;
    }
    let target = planar::Target { size_m: object.marker_size, height_m: object.height };
    let mut placed: Vec<planar::Placed> =
        seen.iter().filter_map(|sighting| planar::place(sighting, target, views, limits)).collect();
    placed.retain(|p| p.shape_residual_px <= limits.shape_residual_max_px);
    let misread = seen.len() - placed.len();
    let suspicious = |reason, estimate| Suspicious { id: object.id.clone(), reason, estimate };
    if placed.is_empty() {
        let reason = "the corners of its marker form no square in front of the camera: bent or half covered";
        observation.suspicious.push(suspicious(reason.to_owned(), None));
        return;
    }
    if let Some(clash) = fuse::apart_in_one_view(&placed, limits.duplicate_m) {
        observation.duplicates.push(duplicate(object, &clash));
        return;
    }
    let level = level::fit(&placed, target, views, limits);
    let complaint = match &level {
        Some(level) => level.complaint(limits),
        None => Some("its marker's pose cannot be worked out".to_owned()),
    };
    match (fuse::fuse(&placed, views, limits), complaint) {
        (Ok(fused), None) => {
            observation.objects.push(estimate(object, &fused, misread, level.as_ref(), views));
        }
        (Ok(fused), Some(reason)) => {
            let estimate = estimate(object, &fused, misread, level.as_ref(), views);
            observation.suspicious.push(suspicious(reason, Some(estimate)));
        }
        // Seen from two sides, what lies too high seems to lie at two places: the height explains it.
        (Err(_), Some(reason)) => observation.suspicious.push(suspicious(reason, None)),
        (Err(clash), None) if clash.apart_m > limits.duplicate_m => {
            observation.duplicates.push(duplicate(object, &clash));
        }
        (Err(clash), None) => {
            let reason = format!(
                "the pictures disagree by {:.2} mm about where it is: it moved, or the camera's pose is wrong",
                crate::units::mm_from_m(clash.apart_m)
            );
            observation.suspicious.push(suspicious(reason, None));
        }
    }
}

fn duplicate(object: &MarkedObject, clash: &fuse::Disagreement) -> Duplicate {
    let poses = clash.poses.iter().map(|marker| object_pose(object, marker)).collect();
    Duplicate { id: object.id.clone(), marker_id: object.marker_id, poses }
}

/// The object's pose from its marker's.
fn object_pose(object: &MarkedObject, table_from_marker: &Pose2) -> Pose2 {
    let theta = table_from_marker.theta - object.offset.theta;
    let turned = Pose2::new(0.0, 0.0, theta).transform([object.offset.x, object.offset.y]);
    Pose2::new(
        table_from_marker.x - turned[0],
        table_from_marker.y - turned[1],
        crate::geometry::pose::wrap_angle(theta),
    )
}

fn estimate(
    object: &MarkedObject,
    fused: &fuse::Fused,
    misread: usize,
    level: Option<&level::Level>,
    views: &[View],
) -> ObjectEstimate {
    let time = fused.views.iter().filter_map(|&view| views.get(view)).map(|view| view.time).max();
    // The marker's angle error swings the object's origin about the marker.
    let lever = object.offset.x.hypot(object.offset.y) * fused.std_theta_rad;
    ObjectEstimate {
        id: object.id.clone(),
        pose: object_pose(object, &fused.pose),
        std_xy_m: fused.std_xy_m.hypot(lever),
        std_theta_rad: fused.std_theta_rad,
        views: fused.views.len(),
        rejected_views: misread + fused.rejected,
        tilt_rad: level.map_or(0.0, level::Level::tilt_rad),
        tilt_std_rad: level.map_or(f64::INFINITY, |level| level.tilt_std_rad),
        height_error_m: level.map_or(0.0, |level| level.height_error_m),
        height_std_m: level.map_or(f64::INFINITY, |level| level.height_std_m),
        time: time.unwrap_or_default(),
    }
}
