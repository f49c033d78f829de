//! Calibration poses within a taught box, proposed instead of taught.
//!
//! In: the cell as drawn (nominal mount and table, survey, `calibration_box`), a lens, the arm's kinematics,
//! where it is. Out: joint poses in an order in which the arm can go from each to the next without leaving
//! the box, or what keeps the box from being large enough. Every pose shows four reference markers or more
//! to a camera on the hand, or as many of the board on the hand to a fixed one; the directions of tilt go
//! round, so that the rotations are about many axes. Before they are given out, the round is played through
//! on paper: what the gate of the real calibration would refuse is refused here, with the same sentence.

pub mod body;
mod scene;

use crate::drawn::{CameraMount, Drawn};
use crate::fit::fixed::{FixedGuess, board_markers, solve_fixed};
use crate::fit::hand_eye::solve_hand_eye;
use crate::fit::{CalibrateError, HandEyeGuess, HandEyeSettings, Sample, TransformStd};
use crate::propose::scene::{Carried, SEEN_MIN, Scene};
use cell_motion::bodies::Room;
use cell_motion::path::ArmModel;
use cell_motion::slow::{CalibrationBox, slow_move};
use cell_values::units::{Joints, deg_from_rad, mm_from_m};
use cell_vision::camera::CameraModel;
use rearrange::document::chain::chain;

/// Tilts tried, largest first, rad: what the perspective of a marker is determined by.
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
            "{} poses; with corners known to {NOISE_PX} px they would place the camera within {:.2} mm and \
             {:.3} degrees",
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

/// So many poses for the arm as drawn, from anywhere.
///
/// # Errors
/// What is missing in the configuration, or why the box does not do.
pub fn on_paper(drawn: &Drawn, lens: &CameraModel, arm: &ArmModel, count: usize) -> Result<Proposal, String> {
    check(drawn)?;
    proposal(drawn, lens, arm, None, count)
}

/// Poses for this arm from the joints at which it is.
///
/// # Errors
/// As [`on_paper`], and that the arm is not in the box.
pub fn from_here(
    drawn: &Drawn,
    lens: &CameraModel,
    arm: &ArmModel,
    q: Joints,
    count: usize,
) -> Result<Proposal, String> {
    // The same pose is no move, but says whether the arm is in the box.
    slow_move(arm, Some(room(drawn)?), &Room::empty(), 1, &q, q).map_err(|error| chain(&error))?;
    proposal(drawn, lens, arm, Some(q), count)
}

/// Whether the configuration has what poses are proposed from.
///
/// # Errors
/// What is missing.
pub fn check(drawn: &Drawn) -> Result<(), String> {
    room(drawn)?;
    carried(drawn).map(|_| ())
}

fn room(drawn: &Drawn) -> Result<&CalibrationBox, String> {
    drawn.room.as_ref().ok_or_else(|| {
        "calibration_box is missing: poses are proposed within a box that the flange does not leave; add \
         calibration_box: {low: [x, y, z], high: [x, y, z]} (m, base frame), or \
         {corners_deg: [[6 joints], [6 joints]]} as taught"
            .to_string()
    })
}

fn proposal(
    drawn: &Drawn,
    lens: &CameraModel,
    model: &ArmModel,
    start: Option<Joints>,
    count: usize,
) -> Result<Proposal, String> {
    let scene = scene(drawn, lens, model)?;
    let poses = poses(&scene, start, count);
    if poses.len() < POSES_MIN {
        return Err(no_room(&scene, poses.len(), count));
    }
    let std = play_through(drawn, &scene, &poses).map_err(|error| match error {
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
            "calibration_box has room for {found} of {count} poses that see {SEEN_MIN} reference markers and \
             that the arm reaches in its work posture without leaving the box; widen it, above all upwards"
        ),
        Carried::Board { .. } => format!(
            "calibration_box has room for {found} of {count} poses that show {SEEN_MIN} markers of the board \
             past the arm to the camera, well clear of it and the table, and that the arm reaches in its \
             work posture without leaving the box; check base_from_camera and flange_from_board, clamp the \
             board further from the wrist, or widen the box sideways"
        ),
    }
}

/// What the configuration draws.
fn scene<'a>(drawn: &'a Drawn, lens: &'a CameraModel, model: &'a ArmModel) -> Result<Scene<'a>, String> {
    let room = room(drawn)?;
    let carried = carried(drawn)?;
    let (target, target_m) = match drawn.camera {
        CameraMount::Flange { .. } => (drawn.reference.clone(), drawn.table_m),
        CameraMount::Fixed { board, .. } => (board_markers(&board), board.extent_m()),
    };
    let mut scene = Scene { model, room, lens, carried, target, target_m, upright: 0.0 };
    scene.stand_upright().map_err(|off| {
        format!(
            "to show the board the hand would hang {:.0} degrees away from work_pose_deg: in \
             camera.flange_from_board x runs along the board's lower edge and z out of the print",
            deg_from_rad(off)
        )
    })?;
    Ok(scene)
}

fn carried(drawn: &Drawn) -> Result<Carried, String> {
    match drawn.camera {
        CameraMount::Flange { flange_from_camera } => {
            Ok(Carried::Camera { flange_from_camera, base_from_table: drawn.base_from_table })
        }
        CameraMount::Fixed { base_from_camera, flange_from_board: Some(flange_from_board), .. } => {
            Ok(Carried::Board { flange_from_board, base_from_camera })
        }
        CameraMount::Fixed { flange_from_board: None, .. } => Err(
            "camera.flange_from_board is missing: to propose poses before a fixed camera celld has to know \
             roughly (within 2 cm and 10 degrees) how the board is clamped, its lower left corner in the \
             flange frame; or teach calibration_poses_deg that carry the board through the picture, turned \
             about at least two axes"
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
        let goes = scene.visible(&q).len() >= SEEN_MIN
            && slow_move(scene.model, Some(scene.room), &Room::empty(), number, from, q).is_ok()
            && scene.keeps_clear(from, &q);
        goes.then_some(q)
    })
}

/// How well the calibration from these poses would know the camera's place, with the cell as drawn.
fn play_through(drawn: &Drawn, scene: &Scene, poses: &[Joints]) -> Result<TransformStd, CalibrateError> {
    let (reference, base_from_table) = (&drawn.reference, drawn.base_from_table);
    let settings = HandEyeSettings { corner_std_px: NOISE_PX, ..HandEyeSettings::default() };
    let sample = |q: &Joints| {
        let base_from_flange = scene.model.kinematics.forward(q);
        let mut detections = scene.visible(q);
        if let Carried::Board { .. } = scene.carried {
            detections.extend(scene.visible_of(reference, &base_from_table, q));
        }
        Sample { base_from_flange, detections }
    };
    let samples: Vec<Sample> = poses.iter().map(sample).collect();
    match drawn.camera {
        CameraMount::Flange { flange_from_camera } => {
            let guess = HandEyeGuess { flange_from_camera, base_from_table };
            let found = solve_hand_eye(&samples, reference, scene.lens, &guess, &settings)?;
            Ok(found.flange_from_camera_std)
        }
        CameraMount::Fixed { base_from_camera, board, .. } => {
            let guess = FixedGuess { base_from_camera, base_from_table };
            let found = solve_fixed(&samples, &board, reference, scene.lens, &guess, &settings)?;
            Ok(found.base_from_camera_std())
        }
    }
}

#[cfg(test)]
mod tests;
