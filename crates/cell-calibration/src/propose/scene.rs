//! Where the hand would have to be, and what the camera would see from there: the cell as drawn.
//!
//! In: a [`Scene`]: arm, box, lens, and which of camera and target the hand carries. Out: flange poses for a
//! direction of view, the markers that appear well inside the picture. A camera on the hand before the table
//! and a board on the hand before a fixed camera are one geometry: the camera looks at a flat target, and
//! one of the two is on the flange. Pure.

use crate::propose::body::Body;
use cell_motion::path::ArmModel;
use cell_motion::slow::CalibrationBox;
use cell_values::units::Joints;
use cell_vision::camera::CameraModel;
use cell_vision::cv;
use cell_vision::detect::Detection;
use cell_vision::marker;
use cell_vision::observe::ReferenceMarker;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// The golden angle: directions of tilt that never bunch up, rad.
const AZIMUTH_STEP: f64 = 2.399_963;
/// Turns about the optical axis, rad; the wrist has room for them.
const ROLLS: [f64; 5] = [0.0, 0.6, -0.6, 0.3, -0.3];
/// Distances of the camera from where it looks: so many, from the first, m.
const DISTANCES: usize = 14;
const NEAREST_M: f64 = 0.25;
const FURTHER_M: f64 = 0.05;
/// Markers of the target that every pose shows.
pub(super) const SEEN_MIN: usize = 4;
/// Rim of the picture that is not relied on, as a share: the nominal mount is a few millimetres and degrees
/// off.
const RIM: f64 = 0.05;
/// Least edge of a marker in the picture, px.
const EDGE_PX: f64 = 18.0;
/// Least distance of the arm's and the board's middle from a fixed camera, m: half an arm, half a camera,
/// and the 10 cm by which its place may be wrong.
const CAMERA_CLEAR_M: f64 = 0.2;
/// Least height of the board's corners over the table, m; plates are larger than the print.
const BOARD_CLEAR_M: f64 = 0.08;
/// The hand may hang so differently from home before a fixed camera, rad; more is a clamp given wrongly.
const UPRIGHT_MAX: f64 = PI / 3.0;
/// Places looked at on the way between two poses.
const ON_THE_WAY: u32 = 25;

/// Which of the two the hand carries.
#[derive(Clone, Copy, Debug)]
pub(super) enum Carried {
    /// The camera; the target is the table with its reference markers.
    Camera { flange_from_camera: Isometry3<f64>, base_from_table: Isometry3<f64> },
    /// The target, a board; the camera is fixed.
    Board { flange_from_board: Isometry3<f64>, base_from_camera: Isometry3<f64> },
}

/// What poses are proposed for.
pub(super) struct Scene<'a> {
    /// The arm.
    pub model: &'a ArmModel,
    /// What the flange does not leave.
    pub room: &'a CalibrationBox,
    /// The camera's.
    pub lens: &'a CameraModel,
    /// What moves.
    pub carried: Carried,
    /// The target's markers, in its frame.
    pub target: Vec<ReferenceMarker>,
    /// Its extent, m, from its frame's origin.
    pub target_m: [f64; 2],
    /// Turn about the optical axis with which the hand hangs as at home, rad: see [`Scene::stand_upright`].
    pub upright: f64,
}

impl Scene<'_> {
    /// Where the flange is in the base when the camera is at `target_from_camera`.
    pub(super) fn base_from_flange(&self, target_from_camera: &Isometry3<f64>) -> Isometry3<f64> {
        match self.carried {
            Carried::Camera { flange_from_camera, base_from_table } => {
                base_from_table * target_from_camera * flange_from_camera.inverse()
            }
            Carried::Board { flange_from_board, base_from_camera } => {
                base_from_camera * target_from_camera.inverse() * flange_from_board.inverse()
            }
        }
    }

    /// Where target and camera are in the base with the flange there.
    fn placed(&self, base_from_flange: &Isometry3<f64>) -> [Isometry3<f64>; 2] {
        match self.carried {
            Carried::Camera { flange_from_camera, base_from_table } => {
                [base_from_table, base_from_flange * flange_from_camera]
            }
            Carried::Board { flange_from_board, base_from_camera } => {
                [base_from_flange * flange_from_board, base_from_camera]
            }
        }
    }

    /// The target's markers as the arm shows them with these joints: to a fixed camera, those that the arm
    /// does not hide.
    pub(super) fn visible(&self, q: &Joints) -> Vec<Detection> {
        let [base_from_target, _] = self.placed(&self.model.kinematics.forward(q));
        self.visible_of(&self.target, &base_from_target, q)
    }

    /// The same of markers elsewhere.
    pub(super) fn visible_of(
        &self,
        markers: &[ReferenceMarker],
        base_from_markers: &Isometry3<f64>,
        q: &Joints,
    ) -> Vec<Detection> {
        let [_, base_from_camera] = self.placed(&self.model.kinematics.forward(q));
        let mut seen = self.seen(markers, &(base_from_markers.inverse() * base_from_camera));
        if let Carried::Board { .. } = self.carried {
            let (body, eye) = (Body::new(self.model, q), Point3::from(base_from_camera.translation.vector));
            let centre = |id: u32| markers.iter().find(|marker| marker.id == id).map(|marker| marker.pose);
            seen.retain(|one| {
                centre(one.id)
                    .is_some_and(|at| !body.hides(&eye, &(base_from_markers * Point3::new(at.x, at.y, 0.0))))
            });
        }
        seen
    }

    /// On the way between two postures arm and board stay clear of a fixed camera, and the board of the
    /// table.
    pub(super) fn keeps_clear(&self, from: &Joints, to: &Joints) -> bool {
        let Carried::Board { base_from_camera, .. } = self.carried else { return true };
        let camera = Point3::from(base_from_camera.translation.vector);
        let [width, height] = self.target_m;
        (0..=ON_THE_WAY).all(|k| {
            let share = f64::from(k) / f64::from(ON_THE_WAY);
            let q = from.lerp(to, share);
            let [base_from_board, _] = self.placed(&self.model.kinematics.forward(&q));
            let corners = [[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]
                .map(|[x, y]| base_from_board * Point3::new(x, y, 0.0));
            let over_table = |corner: &Point3<f64>| (self.model.base_from_table.inverse() * corner).z;
            Body::new(self.model, &q).clears_m(&camera) > CAMERA_CLEAR_M
                && corners.iter().all(|corner| {
                    over_table(corner) > BOARD_CLEAR_M && (corner - camera).norm() > CAMERA_CLEAR_M
                })
        })
    }

    /// Flange poses (base frame) within the box from which enough of the target is seen, tilted by `tilt`
    /// rad in the direction of `turn`; those that show most come first.
    pub(super) fn flanges(&self, tilt: f64, turn: usize) -> Vec<Isometry3<f64>> {
        let look = direction(tilt, turn, self.upright);
        let aims = self.aims(turn);
        let mut places: Vec<(usize, Isometry3<f64>)> = Vec::new();
        for k in 0..DISTANCES {
            // Another height first each time.
            let step = (k + 5 * turn) % DISTANCES;
            let distance = NEAREST_M + FURTHER_M * step as f64;
            for [x, y] in &aims {
                let eye = Vector3::new(*x, *y, 0.0) - look * Vector3::new(0.0, 0.0, distance);
                let target_from_camera = Isometry3::from_parts(Translation3::from(eye), look);
                let flange = self.base_from_flange(&target_from_camera);
                if self.room.outside_m(&flange.translation.vector) > 0.0 {
                    continue;
                }
                let seen = self.seen(&self.target, &target_from_camera).len();
                if seen >= SEEN_MIN {
                    places.push((seen, flange));
                }
            }
        }
        // The sort is stable: of equally good ones the first tried.
        places.sort_by_key(|(seen, _)| std::cmp::Reverse(*seen));
        places.into_iter().map(|(_, flange)| flange).collect()
    }

    /// Finds the turn about the optical axis with which the hand hangs as it does at home. A camera is
    /// mounted to look at the table that way; how a board is clamped is a free choice.
    ///
    /// # Errors
    /// With no turn the hand hangs as at home: how far it is off, rad.
    pub(super) fn stand_upright(&mut self) -> Result<(), f64> {
        let Carried::Board { .. } = self.carried else { return Ok(()) };
        let home = self.model.kinematics.forward(&self.model.home).rotation;
        let off = |roll: f64| {
            let look = Isometry3::from_parts(Translation3::identity(), direction(0.0, 0, roll));
            self.base_from_flange(&look).rotation.angle_to(&home)
        };
        let rolls = (0..24).map(|k| f64::from(k) * PI / 12.0).map(|roll| (off(roll), roll));
        let (least, upright) = rolls.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((PI, 0.0));
        self.upright = upright;
        if least > UPRIGHT_MAX { Err(least) } else { Ok(()) }
    }

    /// Points of the target's plane to look at, m: on the table, the middle first. A board that the camera
    /// always looked at the middle of would show nothing of the picture's rest, so points beside it, another
    /// first each time.
    fn aims(&self, turn: usize) -> Vec<[f64; 2]> {
        let shares = match self.carried {
            Carried::Camera { .. } => [0.5, 0.35, 0.65, 0.2, 0.8],
            Carried::Board { .. } => [0.5, 0.0, 1.0, -0.7, 1.7],
        };
        let [width, height] = self.target_m;
        let mut aims: Vec<[f64; 2]> =
            shares.iter().flat_map(|x| shares.map(|y| [width * x, height * y])).collect();
        let off = |p: &[f64; 2]| (p[0] - width / 2.0).hypot(p[1] - height / 2.0);
        aims.sort_by(|a, b| off(a).total_cmp(&off(b)));
        if let Carried::Board { .. } = self.carried {
            let first = 7 * turn % aims.len();
            aims.rotate_left(first);
        }
        aims
    }

    /// Those of the markers that are well inside the picture, where they would appear.
    fn seen(&self, markers: &[ReferenceMarker], target_from_camera: &Isometry3<f64>) -> Vec<Detection> {
        let camera_from_target = target_from_camera.inverse();
        markers.iter().filter_map(|marker| appears(self.lens, marker, &camera_from_target)).collect()
    }
}

/// The camera's attitude before the target: looking at its front, turned about its axis, tilted.
fn direction(tilt: f64, turn: usize, upright: f64) -> UnitQuaternion<f64> {
    let azimuth = AZIMUTH_STEP * turn as f64;
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    let roll = upright + ROLLS[turn % ROLLS.len()];
    let rolled = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
    let axis = Vector3::new(azimuth.cos(), azimuth.sin(), 0.0);
    UnitQuaternion::from_scaled_axis(axis * tilt) * rolled * down
}

/// The marker as it would be detected; `None` where it is not well inside the picture, or too small in it.
fn appears(
    lens: &CameraModel,
    marker: &ReferenceMarker,
    camera_from_target: &Isometry3<f64>,
) -> Option<Detection> {
    let (width, height) = (f64::from(lens.width), f64::from(lens.height));
    // Far outside the picture a lens model folds back into it.
    let widest = 1.1 * (width / lens.fx).hypot(height / lens.fy) / 2.0;
    let inside = |&[x, y]: &[f64; 2]| {
        (RIM * width..=(1.0 - RIM) * width).contains(&x) && (RIM * height..=(1.0 - RIM) * height).contains(&y)
    };
    let points = marker::corners_m(marker.size).map(|corner| marker.pose.transform(corner));
    let points = points.map(|[x, y]| [x, y, 0.0]);
    let before = |[x, y, z]: &[f64; 3]| {
        let p = camera_from_target * Point3::new(*x, *y, *z);
        p.z > 0.05 && p.x.hypot(p.y) < widest * p.z
    };
    if !points.iter().all(before) {
        return None;
    }
    let pixels = cv::project(lens, camera_from_target, &points).ok()?;
    let corners = <[[f64; 2]; 4]>::try_from(pixels).ok()?;
    let edge = |i: usize| {
        let (a, b) = (corners[i], corners[(i + 1) % 4]);
        (a[0] - b[0]).hypot(a[1] - b[1])
    };
    let sound = corners.iter().all(inside) && (0..4).all(|i| edge(i) >= EDGE_PX);
    let family = marker::FAMILY.to_owned();
    sound.then_some(Detection { family, id: marker.id, corners, decision_margin: 100.0, hamming: 0 })
}
