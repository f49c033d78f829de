//! Phases of a pick-n-place, and what a fault in one of them came to.

use crate::pair::rules::Rule;
use cell_machine::code::{Code, JobStatus};

/// A phase in which a fault may come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Phase {
    BringUp,
    Look,
    Plan,
    Approve,
    Approach,
    Descend,
    Grip,
    Lift,
    Carry,
    Place,
    Release,
    Retreat,
    Park,
}

impl Phase {
    /// All of them, in their order.
    pub const ALL: [Phase; 13] = [
        Phase::BringUp,
        Phase::Look,
        Phase::Plan,
        Phase::Approve,
        Phase::Approach,
        Phase::Descend,
        Phase::Grip,
        Phase::Lift,
        Phase::Carry,
        Phase::Place,
        Phase::Release,
        Phase::Retreat,
        Phase::Park,
    ];

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Phase::BringUp => "bring-up",
            Phase::Look => "look",
            Phase::Plan => "plan",
            Phase::Approve => "approve",
            Phase::Approach => "approach",
            Phase::Descend => "descend",
            Phase::Grip => "grip",
            Phase::Lift => "lift",
            Phase::Carry => "carry",
            Phase::Place => "place",
            Phase::Release => "release",
            Phase::Retreat => "retreat",
            Phase::Park => "park",
        }
    }

    /// True where an object is on the cups.
    pub fn holds(self) -> bool {
        match self {
            Phase::Lift | Phase::Carry | Phase::Place => true,
            Phase::BringUp
            | Phase::Look
            | Phase::Plan
            | Phase::Approve
            | Phase::Approach
            | Phase::Descend
            | Phase::Grip
            | Phase::Release
            | Phase::Retreat
            | Phase::Park => false,
        }
    }
}

/// What a case came to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// How the job ended, without an operator; `None` while it waits or where there was none.
    pub end: Option<JobStatus>,
    /// There was one.
    pub has_job: bool,
    /// The code of its report.
    pub code: Option<Code>,
    /// What the operator read last: the message of a job that failed, or the last alarm.
    pub sentence: String,
    /// The hint of the report.
    pub hint: String,
    /// The cell was armed when the fault had shown.
    pub armed: bool,
    /// What was held was still held when the fault had shown; `None` where nothing was.
    pub kept: Option<bool>,
    /// The daemon ended by itself.
    pub daemon_ended: bool,
    /// How the job after it ended, once the fault was over and a person had armed.
    pub next: Option<Code>,
    /// Breaches of rules, each once.
    pub breaches: Vec<Rule>,
    /// Why there is no outcome.
    pub impossible: Option<String>,
}
