//! Which robot it is, held for as long as celld runs.
//!
//! In: what the controller says of itself on every connection: serial number, model, software, kinematics,
//! checksum of the safety configuration. Out: a locked cell as soon as any of it differs from what it was
//! when the cell was commissioned. Calibration, limits and the integrator's risk assessment hold for one arm
//! with one safety configuration; what comes back after a lost connection may be another.

use crate::code::Code;
use crate::device::robot_types::{KnownRobot, RobotEvent, RobotIdentity};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::reason::Reason;

const CALIBRATE_AGAIN: &str = "end celld, `celld calibrate`, start it again";

impl Supervisor {
    /// The robot that the cell was commissioned for; nothing else may take its place.
    pub fn commissioned_for(&mut self, robot: KnownRobot) {
        self.robot = robot;
    }

    /// Locks the cell where an event shows that it is not the robot any more.
    pub(crate) fn other_robot(&mut self, event: &RobotEvent) -> Option<Reason> {
        let difference = self
            .other_identity(event)
            .or_else(|| self.other_safety_configuration(event))
            .or_else(|| self.other_kinematics(event))?;
        let Difference { what, hint } = difference;
        // A locked cell has no ways back: what hangs on the cups is taken off by hand.
        let hands = match self.may_be_held() {
            true => "hold what hangs on the cups by hand and `celld release --yes`, then ",
            false => "",
        };
        let hint = format!("{hands}{hint}");
        self.mode.lock(format!("{what}; {hint}"));
        Some(Code::OtherRobot.because(what, hint))
    }

    fn other_identity(&mut self, event: &RobotEvent) -> Option<Difference> {
        let RobotEvent::Identity { serial, model, version } = event else { return None };
        let now = RobotIdentity { model: model.clone(), serial: serial.clone(), version: version.clone() };
        let before = self.robot.identity.get_or_insert(now.clone());
        if *before == now {
            return None;
        }
        let same_arm = (&before.model, &before.serial) == (&now.model, &now.serial);
        let hint =
            if same_arm { "end celld, read what has changed, start it again" } else { CALIBRATE_AGAIN };
        Some(Difference {
            what: match same_arm {
                true => format!("the robot's software was changed: {now}; celld started with {before}"),
                false => format!("another robot answers: {now}; celld started with {before}"),
            },
            hint,
        })
    }

    fn other_safety_configuration(&mut self, event: &RobotEvent) -> Option<Difference> {
        let RobotEvent::SafetyChecksum { checksum } = event else { return None };
        let before = *self.robot.safety_checksum.get_or_insert(*checksum);
        let what = format!(
            "the robot's safety configuration was changed: its checksum is {checksum:08x}, it was \
             {before:08x}"
        );
        let hint = "see that it is the one of the risk assessment, end celld, start it again";
        (before != *checksum).then_some(Difference { what, hint })
    }

    fn other_kinematics(&self, event: &RobotEvent) -> Option<Difference> {
        let RobotEvent::Kinematics { dh, .. } = event else { return None };
        let what =
            "another arm answers, or it was calibrated anew: its kinematics differ from those celld started \
                    with"
                .to_string();
        let same_arm = dh == self.model.arm.kinematics.dh();
        (!same_arm).then_some(Difference { what, hint: CALIBRATE_AGAIN })
    }
}

/// What is not as it was, and what to do.
struct Difference {
    what: String,
    hint: &'static str,
}
