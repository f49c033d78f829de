//! A simulated cell made to measure for an instance: the daemon's configuration and the simulator's, as two
//! people who only share the drawing would write them.
//!
//! In: an instance whose objects fit the cell, addresses, a seed. Out: a [`CellConfig`] with nominal values
//! and a [`SimFile`] whose truth deviates from them by the seed. Nothing measured passes between the two.

use crate::config::bodies::Equipment;
use crate::config::cell::{
    CalibrationFiles, CameraDevice, CellConfig, Devices, MotionLimits, PlannerConfig, SimulationConfig,
    Tolerances, WorkspaceConfig,
};
use crate::config::read_cell::{
    ARM_LAPSE_S, FULL_LOOK_EVERY, REFERENCE_SHIFT_M, REFERENCE_TURN_DEG, RETRIES, SIMULATED_SETTLE_S,
};
use crate::config::setup::arm_model;
use crate::demo::teach::{
    BASE_BEHIND_M, REFERENCE_SIZE_M, ViewAngle, calibration_poses, look_poses, reference_markers,
};
use crate::jobs::journal::old::HistoryLimits;
use cell_calibration::drawn::CameraMount;
use cell_machine::orders::Approval;
use cell_machine::supervisor::model::ForeignRule;
use cell_parts::gripper::{CupChannel, CupConfig, GripperConfig};
use cell_parts::reference::ReferenceMarkerConfig;
use cell_values::image::quality::PictureLimits;
use cell_values::units::Joints;
use nalgebra::Isometry3;
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;
use rearrange::tabletop::instance::{Instance, ObjectSpec};
use std::f64::consts::TAU;
use std::net::IpAddr;
use std::path::Path;
use ur_arm::kinematics::{ARM_MODELS, DhParameters};
use ur_sim::box_clients::BoxConfig;
use ur_sim::command::{FOCAL_PX, PICTURE};
use ur_sim::config::read::DEFAULT_ERRORS;
use ur_sim::config::{Installation, SimFile, SimMount, SimPorts};
use ur_sim::controller::config::SOFTWARE;
use ur_sim::controller::modes::Control;
use ur_sim::controller::program_files::ProgramFiles;
use ur_sim::motion::rest::RestConfig;
use ur_sim::motion::rounding::EntrySpeed;
use ur_sim::motion::safety::SafetyLimits;
use ur_sim::world::drive::Drive;

/// Distance of the camera over the table while looking, m.
pub const LOOK_DISTANCE_M: f64 = 0.42;

/// Diameter of the one cup, m.
pub const CUP_DIAMETER_M: f64 = 0.02;

/// Elbow up over the table: the posture of all work.
const HOME: Joints = Joints([-1.6, -1.6, 1.9, -1.9, -1.57, 0.0]);

/// What the arm may do at most: well below a UR5e's own limits.
const LIMITS: MotionLimits = MotionLimits {
    joint_speed: 1.5,
    joint_acceleration: 3.0,
    tool_speed: 0.25,
    tool_acceleration: 1.2,
    joint_range: [(-TAU, TAU); 6],
    link_floor_m: 0.03,
    press_m: 5e-4,
    lift_height_m: 0.03,
    approach_height_m: 0.03,
    blend_m: 0.05,
};

/// What the demo may choose.
#[derive(Clone, Debug)]
pub struct DemoChoice {
    /// Loopback address of the simulated devices.
    pub bind: IpAddr,
    /// Simulated seconds per second.
    pub time_factor: f64,
    /// Seed of the world's truth and its errors.
    pub seed: u64,
    /// Solver.
    pub solver: SolverKind,
    /// What plans are judged by.
    pub objective: Objective,
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
    let mut config = CellConfig {
        devices: devices(choice),
        workspace: WorkspaceConfig {
            width_m: width,
            height_m: height,
            clearance_m: instance.clearance.max(0.002),
            keep_out: instance.keep_out.clone(),
        },
        objects: catalogue(instance),
        reference_markers: reference_markers(width, height)
            .into_iter()
            .map(|(id, pose)| ReferenceMarkerConfig { id, size_m: REFERENCE_SIZE_M, pose })
            .collect(),
        gripper: gripper(),
        flange_from_tool: Isometry3::translation(0.0, 0.0, 0.2),
        base_from_table,
        camera: CameraMount::Flange { flange_from_camera },
        look_poses: Vec::new(),
        park_pose: HOME,
        work_pose: HOME,
        calibration_poses: Vec::new(),
        calibration_box: None,
        calibration: CalibrationFiles {
            camera: out.join("calibration/camera.yaml"),
            hand_eye: out.join("calibration/hand_eye.yaml"),
            table: out.join("calibration/table.yaml"),
            empty: None,
            blends: out.join("calibration/blends.yaml"),
        },
        limits: LIMITS,
        tolerances: tolerances(),
        planner: planner(choice),
        approval: Approval::Never,
        arm_at_start: true,
        arm_lapse_s: ARM_LAPSE_S,
        history: HistoryLimits::YEAR,
        simulation: Some(SimulationConfig { clock_factor: choice.time_factor }),
        recording: None,
        goal_folder: out.to_path_buf(),
        ignore_markers: Vec::new(),
        foreign: ForeignRule::Refuse { depth_needed: true },
        equipment: Equipment::default(),
        page: None,
        fleet: None,
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

fn devices(choice: &DemoChoice) -> Devices {
    let host = choice.bind.to_string();
    Devices {
        robot_host: host.clone(),
        gripper_host: host.clone(),
        gripper_port: 502,
        gripper_unit: 65,
        camera: CameraDevice::Simulator { host, port: 8080, depth: true },
        picture_limits: PictureLimits::STANDARD,
    }
}

/// What the objects are, without where they lie: the camera finds that.
fn catalogue(instance: &Instance) -> Vec<ObjectSpec> {
    let mut objects = instance.objects.clone();
    for object in &mut objects {
        if !object.fixed {
            object.start = None;
        }
        object.goal = None;
    }
    objects
}

fn gripper() -> GripperConfig {
    GripperConfig {
        cups: vec![CupConfig { channel: CupChannel::A, x_m: 0.0, y_m: 0.0, diameter_m: CUP_DIAMETER_M }],
        body_polygon: vec![[-0.035, -0.035], [0.035, -0.035], [0.035, 0.035], [-0.035, 0.035]],
        body_height_m: 0.08,
        vacuum_min: 0.5,
        mass_kg: 0.95,
        centre_of_gravity_m: [0.0, -0.01, 0.07],
    }
}

fn tolerances() -> Tolerances {
    Tolerances {
        goal_position_m: 0.0014,
        goal_angle_rad: 0.7f64.to_radians(),
        observation_age_s: 60.0,
        full_look_every: FULL_LOOK_EVERY,
        retries: RETRIES,
        stop_retries: 0,
        settle_s: SIMULATED_SETTLE_S,
        reference_residual_m: 0.001,
        reference_shift_m: REFERENCE_SHIFT_M,
        reference_turn_rad: REFERENCE_TURN_DEG.to_radians(),
    }
}

fn planner(choice: &DemoChoice) -> PlannerConfig {
    PlannerConfig {
        solver: choice.solver,
        objective: choice.objective,
        time_limit_s: choice.time_limit_s,
        seed: choice.seed,
    }
}

/// The simulator's side; its truth comes from the seed.
///
/// # Errors
/// The cell's camera is not on the flange.
pub fn sim_file(instance: &Instance, config: &CellConfig, choice: &DemoChoice) -> Result<SimFile, String> {
    let CameraMount::Flange { flange_from_camera } = config.camera else {
        return Err("the demo's camera sits on the flange".to_string());
    };
    Ok(SimFile {
        bind: choice.bind.to_string(),
        ports: SimPorts {
            modbus: 0,
            camera: 0,
            control: 0,
            controller_modbus: None,
            robot_api: 0,
            robotiq: 0,
        },
        seed: choice.seed,
        time_factor: choice.time_factor,
        width_m: instance.workspace.width,
        height_m: instance.workspace.height,
        base_from_table: config.base_from_table,
        flange_from_tool: config.flange_from_tool,
        camera: SimMount::Flange(flange_from_camera),
        hand_board: None,
        gripper: config.gripper.clone(),
        drive: Drive::Vgc10,
        objects: instance.objects.clone(),
        reference_markers: config.reference_markers.clone(),
        model: ARM_MODELS[0],
        software: SOFTWARE,
        encoders: [0.0; 2],
        conveyors: Vec::new(),
        start_pose: config.park_pose,
        control: Control::Remote,
        safety: SafetyLimits::default(),
        entry_speed: EntrySpeed::default(),
        rest: RestConfig::recorded(),
        installation: Installation::Gripper,
        compute_box: BoxConfig::default(),
        program_folder: None,
        programs: ProgramFiles::default(),
        errors: DEFAULT_ERRORS,
    })
}
