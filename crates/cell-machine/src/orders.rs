//! What an operator may order, and the answer; and which plans wait for an operator.
//!
//! In: a person's order, with the number under which it came. Out: a [`Reply`] that says what the cell
//! decided; the machine gives it after the decision, never before.

pub use crate::device::gripper_types::Channels;
use crate::device::gripper_types::Identity;
use rearrange::document::word::{UnknownWord, named};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// An order of the operator.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum Order {
    /// Allow motion.
    Arm,
    /// Forbid motion once the present pick-n-place is over; a robot that is held or being started is
    /// stopped.
    Disarm,
    /// The plan shown for a job may be carried out.
    Approve {
        /// The job.
        id: String,
        /// Which of its plans was shown, by its number.
        plan: u64,
    },
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
    /// Leave a stop.
    Recover(WayBack),
    /// What answers at the gripper's address is the gripper.
    ConfirmGripper,
    /// A calibration round: slowly to the taught calibration poses, a picture at each, then disarmed.
    Calibrate,
}

impl Order {
    /// It only stops: obeyed from whoever is known, and however old it is.
    pub fn only_stops(&self) -> bool {
        match self {
            Order::Disarm | Order::Pause | Order::Abort => true,
            Order::Arm
            | Order::Approve { .. }
            | Order::Reject(_)
            | Order::Cancel(_)
            | Order::Resume
            | Order::Step
            | Order::Park
            | Order::Release(_)
            | Order::Recover(_)
            | Order::ConfirmGripper
            | Order::Calibrate => false,
        }
    }

    /// After it the cell is not armed, or stays where it is until a person says more: an older order to do
    /// something does not count after it.
    pub fn ends_leave(&self) -> bool {
        match self {
            Order::Disarm | Order::Pause | Order::Abort | Order::Release(_) => true,
            Order::Recover(way) => *way == WayBack::Release,
            Order::Arm
            | Order::Approve { .. }
            | Order::Reject(_)
            | Order::Cancel(_)
            | Order::Resume
            | Order::Step
            | Order::Park
            | Order::ConfirmGripper
            | Order::Calibrate => false,
        }
    }

    /// It does nothing but take something away from what is to be done.
    pub fn only_takes_away(&self) -> bool {
        self.only_stops() || matches!(self, Order::Reject(_) | Order::Cancel(_))
    }

    /// It may set the arm in motion or let something fall: for people who see the cell.
    pub fn needs_sight(&self) -> bool {
        match self {
            Order::Arm
            | Order::Resume
            | Order::Step
            | Order::Park
            | Order::Release(_)
            | Order::Recover(WayBack::Place | WayBack::Hold | WayBack::Release | WayBack::Retreat)
            | Order::ConfirmGripper
            | Order::Calibrate => true,
            Order::Recover(WayBack::Show)
            | Order::Disarm
            | Order::Approve { .. }
            | Order::Reject(_)
            | Order::Cancel(_)
            | Order::Pause
            | Order::Abort => false,
        }
    }

    /// The least role that may give it.
    pub fn least_role(&self) -> Role {
        match self {
            Order::Disarm | Order::Pause | Order::Abort | Order::Recover(WayBack::Show) => Role::View,
            Order::Arm
            | Order::Cancel(_)
            | Order::Resume
            | Order::Step
            | Order::Park
            | Order::Release(_)
            | Order::Recover(_) => Role::Operate,
            Order::Approve { .. } | Order::Reject(_) => Role::Approve,
            Order::ConfirmGripper | Order::Calibrate => Role::Engineer,
        }
    }
}

/// What a person may do at the cell; each may do what those before it may.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Look, and stop the cell.
    View,
    /// Give orders and jobs.
    Operate,
    /// Agree to plans.
    Approve,
    /// Change what the cell believes of itself.
    Engineer,
}

impl Role {
    /// All of them, the least first.
    pub const ALL: [Role; 4] = [Role::View, Role::Operate, Role::Approve, Role::Engineer];

    /// The word in files and on the page.
    pub fn as_str(self) -> &'static str {
        match self {
            Role::View => "view",
            Role::Operate => "operate",
            Role::Approve => "approve",
            Role::Engineer => "engineer",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Role {
    type Err = UnknownWord;

    fn from_str(word: &str) -> Result<Role, UnknownWord> {
        named(word, &Role::ALL, Role::as_str)
    }
}

/// How a stop is left; each but the first is a person's word that the cell is safe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WayBack {
    /// Nothing is done: what happened, what is held, and which ways there are.
    Show,
    /// Straight up, a look, and what is held is put down at its goal or the nearest free place.
    Place,
    /// What is held stays held and watched, and the arm where it is.
    Hold,
    /// Vacuum off where it is; a person holds the object.
    Release,
    /// Straight up, with whatever is held.
    Retreat,
}

impl WayBack {
    /// As in the status and in `celld recover`.
    pub fn as_str(self) -> &'static str {
        match self {
            WayBack::Show => "show",
            WayBack::Place => "place",
            WayBack::Hold => "hold",
            WayBack::Release => "release",
            WayBack::Retreat => "retreat",
        }
    }
}

/// Who has to agree before the arm moves. Ordered by strictness: a job may only be stricter than the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Approval {
    /// No person: an armed cell carries out accepted jobs at once.
    Never,
    /// A person approves each job once, with its first plan; a new plan for it does not wait again.
    Job,
    /// A person approves every plan, also each new plan within a job.
    Always,
}

impl Approval {
    /// All of them, in the order of strictness.
    pub const ALL: [Approval; 3] = [Approval::Never, Approval::Job, Approval::Always];

    /// The word a file uses.
    pub fn as_str(self) -> &'static str {
        match self {
            Approval::Never => "never",
            Approval::Job => "job",
            Approval::Always => "always",
        }
    }
}

impl fmt::Display for Approval {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Approval {
    type Err = UnknownWord;

    fn from_str(word: &str) -> Result<Approval, UnknownWord> {
        named(word, &Approval::ALL, Approval::as_str)
    }
}

/// Which gripper a person has confirmed to be the one on this arm. That the device says which product it is
/// does not prove that.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
pub enum ConfirmedGripper {
    /// None yet.
    #[default]
    None,
    /// The cell is simulated: no person is needed.
    NotNeeded,
    /// The one at the address, which has no serial number.
    AtAddress,
    /// The one with this serial number, at whichever address.
    Serial(String),
}

impl ConfirmedGripper {
    /// The gripper that answers, as a person confirms it.
    pub fn of(identity: &Identity) -> ConfirmedGripper {
        identity.serial_text().map_or(ConfirmedGripper::AtAddress, ConfirmedGripper::Serial)
    }
}

/// The answer to an order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reply {
    /// The order is carried out.
    pub accepted: bool,
    /// One sentence: what happens, or why not and what to do instead.
    pub message: String,
    /// The gripper that a person has confirmed by the order, to be remembered; never sent to clients.
    #[serde(skip)]
    pub confirmed: Option<ConfirmedGripper>,
    /// Why the cell did not decide on the order, for the rules of the closed loop; never sent to clients.
    #[serde(skip)]
    pub stale: Option<Stale>,
}

/// Why an order no longer counts when it is to be decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stale {
    /// Its client has ended.
    ClientEnded,
    /// It was given too long ago.
    TooOld,
}

impl Reply {
    /// It is done.
    pub fn accept(message: impl Into<String>) -> Reply {
        Reply { accepted: true, message: message.into(), confirmed: None, stale: None }
    }

    /// It is not.
    pub fn refuse(message: impl Into<String>) -> Reply {
        Reply { accepted: false, message: message.into(), confirmed: None, stale: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn approval_is_ordered_by_strictness_and_reads_back() {
        for approval in Approval::ALL {
            assert_eq!(approval.as_str().parse::<Approval>(), Ok(approval));
        }
        assert!(Approval::Always > Approval::Job && Approval::Job > Approval::Never);
    }

    /// Whoever may look may stop; what moves the arm takes more than a look.
    #[test]
    fn whoever_may_look_may_stop_and_nothing_that_moves() {
        for order in [Order::Abort, Order::Disarm, Order::Pause] {
            assert!(order.only_stops() && order.least_role() == Role::View && !order.needs_sight());
        }
        let show = Order::Recover(WayBack::Show);
        assert!(!show.only_stops() && show.least_role() == Role::View && !show.needs_sight());
        let moves = [Order::Arm, Order::Resume, Order::Step, Order::Park, Order::Recover(WayBack::Place)];
        let confirmed = [Order::Release(Channels::Both), Order::ConfirmGripper, Order::Calibrate];
        for order in moves.into_iter().chain(confirmed) {
            assert!(
                !order.only_stops() && order.needs_sight() && order.least_role() > Role::View,
                "{order:?}"
            );
        }
        for role in Role::ALL {
            assert_eq!(role.as_str().parse::<Role>(), Ok(role));
        }
    }
}
