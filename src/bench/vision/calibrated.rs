//! What a calibration from the benchmark's own pictures finds, so that accuracy can be reported with it too.
//!
//! In: the true lens. Out: [`Found`]: the lens that pictures of a board give, and the mount that a round
//! over reference markers gives with that lens, found by the code behind `celld calibrate camera` and `celld
//! calibrate hand-eye`; and how far off they are.

use crate::bench::vision::scene;
use crate::bench::vision::scene::{DEGRADE, looking_down};
use crate::bench::vision::tally::Accuracy;
use cell_calibration::fit::hand_eye::solve_hand_eye;
use cell_calibration::fit::lens::{BoardView, LensSettings, solve_lens};
use cell_calibration::fit::{HandEyeGuess, HandEyeSettings, Sample};
use cell_values::image::GrayImage;
use cell_vision::board::Board;
use cell_vision::camera::CameraModel;
use cell_vision::cv;
use cell_vision::detect::{DetectSettings, Detector, Family};
use cell_vision::observe::ReferenceMarker;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::geometry::pose::Pose2;
use serde::Serialize;
use vision_pictures::render::{Ground, Lens, Print, render};

/// Pictures of the board, and looks at the reference markers.
const BOARD_VIEWS: usize = 40;
const LOOKS: usize = 15;

/// The board of the benchmark: an A4 sheet.
pub fn bench_board() -> Board {
    Board::new(Family::Tag36h11, 7, 5, 0.03, 0)
}

/// Lens and mount as calibration found them.
#[derive(Clone, Debug)]
pub struct Found {
    /// The lens.
    pub lens: CameraModel,
    flange_from_camera: Isometry3<f64>,
    base_from_table: Isometry3<f64>,
    errors: LensErrors,
}

/// How far off a calibrated lens is.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LensErrors {
    /// Root mean square corner error of the board pictures, pixels.
    pub reprojection_px: f64,
    /// Of the worse focal length, per cent.
    pub focal_error_percent: f64,
    /// Of the principal point, pixels.
    pub centre_error_px: f64,
    /// Largest difference of the distortion over the picture, pixels.
    pub distortion_map_error_px: f64,
}

/// The second column of the report.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Column {
    /// How far off the lens is.
    #[serde(flatten)]
    pub lens: LensErrors,
    /// How exact poses are with it.
    #[serde(flatten)]
    pub accuracy: Accuracy,
}

impl Found {
    /// Where the calibration says the camera is that really is there: the bench's arm carries the camera in
    /// its flange's origin and is mounted on the table's.
    pub fn table_from_camera(&self, truly: &Isometry3<f64>) -> Isometry3<f64> {
        self.base_from_table.inverse() * truly * self.flange_from_camera
    }

    /// The report's column.
    pub fn column(&self, accuracy: Accuracy) -> Column {
        Column { lens: self.errors, accuracy }
    }
}

/// Calibrates lens and mount from pictures rendered through the true lens.
///
/// The bare detector on purpose: calibration too works on markers alone, before there is a scene to
/// perceive.
///
/// # Errors
/// What the solvers say.
pub fn calibrate(lens: &Lens, settings: DetectSettings, seed: u64) -> Result<Found, String> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(u64::MAX);
    let settings = DetectSettings { threads: 2, ..settings };
    let mut detector = Detector::new(settings).map_err(|error| error.to_string())?;
    let mut views = Vec::with_capacity(BOARD_VIEWS);
    for number in 0..BOARD_VIEWS {
        let (picture, _) = board_picture(lens, &bench_board(), &mut random);
        let detections = detector.detect(&picture).map_err(|error| error.to_string())?;
        views.push(BoardView { name: number.to_string(), corners: bench_board().seen(&detections) });
    }
    let (width, height) = (lens.camera.width, lens.camera.height);
    let solved =
        solve_lens(&views, width, height, &LensSettings::default()).map_err(|error| error.to_string())?;
    let errors = lens_errors(&lens.camera, &solved.camera, solved.reprojection_px)?;
    let found = CameraModel { serial: lens.camera.serial.clone(), ..solved.camera };
    let (flange_from_camera, base_from_table) = mount(lens, &found, &mut detector, &mut random)?;
    Ok(Found { lens: found, flange_from_camera, base_from_table, errors })
}

/// A picture of a board held before the camera somewhere in the picture, tilted by up to 35 degrees, and the
/// pose it has.
pub fn board_picture(lens: &Lens, board: &Board, random: &mut ChaCha8Rng) -> (GrayImage, Isometry3<f64>) {
    let mut within = |reach: f64| random.random_range(-reach..reach);
    let turn =
        UnitQuaternion::from_euler_angles(std::f64::consts::PI + within(0.6), within(0.6), within(3.1));
    let away = 0.36 + within(0.1);
    let at = Translation3::new(0.75 * away * within(1.0), 0.42 * away * within(1.0), away);
    let [wide, high] = board.extent_m();
    let middle = Translation3::new(-wide / 2.0, -high / 2.0, 0.0);
    let camera_from_board = Isometry3::from_parts(at, turn) * middle;
    let prints: Vec<Print> = board
        .markers()
        .filter_map(|(id, [x, y])| {
            let pattern = board.family.pattern(id)?;
            let table_from_marker = Isometry3::translation(x, y, 0.0);
            Some(Print {
                pattern,
                size_m: board.size_m,
                table_from_marker,
                greys: [35.0, 215.0],
                rim: (0.0, 215.0),
            })
        })
        .collect();
    let board_from_camera = camera_from_board.inverse();
    let ground = Ground::Plain(215.0);
    (render(lens, &board_from_camera, &ground, &prints, DEGRADE, random), camera_from_board)
}

fn lens_errors(truth: &CameraModel, found: &CameraModel, reprojection_px: f64) -> Result<LensErrors, String> {
    let focal = (found.fx / truth.fx - 1.0).abs().max((found.fy / truth.fy - 1.0).abs());
    let pixels = (0..=16).flat_map(|i| (0..=9).map(move |j| [79.9 * f64::from(i), 79.8 * f64::from(j)]));
    let straight = cv::undistort(truth, &pixels.collect::<Vec<_>>()).map_err(|error| error.to_string())?;
    let points: Vec<[f64; 3]> = straight.iter().map(|[x, y]| [*x, *y, 1.0]).collect();
    let bend = |camera: &CameraModel| -> Result<Vec<[f64; 2]>, String> {
        let seen = cv::project(camera, &Isometry3::identity(), &points).map_err(|error| error.to_string())?;
        let plain = |[x, y]: [f64; 2]| [camera.fx * x + camera.cx, camera.fy * y + camera.cy];
        Ok(seen.iter().zip(&straight).map(|(p, s)| [p[0] - plain(*s)[0], p[1] - plain(*s)[1]]).collect())
    };
    let differences = bend(truth)?.into_iter().zip(bend(found)?);
    Ok(LensErrors {
        reprojection_px,
        focal_error_percent: 100.0 * focal,
        centre_error_px: (found.cx - truth.cx).hypot(found.cy - truth.cy),
        distortion_map_error_px: differences
            .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]))
            .fold(0.0, f64::max),
    })
}

/// Camera on the flange and table in the base by looks at reference markers flat on the table.
fn mount(
    lens: &Lens,
    found: &CameraModel,
    detector: &mut Detector,
    random: &mut ChaCha8Rng,
) -> Result<(Isometry3<f64>, Isometry3<f64>), String> {
    let reference: Vec<ReferenceMarker> = (0..12)
        .map(|i| {
            let pose = Pose2::new(
                0.11 * (f64::from(i % 4) - 1.5),
                0.11 * (f64::from(i / 4) - 1.0),
                0.5 * f64::from(i),
            );
            ReferenceMarker { id: 500 + i, size: scene::SIZE_M, pose }
        })
        .collect();
    let print = |marker: &ReferenceMarker| {
        let pattern = Family::Tag36h11.pattern(marker.id)?;
        let table_from_marker = marker.pose.at_height(0.0);
        Some(Print {
            pattern,
            size_m: marker.size,
            table_from_marker,
            greys: [35.0, 215.0],
            rim: (0.002, 150.0),
        })
    };
    let prints: Vec<Print> = reference.iter().filter_map(print).collect();
    let mut samples = Vec::with_capacity(LOOKS);
    for _ in 0..LOOKS {
        let mut within = |reach: f64| random.random_range(-reach..reach);
        let tilted = looking_down([0.0, 0.0], 0.0, [within(0.35), within(0.35)], within(2.5));
        let back = tilted.rotation * Vector3::new(within(0.06), within(0.06), -(0.45 + within(0.08)));
        let table_from_camera = Isometry3::from_parts(Translation3::from(back), tilted.rotation);
        debug_assert!((table_from_camera * Point3::origin()).z > 0.2);
        let ground = Ground::Plain(140.0);
        let picture = render(lens, &table_from_camera, &ground, &prints, DEGRADE, random);
        let detections = detector.detect(&picture).map_err(|error| error.to_string())?;
        samples.push(Sample { base_from_flange: table_from_camera, detections });
    }
    let start =
        HandEyeGuess { flange_from_camera: Isometry3::identity(), base_from_table: Isometry3::identity() };
    let solved = solve_hand_eye(&samples, &reference, found, &start, &HandEyeSettings::default());
    let solved = solved.map_err(|error| error.to_string())?;
    Ok((solved.flange_from_camera, solved.base_from_table))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_calibrated_lens_meets_the_figures() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let lens = Lens::new(scene::bench_camera(), &mut random);
        let found = calibrate(&lens, DetectSettings::default(), 5).unwrap();
        let errors = found.errors;
        println!("{errors:?}");
        assert!(errors.reprojection_px < 0.3 && errors.focal_error_percent < 0.2, "{errors:?}");
        assert!(errors.centre_error_px < 1.0 && errors.distortion_map_error_px < 0.3, "{errors:?}");
        let there = looking_down([0.0, 0.0], 0.5, [0.0, 0.0], 0.3);
        let off = there.inverse() * found.table_from_camera(&there);
        assert!(off.translation.vector.norm() < 2e-3, "{off}");
    }
}
