//! What a commissioning engineer teaches by hand, computed for a simulated cell of any table size: where the
//! reference markers lie, from where the camera looks, and from where it is calibrated.
//!
//! In: table size, the nominal arm and camera. Out: joint poses that the path check accepts. Pure.

use crate::geometry::pose::{Pose2, rotation_from_axes};
use crate::motion::path::{ArmModel, CheckedPath, Leg, Segment};
use crate::units::Joints;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

/// Reference markers: black square edge, distance of their centres from the table's edges, first id.
pub const REFERENCE_SIZE_M: f64 = 0.03;
const REFERENCE_OUTSIDE_M: f64 = 0.045;
const REFERENCE_FIRST_ID: u32 = 500;

/// Distance of the base behind the near edge, m.
pub const BASE_BEHIND_M: f64 = 0.18;

/// Lowest share of the picture, where the gripper's housing is in the way.
const HIDDEN: f64 = 0.17;

/// Space kept to the borders of a picture, m on the table: the arm does not stand exactly where it was taught.
const BORDER_M: f64 = 0.006;

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

/// What has to be seen: the tallest object and the widest marker, m.
#[derive(Clone, Copy, Debug)]
pub struct Things {
    /// Height of the tallest object: the nearer to the camera, the less of the table fits into a picture.
    pub tallest: f64,
    /// Edge of the largest marker: it has to be in one picture whole, at any angle.
    pub widest_marker: f64,
}

/// Joint poses from which the camera, looking straight down from `distance` over the table, sees every marker on
/// the table and the reference markers round it whole.
///
/// # Errors
/// The place that cannot be looked at, with the table size in mind.
pub fn look_poses(
    model: &ArmModel,
    flange_from_camera: &Isometry3<f64>,
    (width, height): (f64, f64),
    angle: ViewAngle,
    distance: f64,
    things: Things,
) -> Result<Vec<Joints>, String> {
    let rim = REFERENCE_OUTSIDE_M + REFERENCE_SIZE_M;
    let above_things = distance - things.tallest;
    let whole = things.widest_marker * std::f64::consts::SQRT_2;
    let columns = centres(width, Reach::new(angle.half_x, [1.0, 1.0], distance, above_things), whole);
    let rows =
        centres(height, Reach::new(angle.half_y, [1.0 - 2.0 * HIDDEN, 1.0], distance, above_things), whole);
    let mut poses = Vec::new();
    for (row, y) in rows.iter().enumerate() {
        // Back and forth, so that the arm does not fly back at the end of each row.
        let mut line: Vec<f64> = columns.clone();
        if row % 2 == 1 {
            line.reverse();
        }
        for x in line {
            let at = [x - rim, y - rim, distance];
            let joints =
                camera_joints(model, flange_from_camera, at, [at[0], at[1], 0.0]).ok_or_else(|| {
                    format!("the camera cannot look at ({:.2}, {:.2}) m from {distance:.2} m", at[0], at[1])
                })?;
            poses.push(joints);
        }
    }
    Ok(poses)
}

/// How far a picture reaches before and behind its centre, m: on the table, and at the height of things.
struct Reach {
    table: [f64; 2],
    things: [f64; 2],
}

impl Reach {
    fn new(half: f64, shares: [f64; 2], distance: f64, above_things: f64) -> Reach {
        let at = |height: f64| shares.map(|share| share * half * height - BORDER_M);
        Reach { table: at(distance), things: at(above_things) }
    }
}

/// Centres of as few pictures as show a table of this length with the reference markers round it, in the frame of the
/// rim. Things of the size `whole` are in one picture whole.
fn centres(length: f64, reach: Reach, whole: f64) -> Vec<f64> {
    let rim = REFERENCE_OUTSIDE_M + REFERENCE_SIZE_M;
    // The outer border of the reference markers, white ring included.
    let outer = rim - REFERENCE_OUTSIDE_M - 0.5 * REFERENCE_SIZE_M * 10.0 / 8.0;
    let first = (outer + reach.table[0]).min(rim + reach.things[0]);
    let last = (2.0 * rim + length - outer - reach.table[1]).max(rim + length - reach.things[1]);
    if last <= first {
        return vec![0.5 * (first + last)];
    }
    let step = (reach.things[0] + reach.things[1] - whole).max(LEAST_STEP_M);
    let count = ((last - first) / step).ceil() as usize;
    (0..=count).map(|k| first + (last - first) * k as f64 / count as f64).collect()
}

/// Markers too wide for the picture are seen whole from nowhere; then more looks do not help.
const LEAST_STEP_M: f64 = 0.08;

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
        if CheckedPath::new(model, &at, &[Leg { segment, floor: 0.06 }]).is_ok() {
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
    use crate::motion::kinematics::{DhParameters, forward};
    use crate::motion::path::ArmLimits;
    use std::f64::consts::TAU;

    fn model(width: f64) -> ArmModel {
        ArmModel {
            dh: DhParameters::UR5E,
            base_from_table: Isometry3::translation(-width / 2.0, BASE_BEHIND_M, 0.0),
            flange_from_tool: Isometry3::translation(0.0, 0.0, 0.2),
            home: Joints([-1.6, -1.6, 1.9, -1.9, -1.57, 0.0]),
            limits: ArmLimits {
                joint_range: [(-TAU, TAU); 6],
                joint_speed: 2.0,
                joint_acceleration: 4.0,
                tool_speed: 0.5,
                tool_acceleration: 2.0,
                link_floor: 0.03,
            },
        }
    }

    const ANGLE: ViewAngle = ViewAngle { half_x: 640.0 / 650.0, half_y: 360.0 / 650.0 };

    #[test]
    fn every_marker_on_table_and_rim_is_wholly_in_some_picture() {
        let cases = [(0.02, 0.03), (0.08, 0.04), (0.04, 0.12)];
        let sizes = [0.2, 0.3, 0.4, 0.5, 0.6, 0.63, 0.7];
        for (size, (tallest, widest_marker)) in
            sizes.into_iter().flat_map(|size| cases.map(|case| (size, case)))
        {
            let model = model(size);
            let flange_from_camera = Isometry3::translation(0.0, -0.07, 0.03);
            let poses = look_poses(
                &model,
                &flange_from_camera,
                (size, size),
                ANGLE,
                0.42,
                Things { tallest, widest_marker },
            )
            .expect("reachable");
            let cameras: Vec<_> = poses
                .iter()
                .map(|q| model.base_from_table.inverse() * forward(&model.dh, q) * flange_from_camera)
                .collect();
            let seen = |camera: &Isometry3<f64>, x: f64, y: f64| {
                let p = camera.inverse() * Point3::new(x, y, tallest);
                let down = p.y / p.z / ANGLE.half_y;
                (p.x / p.z).abs() < ANGLE.half_x && -1.0 < down && down < 1.0 - 2.0 * HIDDEN && p.z > 0.0
            };
            let half = widest_marker / 2.0;
            let whole = |x: f64, y: f64| {
                let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)];
                let in_one = |camera: &Isometry3<f64>| {
                    corners.iter().all(|(i, j)| seen(camera, x + i * half, y + j * half))
                };
                cameras.iter().any(in_one)
            };
            let steps = 40;
            let along = |k: i32| half + (size - 2.0 * half) * f64::from(k) / f64::from(steps);
            for (i, j) in (0..=steps).flat_map(|i| (0..=steps).map(move |j| (i, j))) {
                let (x, y) = (along(i), along(j));
                assert!(whole(x, y), "({x:.3}, {y:.3}) of a {size} m table, {tallest} m up");
            }
        }
    }

    #[test]
    fn calibration_poses_tilt_about_both_axes() {
        let model = model(0.5);
        let flange_from_camera = Isometry3::translation(0.0, -0.07, 0.03);
        let poses = calibration_poses(&model, &flange_from_camera, (0.5, 0.5));
        assert!(poses.len() >= 10, "{} poses", poses.len());
        let tilt = |axis: usize| {
            let of = |q: &Joints| (forward(&model.dh, q).rotation * Vector3::z())[axis];
            let all: Vec<f64> = poses.iter().map(of).collect();
            all.iter().copied().fold(f64::MIN, f64::max) - all.iter().copied().fold(f64::MAX, f64::min)
        };
        assert!(tilt(0) > 0.5 && tilt(1) > 0.5, "tilts {} {}", tilt(0), tilt(1));
    }
}
