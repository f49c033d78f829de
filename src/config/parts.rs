//! A cell's configuration while it is read: every part by itself, absent where it could not be read.
//!
//! In: what the decoders of `read_cell` found. Out: [`CellConfig`] when nothing is missing. The checks
//! across parts run on this, so that a wrong unit in one place does not hide a marker used twice in another.
//! Pure.

use crate::config::bodies::Equipment;
use crate::config::cell::{
    CalibrationFiles, CellConfig, Devices, MotionLimits, PlannerConfig, RecordingConfig, SimulationConfig,
    Tolerances, WorkspaceConfig,
};
use crate::config::fleet::FleetConfig;
use crate::config::page::PageConfig;
use crate::jobs::journal::old::HistoryLimits;
use cell_calibration::drawn::CameraMount;
use cell_machine::orders::Approval;
use cell_machine::supervisor::model::ForeignRule;
use cell_motion::slow::CalibrationBox;
use cell_parts::gripper::GripperConfig;
use cell_parts::reference::ReferenceMarkerConfig;
use cell_values::units::Joints;
use nalgebra::Isometry3;
use rearrange::tabletop::instance::{KeepOut, ObjectSpec, Workspace};
use rearrange::tabletop::parse::MarkerUse;
use std::path::PathBuf;

/// What could be read. A list is there when the key holds one; its entries are there when they are sound.
pub(super) struct CellParts {
    pub devices: Option<Devices>,
    pub table: TableParts,
    pub objects: Option<Vec<Option<ObjectSpec>>>,
    /// Marker numbers of all objects, sound or not.
    pub object_markers: Vec<MarkerUse>,
    pub reference_markers: Option<Vec<ReferenceMarkerConfig>>,
    pub gripper: Option<GripperConfig>,
    pub flange_from_tool: Option<Isometry3<f64>>,
    pub base_from_table: Option<Isometry3<f64>>,
    pub camera: Option<CameraMount>,
    pub look_poses: Option<Vec<Option<Joints>>>,
    pub park_pose: Option<Joints>,
    pub work_pose: Option<Joints>,
    pub calibration_poses: Option<Vec<Option<Joints>>>,
    /// `Some(None)` when the key is absent.
    pub calibration_box: Option<Option<CalibrationBox>>,
    pub calibration: Option<CalibrationFiles>,
    /// Also there when another limit is wrong.
    pub joint_range: Option<[(f64, f64); 6]>,
    pub limits: Option<MotionLimits>,
    pub tolerances: Option<Tolerances>,
    pub planner: Option<PlannerConfig>,
    pub approval: Option<Approval>,
    pub arm_at_start: Option<bool>,
    pub arm_lapse_s: Option<f64>,
    /// `Some(None)` when the key is absent.
    pub simulation: Option<Option<SimulationConfig>>,
    pub recording: Option<Option<RecordingConfig>>,
    pub history: Option<HistoryLimits>,
    pub goal_folder: Option<PathBuf>,
    pub ignore_markers: Option<Vec<u32>>,
    pub foreign: Option<ForeignRule>,
    pub equipment: Option<Equipment>,
    /// `Some(None)` when the key is absent.
    pub page: Option<Option<PageConfig>>,
    /// `Some(None)` when the key is absent.
    pub fleet: Option<Option<FleetConfig>>,
}

/// The table's keys.
pub(super) struct TableParts {
    pub size: Option<Workspace>,
    pub clearance_m: Option<f64>,
    pub keep_out: Option<Vec<KeepOut>>,
}

impl CellParts {
    /// The configuration, if every part is there.
    pub fn whole(self) -> Option<CellConfig> {
        let size = self.table.size?;
        Some(CellConfig {
            devices: self.devices?,
            workspace: WorkspaceConfig {
                width_m: size.width,
                height_m: size.height,
                clearance_m: self.table.clearance_m?,
                keep_out: self.table.keep_out?,
            },
            objects: all(self.objects)?,
            reference_markers: self.reference_markers?,
            gripper: self.gripper?,
            flange_from_tool: self.flange_from_tool?,
            base_from_table: self.base_from_table?,
            camera: self.camera?,
            look_poses: all(self.look_poses)?,
            park_pose: self.park_pose?,
            work_pose: self.work_pose?,
            calibration_poses: all(self.calibration_poses)?,
            calibration_box: self.calibration_box?,
            calibration: self.calibration?,
            limits: self.limits?,
            tolerances: self.tolerances?,
            planner: self.planner?,
            approval: self.approval?,
            arm_at_start: self.arm_at_start?,
            arm_lapse_s: self.arm_lapse_s?,
            simulation: self.simulation?,
            recording: self.recording?,
            history: self.history?,
            goal_folder: self.goal_folder?,
            ignore_markers: self.ignore_markers?,
            foreign: self.foreign?,
            equipment: self.equipment?,
            page: self.page?,
            fleet: self.fleet?,
        })
    }
}

fn all<T>(list: Option<Vec<Option<T>>>) -> Option<Vec<T>> {
    list?.into_iter().collect()
}
