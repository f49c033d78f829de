//! Modes of the robot and of its safety system in words, and what a person does about each.
//!
//! In: a mode. Out: its kind, as a result code; a sentence; what to do first. Below gates and troubles,
//! which both say it. The controller's own name of a mode goes with the words, for its log and its manual
//! use it. Pure.

use crate::code::Code;
use ur_wire::enumerations::{RobotMode, SafetyMode};

/// A safety mode as a person would say it.
pub fn safety_words(mode: SafetyMode) -> String {
    match safety_code(mode) {
        Code::EmergencyStop => "an emergency stop is pressed".to_string(),
        Code::ProtectiveStop => "the arm is in a protective stop".to_string(),
        Code::SafeguardStop => "a safeguard is open (door, light curtain, scanner)".to_string(),
        Code::SafetyFault => format!("the safety system has failed ({mode})"),
        _ => format!("the safety system is in a mode without motion ({mode})"),
    }
}

/// How far the arm is powered up, as a person would say it.
pub fn mode_words(mode: RobotMode) -> String {
    let words = match mode {
        RobotMode::NoController => "the controller's own software does not run",
        RobotMode::Disconnected => "the controller has no connection to the arm",
        RobotMode::ConfirmSafety => "a safety configuration waits for its confirmation at the pendant",
        RobotMode::Booting => "the controller is starting",
        RobotMode::PowerOff => "the arm is powered off",
        RobotMode::PowerOn => "the arm's power is coming on",
        RobotMode::Idle => "the arm's brakes are on",
        RobotMode::Backdrive => "the arm is in backdrive",
        RobotMode::Running => "the arm is powered, its brakes released",
        RobotMode::UpdatingFirmware => "the arm's firmware is being updated",
        RobotMode::Unknown(_) => "the arm is in a mode that celld does not know",
    };
    format!("{words} (robot mode {mode})")
}

/// What to do before anything else.
pub fn safety_hint(mode: SafetyMode) -> &'static str {
    match safety_code(mode) {
        Code::EmergencyStop => "release the button once the cell is safe",
        Code::ProtectiveStop => "see what the arm has met; `celld recover` shows the ways to unlock it",
        Code::SafeguardStop => "close the safeguard once nobody is in the cell",
        Code::SafetyFault => "read the pendant, restart the safety system there",
        _ => "read the pendant for what it waits for",
    }
}

/// The kind of a mode without motion, as the code of a job that it ends.
pub(crate) fn safety_code(mode: SafetyMode) -> Code {
    match mode {
        SafetyMode::SystemEmergencyStop
        | SafetyMode::RobotEmergencyStop
        | SafetyMode::ImmiEmergencyStop
        | SafetyMode::ProfisafeEmergencyStop => Code::EmergencyStop,
        SafetyMode::ProtectiveStop => Code::ProtectiveStop,
        SafetyMode::SafeguardStop
        | SafetyMode::AutomaticModeSafeguardStop
        | SafetyMode::ImmiSafeguardStop
        | SafetyMode::ProfisafeAutomaticModeSafeguardStop
        | SafetyMode::ProfisafeSafeguardStop
        | SafetyMode::SafetyApiSafeguardStop => Code::SafeguardStop,
        SafetyMode::Violation | SafetyMode::Fault => Code::SafetyFault,
        SafetyMode::Normal
        | SafetyMode::Reduced
        | SafetyMode::Recovery
        | SafetyMode::ValidateJointId
        | SafetyMode::Undefined
        | SafetyMode::SystemThreePositionEnablingStop
        | SafetyMode::TpThreePositionEnablingStop
        | SafetyMode::ProfisafeWaitingForParameters
        | SafetyMode::Unknown(_) => Code::SafetyMode,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_safety_mode_without_motion_has_its_words_and_what_to_do() {
        let stopped = || SafetyMode::KNOWN.iter().filter(|mode| !mode.allows_motion());
        for mode in stopped().chain([&SafetyMode::Unknown(99)]) {
            assert!(!safety_words(*mode).is_empty() && !safety_hint(*mode).is_empty(), "{mode}");
        }
        for (mode, code) in [
            (SafetyMode::RobotEmergencyStop, Code::EmergencyStop),
            (SafetyMode::ProtectiveStop, Code::ProtectiveStop),
            (SafetyMode::SafetyApiSafeguardStop, Code::SafeguardStop),
            (SafetyMode::Violation, Code::SafetyFault),
            (SafetyMode::TpThreePositionEnablingStop, Code::SafetyMode),
            (SafetyMode::Unknown(99), Code::SafetyMode),
        ] {
            assert_eq!(safety_code(mode), code, "{mode}");
        }
        assert!(safety_words(SafetyMode::Unknown(99)).contains("99"), "the number is shown");
    }

    #[test]
    fn a_robot_mode_has_words_and_the_controllers_name_for_it() {
        assert_eq!(mode_words(RobotMode::Booting), "the controller is starting (robot mode BOOTING)");
        assert!(mode_words(RobotMode::Unknown(42)).contains("42"), "the number is shown");
    }
}
