//! How exact the camera's place on the flange comes out of twenty poses, and what the answer is to poses
//! that do not determine it.
//!
//! In: how many rounds, a seed. Out: [`Report`]. Twenty poses over a table with reference markers, as an
//! operator would teach them, corners with a noise of 0.2 px and the arm with one of 0.05 mm along each
//! axis; then three sets of poses that leave something undetermined. Solved by the code behind `celld
//! calibrate hand-eye`.

use crate::bench::vision::scene::{bench_camera, looking_down};
use crate::bench::vision::tally::quantile;
use cell_calibration::fit::hand_eye::solve_hand_eye;
use cell_calibration::fit::{CalibrateError, HandEye, HandEyeGuess, HandEyeSettings, Sample};
use cell_vision::detect::{Detection, Family};
use cell_vision::observe::ReferenceMarker;
use nalgebra::{Isometry3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::geometry::pose::Pose2;
use serde::Serialize;
use vision_pictures::render::{Lens, Print};

/// Noise of the corners along each axis, px, and of the arm along each axis, m.
const CORNER_PX: f64 = 0.2;
const ARM_M: f64 = 5e-5;
/// Poses of a round.
const POSES: usize = 20;

/// What came out.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Rounds solved.
    pub rounds: usize,
    /// Poses of each.
    pub poses: usize,
    /// Error of the camera's place on the flange, median, mm.
    pub position_median_mm: f64,
    /// The largest of all rounds, mm.
    pub position_worst_mm: f64,
    /// Error of its direction, median, degrees.
    pub angle_median_deg: f64,
    /// The largest of all rounds, degrees.
    pub angle_worst_deg: f64,
    /// Rounds that were refused.
    pub refused: usize,
    /// Pose sets that leave something undetermined: what they are, and the sentence they were refused with
    /// (`None`: they were not).
    pub degenerate: Vec<(&'static str, Option<String>)>,
}

/// Runs.
pub fn run(rounds: usize, seed: u64) -> Report {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let lens = Lens::new(bench_camera(), &mut random);
    let (mut position_mm, mut angle_deg, mut refused) = (Vec::new(), Vec::new(), 0);
    for _ in 0..rounds {
        match error(&lens, &varied(&mut random), &mut random) {
            Ok((off_m, off_rad)) => {
                position_mm.push(off_m * 1e3);
                angle_deg.push(off_rad.to_degrees());
            }
            Err(_) => refused += 1,
        }
    }
    let degenerate = degenerate()
        .into_iter()
        .map(|(name, poses)| {
            let sentence = match error(&lens, &poses, &mut random) {
                Err(CalibrateError::NotObservable { sentence, .. }) => Some(sentence),
                _ => None,
            };
            (name, sentence)
        })
        .collect();
    Report {
        rounds,
        poses: POSES,
        position_median_mm: quantile(&mut position_mm, 0.5),
        position_worst_mm: quantile(&mut position_mm, 1.0),
        angle_median_deg: quantile(&mut angle_deg, 0.5),
        angle_worst_deg: quantile(&mut angle_deg, 1.0),
        refused,
        degenerate,
    }
}

/// Where the camera and the table truly are.
fn truth() -> HandEyeGuess {
    HandEyeGuess {
        flange_from_camera: Isometry3::new(
            Vector3::new(0.004, -0.073, 0.028),
            Vector3::new(0.01, -0.02, 0.03),
        ),
        base_from_table: Isometry3::new(Vector3::new(-0.25, 0.18, 0.003), Vector3::new(0.004, -0.003, 0.01)),
    }
}

/// Distance and angle between the mount that was found and the true one.
fn error(
    lens: &Lens,
    poses: &[Isometry3<f64>],
    random: &mut ChaCha8Rng,
) -> Result<(f64, f64), CalibrateError> {
    let found = found(lens, poses, random)?;
    let off = found.flange_from_camera.inverse() * truth().flange_from_camera;
    Ok((off.translation.vector.norm(), off.rotation.angle()))
}

/// A mount and a table as a round of varied poses finds them.
pub(super) struct Calibration(HandEye);

impl Calibration {
    /// A round of its own.
    ///
    /// # Errors
    /// What the solver says.
    pub fn found(lens: &Lens, random: &mut ChaCha8Rng) -> Result<Calibration, CalibrateError> {
        let poses = varied(random);
        found(lens, &poses, random).map(Calibration)
    }

    /// Where the camera is assumed to be, in the table's frame, when it truly is at `table_from_camera`.
    pub fn believed(&self, table_from_camera: &Isometry3<f64>) -> Isometry3<f64> {
        let truth = truth();
        let base_from_flange = truth.base_from_table * table_from_camera * truth.flange_from_camera.inverse();
        self.0.base_from_table.inverse() * base_from_flange * self.0.flange_from_camera
    }
}

fn found(lens: &Lens, poses: &[Isometry3<f64>], random: &mut ChaCha8Rng) -> Result<HandEye, CalibrateError> {
    let truth = truth();
    let nominal = HandEyeGuess {
        flange_from_camera: Isometry3::translation(0.0, -0.07, 0.03),
        base_from_table: Isometry3::translation(-0.25, 0.18, 0.0),
    };
    let samples: Vec<Sample> = poses.iter().map(|pose| sample(lens, pose, &truth, random)).collect();
    let settings = HandEyeSettings { corner_std_px: CORNER_PX, ..HandEyeSettings::default() };
    solve_hand_eye(&samples, &reference(), &lens.camera, &nominal, &settings)
}

fn reference() -> Vec<ReferenceMarker> {
    let places = [(-0.05, -0.05), (0.25, -0.05), (0.55, -0.05), (-0.05, 0.25), (0.55, 0.25), (0.25, 0.55)];
    let more = [(-0.05, 0.55), (0.55, 0.55)];
    let marker =
        |(id, (x, y)): (u32, (f64, f64))| ReferenceMarker { id, size: 0.03, pose: Pose2::new(x, y, 0.0) };
    (500..).zip(places.into_iter().chain(more)).map(marker).collect()
}

fn sample(
    lens: &Lens,
    table_from_camera: &Isometry3<f64>,
    truth: &HandEyeGuess,
    random: &mut ChaCha8Rng,
) -> Sample {
    let mut detections = Vec::new();
    for marker in reference() {
        let Some(pattern) = Family::Tag36h11.pattern(marker.id) else { continue };
        let print = Print {
            pattern,
            size_m: marker.size,
            table_from_marker: marker.pose.at_height(0.0),
            greys: [35.0, 215.0],
            rim: (0.0, 0.0),
        };
        let inside = |[x, y]: &[f64; 2]| (4.0..1276.0).contains(x) && (4.0..716.0).contains(y);
        let corners = print.corners(lens, table_from_camera);
        let Some(mut corners) = corners.filter(|corners| corners.iter().all(inside)) else { continue };
        corners.iter_mut().flatten().for_each(|value| *value += CORNER_PX * normal(random));
        detections.push(Detection {
            family: "tag36h11".into(),
            id: marker.id,
            corners,
            ..Detection::default()
        });
    }
    let mut base_from_flange = truth.base_from_table * table_from_camera * truth.flange_from_camera.inverse();
    base_from_flange.translation.vector +=
        Vector3::new(normal(random), normal(random), normal(random)) * ARM_M;
    Sample { base_from_flange, detections }
}

/// Poses as an operator would teach them: tilts of about 20 degrees, turns, heights.
fn varied(random: &mut ChaCha8Rng) -> Vec<Isometry3<f64>> {
    let start: f64 = random.random_range(0.0..10.0);
    (0..POSES)
        .map(|i| {
            let t = start + i as f64;
            let tilt = [0.35 * (1.7 * t).sin(), 0.35 * (2.3 * t + 0.5).cos()];
            let at = [0.25 + 0.1 * t.sin(), 0.25 + 0.1 * (1.3 * t).cos()];
            looking_down(at, 0.5 + 0.08 * (0.9 * t).sin(), tilt, 0.6 * (0.7 * t).sin())
        })
        .collect()
}

/// Sets of poses that leave something undetermined.
fn degenerate() -> [(&'static str, Vec<Isometry3<f64>>); 3] {
    let steps = || (0..POSES).map(|i| i as f64);
    let shifted =
        steps().map(|t| looking_down([0.25 + 0.1 * t.sin(), 0.25 + 0.1 * t.cos()], 0.5, [0.0; 2], 0.0));
    let turned = steps().map(|t| looking_down([0.25 + 0.05 * t.sin(), 0.25], 0.5, [0.0; 2], 0.09 * t - 0.8));
    let nodding =
        steps().map(|t| looking_down([0.25, 0.25 + 0.05 * t.sin()], 0.5, [0.036 * t - 0.33, 0.0], 0.0));
    [
        ("shifted only", shifted.collect()),
        ("turned about the line of sight only", turned.collect()),
        ("nodding only", nodding.collect()),
    ]
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_meet_the_figures_and_poor_ones_are_refused() {
        let report = run(6, 3);
        println!("{report:?}");
        assert!(report.position_worst_mm < 0.5 && report.angle_worst_deg < 0.1, "{report:?}");
        assert_eq!(report.refused, 0);
        for (name, sentence) in &report.degenerate {
            assert!(sentence.as_ref().is_some_and(|text| text.contains("rotat")), "{name}: {sentence:?}");
        }
    }
}
