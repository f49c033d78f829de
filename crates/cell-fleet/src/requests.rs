//! What is requested of one cell, and what it answers: payloads of requests. Pure.

use serde::{Deserialize, Serialize};

/// A request to a cell; the subject names who sent it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Request {
    /// [`crate::payloads::VERSION`].
    pub version: u32,
    /// The job it is about.
    pub job: String,
    /// To approve: the number of the plan that was shown ([`crate::payloads::CellState::plan`]). A plan that
    /// has taken its place meanwhile is not agreed to.
    #[serde(default)]
    pub plan: Option<u64>,
    /// To send: the kinds of files ([`crate::files::FileKind`]).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<String>,
}

/// The cell's answer, after it has decided.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// [`crate::payloads::VERSION`].
    pub version: u32,
    /// It is done.
    pub accepted: bool,
    /// What happens, or why not.
    pub message: String,
    /// The names of the files that are in the object store now.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<String>,
}
