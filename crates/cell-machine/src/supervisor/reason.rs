//! Why a job ends or the cell is stopped, and the sentences that people read.
//!
//! Plain data with the two ways to say something; below every file that decides.

use crate::code::Code;
use crate::device::gripper_types::GripperFault;
use crate::supervisor::input::{Action, Notice};
use serde::{Deserialize, Serialize};

/// How the notice of a stop begins. When it is given the arm still brakes.
pub const STOP_ORDERED: &str = "disarmed, a stop is ordered";

/// Why a job ends.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct Reason {
    pub code: Code,
    /// The object that the code is about.
    pub object: Option<String>,
    /// One sentence.
    pub message: String,
    /// What the operator can do; empty when nothing is needed.
    pub hint: String,
}

impl Reason {
    /// The same about an object.
    pub fn of(self, object: impl Into<String>) -> Reason {
        Reason { object: Some(object.into()), ..self }
    }
}

impl Code {
    /// What ended the job is put right at the table, the arm or the gripper, and not in a file.
    pub(crate) fn needs_hands(self) -> bool {
        let in_files = [Code::Infeasible, Code::NoPlan, Code::SolverUnfit, Code::PlannerStuck];
        !in_files.contains(&self)
    }

    /// With a sentence and what to do about it.
    pub(crate) fn because(self, message: impl Into<String>, hint: impl Into<String>) -> Reason {
        Reason { code: self, object: None, message: message.into(), hint: hint.into() }
    }
}

/// The message with the gripper's fault, where that is known.
pub(crate) fn with_fault(message: String, fault: GripperFault) -> String {
    match fault {
        GripperFault::Silent => message,
        GripperFault::Taken | GripperFault::Refused | GripperFault::Unserved | GripperFault::NoVacuum => {
            format!("{message}: {fault}")
        }
    }
}

/// An ordinary sentence for the operator.
pub(crate) fn say(out: &mut Vec<Action>, text: impl Into<String>) {
    out.push(Action::Say(Notice { alarm: false, text: text.into() }));
}

/// A sentence that requires a person to act.
pub(crate) fn alarm(out: &mut Vec<Action>, text: impl Into<String>) {
    out.push(Action::Say(Notice { alarm: true, text: text.into() }));
}
