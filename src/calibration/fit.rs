//! Camera mount and table from a round's samples, started at the configuration's nominal values.
//!
//! In: the configuration, the lens, samples of a round with the camera on the flange. Out: the solution with
//! its residuals.

use crate::config::cell::{CameraMount, CellConfig};
use crate::config::setup::reference_markers;
use crate::vision::calibrate::{
    CalibrateError, HandEye, HandEyeGuess, HandEyeSettings, Sample, solve_hand_eye,
};
use crate::vision::camera::CameraModel;
use nalgebra::Isometry3;

/// Why there is no solution.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// The camera does not sit where this solver looks for it.
    #[error("the configuration's camera is not mounted on the flange")]
    FixedCamera,
    /// The samples do not give a solution.
    #[error("calibration")]
    Solve(#[from] CalibrateError),
}

/// Camera mount and table from the samples, starting at the configuration's nominal values.
///
/// With a known mount only the table is solved for.
///
/// # Errors
/// [`FitError`].
pub fn solve(
    config: &CellConfig,
    lens: &CameraModel,
    samples: &[Sample],
    known_mount: Option<Isometry3<f64>>,
) -> Result<HandEye, FitError> {
    let CameraMount::Flange { flange_from_camera } = config.camera else {
        return Err(FitError::FixedCamera);
    };
    let flange_from_camera = known_mount.unwrap_or(flange_from_camera);
    let guess = HandEyeGuess { flange_from_camera, base_from_table: config.base_from_table };
    let settings = HandEyeSettings { keep_mount: known_mount.is_some(), ..HandEyeSettings::default() };
    Ok(solve_hand_eye(samples, &reference_markers(config), lens, &guess, &settings)?)
}
