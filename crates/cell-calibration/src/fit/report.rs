//! How good a hand-eye fit is, in numbers a person can trust or doubt.
//!
//! In: the problem, the stops used, the fit. Out: [`HandEye`] with residuals by sample, errors of samples
//! predicted without having been used, the difference of two halves, and standard deviations. Corner scatter
//! alone would be too proud of itself: all corners of a sample share the arm's error, which only leaving
//! whole samples out brings to light.

use crate::fit::problem::{Fit, Problem, Stop};
use crate::fit::{HandEye, HandEyeGuess, HandEyeSettings, SampleResidual, TransformStd};
use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3};

/// Everything a person needs to trust or doubt the fit.
pub fn report(
    problem: &Problem,
    used: &[usize],
    fit: &Fit,
    reprojection_px_rms: f64,
    settings: &HandEyeSettings,
) -> HandEye {
    let folds = folds(problem, used, fit, settings);
    let held_out = |index: usize| {
        let fold = folds.iter().find(|fold| fold.tested.contains(&index))?;
        problem.residual_m(index, &fold.guess)
    };
    let sample = |(index, stop): (usize, &Stop)| SampleResidual {
        sample: stop.sample,
        markers: stop.board_m.len() / 4,
        residual_px: problem.residual_px(&[index], &fit.guess),
        residual_m: problem.residual_m(index, &fit.guess).unwrap_or(f64::INFINITY),
        held_out_m: held_out(index),
        rejected: !used.contains(&index),
    };
    let samples: Vec<SampleResidual> = problem.stops.iter().enumerate().map(sample).collect();
    let predicted: Vec<f64> = samples.iter().filter(|s| !s.rejected).filter_map(|s| s.held_out_m).collect();
    let squares: f64 = predicted.iter().map(|error| error * error).sum();
    let known = !predicted.is_empty();
    let halves = halves(problem, used, fit, settings);
    let noise_px = reprojection_px_rms.max(settings.corner_std_px) / std::f64::consts::SQRT_2;
    let covariance = fit.information.try_inverse().map(|inverse| inverse * noise_px.powi(2));
    let part = |from: usize, of: fn(&HandEyeGuess) -> Isometry3<f64>| {
        let by_corners = covariance.map(|c| c.fixed_view::<6, 6>(from, from).into_owned());
        by_corners.map(|c| widened(c, jackknife(&folds, of)))
    };
    let (camera, table) = (part(0, |guess| guess.flange_from_camera), part(6, |guess| guess.base_from_table));
    HandEye {
        flange_from_camera: fit.guess.flange_from_camera,
        base_from_table: fit.guess.base_from_table,
        flange_from_camera_std: camera.as_ref().map_or(UNKNOWN, TransformStd::of),
        flange_from_camera_covariance: camera.unwrap_or_else(Matrix6::identity),
        base_from_table_std: table.as_ref().map_or(UNKNOWN, TransformStd::of),
        // A metre and a radian: nothing is known.
        base_from_table_covariance: table.unwrap_or_else(Matrix6::identity),
        reprojection_px_rms,
        held_out_rms_m: known.then(|| (squares / predicted.len() as f64).sqrt()),
        held_out_max_m: known.then(|| predicted.iter().copied().fold(0.0, f64::max)),
        halves_m: halves.map(|(m, _)| m),
        halves_rad: halves.map(|(_, rad)| rad),
        samples,
    }
}

/// A fit that has not seen some of the stops.
struct Fold {
    tested: Vec<usize>,
    guess: HandEyeGuess,
}

fn folds(problem: &Problem, used: &[usize], fit: &Fit, settings: &HandEyeSettings) -> Vec<Fold> {
    let count = settings.folds.clamp(2, used.len().max(2));
    let mut folds = Vec::new();
    for fold in 0..count {
        let part = |wanted: bool| -> Vec<usize> {
            let places = used.iter().enumerate();
            places.filter(|(place, _)| (place % count == fold) == wanted).map(|(_, &stop)| stop).collect()
        };
        let (tested, kept) = (part(true), part(false));
        if kept.len() >= 3
            && let Some(other) = problem.fit(&kept, fit.guess, settings)
        {
            folds.push(Fold { tested, guess: other.guess });
        }
    }
    folds
}

/// Variances (translation m2, rotation rad2, all directions together) by leaving out one fold at a time.
fn jackknife(folds: &[Fold], of: fn(&HandEyeGuess) -> Isometry3<f64>) -> (f64, f64) {
    let poses: Vec<Isometry3<f64>> = folds.iter().map(|fold| of(&fold.guess)).collect();
    let Some(mean) = mean_pose(poses.iter().copied()) else { return (0.0, 0.0) };
    let off: Vec<Isometry3<f64>> = poses.iter().map(|pose| mean.inverse() * pose).collect();
    let factor = (poses.len() as f64 - 1.0) / poses.len() as f64;
    let shifts: f64 = off.iter().map(|pose| pose.translation.vector.norm_squared()).sum();
    let turns: f64 = off.iter().map(|pose| pose.rotation.angle().powi(2)).sum();
    (factor * shifts, factor * turns)
}

/// Of what no number of samples would determine.
const UNKNOWN: TransformStd = TransformStd { translation_m: f64::INFINITY, rotation_rad: f64::INFINITY };

/// The covariance by corner noise, stretched where leaving samples out showed more (variances of shift and
/// turn).
fn widened(by_corners: Matrix6<f64>, by_folds: (f64, f64)) -> Matrix6<f64> {
    let std = TransformStd::of(&by_corners);
    let factor = |own: f64, other: f64| if own > 0.0 { (other.sqrt() / own).max(1.0) } else { 1.0 };
    let (shift, turn) = (factor(std.translation_m, by_folds.0), factor(std.rotation_rad, by_folds.1));
    let scale = |i: usize| if i < 3 { shift } else { turn };
    Matrix6::from_fn(|i, j| by_corners[(i, j)] * scale(i) * scale(j))
}

/// Distance and angle between the cameras of two fits to every other sample.
fn halves(problem: &Problem, used: &[usize], fit: &Fit, settings: &HandEyeSettings) -> Option<(f64, f64)> {
    if used.len() < 6 {
        return None;
    }
    let half = |odd: usize| {
        let stops: Vec<usize> = used.iter().copied().skip(odd).step_by(2).collect();
        problem.fit(&stops, fit.guess, settings).map(|fit| fit.guess.flange_from_camera)
    };
    let between = half(0)?.inverse() * half(1)?;
    Some((between.translation.vector.norm(), between.rotation.angle()))
}

/// Mean translation and rotation of poses that lie close together.
pub fn mean_pose(poses: impl Iterator<Item = Isometry3<f64>>) -> Option<Isometry3<f64>> {
    let poses: Vec<Isometry3<f64>> = poses.collect();
    let first = poses.first()?;
    let count = poses.len() as f64;
    let place = poses.iter().map(|p| p.translation.vector).sum::<Vector3<f64>>() / count;
    let turn = poses.iter().map(|p| (first.rotation.inverse() * p.rotation).scaled_axis());
    let turn = UnitQuaternion::from_scaled_axis(turn.sum::<Vector3<f64>>() / count);
    Some(Isometry3::from_parts(Translation3::from(place), first.rotation * turn))
}
