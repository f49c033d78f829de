//! Sums of the vision benchmark: counts and errors, from scenes to figures.
//!
//! In: errors with their claimed covariance. Out: [`Accuracy`]: medians, percentiles, and how true the
//! claimed deviations are.

use cell_values::units::{deg_from_rad, mm_from_m};
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// A marker that was read where there is none, or not read where there is one.
#[derive(Clone, Debug, Serialize)]
pub struct Slip {
    /// The table's number.
    pub scene: usize,
    /// The view of it.
    pub view: usize,
    /// The marker's number.
    pub id: u32,
    /// Centre in the picture, pixels.
    pub centre: [f64; 2],
    /// Shortest edge, pixels.
    pub edge_px: f64,
    /// Bits repaired and decision margin of a false one; nothing of a missed one.
    pub hamming: Option<u8>,
    /// See `hamming`.
    pub decision_margin: Option<f64>,
}

/// What a share of scenes gave.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Frames looked at.
    pub frames: usize,
    /// Markers wholly in the picture.
    pub visible: usize,
    /// Those that were found.
    pub found: usize,
    /// Detections that match no marker.
    pub false_ids: Vec<Slip>,
    /// Markers read rightly with a corner far off.
    pub misplaced: Vec<Slip>,
    /// Markers wholly in the picture that were not found.
    pub missed: Vec<Slip>,
    /// Corner errors, pixels.
    pub corner_px: Vec<f64>,
    /// Pose errors with the true lens.
    pub exact: Sums,
    /// Pose errors with the calibrated lens.
    pub calibrated: Sums,
}

impl Tally {
    /// Both together.
    pub fn merge(mut self, other: Tally) -> Tally {
        self.frames += other.frames;
        self.visible += other.visible;
        self.found += other.found;
        self.false_ids.extend(other.false_ids);
        self.misplaced.extend(other.misplaced);
        self.missed.extend(other.missed);
        self.corner_px.extend(other.corner_px);
        self.exact.extend(other.exact);
        self.calibrated.extend(other.calibrated);
        self
    }
}

/// Pose errors with one set of intrinsics.
#[derive(Clone, Debug, Default)]
pub struct Sums {
    /// Of single frames.
    pub single: Errors,
    /// Of five frames together.
    pub fused: Errors,
    /// Poses that were refused although the marker was read.
    pub refused: usize,
}

impl Sums {
    fn extend(&mut self, other: Sums) {
        self.single.extend(other.single);
        self.fused.extend(other.fused);
        self.refused += other.refused;
    }

    /// The figures.
    pub fn accuracy(&self) -> Accuracy {
        let (single, fused) = (&self.single, &self.fused);
        Accuracy {
            position_median_mm: quantile(&mut single.position_mm.clone(), 0.5),
            position_p99_mm: quantile(&mut single.position_mm.clone(), 0.99),
            angle_median_deg: quantile(&mut single.angle_deg.clone(), 0.5),
            angle_p99_deg: quantile(&mut single.angle_deg.clone(), 0.99),
            std_ratio: single.std_ratio(),
            std_ratio_median: single.std_ratio_median(),
            fused_median_mm: quantile(&mut fused.position_mm.clone(), 0.5),
            fused_p99_mm: quantile(&mut fused.position_mm.clone(), 0.99),
            fused_std_ratio: fused.std_ratio(),
            fused_std_ratio_median: fused.std_ratio_median(),
            poses: single.position_mm.len(),
            fused_poses: fused.position_mm.len(),
            refused: self.refused,
        }
    }
}

/// Errors of poses.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    position_mm: Vec<f64>,
    angle_deg: Vec<f64>,
    /// Squared errors over what was claimed, summed over x, y and angle: 3 on average when the claims are
    /// true.
    normalised: Vec<f64>,
}

impl Errors {
    /// An error in x, y (m) and angle (rad), and the covariance that was claimed.
    pub fn add(&mut self, off: Vector3<f64>, covariance: &Matrix3<f64>) {
        self.position_mm.push(mm_from_m(off.x.hypot(off.y)));
        self.angle_deg.push(deg_from_rad(off.z.abs()));
        let information = covariance.try_inverse();
        self.normalised.push(information.map_or(f64::INFINITY, |w| (off.transpose() * w * off)[(0, 0)]));
    }

    fn extend(&mut self, other: Errors) {
        self.position_mm.extend(other.position_mm);
        self.angle_deg.extend(other.angle_deg);
        self.normalised.extend(other.normalised);
    }

    /// Real standard deviation over the claimed one, by medians: what a few bad slips do not change.
    fn std_ratio_median(&self) -> f64 {
        // The median of chi squared with three degrees of freedom.
        (quantile(&mut self.normalised.clone(), 0.5) / 2.366).sqrt()
    }

    /// Real standard deviation over the claimed one.
    fn std_ratio(&self) -> f64 {
        (self.normalised.iter().sum::<f64>() / (3 * self.normalised.len().max(1)) as f64).sqrt()
    }
}

/// How exact poses are.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Accuracy {
    /// Error in the plane of a single frame, median, mm.
    pub position_median_mm: f64,
    /// The same, 99th percentile, mm.
    pub position_p99_mm: f64,
    /// Error of the angle of a single frame, median, degrees.
    pub angle_median_deg: f64,
    /// The same, 99th percentile, degrees.
    pub angle_p99_deg: f64,
    /// Real over claimed standard deviation of x, y and angle, single frames.
    pub std_ratio: f64,
    /// The same by medians: what a few bad slips do not change.
    pub std_ratio_median: f64,
    /// Error in the plane of five frames fused, median, mm.
    pub fused_median_mm: f64,
    /// The same, 99th percentile, mm.
    pub fused_p99_mm: f64,
    /// Real over claimed standard deviation, five frames fused.
    pub fused_std_ratio: f64,
    /// The same by medians.
    pub fused_std_ratio_median: f64,
    /// Poses of single frames judged.
    pub poses: usize,
    /// Poses of five frames judged.
    pub fused_poses: usize,
    /// Poses refused.
    pub refused: usize,
}

/// The value that a share of all lies below; NaN of nothing.
pub fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1) as f64;
    values.get((share * last).round() as usize).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_of_the_list() {
        let mut values: Vec<f64> = (0..101).rev().map(f64::from).collect();
        assert_eq!((quantile(&mut values, 0.5), quantile(&mut values, 0.99)), (50.0, 99.0));
        assert!(quantile(&mut [], 0.5).is_nan());
    }

    #[test]
    fn true_claims_have_a_ratio_of_one_and_boasts_a_larger_one() {
        let mut errors = Errors::default();
        for sign in [-1.0, 1.0] {
            errors.add(
                Vector3::new(1e-4, 2e-4, 1e-3) * sign,
                &Matrix3::from_diagonal(&Vector3::new(1e-8, 4e-8, 1e-6)),
            );
        }
        assert!((errors.std_ratio() - 1.0).abs() < 1e-9);
        errors.add(Vector3::new(1e-3, 0.0, 0.0), &Matrix3::from_diagonal(&Vector3::new(1e-8, 4e-8, 1e-6)));
        assert!(errors.std_ratio() > 2.0);
    }
}
