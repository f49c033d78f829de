//! What an operator may order, and the answer.
//!
//! In: a person's order, with the number under which it came. Out: a [`Reply`] that says what the cell
//! decided; the machine gives it after the decision, never before.

use crate::cell::device::gripper::Channels;
use serde::{Deserialize, Serialize};

/// An order of the operator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Order {
    /// Allow motion.
    Arm,
    /// Forbid motion once the present pick-n-place is over; a robot that is held or being started is stopped.
    Disarm,
    /// The plan shown for this job may be carried out.
    Approve(String),
    /// It may not.
    Reject(String),
    /// Give this job up after the present pick-n-place.
    Cancel(String),
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
    /// Stop, disarm, and switch the vacuum off, whatever is held.
    Release(Channels),
    /// Leave a fault.
    Recover,
}

/// The answer to an order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reply {
    /// The order is carried out.
    pub accepted: bool,
    /// One sentence: what happens, or why not and what to do instead.
    pub message: String,
}

impl Reply {
    /// It is done.
    pub fn accept(message: impl Into<String>) -> Reply {
        Reply { accepted: true, message: message.into() }
    }

    /// It is not.
    pub fn refuse(message: impl Into<String>) -> Reply {
        Reply { accepted: false, message: message.into() }
    }
}
