//! What goes into the machine and what comes out of it.
//!
//! Every event carries what happened and nothing of how it was learned; every effect names what is to be
//! done and never how. Answers carry the number of the effect that they answer, so that one that comes too
//! late is known as such.

use crate::device::gripper_types::{ModbusFailure, ModbusRequest};
use crate::device::robot_types::{Link, RobotIdentity};
use crate::intake::{Origin, Unreachable};
use crate::orders::{Order, Reply};
use crate::supervisor::input::{CameraFault, Notice, PlanAnswer, PlanRequest, Record};
use crate::supervisor::mode::EndFault;
use crate::supervisor::model::CellModel;
use crate::supervisor::order::{JobOrder, JobReport, RouteAction};
use crate::supervisor::round::{RoundFault, RoundOrder};
use crate::supervisor::status::Status;
use cell_values::time::Duration;
use cell_vision::foreign::HeldBody;
use cell_vision::observe::{Observation, PartialLook, View};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use ur_arm::kinematics::DhParameters;

/// Something happened.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Event {
    /// Time went by; everything else that has happened by now was handed over before.
    Time,
    /// The connection that [`Effect::Connect`] requested is established.
    Connected(Link),
    /// It could not be made, or the peer or the network ended it. Not reported after [`Effect::Close`].
    Disconnected(Link, String),
    /// Bytes came in.
    Received(Link, #[serde(with = "serde_bytes")] Vec<u8>),
    /// The answer to [`Effect::Registers`]: the words of a read, nothing for a write.
    Registers(Result<Vec<u16>, ModbusFailure>),
    /// To [`Effect::Look`], first: its frames are exposed, and the camera may be moved.
    Exposed(u64),
    /// To [`Effect::Look`].
    Looked(u64, Result<Vec<View>, CameraFault>),
    /// To [`Effect::Observe`].
    Observed(u64, Result<Box<Observation>, String>),
    /// To [`Effect::Picture`].
    Pictured(u64, Result<(), CameraFault>),
    /// To [`Effect::Plan`].
    Planned(u64, Box<PlanAnswer>),
    /// To [`Effect::Commit`]: the record is on disk, or why not.
    Committed(u64, Result<(), String>),
    /// Nothing can be written any more.
    StoreLost(EndFault),
    /// Calibration and configuration, once the arm is known: from now on there is a cell.
    Commission {
        /// The cell.
        model: Box<CellModel>,
        /// Arm it without a person: simulated cells only, as the configuration checks.
        arm: bool,
    },
    /// A job was claimed, as [`Effect::WantJob`] requested.
    Job(Box<JobOrder>),
    /// A calibration round is to be carried out.
    Round(Box<RoundOrder>),
    /// An operator's order; its answer is [`Effect::Reply`] with this number.
    Order(u64, Order, Origin),
    /// Orders do not reach the cell, or do again.
    OrdersReach(Option<Unreachable>),
    /// The loop did not come round for so long: the process was stopped, or the computer was overloaded.
    HeldUp(Duration),
    /// The daemon is to end.
    Shutdown,
}

/// Something is to be done.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Effect {
    /// Make this connection.
    Connect(Link),
    /// Drop it, or the attempt.
    Close(Link),
    /// Send these bytes.
    Send(Link, #[serde(with = "serde_bytes")] Vec<u8>),
    /// One register transaction with the gripper; the next follows its answer.
    Registers(ModbusRequest),
    /// Take pictures from one look pose and find the markers.
    Look {
        /// For the answer.
        number: u64,
        /// How many frames.
        frames: usize,
        /// Where the camera is.
        table_from_camera: Isometry3<f64>,
    },
    /// Put the views of a look together.
    Observe {
        /// For the answer.
        number: u64,
        /// All of the look.
        views: Vec<View>,
        /// What it had to show, and what is remembered of the rest; `None`: the whole table.
        partial: Option<PartialLook>,
        /// What hangs on the gripper and is meant to.
        held: Option<HeldBody>,
    },
    /// Take one picture of a calibration round and keep what it shows.
    Picture {
        /// For the answer.
        number: u64,
        /// The pose, from 1.
        pose: usize,
        /// Where the flange is.
        base_from_flange: Isometry3<f64>,
    },
    /// Make a plan.
    Plan {
        /// For the answer.
        number: u64,
        /// The problem and its budget.
        request: Box<PlanRequest>,
    },
    /// The plan is not awaited any more.
    CancelPlan,
    /// Write this down.
    Commit {
        /// For the answer.
        number: u64,
        /// What.
        record: Record,
    },
    /// Answer an order.
    Reply {
        /// Of the order.
        number: u64,
        /// What was decided.
        reply: Reply,
    },
    /// The cell is free for a job: one is to be claimed as soon as one is ready.
    WantJob,
    /// For people and records.
    Notify(News),
    /// The calibration round is over.
    RoundOver(Result<(), RoundFault>),
    /// The daemon ends, with this fault if it was not ordered to.
    End(Result<(), EndFault>),
}

/// What is reported to people and records.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub enum News {
    /// The controller has said which arm it moves: time to commission the cell.
    Identified(Box<Arm>),
    /// A sentence.
    Notice(Notice),
    /// The status changed.
    Status(Box<Status>),
    /// A new route.
    Route(Vec<RouteAction>),
    /// A job ended; its report is on its way to the disk.
    Ended(Box<JobReport>),
}

/// Which arm it is, as the controller says.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct Arm {
    /// Calibrated kinematics.
    pub dh: DhParameters,
    /// Checksum of the kinematics, hex.
    pub checksum: String,
    /// Serial number.
    pub serial: String,
    /// Software version, as the dashboard reports it.
    #[serde(default)]
    pub software: String,
}

impl Arm {
    /// From what the dashboard reports and the primary interface sends.
    pub fn new(robot: &RobotIdentity, dh: DhParameters, checksum: &str) -> Arm {
        let (serial, software) = (robot.serial.clone(), robot.version.clone());
        Arm { dh, checksum: checksum.to_string(), serial, software }
    }
}
