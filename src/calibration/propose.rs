//! Calibration poses within a taught box, proposed instead of taught.
//!
//! In: the configuration (nominal mount and table, survey, `calibration_box`), a lens, the arm's kinematics,
//! where it stands. Out: joint poses in an order in which the arm can go from each to the next without
//! leaving the box, or what keeps the box from being large enough. Every pose shows four reference markers or
//! more to a camera on the hand, or as many of the board on the hand to one that stands; the directions of
//! tilt go round, so that the rotations are about many axes. Before they are given out, the round is played
//! through on paper: what the gate of the real calibration would refuse is refused here, with the same
//! sentence.

mod body;
mod scene;

use crate::cell::event::Arm;
use crate::config::cell::{CameraMount, CellConfig};
use crate::config::setup::{arm_model, reference_markers};
use crate::document::chain::chain;
use crate::motion::kinematics::{DhParameters, forward};
use crate::motion::path::ArmModel;
use crate::motion::slow::{CalibrationBox, slow_move};
use crate::units::{Joints, deg_from_rad, mm_from_m};
use crate::vision::calibrate::fixed::{FixedGuess, board_markers, solve_fixed};
use crate::vision::calibrate::{
    CalibrateError, HandEyeGuess, HandEyeSettings, Sample, TransformStd, solve_hand_eye,
};
use crate::vision::camera::CameraModel;
use scene::{Carried, SEEN_MIN, Scene};

/// Tilts tried, largest first, rad: what the perspective of a marker is told by.
const TILTS: [f64; 3] = [0.45, 0.35, 0.25];
/// Most postures tried for one direction of tilt.
const TRIES: usize = 60;
/// Fewest poses worth going for.
const POSES_MIN: usize = 8;
/// Corner noise that the poses have to do with, px: three times what the detector leaves.
const NOISE_PX: f64 = 0.3;

/// Poses, and how well a calibration from them would know the camera's place.
pub struct Proposal {
    /// In an order in which the arm can go from each to the next.
    pub poses: Vec<Joints>,
    std: TransformStd,
}

impl Proposal {
    /// How many, and how good: one sentence.
    pub fn sentence(&self) -> String {
        format!(
            "{} poses; with corners known to {NOISE_PX} px they would place the camera within {:.2} mm and {:.3} degrees",
            self.poses.len(),
            mm_from_m(self.std.translation_m),
            deg_from_rad(self.std.rotation_rad)
        )
    }

    /// The text that goes into the configuration.
    pub fn yaml(&self) -> String {
        let mut text = "calibration_poses_deg:\n".to_string();
        for pose in &self.poses {
            let degrees = pose.0.map(|q| format!("{:.2}", deg_from_rad(q)));
            text.push_str(&format!("  - [{}]\n", degrees.join(", ")));
        }
        text
    }
}

/// Poses for the arm as drawn.
///
/// # Errors
/// What is missing in the configuration, or why the box does not do.
pub fn on_paper(config: &CellConfig, lens: &CameraModel, count: usize) -> Result<Proposal, String> {
    check(config)?;
    let model = arm_model(config, DhParameters::UR5E, config.base_from_table);
    proposal(config, lens, &model, None, count)
}

/// Poses for this arm from the joints at which it is.
///
/// # Errors
/// As [`on_paper`], and that the arm is not in the box.
pub fn from_here(
    config: &CellConfig,
    lens: &CameraModel,
    arm: &Arm,
    q: Joints,
    count: usize,
) -> Result<Proposal, String> {
    let model = arm_model(config, arm.dh, config.base_from_table);
    // The same pose is no move, but says whether the arm is in the box.
    slow_move(&model, Some(room(config)?), 1, &q, q).map_err(|error| chain(&error))?;
    proposal(config, lens, &model, Some(q), count)
}

/// Whether the configuration has what poses are proposed from.
///
/// # Errors
/// What is missing.
pub fn check(config: &CellConfig) -> Result<(), String> {
    room(config)?;
    carried(config).map(|_| ())
}

fn room(config: &CellConfig) -> Result<&CalibrationBox, String> {
    config.calibration_box.as_ref().ok_or_else(|| {
        "calibration_box is missing: poses are proposed within a box that the flange does not leave; add \
         calibration_box: {low: [x, y, z], high: [x, y, z]} (m, base frame), or {corners_deg: [[6 joints], [6 joints]]} as taught"
            .to_string()
    })
}

fn proposal(
    config: &CellConfig,
    lens: &CameraModel,
    model: &ArmModel,
    start: Option<Joints>,
    count: usize,
) -> Result<Proposal, String> {
    let scene = scene(config, lens, model)?;
    let poses = poses(&scene, start, count);
    if poses.len() < POSES_MIN {
        return Err(no_room(&scene, poses.len(), count));
    }
    let std = play_through(config, &scene, &poses).map_err(|error| match error {
        CalibrateError::NotObservable { .. } => {
            format!("calibration_box is too small to turn the hand in: {}", chain(&error))
        }
        _ => format!("with the cell as drawn in the configuration: {}", chain(&error)),
    })?;
    Ok(Proposal { poses, std })
}

fn no_room(scene: &Scene, found: usize, count: usize) -> String {
    match scene.carried {
        Carried::Camera { .. } => format!(
            "calibration_box has room for {found} of {count} poses that see {SEEN_MIN} reference markers and that the arm reaches \
             in its work posture without leaving the box; widen it, above all upwards"
        ),
        Carried::Board { .. } => format!(
            "calibration_box has room for {found} of {count} poses that show {SEEN_MIN} markers of the board past the arm to the \
             camera, well clear of it and the table, and that the arm reaches in its work posture without leaving the box; check \
             base_from_camera and flange_from_board, clamp the board further from the wrist, or widen the box sideways"
        ),
    }
}

/// What the configuration draws.
fn scene<'a>(
    config: &'a CellConfig,
    lens: &'a CameraModel,
    model: &'a ArmModel,
) -> Result<Scene<'a>, String> {
    let room = room(config)?;
    let carried = carried(config)?;
    let (target, target_m) = match config.camera {
        CameraMount::Flange { .. } => {
            (reference_markers(config), [config.workspace.width_m, config.workspace.height_m])
        }
        CameraMount::Fixed { board, .. } => (board_markers(&board), board.extent_m()),
    };
    let mut scene = Scene { model, room, lens, carried, target, target_m, upright: 0.0 };
    scene.stand_upright().map_err(|off| {
        format!(
            "to show the board the hand would hang {:.0} degrees away from work_pose_deg: in camera.flange_from_board x runs along \
             the board's lower edge and z out of the print",
            deg_from_rad(off)
        )
    })?;
    Ok(scene)
}

fn carried(config: &CellConfig) -> Result<Carried, String> {
    match config.camera {
        CameraMount::Flange { flange_from_camera } => {
            Ok(Carried::Camera { flange_from_camera, base_from_table: config.base_from_table })
        }
        CameraMount::Fixed { base_from_camera, flange_from_board: Some(flange_from_board), .. } => {
            Ok(Carried::Board { flange_from_board, base_from_camera })
        }
        CameraMount::Fixed { flange_from_board: None, .. } => Err(
            "camera.flange_from_board is missing: to propose poses before a fixed camera celld has to know roughly (within 2 cm and \
             10 degrees) how the board is clamped, its lower left corner in the flange frame; or teach calibration_poses_deg \
             that carry the board through the picture, turned about at least two axes"
                .into(),
        ),
    }
}

/// As many poses as there are, at most `count`.
fn poses(scene: &Scene, start: Option<Joints>, count: usize) -> Vec<Joints> {
    let mut poses: Vec<Joints> = Vec::with_capacity(count);
    let mut at = start;
    // A direction in which there is no room is made up for by the next.
    for turn in 0..2 * count {
        if poses.len() == count {
            break;
        }
        let number = poses.len() + 1;
        let found = TILTS.iter().find_map(|tilt| pose(scene, at.as_ref(), *tilt, turn, number));
        if let Some(q) = found {
            at = Some(q);
            poses.push(q);
        }
    }
    poses
}

/// A pose tilted by `tilt` in the direction of `turn` that the arm can move to.
fn pose(scene: &Scene, from: Option<&Joints>, tilt: f64, turn: usize, number: usize) -> Option<Joints> {
    let table_from_base = scene.model.base_from_table.inverse();
    scene.flanges(tilt, turn).into_iter().take(TRIES).find_map(|flange| {
        let near = from.unwrap_or(&scene.model.home);
        let tool = table_from_base * flange * scene.model.flange_from_tool;
        let q = scene.model.joints_in_work_posture(&tool, near)?;
        let from = from.unwrap_or(&q);
        let goes = scene.shown(&q).len() >= SEEN_MIN
            && slow_move(scene.model, Some(scene.room), number, from, q).is_ok()
            && scene.keeps_clear(from, &q);
        goes.then_some(q)
    })
}

/// How well the calibration from these poses would know the camera's place, with the cell as drawn.
fn play_through(
    config: &CellConfig,
    scene: &Scene,
    poses: &[Joints],
) -> Result<TransformStd, CalibrateError> {
    let reference = reference_markers(config);
    let base_from_table = config.base_from_table;
    let settings = HandEyeSettings { corner_std_px: NOISE_PX, ..HandEyeSettings::default() };
    let sample = |q: &Joints| {
        let base_from_flange = forward(&scene.model.dh, q);
        let mut detections = scene.shown(q);
        if let Carried::Board { .. } = scene.carried {
            detections.extend(scene.shown_of(&reference, &base_from_table, q));
        }
        Sample { base_from_flange, detections }
    };
    let samples: Vec<Sample> = poses.iter().map(sample).collect();
    match config.camera {
        CameraMount::Flange { flange_from_camera } => {
            let guess = HandEyeGuess { flange_from_camera, base_from_table };
            let found = solve_hand_eye(&samples, &reference, scene.lens, &guess, &settings)?;
            Ok(found.flange_from_camera_std)
        }
        CameraMount::Fixed { base_from_camera, board, .. } => {
            let guess = FixedGuess { base_from_camera, base_from_table };
            let found = solve_fixed(&samples, &board, &reference, scene.lens, &guess, &settings)?;
            Ok(found.base_from_camera_std())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::load::load_cell;
    use crate::vision::board::Board;
    use crate::vision::detect::Family;
    use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
    use std::path::Path;

    fn example() -> CellConfig {
        load_cell(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml")).unwrap()
    }

    fn lens(config: &CellConfig) -> CameraModel {
        let text = std::fs::read_to_string(&config.calibration.camera).unwrap();
        crate::vision::calibration::camera::CameraCalibration::parse(&text, "camera.yaml").unwrap().model
    }

    fn proposed(config: &CellConfig, start: Option<Joints>) -> Result<Proposal, String> {
        let lens = lens(config);
        let model = arm_model(config, DhParameters::UR5E, config.base_from_table);
        proposal(config, &lens, &model, start, 15)
    }

    fn down() -> UnitQuaternion<f64> {
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
    }

    /// The flange stays in the box and the tool over the table: a finer look at the way than the proposal's
    /// own.
    fn assert_stays_in(config: &CellConfig, model: &ArmModel, start: Option<Joints>, poses: &[Joints]) {
        let room = config.calibration_box.unwrap();
        let mut at = start.unwrap_or(poses[0]);
        for (index, q) in poses.iter().enumerate() {
            for k in 0..=1000 {
                let share = f64::from(k) / 1000.0;
                let on_way = Joints(std::array::from_fn(|i| at.0[i] + share * (q.0[i] - at.0[i])));
                let flange = forward(&model.dh, &on_way);
                assert!(room.outside_m(&flange.translation.vector) < 1e-4, "pose {index} at {share}");
                assert!(model.tool_at(&on_way).translation.z > 0.049, "pose {index}");
            }
            at = *q;
        }
    }

    #[test]
    fn poses_stay_in_the_box_see_markers_and_turn_about_both_axes() {
        let config = example();
        let found = proposed(&config, Some(config.park_pose)).unwrap();
        assert_eq!(found.poses.len(), 15);
        let model = arm_model(&config, DhParameters::UR5E, config.base_from_table);
        assert_stays_in(&config, &model, Some(config.park_pose), &found.poses);
        let tilt = |axis: usize| {
            let of = |q: &Joints| (forward(&model.dh, q).rotation * Vector3::z())[axis];
            let all: Vec<f64> = found.poses.iter().map(of).collect();
            all.iter().copied().fold(f64::MIN, f64::max) - all.iter().copied().fold(f64::MAX, f64::min)
        };
        assert!(tilt(0) > 0.5 && tilt(1) > 0.5, "{} {}", tilt(0), tilt(1));
        assert!(found.std.translation_m < 1e-3 && found.std.rotation_rad < 3e-3, "{:?}", found.std);
        // What is printed is what the configuration takes.
        assert_eq!(found.yaml().lines().count(), 16);
    }

    /// The example's cell with a camera 0.75 m over the table, and a board clamped to the flange, its print
    /// up.
    fn standing(flange_from_board: Option<Isometry3<f64>>) -> CellConfig {
        let mut config = example();
        config.camera = CameraMount::Fixed {
            base_from_camera: Isometry3::from_parts(Translation3::new(0.0, 0.43, 0.75), down()),
            board: Board::new(Family::Tag36h11, 5, 4, 0.02, 100),
            flange_from_board,
        };
        config.calibration_box = Some(CalibrationBox { low_m: [-0.2, 0.2, 0.25], high_m: [0.2, 0.6, 0.45] });
        config
    }

    #[test]
    fn a_board_is_carried_through_the_picture_of_a_camera_that_stands_however_it_is_clamped() {
        for turned in [0.0, 1.2, 3.0] {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turned);
            let clamped = Isometry3::from_parts(Translation3::new(0.05, 0.049, 0.03), turn * down());
            let config = standing(Some(clamped));
            let found = proposed(&config, None).unwrap();
            println!("{turned}: {} poses, {:?}", found.poses.len(), found.std);
            assert!(found.std.translation_m < 1e-3 && found.std.rotation_rad < 3e-3, "{:?}", found.std);
            let lens = lens(&config);
            let model = arm_model(&config, DhParameters::UR5E, config.base_from_table);
            assert_stays_in(&config, &model, None, &found.poses);
            let scene = scene(&config, &lens, &model).unwrap();
            let mut parts = [false; 4];
            for q in &found.poses {
                let seen = scene.shown(q);
                assert!(seen.len() >= SEEN_MIN);
                // The camera is not where the elbow goes, nor does the wrist hide the board from it.
                let near = body::Body::new(&model, q).clears_m(&Point3::new(0.0, 0.43, 0.75));
                assert!(near > 0.2, "{near} m from the camera");
                for [x, y] in seen.iter().map(|marker| marker.centre()) {
                    let part = usize::from(2.0 * x > f64::from(lens.width));
                    parts[part + 2 * usize::from(2.0 * y > f64::from(lens.height))] = true;
                }
            }
            assert_eq!(parts, [true; 4], "the board is seen in every quarter of the picture");
        }
        let told = proposed(&standing(None), None).err().unwrap();
        assert!(told.contains("camera.flange_from_board is missing"), "{told}");
        // The print away from the camera: the hand would have to stand on its head.
        let away = Isometry3::translation(0.05, 0.049, 0.03);
        let told = proposed(&standing(Some(away)), None).err().unwrap();
        assert!(told.contains("degrees away from work_pose_deg"), "{told}");
        let far = Isometry3::from_parts(Translation3::new(6.0, 0.0, 0.0), down());
        let told = proposed(&standing(Some(far)), None).err().unwrap();
        assert!(told.contains("check base_from_camera and flange_from_board"), "{told}");
    }

    #[test]
    fn a_box_that_is_too_small_low_or_missing_is_told() {
        let mut config = example();
        let here = forward(&DhParameters::UR5E, &config.park_pose).translation.vector;
        let round = |half: f64| CalibrationBox {
            low_m: std::array::from_fn(|i| here[i] - half),
            high_m: std::array::from_fn(|i| here[i] + half),
        };
        config.calibration_box = Some(round(0.002));
        let told = proposed(&config, None).err().unwrap();
        assert!(told.contains("room for 0 of 15"), "{told}");
        // On the table the gripper would be in it.
        config.calibration_box = Some(CalibrationBox { low_m: [-0.3, 0.1, 0.0], high_m: [0.3, 0.7, 0.15] });
        assert!(proposed(&config, None).err().unwrap().contains("widen it"));
        // From outside there is no way in.
        config.calibration_box = example().calibration_box;
        let away = Joints(std::array::from_fn(|i| config.park_pose.0[i] + if i == 0 { 2.5 } else { 0.0 }));
        let told = proposed(&config, Some(away)).err().unwrap();
        assert!(told.contains("room for 0 of 15"), "{told}");
        config.calibration_box = None;
        assert!(proposed(&config, None).err().unwrap().contains("calibration_box is missing"));
    }
}
