//! Calibration poses within a taught box, proposed instead of taught.
//!
//! In: the configuration (nominal mount and table, survey, `calibration_box`), a lens, the arm's kinematics, where it stands. Out: joint poses in
//! an order in which the arm can go from each to the next without leaving the box, or what keeps the box from being large enough.
//! Every pose looks at four reference markers or more; the directions in which the camera is tilted go round, so that
//! the rotations are about many axes. Before they are given out, the round is played through on paper: what the gate of
//! the real calibration would refuse is refused here, with the same sentence.

use crate::cli::calibrate::{camera_and_lens, lens_file};
use crate::cli::task::complain;
use crate::config::cell::{CalibrationBox, CameraMount, CellConfig};
use crate::daemon::calibrate::{Arm, checked_move};
use crate::daemon::hardware::Hardware;
use crate::daemon::setup::{arm_model, reference_markers};
use crate::document::chain::chain;
use crate::motion::kinematics::{DhParameters, forward};
use crate::motion::path::ArmModel;
use crate::units::{Joints, deg_from_rad, mm_from_m};
use crate::vision::calibrate::{HandEyeGuess, HandEyeSettings, Sample, TransformStd, solve_hand_eye};
use crate::vision::camera::CameraModel;
use crate::vision::cv;
use crate::vision::detect::Detection;
use crate::vision::marker;
use crate::vision::observe::ReferenceMarker;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// Tilts tried, largest first, rad: what the perspective of a marker is told by.
const TILTS: [f64; 3] = [0.45, 0.35, 0.25];
/// The golden angle: directions of tilt that never bunch up, rad.
const AZIMUTH_STEP: f64 = 2.399_963;
/// Turns about the optical axis, rad; the wrist has room for them.
const ROLLS: [f64; 5] = [0.0, 0.6, -0.6, 0.3, -0.3];
/// Distances of the camera from where it looks, m.
const DISTANCES: std::ops::Range<u32> = 0..14;
/// Reference markers that every pose shows.
const SEEN_MIN: usize = 4;
/// Rim of the picture that is not relied on, as a share: the nominal mount is a few millimetres and degrees off.
const RIM: f64 = 0.05;
/// Least edge of a marker in the picture, px.
const EDGE_PX: f64 = 18.0;
/// Most postures tried for one direction of tilt.
const TRIES: usize = 60;
/// Fewest poses worth going for.
const POSES_MIN: usize = 8;
/// Corner noise that the poses have to do with, px: three times what the detector leaves.
const NOISE_PX: f64 = 0.3;

/// What poses are proposed for.
struct Scene<'a> {
    model: &'a ArmModel,
    room: &'a CalibrationBox,
    flange_from_camera: Isometry3<f64>,
    lens: &'a CameraModel,
    reference: &'a [ReferenceMarker],
    /// Size of the table, m.
    table_m: [f64; 2],
}

/// Poses, and how well a calibration from them would know the camera's place.
struct Proposal {
    poses: Vec<Joints>,
    std: TransformStd,
}

/// Poses for the arm as drawn, as the text that goes into the configuration.
///
/// # Errors
/// What is missing in the configuration, or why the box does not do.
pub(super) fn on_paper(config: &CellConfig, count: usize) -> Result<String, String> {
    room(config)?;
    let lens = known_lens(config)?;
    let model = arm_model(config, DhParameters::UR5E, config.base_from_table);
    let proposal = proposal(config, &lens, &model, None, count)?;
    tell(&proposal);
    Ok(text(&proposal.poses))
}

/// Poses for this arm from where it stands.
///
/// # Errors
/// As [`on_paper`], and that the arm does not stand in the box.
pub(super) fn from_here(
    config: &CellConfig,
    lens: &CameraModel,
    arm: &Arm,
    hardware: &Hardware,
    count: usize,
) -> Result<Vec<Joints>, String> {
    let q = hardware.robot().state().map(|state| state.q).ok_or("the robot does not say where it stands")?;
    let model = arm_model(config, arm.dh, config.base_from_table);
    // The same pose is no move, but says whether the arm stands in the box.
    checked_move(&model, Some(room(config)?), 1, &q, q).map_err(|error| chain(&error))?;
    let proposal = proposal(config, lens, &model, Some(q), count)?;
    tell(&proposal);
    complain(text(&proposal.poses).trim_end());
    Ok(proposal.poses)
}

fn room(config: &CellConfig) -> Result<&CalibrationBox, String> {
    config.calibration_box.as_ref().ok_or_else(|| {
        "calibration_box is missing: poses are proposed within a box that the flange does not leave; add \
         calibration_box: {low: [x, y, z], high: [x, y, z]} (m, base frame), or {corners_deg: [[6 joints], [6 joints]]} as taught"
            .to_string()
    })
}

fn known_lens(config: &CellConfig) -> Result<CameraModel, String> {
    let path = &config.calibration.camera;
    if !path.exists() {
        return camera_and_lens(config).map(|(_, lens)| lens.model);
    }
    lens_file(path).map(|known| known.model)
}

fn tell(proposal: &Proposal) {
    complain(&format!(
        "{} poses; with corners known to {NOISE_PX} px they would place the camera within {:.2} mm and {:.3} degrees",
        proposal.poses.len(),
        mm_from_m(proposal.std.translation_m),
        deg_from_rad(proposal.std.rotation_rad)
    ));
}

fn text(poses: &[Joints]) -> String {
    let mut text = "calibration_poses_deg:\n".to_string();
    for pose in poses {
        let degrees = pose.0.map(|q| format!("{:.2}", deg_from_rad(q)));
        text.push_str(&format!("  - [{}]\n", degrees.join(", ")));
    }
    text
}

fn proposal(
    config: &CellConfig,
    lens: &CameraModel,
    model: &ArmModel,
    start: Option<Joints>,
    count: usize,
) -> Result<Proposal, String> {
    let CameraMount::Flange { flange_from_camera } = config.camera else {
        return Err("poses are proposed for a camera on the flange; before a fixed camera, teach calibration_poses_deg that \
                    carry the board through its picture, turned about at least two axes"
            .to_string());
    };
    let scene = Scene {
        model,
        room: room(config)?,
        flange_from_camera,
        lens,
        reference: &reference_markers(config),
        table_m: [config.workspace.width_m, config.workspace.height_m],
    };
    let poses = poses(&scene, start, count);
    if poses.len() < POSES_MIN {
        return Err(format!(
            "calibration_box has room for {} of {count} poses that see {SEEN_MIN} reference markers and that the arm reaches in \
             its work posture without leaving the box; widen it, above all upwards",
            poses.len()
        ));
    }
    let std = play_through(&scene, &poses)
        .map_err(|error| format!("calibration_box is too small to turn the camera in: {}", chain(&error)))?;
    Ok(Proposal { poses, std })
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
    let look = direction(tilt, turn);
    let base_from_table = scene.model.base_from_table;
    let mut places: Vec<(usize, Isometry3<f64>)> = Vec::new();
    for k in DISTANCES {
        // Another height first each time.
        let step = (k as usize + 5 * turn) % DISTANCES.len();
        let distance = 0.25 + 0.05 * step as f64;
        for [x, y] in targets(scene.table_m) {
            let eye = Vector3::new(x, y, 0.0) - look * Vector3::new(0.0, 0.0, distance);
            let table_from_camera = Isometry3::from_parts(Translation3::from(eye), look);
            let flange = base_from_table * table_from_camera * scene.flange_from_camera.inverse();
            if scene.room.outside_m(&flange.translation.vector) > 0.0 {
                continue;
            }
            let seen = seen(scene, &table_from_camera).len();
            if seen >= SEEN_MIN {
                places.push((seen, base_from_table.inverse() * flange));
            }
        }
    }
    // The sort is stable: of equally good ones the first tried.
    places.sort_by_key(|(seen, _)| std::cmp::Reverse(*seen));
    places.into_iter().take(TRIES).find_map(|(_, table_from_flange)| {
        let near = from.unwrap_or(&scene.model.home);
        let tool = table_from_flange * scene.model.flange_from_tool;
        let q = scene.model.joints_in_work_posture(&tool, near)?;
        checked_move(scene.model, Some(scene.room), number, from.unwrap_or(&q), q).is_ok().then_some(q)
    })
}

/// The camera's attitude over the table: looking down, turned about its axis, tilted.
fn direction(tilt: f64, turn: usize) -> UnitQuaternion<f64> {
    let azimuth = AZIMUTH_STEP * turn as f64;
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    let rolled = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), ROLLS[turn % ROLLS.len()]);
    let axis = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0);
    UnitQuaternion::from_scaled_axis(axis * tilt) * rolled * down
}

/// Points of the table to look at, the middle first.
fn targets([width, height]: [f64; 2]) -> Vec<[f64; 2]> {
    let shares = [0.5, 0.35, 0.65, 0.2, 0.8];
    let mut targets: Vec<[f64; 2]> =
        shares.iter().flat_map(|x| shares.map(|y| [width * x, height * y])).collect();
    let off = |p: &[f64; 2]| (p[0] - width / 2.0).hypot(p[1] - height / 2.0);
    targets.sort_by(|a, b| off(a).total_cmp(&off(b)));
    targets
}

/// The reference markers well inside the picture, where they would appear.
fn seen(scene: &Scene, table_from_camera: &Isometry3<f64>) -> Vec<Detection> {
    let camera_from_table = table_from_camera.inverse();
    let lens = scene.lens;
    let (width, height) = (f64::from(lens.width), f64::from(lens.height));
    // Far outside the picture a lens model folds back into it.
    let widest = 1.1 * (width / lens.fx).hypot(height / lens.fy) / 2.0;
    let inside = |&[x, y]: &[f64; 2]| {
        (RIM * width..=(1.0 - RIM) * width).contains(&x) && (RIM * height..=(1.0 - RIM) * height).contains(&y)
    };
    let detection = |marker: &ReferenceMarker| {
        let corners = marker::corners_m(marker.size).map(|corner| marker.pose.transform(corner));
        let points = corners.map(|[x, y]| [x, y, 0.0]);
        let before = |[x, y, z]: &[f64; 3]| {
            let p = camera_from_table * Point3::new(*x, *y, *z);
            p.z > 0.05 && p.x.hypot(p.y) < widest * p.z
        };
        if !points.iter().all(before) {
            return None;
        }
        let pixels = cv::project(lens, &camera_from_table, &points).ok()?;
        let corners = <[[f64; 2]; 4]>::try_from(pixels).ok()?;
        let edge = |i: usize| {
            let (a, b) = (corners[i], corners[(i + 1) % 4]);
            (a[0] - b[0]).hypot(a[1] - b[1])
        };
        let sound = corners.iter().all(inside) && (0..4).all(|i| edge(i) >= EDGE_PX);
        let family = marker::FAMILY.to_owned();
        sound.then_some(Detection { family, id: marker.id, corners, decision_margin: 100.0, hamming: 0 })
    };
    scene.reference.iter().filter_map(detection).collect()
}

/// The calibration that these poses would give, with the cell as drawn.
fn play_through(
    scene: &Scene,
    poses: &[Joints],
) -> Result<TransformStd, crate::vision::calibrate::CalibrateError> {
    let base_from_table = scene.model.base_from_table;
    let sample = |q: &Joints| {
        let base_from_flange = forward(&scene.model.dh, q);
        let table_from_camera = base_from_table.inverse() * base_from_flange * scene.flange_from_camera;
        Sample { base_from_flange, detections: seen(scene, &table_from_camera) }
    };
    let samples: Vec<Sample> = poses.iter().map(sample).collect();
    let guess = HandEyeGuess { flange_from_camera: scene.flange_from_camera, base_from_table };
    let settings = HandEyeSettings { corner_std_px: NOISE_PX, ..HandEyeSettings::default() };
    solve_hand_eye(&samples, scene.reference, scene.lens, &guess, &settings)
        .map(|found| found.flange_from_camera_std)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::load::load_cell;
    use std::path::Path;

    fn example() -> CellConfig {
        load_cell(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml")).unwrap()
    }

    fn proposed(config: &CellConfig, start: Option<Joints>) -> Result<Proposal, String> {
        let lens = known_lens(config)?;
        let model = arm_model(config, DhParameters::UR5E, config.base_from_table);
        proposal(config, &lens, &model, start, 15)
    }

    #[test]
    fn poses_stay_in_the_box_see_markers_and_turn_about_both_axes() {
        let config = example();
        let found = proposed(&config, Some(config.park_pose)).unwrap();
        assert_eq!(found.poses.len(), 15);
        let model = arm_model(&config, DhParameters::UR5E, config.base_from_table);
        let room = config.calibration_box.unwrap();
        let mut at = config.park_pose;
        for (index, q) in found.poses.iter().enumerate() {
            // A finer look at the way than the proposal's own.
            for k in 0..=1000 {
                let share = f64::from(k) / 1000.0;
                let on_way = Joints(std::array::from_fn(|i| at.0[i] + share * (q.0[i] - at.0[i])));
                let flange = forward(&model.dh, &on_way);
                assert!(room.outside_m(&flange.translation.vector) < 1e-4, "pose {index} at {share}");
                assert!(model.tool_at(&on_way).translation.z > 0.049, "pose {index}");
            }
            at = *q;
        }
        let tilt = |axis: usize| {
            let of = |q: &Joints| (forward(&model.dh, q).rotation * Vector3::z())[axis];
            let all: Vec<f64> = found.poses.iter().map(of).collect();
            all.iter().copied().fold(f64::MIN, f64::max) - all.iter().copied().fold(f64::MAX, f64::min)
        };
        assert!(tilt(0) > 0.5 && tilt(1) > 0.5, "{} {}", tilt(0), tilt(1));
        assert!(found.std.translation_m < 1e-3 && found.std.rotation_rad < 3e-3, "{:?}", found.std);
        // What is printed is what the configuration takes.
        assert_eq!(text(&found.poses).lines().count(), 16);
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
