//! The simulator's configuration after all checks: what is on the table, and how far the truth is off.
//!
//! In: nothing; `config::read_sim` builds it from YAML, the demo from an instance. Out: the numbers from
//! which `celld sim` builds its world. The nominal values are those the cell's own configuration states; the
//! `errors` say how far, by seed, the simulated truth deviates from them.

pub mod blend;
pub mod compute_box;
pub mod conveyors;
pub mod gripper;
pub mod load;
pub mod programs;
pub mod read;
pub mod rest;
pub mod safety;
pub mod software;

use crate::box_clients::BoxConfig;
use crate::config::conveyors::ConveyorConfig;
use crate::controller::modes::Control;
use crate::controller::program_files::ProgramFiles;
use crate::motion::rest::RestConfig;
use crate::motion::rounding::EntrySpeed;
use crate::motion::safety::SafetyLimits;
use crate::world::drive::Drive;
use cell_parts::grid::MarkerGrid;
use cell_parts::gripper::GripperConfig;
use cell_parts::reference::ReferenceMarkerConfig;
use cell_values::units::Joints;
use nalgebra::Isometry3;
use rearrange::geometry::pose::Pose2;
use rearrange::tabletop::instance::ObjectSpec;
use ur_arm::kinematics::ArmModel;

/// One simulated cell, as `celld sim` needs it.
#[derive(Clone, Debug)]
pub struct SimFile {
    /// Address on which all servers listen.
    pub bind: String,
    /// Ports that are not the controller's own.
    pub ports: SimPorts,
    /// Seed of every deviation and of all noise.
    pub seed: u64,
    /// How much faster than real time the simulation runs.
    pub time_factor: f64,
    /// Table extent along x, m.
    pub width_m: f64,
    /// Table extent along y, m.
    pub height_m: f64,
    /// Nominal pose of the table in the base frame.
    pub base_from_table: Isometry3<f64>,
    /// Nominal pose of the tool.
    pub flange_from_tool: Isometry3<f64>,
    /// Nominal place of the camera.
    pub camera: SimMount,
    /// A calibration board on the hand.
    pub hand_board: Option<SimHandBoard>,
    /// Cups, body and mass.
    pub gripper: GripperConfig,
    /// What makes the gripper grip.
    pub drive: Drive,
    /// Objects with their start poses.
    pub objects: Vec<ObjectSpec>,
    /// Markers fixed to the table.
    pub reference_markers: Vec<ReferenceMarkerConfig>,
    /// Which arm.
    pub model: ArmModel,
    /// Software of the controller: major, minor, bug fix, build; PolyScope X from 10 on.
    pub software: [u32; 4],
    /// Ticks a second that come from the wires of the two encoders.
    pub encoders: [f64; 2],
    /// Belts in the table.
    pub conveyors: Vec<ConveyorConfig>,
    /// From where the arm is commanded at the start.
    pub control: Control,
    /// Safety configuration of the controller.
    pub safety: SafetyLimits,
    /// At which speed the arm passes blends.
    pub entry_speed: EntrySpeed,
    /// How its joints come to rest.
    pub rest: RestConfig,
    /// What the installation says of the tool.
    pub installation: Installation,
    /// How the gripper's box treats its clients.
    pub compute_box: BoxConfig,
    /// Joint pose at power-on.
    pub start_pose: Joints,
    /// Folder with the scripts that the dashboard loads, relative to the file's own; absent: none.
    pub program_folder: Option<String>,
    /// What the dashboard loads; the code that opens files adds the scripts of the folder.
    pub programs: ProgramFiles,
    /// How far the truth is off.
    pub errors: SimErrors,
}

/// Payload and tool centre point of the installation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Installation {
    /// Nothing on the flange.
    Bare,
    /// The gripper.
    Gripper,
}

/// Where the simulated camera sits, nominal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SimMount {
    /// On the flange: `flange_from_camera`.
    Flange(Isometry3<f64>),
    /// On a stand: `base_from_camera`.
    Fixed(Isometry3<f64>),
}

/// What the hand carries before a camera on a stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimHandBoard {
    /// What is printed on it.
    pub board: MarkerGrid,
    /// The board's frame (lower left corner of the lower left marker, z out of the print) in the flange
    /// frame.
    pub flange_from_board: Isometry3<f64>,
}

/// Ports of the simulated gripper, camera and control server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SimPorts {
    /// Modbus TCP.
    pub modbus: u16,
    /// HTTP camera.
    pub camera: u16,
    /// HTTP control, with `--control` only.
    pub control: u16,
    /// The controller's own Modbus server; absent: it is not started.
    pub controller_modbus: Option<u16>,
    /// The Robot API of PolyScope X, which other software does not have.
    pub robot_api: u16,
    /// The socket of a Robotiq gripper's URCap, which other grippers do not have.
    pub robotiq: u16,
}

/// Standard deviations and bounds of what the simulated truth deviates by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimErrors {
    /// Grip and release, standard deviation along x and y, m.
    pub placement_m: f64,
    /// Grip and release, standard deviation of the angle, rad.
    pub placement_rad: f64,
    /// Table pose, largest shift along x and y, m; half of it along z.
    pub table_m: f64,
    /// Table pose, largest turn about z, rad; a sixth of it about x and y.
    pub table_rad: f64,
    /// Camera mount, largest shift along each axis, m.
    pub mount_m: f64,
    /// Camera mount, largest turn about each axis, rad.
    pub mount_rad: f64,
    /// Calibrated DH lengths, standard deviation, m.
    pub dh_m: f64,
    /// Calibrated DH angles, standard deviation, rad.
    pub dh_rad: f64,
    /// Picture noise, standard deviation in grey levels (0 to 255).
    pub noise_levels: f64,
}

impl SimFile {
    /// Pose of an object at the beginning, if the file gives it.
    pub fn start_of(&self, id: &str) -> Option<Pose2> {
        self.objects.iter().find(|object| object.id == id).and_then(|object| object.start)
    }
}
