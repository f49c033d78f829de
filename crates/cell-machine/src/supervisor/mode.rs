//! Whether and how the cell may move: one value in place of flags that could contradict each other.
//!
//! In: orders, stops, faults. Out: what may begin. A pause outlasts disarming and arming, because the
//! person who paused a cell does not expect it to move when another person arms it.

use cell_values::time::Timestamp;
use serde::{Deserialize, Serialize};
use ur_wire::enumerations::RobotMode;

/// Whether and how the cell may move.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum Mode {
    /// Nothing moves before a person arms the cell.
    Disarmed {
        /// A pause is in force once it is armed.
        paused: bool,
    },
    /// Motion is allowed.
    Armed {
        /// How jobs go on.
        pace: Pace,
        /// The arm goes to its park pose next.
        park: bool,
        /// The highest step of the arm's power since the cell was armed.
        #[serde(default)]
        power: PowerStep,
    },
    /// The cell cannot be armed until the daemon is started anew, for this reason.
    Locked(String),
    /// The daemon ends; nothing begins any more.
    Ending {
        /// Since when.
        since: Timestamp,
        /// What made it end, unless it was ordered to.
        fault: Option<EndFault>,
    },
}

/// A step of the arm's power, from off to running.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
pub enum PowerStep {
    /// No power.
    #[default]
    Off,
    /// Power is on, the joints start.
    Starting,
    /// The brakes are on.
    Idle,
    /// The brakes are off.
    Running,
}

impl PowerStep {
    /// The step of a robot mode; `None` for a mode that is none. Booting counts once celld has `ordered` the
    /// power on: a controller that is switched on boots too, with the arm's power off.
    pub fn of(mode: RobotMode, ordered: bool) -> Option<PowerStep> {
        match mode {
            RobotMode::PowerOff | RobotMode::NoController | RobotMode::Disconnected => Some(PowerStep::Off),
            RobotMode::Booting if ordered => Some(PowerStep::Starting),
            RobotMode::PowerOn => Some(PowerStep::Starting),
            RobotMode::Idle => Some(PowerStep::Idle),
            RobotMode::Running => Some(PowerStep::Running),
            RobotMode::Booting
            | RobotMode::ConfirmSafety
            | RobotMode::Backdrive
            | RobotMode::UpdatingFirmware
            | RobotMode::Unknown(_) => None,
        }
    }
}

/// How jobs go on in an armed cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub enum Pace {
    /// One pick-n-place after the other.
    Running,
    /// One more, then a pause.
    OneMove,
    /// None.
    Paused,
}

/// Why the cell ends by itself: without its state folder it must not move.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Deserialize, Serialize)]
pub enum EndFault {
    /// An entry could not be written.
    #[error("the journal cannot be written: {0}")]
    Journal(String),
    /// The disk is silent.
    #[error("nothing could be written to the state folder for {0} s")]
    Silent(u64),
    /// The journal's file was removed, replaced or damaged.
    #[error("{0}")]
    Damaged(String),
    /// A defect of this program.
    #[error("a defect of celld ended what writes to the state folder: please report what was printed above")]
    Failed,
}

impl Mode {
    /// Motion is allowed.
    pub fn armed(&self) -> bool {
        matches!(self, Mode::Armed { .. })
    }

    /// A pause is in force.
    pub fn paused(&self) -> bool {
        match self {
            Mode::Disarmed { paused } => *paused,
            Mode::Armed { pace, .. } => *pace == Pace::Paused,
            Mode::Locked(_) | Mode::Ending { .. } => false,
        }
    }

    /// A pause follows the next pick-n-place.
    pub fn pauses_after_this_move(&self) -> bool {
        matches!(self, Mode::Armed { pace: Pace::OneMove, .. })
    }

    /// The arm is to be parked.
    pub fn parks(&self) -> bool {
        matches!(self, Mode::Armed { park: true, .. })
    }

    /// One pick-n-place follows the other, and nothing else is wanted.
    pub fn runs(&self) -> bool {
        matches!(self, Mode::Armed { pace: Pace::Running, park: false, .. })
    }

    /// The daemon ends.
    pub fn ending(&self) -> bool {
        matches!(self, Mode::Ending { .. })
    }

    /// A person's order to arm would be considered.
    pub fn can_be_armed(&self) -> bool {
        matches!(self, Mode::Armed { .. } | Mode::Disarmed { .. })
    }

    /// Motion is allowed from now on; false where it cannot be.
    pub fn arm(&mut self) -> bool {
        if let Mode::Disarmed { paused } = *self {
            let pace = if paused { Pace::Paused } else { Pace::Running };
            *self = Mode::Armed { pace, park: false, power: PowerStep::Off };
        }
        self.armed()
    }

    /// Motion is not allowed any more; a wish to park is forgotten, a pause is kept.
    pub fn disarm(&mut self) {
        if let Mode::Armed { pace, .. } = *self {
            // A single step that never came to its end leaves the pause that was promised after it.
            let paused = match pace {
                Pace::Running => false,
                Pace::OneMove | Pace::Paused => true,
            };
            *self = Mode::Disarmed { paused };
        }
    }

    /// The cell cannot be armed any more.
    pub fn lock(&mut self, reason: String) {
        if !self.ending() {
            *self = Mode::Locked(reason);
        }
    }

    /// Jobs go on like this; in a disarmed cell once it is armed.
    pub fn set_pace(&mut self, new: Pace) {
        match self {
            Mode::Disarmed { paused } => *paused = new == Pace::Paused,
            Mode::Armed { pace, .. } => *pace = new,
            Mode::Locked(_) | Mode::Ending { .. } => {}
        }
    }

    /// Sets or forgets the wish to park.
    pub fn set_park(&mut self, wanted: bool) {
        if let Mode::Armed { park, .. } = self {
            *park = wanted;
        }
    }

    /// Notes the present step of the arm's power.
    pub fn note_power(&mut self, step: PowerStep) {
        if let Mode::Armed { power, .. } = self {
            *power = step.max(*power);
        }
    }

    /// Power or brakes went back since the cell was armed; celld does not switch them off in an armed cell.
    pub fn power_fell_to(&self, step: Option<PowerStep>) -> bool {
        matches!(self, Mode::Armed { power, .. } if step.is_some_and(|step| step < *power))
    }

    /// A pick-n-place is over: a single step ends in a pause.
    pub fn step_over(&mut self) {
        if let Mode::Armed { pace: pace @ Pace::OneMove, .. } = self {
            *pace = Pace::Paused;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_outlasts_disarming_and_a_wish_to_park_does_not() {
        let mut mode = Mode::Disarmed { paused: false };
        assert!(mode.arm());
        mode.set_park(true);
        mode.set_pace(Pace::Paused);
        assert!(mode.parks() && mode.paused());
        mode.disarm();
        assert!(!mode.armed() && mode.paused() && !mode.parks());
        assert!(mode.arm());
        assert!(mode.paused() && !mode.parks());
    }

    #[test]
    fn a_single_step_ends_in_a_pause() {
        let mut mode = Mode::Armed { pace: Pace::OneMove, park: false, power: PowerStep::Running };
        mode.step_over();
        assert!(mode.paused());
        let mut mode = Mode::Armed { pace: Pace::OneMove, park: false, power: PowerStep::Running };
        mode.disarm();
        assert!(mode.arm() && mode.paused(), "also when it was broken off");
        let mut mode = Mode::Armed { pace: Pace::Running, park: false, power: PowerStep::Running };
        mode.step_over();
        assert!(!mode.paused());
    }

    #[test]
    fn a_locked_or_ending_cell_is_not_armed() {
        for mut mode in
            [Mode::Locked("another arm".into()), Mode::Ending { since: Timestamp::ZERO, fault: None }]
        {
            assert!(!mode.arm(), "{mode:?}");
            mode.set_pace(Pace::Running);
            mode.set_park(true);
            assert!(!mode.armed() && !mode.parks(), "{mode:?}");
        }
        let mut mode = Mode::Ending { since: Timestamp::ZERO, fault: None };
        mode.lock("too late".into());
        assert!(mode.ending());
    }
}
