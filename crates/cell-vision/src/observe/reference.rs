//! The markers fixed on the table against their survey: has the camera been bumped, has the table moved?
//!
//! In: the surveyed markers and what the views saw. Out: [`ReferenceCheck`]: each marker's error, their rms,
//! the rigid shift that explains most of it, and for each place the camera looked from how far it seems to
//! have been shifted, turned and lifted. Each place by itself, because what a bump does to the looks from
//! two sides cancels in their mean. The limits are the caller's ([`DriftLimits`]). Pure.

use crate::observe::fuse;
use crate::observe::input::{ObserveLimits, ReferenceMarker, View};
use crate::observe::planar::{self, Placed, Target};
use crate::observe::sighting::Sighting;
use rearrange::geometry::pose::Pose2;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One reference marker's error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceError {
    /// Its number.
    pub id: u32,
    /// Measured centre minus surveyed centre, m, mean over the views.
    pub error_m: [f64; 2],
    /// Measured minus surveyed angle, rad.
    pub error_rad: f64,
    /// Pictures it was seen in.
    pub views: usize,
}

/// How far the camera seems to be from where it should have been at one place, shown by the markers it saw
/// from there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LookShift {
    /// The first of the views from there.
    pub view: usize,
    /// Markers it rests on.
    pub markers: usize,
    /// Where the markers seem to have gone at their centroid, m: the camera went the other way, or tilted.
    pub shift_m: [f64; 2],
    /// By how much they seem turned, rad.
    pub turn_rad: f64,
    /// How much nearer to the table the camera seems to be, m, by how much larger the layout looks.
    pub lift_m: f64,
    /// Each marker's error as seen from there.
    pub errors: Vec<ReferenceError>,
}

/// From where on the camera counts as moved.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
pub struct DriftLimits {
    /// Root mean square error of the markers' centres over all views, m.
    pub residual_m: f64,
    /// Shift and lift from one place, m.
    pub shift_m: f64,
    /// Turn from one place, rad.
    pub turn_rad: f64,
}

/// All reference markers that were seen, against their survey.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceCheck {
    /// One entry for each marker seen, in survey order.
    pub markers: Vec<ReferenceError>,
    /// Root mean square of the centre errors, m.
    pub residual_rms_m: f64,
    /// Largest centre error, m.
    pub residual_max_m: f64,
    /// Mean shift of the markers, m: where the table seems to have gone at their centroid.
    pub shift_m: [f64; 2],
    /// Turn about their centroid, rad; 0 with fewer than 2 markers.
    pub turn_rad: f64,
    /// The same from each place that showed at least three markers.
    pub looks: Vec<LookShift>,
}

/// Fewest markers that separate shift, turn and lift with one to spare.
pub const MARKERS_MIN: usize = 3;

impl ReferenceCheck {
    /// The place whose shift, turn or lift exceeds its limit the most, with that excess (1 is the limit);
    /// NaN counts as beyond every limit.
    pub fn worst_look(&self, limits: &DriftLimits) -> Option<(LookShift, f64)> {
        let excess = |look: &LookShift| {
            let [x, y] = look.shift_m;
            let shares = [
                x.hypot(y) / limits.shift_m,
                look.lift_m.abs() / limits.shift_m,
                look.turn_rad.abs() / limits.turn_rad,
            ];
            shares
                .into_iter()
                .fold(0.0, |worst: f64, share| if share.is_nan() { f64::INFINITY } else { worst.max(share) })
        };
        let looks = self.looks.iter().map(|look| (look.clone(), excess(look)));
        looks.max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// True when camera or table are not where they were calibrated.
    pub fn drifted(&self, limits: &DriftLimits) -> bool {
        // A number that is none is no proof that the calibration holds.
        let holds = self.residual_rms_m <= limits.residual_m;
        !holds || self.worst_look(limits).is_some_and(|(_, excess)| excess > 1.0)
    }
}

/// Compares; `None` when no reference marker was seen.
pub fn check(
    reference: &[ReferenceMarker],
    sightings: &BTreeMap<u32, Vec<Sighting>>,
    views: &[View],
    limits: &ObserveLimits,
) -> Option<ReferenceCheck> {
    let mut markers = Vec::new();
    let mut surveyed = Vec::new();
    let mut by_marker: Vec<(&ReferenceMarker, Vec<Placed>)> = Vec::new();
    for marker in reference {
        // They are the table: held exactly flat, any lift or tilt of the camera shows as a shift.
        let target = Target { size_m: marker.size, height_m: 0.0, height_std_m: 0.0, tilt_std_rad: 0.0 };
        let seen = sightings.get(&marker.id).map_or(&[][..], Vec::as_slice);
        let placed: Vec<Placed> = seen
            .iter()
            .filter_map(|sighting| planar::place(sighting, target, views, limits))
            .filter(|p| p.shape_residual_px <= limits.shape_residual_max_px)
            .collect();
        if let Some(error) = error(marker, &placed) {
            markers.push(error);
            surveyed.push(marker.pose);
        }
        by_marker.push((marker, placed));
    }
    if markers.is_empty() {
        return None;
    }
    let count = markers.len() as f64;
    let squares: Vec<f64> = markers.iter().map(|m| m.error_m[0].powi(2) + m.error_m[1].powi(2)).collect();
    let (shift_m, turn_rad) = rigid_shift(&markers, &surveyed);
    Some(ReferenceCheck {
        residual_rms_m: (squares.iter().sum::<f64>() / count).sqrt(),
        residual_max_m: squares.iter().copied().fold(0.0, f64::max).sqrt(),
        shift_m,
        turn_rad,
        looks: looks(&by_marker, views),
        markers,
    })
}

/// Shift, turn and lift of each place the camera looked from.
fn looks(by_marker: &[(&ReferenceMarker, Vec<Placed>)], views: &[View]) -> Vec<LookShift> {
    let mut looks = Vec::new();
    for (first, view) in views.iter().enumerate() {
        let from_here =
            |at: usize| views.get(at).is_some_and(|v| v.table_from_camera == view.table_from_camera);
        if (0..first).any(from_here) {
            continue;
        }
        let (mut errors, mut surveyed) = (Vec::new(), Vec::new());
        for (marker, placed) in by_marker {
            let here: Vec<Placed> = placed.iter().filter(|p| from_here(p.sighting.view)).cloned().collect();
            if let Some(error) = error(marker, &here) {
                errors.push(error);
                surveyed.push(marker.pose);
            }
        }
        if errors.len() < MARKERS_MIN {
            continue;
        }
        let (shift_m, turn_rad) = rigid_shift(&errors, &surveyed);
        let lift_m = growth(&errors, &surveyed) * view.table_from_camera.translation.z;
        looks.push(LookShift { view: first, markers: errors.len(), shift_m, turn_rad, lift_m, errors });
    }
    looks
}

/// By what share the layout seems larger about its centroid.
fn growth(errors: &[ReferenceError], surveyed: &[Pose2]) -> f64 {
    let count = errors.len() as f64;
    let centre = [
        surveyed.iter().map(|pose| pose.x).sum::<f64>() / count,
        surveyed.iter().map(|pose| pose.y).sum::<f64>() / count,
    ];
    let (mut grown, mut arms) = (0.0, 0.0);
    for (error, at) in errors.iter().zip(surveyed) {
        let arm = [at.x - centre[0], at.y - centre[1]];
        grown += arm[0] * error.error_m[0] + arm[1] * error.error_m[1];
        arms += arm[0].powi(2) + arm[1].powi(2);
    }
    if arms > 1e-9 { grown / arms } else { 0.0 }
}

fn error(marker: &ReferenceMarker, placed: &[Placed]) -> Option<ReferenceError> {
    let middle = fuse::middle(placed)?;
    Some(ReferenceError {
        id: marker.id,
        error_m: [middle.x - marker.pose.x, middle.y - marker.pose.y],
        error_rad: rearrange::geometry::pose::wrap_angle(middle.theta - marker.pose.theta),
        views: placed.len(),
    })
}

/// Mean shift and small turn about the centroid of the surveyed markers.
fn rigid_shift(errors: &[ReferenceError], surveyed: &[Pose2]) -> ([f64; 2], f64) {
    let count = errors.len() as f64;
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / count;
    let shift = [0, 1].map(|axis| mean(&mut errors.iter().map(|e| e.error_m[axis])));
    let centre = [mean(&mut surveyed.iter().map(|p| p.x)), mean(&mut surveyed.iter().map(|p| p.y))];
    let (mut swept, mut arms) = (0.0, 0.0);
    for (error, at) in errors.iter().zip(surveyed) {
        let arm = [at.x - centre[0], at.y - centre[1]];
        swept += arm[0] * (error.error_m[1] - shift[1]) - arm[1] * (error.error_m[0] - shift[0]);
        arms += arm[0].powi(2) + arm[1].powi(2);
    }
    (shift, if arms > 1e-9 { swept / arms } else { 0.0 })
}
