//! Where the camera sits on the flange and the table under the robot, from pictures of the reference markers.
//!
//! In: [`Sample`]s (arm pose and detections), the surveyed reference markers, the lens, a rough guess. Out:
//! [`HandEye`] with its errors in pixels and metres, or the sentence that says what is missing. Both
//! transforms are solved together (robot-world and hand-eye): a closed form or the guess starts,
//! Levenberg-Marquardt on pixel errors with a robust loss finishes. Poses that leave a direction unseen are
//! refused instead of answered with a number. Pure.
//!
//! Honest errors: `held_out_*` predicts samples that were not used, `halves_*` compares two independent
//! halves.

pub mod fixed;
pub mod lens;
pub mod observability;
pub mod problem;
pub mod report;
pub mod touch;

use crate::vision::camera::{CameraModel, CameraModelError};
use crate::vision::cv::{self, CvError};
use crate::vision::detect::Detection;
use crate::vision::observe::ReferenceMarker;
use nalgebra::{Isometry3, Matrix3, Matrix6, Vector6};
use problem::{Fit, Problem};
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

/// What is asked of the data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandEyeSettings {
    /// Corner noise along each axis, pixels: decides what is well determined.
    pub corner_std_px: f64,
    /// Corner errors beyond this pull less and less, pixels.
    pub robust_px: f64,
    /// Fewest samples with a reference marker.
    pub samples_min: usize,
    /// Largest standard deviation of the worst determined direction, m (rotations count by a lever of 0.3 m).
    pub std_max_m: f64,
    /// Samples with a residual above this many times the median are left out, at most a quarter of them.
    pub outlier_ratio: f64,
    /// Parts for the held-out error; each is predicted by a fit to the others.
    pub folds: usize,
    /// The camera's place on the flange is known (it is the start's), only the table is looked for.
    pub keep_mount: bool,
    /// The camera stands and the hand carries what it looks at: changes the words of a refusal, not the
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
        "only {found} of {given} samples show a reference marker, {wanted} are needed: check the marker ids and sizes in the \
         config, the light, and that the camera looks at the table"
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
        "only {found} of {given} samples show the board on the hand, {wanted} are needed: check `camera.board` in the config \
         against the print, the light, and that the camera sees the hand"
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
        "the best fit misses the corners by {reprojection_px:.1} px: samples taken while the arm moved, wrong marker sizes, \
         a wrong marker survey, or the camera's intrinsics of another resolution"
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

/// A fit worse than this is no fit, pixels.
const NO_FIT_PX: f64 = 3.0;

/// Solves for the camera on the flange and the table in the base.
///
/// # Errors
/// `TooFewSamples`, `NotObservable` with the missing motion in words, `NoFit`, `Camera`, `Cv`.
pub fn solve_hand_eye(
    samples: &[Sample],
    reference: &[ReferenceMarker],
    camera: &CameraModel,
    start: &HandEyeGuess,
    settings: &HandEyeSettings,
) -> Result<HandEye, CalibrateError> {
    camera.check()?;
    let problem = Problem::new(samples, reference, camera)?;
    if problem.stops.len() < settings.samples_min.max(3) {
        return Err(CalibrateError::TooFewSamples {
            found: problem.stops.len(),
            given: samples.len(),
            wanted: settings.samples_min.max(3),
        });
    }
    let all: Vec<usize> = (0..problem.stops.len()).collect();
    let first = best_start(&problem, &all, camera, start, settings)
        .ok_or(CalibrateError::NoFit { reprojection_px: f64::INFINITY })?;
    let used = without_outliers(&problem, &first, settings);
    let fit = problem.fit(&used, first.guess, settings).unwrap_or(first);
    observability::check(&problem, &used, &fit, settings)?;
    let reprojection_px_rms = problem.residual_px(&used, &fit.guess);
    if reprojection_px_rms > NO_FIT_PX {
        return Err(CalibrateError::NoFit { reprojection_px: reprojection_px_rms });
    }
    Ok(report::report(&problem, &used, &fit, reprojection_px_rms, settings))
}

/// Fits from the guess and from the closed form, whichever ends lower.
fn best_start(
    problem: &Problem,
    all: &[usize],
    camera: &CameraModel,
    start: &HandEyeGuess,
    settings: &HandEyeSettings,
) -> Option<Fit> {
    let closed = closed_form(problem, camera, settings.keep_mount.then_some(start));
    let fits = [Some(*start), closed].into_iter().flatten();
    fits.filter_map(|guess| problem.fit(all, guess, settings)).min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// Park's closed form on the pose of the whole marker layout in each picture; `None` where it breaks down.
///
/// With a known mount the table is the mean of where each picture puts it.
fn closed_form(
    problem: &Problem,
    camera: &CameraModel,
    known: Option<&HandEyeGuess>,
) -> Option<HandEyeGuess> {
    let (mut flanges, mut tables) = (Vec::new(), Vec::new());
    for stop in &problem.stops {
        if let Ok(pose) = cv::board_pose(camera, &stop.board_m, &stop.pixels) {
            flanges.push(stop.base_from_flange);
            tables.push(pose.camera_from_target);
        }
    }
    let flange_from_camera = match known {
        Some(known) => known.flange_from_camera,
        None if flanges.len() < 3 => return None,
        None => cv::hand_eye_park(&flanges, &tables).ok()?,
    };
    let in_base = flanges.iter().zip(&tables).map(|(flange, table)| flange * flange_from_camera * table);
    Some(HandEyeGuess { flange_from_camera, base_from_table: report::mean_pose(in_base)? })
}

/// The stops whose residual is in line with the others'.
fn without_outliers(problem: &Problem, fit: &Fit, settings: &HandEyeSettings) -> Vec<usize> {
    let mut by_residual: Vec<(f64, usize)> =
        (0..problem.stops.len()).map(|stop| (problem.residual_px(&[stop], &fit.guess), stop)).collect();
    by_residual.sort_by(|a, b| a.0.total_cmp(&b.0));
    let median = by_residual[by_residual.len() / 2].0.max(settings.corner_std_px);
    let droppable =
        (by_residual.len() / 4).min(by_residual.len().saturating_sub(settings.samples_min.max(3)));
    let keep_at_least = by_residual.len() - droppable;
    let kept = by_residual.iter().enumerate();
    let kept = kept.filter(|(rank, (px, _))| *rank < keep_at_least || *px <= settings.outlier_ratio * median);
    let mut used: Vec<usize> = kept.map(|(_, &(_, stop))| stop).collect();
    used.sort_unstable();
    used
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose::Pose2;
    use crate::vision::testing::{self, Print, normal};
    use nalgebra::Vector3;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn reference() -> Vec<ReferenceMarker> {
        let places =
            [(-0.05, -0.05), (0.25, -0.05), (0.55, -0.05), (-0.05, 0.25), (0.55, 0.25), (0.25, 0.55)];
        let marker = |(i, &(x, y)): (usize, &(f64, f64))| ReferenceMarker {
            id: 500 + i as u32,
            size: 0.03,
            pose: Pose2::new(x, y, 0.1 * i as f64),
        };
        places.iter().enumerate().map(marker).collect()
    }

    fn truth() -> HandEyeGuess {
        let down = Vector3::new(0.01, -0.02, 0.03);
        HandEyeGuess {
            flange_from_camera: Isometry3::new(Vector3::new(0.004, -0.073, 0.028), down),
            base_from_table: Isometry3::new(
                Vector3::new(-0.25, 0.18, 0.003),
                Vector3::new(0.004, -0.003, 0.01),
            ),
        }
    }

    fn nominal() -> HandEyeGuess {
        HandEyeGuess {
            flange_from_camera: Isometry3::translation(0.0, -0.07, 0.03),
            base_from_table: Isometry3::translation(-0.25, 0.18, 0.0),
        }
    }

    /// Samples with the camera at given poses over the table; noise of corners (px) and of the arm (m).
    fn samples(poses: &[Isometry3<f64>], noise_px: f64, arm_m: f64, seed: u64) -> Vec<Sample> {
        let camera = testing::camera(1280, 720);
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let prints: Vec<Print> =
            reference().iter().map(|m| Print::level(m.id, m.size, m.pose, 0.0)).collect();
        let truth = truth();
        let mut sample = |table_from_camera: &Isometry3<f64>| {
            let detections = testing::detections(&camera, table_from_camera, &prints, noise_px, &mut random);
            let mut base_from_flange =
                truth.base_from_table * table_from_camera * truth.flange_from_camera.inverse();
            base_from_flange.translation.vector +=
                Vector3::new(normal(&mut random), normal(&mut random), normal(&mut random)) * arm_m;
            Sample { base_from_flange, detections }
        };
        poses.iter().map(&mut sample).collect()
    }

    /// Fifteen poses as an operator would teach them: tilts of about 20 degrees, turns, heights.
    fn varied() -> Vec<Isometry3<f64>> {
        (0..15)
            .map(|i| {
                let t = f64::from(i);
                let tilt = [0.35 * (1.7 * t).sin(), 0.35 * (2.3 * t + 0.5).cos()];
                let (x, y) = (0.25 + 0.1 * t.sin(), 0.25 + 0.1 * (1.3 * t).cos());
                testing::looking_down(x, y, 0.5 + 0.08 * (0.9 * t).sin(), tilt, 0.6 * (0.7 * t).sin())
            })
            .collect()
    }

    fn solve(samples: &[Sample], start: &HandEyeGuess) -> Result<HandEye, CalibrateError> {
        let camera = testing::camera(1280, 720);
        solve_hand_eye(samples, &reference(), &camera, start, &HandEyeSettings::default())
    }

    fn error(found: &HandEye) -> (f64, f64) {
        let off = found.flange_from_camera.inverse() * truth().flange_from_camera;
        (off.translation.vector.norm(), off.rotation.angle())
    }

    #[test]
    fn exact_data_gives_the_exact_answer_even_from_a_useless_guess() {
        let samples = samples(&varied(), 0.0, 0.0, 0);
        let useless = HandEyeGuess {
            flange_from_camera: Isometry3::new(Vector3::new(0.1, 0.1, 0.1), Vector3::new(0.0, 0.0, 2.5)),
            base_from_table: Isometry3::translation(1.0, 1.0, 0.0),
        };
        for start in [nominal(), useless] {
            let found = solve(&samples, &start).unwrap();
            let (off_m, off_rad) = error(&found);
            assert!(off_m < 1e-6 && off_rad < 1e-6, "{off_m} {off_rad}");
            assert!(found.reprojection_px_rms < 1e-3);
        }
    }

    #[test]
    fn noise_leaves_less_than_half_a_millimetre_and_is_reported_honestly() {
        let (mut worst_m, mut worst_rad, mut normalised) = (0.0_f64, 0.0_f64, Vec::new());
        for seed in 0..10 {
            let samples = samples(&varied(), 0.1, 5e-5, seed);
            let found = solve(&samples, &nominal()).unwrap();
            let (off_m, off_rad) = error(&found);
            worst_m = worst_m.max(off_m);
            worst_rad = worst_rad.max(off_rad);
            normalised.push(off_m / found.flange_from_camera_std.translation_m);
            assert!((0.1..0.3).contains(&found.reprojection_px_rms), "{}", found.reprojection_px_rms);
            let held_out = found.held_out_rms_m.unwrap();
            assert!((3e-5..3e-4).contains(&held_out), "{held_out}");
            assert!(found.halves_m.unwrap() < 1e-3 && found.halves_rad.unwrap() < 2e-3);
            assert_eq!(found.samples.len(), 15);
        }
        println!(
            "worst of 10: {:.3} mm, {:.4} deg; normalised {normalised:.1?}",
            worst_m * 1e3,
            worst_rad.to_degrees()
        );
        assert!(worst_m < 5e-4 && worst_rad < 0.05_f64.to_radians(), "{worst_m} m {worst_rad} rad");
        normalised.sort_by(f64::total_cmp);
        assert!((0.4..2.0).contains(&normalised[5]), "{normalised:?}");
    }

    #[test]
    fn motions_that_leave_a_direction_unseen_are_refused_with_what_is_missing() {
        let sentence = |poses: Vec<Isometry3<f64>>| {
            let samples = samples(&poses, 0.1, 5e-5, 3);
            match solve(&samples, &nominal()) {
                Err(CalibrateError::NotObservable { sentence, std_mm, .. }) => {
                    assert!(std_mm > 1.0);
                    sentence
                }
                other => panic!("not refused: {other:?}"),
            }
        };
        let steps = || (0..12).map(f64::from);
        let shifted = steps()
            .map(|t| testing::looking_down(0.25 + 0.1 * t.sin(), 0.25 + 0.1 * t.cos(), 0.5, [0.0, 0.0], 0.0));
        let text = sentence(shifted.collect());
        assert!(text.contains("hardly rotates"), "{text}");
        let turned = steps()
            .map(|t| testing::looking_down(0.25 + 0.05 * t.sin(), 0.25, 0.5, [0.0, 0.0], 0.15 * t - 0.8));
        let text = sentence(turned.collect());
        assert!(
            text.contains("nearest the camera's z") && text.contains("x axis and about the camera's y"),
            "{text}"
        );
        let nodding = steps()
            .map(|t| testing::looking_down(0.25, 0.25 + 0.05 * t.sin(), 0.5, [0.06 * t - 0.33, 0.0], 0.0));
        let text = sentence(nodding.collect());
        assert!(text.contains("nearest the camera's x") && text.contains("camera's y axis"), "{text}");
    }

    #[test]
    fn a_table_that_was_moved_is_found_with_the_mount_kept_from_poses_that_hardly_turn() {
        let steps = (0..8).map(f64::from);
        let poses: Vec<_> = steps
            .map(|t| {
                testing::looking_down(0.25 + 0.1 * t.sin(), 0.25 + 0.1 * t.cos(), 0.5, [0.02 * t, 0.0], 0.0)
            })
            .collect();
        let samples = samples(&poses, 0.1, 5e-5, 3);
        let start = HandEyeGuess { flange_from_camera: truth().flange_from_camera, ..nominal() };
        let settings = HandEyeSettings { keep_mount: true, ..Default::default() };
        let camera = testing::camera(1280, 720);
        let found = solve_hand_eye(&samples, &reference(), &camera, &start, &settings).unwrap();
        let mount = found.flange_from_camera.inverse() * start.flange_from_camera;
        assert!(mount.translation.vector.norm() < 1e-9 && found.flange_from_camera_std.translation_m < 1e-6);
        let table = found.base_from_table.inverse() * truth().base_from_table;
        assert!(table.translation.vector.norm() < 3e-4 && table.rotation.angle() < 1e-3, "{table}");
        assert!(matches!(solve(&samples, &nominal()), Err(CalibrateError::NotObservable { .. })));
    }

    #[test]
    fn too_few_samples_are_counted() {
        let mut samples = samples(&varied(), 0.1, 0.0, 0);
        for sample in samples.iter_mut().skip(4) {
            sample.detections.clear();
        }
        let error = solve(&samples, &nominal()).unwrap_err();
        assert!(matches!(error, CalibrateError::TooFewSamples { found: 4, given: 15, wanted: 6 }), "{error}");
    }

    #[test]
    fn one_sample_taken_while_the_arm_moved_is_left_out_and_shown() {
        let mut samples = samples(&varied(), 0.1, 5e-5, 1);
        samples[6].base_from_flange.translation.vector += Vector3::new(6e-3, 0.0, 0.0);
        let found = solve(&samples, &nominal()).unwrap();
        let rejected: Vec<usize> = found.samples.iter().filter(|s| s.rejected).map(|s| s.sample).collect();
        assert_eq!(rejected, [6]);
        assert!(found.samples[6].residual_m > 3e-3 && found.samples[6].residual_px > 3.0);
        assert!(error(&found).0 < 5e-4);
    }

    #[test]
    fn wrong_marker_sizes_are_no_fit() {
        let samples = samples(&varied(), 0.1, 0.0, 0);
        let camera = testing::camera(1280, 720);
        let wrong: Vec<_> = reference().into_iter().map(|m| ReferenceMarker { size: 0.05, ..m }).collect();
        let error =
            solve_hand_eye(&samples, &wrong, &camera, &nominal(), &HandEyeSettings::default()).unwrap_err();
        assert!(
            matches!(error, CalibrateError::NoFit { .. } | CalibrateError::NotObservable { .. }),
            "{error}"
        );
    }
}
