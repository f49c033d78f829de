//! What a round says: where the camera sits and where the table lies, how sure, or what is missing.
//!
//! In: [`Sample`]s of a round, the cell as drawn, the lens. Out: [`HandEye`] with its errors in pixels and
//! metres, or a [`CalibrateError`]. This file has what the solvers share. `solve` picks the solver by the
//! mount, `hand_eye` is for a camera on the flange, `fixed` for one that does not move, `touch` places the
//! table by the tool's tip, `lens` measures the camera itself; `problem` is the least squares,
//! `observability` refuses poses that leave something open, `report` says how good it is. Pure.
//!
//! Honest errors: `held_out_*` predicts samples that were not used, `halves_*` compares two independent
//! halves.

pub mod fixed;
pub mod hand_eye;
pub mod lens;
pub mod observability;
pub mod problem;
pub mod report;
pub mod solve;
pub mod touch;

use cell_vision::camera::CameraModelError;
use cell_vision::cv::CvError;
use cell_vision::detect::Detection;
use nalgebra::{Isometry3, Matrix3, Matrix6, Vector6};
use serde::{Deserialize, Serialize};

/// One stop of the arm: where the flange was and what the camera saw.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The flange in the robot's base, by the calibrated kinematics and the joint positions of that moment.
    pub base_from_flange: Isometry3<f64>,
    /// What was detected; markers that are not reference markers are ignored.
    pub detections: Vec<Detection>,
}

/// Where to start, within some 5 cm and 30 degrees: the drawing's numbers do.
#[derive(Clone, Copy, Debug)]
pub struct HandEyeGuess {
    /// The camera in the flange frame.
    pub flange_from_camera: Isometry3<f64>,
    /// The table in the base frame.
    pub base_from_table: Isometry3<f64>,
}

/// What is required of the data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandEyeSettings {
    /// Corner noise along each axis, pixels: decides what is well determined.
    pub corner_std_px: f64,
    /// Corner errors beyond this pull less and less, pixels.
    pub robust_px: f64,
    /// Fewest samples with a reference marker.
    pub samples_min: usize,
    /// Largest standard deviation of the worst determined direction, m (rotations count by a lever of 0.3
    /// m).
    pub std_max_m: f64,
    /// Samples with a residual above this many times the median are left out, at most a quarter of them.
    pub outlier_ratio: f64,
    /// Parts for the held-out error; each is predicted by a fit to the others.
    pub folds: usize,
    /// The camera's place on the flange is known (it is the start's), only the table is looked for.
    pub keep_mount: bool,
    /// The camera is fixed and the hand carries what it looks at: changes the words of a refusal, not the
    /// mathematics.
    pub target_on_hand: bool,
}

impl Default for HandEyeSettings {
    fn default() -> HandEyeSettings {
        HandEyeSettings {
            corner_std_px: 0.1,
            robust_px: 0.5,
            samples_min: 6,
            std_max_m: 1e-3,
            outlier_ratio: 4.0,
            folds: 5,
            keep_mount: false,
            target_on_hand: false,
        }
    }
}

/// How well one sample fits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SampleResidual {
    /// Its place among the samples given, from 0.
    pub sample: usize,
    /// Reference markers it shows.
    pub markers: usize,
    /// Root mean square corner error, pixels.
    pub residual_px: f64,
    /// Root mean square corner error on the table, m.
    pub residual_m: f64,
    /// The same with a fit that has not seen this sample, m; `None` if there are too few samples for that.
    pub held_out_m: Option<f64>,
    /// Left out of the fit because it disagrees with all others.
    pub rejected: bool,
}

/// Standard deviations of a transform, root mean square over all three directions together.
///
/// The larger of two answers: what corner noise alone explains, and the jackknife over the folds, which also
/// sees errors that all corners of a sample share (the arm's).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TransformStd {
    /// Of the translation, m.
    pub translation_m: f64,
    /// Of the rotation, rad.
    pub rotation_rad: f64,
}

/// The calibration and everything that says how good it is.
#[derive(Clone, Debug, PartialEq)]
pub struct HandEye {
    /// The camera in the flange frame.
    pub flange_from_camera: Isometry3<f64>,
    /// The table in the base frame.
    pub base_from_table: Isometry3<f64>,
    /// Standard deviation of `flange_from_camera`.
    pub flange_from_camera_std: TransformStd,
    /// Covariance of small motions of the camera in its own frame: shift (m2) before turn (rad2).
    pub flange_from_camera_covariance: Matrix6<f64>,
    /// Standard deviation of `base_from_table`.
    pub base_from_table_std: TransformStd,
    /// Covariance of small motions of the table in its own frame: shift (m2) before turn (rad2).
    pub base_from_table_covariance: Matrix6<f64>,
    /// Root mean square corner error of the samples used, pixels.
    pub reprojection_px_rms: f64,
    /// Root mean square error on the table of samples predicted without having been used, m.
    pub held_out_rms_m: Option<f64>,
    /// Largest of those by sample, m.
    pub held_out_max_m: Option<f64>,
    /// How far the camera's place moves between fits to two halves of the samples, m.
    pub halves_m: Option<f64>,
    /// How far its rotation turns between them, rad.
    pub halves_rad: Option<f64>,
    /// One entry for each sample with a reference marker.
    pub samples: Vec<SampleResidual>,
}

impl HandEye {
    /// Adds what a mount that was taken as known leaves open, with the table `lever_m` (m) from the camera.
    ///
    /// How its error moves the table depends on the poses; the full error counts, shared evenly by the axes.
    pub fn widen_by_mount(&mut self, mount: &TransformStd, lever_m: f64) {
        let turn = mount.rotation_rad.powi(2);
        // A lever moves its end along two of three axes.
        let shift = mount.translation_m.powi(2) + 2.0 / 3.0 * turn * lever_m.powi(2);
        let axes = |each: f64| Matrix3::from_diagonal_element(each / 3.0);
        let mut added = Matrix6::zeros();
        added.fixed_view_mut::<3, 3>(0, 0).copy_from(&axes(shift));
        added.fixed_view_mut::<3, 3>(3, 3).copy_from(&axes(turn));
        self.base_from_table_covariance += added;
        self.base_from_table_std = TransformStd::of(&self.base_from_table_covariance);
    }
}

impl TransformStd {
    /// Of a covariance of shift (m2) before turn (rad2).
    pub fn of(covariance: &Matrix6<f64>) -> TransformStd {
        let sum = |from: usize| (from..from + 3).map(|i| covariance[(i, i)]).sum::<f64>().sqrt();
        TransformStd { translation_m: sum(0), rotation_rad: sum(3) }
    }

    /// A covariance that has these, shared evenly by the axes: what is left of one in a file.
    pub fn spread(&self) -> Matrix6<f64> {
        let each = |std: f64| std.powi(2) / 3.0;
        let (shift, turn) = (each(self.translation_m), each(self.rotation_rad));
        Matrix6::from_diagonal(&Vector6::new(shift, shift, shift, turn, turn, turn))
    }
}

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError {
    /// Too few samples show a reference marker.
    #[error(
        "only {found} of {given} samples show a reference marker, {wanted} are needed: check the marker ids \
         and sizes in the config, the light, and that the camera looks at the table"
    )]
    TooFewSamples {
        /// Samples with a reference marker.
        found: usize,
        /// Samples given.
        given: usize,
        /// Samples needed.
        wanted: usize,
    },
    /// Too few samples show the board on the hand.
    #[error(
        "only {found} of {given} samples show the board on the hand, {wanted} are needed: check \
         `camera.board` in the config against the print, the light, and that the camera sees the hand"
    )]
    BoardUnseen {
        /// Samples with a marker of the board.
        found: usize,
        /// Samples given.
        given: usize,
        /// Samples needed.
        wanted: usize,
    },
    /// The poses leave something undetermined.
    #[error("{sentence} (worst direction known to {std_mm:.1} mm only, {limit_mm:.1} mm is the limit)")]
    NotObservable {
        /// Which motion is missing.
        sentence: String,
        /// Standard deviation of the worst direction, mm.
        std_mm: f64,
        /// The limit, mm.
        limit_mm: f64,
    },
    /// The fit did not come near the data.
    #[error(
        "the best fit misses the corners by {reprojection_px:.1} px: samples taken while the arm moved, \
         wrong marker sizes, a wrong marker survey, or the camera's intrinsics of another resolution"
    )]
    NoFit {
        /// Root mean square corner error, pixels.
        reprojection_px: f64,
    },
    /// The camera's numbers are broken.
    #[error("the camera's calibration cannot be used")]
    Camera(#[from] CameraModelError),
    /// OpenCV failed.
    #[error("the corners could not be undistorted")]
    Cv(#[from] CvError),
}
