//! From configuration and calibration to the parameter structs of supervisor, perception and devices.
//!
//! In: a checked [`CellConfig`], what calibration found, the reported kinematics. Out: plain structs. Pure.

use crate::config::bodies::Equipment;
use crate::config::cell::CellConfig;
use crate::config::check::{off_centre, suction};
use crate::config::sessions::gripper_address;
use crate::perception::Scene;
use cell_calibration::drawn::{CameraMount, Drawn};
use cell_calibration::files::hand_eye::Mount;
use cell_machine::device::gripper_types::Channels;
use cell_machine::event::Arm;
use cell_machine::orders::ConfirmedGripper;
use cell_machine::stillness::{LEAST_REST, SIMULATED_LEAST_REST};
use cell_machine::supervisor::model::{
    CellModel, CellObject, DeviceAddresses, ForeignRule, GripSettings, Tolerances,
};
use cell_machine::views::SightModel;
use cell_motion::bodies::cell::{CellBodies, GripperBody};
use cell_motion::bodies::{Bodies, Surroundings};
use cell_motion::holding::LEAST_ACCELERATION;
use cell_motion::path::{ArmLimits, ArmModel, BlendSpeed};
use cell_motion::pick_n_place::{CycleParameters, plan};
use cell_parts::gripper::CupChannel;
use cell_values::time::Duration;
use cell_vision::camera::CameraModel;
use cell_vision::foreign::search::{CatalogueObject, ForeignSearch, Inventory};
use cell_vision::foreign::{Area, ForeignLimits, HeightMapError, KnownBody, OwnBody};
use cell_vision::observe::reference::DriftLimits;
use cell_vision::observe::{MarkedObject, ObserveLimits, ReferenceMarker};
use nalgebra::{Isometry3, Vector3};
use rearrange::geometry::pose::Pose2;
use rearrange::tabletop::instance::{ObjectSpec, Workspace};
use rearrange::tabletop::room::{Cup, Grip, place_for_cups};
use std::sync::Arc;
use ur_arm::kinematics::{DhParameters, Kinematics};

/// What calibration found and the controller reported.
#[derive(Clone, Debug)]
pub struct Measured {
    /// The arm's calibrated kinematics.
    pub dh: DhParameters,
    /// Where the table is.
    pub base_from_table: Isometry3<f64>,
    /// Where the camera sits.
    pub mount: Mount,
    /// The camera's lens.
    pub camera: CameraModel,
    /// Corners may be cut: the cell is simulated, or this arm's blends are recorded. Otherwise the arm stops
    /// at corners, whatever `limits.blend_m` says.
    pub blends: bool,
}

/// Why a configuration cannot be worked with, although each key is fine.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SetupError {
    /// Height, mass or marker is missing.
    #[error("object {id} has no {what}; the cell needs it")]
    Lacks {
        /// Object.
        id: String,
        /// What is missing.
        what: &'static str,
    },
    /// The cups do not fit on it.
    #[error("object {id}: no place on its top where all cups lie with 1 mm to spare")]
    NoGrip {
        /// Object.
        id: String,
    },
    /// The cups could lose it on the way.
    #[error(
        "object {id} weighs {mass_kg} kg: carrying it safely takes {needed_n:.1} N, the cups hold \
         {held_n:.1} N where a loss is reported"
    )]
    TooHeavy {
        /// Object.
        id: String,
        /// Its mass, kg.
        mass_kg: f64,
        /// Force that the factors require, N.
        needed_n: f64,
        /// Force of the cups at the least vacuum that counts as held, N.
        held_n: f64,
    },
}

/// Distance every cup keeps to the edge of a top, m (design, section 4.4).
pub const CUP_MARGIN_M: f64 = 1e-3;

/// Relative vacuum requested; regulated down from the pump's 80 % to spare the filters.
const VACUUM_TARGET: f64 = 0.6;

/// Reference markers that a look must show: with fewer, a bump of the camera could hide in the noise.
const REFERENCES_SEEN: usize = 3;

/// How far round the workspace foreign objects are looked for, m: the gripper comes down at its very edge.
const SEARCH_MARGIN_M: f64 = 0.02;

/// Room round the gripper in which points are taken for its own, m.
const OWN_MARGIN_M: f64 = 0.02;

/// The supervisor's model of the cell.
///
/// # Errors
/// What an object of the catalogue lacks.
pub fn cell_model(config: &CellConfig, measured: &Measured) -> Result<CellModel, SetupError> {
    Ok(model_of(config, measured, cell_objects(config)?))
}

fn model_of(config: &CellConfig, measured: &Measured, objects: Vec<CellObject>) -> CellModel {
    let (robot, gripper) = (config.devices.robot_host.clone(), gripper_address(&config.devices));
    let tolerances = &config.tolerances;
    CellModel {
        addresses: DeviceAddresses { robot, gripper },
        confirmed: match config.simulation {
            Some(_) => ConfirmedGripper::NotNeeded,
            None => ConfirmedGripper::None,
        },
        held_before: None,
        plans_before: 0,
        cut_off: None,
        arm: arm_model(config, measured.dh, measured.base_from_table),
        cycle: match measured.blends {
            true => cycle_parameters(config),
            false => CycleParameters { blend: 0.0, ..cycle_parameters(config) },
        },
        mount: measured.mount,
        look_poses: config.look_poses.clone(),
        frames_per_view: 2,
        sight: sight(config, measured),
        park: config.park_pose,
        round: config.calibration_round(),
        workspace: Workspace { width: config.workspace.width_m, height: config.workspace.height_m },
        clearance: config.workspace.clearance_m,
        keep_out: config.obstacles(),
        ignore_markers: config.ignore_markers.clone(),
        objects,
        foreign: config.foreign,
        tolerances: Tolerances {
            goal_position: tolerances.goal_position_m,
            goal_angle: tolerances.goal_angle_rad,
            expected_position: 2.0 * tolerances.goal_position_m,
            expected_angle: 2.0 * tolerances.goal_angle_rad,
            observation_age: Duration::from_secs_f64(tolerances.observation_age_s),
            full_look_every: tolerances.full_look_every,
            reference: drift_limits(config),
            reference_seen: REFERENCES_SEEN,
            measurement_std: tolerances.goal_position_m,
            retries: tolerances.retries,
            stop_retries: tolerances.stop_retries,
            settle: settle(config),
            look_deadline: Duration::from_secs(60),
            phase_deadline: Duration::from_secs(60),
            arm_lapse: Duration::from_secs_f64(config.arm_lapse_s),
            plan_grace: Duration::from_secs(600),
        },
        grip: grip_settings(config),
    }
}

/// What the camera shows from where. Colours are compared with pictures from the look poses alone.
fn sight(config: &CellConfig, measured: &Measured) -> Option<SightModel> {
    let flange_from_camera = measured.mount.flange_from_camera()?;
    let by_colour = config.foreign != ForeignRule::Off && config.calibration.empty.is_some();
    let by_depth = config.devices.camera.measures_depth() || !by_colour;
    let own = own_body(config, flange_from_camera.inverse() * config.flange_from_tool);
    by_depth.then(|| SightModel {
        camera: measured.camera.clone(),
        references: reference_markers(config),
        smallest_m: smallest_marker(config),
        own: Some(own),
        views: Arc::default(),
    })
}

/// Edge of the smallest marker that looks have to find, m.
fn smallest_marker(config: &CellConfig) -> f64 {
    let objects = config.objects.iter().filter_map(|object| Some(object.marker.as_ref()?.size));
    objects.chain(config.reference_markers.iter().map(|marker| marker.size_m)).fold(f64::INFINITY, f64::min)
}

/// The gripper as the camera on the wrist may see it.
fn own_body(config: &CellConfig, camera_from_tool: Isometry3<f64>) -> OwnBody {
    let radius = config.gripper.body_polygon.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max);
    let (radius_m, beyond_m) = (radius + OWN_MARGIN_M, OWN_MARGIN_M);
    OwnBody { camera_from_tool, radius_m, body_m: radius, beyond_m }
}

/// The model of a cell that is not calibrated yet: the arm as the controller reports it, table and camera as
/// drawn, no object. Good for calibration rounds and nothing else.
pub fn nominal_model(config: &CellConfig, arm: &Arm, lens: &CameraModel) -> CellModel {
    let mount = match &config.camera {
        CameraMount::Flange { flange_from_camera } => {
            Mount::Flange { flange_from_camera: *flange_from_camera }
        }
        CameraMount::Fixed { base_from_camera, .. } => Mount::Fixed { base_from_camera: *base_from_camera },
    };
    let camera = lens.clone();
    let measured =
        Measured { dh: arm.dh, base_from_table: config.base_from_table, mount, camera, blends: true };
    model_of(config, &measured, Vec::new())
}

/// Heights and speeds of a pick-n-place.
pub fn cycle_parameters(config: &CellConfig) -> CycleParameters {
    let limits = &config.limits;
    CycleParameters {
        tallest: config.objects.iter().filter_map(|object| object.height).fold(0.0, f64::max),
        air: limits.lift_height_m,
        approach: limits.approach_height_m,
        press: limits.press_m,
        blend: limits.blend_m,
        joint_speed: limits.joint_speed,
        joint_acceleration: limits.joint_acceleration,
        tool_speed: limits.tool_speed,
        tool_acceleration: limits.tool_acceleration,
    }
}

/// An object to be carried.
#[derive(Clone, Debug)]
pub struct Transport {
    /// Name of the object.
    pub object: String,
    /// Its start, table frame.
    pub from: Pose2,
    /// Its goal, table frame.
    pub to: Pose2,
}

/// Whether the arm, as drawn, can carry each object from its start to its goal.
///
/// # Errors
/// The first object that it cannot, and why.
pub fn check_reach(config: &CellConfig, task: &[Transport]) -> Result<(), String> {
    let objects = cell_objects(config).map_err(|error| error.to_string())?;
    let arm = arm_model(config, DhParameters::UR5E, config.base_from_table);
    for Transport { object: id, from, to } in task {
        let Some(object) = objects.iter().find(|object| object.id == *id) else { continue };
        let task = object.pick_n_place(*from, *to);
        let cycle = cycle_parameters(config);
        let table = cycle.tabletop(Vec::new());
        plan(&arm, &config.park_pose, &task, &cycle, &table)
            .map_err(|fault| format!("object {id} cannot be carried to its goal: {fault}"))?;
    }
    Ok(())
}

/// How long the arm rests before a picture: the configured time, or the least of a real or simulated arm.
fn settle(config: &CellConfig) -> Duration {
    let least = if config.simulation.is_some() { SIMULATED_LEAST_REST } else { LEAST_REST };
    Duration::from_secs_f64(config.tolerances.settle_s).max(least)
}

/// The arm with the table at `base_from_table`: nominal for calibration, calibrated for work.
pub fn arm_model(config: &CellConfig, dh: DhParameters, base_from_table: Isometry3<f64>) -> ArmModel {
    let limits = &config.limits;
    ArmModel {
        kinematics: Kinematics::of(&dh),
        base_from_table,
        flange_from_tool: config.flange_from_tool,
        home: config.work_pose,
        limits: ArmLimits {
            joint_range: limits.joint_range,
            joint_speed: limits.joint_speed,
            joint_acceleration: limits.joint_acceleration,
            tool_speed: limits.tool_speed,
            tool_acceleration: limits.tool_acceleration,
        },
        blend_speed: BlendSpeed::Unknown,
        bodies: bodies(config, &dh, base_from_table),
    }
}

/// Arm, gripper, camera, table and equipment as bodies.
fn bodies(config: &CellConfig, dh: &DhParameters, base_from_table: Isometry3<f64>) -> Bodies {
    let gripper = GripperBody {
        outline: config.gripper.body_polygon.clone(),
        above_lips: config.gripper.body_height_m,
        cups: config.gripper.cups.iter().map(|cup| ([cup.x_m, cup.y_m], cup.diameter_m / 2.0)).collect(),
    };
    let camera = match &config.camera {
        CameraMount::Flange { flange_from_camera } => Some(flange_from_camera),
        CameraMount::Fixed { .. } => None,
    };
    let Equipment { margin_m, cable_m, stand, fixed, tool } = config.equipment.clone();
    let mut cell = CellBodies::new(&gripper, &config.flange_from_tool, camera);
    (cell.margin_m, cell.cable_m, cell.stand, cell.equipment) = (margin_m, cable_m, stand, fixed);
    cell.tool.extend(tool);
    let surroundings = Surroundings {
        base_from_table,
        flange_from_tool: config.flange_from_tool,
        table: [config.workspace.width_m, config.workspace.height_m],
        link_floor: config.limits.link_floor_m,
        cell,
    };
    Bodies::new(dh, &surroundings)
}

/// The cups as the fit needs them.
pub fn cups(config: &CellConfig) -> Vec<Cup> {
    let cup =
        |cup: &cell_parts::gripper::CupConfig| Cup { x: cup.x_m, y: cup.y_m, radius: cup.diameter_m / 2.0 };
    config.gripper.cups.iter().map(cup).collect()
}

/// What the cell may move.
///
/// # Errors
/// What an object of the catalogue lacks, or why the gripper cannot carry it.
pub fn cell_objects(config: &CellConfig) -> Result<Vec<CellObject>, SetupError> {
    let movable = config.objects.iter().filter(|object| !object.fixed);
    movable.map(|object| cell_object(config, object)).collect()
}

fn cell_object(config: &CellConfig, object: &ObjectSpec) -> Result<CellObject, SetupError> {
    let lacks = |what| SetupError::Lacks { id: object.id.clone(), what };
    let grip = place_for_cups(&object.footprint, object.grippable.as_ref(), &cups(config), CUP_MARGIN_M);
    let grip: Grip = grip.ok_or_else(|| SetupError::NoGrip { id: object.id.clone() })?;
    let mass_kg = object.mass.ok_or_else(|| lacks("mass"))?;
    let (suction, off) = (suction(&config.gripper), off_centre(&object.footprint, &grip));
    let least = config.limits.tool_acceleration.min(LEAST_ACCELERATION);
    let (needed_n, held_n) = (suction.needed_n(mass_kg, off, least), suction.force_n);
    if held_n < needed_n {
        return Err(SetupError::TooHeavy { id: object.id.clone(), mass_kg, needed_n, held_n });
    }
    Ok(CellObject {
        id: object.id.clone(),
        group: object.group.clone(),
        footprint: object.footprint.clone(),
        impedance: object.impedance,
        height: object.height.ok_or_else(|| lacks("height"))?,
        mass: mass_kg,
        marker: object.marker.clone().ok_or_else(|| lacks("marker"))?,
        grip_point: grip.point,
        grip_yaw: grip.yaw,
        hold: suction.acceleration(mass_kg, off),
    })
}

fn grip_settings(config: &CellConfig) -> GripSettings {
    let has = |channel| config.gripper.cups.iter().any(|cup| cup.channel == channel);
    GripSettings {
        channels: match (has(CupChannel::A), has(CupChannel::B)) {
            (true, true) => Channels::Both,
            (false, true) => Channels::B,
            (true, false) | (false, false) => Channels::A,
        },
        vacuum_target: VACUUM_TARGET.max(config.gripper.vacuum_min),
        body_radius: config.gripper.body_polygon.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max),
        body_above_lips: config.gripper.body_height_m,
        tool_mass: config.gripper.mass_kg,
        tool_centre: Vector3::from(config.gripper.centre_of_gravity_m),
    }
}

/// The surveyed reference markers.
pub fn reference_markers(config: &CellConfig) -> Vec<ReferenceMarker> {
    let marker = |m: &cell_parts::reference::ReferenceMarkerConfig| ReferenceMarker {
        id: m.id,
        size: m.size_m,
        pose: m.pose,
    };
    config.reference_markers.iter().map(marker).collect()
}

/// Where a calibration starts, and what poses are proposed for.
pub fn drawn(config: &CellConfig) -> Drawn {
    Drawn {
        camera: config.camera,
        base_from_table: config.base_from_table,
        reference: reference_markers(config),
        table_m: [config.workspace.width_m, config.workspace.height_m],
        room: config.calibration_box,
    }
}

/// What perception looks for.
///
/// # Errors
/// What OpenCV says about the lens.
pub fn scene(config: &CellConfig, measured: &Measured) -> Result<Scene, HeightMapError> {
    let objects = config
        .objects
        .iter()
        .filter_map(|object| {
            let marker = object.marker.as_ref()?;
            Some(MarkedObject {
                id: object.id.clone(),
                marker_id: marker.id,
                marker_size: marker.size,
                height: object.height.unwrap_or(0.0),
                offset: marker.offset,
            })
        })
        .collect();
    let camera = measured.camera.clone();
    let foreign = match config.foreign {
        ForeignRule::Off => None,
        ForeignRule::Refuse { .. } | ForeignRule::Obstacle { .. } => {
            // Before a fixed camera the look poses keep the arm out of the picture; what of it is in there
            // is in the way.
            let own = match &measured.mount {
                Mount::Flange { flange_from_camera } => {
                    Some(flange_from_camera.inverse() * config.flange_from_tool)
                }
                Mount::Fixed { .. } => None,
            };
            Some(ForeignSearch::new(&camera, inventory(config, own), ForeignLimits::default())?)
        }
    };
    Ok(Scene { objects, ..movable_scene(config, camera, foreign) })
}

/// What perception looks for in a picture of the table alone: what can move; `foreign` where there is depth.
pub fn movable_scene(config: &CellConfig, camera: CameraModel, foreign: Option<ForeignSearch>) -> Scene {
    Scene {
        camera,
        objects: movable_objects(config),
        reference: reference_markers(config),
        limits: ObserveLimits::default(),
        foreign,
        drift: drift_limits(config),
    }
}

/// The objects that can move, by their markers.
pub fn movable_objects(config: &CellConfig) -> Vec<MarkedObject> {
    let movable = config.objects.iter().filter(|object| !object.fixed);
    let marked = movable.filter_map(|object| {
        let (marker, height) = (object.marker.as_ref()?, object.height?);
        Some(MarkedObject {
            id: object.id.clone(),
            marker_id: marker.id,
            marker_size: marker.size,
            height,
            offset: marker.offset,
        })
    });
    marked.collect()
}

/// The search with the mount as drawn: the gripper's own room is wide enough for that.
///
/// # Errors
/// What OpenCV says about the lens.
pub fn drawn_search(config: &CellConfig, lens: &CameraModel) -> Result<ForeignSearch, HeightMapError> {
    let own = match &config.camera {
        CameraMount::Flange { flange_from_camera } => {
            Some(flange_from_camera.inverse() * config.flange_from_tool)
        }
        CameraMount::Fixed { .. } => None,
    };
    ForeignSearch::new(lens, inventory(config, own), ForeignLimits::default())
}

/// From where on the camera counts as moved.
pub fn drift_limits(config: &CellConfig) -> DriftLimits {
    DriftLimits {
        residual_m: config.tolerances.reference_residual_m,
        shift_m: config.tolerances.reference_shift_m,
        turn_rad: config.tolerances.reference_turn_rad,
    }
}

/// What the table may carry, for the search for what it should not; `camera_from_tool` where the camera is
/// on the arm.
pub fn inventory(config: &CellConfig, camera_from_tool: Option<Isometry3<f64>>) -> Inventory {
    let (width, height) = (config.workspace.width_m, config.workspace.height_m);
    let marked = |object: &&ObjectSpec| object.marker.is_some();
    let body = |object: &ObjectSpec| {
        let (footprint, pose) = (object.footprint.clone(), object.start?);
        Some(KnownBody { footprint, pose, height_m: object.height? })
    };
    Inventory {
        area: Area::around(width, height, SEARCH_MARGIN_M),
        objects: config
            .objects
            .iter()
            .filter(marked)
            .map(|object| CatalogueObject {
                id: object.id.clone(),
                footprint: object.footprint.clone(),
                height_m: object.height.unwrap_or(0.0),
            })
            .collect(),
        fixed: config.objects.iter().filter(|object| object.fixed).filter_map(body).collect(),
        ignored: config.workspace.keep_out.clone(),
        own: camera_from_tool.map(|camera_from_tool| own_body(config, camera_from_tool)),
    }
}
