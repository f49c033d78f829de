//! The cell's configuration after all checks: plain structs, SI, radians, absolute paths.
//!
//! In: nothing; `config::read_cell` builds these from YAML, the demo builds them from an instance. Out: the
//! numbers from which the daemon makes the small parameter structs of vision, motion, device and supervisor.
//! No field that is measured, and no speed or acceleration, has a `Default`: an unmeasured cell must not
//! start.

use crate::config::bodies::Equipment;
pub use crate::config::camera::CameraDevice;
use crate::config::fleet::FleetConfig;
use crate::config::page::PageConfig;
use crate::jobs::goal::GoalContext;
use crate::jobs::journal::old::HistoryLimits;
use cell_calibration::drawn::CameraMount;
use cell_machine::orders::Approval;
use cell_machine::supervisor::model::ForeignRule;
use cell_machine::supervisor::round::RoundOrder;
use cell_motion::slow::CalibrationBox;
use cell_parts::gripper::GripperConfig;
use cell_parts::reference::ReferenceMarkerConfig;
use cell_values::image::quality::PictureLimits;
use cell_values::units::Joints;
use cell_vision::observe::ObserveLimits;
use nalgebra::Isometry3;
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;
use rearrange::tabletop::instance::{KeepOut, ObjectSpec};
use std::path::PathBuf;

/// One robot cell, as `celld run` needs it.
#[derive(Clone, Debug)]
pub struct CellConfig {
    /// Where the devices are.
    pub devices: Devices,
    /// Size and obstacles of the table.
    pub workspace: WorkspaceConfig,
    /// Everything that may lie on the table: height, mass and marker present, `goal` absent, `start` only
    /// for fixed objects.
    pub objects: Vec<ObjectSpec>,
    /// Markers fixed to the table, in the table frame.
    pub reference_markers: Vec<ReferenceMarkerConfig>,
    /// Cups, body and vacuum of the gripper, in the tool frame.
    pub gripper: GripperConfig,
    /// From tool (centre of the cup lips, z out of the gripper) to flange.
    pub flange_from_tool: Isometry3<f64>,
    /// Nominal pose of the table frame in the robot's base frame; the calibration starts from it.
    pub base_from_table: Isometry3<f64>,
    /// Where the camera sits, nominally.
    pub camera: CameraMount,
    /// Taught joint poses that together see the whole workspace.
    pub look_poses: Vec<Joints>,
    /// Taught joint pose in which the arm waits.
    pub park_pose: Joints,
    /// Taught joint pose over the table: work is done in its posture (shoulder, elbow and wrist side).
    pub work_pose: Joints,
    /// Taught joint poses for `celld calibrate`.
    pub calibration_poses: Vec<Joints>,
    /// Where the flange stays while calibrating; poses are proposed in it.
    pub calibration_box: Option<CalibrationBox>,
    /// Files that `celld calibrate` writes and `celld run` reads.
    pub calibration: CalibrationFiles,
    /// What the arm may do at most.
    pub limits: MotionLimits,
    /// When something counts as where it should be, and as recent.
    pub tolerances: Tolerances,
    /// How plans are made.
    pub planner: PlannerConfig,
    /// Least approval a job needs.
    pub approval: Approval,
    /// Armed from the start; only accepted together with `simulation`.
    pub arm_at_start: bool,
    /// Arming lapses after this long without motion, s.
    pub arm_lapse_s: f64,
    /// Present only when every device is simulated.
    pub simulation: Option<SimulationConfig>,
    /// Present when runs are recorded.
    pub recording: Option<RecordingConfig>,
    /// How much of the history is kept.
    pub history: HistoryLimits,
    /// Folder against which relative `goal.file` paths of jobs resolve.
    pub goal_folder: PathBuf,
    /// Markers in view that belong to nothing on the table.
    pub ignore_markers: Vec<u32>,
    /// What is done about things on the table that carry no marker.
    pub foreign: ForeignRule,
    /// What stands round the arm and hangs on it.
    pub equipment: Equipment,
    /// Present when the daemon serves a page.
    pub page: Option<PageConfig>,
    /// Present when the cell is part of a fleet.
    pub fleet: Option<FleetConfig>,
}

impl CellConfig {
    /// The round that a person orders at the page: the taught poses.
    pub fn calibration_round(&self) -> RoundOrder {
        RoundOrder::pictures(self.calibration_poses.clone(), self.calibration_box)
    }

    /// Overlap that the goals of a job may have, m: three standard deviations of where the camera finds an
    /// object, for goals may have been measured. Goals typed by hand that overlap by more are a mistake. It
    /// does not grow with `tolerances.goal_position_m`, which says how near is near enough.
    pub fn goal_overlap_tolerance_m() -> f64 {
        3.0 * ObserveLimits::default().systematic_xy_m
    }

    /// What the goals of jobs are checked against; `obstacles` are [`CellConfig::obstacles`].
    pub fn goal_context<'a>(&'a self, obstacles: &'a [KeepOut]) -> GoalContext<'a> {
        GoalContext {
            objects: &self.objects,
            width_m: self.workspace.width_m,
            height_m: self.workspace.height_m,
            clearance_m: self.workspace.clearance_m,
            keep_out: obstacles,
            overlap_tolerance_m: CellConfig::goal_overlap_tolerance_m(),
        }
    }

    /// Where nothing may be put: the keep-out regions, and fixed objects where they are.
    pub fn obstacles(&self) -> Vec<KeepOut> {
        let fixed =
            self.objects.iter().filter(|object| object.fixed).filter_map(|object| {
                Some(KeepOut { footprint: object.footprint.clone(), pose: object.start? })
            });
        self.workspace.keep_out.iter().cloned().chain(fixed).collect()
    }
}

/// Device addresses. The robot's ports are the controller's own and not configurable.
#[derive(Clone, Debug, PartialEq)]
pub struct Devices {
    /// Host name or address of the UR controller.
    pub robot_host: String,
    /// Host name or address of the gripper's compute box.
    pub gripper_host: String,
    /// Modbus TCP port of the compute box (502 on the real one).
    pub gripper_port: u16,
    /// Modbus unit that the gripper answers to: 65 alone on the wrist, 66 or 67 on a dual quick changer.
    pub gripper_unit: u8,
    /// The camera.
    pub camera: CameraDevice,
    /// When a picture of it is of no use.
    pub picture_limits: PictureLimits,
}

/// The table.
#[derive(Clone, Debug)]
pub struct WorkspaceConfig {
    /// Extent along x, m.
    pub width_m: f64,
    /// Extent along y, m.
    pub height_m: f64,
    /// Least distance between objects at every new place, m.
    pub clearance_m: f64,
    /// Places that stay free.
    pub keep_out: Vec<KeepOut>,
}

/// Paths of the calibration files, absolute.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CalibrationFiles {
    /// Intrinsics and distortion of one camera, by serial number.
    pub camera: PathBuf,
    /// Camera on flange (or on base) with residuals.
    pub hand_eye: PathBuf,
    /// Table in base with residuals.
    pub table: PathBuf,
    /// Folder with pictures of the empty table, for cameras without depth.
    pub empty: Option<PathBuf>,
    /// How this arm passes corners that are cut; the arm's joints are in the .csv beside it.
    pub blends: PathBuf,
}

/// What the arm may do at most, and the heights of a pick-n-place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionLimits {
    /// Lowest and highest position of each joint, rad.
    pub joint_range: [(f64, f64); 6],
    /// rad/s, every joint.
    pub joint_speed: f64,
    /// rad/s2, every joint.
    pub joint_acceleration: f64,
    /// m/s at the tool, on the straight parts.
    pub tool_speed: f64,
    /// m/s2 at the tool, on the straight parts.
    pub tool_acceleration: f64,
    /// Lowest height of elbow and wrist over the table, m.
    pub link_floor_m: f64,
    /// Air kept between what is carried and what is on the table, m.
    pub lift_height_m: f64,
    /// How far over the object the slow, straight part of approach and retreat begins, m.
    pub approach_height_m: f64,
    /// How far the cups are pressed below the nominal top so that they seal, m.
    pub press_m: f64,
    /// Blend radius between segments, m.
    pub blend_m: f64,
}

/// When something counts as where it should be, and as recent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerances {
    /// m.
    pub goal_position_m: f64,
    /// rad.
    pub goal_angle_rad: f64,
    /// What was seen longer ago is not acted upon, s.
    pub observation_age_s: f64,
    /// The whole table is looked at again after so many pick-n-places.
    pub full_look_every: u32,
    /// How often a failed grip, an incomplete look or a disturbed table is tried again.
    pub retries: u32,
    /// How often a job outlives a lost object or a missed heartbeat.
    pub stop_retries: u32,
    /// How long the arm is at rest before a picture is taken, s; shorter than the least counts as that.
    pub settle_s: f64,
    /// Largest mean residual of the reference markers in a look, m.
    pub reference_residual_m: f64,
    /// Shift or lift of the camera, shown by the reference markers from one look pose, that stops motion, m.
    pub reference_shift_m: f64,
    /// Turn of it, rad.
    pub reference_turn_rad: f64,
}

/// How plans are made.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannerConfig {
    /// For jobs that do not say.
    pub solver: SolverKind,
    /// For jobs that do not say.
    pub objective: Objective,
    /// Planning budget, s.
    pub time_limit_s: f64,
    /// For jobs that do not say.
    pub seed: u64,
}

/// Only for cells whose devices are all simulated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulationConfig {
    /// How much faster than real time the daemon's clock runs; the simulator's factor.
    pub clock_factor: f64,
}

/// How pictures are recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordedPictures {
    /// Not at all.
    Off,
    /// As JPEG: small, good for the eye.
    Jpeg,
    /// As PNG, pixel by pixel: the detector finds in them what it found.
    Lossless,
}

/// Where runs are recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordingConfig {
    /// Folder for the MCAP files, absolute.
    pub folder: PathBuf,
    /// Pictures too, not only numbers.
    pub pictures: RecordedPictures,
    /// What a replay needs: everything that the cell takes in and decides.
    pub decisions: bool,
    /// What all recordings together may take; the oldest go first.
    pub budget_bytes: u64,
    /// What is left free on their disk.
    pub reserve_bytes: u64,
}
