//! The markers fixed on the table against their survey: has the camera been bumped, has the table moved?
//!
//! In: the surveyed markers and what the views saw. Out: [`ReferenceCheck`]: each marker's error, their rms, and the rigid shift that
//! explains most of it. The limits (1 mm, 0.15 degrees) are the caller's. Pure.

use crate::geometry::pose::Pose2;
use crate::vision::observe::planar::{self, Placed, Sighting, Target};
use crate::vision::observe::{ObserveLimits, ReferenceMarker, View, fuse};
use serde::Serialize;
use std::collections::BTreeMap;

/// One reference marker's error.
#[derive(Clone, Debug, PartialEq, Serialize)]
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

/// All reference markers that were seen, against their survey.
#[derive(Clone, Debug, PartialEq, Serialize)]
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
        markers,
    })
}

fn error(marker: &ReferenceMarker, placed: &[Placed]) -> Option<ReferenceError> {
    let middle = fuse::middle(placed)?;
    Some(ReferenceError {
        id: marker.id,
        error_m: [middle.x - marker.pose.x, middle.y - marker.pose.y],
        error_rad: crate::geometry::pose::wrap_angle(middle.theta - marker.pose.theta),
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
