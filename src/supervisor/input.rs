//! What the supervisor is told, and what it asks for.

use crate::device::gripper::{Channels, GripperCommand, GripperEvent};
use crate::device::robot_types::{RobotCommand, RobotEvent, RobotState};
use crate::geometry::pose::Pose2;
use crate::motion::cycle_time::CycleTimes;
use crate::planning::plan::{Action as PlanAction, Objective};
use crate::planning::solver::SolverKind;
use crate::supervisor::order::{JobOrder, JobReport};
use crate::tabletop::instance::Instance;
use crate::time::Duration;
use crate::vision::observe::{Observation, View};
use nalgebra::Isometry3;

/// What the devices last said, handed over with every call.
#[derive(Clone, Copy, Debug)]
pub struct Outside<'a> {
    /// Last state of the robot, if it ever spoke.
    pub robot: Option<&'a RobotState>,
    /// The robot's last state is younger than the staleness limit.
    pub robot_fresh: bool,
    /// The robot has been silent for longer than the staleness limit while the daemon was listening: not
    /// merely because the daemon was held up itself.
    pub robot_silent: bool,
    /// No program is being started, stopped or ended, so that a new one may be started.
    pub program_settled: bool,
    /// The gripper answered within its deadline.
    pub gripper_answers: bool,
    /// Vacuum of the channels (fraction), if it was read lately.
    pub vacuum: Option<[f64; 2]>,
}

/// An order of the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OperatorCommand {
    /// Allow motion.
    Arm,
    /// Forbid motion once the present pick-n-place is over.
    Disarm,
    /// The plan shown may be carried out.
    Approve,
    /// It may not.
    Reject,
    /// Give the job up after the present pick-n-place.
    Cancel,
    /// Stop after the present pick-n-place.
    Pause,
    /// Go on.
    Resume,
    /// One pick-n-place, then pause.
    Step,
    /// Stop now.
    Abort,
    /// Go to the park pose.
    Park,
    /// Switch the vacuum off, whatever hangs there.
    Release(Channels),
}

/// Why a camera gives no picture, after everything that can be tried from here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraTrouble {
    /// Stable word for the job's result, such as `camera_frozen`.
    pub code: &'static str,
    /// What is wrong.
    pub message: String,
    /// What a person can do.
    pub remedy: &'static str,
    /// Waiting does not help: another camera, another size, a recording at its end.
    pub lasting: bool,
}

/// What a plan request came to.
#[derive(Clone, Debug)]
pub enum PlanAnswer {
    /// A plan that passed the independent checker.
    Found {
        /// Its actions; objects are indices into the request's instance.
        actions: Vec<PlanAction>,
        /// Its cost in the objective asked for.
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
}

/// What happened.
#[derive(Clone, Debug)]
pub enum Input {
    /// Time has passed.
    Tick,
    /// The robot session reports.
    Robot(RobotEvent),
    /// The gripper session reports.
    Gripper(GripperEvent),
    /// The frames of one look pose were taken and searched for markers.
    Captured(Result<Vec<View>, CameraTrouble>),
    /// The views of a look were put together.
    Observed(Result<Box<Observation>, String>),
    /// The planner answered.
    Planned(Box<PlanAnswer>),
    /// A job was claimed.
    Job(Box<JobOrder>),
    /// The operator spoke.
    Operator(OperatorCommand),
    /// The daemon shall end: stop the arm, leave the job in a named state.
    Shutdown,
}

/// A planning problem with the budget to solve it in.
#[derive(Clone, Debug)]
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
}

/// A line of the step journal; committed before the next action of the list is carried out.
#[derive(Clone, Debug, PartialEq)]
pub enum JournalEntry {
    /// A plan was made.
    Planned {
        /// Number of pick-n-places.
        moves: usize,
    },
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
    },
    /// The object hangs on the gripper.
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
}

/// What the daemon has to do, in this order.
#[derive(Clone, Debug)]
pub enum Action {
    /// Tell the robot session.
    Robot(RobotCommand),
    /// Tell the gripper session.
    Gripper(GripperCommand),
    /// Take frames and find the markers in them; answer with [`Input::Captured`].
    Capture {
        /// Number of frames.
        frames: usize,
        /// Where the camera is.
        table_from_camera: Isometry3<f64>,
    },
    /// Put views together; answer with [`Input::Observed`].
    Observe(Vec<View>),
    /// Plan; answer with [`Input::Planned`].
    Plan(Box<PlanRequest>),
    /// Write the journal of the active job.
    Journal(JournalEntry),
    /// The active job is over.
    Finish(Box<JobReport>),
    /// Tell the operator.
    Say(Notice),
}

/// A sentence for the operator and the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    /// True when somebody has to act.
    pub alarm: bool,
    /// The sentence.
    pub text: String,
}
