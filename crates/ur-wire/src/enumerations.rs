//! The controller's enumerations: robot mode, safety mode, runtime state, as numbers and as names.
//!
//! In: the integer of an RTDE field or the name of a dashboard reply. Out: a value that keeps a number it
//! does not know as `Unknown`, which every caller has to treat as a fault (design: an unknown value is never
//! ignored). Source: reference on UR interfaces, 1.8, which took them from the vendor's client library.

macro_rules! enumeration {
    ($(#[$doc:meta])* $name:ident { $($(#[$vdoc:meta])* $variant:ident = $code:literal, $text:literal;)* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
        pub enum $name {
            $($(#[$vdoc])* #[doc = $text] $variant,)*
            /// A number that this table does not have: a fault.
            Unknown(i32),
        }

        impl $name {
            /// Every value that has a name.
            pub const KNOWN: &[$name] = &[$($name::$variant),*];

            /// The value of a number.
            pub fn from_code(code: i32) -> $name {
                match code {
                    $($code => $name::$variant,)*
                    other => $name::Unknown(other),
                }
            }

            /// The number of a value.
            pub fn code(self) -> i32 {
                match self {
                    $($name::$variant => $code,)*
                    $name::Unknown(code) => code,
                }
            }

            /// The name as the dashboard prints it; `UNKNOWN` for a number without a name.
            pub fn name(self) -> &'static str {
                match self {
                    $($name::$variant => $text,)*
                    $name::Unknown(_) => "UNKNOWN",
                }
            }

            /// The value of a name, upper or lower case.
            pub fn from_name(name: &str) -> Option<$name> {
                $name::KNOWN.iter().copied().find(|value| value.name().eq_ignore_ascii_case(name))
            }

            /// False for a number that the table does not have.
            pub fn is_known(self) -> bool {
                !matches!(self, $name::Unknown(_))
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                match self {
                    $name::Unknown(code) => write!(f, "unknown value {code}"),
                    known => f.write_str(known.name()),
                }
            }
        }
    };
}

enumeration! {
    /// `robot_mode`: how far the arm is powered up.
    RobotMode {
        NoController = -1, "NO_CONTROLLER";
        Disconnected = 0, "DISCONNECTED";
        ConfirmSafety = 1, "CONFIRM_SAFETY";
        Booting = 2, "BOOTING";
        PowerOff = 3, "POWER_OFF";
        PowerOn = 4, "POWER_ON";
        Idle = 5, "IDLE";
        Backdrive = 6, "BACKDRIVE";
        Running = 7, "RUNNING";
        UpdatingFirmware = 8, "UPDATING_FIRMWARE";
    }
}

enumeration! {
    /// `safety_mode`: what the controller's safety system lets the arm do.
    SafetyMode {
        Normal = 1, "NORMAL";
        Reduced = 2, "REDUCED";
        ProtectiveStop = 3, "PROTECTIVE_STOP";
        Recovery = 4, "RECOVERY";
        SafeguardStop = 5, "SAFEGUARD_STOP";
        SystemEmergencyStop = 6, "SYSTEM_EMERGENCY_STOP";
        RobotEmergencyStop = 7, "ROBOT_EMERGENCY_STOP";
        Violation = 8, "VIOLATION";
        Fault = 9, "FAULT";
        ValidateJointId = 10, "VALIDATE_JOINT_ID";
        Undefined = 11, "UNDEFINED";
        AutomaticModeSafeguardStop = 12, "AUTOMATIC_MODE_SAFEGUARD_STOP";
        SystemThreePositionEnablingStop = 13, "SYSTEM_THREE_POSITION_ENABLING_STOP";
        TpThreePositionEnablingStop = 14, "TP_THREE_POSITION_ENABLING_STOP";
        ImmiEmergencyStop = 15, "IMMI_EMERGENCY_STOP";
        ImmiSafeguardStop = 16, "IMMI_SAFEGUARD_STOP";
        ProfisafeWaitingForParameters = 17, "PROFISAFE_WAITING_FOR_PARAMETERS";
        ProfisafeAutomaticModeSafeguardStop = 18, "PROFISAFE_AUTOMATIC_MODE_SAFEGUARD_STOP";
        ProfisafeSafeguardStop = 19, "PROFISAFE_SAFEGUARD_STOP";
        ProfisafeEmergencyStop = 20, "PROFISAFE_EMERGENCY_STOP";
        SafetyApiSafeguardStop = 22, "SAFETY_API_SAFEGUARD_STOP";
    }
}

impl SafetyMode {
    /// The two modes in which the arm may move.
    pub fn allows_motion(self) -> bool {
        matches!(self, SafetyMode::Normal | SafetyMode::Reduced)
    }
}

enumeration! {
    /// `runtime_state`: what the controller does with its program.
    RuntimeState {
        Stopping = 0, "STOPPING";
        Stopped = 1, "STOPPED";
        Playing = 2, "PLAYING";
        Pausing = 3, "PAUSING";
        Paused = 4, "PAUSED";
        Resuming = 5, "RESUMING";
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_and_name_comes_back() {
        for mode in RobotMode::KNOWN {
            assert_eq!(RobotMode::from_code(mode.code()), *mode);
            assert_eq!(RobotMode::from_name(&mode.name().to_lowercase()), Some(*mode));
        }
        for mode in SafetyMode::KNOWN {
            assert_eq!(SafetyMode::from_code(mode.code()), *mode);
        }
        for state in RuntimeState::KNOWN {
            assert_eq!(RuntimeState::from_code(state.code()), *state);
        }
    }

    #[test]
    fn an_unknown_number_is_kept_and_never_allows_motion() {
        let mode = SafetyMode::from_code(21);
        assert_eq!(mode, SafetyMode::Unknown(21));
        assert_eq!(mode.to_string(), "unknown value 21");
        assert!(!mode.is_known() && !mode.allows_motion());
        assert!(SafetyMode::Reduced.allows_motion() && !SafetyMode::Recovery.allows_motion());
        assert_eq!(RuntimeState::from_code(6), RuntimeState::Unknown(6));
    }
}
