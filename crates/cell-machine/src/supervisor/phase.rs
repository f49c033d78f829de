//! What the cell is doing: the phases of the supervisor and what each of them carries.
//!
//! Plain data; the transitions are in the modules named after the phases.

use crate::device::gripper_types::Channels;
use crate::stillness::Stillness;
use crate::supervisor::back::{BackStage, Held};
use crate::supervisor::input::CameraFault;
use crate::supervisor::look_plan::LookPlan;
use crate::supervisor::look_plan::Stop;
use crate::supervisor::order::{JobOrder, RouteAction};
use cell_motion::path::CheckedPath;
use cell_motion::pick_n_place::PickNPlacePaths;
use cell_values::time::Timestamp;
use cell_values::units::Joints;
use cell_vision::observe::{Observation, View};
use cell_vision::region::Region;
use rearrange::geometry::pose::Pose2;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use ur_wire::enumerations::RobotMode;

/// What the cell is doing.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) enum Phase {
    /// Between two things.
    Ready,
    /// Powering the arm and starting the on-robot program.
    BringUp(BringUp),
    /// Going round the look poses.
    Look(Box<Look>),
    /// Waiting for the planner.
    Plan,
    /// Waiting for a person.
    Approve,
    /// One pick-n-place.
    Work(Box<Work>),
    /// Going to the park pose.
    Park,
    /// At a pose of a calibration round, or on the way.
    Visit(Visit),
    /// On a way back after a stop.
    Recover(BackStage),
}

/// Bring-up of the robot: which request is out, if any.
#[derive(Debug, Default, Deserialize, Serialize)]
pub(crate) struct BringUp {
    pub requested: Option<RobotMode>,
    pub program_requested: bool,
    /// How noisy the joints are at rest.
    pub rest: Stillness,
}

/// A look at the table.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Look {
    /// From where, in order.
    pub poses: Vec<Joints>,
    /// The present one.
    pub at: usize,
    /// What has to be seen; `None`: the whole table.
    pub region: Option<Region>,
    /// What need not be seen although it is in there: it will soon be too old.
    pub for_age: Vec<String>,
    pub stage: LookStage,
    /// What the pictures show that were searched.
    pub views: Vec<View>,
    /// Pictures that are being searched, oldest first, and whether they count.
    pub awaited: VecDeque<bool>,
    /// Where the frames that count were taken, oldest first.
    pub stops: Vec<Stop>,
    /// Why there is no picture from here yet.
    pub fault: Option<CameraFault>,
    /// Why the look ends at the next stop.
    pub failed: Option<CameraFault>,
    /// The cell was disarmed on the way: what was seen before proves nothing.
    pub void: bool,
    /// When the frames of the last pose were exposed.
    pub exposed: Option<Timestamp>,
    /// When it was known what all pictures show.
    pub known: Option<Timestamp>,
    /// The arm is on its way to the next object while the last picture is searched.
    pub ahead: Option<Ahead>,
}

/// A way to over the next object, on which the arm has set out before it is known to be where it was.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Ahead {
    /// To the waiting place there.
    pub path: CheckedPath,
    /// What the look showed, where the arm does not go on with it before it rests.
    pub shown: Option<Result<Box<Observation>, String>>,
}

/// How far a look is.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) enum LookStage {
    /// On the way to a look pose.
    Moving,
    /// Arrived, coming to rest.
    Settling { rest: Stillness },
    /// Frames are being taken with the arm at these joints.
    Capturing { q: Joints },
    /// All pictures are taken; what they show is being worked out.
    Observing,
}

/// One pose of a calibration round.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) enum Visit {
    /// On the way.
    Moving,
    /// Arrived, coming to rest.
    Settling { rest: Stillness },
    /// The picture is being taken.
    Picturing,
}

/// A pick-n-place under way.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Work {
    pub object: String,
    /// Where it was seen.
    pub from: Pose2,
    /// What hangs on the gripper once it has gripped.
    pub held: Held,
    pub paths: PickNPlacePaths,
    pub stage: WorkStage,
    /// The job counts it as carried out.
    pub over: bool,
    /// The next look, to whose first pose the arm goes on from the place without a stop.
    pub then: Option<LookPlan>,
}

/// How far a pick-n-place is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub(crate) enum WorkStage {
    /// Nothing has moved yet: it waits for its record, by the number.
    NotingIntent(u64),
    /// To the pick, in so many segments.
    Approaching {
        segments: usize,
    },
    Gripping,
    /// To the place, in so many segments.
    Carrying {
        segments: usize,
    },
    Releasing,
    Retreating,
    /// The grip failed: letting go.
    GivingUp,
    /// The grip failed: going up empty.
    Withdrawing,
}

/// A pick-n-place that was written down, or is on its way to the disk.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct Meant {
    /// Of the record.
    pub number: u64,
    pub on_disk: bool,
    /// Of the job.
    pub step: usize,
    pub action: RouteAction,
    pub tool_from_object: Option<Pose2>,
}

/// An armed cell in which nothing moves.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub(crate) struct Quiet {
    pub since: Timestamp,
    /// Where the arm has come to rest.
    pub at: Option<Joints>,
}

/// What comes once the arm is at rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub(crate) enum Then {
    /// The answer.
    Say,
    /// The vacuum goes off; the gripper has the answer.
    Release(Channels),
}

/// An order that waits for the arm to come to rest.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub(crate) struct UntilItStands {
    pub number: u64,
    pub since: Timestamp,
    pub then: Then,
}

/// The last sight of the whole table that nothing has disturbed since.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct Glance {
    pub seen: Observation,
    pub at: Timestamp,
}

/// How far the preview of a job is.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub(crate) enum Preview {
    /// The planner works on it.
    Requested,
    /// A person may look at it.
    Made(Vec<RouteAction>),
    /// It cannot be had.
    Never,
}

/// The job being carried out.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct JobRun {
    pub order: JobOrder,
    /// Its goals are known, and what it found is written down.
    pub settled: bool,
    /// What a person may look at before the cell is armed.
    pub preview: Option<Preview>,
    pub started: Timestamp,
    /// What remains to be done; `None` before planning or when the table disagreed.
    pub route: Option<Vec<RouteAction>>,
    pub approved: bool,
    /// A better plan than this has not been ruled out.
    pub improvable: bool,
    /// What the planner works on while the arm moves.
    pub improving: Option<Improving>,
    pub moves: usize,
    pub planned: Option<(usize, usize)>,
    pub lower_bound: Option<f64>,
    pub planning_seconds: f64,
    pub replans: u32,
    pub grip_failures: u32,
    pub look_failures: u32,
    /// Stops that it has outlived.
    pub stops: u32,
    /// Why what was seen could not be acted upon.
    pub rejection: Option<String>,
    /// What the last look showed in one picture and not in a later one that shows its place, and where.
    pub gone: Vec<(String, Pose2)>,
    /// It was said which objects of the catalogue are not seen.
    pub absent_reported: bool,
    pub last_seen: Vec<LastSeen>,
    pub cancel: bool,
}

/// A rest of the route that is planned again while the arm moves.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Improving {
    /// The number of the pick-n-place under way.
    pub step: usize,
    /// The table as it will be after that.
    pub expected: Observation,
}

/// Where the camera saw an object last.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct LastSeen {
    pub id: String,
    pub pose: Pose2,
    pub at: Timestamp,
    /// It was gripped since: it is not there any more.
    pub moved: bool,
}

/// A part of a pick-n-place, for people.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum WorkStep {
    /// The intent is on its way to the journal.
    AboutToMove,
    /// On the way to the object.
    Approaching,
    /// The cups are on it.
    Gripping,
    /// On the way to its place.
    Carrying,
    /// The vacuum goes.
    Releasing,
    /// Away from the place.
    Retreating,
    /// The grip failed.
    GivingUp,
}

impl WorkStep {
    /// In words that the object's name follows.
    pub fn as_str(self) -> &'static str {
        match self {
            WorkStep::AboutToMove => "about to move",
            WorkStep::Approaching => "approaching",
            WorkStep::Gripping => "gripping",
            WorkStep::Carrying => "carrying",
            WorkStep::Releasing => "releasing",
            WorkStep::Retreating => "retreating from",
            WorkStep::GivingUp => "giving up",
        }
    }
}

impl WorkStage {
    /// For people.
    pub fn step(self) -> WorkStep {
        match self {
            WorkStage::NotingIntent(_) => WorkStep::AboutToMove,
            WorkStage::Approaching { .. } => WorkStep::Approaching,
            WorkStage::Gripping => WorkStep::Gripping,
            WorkStage::Carrying { .. } => WorkStep::Carrying,
            WorkStage::Releasing => WorkStep::Releasing,
            WorkStage::Retreating => WorkStep::Retreating,
            WorkStage::GivingUp | WorkStage::Withdrawing => WorkStep::GivingUp,
        }
    }

    pub fn follows_a_path(self) -> bool {
        match self {
            WorkStage::Approaching { .. }
            | WorkStage::Carrying { .. }
            | WorkStage::Retreating
            | WorkStage::Withdrawing => true,
            WorkStage::NotingIntent(_) | WorkStage::Gripping | WorkStage::Releasing | WorkStage::GivingUp => {
                false
            }
        }
    }
}
