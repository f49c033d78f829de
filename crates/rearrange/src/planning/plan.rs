//! A plan: its actions, what it costs, how the search ended; and the JSON of design section 4.2.
//!
//! In and out: poses in m and rad in the table frame, objects by index into the problem (by name in files).

use crate::document::word::{UnknownWord, named};
use crate::geometry::pose::Pose2;
use crate::planning::problem::Problem;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

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
    /// All of them.
    pub const ALL: [Objective; 3] = [Objective::Pp, Objective::Ti, Objective::Time];

    /// The word on the command line and in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Objective::Pp => "pp",
            Objective::Ti => "ti",
            Objective::Time => "time",
        }
    }
}

impl fmt::Display for Objective {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Objective {
    type Err = UnknownWord;

    fn from_str(word: &str) -> Result<Objective, UnknownWord> {
        named(word, &Objective::ALL, Objective::as_str)
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
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
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

#[cfg(test)]
mod tests {
    use super::*;

    fn file(poses: &[Pose2]) -> PlanFile {
        let entry = |pair: &[Pose2]| ActionEntry {
            object: "a \"quoted\" name".to_string(),
            from: pair[0],
            to: pair[1],
            kind: ActionKind::Buffer,
        };
        PlanFile {
            solver: "erbm".to_string(),
            objective: Objective::Ti,
            seed: u64::MAX,
            status: Status::Solved,
            cost: Some(0.1 + 0.2),
            moves: Some(poses.len() - 1),
            lower_bound: 1.0 / 3.0,
            first_plan_seconds: Some(0.004),
            seconds: 0.012,
            witness: None,
            actions: poses.windows(2).map(entry).collect(),
        }
    }

    #[test]
    fn poses_are_read_back_to_the_last_bit() {
        let mut state = 7u64;
        let mut random = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let poses: Vec<Pose2> =
            (0..5000).map(|_| Pose2::new(random(), random() / 3.0, 7.0 * random())).collect();
        let plan = file(&poses);
        assert_eq!(PlanFile::parse(&plan.to_json()), Ok(plan));
    }

    #[test]
    fn the_keys_are_those_of_the_design() {
        let plan = file(&[Pose2::new(0.0, 0.0, 0.0), Pose2::new(1.0, 0.0, 0.0)]);
        let value: serde_json::Value = serde_json::from_str(&plan.to_json()).expect("JSON");
        assert_eq!(value["status"], "solved");
        assert_eq!(value["objective"], "ti");
        assert_eq!(value["actions"][0]["kind"], "buffer");
        assert_eq!(value["actions"][0]["to"], serde_json::json!([1.0, 0.0, 0.0]));
        let none = PlanFile { cost: None, moves: None, actions: Vec::new(), status: Status::Timeout, ..plan };
        let value: serde_json::Value = serde_json::from_str(&none.to_json()).expect("JSON");
        assert!(value["cost"].is_null() && value["moves"].is_null());
        assert_eq!(value["actions"], serde_json::json!([]));
    }

    #[test]
    fn what_is_wrong_with_a_file_has_a_place() {
        let reported = PlanFile::parse("{\n  \"solver\": 3}").expect_err("refused");
        assert!(matches!(reported, PlanFileError::Syntax { line: 2, .. }), "{reported}");
        let unknown = file(&[Pose2::default()]).to_json().replace("\"seed\"", "\"sead\"");
        assert!(PlanFile::parse(&unknown).is_err());
    }
}
