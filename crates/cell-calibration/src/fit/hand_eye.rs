//! Where the camera sits on the flange and the table under the robot, solved for together (robot-world and
//! hand-eye).
//!
//! In: [`Sample`]s (arm pose and detections), the surveyed reference markers, the lens, a rough guess. Out:
//! [`HandEye`] with its errors in pixels and metres, or the sentence that says what is missing. A closed
//! form or the guess starts, Levenberg-Marquardt on pixel errors with a robust loss finishes. Poses that
//! leave a direction unseen are refused instead of answered with a number. Pure.

use crate::fit::problem::{Fit, Problem};
use crate::fit::{CalibrateError, HandEye, HandEyeGuess, HandEyeSettings, Sample, observability, report};
use cell_vision::camera::CameraModel;
use cell_vision::cv;
use cell_vision::observe::ReferenceMarker;

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
pub(super) fn closed_form(
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
    use cell_vision::testing::{self, Print, normal};
    use nalgebra::{Isometry3, Vector3};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rearrange::geometry::pose::Pose2;

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
    fn one_sample_taken_while_the_arm_moved_is_left_out_and_marked() {
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
