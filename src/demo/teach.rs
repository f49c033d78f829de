//! What a commissioning engineer teaches by hand, computed for a simulated cell of any table size: where the
//! reference markers lie, from where the camera looks, and from where it is calibrated.
//!
//! In: table size, the nominal arm and camera. Out: joint poses that the path check accepts. Pure.

use cell_motion::bodies::Room;
use cell_motion::path::{ArmModel, CheckedPath, Leg, Segment};
use cell_values::units::Joints;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rearrange::geometry::pose::{Pose2, rotation_from_axes};

/// Reference markers: black square edge, distance of their centres from the table's edges, first id.
pub const REFERENCE_SIZE_M: f64 = 0.03;
const REFERENCE_OUTSIDE_M: f64 = 0.045;
const REFERENCE_FIRST_ID: u32 = 500;

/// Distance of the base behind the near edge, m.
pub const BASE_BEHIND_M: f64 = 0.18;

/// Share of the picture that neighbouring looks rely on; the rest overlaps.
const USED_SHARE: f64 = 0.88;

/// Share of the lower half of the picture that the gripper leaves free; it hangs at that side of the camera.
const FREE_SHARE: f64 = 0.5;

/// How far round the table the looks have to see it at that side, m: what carries no marker is searched for
/// so far.
const NEAR_M: f64 = 0.02;

/// A camera for teaching: half picture size over focal length, horizontally and vertically.
#[derive(Clone, Copy, Debug)]
pub struct ViewAngle {
    /// tan of half the horizontal field of view.
    pub half_x: f64,
    /// tan of half the vertical field of view.
    pub half_y: f64,
}

/// Reference markers round a table: id and pose in the table frame, one at each corner and two or more on
/// each side.
pub fn reference_markers(width: f64, height: f64) -> Vec<(u32, Pose2)> {
    let (left, right) = (-REFERENCE_OUTSIDE_M, width + REFERENCE_OUTSIDE_M);
    let (near, far) = (-REFERENCE_OUTSIDE_M, height + REFERENCE_OUTSIDE_M);
    let mut places = vec![[left, near], [right, near], [left, far], [right, far]];
    for share in [1.0 / 3.0, 2.0 / 3.0] {
        places.push([width * share, near]);
        places.push([width * share, far]);
        places.push([left, height * share]);
        places.push([right, height * share]);
    }
    (REFERENCE_FIRST_ID..).zip(places).map(|(id, [x, y])| (id, Pose2::new(x, y, 0.0))).collect()
}

/// Joint poses from which the camera, looking straight down from `distance` over the markers, sees the whole
/// table and the reference markers round it.
///
/// # Errors
/// The place that cannot be looked at, with the table size in mind.
pub fn look_poses(
    model: &ArmModel,
    flange_from_camera: &Isometry3<f64>,
    (width, height): (f64, f64),
    angle: ViewAngle,
    distance: f64,
) -> Result<Vec<Joints>, String> {
    let rim = REFERENCE_OUTSIDE_M + REFERENCE_SIZE_M;
    let columns = centres(width + 2.0 * rim, 2.0 * angle.half_x * distance * USED_SHARE);
    let rows = rows(height + rim, angle.half_y * distance);
    let mut poses = Vec::new();
    for (row, y) in rows.iter().enumerate() {
        // Back and forth, so that the arm does not fly back at the end of each row.
        let mut line: Vec<f64> = columns.clone();
        if row % 2 == 1 {
            line.reverse();
        }
        for x in line {
            let at = [x - rim, *y, distance];
            let joints =
                camera_joints(model, flange_from_camera, at, [at[0], at[1], 0.0]).ok_or_else(|| {
                    format!("the camera cannot look at ({:.2}, {:.2}) m from {distance:.2} m", at[0], at[1])
                })?;
            poses.push(joints);
        }
    }
    Ok(poses)
}

/// Where pictures that reach `half` up and down have their middles, table frame, so that none of the table
/// up to `far` is seen through the gripper alone.
fn rows(far: f64, half: f64) -> Vec<f64> {
    let (below, above) = (FREE_SHARE * half, USED_SHARE * half);
    let count = ((far + NEAR_M) / (below + above)).ceil().max(1.0) as usize;
    let first = below - NEAR_M;
    let step = (far - above - first) / (count.max(2) - 1) as f64;
    (0..count).map(|k| first + step * k as f64).collect()
}

/// Centres of as few spans as cover `length`, evenly spread.
fn centres(length: f64, span: f64) -> Vec<f64> {
    let count = (length / span).ceil().max(1.0) as usize;
    if count == 1 {
        return vec![length / 2.0];
    }
    let step = (length - span) / (count - 1) as f64;
    (0..count).map(|k| span / 2.0 + step * k as f64).collect()
}

/// Joint poses for hand-eye calibration: the camera at different places and heights, tilted about both image
/// axes and turned about its own, always looking at the table.
pub fn calibration_poses(
    model: &ArmModel,
    flange_from_camera: &Isometry3<f64>,
    (width, height): (f64, f64),
) -> Vec<Joints> {
    let middle = [width / 2.0, height / 2.0];
    let mut poses = Vec::new();
    let mut at = model.home;
    let offsets = [
        [0.0, 0.0],
        [0.22, 0.0],
        [-0.22, 0.0],
        [0.0, 0.2],
        [0.0, -0.2],
        [0.18, 0.16],
        [-0.18, 0.16],
        [0.18, -0.16],
        [-0.18, -0.16],
        [0.1, 0.05],
        [-0.1, 0.05],
        [0.05, -0.1],
        [-0.05, 0.1],
        [0.12, -0.03],
    ];
    for (k, [dx, dy]) in offsets.into_iter().enumerate() {
        let distance = 0.36 + 0.035 * (k % 4) as f64;
        let roll = [0.0, 0.5, -0.5, 0.25, -0.25][k % 5];
        let eye = [middle[0] + dx, middle[1] + dy, distance];
        // Aiming short of the opposite side keeps the markers there in the picture.
        let target = [middle[0] - 0.25 * dx, middle[1] - 0.25 * dy, 0.0];
        let flange = looking(eye, target, roll) * flange_from_camera.inverse();
        let tool = flange * model.flange_from_tool;
        let Some(joints) = model.joints_in_work_posture(&tool, &at) else { continue };
        let segment = Segment::Joint {
            target: joints,
            speed: model.limits.joint_speed,
            acceleration: model.limits.joint_acceleration,
            blend: 0.0,
        };
        if CheckedPath::new(model, &at, &[Leg::over(segment, 0.06)], &Room::empty()).is_ok() {
            poses.push(joints);
            at = joints;
        }
    }
    poses
}

/// Joints that bring the camera to `eye` looking at `target`, tried with the picture the right way up and
/// then upside down (which the detector does not mind).
fn camera_joints(
    model: &ArmModel,
    flange_from_camera: &Isometry3<f64>,
    eye: [f64; 3],
    target: [f64; 3],
) -> Option<Joints> {
    [0.0, std::f64::consts::PI].into_iter().find_map(|roll| {
        let flange = looking(eye, target, roll) * flange_from_camera.inverse();
        model.joints_in_work_posture(&(flange * model.flange_from_tool), &model.home)
    })
}

/// `table_from_camera` of a camera at `eye` looking at `target`: x of the picture along the table's x when
/// `roll` is 0, turned by `roll` (rad) about the optical axis otherwise.
fn looking(eye: [f64; 3], target: [f64; 3], roll: f64) -> Isometry3<f64> {
    let (eye, target) = (Point3::from(eye), Point3::from(target));
    let forward = (target - eye).normalize();
    let right = Vector3::x();
    let x = (right - forward * right.dot(&forward)).normalize();
    let y = forward.cross(&x);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
    Isometry3::from_parts(Translation3::from(eye.coords), rotation_from_axes(x, y, forward) * turn)
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_motion::bodies::Bodies;
    use cell_motion::path::{ArmLimits, BlendSpeed};
    use std::f64::consts::TAU;
    use ur_arm::kinematics::{DhParameters, Kinematics};

    fn model(width: f64) -> ArmModel {
        ArmModel {
            kinematics: Kinematics::of(&DhParameters::UR5E),
            base_from_table: Isometry3::translation(-width / 2.0, BASE_BEHIND_M, 0.0),
            flange_from_tool: Isometry3::translation(0.0, 0.0, 0.2),
            home: Joints([-1.6, -1.6, 1.9, -1.9, -1.57, 0.0]),
            limits: ArmLimits {
                joint_range: [(-TAU, TAU); 6],
                joint_speed: 2.0,
                joint_acceleration: 4.0,
                tool_speed: 0.5,
                tool_acceleration: 2.0,
            },
            blend_speed: BlendSpeed::Unknown,
            bodies: Bodies::bare(&DhParameters::UR5E),
        }
    }

    const ANGLE: ViewAngle = ViewAngle { half_x: 640.0 / 650.0, half_y: 360.0 / 650.0 };

    #[test]
    fn every_point_of_table_and_rim_is_in_some_picture() {
        for size in [0.4, 0.5, 0.6, 0.7] {
            let model = model(size);
            let flange_from_camera = Isometry3::translation(0.0, -0.07, 0.03);
            let poses =
                look_poses(&model, &flange_from_camera, (size, size), ANGLE, 0.45).expect("reachable");
            for (x, y) in
                [(-0.06, -0.06), (size + 0.06, -0.06), (size / 2.0, size + 0.06), (size / 3.0, size / 2.0)]
            {
                let seen = poses.iter().any(|q| {
                    let camera =
                        model.base_from_table.inverse() * model.kinematics.forward(q) * flange_from_camera;
                    let p = camera.inverse() * Point3::new(x, y, 0.0);
                    (p.x / p.z).abs() < ANGLE.half_x && (p.y / p.z).abs() < ANGLE.half_y && p.z > 0.0
                });
                assert!(seen, "({x}, {y}) of a {size} m table");
            }
        }
    }

    #[test]
    fn no_part_of_the_table_is_behind_the_gripper_in_every_look() {
        for height in [0.25, 0.4, 0.5, 0.6, 0.7, 1.0] {
            let (far, half) = (height + 0.075, 0.25);
            let rows = rows(far, half);
            let seen = |y: f64| rows.iter().any(|row| y >= row - 0.53 * half && y <= row + half);
            let missed = (-20..=(1e3 * far) as i32).find(|mm| !seen(f64::from(*mm) / 1e3));
            assert_eq!(missed, None, "mm of a table of {height} m: {rows:?}");
        }
    }

    #[test]
    fn calibration_poses_tilt_about_both_axes() {
        let model = model(0.5);
        let flange_from_camera = Isometry3::translation(0.0, -0.07, 0.03);
        let poses = calibration_poses(&model, &flange_from_camera, (0.5, 0.5));
        assert!(poses.len() >= 10, "{} poses", poses.len());
        let tilt = |axis: usize| {
            let of = |q: &Joints| (model.kinematics.forward(q).rotation * Vector3::z())[axis];
            let all: Vec<f64> = poses.iter().map(of).collect();
            all.iter().copied().fold(f64::MIN, f64::max) - all.iter().copied().fold(f64::MAX, f64::min)
        };
        assert!(tilt(0) > 0.5 && tilt(1) > 0.5, "tilts {} {}", tilt(0), tilt(1));
    }
}
