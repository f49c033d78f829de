//! Arming lapses: what ends a person's leave to move although nothing has to be stopped for it (design,
//! section 7, rule 2).
//!
//! In: the devices' state on every tick of an armed cell. Out: the cell disarmed as by an order to disarm: a
//! pick-n-place under way is finished, the job waits, nothing begins before a person has armed again.
//! Whoever armed the cell has seen it as it was: a link that comes back, an arm that was switched or moved
//! by others, or ten quiet minutes mean that this is not so any more. Stops and safety events are in
//! `faults`.

use crate::code::{Code, JobStatus};
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::motion_speed;
use crate::supervisor::input::{Action, DeviceSnapshot};
use crate::supervisor::mode::PowerStep;
use crate::supervisor::phase::{Phase, Quiet};
use crate::supervisor::reason::{alarm, with_fault};
use crate::supervisor::safety_words::mode_words;
use cell_values::time::{Duration, Timestamp};
use ur_wire::enumerations::RobotMode;

/// An arm at rest whose joint turns by more was moved by others, rad: brakes that open let it sink by less.
pub(crate) const MOVED_RAD: f64 = 0.02;

impl Supervisor {
    /// Disarms the cell when arming does not hold any more.
    pub(crate) fn watch_arming(&mut self, now: Timestamp, devices: &DeviceSnapshot, out: &mut Vec<Action>) {
        let quiet_for = self.follow_quiet(now, devices);
        if !self.mode.armed() {
            return;
        }
        if let Some(why) = self.why_lapsed(devices).or_else(|| self.too_quiet(quiet_for)) {
            self.lapse(now, devices, &why, out);
        }
    }

    /// How long an armed cell has not moved the arm; notes where it rests.
    fn follow_quiet(&mut self, now: Timestamp, devices: &DeviceSnapshot) -> Duration {
        let rests = match self.phase {
            Phase::Ready | Phase::Approve => true,
            // A long plan is no idleness.
            Phase::Plan
            | Phase::BringUp(_)
            | Phase::Look(_)
            | Phase::Work(_)
            | Phase::Park
            | Phase::Visit(_)
            | Phase::Recover(_) => false,
        };
        if !self.mode.armed() || !rests {
            self.quiet = None;
            return Duration::ZERO;
        }
        let quiet = self.quiet.get_or_insert(Quiet { since: now, at: None });
        let still = devices.robot.filter(|robot| devices.robot_fresh && robot.stands_still());
        quiet.at = quiet.at.or(still.map(|robot| robot.q));
        now.since(quiet.since)
    }

    /// The present step of the arm's power.
    fn power_step(&self, devices: &DeviceSnapshot) -> Option<PowerStep> {
        let robot = devices.robot?;
        let ordered = matches!(&self.phase, Phase::BringUp(bring_up) if bring_up.requested.is_some());
        PowerStep::of(robot.robot_mode, ordered)
    }

    /// The arm's power or brakes went back since the cell was armed, and not by celld.
    pub(crate) fn power_was_switched(&self, devices: &DeviceSnapshot) -> bool {
        self.mode.power_fell_to(self.power_step(devices))
    }

    /// Notes how far the arm has come since the cell was armed.
    pub(crate) fn note_power(&mut self, devices: &DeviceSnapshot) {
        if let Some(step) = self.power_step(devices) {
            self.mode.note_power(step);
        }
    }

    fn too_quiet(&self, quiet_for: Duration) -> Option<String> {
        let limit = self.model.tolerances.arm_lapse;
        (quiet_for >= limit)
            .then(|| format!("nothing has moved for {} s (`arm_lapse_s`)", limit.as_secs_f64().round()))
    }

    /// The first reason, other than time, for which arming does not hold any more.
    fn why_lapsed(&self, devices: &DeviceSnapshot) -> Option<String> {
        if let Some(link) = devices.link_lost {
            return Some(format!("the {link} link was lost ({})", self.model.addresses.robot));
        }
        if !devices.gripper_answers && self.round.is_none() {
            let stopped = format!("gripper not responding ({})", self.model.addresses.gripper);
            return Some(with_fault(stopped, devices.gripper_fault));
        }
        let robot = devices.robot.filter(|_| devices.robot_fresh)?;
        if robot.guided || robot.robot_mode == RobotMode::Backdrive {
            return Some("the arm is guided by hand".to_string());
        }
        let starts = matches!(self.phase, Phase::BringUp(_)) && !self.power_was_switched(devices);
        if robot.robot_mode != RobotMode::Running && !starts {
            let mode = mode_words(robot.robot_mode);
            return Some(format!("power or brakes were switched, and not by celld: {mode}"));
        }
        let rest = self.quiet.and_then(|quiet| quiet.at)?;
        (robot.q.max_difference(&rest) > MOVED_RAD).then(|| "the arm was moved, and not by celld".to_string())
    }

    /// Disarms as an order to disarm does. What is held in the middle of a motion must not go on by itself
    /// later, and a calibration round ends.
    fn lapse(&mut self, now: Timestamp, devices: &DeviceSnapshot, why: &str, out: &mut Vec<Action>) {
        let held = self.moving() && motion_speed(devices) == 0.0;
        if held || self.round.is_some() || self.back.recovery.is_some() {
            let reason = Code::ArmingLapsed.because(why, "");
            return self.stop_what_has_begun(now, JobStatus::Interrupted, reason, out);
        }
        let goes_on = self.disarm_after_this_motion(now, devices, out);
        let first = match (goes_on, &self.phase) {
            (true, Phase::Work(work)) if work.then.is_none() => {
                "; the pick-n-place under way is finished first, `celld abort` stops it now"
            }
            (true, _) => "; the motion under way goes on to its next stop, `celld abort` stops it now",
            (false, _) => "",
        };
        let back = match devices.link_lost.is_some() || !devices.gripper_answers {
            true => "check its power and network; once it answers and the cell is clear, `celld arm`",
            false => "see that the cell is clear, then `celld arm`",
        };
        alarm(out, format!("disarmed: {why}{first}; {back}"));
    }
}
