//! What is fixed to the flange and what is fixed to the floor: gripper, camera, equipment, safety planes.
//!
//! In: the gripper's outline and cups in the tool frame, where the camera sits, what the configuration's
//! `cell:` section adds. Out: named convex shapes, in the flange frame or in the base frame. Pure.

use crate::bodies::shape::Shape;
use nalgebra::{Isometry3, Point3};
use std::f64::consts::TAU;

/// Distance kept to everything that does not move, m, where the configuration gives none.
pub const MARGIN_M: f64 = 0.005;

/// Edges of a D405 along its x, y and z axes, m, and how far its front lies before the camera frame's
/// origin.
const CAMERA_M: [f64; 3] = [0.042, 0.042, 0.023];
const CAMERA_FRONT_M: f64 = 0.004;

/// Room round the camera for its plug, its screws and errors of its place as drawn, m.
const CAMERA_ROOM_M: f64 = 0.01;

/// Radius of the bracket between flange and camera, m.
const BRACKET_M: f64 = 0.015;

/// Corners of the prism round a cup.
const CUP_CORNERS: usize = 12;

/// A shape and what people call it.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedShape {
    /// As it appears in sentences: "the feeder".
    pub name: String,
    /// In the base frame, or in that of the flange.
    pub shape: Shape,
}

/// Gripper, camera, equipment.
#[derive(Clone, Debug, PartialEq)]
pub struct CellBodies {
    /// Distance kept to everything that does not move, m.
    pub margin_m: f64,
    /// Room for hoses and cables round forearm and wrists, m.
    pub cable_m: f64,
    /// What the robot is mounted on; a column where it is not given.
    pub stand: Option<Shape>,
    /// Everything else that does not move, in the base frame.
    pub equipment: Vec<NamedShape>,
    /// What is fixed to the flange, in its frame, without the cups.
    pub tool: Vec<NamedShape>,
    /// The cups and their pipes, in the flange frame.
    pub cups: Vec<NamedShape>,
}

/// The gripper in the tool frame, as the configuration describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct GripperBody {
    /// Outline of the body, m.
    pub outline: Vec<[f64; 2]>,
    /// Its lower face over the cup lips, m.
    pub above_lips: f64,
    /// Centre and radius of each cup, m.
    pub cups: Vec<([f64; 2], f64)>,
}

impl CellBodies {
    /// A gripper on the flange, a camera beside it where there is one, and nothing else.
    pub fn new(
        gripper: &GripperBody,
        flange_from_tool: &Isometry3<f64>,
        flange_from_camera: Option<&Isometry3<f64>>,
    ) -> CellBodies {
        let tool_from_flange = flange_from_tool.inverse();
        let seen =
            |[x, y]: [f64; 2], z: f64| -> [f64; 3] { (flange_from_tool * Point3::new(x, y, z)).into() };
        // In the tool frame z points out of the gripper: the flange is where z is lowest.
        let top = tool_from_flange.translation.z.min(-gripper.above_lips);
        let outline = gripper.outline.iter();
        let body = outline.flat_map(|corner| [seen(*corner, -gripper.above_lips), seen(*corner, top)]);
        let mut tool = vec![NamedShape { name: "the gripper".to_string(), shape: Shape::hull(body, 0.0) }];
        if let Some(camera) = flange_from_camera {
            tool.extend(camera_and_bracket(camera));
        }
        let cups = gripper.cups.iter().map(|(centre, radius)| {
            let ring = (0..CUP_CORNERS).map(|k| {
                let (sin, cos) = (TAU * k as f64 / CUP_CORNERS as f64).sin_cos();
                [centre[0] + 1.05 * radius * cos, centre[1] + 1.05 * radius * sin]
            });
            let ends = ring.flat_map(|corner| [seen(corner, 0.0), seen(corner, -gripper.above_lips)]);
            NamedShape { name: "a cup".to_string(), shape: Shape::hull(ends, 0.0) }
        });
        CellBodies {
            margin_m: MARGIN_M,
            cable_m: 0.0,
            stand: None,
            equipment: Vec::new(),
            tool,
            cups: cups.collect(),
        }
    }

    /// An arm with nothing on its flange and nothing round it.
    pub fn bare() -> CellBodies {
        CellBodies {
            margin_m: MARGIN_M,
            cable_m: 0.0,
            stand: None,
            equipment: Vec::new(),
            tool: Vec::new(),
            cups: Vec::new(),
        }
    }
}

/// The camera's housing, and a rod from the flange to it.
fn camera_and_bracket(flange_from_camera: &Isometry3<f64>) -> [NamedShape; 2] {
    let middle = Isometry3::translation(0.0, 0.0, CAMERA_FRONT_M - CAMERA_M[2] / 2.0);
    let housing = Shape::cuboid(CAMERA_M, &(flange_from_camera * middle)).widened(CAMERA_ROOM_M);
    let ends = flange_from_camera * middle * Point3::origin();
    let foot = [0.0, 0.0, BRACKET_M];
    [
        NamedShape { name: "the camera".to_string(), shape: housing },
        NamedShape {
            name: "the camera's bracket".to_string(),
            shape: Shape::capsule(foot, ends.into(), BRACKET_M),
        },
    ]
}
