//! Where a camera is that does not move, and the table before it: the hand carries a board through its
//! picture.
//!
//! In: [`Sample`]s whose pictures show the board on the hand (and the reference markers, where the arm
//! leaves them in view). Out: [`FixedCamera`], or what is missing. With base and flange changed round,
//! "board on the hand, camera on the base" is the equation of "table on the base, camera on the hand", so
//! one solver, one observability gate and one report serve both. The table then comes from the reference
//! markers with the camera's place kept. Pure.

use crate::fit::hand_eye::{closed_form, solve_hand_eye};
use crate::fit::problem::Problem;
use crate::fit::{CalibrateError, HandEye, HandEyeGuess, HandEyeSettings, Sample, TransformStd};
use cell_vision::board::Board;
use cell_vision::camera::CameraModel;
use cell_vision::observe::ReferenceMarker;
use nalgebra::{Isometry3, Matrix6};
use rearrange::geometry::pose::Pose2;

/// Where to start.
#[derive(Clone, Copy, Debug)]
pub struct FixedGuess {
    /// The camera in the base, as the drawing says.
    pub base_from_camera: Isometry3<f64>,
    /// The table in the base.
    pub base_from_table: Isometry3<f64>,
}

/// A fixed camera, the board on the hand and the table.
#[derive(Clone, Debug)]
pub struct FixedCamera {
    /// The fit behind camera and board, base and flange changed round: read it through the methods below.
    pub hand: HandEye,
    /// The table, seen by that camera; its `flange_from_camera` is the camera in the base, kept.
    pub table: HandEye,
}

impl FixedCamera {
    /// The camera in the robot's base.
    pub fn base_from_camera(&self) -> Isometry3<f64> {
        self.hand.flange_from_camera
    }

    /// Standard deviation of it.
    pub fn base_from_camera_std(&self) -> TransformStd {
        self.hand.flange_from_camera_std
    }

    /// The board's frame (its lower left corner) in the flange's.
    pub fn flange_from_board(&self) -> Isometry3<f64> {
        self.hand.base_from_table
    }
}

/// The board's markers, surveyed by its print.
pub fn board_markers(board: &Board) -> Vec<ReferenceMarker> {
    let marker = |(id, [x, y]): (u32, [f64; 2])| ReferenceMarker {
        id,
        size: board.size_m,
        pose: Pose2::new(x, y, 0.0),
    };
    board.markers().map(marker).collect()
}

/// Solves for camera, board and table.
///
/// # Errors
/// As [`solve_hand_eye`]; `BoardUnseen` where it would count reference markers.
pub fn solve_fixed(
    samples: &[Sample],
    board: &Board,
    reference: &[ReferenceMarker],
    camera: &CameraModel,
    start: &FixedGuess,
    settings: &HandEyeSettings,
) -> Result<FixedCamera, CalibrateError> {
    camera.check()?;
    let settings = HandEyeSettings { target_on_hand: true, keep_mount: false, ..*settings };
    let board = board_markers(board);
    let turned: Vec<Sample> = samples
        .iter()
        .map(|sample| Sample {
            base_from_flange: sample.base_from_flange.inverse(),
            detections: sample.detections.clone(),
        })
        .collect();
    let mut guess =
        HandEyeGuess { flange_from_camera: start.base_from_camera, base_from_table: Isometry3::identity() };
    // How the board was clamped need not be measured: the drawing's camera gives it well enough.
    let problem = Problem::new(&turned, &board, camera)?;
    if let Some(clamped) = closed_form(&problem, camera, Some(&guess)) {
        guess = clamped;
    }
    let hand = solve_hand_eye(&turned, &board, camera, &guess, &settings).map_err(about_board)?;
    let mount = (hand.flange_from_camera, hand.flange_from_camera_covariance);
    let table = table_before(samples, reference, camera, mount, &start.base_from_table, &settings)?;
    Ok(FixedCamera { hand, table })
}

/// The table before a camera whose place is known, from pictures with the arm anywhere. The camera's
/// covariance is that of small motions in its own frame, shift (m2) before turn (rad2).
///
/// # Errors
/// As [`solve_hand_eye`].
pub fn table_before(
    samples: &[Sample],
    reference: &[ReferenceMarker],
    camera: &CameraModel,
    (base_from_camera, camera_covariance): (Isometry3<f64>, Matrix6<f64>),
    base_from_table: &Isometry3<f64>,
    settings: &HandEyeSettings,
) -> Result<HandEye, CalibrateError> {
    let still: Vec<Sample> = samples
        .iter()
        .map(|sample| Sample {
            base_from_flange: Isometry3::identity(),
            detections: sample.detections.clone(),
        })
        .collect();
    let start = HandEyeGuess { flange_from_camera: base_from_camera, base_from_table: *base_from_table };
    let settings = HandEyeSettings { keep_mount: true, target_on_hand: false, ..*settings };
    let mut table = solve_hand_eye(&still, reference, camera, &start, &settings)?;
    // Nothing moves between these pictures: what lens and detector get wrong is the same in all, and counts
    // as in one.
    let pictures = table.samples.iter().filter(|sample| !sample.rejected).count().max(1);
    table.base_from_table_covariance *= pictures as f64;
    // The camera carries the table along. Where it was calibrated, its shift and turn go against each other,
    // which two standard deviations would not show.
    let carried = carries(&(table.base_from_table.inverse() * base_from_camera));
    table.base_from_table_covariance += carried * camera_covariance * carried.transpose();
    table.base_from_table_std = TransformStd::of(&table.base_from_table_covariance);
    Ok(table)
}

/// How a small motion of b in its own frame, shift before turn, moves a in its own when b carries it (the
/// adjoint of `a_from_b`).
fn carries(a_from_b: &Isometry3<f64>) -> Matrix6<f64> {
    let turn = a_from_b.rotation.to_rotation_matrix().into_inner();
    let mut adjoint = Matrix6::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
    adjoint.fixed_view_mut::<3, 3>(0, 3).copy_from(&(a_from_b.translation.vector.cross_matrix() * turn));
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
    adjoint
}

fn about_board(error: CalibrateError) -> CalibrateError {
    match error {
        CalibrateError::TooFewSamples { found, given, wanted } => {
            CalibrateError::BoardUnseen { found, given, wanted }
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_vision::detect::Family;
    use cell_vision::testing::{self, Print, normal};
    use nalgebra::{UnitQuaternion, Vector3, Vector6};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn board() -> Board {
        Board::new(Family::Tag36h11, 4, 3, 0.03, 100)
    }

    fn reference() -> Vec<ReferenceMarker> {
        let places = [(-0.05, -0.05), (0.55, -0.05), (-0.05, 0.25), (0.55, 0.25), (0.25, 0.55)];
        let marker = |(i, &(x, y)): (usize, &(f64, f64))| ReferenceMarker {
            id: 500 + i as u32,
            size: 0.03,
            pose: Pose2::new(x, y, 0.1 * i as f64),
        };
        places.iter().enumerate().map(marker).collect()
    }

    struct Truth {
        base_from_camera: Isometry3<f64>,
        base_from_table: Isometry3<f64>,
        flange_from_board: Isometry3<f64>,
    }

    fn truth() -> Truth {
        let base_from_table =
            Isometry3::new(Vector3::new(-0.25, 0.18, 0.003), Vector3::new(0.004, -0.003, 0.01));
        Truth {
            base_from_camera: base_from_table * testing::looking_down(0.25, 0.25, 0.9, [0.06, -0.04], 0.1),
            base_from_table,
            // Face up to the camera, behind the flange.
            flange_from_board: Isometry3::new(
                Vector3::new(-0.06, 0.05, -0.03),
                Vector3::new(3.1, 0.02, -0.03),
            ),
        }
    }

    /// The board half-way between table and camera, tilted about the camera's x and y axes and turned about
    /// z.
    fn samples(turns: &[[f64; 3]], noise_px: f64, arm_m: f64, seed: u64) -> Vec<Sample> {
        let camera = testing::camera(1280, 720);
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let truth = truth();
        let table_from_camera = truth.base_from_table.inverse() * truth.base_from_camera;
        turns
            .iter()
            .enumerate()
            .map(|(i, turn)| {
                let t = i as f64;
                let facing = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
                let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(*turn)) * facing;
                let at =
                    Vector3::new(-0.06 + 0.08 * t.sin(), 0.05 + 0.05 * (1.3 * t).cos(), 0.5 + 0.05 * t.cos());
                let camera_from_board = Isometry3::from_parts(at.into(), rotation);
                let mut base_from_flange =
                    truth.base_from_camera * camera_from_board * truth.flange_from_board.inverse();
                let table_from_board = table_from_camera * camera_from_board;
                let on_board = board_markers(&board()).into_iter().map(|m| Print {
                    id: m.id,
                    size_m: m.size,
                    table_from_marker: table_from_board * m.pose.at_height(0.0),
                });
                let on_table = reference().into_iter().map(|m| Print::level(m.id, m.size, m.pose, 0.0));
                let prints: Vec<Print> = on_board.chain(on_table).collect();
                let detections =
                    testing::detections(&camera, &table_from_camera, &prints, noise_px, &mut random);
                base_from_flange.translation.vector +=
                    Vector3::new(normal(&mut random), normal(&mut random), normal(&mut random)) * arm_m;
                Sample { base_from_flange, detections }
            })
            .collect()
    }

    fn varied() -> Vec<[f64; 3]> {
        (0..16)
            .map(|i| {
                let t = f64::from(i);
                [0.4 * (1.7 * t).sin(), 0.4 * (2.3 * t + 0.5).cos(), 0.6 * (0.7 * t).sin()]
            })
            .collect()
    }

    fn nominal() -> FixedGuess {
        let off = Isometry3::new(Vector3::new(0.03, -0.02, 0.03), Vector3::new(0.1, -0.1, 0.05));
        FixedGuess {
            base_from_camera: truth().base_from_camera * off,
            base_from_table: Isometry3::translation(-0.25, 0.18, 0.0),
        }
    }

    fn solve(samples: &[Sample]) -> Result<FixedCamera, CalibrateError> {
        let camera = testing::camera(1280, 720);
        let settings = HandEyeSettings::default();
        solve_fixed(samples, &board(), &reference(), &camera, &nominal(), &settings)
    }

    #[test]
    fn exact_pictures_give_camera_board_and_table_exactly() {
        let found = solve(&samples(&varied(), 0.0, 0.0, 0)).unwrap();
        let truth = truth();
        for (found, truth) in [
            (found.base_from_camera(), truth.base_from_camera),
            (found.flange_from_board(), truth.flange_from_board),
            (found.table.base_from_table, truth.base_from_table),
        ] {
            let off = found.inverse() * truth;
            assert!(off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6, "{off}");
        }
    }

    #[test]
    fn noise_is_reported_as_large_as_it_is() {
        const ROUNDS: u64 = 24;
        let (mut camera, mut table, mut worst) = (0.0, 0.0, 0.0_f64);
        for seed in 0..ROUNDS {
            let found = solve(&samples(&varied(), 0.1, 5e-5, seed)).unwrap();
            let off = found.base_from_camera().inverse() * truth().base_from_camera;
            camera += normalised(&off, &found.base_from_camera_std()) / ROUNDS as f64;
            let off = found.table.base_from_table.inverse() * truth().base_from_table;
            table += normalised(&off, &found.table.base_from_table_std) / ROUNDS as f64;
            worst = worst.max(off.translation.vector.norm());
            assert!(found.hand.held_out_rms_m.unwrap() < 5e-4 && found.hand.samples.len() == 16);
        }
        println!("worst table {:.3} mm; mean normalised square {camera:.2} {table:.2}", worst * 1e3);
        assert!(worst < 1.5e-3, "{worst}");
        assert!((0.5..2.0).contains(&camera), "{camera}");
        // Pictures of a table before a fixed camera count as one, and here their noise is not the same: less
        // than 1.
        assert!((0.3..1.5).contains(&table), "{table}");
    }

    /// Square of the shift over its standard deviation.
    fn normalised(off: &Isometry3<f64>, std: &TransformStd) -> f64 {
        (off.translation.vector.norm() / std.translation_m).powi(2)
    }

    #[test]
    fn what_a_camera_carries_moves_as_if_it_were_bolted_to_it() {
        let a_from_b = Isometry3::new(Vector3::new(0.1, -0.2, 0.7), Vector3::new(2.9, 0.1, -0.2));
        let small = Vector6::new(1e-6, -2e-6, 3e-6, 2e-6, 1e-6, -3e-6);
        let motion = Isometry3::new(small.fixed_rows::<3>(0).into(), small.fixed_rows::<3>(3).into());
        let moved = a_from_b * motion * a_from_b.inverse();
        let reported = carries(&a_from_b) * small;
        assert!(
            (moved.translation.vector - reported.fixed_rows::<3>(0)).norm() < 1e-11,
            "{moved} {reported}"
        );
        assert!(
            (moved.rotation.scaled_axis() - reported.fixed_rows::<3>(3)).norm() < 1e-11,
            "{moved} {reported}"
        );
    }

    #[test]
    fn a_hand_that_hardly_turns_and_one_that_nods_are_refused_with_what_is_missing() {
        let sentence = |turns: &[[f64; 3]]| match solve(&samples(turns, 0.1, 5e-5, 3)) {
            Err(CalibrateError::NotObservable { sentence, .. }) => sentence,
            other => panic!("not refused: {other:?}"),
        };
        let text = sentence(&[[0.0; 3]; 14]);
        assert!(text.contains("the hand hardly rotates"), "{text}");
        let nodding: Vec<[f64; 3]> = (0..14).map(|i| [0.05 * f64::from(i) - 0.35, 0.0, 0.0]).collect();
        let text = sentence(&nodding);
        assert!(text.contains("nearest the camera's x") && text.contains("rotate the hand"), "{text}");
        assert!(text.contains("camera's y axis"), "{text}");
        let turning: Vec<[f64; 3]> = (0..14).map(|i| [0.0, 0.0, 0.1 * f64::from(i) - 0.7]).collect();
        let text = sentence(&turning);
        assert!(text.contains("nearest the camera's z") && text.contains("x axis and about"), "{text}");
    }

    #[test]
    fn pictures_without_the_board_or_the_table_say_which() {
        let mut blind = samples(&varied(), 0.1, 0.0, 1);
        blind.iter_mut().skip(3).for_each(|sample| sample.detections.retain(|d| d.id >= 500));
        let reported = solve(&blind).unwrap_err();
        assert!(matches!(reported, CalibrateError::BoardUnseen { found: 3, given: 16, .. }), "{reported}");
        let mut blind = samples(&varied(), 0.1, 0.0, 1);
        blind.iter_mut().for_each(|sample| sample.detections.retain(|d| d.id < 500));
        let reported = solve(&blind).unwrap_err();
        assert!(matches!(reported, CalibrateError::TooFewSamples { found: 0, .. }), "{reported}");
    }
}
