//! A simulated cell made to measure for an instance: the daemon's configuration and the simulator's, as two
//! people who only share the drawing would write them.
//!
//! In: an instance whose objects fit the cell, addresses, a seed. Out: a [`CellConfig`] with nominal values
//! and a [`SimConfig`] whose truth deviates from them by the seed. Nothing measured passes between the two.

use crate::cli::demo::teach::{
    BASE_BEHIND_M, REFERENCE_SIZE_M, ViewAngle, calibration_poses, look_poses, reference_markers,
};
use crate::config::cell::{
    CalibrationFiles, CameraDevice, CameraMount, CellConfig, CupChannel, CupConfig, Devices, GripperConfig,
    MotionLimits, PlannerConfig, ReferenceMarkerConfig, SimulationConfig, Tolerances, WorkspaceConfig,
};
use crate::daemon::setup::arm_model;
use crate::geometry::footprint::Footprint;
use crate::jobs::policy::{Approval, JobObjective};
use crate::motion::kinematics::DhParameters;
use crate::sim::camera_server::CameraSetup;
use crate::sim::cell::SimConfig;
use crate::sim::controller::ControllerConfig;
use crate::sim::render::lens::CameraTruth;
use crate::sim::robot_server::RobotPorts;
use crate::sim::world::spec;
use crate::sim::world::vacuum::Channel;
use crate::tabletop::instance::Instance;
use crate::units::Joints;
use nalgebra::Isometry3;
use std::f64::consts::TAU;
use std::net::IpAddr;
use std::path::Path;

/// Distance of the camera over the table while looking, m.
pub const LOOK_DISTANCE_M: f64 = 0.42;

/// Nominal focal length of the camera, px, and its picture.
pub const FOCAL_PX: f64 = 650.0;
const PICTURE: (u32, u32) = (1280, 720);

/// Diameter of the one cup, m.
pub const CUP_DIAMETER_M: f64 = 0.02;

/// Elbow up over the table: the posture of all work.
const HOME: Joints = Joints([-1.6, -1.6, 1.9, -1.9, -1.57, 0.0]);

/// What the demo may choose.
#[derive(Clone, Debug)]
pub struct DemoChoice {
    /// Loopback address of the simulated devices.
    pub bind: IpAddr,
    /// Simulated seconds per second.
    pub time_factor: f64,
    /// Seed of the world's truth and its errors.
    pub seed: u64,
    /// Solver's name.
    pub solver: String,
    /// Planning budget, s.
    pub time_limit_s: f64,
}

/// The daemon's side. Device ports are put in once the simulator listens.
///
/// # Errors
/// That the table cannot be looked at from the arm's place.
pub fn cell_config(instance: &Instance, choice: &DemoChoice, out: &Path) -> Result<CellConfig, String> {
    let (width, height) = (instance.workspace.width, instance.workspace.height);
    let base_from_table = Isometry3::translation(-width / 2.0, BASE_BEHIND_M, 0.0);
    let flange_from_camera = Isometry3::translation(0.0, -0.07, 0.03);
    let mut objects = instance.objects.clone();
    for object in &mut objects {
        object.start = None;
        object.goal = None;
    }
    let mut config = CellConfig {
        devices: Devices {
            robot_host: choice.bind.to_string(),
            gripper_host: choice.bind.to_string(),
            gripper_port: 502,
            camera: CameraDevice::Simulator { host: choice.bind.to_string(), port: 8080 },
        },
        workspace: WorkspaceConfig {
            width_m: width,
            height_m: height,
            clearance_m: instance.clearance.max(0.002),
            keep_out: instance.keep_out.clone(),
        },
        objects,
        reference_markers: reference_markers(width, height)
            .into_iter()
            .map(|(id, pose)| ReferenceMarkerConfig { id, size_m: REFERENCE_SIZE_M, pose })
            .collect(),
        gripper: GripperConfig {
            cups: vec![CupConfig { channel: CupChannel::A, x_m: 0.0, y_m: 0.0, diameter_m: CUP_DIAMETER_M }],
            body_polygon: vec![[-0.035, -0.035], [0.035, -0.035], [0.035, 0.035], [-0.035, 0.035]],
            body_height_m: 0.08,
            vacuum_min: 0.4,
            mass_kg: 0.95,
            centre_of_gravity_m: [0.0, -0.01, 0.07],
        },
        flange_from_tool: Isometry3::translation(0.0, 0.0, 0.2),
        base_from_table,
        camera: CameraMount::Flange { flange_from_camera },
        look_poses: Vec::new(),
        park_pose: HOME,
        work_pose: HOME,
        calibration_poses: Vec::new(),
        calibration: CalibrationFiles {
            camera: out.join("calibration/camera.yaml"),
            hand_eye: out.join("calibration/hand_eye.yaml"),
            table: out.join("calibration/table.yaml"),
        },
        limits: MotionLimits {
            joint_speed: 1.5,
            joint_acceleration: 3.0,
            tool_speed: 0.25,
            tool_acceleration: 1.2,
            joint_range: [(-TAU, TAU); 6],
            link_floor_m: 0.03,
            press_m: 5e-4,
            lift_height_m: 0.03,
            approach_height_m: 0.04,
            blend_m: 0.015,
        },
        tolerances: Tolerances {
            goal_position_m: 0.0014,
            goal_angle_rad: 0.7f64.to_radians(),
            observation_age_s: 60.0,
            reference_residual_m: 0.001,
        },
        planner: PlannerConfig {
            solver: choice.solver.clone(),
            objective: JobObjective::Pp,
            time_limit_s: choice.time_limit_s,
            seed: choice.seed,
        },
        approval: Approval::Never,
        arm_at_start: true,
        simulation: Some(SimulationConfig { clock_factor: choice.time_factor }),
        recording: None,
        goal_folder: out.to_path_buf(),
    };
    let model = arm_model(&config, DhParameters::UR5E, base_from_table);
    let angle = ViewAngle {
        half_x: f64::from(PICTURE.0) / 2.0 / FOCAL_PX,
        half_y: f64::from(PICTURE.1) / 2.0 / FOCAL_PX,
    };
    config.look_poses = look_poses(&model, &flange_from_camera, (width, height), angle, LOOK_DISTANCE_M)?;
    config.calibration_poses = calibration_poses(&model, &flange_from_camera, (width, height));
    Ok(config)
}

/// The simulator's side, with a truth of its own.
pub fn sim_config(instance: &Instance, config: &CellConfig, choice: &DemoChoice) -> SimConfig {
    let mount = match config.camera {
        CameraMount::Flange { flange_from_camera } => spec::CameraMount::Flange(flange_from_camera),
        CameraMount::Fixed { base_from_camera } => {
            spec::CameraMount::Fixed(config.base_from_table.inverse() * base_from_camera)
        }
    };
    let nominal = spec::NominalCell {
        base_from_table: config.base_from_table,
        mount,
        camera: CameraTruth::ideal("sim-d405", PICTURE.0, PICTURE.1, FOCAL_PX),
    };
    let truth = spec::TruthSpec::from_seed(&nominal, choice.seed);
    let mut controller = ControllerConfig::ur5e(choice.seed);
    controller.start = config.park_pose;
    SimConfig {
        bind: choice.bind,
        ports: RobotPorts::ANY,
        modbus_port: 0,
        camera_port: 0,
        control_port: None,
        time_factor: choice.time_factor,
        controller,
        world: spec::WorldSpec {
            table: spec::TableSpec {
                width_m: instance.workspace.width,
                height_m: instance.workspace.height,
                margin_m: 0.12,
            },
            base_from_table: truth.base_from_table,
            objects: instance.objects.iter().filter_map(world_object).collect(),
            reference_markers: config
                .reference_markers
                .iter()
                .map(|m| spec::ReferenceMarker { id: m.id, size_m: m.size_m, pose: m.pose })
                .collect(),
            errors: spec::PlacementErrors::default(),
            gripper: gripper_spec(config),
        },
        camera: CameraSetup { truth: truth.camera, reported: truth.reported, mount: truth.mount },
        seed: choice.seed,
    }
}

fn world_object(object: &crate::tabletop::instance::ObjectSpec) -> Option<spec::WorldObject> {
    Some(spec::WorldObject {
        id: object.id.clone(),
        footprint: object.footprint.clone(),
        height_m: object.height?,
        mass_kg: object.mass?,
        pose: object.start?,
        marker: object.marker.as_ref().map(|marker| spec::ObjectMarker {
            id: marker.id,
            size_m: marker.size,
            offset: marker.offset,
        }),
        grippable: object.grippable.clone().map(Footprint::Polygon),
        fixed: object.fixed,
        colour: None,
    })
}

fn gripper_spec(config: &CellConfig) -> spec::GripperSpec {
    let gripper = &config.gripper;
    let channel = |channel| match channel {
        CupChannel::A => Channel::A,
        CupChannel::B => Channel::B,
    };
    let cups = gripper.cups.iter().map(|cup| spec::Cup {
        channel: channel(cup.channel),
        x_m: cup.x_m,
        y_m: cup.y_m,
        diameter_m: cup.diameter_m,
    });
    spec::GripperSpec {
        flange_from_tool: config.flange_from_tool,
        cups: cups.collect(),
        // A body that cannot be drawn is no reason to stop: it only hides part of a picture.
        body: Footprint::polygon(&gripper.body_polygon).unwrap_or(Footprint::Disc { radius: 0.04 }),
        body_above_lips_m: 0.08,
    }
}
