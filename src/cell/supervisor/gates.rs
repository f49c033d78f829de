//! The conditions without which nothing moves (design, section 7, rule 1).
//!
//! In: what the devices last said, whether the cell is armed, what was observed when. Out: `Ok`, or the first
//! condition that is missing, in words. One function for each class of motion; every motion goes through one.

use crate::cell::device::program::Nonce;
use crate::cell::supervisor::input::Outside;
use ur_wire::enumerations::{RobotMode, RuntimeState, SafetyMode};

/// Below this vacuum (fraction) nothing hangs on a cup; readings scatter by 1 %.
const EMPTY_BELOW: f64 = 0.05;

impl Closed {
    /// What a person can do about it.
    pub fn remedy(&self) -> &'static str {
        match self {
            Closed::Stale => {
                "see that the controller is on and in the network: `devices.robot` in the configuration, `ping` it"
            }
            Closed::Safety(_) => "clear the stop at the pendant once the cell is safe, then `celld arm`",
            Closed::Mode(_) => {
                "power the arm at the pendant, or switch it to Remote Control so that celld may"
            }
            Closed::Local => "switch the pendant to Remote Control, then `celld arm`",
            Closed::Program => "look at the pendant for the program's error, then `celld arm`",
            Closed::Paused => "press play at the pendant, or `celld abort`",
            Closed::NotPlaying(_) => "look at the pendant for what the program does, or `celld abort`",
            Closed::Disarmed => "`celld arm` once the cell is clear",
            Closed::Gripper => {
                "see that the Compute Box is on and in the network: `devices.gripper` in the configuration, `ping` it"
            }
            Closed::Holding(_) => "hold the object by hand, `celld release --yes`, then `celld arm`",
            Closed::NotObserved | Closed::NotApproved => "nothing: the cell goes on by itself",
        }
    }
}

/// Why a motion may not start.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Closed {
    /// No state of the robot within the staleness limit.
    #[error("the robot's state is not fresh")]
    Stale,
    /// The safety system does not allow motion.
    #[error("the safety mode is {0}")]
    Safety(String),
    /// The arm is not powered with its brakes released.
    #[error("the robot mode is {0}")]
    Mode(String),
    /// The pendant is in local control, or has not said otherwise.
    #[error("remote control is off: switch the pendant to Remote Control")]
    Local,
    /// The program running on the controller is not the one uploaded.
    #[error("the on-robot program is not acknowledged")]
    Program,
    /// The program is paused at the pendant.
    #[error("the program is paused")]
    Paused,
    /// The program neither plays nor is paused.
    #[error("the program does not play: the controller is {0}")]
    NotPlaying(String),
    /// Nobody armed the cell.
    #[error("the cell is disarmed")]
    Disarmed,
    /// The gripper does not answer.
    #[error("the gripper does not answer")]
    Gripper,
    /// There is vacuum although nothing was picked.
    #[error("something may hang on the gripper: vacuum {0} %")]
    Holding(u32),
    /// The table changed since it was last seen.
    #[error("the table was not observed since the last motion of an object")]
    NotObserved,
    /// The plan waits for a person.
    #[error("the plan is not approved")]
    NotApproved,
}

/// What every motion needs.
///
/// # Errors
/// The first condition that does not hold.
pub fn any_motion(armed: bool, outside: &Outside, nonce: Option<Nonce>) -> Result<(), Closed> {
    // First, because a cell that nobody armed is no cell in trouble.
    if !armed {
        return Err(Closed::Disarmed);
    }
    let robot = match outside.robot {
        Some(robot) if outside.robot_fresh => robot,
        _ => return Err(Closed::Stale),
    };
    if !matches!(robot.safety_mode, SafetyMode::Normal | SafetyMode::Reduced) {
        return Err(Closed::Safety(format!("{:?}", robot.safety_mode)));
    }
    if robot.robot_mode != RobotMode::Running {
        return Err(Closed::Mode(format!("{:?}", robot.robot_mode)));
    }
    if robot.remote_control != Some(true) {
        return Err(Closed::Local);
    }
    if nonce.is_none_or(|nonce| robot.nonce != nonce.number()) {
        return Err(Closed::Program);
    }
    match robot.runtime_state {
        RuntimeState::Playing => Ok(()),
        RuntimeState::Pausing | RuntimeState::Paused => Err(Closed::Paused),
        RuntimeState::Stopping
        | RuntimeState::Stopped
        | RuntimeState::Resuming
        | RuntimeState::Unknown(_) => Err(Closed::NotPlaying(robot.runtime_state.to_string().to_lowercase())),
    }
}

/// What every motion with an empty gripper needs besides: that it is known to be empty.
///
/// # Errors
/// [`Closed::Gripper`] or [`Closed::Holding`].
pub fn empty_handed(outside: &Outside) -> Result<(), Closed> {
    let Some(vacuum) = outside.vacuum.filter(|_| outside.gripper_answers) else {
        return Err(Closed::Gripper);
    };
    let most = vacuum[0].max(vacuum[1]);
    // A reading that is no number is no proof either.
    if most < EMPTY_BELOW { Ok(()) } else { Err(Closed::Holding((most * 100.0).round() as u32)) }
}

/// What moving an object needs besides.
///
/// # Errors
/// The first condition that does not hold.
pub fn manipulate(
    armed: bool,
    outside: &Outside,
    nonce: Option<Nonce>,
    observed: bool,
    approved: bool,
) -> Result<(), Closed> {
    any_motion(armed, outside, nonce)?;
    empty_handed(outside)?;
    if !observed {
        Err(Closed::NotObserved)
    } else if !approved {
        Err(Closed::NotApproved)
    } else {
        Ok(())
    }
}

/// Share of its speed at which the arm follows its path now: the slider's, nothing while the program does not
/// play.
pub(crate) fn motion_speed(outside: &Outside) -> f64 {
    outside.robot.map_or(0.0, |robot| {
        let playing = robot.runtime_state == RuntimeState::Playing;
        if playing { robot.target_speed_fraction.clamp(0.0, 1.0) } else { 0.0 }
    })
}
