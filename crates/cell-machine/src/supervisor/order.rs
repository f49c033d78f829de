//! A job as the supervisor carries it out, and how it ended.
//!
//! In: goals by object name, how to plan, whether a person has to approve. Out: the [`RouteAction`]s that
//! remain to be done, and a [`JobReport`] with a code a program can test and a sentence a person can act on.

use crate::code::{Code, JobStatus};
use crate::orders::Approval;
use crate::times::JobTimes;
use cell_values::time::Duration;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;
use rearrange::tabletop::rule::GoalRule;
use serde::{Deserialize, Serialize};

/// Work to do: bring the named objects to their goals; the others may end anywhere.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct JobOrder {
    /// Name of the job.
    pub id: String,
    /// Wanted pose of each named object, table frame; empty where `rule` is still to give them.
    pub goals: Vec<(String, Pose2)>,
    /// How they follow from what is seen first. Poses that it gave before a restart are in `goals`.
    pub rule: Option<GoalRule>,
    /// What the plan minimises.
    pub objective: Objective,
    /// Solver.
    pub solver: SolverKind,
    /// Planning budget.
    pub time_limit: Duration,
    /// Seed of the planner.
    pub seed: u64,
    /// Which plans a person has to approve before anything is picked.
    pub approval: Approval,
    /// The plan that a person approved before celld was started anew; empty where there is none.
    pub agreed: Vec<RouteAction>,
}

/// One remaining pick-n-place of a job's route.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub struct RouteAction {
    /// Name of the object.
    pub object: String,
    /// Where it is picked, table frame.
    pub from: Pose2,
    /// Where it is placed, table frame.
    pub to: Pose2,
    /// `to` is its goal, not a buffer.
    pub to_goal: bool,
}

/// One object at the end of a job.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct ObjectReport {
    /// Name.
    pub id: String,
    /// Where it should be.
    pub goal: Option<Pose2>,
    /// Where the camera saw it last, and how long before the job's end; `None` also where it was gripped
    /// since.
    pub measured: Option<(Pose2, Duration)>,
}

/// What became of a job.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct JobReport {
    /// Name of the job.
    pub id: String,
    /// How it ended.
    pub end: JobStatus,
    /// Stable code.
    pub code: Code,
    /// The object that the code is about, if it is about one.
    pub object: Option<String>,
    /// One sentence.
    pub message: String,
    /// What the operator can do about it; empty when nothing is needed.
    pub hint: String,
    /// Pick-n-places carried out.
    pub moves: usize,
    /// Lower bound of the first plan, in the job's objective.
    pub lower_bound: Option<f64>,
    /// Pick-n-places of the first plan, and how many of them went to a buffer.
    pub planned: Option<(usize, usize)>,
    /// Seconds the first plan took.
    pub planning_seconds: f64,
    /// Seconds from the job's start to its end.
    pub seconds: f64,
    /// What they were used for.
    pub times: JobTimes,
    /// How far the arm's links are from those of a nominal arm at most, m.
    #[serde(default)]
    pub links_off_m: f64,
    /// Each object.
    pub objects: Vec<ObjectReport>,
}

impl JobReport {
    /// The code as files have it, for example `done` or `object_missing:lid`.
    pub fn code_text(&self) -> String {
        self.code.about(self.object.as_deref().unwrap_or_default())
    }
}
