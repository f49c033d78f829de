//! The conditions without which nothing moves (design, section 7, rule 1).
//!
//! In: what the devices last said, whether the cell is armed, what was observed when. Out: `Ok`, or the
//! first condition that is missing, in words. One function for each class of motion; every motion goes
//! through one.

use crate::device::gripper_types::{GripperFault, Identity};
use crate::device::program::Nonce;
use crate::device::robot_types::Link;
use crate::intake::Unreachable;
use crate::orders::ConfirmedGripper;
use crate::supervisor::input::DeviceSnapshot;
use crate::supervisor::safety_words::{mode_words, safety_hint, safety_words};
use serde::{Deserialize, Serialize};
use ur_wire::enumerations::{RobotMode, RuntimeState, SafetyMode};

/// Below this vacuum (fraction) nothing hangs on a cup; readings scatter by 1 %.
const EMPTY_BELOW: f64 = 0.05;

impl GateClosed {
    /// The same for an order that is given again and needs no `celld arm`.
    pub fn hint_to_try_again(&self) -> String {
        let hint = self.hint();
        hint.strip_suffix("then `celld arm`")
            .map_or_else(|| hint.to_string(), |first| format!("{first}then try again"))
    }

    /// What comes before the arming that the hint ends in.
    pub fn hint_before_arming(&self) -> &'static str {
        let hint = self.hint();
        hint.strip_suffix("then `celld arm`").map_or(hint, |first| first.trim_end_matches([' ', ',', ';']))
    }

    /// What a person can do about it.
    pub fn hint(&self) -> &'static str {
        match self {
            GateClosed::Link(_) | GateClosed::Stale => {
                "see that the controller is on and in the network: `devices.robot` in the configuration, \
                 `ping` it"
            }
            GateClosed::Safety(mode) => safety_hint(*mode),
            GateClosed::Mode(_) => {
                "see the pendant: a controller that starts or is updated takes its time, a new safety \
                 configuration is confirmed there, and so is backdrive ended; then `celld arm`"
            }
            GateClosed::Guided => {
                "let go of the freedrive button and stand clear of the arm, then `celld arm`"
            }
            GateClosed::Local => "switch the pendant to Remote Control, then `celld arm`",
            GateClosed::Program => "look at the pendant for the program's error, then `celld arm`",
            GateClosed::Paused => "`celld abort`, then `celld recover`",
            GateClosed::NotPlaying(_) => "look at the pendant for what the program does, or `celld abort`",
            GateClosed::Orders(_) => "put the state folder back or restart celld",
            GateClosed::Disarmed => "`celld arm` once the cell is clear",
            GateClosed::Locked(_) => "the cell cannot be armed before that",
            GateClosed::Gripper(GripperFault::Silent) => {
                "check the Compute Box's power and network: `devices.gripper` in the configuration, \
                 `ping` it"
            }
            GateClosed::Gripper(GripperFault::Taken) => {
                "the Compute Box serves one client: end the other one (a second celld, a PLC, the gripper's \
                 URCap); after a pulled cable the box may keep the place of an old connection for a while; \
                 without power the gripper drops what hangs there"
            }
            GateClosed::Gripper(GripperFault::Refused) => {
                "the Compute Box may still be starting, or serve another client (a second celld, a PLC, the \
                 gripper's URCap): end that one; `devices.gripper` in the configuration has the port"
            }
            GateClosed::Gripper(GripperFault::Unserved) => {
                "end the other client of the Compute Box (a second celld, a PLC, the gripper's URCap); if there \
                 is none, check the unit in `devices.gripper` of the configuration"
            }
            GateClosed::Gripper(GripperFault::NoVacuum) => {
                "see on the Compute Box's own web page which gripper and which firmware it has: older \
                 firmware has the vacuum in other registers, update it"
            }
            GateClosed::GripperUnknown => "wait a few seconds, then try again",
            GateClosed::GripperUnconfirmed | GateClosed::GripperByAddress | GateClosed::GripperOther => {
                "see that it is the gripper on this arm, then `celld confirm-gripper`, once for each gripper"
            }
            GateClosed::Holding => "`celld recover` says what hangs there and what can be done with it",
            GateClosed::MayHang(_) => "see that nothing hangs on the cups, then `celld release --yes`",
            GateClosed::NotObserved | GateClosed::NotApproved => "nothing: the cell goes on by itself",
        }
    }
}

/// Why a motion may not start.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Deserialize, Serialize)]
pub enum GateClosed {
    /// A connection to the controller is down.
    #[error("the {0} link to the controller is down")]
    Link(Link),
    /// No state of the robot within the staleness limit.
    #[error("the robot sends no state")]
    Stale,
    /// The safety system does not allow motion.
    #[error("{}", safety_words(*.0))]
    Safety(SafetyMode),
    /// The arm is not powered with its brakes released.
    #[error("{}", mode_words(*.0))]
    Mode(RobotMode),
    /// A person guides the arm by hand.
    #[error("the arm is guided by hand (freedrive)")]
    Guided,
    /// The pendant is in local control, or has not said otherwise.
    #[error("remote control is off")]
    Local,
    /// The program running on the controller is not the one uploaded.
    #[error("celld's program does not run on the robot")]
    Program,
    /// The program is paused, by another client or at the pendant: celld never pauses it.
    #[error("the program is paused")]
    Paused,
    /// The program neither plays nor is paused.
    #[error("the program does not play: the controller is {0}")]
    NotPlaying(String),
    /// Orders do not reach the cell.
    #[error("orders do not reach celld: {0}")]
    Orders(Unreachable),
    /// The cell was not armed.
    #[error("the cell is disarmed")]
    Disarmed,
    /// Nor can it be armed, for this reason.
    #[error("the cell is locked: {0}")]
    Locked(String),
    /// There is no vacuum reading.
    #[error("{0}")]
    Gripper(GripperFault),
    /// The gripper answers, and its serial number was not read yet.
    #[error("the gripper's serial number was not read yet")]
    GripperUnknown,
    /// No person has said yet that what answers at the gripper's address is the gripper.
    #[error("what answers at the gripper's address was never confirmed to be the gripper")]
    GripperUnconfirmed,
    /// A person has confirmed a gripper that gave out no serial number, by an older celld perhaps.
    #[error("the gripper was confirmed by its address only, but it reports a serial number")]
    GripperByAddress,
    /// A person has confirmed a gripper with another serial number.
    #[error("this is another gripper than the one that was confirmed")]
    GripperOther,
    /// There is vacuum although nothing was picked. Without the reading: what is said of a gate is part of
    /// the status, which would be another with every reading.
    #[error("something may hang on the gripper: there is vacuum in its cups")]
    Holding,
    /// An object was held, and no person or picture has said that it is gone.
    #[error("{0} may hang on the cups")]
    MayHang(String),
    /// The table changed since it was last seen, or that was too long ago.
    #[error("the table was not observed since the last motion of an object, or too long ago")]
    NotObserved,
    /// The plan waits for a person.
    #[error("the plan is not approved")]
    NotApproved,
}

/// What arming needs: everything that a person at the table cannot see past. An arm that is off may be
/// armed, for celld powers it on the order; an arm that comes to life later must not move for an order from
/// before.
///
/// # Errors
/// The first condition that does not hold.
pub fn arming(devices: &DeviceSnapshot) -> Result<(), GateClosed> {
    arming_for_round(devices)?;
    empty_handed(devices)
}

/// What arming for a calibration round needs: it picks nothing, and the gripper need not be there.
///
/// # Errors
/// The first condition that does not hold.
pub fn arming_for_round(devices: &DeviceSnapshot) -> Result<(), GateClosed> {
    if let Some(link) = devices.link_down {
        return Err(GateClosed::Link(link));
    }
    let robot = match devices.robot {
        Some(robot) if devices.robot_fresh => robot,
        _ => return Err(GateClosed::Stale),
    };
    if !robot.safety_mode.allows_motion() {
        return Err(GateClosed::Safety(robot.safety_mode));
    }
    if robot.remote_control != Some(true) {
        return Err(GateClosed::Local);
    }
    if robot.guided {
        return Err(GateClosed::Guided);
    }
    match robot.robot_mode {
        RobotMode::PowerOff | RobotMode::Idle | RobotMode::Running => Ok(()),
        RobotMode::NoController
        | RobotMode::Disconnected
        | RobotMode::ConfirmSafety
        | RobotMode::Booting
        | RobotMode::PowerOn
        | RobotMode::Backdrive
        | RobotMode::UpdatingFirmware
        | RobotMode::Unknown(_) => Err(GateClosed::Mode(robot.robot_mode)),
    }
}

/// What a way back after a stop needs: as for arming, but a protective stop is what it leaves, and something
/// may be held.
///
/// # Errors
/// The first condition that does not hold.
pub fn recovering(devices: &DeviceSnapshot) -> Result<(), GateClosed> {
    let stopped = devices.robot.is_some_and(|robot| robot.safety_mode == SafetyMode::ProtectiveStop);
    match arming_for_round(devices) {
        Err(GateClosed::Safety(_)) if stopped => Ok(()),
        judged => judged,
    }
}

/// What every motion needs.
///
/// # Errors
/// The first condition that does not hold.
pub fn any_motion(armed: bool, devices: &DeviceSnapshot, nonce: Option<Nonce>) -> Result<(), GateClosed> {
    // First, because a cell that was not armed is no cell in trouble.
    if !armed {
        return Err(GateClosed::Disarmed);
    }
    let robot = match devices.robot {
        Some(robot) if devices.robot_fresh => robot,
        _ => return Err(GateClosed::Stale),
    };
    if !robot.safety_mode.allows_motion() {
        return Err(GateClosed::Safety(robot.safety_mode));
    }
    if robot.robot_mode != RobotMode::Running {
        return Err(GateClosed::Mode(robot.robot_mode));
    }
    if robot.guided {
        return Err(GateClosed::Guided);
    }
    if robot.remote_control != Some(true) {
        return Err(GateClosed::Local);
    }
    if nonce.is_none_or(|nonce| robot.nonce != nonce.number()) {
        return Err(GateClosed::Program);
    }
    match robot.runtime_state {
        RuntimeState::Playing => Ok(()),
        RuntimeState::Pausing | RuntimeState::Paused => Err(GateClosed::Paused),
        RuntimeState::Stopping
        | RuntimeState::Stopped
        | RuntimeState::Resuming
        | RuntimeState::Unknown(_) => {
            Err(GateClosed::NotPlaying(robot.runtime_state.to_string().to_lowercase()))
        }
    }
}

/// What every motion with an empty gripper needs besides: that it is known to be empty.
///
/// # Errors
/// [`GateClosed::Gripper`] or [`GateClosed::Holding`].
pub fn empty_handed(devices: &DeviceSnapshot) -> Result<(), GateClosed> {
    let Some(vacuum) = devices.vacuum.filter(|_| devices.gripper_answers) else {
        return Err(GateClosed::Gripper(devices.gripper_fault));
    };
    // A reading that is no number is no proof either; the larger of it and another would be the other.
    if vacuum.iter().all(|share| *share < EMPTY_BELOW) {
        return Ok(());
    }
    Err(GateClosed::Holding)
}

/// What arming needs besides: the gripper that answers is the one that a person has confirmed.
///
/// # Errors
/// It is not, or it has not said yet which one it is.
pub fn confirmed(confirmed: &ConfirmedGripper, identity: Option<&Identity>) -> Result<(), GateClosed> {
    match (confirmed, identity.map(ConfirmedGripper::of)) {
        (ConfirmedGripper::NotNeeded, _) => Ok(()),
        (confirmed, Some(answers)) if *confirmed == answers => Ok(()),
        (_, None) => Err(GateClosed::GripperUnknown),
        (ConfirmedGripper::None, Some(_)) => Err(GateClosed::GripperUnconfirmed),
        (ConfirmedGripper::AtAddress, Some(_)) => Err(GateClosed::GripperByAddress),
        (ConfirmedGripper::Serial(_), Some(_)) => Err(GateClosed::GripperOther),
    }
}

/// What moving an object needs besides.
///
/// # Errors
/// The first condition that does not hold.
pub fn manipulate(
    armed: bool,
    devices: &DeviceSnapshot,
    nonce: Option<Nonce>,
    observed: bool,
    approved: bool,
) -> Result<(), GateClosed> {
    any_motion(armed, devices, nonce)?;
    empty_handed(devices)?;
    if !observed {
        Err(GateClosed::NotObserved)
    } else if !approved {
        Err(GateClosed::NotApproved)
    } else {
        Ok(())
    }
}

/// Share of its speed at which the arm follows its path now: the slider's, nothing while the program does
/// not play.
pub(crate) fn motion_speed(devices: &DeviceSnapshot) -> f64 {
    devices.robot.map_or(0.0, |robot| {
        let playing = robot.runtime_state == RuntimeState::Playing;
        if playing { robot.target_speed_fraction.clamp(0.0, 1.0) } else { 0.0 }
    })
}
