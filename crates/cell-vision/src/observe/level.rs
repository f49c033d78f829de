//! Does a marker lie level at the height it should have? Decided by all views together.
//!
//! In: the placed sightings of one marker, its target plane. Out: [`Level`]: tilt, height error, and how
//! much better a tilted or raised square explains the corners. A complaint needs both size (more than the
//! limit) and significance (a likelihood ratio well beyond corner noise): size alone would raise false
//! alarms on small markers seen frontally, significance alone would complain about harmless tenths of a
//! degree.

use crate::observe::fuse;
use crate::observe::input::{ObserveLimits, View};
use crate::observe::planar::{Placed, Target};
use crate::observe::pnp::{self, Freedom};
use crate::observe::sighting::Sighting;
use cell_values::units::{deg_from_rad, mm_from_m};
use nalgebra::Vector3;

/// How level a marker lies.
#[derive(Clone, Copy, Debug)]
pub struct Level {
    /// Normal of the marker, table frame.
    pub normal: Vector3<f64>,
    /// Standard deviation of the tilt in its worse direction, rad.
    pub tilt_std_rad: f64,
    /// Standard deviations by which the corners indicate a tilt.
    pub tilt_significance: f64,
    /// Height above the one it should have, m, the marker taken as level.
    pub height_error_m: f64,
    /// Standard deviation of that, m.
    pub height_std_m: f64,
    /// Standard deviations by which the corners indicate another height.
    pub height_significance: f64,
    /// Height error of the centre when the marker may also tilt, m.
    pub free_height_error_m: f64,
}

impl Level {
    /// Angle between the marker's normal and the vertical, rad.
    pub fn tilt_rad(&self) -> f64 {
        self.normal.x.hypot(self.normal.y).atan2(self.normal.z)
    }

    /// What is wrong in words, or `None` if the marker may be taken as level at its height.
    pub fn complaint(&self, limits: &ObserveLimits) -> Option<String> {
        let tilted = self.tilt_rad() > limits.tilt_max_rad && self.tilt_significance > limits.significance;
        let raised = self.height_error_m.abs() > limits.height_error_max_m
            && self.height_significance > limits.significance;
        let tilt = format!(
            "tilted by {:.1} deg (limit {:.1} deg)",
            deg_from_rad(self.tilt_rad()),
            deg_from_rad(limits.tilt_max_rad)
        );
        let high = self.height_error_m > 0.0;
        let (error, way) = (mm_from_m(self.height_error_m), if high { "high" } else { "low" });
        let height = format!(
            "its marker is {:.1} mm too {way} (limit {:.1} mm)",
            error.abs(),
            mm_from_m(limits.height_error_max_m)
        );
        match (tilted, raised) {
            (false, false) => None,
            (true, false) => Some(format!("{tilt}: it lies on something or its marker is not flat")),
            (false, true) => {
                let lies = if high { "it lies on something, or " } else { "" };
                Some(format!("{height}: {lies}its height or marker size is wrong in the config"))
            }
            (true, true) if high => Some(format!("{tilt} and {height}: it lies on something")),
            (true, true) => Some(format!("{tilt} and {height}: it lies askew")),
        }
    }
}

/// By how much looks from different places disagree along each axis, pixels: errors of arm and mount, of
/// which the corners' own noise knows nothing. Without it a small marker that lies flat is now and then
/// called tilted.
const LOOKS_PX: f64 = 0.07;

/// Compares level, raised and tilted fits over all views; `None` if the numbers break down.
pub fn fit(placed: &[Placed], target: Target, views: &[View], limits: &ObserveLimits) -> Option<Level> {
    let sightings: Vec<Sighting> = placed.iter().map(|p| p.sighting.clone()).collect();
    let start = fuse::middle(placed)?.at_height(target.height_m);
    let fit = |start, freedom| pnp::fit(&sightings, target.size_m, views, start, freedom, None);
    let flat = fit(start, Freedom::Plane)?;
    let raised = fit(flat.table_from_marker, Freedom::PlaneAndHeight)?;
    let mut free = fit(raised.table_from_marker, Freedom::All)?;
    // A square seen in perspective has a mirror pose that fits nearly as well; look on both sides.
    let mirrored = mirror(&free.table_from_marker, &sightings, views)?;
    if let Some(other) = fit(mirrored, Freedom::All)
        && other.cost_px2 < free.cost_px2
    {
        free = other;
    }
    // Repeated pictures from one place share their corner bias, which therefore does not average out.
    let repeats = sightings.len() as f64 / fuse::places(placed, views).len().max(1) as f64;
    let shared = limits.corner_bias_px.hypot(LOOKS_PX);
    let modelled = limits.corner_noise_px.powi(2) + repeats * shared.powi(2);
    let freedom_left = (8 * sightings.len() - 6).max(1) as f64;
    let variance = modelled.max(free.cost_px2 / freedom_left);
    let significance = |less: f64, more: f64| ((less - more).max(0.0) / variance).sqrt();
    let covariance = free.information.try_inverse()? * variance;
    let height_variance = held_level_height_variance(&raised.information)? * variance;
    let tilts = covariance.fixed_view::<2, 2>(3, 3).into_owned();
    Some(Level {
        normal: free.table_from_marker.rotation * Vector3::z(),
        tilt_std_rad: tilts.symmetric_eigenvalues().max().max(0.0).sqrt(),
        tilt_significance: significance(raised.cost_px2, free.cost_px2),
        height_error_m: raised.table_from_marker.translation.z - target.height_m,
        height_std_m: height_variance.hypot(target.height_std_m.powi(2)).sqrt(),
        height_significance: significance(flat.cost_px2, raised.cost_px2),
        free_height_error_m: free.table_from_marker.translation.z - target.height_m,
    })
}

/// Variance of the height for 1 px of noise when the marker cannot tilt.
fn held_level_height_variance(information: &nalgebra::Matrix6<f64>) -> Option<f64> {
    let free = [0, 1, 2, 5];
    let reduced = nalgebra::Matrix4::from_fn(|i, j| information[(free[i], free[j])]);
    Some(reduced.try_inverse()?[(2, 2)])
}

/// The pose with its normal mirrored about the line of sight of the first view.
fn mirror(
    table_from_marker: &nalgebra::Isometry3<f64>,
    sightings: &[Sighting],
    views: &[View],
) -> Option<nalgebra::Isometry3<f64>> {
    let view = views.get(sightings.first()?.view)?;
    let centre = table_from_marker.translation.vector;
    let sight = (view.table_from_camera.translation.vector - centre).try_normalize(1e-9)?;
    let normal = table_from_marker.rotation * Vector3::z();
    let other = 2.0 * normal.dot(&sight) * sight - normal;
    let turn = nalgebra::UnitQuaternion::rotation_between(&normal, &other)?;
    Some(nalgebra::Isometry3::from_parts(table_from_marker.translation, turn * table_from_marker.rotation))
}
