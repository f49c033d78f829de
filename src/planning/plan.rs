//! A plan: its actions, what it costs, how the search ended; and the JSON of design section 4.2.
//!
//! In and out: poses in m and rad in the table frame, objects by index into the problem (by name in files).

use crate::geometry::pose::Pose2;
use crate::planning::problem::Problem;
use serde::{Deserialize, Serialize};

/// What a plan minimises (paper, section III-A; `time` is ours).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Objective {
    /// Number of pick-n-places.
    Pp,
    /// Total task impedance.
    Ti,
    /// Estimated execution time, by the caller's cost function.
    Time,
}

impl Objective {
    /// The word on the command line and in files.
    pub fn word(self) -> &'static str {
        match self {
            Objective::Pp => "pp",
            Objective::Ti => "ti",
            Objective::Time => "time",
        }
    }
}

/// Whether an action ends at the object's goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ActionKind {
    /// To its goal.
    Goal,
    /// To anywhere else.
    Buffer,
}

/// One pick-n-place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Action {
    /// Index of the object in the problem.
    pub object: usize,
    /// Where it is.
    pub from: Pose2,
    /// Where it goes.
    pub to: Pose2,
    /// Whether that is its goal.
    pub kind: ActionKind,
}

/// How planning ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// The cost equals the lower bound.
    Optimal,
    /// There is a plan.
    Solved,
    /// Proved that there is none.
    Infeasible,
    /// No plan was found.
    Timeout,
}

/// The plan file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanFile {
    /// Solver's name.
    pub solver: String,
    /// Objective.
    pub objective: Objective,
    /// Seed of every random choice.
    pub seed: u64,
    /// How it ended.
    pub status: Status,
    /// Cost in the objective; none without a plan.
    pub cost: Option<f64>,
    /// Number of actions; none without a plan.
    pub moves: Option<usize>,
    /// No plan is cheaper.
    pub lower_bound: f64,
    /// Seconds until the first plan.
    pub first_plan_seconds: Option<f64>,
    /// Seconds in all.
    pub seconds: f64,
    /// Why there is no plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub witness: Option<String>,
    /// The actions in order.
    pub actions: Vec<ActionEntry>,
}

/// An action in the plan file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionEntry {
    /// Object's name.
    pub object: String,
    /// From where.
    pub from: Pose2,
    /// To where.
    pub to: Pose2,
    /// Goal or buffer.
    pub kind: ActionKind,
}

/// Why a plan file cannot be used with a problem.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanFileError {
    /// Not JSON, or not a plan.
    #[error("line {line}, column {column}: {message}")]
    Syntax {
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What the parser expected.
        message: String,
    },
    /// An action names an object the instance does not have.
    #[error("actions[{index}]: the instance has no object {object:?}")]
    UnknownObject {
        /// Index of the action, from 0.
        index: usize,
        /// The name.
        object: String,
    },
}

impl PlanFile {
    /// Parses a plan file.
    ///
    /// # Errors
    /// Line, column and what is wrong there.
    pub fn parse(text: &str) -> Result<PlanFile, PlanFileError> {
        serde_json::from_str(text).map_err(|error| PlanFileError::Syntax {
            line: error.line(),
            column: error.column(),
            message: error.to_string(),
        })
    }

    /// The file's text.
    pub fn to_json(&self) -> String {
        // The type has string keys and finite numbers only; nothing in it can fail to serialise.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// Actions as entries with the problem's object names.
    pub fn entries(problem: &Problem, actions: &[Action]) -> Vec<ActionEntry> {
        actions
            .iter()
            .map(|action| ActionEntry {
                object: problem.objects[action.object].id.clone(),
                from: action.from,
                to: action.to,
                kind: action.kind,
            })
            .collect()
    }

    /// The actions with object indices of `problem`.
    ///
    /// # Errors
    /// The first action whose object the problem does not have.
    pub fn actions_for(&self, problem: &Problem) -> Result<Vec<Action>, PlanFileError> {
        self.actions
            .iter()
            .enumerate()
            .map(|(index, entry)| {
                let object = problem.objects.iter().position(|object| object.id == entry.object);
                let object = object
                    .ok_or_else(|| PlanFileError::UnknownObject { index, object: entry.object.clone() })?;
                Ok(Action { object, from: entry.from, to: entry.to, kind: entry.kind })
            })
            .collect()
    }
}
