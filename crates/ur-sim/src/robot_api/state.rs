//! Robot state and system: `/robotstate/v1` and `/system/v1` of the Robot API.
//!
//! In: actions. Out: replies, or what they wait for ([`Goal`]); the words for the modes. Statuses and which
//! action waits are assumed from clients; that a protective stop is unlocked at once is what the vendor's
//! own client relies on.

use crate::controller::Controller;
use crate::controller::pendant::OperationalMode;
use crate::robot_api::reply::{Goal, Outcome, Reply, Request};
use serde_json::json;
use ur_wire::enumerations::{RobotMode, SafetyMode};

/// PUT `/robotstate/v1/state`.
pub fn act(controller: &mut Controller, request: &Request<'_>) -> Outcome {
    let action = match request.text(&["action"]) {
        Ok(action) => action,
        Err(refusal) => return refusal.into(),
    };
    match action.as_str() {
        "POWER_ON" => {
            controller.core.modes.power_on();
            Outcome::Until(Goal::Powered)
        }
        "BRAKE_RELEASE" => {
            controller.core.modes.release_brakes();
            Outcome::Until(Goal::Running)
        }
        "POWER_OFF" => {
            controller.power_off();
            Reply::done("Robot powered off").into()
        }
        "RESTART_SAFETY" => {
            controller.restart_safety();
            Reply::done("Safety restarted").into()
        }
        "UNLOCK_PROTECTIVE_STOP" if controller.core.modes.protective_stopped() => {
            controller.unlock_at_once();
            Reply::done("Protective stop unlocked").into()
        }
        "UNLOCK_PROTECTIVE_STOP" => conflict("The robot is not in protective stop").into(),
        _ => {
            let details = "action: POWER_ON, POWER_OFF, BRAKE_RELEASE, UNLOCK_PROTECTIVE_STOP or \
                           RESTART_SAFETY";
            Reply::refused(422, "Validation error", details).into()
        }
    }
}

fn conflict(details: &str) -> Reply {
    Reply::refused(409, "Conflict - Invalid State Transition", details)
}

/// The reply to an action that has come to its end; `None` while it goes on.
pub fn reached(controller: &Controller, goal: Goal) -> Option<Reply> {
    let modes = &controller.core.modes;
    let under_way = modes.robot_mode() == RobotMode::Booting || modes.powered();
    match goal {
        Goal::Powered if modes.powered() => Some(Reply::done("Robot powered on")),
        Goal::Running if modes.brakes_open() => Some(Reply::done("Brakes released")),
        _ if under_way => None,
        _ => Some(conflict(&format!(
            "The arm has no power; the safety mode is {}",
            safety_word(modes.safety_mode())
        ))),
    }
}

/// GET `/robotstate/v1/robotmode`.
pub fn robot_mode(controller: &Controller) -> Reply {
    let word = match controller.core.modes.robot_mode() {
        RobotMode::UpdatingFirmware => "UPDATING",
        mode => mode.name(),
    };
    mode(word)
}

/// GET `/robotstate/v1/safetymode`.
pub fn safety_mode(controller: &Controller) -> Reply {
    mode(safety_word(controller.core.modes.safety_mode()))
}

/// GET `/system/v1/controlmode`.
pub fn control_mode(controller: &Controller) -> Reply {
    mode(if controller.core.modes.remote() { "REMOTE" } else { "LOCAL" })
}

/// GET `/system/v1/operationalmode`. Remote control needs the automatic mode, unless a client has set the
/// other.
pub fn operational_mode(controller: &Controller) -> Reply {
    let automatic = match controller.core.pendant.operational_mode {
        OperationalMode::Automatic => true,
        OperationalMode::Manual => false,
        OperationalMode::None => controller.core.modes.remote(),
    };
    mode(if automatic { "AUTOMATIC" } else { "MANUAL" })
}

/// PUT and DELETE `/operational-mode/v1` (10.14): a client sets the mode, or leaves it to the pendant again.
/// The vendor's client names the requests and sends none: the body is assumed.
pub fn set_operational_mode(controller: &mut Controller, request: &Request<'_>) -> Reply {
    let wanted = match request.method {
        "DELETE" => OperationalMode::None,
        _ => match request.text(&["mode"]).map(|name| OperationalMode::from_name(&name)) {
            Ok(Some(mode)) => mode,
            Ok(None) => return Reply::refused(422, "Validation error", "mode: MANUAL or AUTOMATIC"),
            Err(refusal) => return refusal,
        },
    };
    controller.core.pendant.operational_mode = wanted;
    Reply::done("Operational mode set")
}

/// GET `/system/v1/system-time`: the controller's, counted from 2026-01-01 as scripts count it. Its form is
/// assumed.
pub fn system_time(controller: &Controller) -> Reply {
    let seconds = EPOCH_S + controller.core.timestamp();
    Reply::of(json!({"systemTime": (seconds * 1e3).round(), "message": ""}))
}

/// 2026-01-01 as system time, s.
const EPOCH_S: f64 = 1_767_225_600.0;

fn mode(word: &str) -> Reply {
    Reply::of(json!({"mode": word, "message": ""}))
}

/// The API has five words.
fn safety_word(mode: SafetyMode) -> &'static str {
    match mode {
        SafetyMode::Normal => "NORMAL",
        SafetyMode::Reduced => "REDUCED",
        SafetyMode::ProtectiveStop
        | SafetyMode::SafeguardStop
        | SafetyMode::AutomaticModeSafeguardStop
        | SafetyMode::ImmiSafeguardStop
        | SafetyMode::ProfisafeAutomaticModeSafeguardStop
        | SafetyMode::ProfisafeSafeguardStop
        | SafetyMode::SafetyApiSafeguardStop => "PROTECTIVE_STOP",
        SafetyMode::SystemEmergencyStop
        | SafetyMode::RobotEmergencyStop
        | SafetyMode::ImmiEmergencyStop
        | SafetyMode::ProfisafeEmergencyStop => "EMERGENCY_STOP",
        SafetyMode::Recovery
        | SafetyMode::Violation
        | SafetyMode::Fault
        | SafetyMode::ValidateJointId
        | SafetyMode::Undefined
        | SafetyMode::SystemThreePositionEnablingStop
        | SafetyMode::TpThreePositionEnablingStop
        | SafetyMode::ProfisafeWaitingForParameters
        | SafetyMode::Unknown(_) => "FAULT",
    }
}

/// GET `/versions/v1` (10.14).
pub fn versions(controller: &Controller) -> Reply {
    let [major, minor, bugfix, build] = controller.core.version();
    Reply::of(json!({
        "marketingVersion": format!("{major}.{minor}.{bugfix}"),
        "baselineVersion": format!("{major}.{minor}.{bugfix}-{build}"),
    }))
}

/// GET `/system/v1/information` (10.14).
pub fn information(controller: &Controller) -> Reply {
    let config = &controller.core.config;
    let claimed = controller.core.pendant.claimed_model();
    Reply::of(json!({
        "robotType": claimed.unwrap_or(config.arm.name),
        "serialNumber": config.serial_number,
    }))
}
