//! What a person reads before choosing a way back: `celld recover` without a choice.
//!
//! In: the last stop, the controller's last error, the robot's state, what hangs on the gripper. Out: a few
//! lines: what happened, how the robot is, what is held and where, who else holds the inputs that celld
//! needs, and every way back with what it would do, or why it cannot be taken now.

use crate::device::robot_types::RobotEvent;
use crate::orders::WayBack;
use crate::supervisor::cell::Supervisor;
use crate::supervisor::gates::{self, GateClosed};
use crate::supervisor::input::DeviceSnapshot;
use crate::supervisor::recovery::protective;
use cell_values::time::Timestamp;
use ur_wire::enumerations::SafetyMode;
use ur_wire::error_codes::meaning;

/// The ways, with their options.
const WAYS: [(WayBack, &str); 4] = [
    (WayBack::Place, "--place"),
    (WayBack::Hold, "--hold"),
    (WayBack::Release, "--release"),
    (WayBack::Retreat, "--retreat"),
];

impl Supervisor {
    /// Keeps what `celld recover` shows later.
    pub(crate) fn note_for_the_way_back(&mut self, now: Timestamp, event: &RobotEvent) {
        match event {
            RobotEvent::Safety { mode: SafetyMode::ProtectiveStop } => {
                self.back.protective_since.get_or_insert(now);
            }
            RobotEvent::Safety { .. } => self.back.protective_since = None,
            RobotEvent::ErrorCode { code, argument, .. } => self.back.error = Some((*code, *argument)),
            RobotEvent::InputInUse { taken, .. } => self.back.registers_taken = Some(taken.clone()),
            RobotEvent::RtdeReady => self.back.registers_taken = None,
            RobotEvent::RtdeLost
            | RobotEvent::Identity { .. }
            | RobotEvent::Kinematics { .. }
            | RobotEvent::SafetyChecksum { .. }
            | RobotEvent::RemoteControl { .. }
            | RobotEvent::ProgramRunning { .. }
            | RobotEvent::ProgramEnded { .. }
            | RobotEvent::SegmentFinished { .. }
            | RobotEvent::PathFinished { .. }
            | RobotEvent::PayloadSet
            | RobotEvent::TcpSet
            | RobotEvent::Stopped
            | RobotEvent::Paused
            | RobotEvent::Resumed
            | RobotEvent::Mode { .. }
            | RobotEvent::Completed { .. }
            | RobotEvent::Refused { .. }
            | RobotEvent::RuntimeException { .. }
            | RobotEvent::Message { .. }
            | RobotEvent::LinkSilent { .. }
            | RobotEvent::ArmStalled { .. }
            | RobotEvent::JointJump { .. }
            | RobotEvent::ProtocolFault { .. } => {}
        }
    }

    /// The lines of `celld recover`. The page has them in other languages too, phrase by phrase.
    pub(crate) fn situation(&self, now: Timestamp, devices: &DeviceSnapshot) -> String {
        let mut lines = vec![self.what_happened(now)];
        lines.extend(self.back.error.map(|(code, argument)| {
            let words =
                meaning(code, argument).unwrap_or_else(|| "see the maker's error code directory".into());
            format!("controller: C{code}A{argument}, {words}")
        }));
        lines.push(self.how_the_robot_is(devices));
        lines.extend(self.registers_taken());
        lines.push(self.what_is_held(devices));
        lines.extend(self.where_the_arm_is(devices));
        lines.push("ways back:".to_string());
        lines.extend(WAYS.map(|(way, option)| match self.may_recover(devices, way) {
            Ok(()) => format!("  celld recover {option:<10} {}", self.announce(devices, way)),
            Err(why) => format!("  not now: {option:<14} {why}"),
        }));
        lines.push(match self.mode.armed() {
            true => "the cell is armed".to_string(),
            false if !self.mode.can_be_armed() => {
                "`celld arm` is refused: the cell is locked or ends".to_string()
            }
            false => match self.may_arm(devices) {
                Ok(()) => "`celld arm` goes on with jobs".to_string(),
                Err(closed) => format!("`celld arm` is refused: {}", self.place(&closed)),
            },
        });
        lines.join("\n")
    }

    /// The ways back that may be taken now, where there is a stop to leave or something that may hang on the
    /// gripper.
    pub(crate) fn ways_now(&self, devices: &DeviceSnapshot) -> Vec<WayBack> {
        let stopped = self.back.last_stop.is_some() || protective(devices);
        let holds = matches!(gates::empty_handed(devices), Err(GateClosed::Holding));
        let needed = stopped || self.holding_words().is_some() || holds;
        let ways = WAYS.map(|(way, _)| way).into_iter();
        ways.filter(|way| needed && self.may_recover(devices, *way).is_ok()).collect()
    }

    /// Inputs that celld needs and another client of the controller holds, and who that may be.
    pub(crate) fn registers_taken(&self) -> Option<String> {
        self.back.registers_taken.as_ref().map(ToString::to_string)
    }

    fn what_happened(&self, now: Timestamp) -> String {
        match &self.back.last_stop {
            None => "what happened: no stop that is still to be left".to_string(),
            Some(stop) => {
                let when = match stop.at {
                    Some(at) => format!("{} s ago", now.since(at).as_secs()),
                    None => "before this start".to_string(),
                };
                format!("what happened: {}; {}, {when}", stop.reason.message, stop.reason.code)
            }
        }
    }

    fn how_the_robot_is(&self, devices: &DeviceSnapshot) -> String {
        let down = devices.link_down.map(|link| GateClosed::Link(link).to_string());
        let Some(robot) = devices.robot.filter(|_| devices.robot_fresh) else {
            let why = down.unwrap_or_else(|| GateClosed::Stale.to_string());
            return format!("robot: {why} ({})", self.model.addresses.robot);
        };
        let control = match robot.remote_control {
            Some(true) => "remote control",
            Some(false) => "local control",
            None => "control not known",
        };
        format!(
            "robot: safety mode {}; robot mode {}; program {}; {control}{}",
            robot.safety_mode,
            robot.robot_mode,
            robot.runtime_state.to_string().to_lowercase(),
            down.map_or_else(String::new, |why| format!("; {why}"))
        )
    }

    fn what_is_held(&self, devices: &DeviceSnapshot) -> String {
        let Some([a, b]) = devices.vacuum.filter(|_| devices.gripper_answers) else {
            let at = &self.model.addresses.gripper;
            let object = self.back.held.as_ref().map_or("nothing", |held| held.object.as_str());
            return format!("held: not known, the gripper does not answer ({at}); before that: {object}");
        };
        let vacuum = format!("vacuum A {:.0} %, B {:.0} %", a * 100.0, b * 100.0);
        let unsealed = self.back.held.as_ref().is_some_and(|held| held.unsealed);
        let object = self.back.held.as_ref().map(|held| held.object.as_str());
        match (gates::empty_handed(devices).is_ok(), object) {
            (true, None) => format!("held: nothing ({vacuum})"),
            (true, Some(object)) => {
                let fell = self.back.fell.as_ref().map_or_else(String::new, |fell| format!("{fell}; "));
                format!("held: {fell}without vacuum {object} may hang on the cups ({vacuum})")
            }
            (false, Some(object)) => match &self.back.fell {
                Some(fell) => format!("held: {fell}, or hangs on the cups ({vacuum})"),
                None if unsealed => {
                    format!("held: {object} may hang on the cups: the grip did not seal ({vacuum})")
                }
                None => format!("held: {object} ({vacuum})"),
            },
            (false, None) => format!("held: something that celld did not pick ({vacuum})"),
        }
    }

    fn where_the_arm_is(&self, devices: &DeviceSnapshot) -> Option<String> {
        let robot = devices.robot?;
        let tool = self.model.arm.tool_at(&robot.q).translation.vector;
        // Rounded, and never "-0".
        let height = ((tool.z - self.held_height()) * 1e3).round() + 0.0;
        let what = match (&self.back.held, &self.back.fell) {
            (Some(held), None) if !held.unsealed => "what hangs on it",
            (Some(_), _) => "what may hang on it",
            (None, _) => "the cups",
        };
        Some(format!(
            "arm{}: tool at x {:.3} m, y {:.3} m; {what} {height:.0} mm over the table",
            if devices.robot_fresh { "" } else { ", as it was last known" },
            tool.x,
            tool.y
        ))
    }
}
