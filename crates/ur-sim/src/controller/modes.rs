//! The controller's states: arm power and brakes, safety, and who may command it.
//!
//! In: what an operator, a client or the arm does. Out: the numbers that RTDE, dashboard and primary
//! interface show. Power: off -> booting -> idle (brakes shut) -> releasing -> running. Safety is beside it:
//! a protective stop leaves the arm powered, an emergency stop and a fault do not. The times are shorter
//! than a real arm's (3 to 8 s and 2 to 5 s) but not zero, so that no client mistakes a reply for
//! completion.

use ur_wire::enumerations::{RobotMode, SafetyMode};

/// Frames from power on to idle, and from brake release to running.
const BOOTING_FRAMES: u32 = 250;
const RELEASING_FRAMES: u32 = 150;

/// Frames after a protective stop in which it cannot be unlocked (5 s).
const UNLOCK_FRAMES: u64 = 2500;

/// Error code of a protective stop because of an impossible motion ("path sanity check failed").
pub const PATH_SANITY_CODE: i32 = 204;

/// Error codes of a protective stop at a safety plane, and of two links that meet.
pub const SAFETY_PLANE_CODE: i32 = 152;
pub const COLLISION_CODE: i32 = 157;

/// Error code of a protective stop because a limit of the safety configuration was passed.
pub const SAFETY_LIMIT_CODE: i32 = 191;

/// Error code of a protective stop that the program has requested (C209A0).
pub const STOP_BY_PROGRAM_CODE: i32 = 209;

/// What the dashboard says to an early unlock.
pub const UNLOCK_TOO_EARLY: &str = "Cannot unlock protective stop until 5s after occurrence. Always inspect \
                                    cause of protective stop before unlocking";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Power {
    Off,
    Booting { frames_left: u32, then_release: bool },
    Idle,
    Releasing { frames_left: u32 },
    Running,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Safety {
    Normal,
    Protective {
        since: u64,
        /// It came in reduced mode, which comes back after it.
        reduced: bool,
    },
    Safeguard,
    Emergency,
    Fault,
    /// Another mode by its number; in reduced mode the arm may move, in all others not.
    Other(i32),
}

/// Number of the reduced mode.
const REDUCED: i32 = 2;

/// `joint_mode` of a joint that runs, is idle, or is off.
const JOINT_RUNNING: i32 = 253;
const JOINT_IDLE: i32 = 255;
const JOINT_OFF: i32 = 239;

/// From where the arm is commanded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// By clients.
    Remote,
    /// At the pendant: clients are refused.
    Local,
    /// Remote control was never enabled in the settings, as on a robot just unpacked: it is in no remote
    /// control and takes clients' commands all the same.
    NotEnabled,
}

/// Modes of the controller.
#[derive(Clone, Debug)]
pub struct Modes {
    power: Power,
    safety: Safety,
    control: Control,
    /// Counts switches between local and remote control: connections made before the last one are stale.
    switches: u64,
}

impl Modes {
    /// Powered and free, or powered off.
    pub fn new(running: bool, control: Control) -> Modes {
        let power = if running { Power::Running } else { Power::Off };
        Modes { power, safety: Safety::Normal, control, switches: 0 }
    }

    /// One frame.
    pub fn advance(&mut self) {
        self.power = match self.power {
            Power::Booting { frames_left: 0, then_release: false } => Power::Idle,
            Power::Booting { frames_left: 0, then_release: true } => {
                Power::Releasing { frames_left: RELEASING_FRAMES }
            }
            Power::Booting { frames_left, then_release } => {
                Power::Booting { frames_left: frames_left - 1, then_release }
            }
            Power::Releasing { frames_left: 0 } => Power::Running,
            Power::Releasing { frames_left } => Power::Releasing { frames_left: frames_left - 1 },
            Power::Off | Power::Idle | Power::Running => self.power,
        };
    }

    /// Arm power on; without effect if it is on or may not be.
    pub fn power_on(&mut self) {
        self.boot(false);
    }

    fn boot(&mut self, then_release: bool) {
        if self.power == Power::Off && !matches!(self.safety, Safety::Emergency | Safety::Fault) {
            self.power = Power::Booting { frames_left: BOOTING_FRAMES, then_release };
        }
    }

    /// Brakes open; powers the arm on first if need be.
    pub fn release_brakes(&mut self) {
        match self.power {
            Power::Idle => self.power = Power::Releasing { frames_left: RELEASING_FRAMES },
            Power::Off => self.boot(true),
            Power::Booting { frames_left, .. } => {
                self.power = Power::Booting { frames_left, then_release: true };
            }
            Power::Releasing { .. } | Power::Running => {}
        }
    }

    /// Arm power off.
    pub fn power_off(&mut self) {
        self.power = Power::Off;
    }

    /// True if this changed anything.
    pub fn protective_stop(&mut self, step: u64) -> bool {
        let reduced = self.safety == Safety::Other(REDUCED);
        let possible = reduced || self.safety == Safety::Normal || self.safety == Safety::Safeguard;
        if possible {
            self.safety = Safety::Protective { since: step, reduced };
        }
        possible
    }

    /// Ends a protective stop that is at least 5 s old.
    ///
    /// # Errors
    /// The dashboard's sentence.
    pub fn unlock(&mut self, step: u64) -> Result<(), String> {
        match self.safety {
            Safety::Protective { since, .. } if step.saturating_sub(since) < UNLOCK_FRAMES => {
                return Err(UNLOCK_TOO_EARLY.to_owned());
            }
            _ => self.unlock_at_once(),
        }
        Ok(())
    }

    /// Ends a protective stop however old it is; other stops stay.
    pub fn unlock_at_once(&mut self) {
        if let Safety::Protective { reduced, .. } = self.safety {
            self.safety = if reduced { Safety::Other(REDUCED) } else { Safety::Normal };
        }
    }

    /// The emergency stop button.
    pub fn emergency_stop(&mut self, pressed: bool) {
        if pressed {
            self.safety = Safety::Emergency;
            self.power = Power::Off;
        } else if self.safety == Safety::Emergency {
            self.safety = Safety::Normal;
        }
    }

    /// The safeguard circuit; true if this changed anything.
    pub fn safeguard_stop(&mut self, open: bool) -> bool {
        let (from, to) =
            if open { (Safety::Normal, Safety::Safeguard) } else { (Safety::Safeguard, Safety::Normal) };
        let changes = self.safety == from;
        if changes {
            self.safety = to;
        }
        changes
    }

    /// Shows a safety mode by its number; absent: back to normal.
    pub fn show_safety(&mut self, number: Option<i32>) {
        match (number, self.safety) {
            (Some(number), _) => self.safety = Safety::Other(number),
            (None, Safety::Other(_)) => self.safety = Safety::Normal,
            (None, Safety::Protective { since, .. }) => {
                self.safety = Safety::Protective { since, reduced: false };
            }
            (None, _) => {}
        }
    }

    /// A fault of the safety system: arm power off until it is restarted.
    pub fn fault(&mut self) {
        self.safety = Safety::Fault;
        self.power = Power::Off;
    }

    /// Back to normal, powered off.
    pub fn restart_safety(&mut self) {
        self.power = Power::Off;
        if self.safety != Safety::Emergency {
            self.safety = Safety::Normal;
        }
    }

    /// Switches between remote (true) and local control; a controller whose remote control is not enabled
    /// has no such switch.
    pub fn set_remote(&mut self, remote: bool) {
        let control = if remote { Control::Remote } else { Control::Local };
        if self.control != Control::NotEnabled && self.control != control {
            self.control = control;
            self.switches += 1;
        }
    }

    /// Remote control is on.
    pub fn remote(&self) -> bool {
        self.control == Control::Remote
    }

    /// Clients may command the arm.
    pub fn takes_commands(&self) -> bool {
        self.control != Control::Local
    }

    /// Number of switches between local and remote so far.
    pub fn switches(&self) -> u64 {
        self.switches
    }

    /// Brakes are open.
    pub fn brakes_open(&self) -> bool {
        self.power == Power::Running
    }

    /// Arm has power.
    pub fn powered(&self) -> bool {
        matches!(self.power, Power::Idle | Power::Releasing { .. } | Power::Running)
    }

    /// Number of the mode all joints are in.
    pub fn joint_mode(&self) -> i32 {
        match (self.powered(), self.brakes_open()) {
            (_, true) => JOINT_RUNNING,
            (true, false) => JOINT_IDLE,
            (false, false) => JOINT_OFF,
        }
    }

    /// Safety lets the arm move.
    pub fn motion_allowed(&self) -> bool {
        self.safety_mode().allows_motion()
    }

    /// A protective stop is in force.
    pub fn protective_stopped(&self) -> bool {
        matches!(self.safety, Safety::Protective { .. })
    }

    /// An emergency stop is in force.
    pub fn emergency_stopped(&self) -> bool {
        self.safety == Safety::Emergency
    }

    /// As clients see it.
    pub fn robot_mode(&self) -> RobotMode {
        match self.power {
            Power::Off => RobotMode::PowerOff,
            Power::Booting { .. } => RobotMode::Booting,
            Power::Idle | Power::Releasing { .. } => RobotMode::Idle,
            Power::Running => RobotMode::Running,
        }
    }

    /// As clients see it.
    pub fn safety_mode(&self) -> SafetyMode {
        match self.safety {
            Safety::Normal => SafetyMode::Normal,
            Safety::Protective { .. } => SafetyMode::ProtectiveStop,
            Safety::Safeguard => SafetyMode::SafeguardStop,
            Safety::Emergency => SafetyMode::RobotEmergencyStop,
            Safety::Fault => SafetyMode::Fault,
            Safety::Other(number) => SafetyMode::from_code(number),
        }
    }

    /// Bits of `safety_status_bits`; bit 10 is "stopped due to safety".
    pub fn safety_status_bits(&self) -> u32 {
        match self.safety {
            Safety::Normal => 1,
            Safety::Protective { .. } => 1 << 2 | 1 << 10,
            Safety::Safeguard => 1 << 4 | 1 << 10,
            Safety::Emergency => 1 << 6 | 1 << 7 | 1 << 10,
            Safety::Fault => 1 << 9 | 1 << 10,
            Safety::Other(REDUCED) => 1 << 1,
            Safety::Other(4) => 1 << 3 | 1 << 10,
            Safety::Other(6) => 1 << 5 | 1 << 7 | 1 << 10,
            Safety::Other(8) => 1 << 8 | 1 << 10,
            Safety::Other(_) => 1 << 10,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(mut modes: Modes, frames: u32) -> Modes {
        (0..frames).for_each(|_| modes.advance());
        modes
    }

    #[test]
    fn power_comes_step_by_step() {
        let mut modes = Modes::new(false, Control::Remote);
        modes.power_on();
        assert_eq!(modes.robot_mode(), RobotMode::Booting);
        let mut modes = after(modes, BOOTING_FRAMES + 1);
        assert_eq!(modes.robot_mode(), RobotMode::Idle);
        modes.release_brakes();
        assert!(!modes.brakes_open(), "the reply is not the completion");
        assert!(after(modes, RELEASING_FRAMES + 1).brakes_open());
    }

    #[test]
    fn releasing_the_brakes_of_an_arm_without_power_switches_it_on_first() {
        let mut modes = Modes::new(false, Control::Remote);
        modes.release_brakes();
        let modes = after(modes, BOOTING_FRAMES + 1);
        assert!(modes.powered() && !modes.brakes_open());
        assert!(after(modes, RELEASING_FRAMES + 1).brakes_open());
    }

    #[test]
    fn reduced_mode_lets_the_arm_move_and_shows() {
        let mut modes = Modes::new(true, Control::Remote);
        modes.show_safety(Some(2));
        assert!(modes.motion_allowed());
        assert_eq!((modes.safety_mode(), modes.safety_status_bits()), (SafetyMode::Reduced, 2));
        modes.show_safety(Some(8));
        assert!(!modes.motion_allowed());
        modes.show_safety(None);
        assert_eq!(modes.safety_mode(), SafetyMode::Normal);
    }

    #[test]
    fn a_protective_stop_waits_five_seconds() {
        let mut modes = Modes::new(true, Control::Remote);
        assert!(modes.protective_stop(100) && !modes.protective_stop(101));
        assert!(modes.unlock(100 + UNLOCK_FRAMES - 1).is_err());
        assert_eq!(modes.safety_status_bits(), 0x404);
        assert!(modes.unlock(100 + UNLOCK_FRAMES).is_ok());
        assert!(modes.motion_allowed() && modes.brakes_open());
    }

    #[test]
    fn a_protective_stop_in_reduced_mode_leaves_it_reduced() {
        let mut modes = Modes::new(true, Control::Remote);
        modes.show_safety(Some(REDUCED));
        assert!(modes.protective_stop(100) && modes.protective_stopped());
        modes.unlock_at_once();
        assert_eq!(modes.safety_mode(), SafetyMode::Reduced);
        assert!(modes.protective_stop(200));
        modes.show_safety(None);
        assert!(modes.protective_stopped(), "another mode is no way out of it");
        modes.unlock_at_once();
        assert_eq!(modes.safety_mode(), SafetyMode::Normal);
    }

    #[test]
    fn an_emergency_stop_takes_the_power_and_needs_release() {
        let mut modes = Modes::new(true, Control::Remote);
        modes.emergency_stop(true);
        modes.power_on();
        assert_eq!(
            (modes.robot_mode(), modes.safety_mode()),
            (RobotMode::PowerOff, SafetyMode::RobotEmergencyStop)
        );
        modes.restart_safety();
        assert!(modes.emergency_stopped(), "a restart does not release the button");
        modes.emergency_stop(false);
        assert!(modes.motion_allowed() && !modes.powered());
    }

    #[test]
    fn a_fault_needs_a_restart() {
        let mut modes = Modes::new(true, Control::Remote);
        modes.fault();
        modes.power_on();
        assert_eq!(modes.robot_mode(), RobotMode::PowerOff);
        modes.restart_safety();
        modes.power_on();
        assert_eq!(modes.robot_mode(), RobotMode::Booting);
    }

    #[test]
    fn every_switch_of_control_is_counted() {
        let mut modes = Modes::new(true, Control::Remote);
        modes.set_remote(true);
        modes.set_remote(false);
        modes.set_remote(true);
        assert_eq!((modes.remote(), modes.switches()), (true, 2));
    }
}
