//! Faults on request: what can go wrong with the simulated cell, when, and for how long.
//!
//! In: a fault file or a posted text ([`read`]), the state of the world and of the arm in each frame. Out:
//! plans ([`Planned`]), the faults that are due ([`schedule`]), and their effect on controller, world,
//! pictures and connections ([`injector`], [`link`]). Reading and scheduling are pure; only the injector
//! and the links touch what is shared. Nothing happens unless a file or a post requests it. The table of
//! all faults is docs/faults.md.

pub mod camera;
pub mod injector;
pub mod link;
pub mod read;
pub mod schedule;

use crate::faults::link::LinkName;
use crate::world::spec::ForeignBody;
use crate::world::vacuum::Channel;
use nalgebra::{Isometry3, Vector3};
use rearrange::geometry::pose::Pose2;

/// A fault, when it comes and how long it stays.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned {
    /// When; absent: at once.
    pub at: Option<Trigger>,
    /// What.
    pub order: Order,
}

/// A fault to bring about.
#[derive(Clone, Debug, PartialEq)]
pub struct Order {
    /// Its name in fault files.
    pub name: &'static str,
    /// What it does.
    pub fault: Fault,
    /// Simulated seconds until it ends by itself; absent: it stays until it is cleared.
    pub seconds: Option<f64>,
}

/// When a fault is due.
#[derive(Clone, Debug, PartialEq)]
pub enum Trigger {
    /// Simulated seconds after the start.
    Time(f64),
    /// In a pick-n-place.
    Step {
        /// Which, counted from 1.
        step: u32,
        /// Which part of it.
        phase: Phase,
        /// Share of the arm's current move, 0 to 1.
        progress: f64,
    },
    /// When something happened in the world.
    Event {
        /// What.
        kind: DeviceEvent,
        /// To which object; absent: any.
        object: Option<String>,
        /// The how-manieth time, from 1.
        count: u32,
    },
}

/// Parts of a pick-n-place, in their order, as far as the world can distinguish them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Phase {
    /// Nothing is held, and the arm has left the last place.
    Approach,
    /// The pump runs; or the object is held and was not lifted yet.
    Grip,
    /// Held, over the place where it was gripped.
    Lift,
    /// Held, and moved sideways.
    Carry,
    /// Held, going down after a carry more than sideways.
    Place,
    /// Let go, over the place where it was.
    Retreat,
}

impl Phase {
    /// Names in fault files.
    pub const NAMES: [(&'static str, Phase); 6] = [
        ("approach", Phase::Approach),
        ("grip", Phase::Grip),
        ("lift", Phase::Lift),
        ("carry", Phase::Carry),
        ("place", Phase::Place),
        ("retreat", Phase::Retreat),
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        Phase::NAMES.iter().find(|(_, phase)| *phase == self).map_or("", |(name, _)| name)
    }
}

/// Events of the world that a fault can wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceEvent {
    /// The vacuum took hold of an object.
    Grip,
    /// An object was set down.
    Place,
    /// An object fell out of the gripper.
    Drop,
    /// An object left the table.
    Fall,
    /// A neighbour was moved.
    Push,
    /// An object came to lie on others.
    Tilt,
    /// The arm pressed on something.
    Contact,
}

impl DeviceEvent {
    /// Names in fault files.
    pub const NAMES: [(&'static str, DeviceEvent); 7] = [
        ("grip", DeviceEvent::Grip),
        ("place", DeviceEvent::Place),
        ("drop", DeviceEvent::Drop),
        ("fall", DeviceEvent::Fall),
        ("push", DeviceEvent::Push),
        ("tilt", DeviceEvent::Tilt),
        ("contact", DeviceEvent::Contact),
    ];
}

/// What can go wrong.
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    /// The controller or the arm.
    Robot(RobotFault),
    /// Air where none should be.
    Vacuum(VacuumFault),
    /// The camera or what it sees.
    Camera(CameraFault),
    /// A person moves an object that lies on the table, or leaves something there.
    World(WorldFault),
    /// A server's connections.
    Net {
        /// Which server; absent: all.
        link: Option<LinkName>,
        /// What is wrong with them.
        toxic: Toxic,
    },
    /// Ends a lasting fault, or all of them.
    Clear {
        /// Name of the fault.
        fault: Option<String>,
    },
}

/// Faults of the controller.
#[derive(Clone, Debug, PartialEq)]
pub enum RobotFault {
    /// The safety system stops the arm.
    ProtectiveStop,
    /// The emergency stop is pressed.
    EmergencyStop,
    /// The safeguard circuit is open.
    Safeguard,
    /// A safety mode with this number.
    SafetyMode(i32),
    /// A fault of the safety system.
    SafetyFault,
    /// The pendant is in local mode.
    Local,
    /// The arm's power is switched off at the pendant.
    PowerOff,
    /// A person holds the freedrive button and draws the tool up.
    Freedrive,
    /// The program is stopped from the pendant.
    KillProgram,
    /// A foreign program replaces ours, for so many seconds.
    ForeignScript(f64),
    /// The running program meets a runtime exception.
    ScriptError,
    /// Uploaded programs do not start.
    NeverStart,
    /// The program is paused from the pendant.
    Pause,
    /// The speed slider, 0 to 1.
    Slider(f64),
    /// The arm does not follow.
    Stall,
    /// Another client owns this RTDE input.
    Claim(String),
    /// The controller assumes another payload, kg.
    Payload(f64),
    /// RTDE comes at this rate whatever was agreed, Hz.
    Rate(f64),
    /// The controller says that it runs this software: major, minor, bug fix, build.
    Version([u32; 4]),
    /// The controller says that it is this robot.
    Model(String),
    /// Another safety configuration is applied, with this checksum.
    SafetyChecksum(u32),
    /// The controller boots anew.
    Reboot {
        /// It comes back with this serial number.
        serial: Option<String>,
        /// It comes back with the calibration of this seed.
        kinematics: Option<u64>,
    },
}

/// Faults of the vacuum; no channel means both.
#[derive(Clone, Debug, PartialEq)]
pub enum VacuumFault {
    /// All air enters.
    Drop(Option<Channel>),
    /// The pump reaches only `vacuum` (fraction), after `falls_s` seconds.
    Leak {
        /// Which channel.
        channel: Option<Channel>,
        /// The most it reaches.
        vacuum: f64,
        /// Time it takes to fall to that, s.
        falls_s: f64,
    },
    /// What is held stays on the cups without vacuum.
    Stick,
}

/// Faults of the camera.
#[derive(Clone, Debug, PartialEq)]
pub enum CameraFault {
    /// No answer.
    Off,
    /// The last frame again: picture, number and time.
    Freeze,
    /// The last picture again with a new number and time.
    Repeat,
    /// Light times this: below 1 dark, above over-exposed.
    Gain(f64),
    /// Further blur, standard deviation in px.
    Blur(f64),
    /// Share of the contrast that is lost to fog or dirt.
    Fog(f64),
    /// Half of this marker is covered.
    Occlude(u32),
    /// A further print on the table.
    Print(ExtraPrint),
    /// The mount is bumped: camera before from camera after.
    Extrinsics(Isometry3<f64>),
    /// The mount gives way: shift (m) and turn (rotation vector, rad) of each minute, in the camera's frame.
    Drift {
        /// m per minute.
        translation: Vector3<f64>,
        /// rad per minute.
        rotation: Vector3<f64>,
    },
}

/// A print that a person has put on the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExtraPrint {
    /// Number in the family tag36h11.
    pub marker: u32,
    /// Where: x, y in m and theta in rad, table frame.
    pub pose: Pose2,
    /// Edge of the black square, m; absent: as the print it repeats.
    pub size_m: Option<f64>,
}

/// Objects moved by hand, and things left on the table.
#[derive(Clone, Debug, PartialEq)]
pub enum WorldFault {
    /// By this in the table frame.
    Nudge {
        /// Which object.
        object: String,
        /// Shift and turn.
        by: Pose2,
    },
    /// To this pose on the table.
    Place {
        /// Which object.
        object: String,
        /// Where.
        pose: Pose2,
    },
    /// A thing without a marker is put on the table.
    Foreign(ForeignBody),
}

/// What is wrong with connections.
#[derive(Clone, Debug, PartialEq)]
pub enum Toxic {
    /// All are reset at once; new ones work.
    ResetPeer,
    /// Half-open: sockets stay, nothing passes.
    Timeout,
    /// What the simulator sends arrives so many seconds later.
    Latency(f64),
    /// What the simulator sends goes out in pieces of so many bytes.
    Slicer(usize),
    /// Every connection is reset before the simulator sends more bytes than this.
    LimitData(u64),
    /// The gripper answers every request with this Modbus exception.
    Exception(u8),
    /// The gripper's answers have the transaction number of another request.
    Transaction,
}

/// Why a fault could not be brought about.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultError {
    /// No object has that name.
    #[error("there is no object {0:?}")]
    NoSuchObject(String),
    /// The object is held, fallen or fixed.
    #[error("object {0:?} does not lie free on the table")]
    NotFree(String),
    /// No print in the cell has that number.
    #[error("no object and no place of the table has marker {0}")]
    NoSuchMarker(u32),
    /// There is no program to act on.
    #[error("no program runs")]
    NoProgram,
    /// The safety system is in a state that rules it out.
    #[error("the controller is not in a state in which this can happen")]
    NotNow,
}

impl Fault {
    /// True when it goes on until it ends or is cleared.
    pub fn lasts(&self) -> bool {
        match self {
            Fault::Robot(robot) => !matches!(
                robot,
                RobotFault::ProtectiveStop
                    | RobotFault::SafetyFault
                    | RobotFault::KillProgram
                    | RobotFault::ForeignScript(_)
                    | RobotFault::ScriptError
                    | RobotFault::Payload(_)
            ),
            Fault::Vacuum(_) | Fault::Camera(_) => true,
            Fault::Net { toxic, .. } => *toxic != Toxic::ResetPeer,
            Fault::World(world) => matches!(world, WorldFault::Foreign(_)),
            Fault::Clear { .. } => false,
        }
    }
}

#[cfg(test)]
mod tests;
