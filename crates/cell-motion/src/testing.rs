//! The demo's arm, gripper, table and usual heights for tests, those of other crates included.
//!
//! In: the width of a table, where it is. Out: models and parameters of plain numbers.

use crate::bodies::cell::{CellBodies, GripperBody};
use crate::bodies::{Bodies, Surroundings, Tabletop};
use crate::path::{ArmLimits, ArmModel, BlendSpeed};
use crate::pick_n_place::{CycleParameters, PickNPlace, tool_down};
use cell_values::units::Joints;
use nalgebra::Isometry3;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use std::f64::consts::TAU;
use ur_arm::kinematics::{DhParameters, Kinematics};

/// Arm, gripper with one cup, camera and table of the demo.
pub fn bodies(base_from_table: Isometry3<f64>, table: [f64; 2]) -> Bodies {
    let flange_from_tool = Isometry3::translation(0.0, 0.0, 0.2);
    let cell = cell();
    let surroundings = Surroundings { base_from_table, flange_from_tool, table, link_floor: 0.03, cell };
    Bodies::new(&DhParameters::UR5E, &surroundings)
}

/// Gripper and camera of the demo.
pub fn cell() -> CellBodies {
    let gripper = GripperBody {
        outline: vec![[-0.035, -0.035], [0.035, -0.035], [0.035, 0.035], [-0.035, 0.035]],
        above_lips: 0.08,
        cups: vec![([0.0, 0.0], 0.01)],
    };
    let flange_from_tool = Isometry3::translation(0.0, 0.0, 0.2);
    let camera = Isometry3::translation(0.0, -0.07, 0.03);
    CellBodies::new(&gripper, &flange_from_tool, Some(&camera))
}

/// A table of which nothing is known but that all that may lie there ends at this height, m.
pub fn up_to(layer: f64) -> Tabletop {
    Tabletop { layer, corner_layer: layer, standing: Vec::new() }
}

/// A table on which nothing else lies, and anything up to the tallest object may.
pub fn table() -> Tabletop {
    cycle().tabletop(Vec::new())
}

/// A thin disc of 2 cm that is carried from one place to another.
pub fn task(from: Pose2, to: Pose2, grip_point: [f64; 2]) -> PickNPlace {
    PickNPlace {
        object: "disc".to_string(),
        footprint: Footprint::Disc { radius: 0.02 },
        from,
        to,
        grip_point,
        grip_yaw: None,
        height: 0.02,
        hold: 20.0,
    }
}

/// The demo's arm at a table of this width.
pub fn model(width: f64) -> ArmModel {
    ArmModel {
        kinematics: Kinematics::of(&DhParameters::UR5E),
        // The base is behind the middle of the near edge.
        base_from_table: Isometry3::translation(-width / 2.0, 0.18, 0.0),
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
        bodies: bodies(Isometry3::translation(-width / 2.0, 0.18, 0.0), [width, width]),
    }
}

/// Usual heights and speeds.
pub fn cycle() -> CycleParameters {
    CycleParameters {
        tallest: 0.02,
        air: 0.03,
        approach: 0.04,
        press: 0.001,
        blend: 0.02,
        joint_speed: 1.5,
        joint_acceleration: 3.0,
        tool_speed: 0.25,
        tool_acceleration: 1.2,
    }
}

/// Joints to begin with: the tool over the middle of the table.
pub fn home(model: &ArmModel, width: f64) -> Joints {
    let over = tool_down(width / 2.0, width / 2.0, 0.3, 0.0);
    model.joints_in_work_posture(&over, &model.home).expect("reachable")
}
