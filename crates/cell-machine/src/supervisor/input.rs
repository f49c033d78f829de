//! What goes into the supervisor, and what it requests.

use crate::code::Code;
use crate::device::gripper_types::{GripperCommand, GripperEvent, GripperFault, Identity};
use crate::device::robot_types::{Link, RobotCommand, RobotEvent, RobotState};
use crate::intake::Unreachable;
use crate::orders::{Order, Reply};
use crate::plan_check::{OutOfReach, PlanLimits};
use crate::supervisor::mode::EndFault;
use crate::supervisor::order::{JobOrder, JobReport, RouteAction};
use crate::supervisor::round::{RoundFault, RoundOrder};
use cell_motion::cycle_time::CycleTimes;
use cell_values::time::Duration;
use cell_vision::foreign::HeldBody;
use cell_vision::observe::{Observation, PartialLook, View};
use nalgebra::Isometry3;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::{Action as PlanAction, ActionKind, Objective};
use rearrange::planning::solver::SolverKind;
use rearrange::tabletop::instance::Instance;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// What the devices last said, handed over with every call.
#[derive(Clone, Copy, Debug)]
pub struct DeviceSnapshot<'a> {
    /// The first connection to the controller that is down.
    pub link_down: Option<Link>,
    /// The first connection to the controller that is down and that celld has not dropped by itself to make
    /// it anew.
    pub link_lost: Option<Link>,
    /// All of them are.
    pub all_links_lost: bool,
    /// Last state of the robot, if it ever spoke.
    pub robot: Option<&'a RobotState>,
    /// The robot's last state is younger than the staleness limit.
    pub robot_fresh: bool,
    /// No program is being started, stopped or ended, so that a new one may be started.
    pub program_settled: bool,
    /// Neither power nor brakes that a stop took back may still come on.
    pub arm_settled: bool,
    /// The vacuum holds an object, and the gripper's session watches it.
    pub gripper_holds: bool,
    /// The gripper answered within its deadline.
    pub gripper_answers: bool,
    /// Why it does not answer, if it does not.
    pub gripper_fault: GripperFault,
    /// Which gripper it is, once it has said so.
    pub gripper_identity: Option<Identity>,
    /// Vacuum of the channels (fraction), if it was read lately.
    pub vacuum: Option<[f64; 2]>,
}

/// Why a camera gives no picture, after everything that can be tried from here.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct CameraFault {
    /// For the job's result.
    pub code: Code,
    /// What is wrong.
    pub message: String,
    /// What a person can do.
    pub hint: Cow<'static, str>,
    /// Waiting does not help: another camera, another size, a recording at its end.
    pub lasting: bool,
}

/// What a plan request came to.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub enum PlanAnswer {
    /// A plan that passed the independent checker.
    Found {
        /// Its actions; objects are indices into the request's instance.
        actions: Vec<PlanAction>,
        /// Its cost in the objective requested.
        cost: f64,
        /// Lower bound in the same objective.
        lower_bound: f64,
        /// Seconds of planning.
        seconds: f64,
    },
    /// There is none, proved.
    Infeasible(String),
    /// None was found in time.
    Timeout,
    /// The request itself was at fault (a start that overlaps, for example).
    Refused(String),
    /// The solver does not do such problems.
    Unsolvable(String),
    /// The arm cannot move an object from or to where it has to.
    OutOfReach(Box<OutOfReach>),
    /// The planner itself failed, in the words of its panic.
    Failed(String),
}

/// What happened.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub enum Input {
    /// Time has passed.
    Tick,
    /// The robot session reports.
    Robot(RobotEvent),
    /// The gripper session reports.
    Gripper(GripperEvent),
    /// The frames of one look pose are exposed: the arm may go on.
    Exposed,
    /// They were searched for markers.
    Captured(Result<Vec<View>, CameraFault>),
    /// The views of a look were put together.
    Observed(Result<Box<Observation>, String>),
    /// The planner answered.
    Planned(Box<PlanAnswer>),
    /// One picture of a calibration round was taken.
    Pictured(Result<(), CameraFault>),
    /// The record with this number is on disk, or could not be written.
    Committed {
        /// Of [`Action::Commit`].
        number: u64,
        /// The cause of a failure.
        result: Result<(), String>,
    },
    /// Nothing can be written any more.
    StoreLost(EndFault),
    /// A job was claimed.
    Job(Box<JobOrder>),
    /// A calibration round is to be carried out; the order is the operator's leave to move.
    Round(Box<RoundOrder>),
    /// An operator's order.
    Order {
        /// Names it in [`Action::Reply`].
        number: u64,
        /// What is wanted.
        order: Order,
    },
    /// Orders do not reach the cell, or do again.
    OrdersReach(Option<Unreachable>),
    /// The loop did not come round for so long.
    HeldUp(Duration),
    /// The daemon is to end: stop the arm, leave the job in a named state.
    Shutdown,
}

/// A planning problem with the budget to solve it in.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct PlanRequest {
    /// Measured starts, wanted goals.
    pub instance: Instance,
    /// What to minimise.
    pub objective: Objective,
    /// How.
    pub solver: SolverKind,
    /// Seed.
    pub seed: u64,
    /// Budget.
    pub time_limit: Duration,
    /// What the arm takes, for plans that are judged by time.
    pub times: CycleTimes,
    /// What the arm can do of a plan; its objects are those of the instance, in the same order.
    pub limits: PlanLimits,
    /// A plan that is there already, empty for none: the answer is one that is worth the change, or this.
    pub known_plan: Vec<PlanAction>,
}

/// A plan with what a person needs to judge it.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct PlanNote {
    /// Which plan of this celld it is, from 1: what a person agrees to. 0: a draft, which waits for no
    /// person.
    pub number: u64,
    /// All of it, in order.
    pub actions: Vec<RouteAction>,
    /// Pick-n-places that the job had made before the first of them.
    pub made: usize,
    /// In the job's objective.
    pub lower_bound: f64,
    /// What it will take, s, looks between its moves included.
    pub seconds: f64,
    /// Where the objects lie that it starts from.
    pub table: Vec<(String, Pose2)>,
    /// From an older sight: never carried out, to be looked at only.
    pub preview: bool,
    /// Age of that sight when the plan was made, s.
    pub sight_age_s: f64,
}

/// What is written into the journal of the active job before the cell goes on.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub enum Record {
    /// What the job's first look showed, and the goals that it has from then on.
    Found {
        /// Objects by name, where they lie.
        objects: Vec<(String, Pose2)>,
        /// Wanted pose of each object that has one.
        goals: Vec<(String, Pose2)>,
    },
    /// What is planned for the table as it was seen last.
    Planned(Box<PlanNote>),
    /// A person has approved what was planned last.
    Approved,
    /// The arm is about to move `object`.
    Intent {
        /// Running number of the pick-n-place in this job.
        step: usize,
        /// Object's name.
        object: String,
        /// From where.
        from: Pose2,
        /// To where.
        to: Pose2,
        /// To its goal or to a buffer.
        kind: ActionKind,
        /// How it will hang on the tool, seen from above: what a later start needs to put it down.
        tool_from_object: Option<Pose2>,
        /// Where each object was seen last, by name: what is held may hide one from the next look.
        table: Vec<(String, Pose2)>,
    },
    /// The object is held.
    Gripped {
        /// Running number.
        step: usize,
    },
    /// The object was released at its place.
    Released {
        /// Running number.
        step: usize,
    },
    /// The pick-n-place is over.
    Done {
        /// Running number.
        step: usize,
    },
    /// The pick-n-place that was meant last is not begun: the job waits, or its route is another.
    Withdrawn {
        /// Running number.
        step: usize,
    },
    /// What was gripped last does not hang on the cups any more: it was put down on a way back, let go by a
    /// person's order, or had gone when celld started. Of no job.
    LetGo {
        /// What became of it, as far as is known, as a sentence about "it".
        how: String,
    },
    /// The job is over.
    Ended(Box<JobReport>),
}

/// What the machine has to do, in this order.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub enum Action {
    /// For the robot session.
    Robot(RobotCommand),
    /// For the gripper session.
    Gripper(GripperCommand),
    /// Take frames and find the markers in them; answered by [`Input::Exposed`] and [`Input::Captured`].
    Capture {
        /// Number of frames.
        frames: usize,
        /// Where the camera is.
        table_from_camera: Isometry3<f64>,
        /// The first of a look: answers to earlier ones are not awaited any more.
        first: bool,
    },
    /// Put views together; answered by [`Input::Observed`].
    Observe {
        /// All of a look.
        views: Vec<View>,
        /// What it had to show, and what is remembered of the rest; `None`: the whole table.
        partial: Option<PartialLook>,
        /// What hangs on the gripper and is meant to.
        held: Option<HeldBody>,
    },
    /// Take one picture of a calibration round; answered by [`Input::Pictured`].
    Picture {
        /// Number of the pose, from 1.
        pose: usize,
        /// Where the flange is.
        base_from_flange: Isometry3<f64>,
    },
    /// Plan; answered by [`Input::Planned`].
    Plan(Box<PlanRequest>),
    /// Write this down; answered by [`Input::Committed`].
    Commit {
        /// Its number, growing.
        number: u64,
        /// What.
        record: Record,
    },
    /// The answer to an order.
    Reply {
        /// Of [`Input::Order`].
        number: u64,
        /// What was decided.
        reply: Reply,
    },
    /// The calibration round is over.
    RoundOver(Result<(), RoundFault>),
    /// For the operator.
    Say(Notice),
    /// The daemon may end: the arm is at rest and everything is written, or it was waited for long enough.
    End(Result<(), EndFault>),
}

/// A sentence for the operator and the log.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct Notice {
    /// True when a person has to act.
    pub alarm: bool,
    /// The sentence.
    pub text: String,
}
