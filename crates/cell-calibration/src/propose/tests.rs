//! Poses proposed for a cell like the example's, and boxes that cannot do.

use super::*;
use crate::files::camera::CameraCalibration;
use cell_motion::bodies::Bodies;
use cell_motion::path::{ArmLimits, BlendSpeed};
use cell_values::units::rad_from_deg;
use cell_vision::board::Board;
use cell_vision::detect::Family;
use cell_vision::observe::ReferenceMarker;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rearrange::geometry::pose::Pose2;
use std::path::Path;
use ur_arm::kinematics::{DhParameters, Kinematics};

/// Where the arm waits.
fn park() -> Joints {
    Joints([-91.7, -110.0, 100.0, -80.0, -90.0, 0.0].map(rad_from_deg))
}

/// The cell of `config/cell.yaml`: a camera on the flange, twelve markers round half a metre of table.
fn example() -> Drawn {
    let (low, high, third) = (-0.045, 0.545, 0.5 / 3.0);
    let corners = [[low, low], [high, low], [low, high], [high, high]];
    let along = [third, 2.0 * third].map(|at| [[at, low], [at, high], [low, at], [high, at]]);
    let marker =
        |(id, [x, y]): (u32, [f64; 2])| ReferenceMarker { id, size: 0.03, pose: Pose2::new(x, y, 0.0) };
    Drawn {
        camera: CameraMount::Flange { flange_from_camera: Isometry3::translation(0.0, -0.07, 0.03) },
        base_from_table: Isometry3::translation(-0.25, 0.18, 0.0),
        reference: (500..).zip(corners.into_iter().chain(along.into_iter().flatten())).map(marker).collect(),
        table_m: [0.5; 2],
        room: Some(CalibrationBox { low_m: [-0.4, 0.12, 0.25], high_m: [0.4, 0.7, 0.75] }),
    }
}

fn arm(drawn: &Drawn) -> ArmModel {
    let turn = (rad_from_deg(-360.0), rad_from_deg(360.0));
    let mut joint_range = [turn; 6];
    joint_range[2] = (rad_from_deg(-175.0), rad_from_deg(175.0));
    ArmModel {
        kinematics: Kinematics::of(&DhParameters::UR5E),
        base_from_table: drawn.base_from_table,
        flange_from_tool: Isometry3::translation(0.0, 0.0, 0.2),
        home: Joints([-91.7, -91.7, 108.9, -108.9, -90.0, 0.0].map(rad_from_deg)),
        limits: ArmLimits {
            joint_range,
            joint_speed: rad_from_deg(60.0),
            joint_acceleration: rad_from_deg(120.0),
            tool_speed: 0.25,
            tool_acceleration: 1.0,
        },
        blend_speed: BlendSpeed::Unknown,
        bodies: Bodies::bare(&DhParameters::UR5E),
    }
}

fn lens() -> CameraModel {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../calibration/sim/camera.yaml");
    let text = std::fs::read_to_string(path).unwrap();
    CameraCalibration::parse(&text, "camera.yaml").unwrap().model
}

fn proposed(drawn: &Drawn, start: Option<Joints>) -> Result<Proposal, String> {
    proposal(drawn, &lens(), &arm(drawn), start, 15)
}

fn down() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
}

/// The flange stays in the box and the tool over the table: a finer look at the way than the proposal's
/// own.
fn assert_stays_in(drawn: &Drawn, model: &ArmModel, start: Option<Joints>, poses: &[Joints]) {
    let room = drawn.room.unwrap();
    let mut at = start.unwrap_or(poses[0]);
    for (index, q) in poses.iter().enumerate() {
        for k in 0..=1000 {
            let share = f64::from(k) / 1000.0;
            let on_way = at.lerp(q, share);
            let flange = model.kinematics.forward(&on_way);
            assert!(room.outside_m(&flange.translation.vector) < 1e-4, "pose {index} at {share}");
            assert!(model.tool_at(&on_way).translation.z > 0.049, "pose {index}");
        }
        at = *q;
    }
}

#[test]
fn poses_stay_in_the_box_see_markers_and_turn_about_both_axes() {
    let drawn = example();
    let found = proposed(&drawn, Some(park())).unwrap();
    assert_eq!(found.poses.len(), 15);
    let model = arm(&drawn);
    assert_stays_in(&drawn, &model, Some(park()), &found.poses);
    let tilt = |axis: usize| {
        let of = |q: &Joints| (model.kinematics.forward(q).rotation * Vector3::z())[axis];
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
fn standing(flange_from_board: Option<Isometry3<f64>>) -> Drawn {
    let mut drawn = example();
    drawn.camera = CameraMount::Fixed {
        base_from_camera: Isometry3::from_parts(Translation3::new(0.0, 0.43, 0.75), down()),
        board: Board::new(Family::Tag36h11, 5, 4, 0.02, 100),
        flange_from_board,
    };
    drawn.room = Some(CalibrationBox { low_m: [-0.2, 0.2, 0.25], high_m: [0.2, 0.6, 0.45] });
    drawn
}

#[test]
fn a_board_is_carried_through_the_picture_of_a_camera_that_stands_however_it_is_clamped() {
    for turned in [0.0, 1.2, 3.0] {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turned);
        let clamped = Isometry3::from_parts(Translation3::new(0.05, 0.049, 0.03), turn * down());
        let drawn = standing(Some(clamped));
        let found = proposed(&drawn, None).unwrap();
        println!("{turned}: {} poses, {:?}", found.poses.len(), found.std);
        assert!(found.std.translation_m < 1e-3 && found.std.rotation_rad < 3e-3, "{:?}", found.std);
        let (lens, model) = (lens(), arm(&drawn));
        assert_stays_in(&drawn, &model, None, &found.poses);
        let scene = scene(&drawn, &lens, &model).unwrap();
        let mut parts = [false; 4];
        for q in &found.poses {
            let seen = scene.visible(q);
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
    let reported = proposed(&standing(None), None).err().unwrap();
    assert!(reported.contains("camera.flange_from_board is missing"), "{reported}");
    // The print away from the camera: the hand would have to be upside down.
    let away = Isometry3::translation(0.05, 0.049, 0.03);
    let reported = proposed(&standing(Some(away)), None).err().unwrap();
    assert!(reported.contains("degrees away from work_pose_deg"), "{reported}");
    let far = Isometry3::from_parts(Translation3::new(6.0, 0.0, 0.0), down());
    let reported = proposed(&standing(Some(far)), None).err().unwrap();
    assert!(reported.contains("check base_from_camera and flange_from_board"), "{reported}");
}

#[test]
fn a_box_that_is_too_small_low_or_missing_is_reported() {
    let mut drawn = example();
    let here = Kinematics::of(&DhParameters::UR5E).forward(&park()).translation.vector;
    let round = |half: f64| CalibrationBox {
        low_m: std::array::from_fn(|i| here[i] - half),
        high_m: std::array::from_fn(|i| here[i] + half),
    };
    drawn.room = Some(round(0.002));
    let reported = proposed(&drawn, None).err().unwrap();
    assert!(reported.contains("room for 0 of 15"), "{reported}");
    // On the table the gripper would be in it.
    drawn.room = Some(CalibrationBox { low_m: [-0.3, 0.1, 0.0], high_m: [0.3, 0.7, 0.15] });
    assert!(proposed(&drawn, None).err().unwrap().contains("widen it"));
    // From outside there is no way in.
    drawn.room = example().room;
    let away = Joints(std::array::from_fn(|i| park().0[i] + if i == 0 { 2.5 } else { 0.0 }));
    let reported = proposed(&drawn, Some(away)).err().unwrap();
    assert!(reported.contains("room for 0 of 15"), "{reported}");
    drawn.room = None;
    assert!(proposed(&drawn, None).err().unwrap().contains("calibration_box is missing"));
}
