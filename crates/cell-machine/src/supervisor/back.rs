//! What the ways back after a stop need to know, and how far one is.
//!
//! Plain data; the transitions are in `recovery`, the sentences in `situation`.

use crate::code::Code;
use crate::device::robot_types::InputsTaken;
use crate::orders::WayBack;
use crate::supervisor::model::CutOff;
use crate::supervisor::reason::Reason;
use cell_motion::path::CheckedPath;
use cell_motion::put_down::Grasp;
use cell_values::time::Timestamp;
use rearrange::geometry::pose::Pose2;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// What may hang on the gripper.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct Held {
    pub object: String,
    /// How it hangs; unknown where the tool did not point straight down.
    pub grasp: Option<Grasp>,
    pub height: f64,
    pub mass: f64,
    /// Largest acceleration of the tool at which the cups hold it, m/s2.
    pub hold: f64,
    /// Where it was to go.
    pub to: Pose2,
    /// The vacuum has gone at its place; it may hang on the cups all the same until a picture shows it.
    pub let_go: bool,
    /// The grip ended without enough vacuum; the pump may go on, and it may hang there all the same.
    #[serde(default)]
    pub unsealed: bool,
}

/// A stop that was not left yet.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct LastStop {
    /// `None`: before this celld was started.
    pub at: Option<Timestamp>,
    pub reason: Reason,
    /// The job that it ended or left, if one was active.
    pub job: Option<String>,
    /// That job was not ended by it: it goes on once the cell is armed.
    pub keeps_job: bool,
}

impl LastStop {
    /// The end of an earlier celld is a stop like any other: it is left by a person who has looked.
    pub fn of(CutOff { object, carrying, message }: CutOff) -> LastStop {
        let again = "submit the job again with `rerun: true`";
        let (code, hint) = match carrying {
            true => (
                Code::InterruptedCarrying,
                format!("{object} may hang on the cups: `celld recover` shows the ways back; then {again}"),
            ),
            false => (
                Code::Interrupted,
                format!("look at the cell, `celld recover` shows how it is; then `celld arm` and {again}"),
            ),
        };
        LastStop { at: None, reason: code.because(message, hint).of(object), job: None, keeps_job: false }
    }
}

/// What the ways back need to know.
#[derive(Debug, Default, Deserialize, Serialize)]
pub(crate) struct Back {
    /// The way that is under way.
    pub recovery: Option<Recovery>,
    /// How the last one ended, unless one is under way.
    pub ended: Option<Result<String, String>>,
    /// The vacuum holds something.
    pub grips: bool,
    /// Since when the gripper has shown no vacuum after a start.
    #[serde(default)]
    pub empty_since: Option<Timestamp>,
    pub held: Option<Held>,
    /// That the vacuum fell at the last pick-n-place.
    pub weak: Option<String>,
    /// What fell, and where the tool was.
    pub fell: Option<String>,
    /// Since when the arm is in a protective stop.
    pub protective_since: Option<Timestamp>,
    pub last_stop: Option<LastStop>,
    /// The controller's last error: code and argument.
    pub error: Option<(i32, i32)>,
    /// Inputs that another client of the controller holds.
    pub registers_taken: Option<InputsTaken>,
    /// Where objects were seen last.
    pub table: Vec<(String, Pose2)>,
}

/// A way back under way.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Recovery {
    pub way: WayBack,
    /// The arm is over everything on the table.
    pub raised: bool,
    /// Where what is held hangs over then.
    pub below: Option<Pose2>,
    pub search: Option<PlaceSearch>,
    pub place: Option<Placing>,
}

/// A search for a place for what is held: which are free, and how far the paths to them were tried.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct PlaceSearch {
    /// Nearest first, and whether it is the one it was carried to.
    pub places: VecDeque<(Pose2, bool)>,
    /// When the last one was tried.
    pub tried: Option<Timestamp>,
    /// Why the first cannot be reached.
    pub fault: Option<String>,
    /// Why it is not put down where it was carried to.
    pub not_where_meant: Option<String>,
}

/// Where what is held is put down.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Placing {
    pub to: Pose2,
    /// Why it is not the place that it was carried to, where it is another.
    pub elsewhere: Option<String>,
    pub up: CheckedPath,
}

/// What the arm, or the controller, does on the way back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub(crate) enum BackStage {
    /// Nothing moves: the controller's 5 s, then its answer.
    Unlocking { ordered: bool },
    /// Straight up.
    Raising,
    /// Down onto the place.
    Placing,
    /// The vacuum goes off.
    Releasing,
    /// Straight up from the place.
    Leaving,
}

impl BackStage {
    pub fn follows_a_path(self) -> bool {
        match self {
            BackStage::Raising | BackStage::Placing | BackStage::Leaving => true,
            BackStage::Unlocking { .. } | BackStage::Releasing => false,
        }
    }

    pub fn words(self) -> &'static str {
        match self {
            BackStage::Unlocking { .. } => "unlocking the protective stop",
            BackStage::Raising => "going straight up",
            BackStage::Placing => "putting down what is held",
            BackStage::Releasing => "letting go",
            BackStage::Leaving => "leaving the place",
        }
    }
}
