//! Do the arm's poses determine the calibration, and if not, which motion is missing?
//!
//! In: a fit and its samples. Out: nothing, or `NotObservable` with a sentence for the operator. The
//! smallest singular value of the problem says how well the worst direction is known; the rotations between
//! the samples, taken about the camera's axes, say why. Without rotation about two different axes the
//! camera's place along the common axis cannot be distinguished from the table's, and OpenCV's solvers
//! return a number all the same.

use crate::fit::problem::{Fit, Problem};
use crate::fit::{CalibrateError, HandEyeSettings};
use cell_values::units::mm_from_m;
use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector3};

/// Lever by which a rotation error counts as a distance, m: about the distance to the table.
const LEVER_M: f64 = 0.3;

/// Rotations with a smaller spread (standard deviation) do not count, rad.
const TURN_MIN_RAD: f64 = 0.05;

/// Refuses samples that leave a direction undetermined.
///
/// # Errors
/// `NotObservable`.
pub fn check(
    problem: &Problem,
    used: &[usize],
    fit: &Fit,
    settings: &HandEyeSettings,
) -> Result<(), CalibrateError> {
    let noise_px =
        settings.corner_std_px.max(problem.residual_px(used, &fit.guess) / std::f64::consts::SQRT_2);
    let std_m = worst_direction_std_m(fit, noise_px);
    if std_m <= settings.std_max_m {
        return Ok(());
    }
    Err(CalibrateError::NotObservable {
        sentence: sentence(&turns(problem, used, fit), settings.target_on_hand),
        std_mm: mm_from_m(std_m),
        limit_mm: mm_from_m(settings.std_max_m),
    })
}

/// Standard deviation of the worst determined combination of the twelve unknowns, m.
fn worst_direction_std_m(fit: &Fit, noise_px: f64) -> f64 {
    let is_turn = |i: usize| i % 6 >= 3;
    let scale = |i: usize| if is_turn(i) { 1.0 / LEVER_M } else { 1.0 };
    let scaled = SMatrix::<f64, 12, 12>::from_fn(|i, j| fit.information[(i, j)] * scale(i) * scale(j));
    let weakest = scaled.symmetric_eigenvalues().min();
    if weakest > 0.0 { noise_px / weakest.sqrt() } else { f64::INFINITY }
}

/// Scatter (mean square, rad2) of the camera's rotations about their mean, in the camera's axes.
fn turns(problem: &Problem, used: &[usize], fit: &Fit) -> Matrix3<f64> {
    let rotations: Vec<UnitQuaternion<f64>> = used
        .iter()
        .filter_map(|&stop| problem.stops.get(stop))
        .map(|stop| stop.base_from_flange.rotation * fit.guess.flange_from_camera.rotation)
        .collect();
    let Some(first) = rotations.first() else { return Matrix3::zeros() };
    let count = rotations.len() as f64;
    let vectors: Vec<Vector3<f64>> = rotations.iter().map(|r| (first.inverse() * r).scaled_axis()).collect();
    let mean = vectors.iter().sum::<Vector3<f64>>() / count;
    vectors.iter().map(|v| (v - mean) * (v - mean).transpose()).sum::<Matrix3<f64>>() / count
}

/// The motion that is missing, for the operator.
fn sentence(scatter: &Matrix3<f64>, target_on_hand: bool) -> String {
    let moved = if target_on_hand { "the hand" } else { "the camera" };
    let eigen = scatter.symmetric_eigen();
    let turning: Vec<usize> =
        (0..3).filter(|&i| eigen.eigenvalues[i].max(0.0).sqrt() >= TURN_MIN_RAD).collect();
    let names = ["x", "y", "z"];
    match turning.as_slice() {
        [] => format!(
            "{moved} hardly rotates between the samples: rotate it by 20 degrees and more about the camera's \
             x axis and about the camera's y axis (image right and image down)"
        ),
        &[only] => {
            let axis = eigen.eigenvectors.column(only).into_owned();
            let mut by_share = [0, 1, 2];
            by_share.sort_by(|&a, &b| axis[a].abs().total_cmp(&axis[b].abs()));
            // The optical axis is the least useful of the two that are left: tilting changes the
            // perspective.
            let missing = match by_share {
                [a, b, _] if a == 2 || b == 2 => names[if a == 2 { b } else { a }].to_owned(),
                [a, b, _] => format!("{} axis and about the camera's {}", names[a.min(b)], names[a.max(b)]),
            };
            format!(
                "all rotations are about one axis, nearest the camera's {}: also rotate {moved} by 20 \
                 degrees and more about the camera's {missing} axis",
                names[by_share[2]]
            )
        }
        _ => "the samples rotate enough but show too little: take more of them, further apart, with more \
              reference markers in each picture"
            .to_owned(),
    }
}
