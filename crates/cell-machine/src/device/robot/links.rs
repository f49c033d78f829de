//! What the three link sessions report, turned into the robot's own events and state.
//!
//! In: events of the link sessions, the state of RTDE. Out: [`RobotEvent`]s, calls into the program's life.

use crate::device::dashboard_session::DashboardEvent;
use crate::device::primary_session::PrimaryEvent;
use crate::device::robot::Robot;
use crate::device::robot::parts::{Identity, PoweringOff};
use crate::device::robot_types::{Link, ProgramEnd, RobotEvent, RobotState};
use crate::device::rtde_session::RtdeEvent;
use cell_values::time::{Duration, Timestamp};
use ur_arm::kinematics::DhParameters;
use ur_wire::dashboard::{Command, Reply};
use ur_wire::enumerations::{RobotMode, RuntimeState, SafetyMode};

/// The real arm takes 3 to 8 s to power on and 2 to 5 s to release its brakes.
const POWERED_WITHIN: Duration = Duration::from_secs(15);
/// An arm that has been off for so long after `power off` was accepted stays off.
const STAYS_OFF: Duration = Duration::from_secs(1);
/// Jumps of a joint that follow sooner are the same one.
const JUMPS_AGAIN_AFTER: Duration = Duration::from_secs(1);

impl Robot {
    /// Takes everything the link sessions have to say.
    pub(super) fn take_link_events(&mut self, now: Timestamp) {
        while let Some(event) = self.rtde.poll_event() {
            self.rtde_event(now, event);
        }
        while let Some(event) = self.dashboard.poll_event() {
            self.dashboard_event(now, event);
        }
        while let Some(event) = self.primary.poll_event() {
            self.primary_event(now, event);
        }
        if self.rtde.poll_close() {
            self.closes.push_back(Link::Rtde);
        }
        if self.dashboard.poll_close() {
            self.closes.push_back(Link::Dashboard);
        }
        if self.primary.poll_close() {
            self.closes.push_back(Link::Primary);
        }
    }

    fn rtde_event(&mut self, now: Timestamp, event: RtdeEvent) {
        match event {
            RtdeEvent::Ready => self.report(RobotEvent::RtdeReady),
            RtdeEvent::InUse { taken, attempt } => self.report(RobotEvent::InputInUse { taken, attempt }),
            RtdeEvent::Message(text) => self.report(RobotEvent::Message { text }),
            RtdeEvent::Jump(detail) => self.joint_jumped(now, detail),
            RtdeEvent::Silent(detail) => {
                self.report(RobotEvent::LinkSilent { link: Link::Rtde, detail });
                self.rtde_gone(now);
            }
            RtdeEvent::Fault(detail) => {
                self.report_fault(now, Link::Rtde, detail);
                self.rtde_gone(now);
            }
        }
    }

    /// Where the arm is cannot be trusted: a program of ours is stopped here already. While none may move
    /// it, positions that jump with every package are reported once a second.
    fn joint_jumped(&mut self, now: Timestamp, detail: String) {
        let moves = self.program.may_move();
        if moves || self.jumped.is_none_or(|at| now.since(at) >= JUMPS_AGAIN_AFTER) {
            self.jumped = Some(now);
            self.report(RobotEvent::JointJump { detail });
        }
        if moves {
            self.stop(now);
        }
    }

    /// The RTDE connection is gone.
    pub(super) fn lose_rtde(&mut self, now: Timestamp) {
        self.rtde.disconnected();
        self.rtde_gone(now);
    }

    fn rtde_gone(&mut self, now: Timestamp) {
        if self.state.take().is_some() {
            self.report(RobotEvent::RtdeLost);
        }
        self.reported.mode = None;
        self.reported.safety = None;
        self.reported.paused = false;
        self.program_lost_rtde(now);
    }

    /// The dashboard connection is gone; commands without an answer failed.
    pub(super) fn lose_dashboard(&mut self, reason: &str) {
        self.dashboard.disconnected();
        self.dropped.clear();
        self.remote_control_before = self.remote_control.take().or(self.remote_control_before);
        if let Some(state) = &mut self.state {
            state.remote_control = None;
        }
        for wait in std::mem::take(&mut self.arm_waits) {
            let reply = format!("dashboard connection lost: {reason}");
            self.report(RobotEvent::Refused { what: wait.what.into(), reply });
        }
    }

    fn dashboard_event(&mut self, now: Timestamp, event: DashboardEvent) {
        match event {
            DashboardEvent::Silent(detail) => {
                self.lose_dashboard(&detail);
                self.report(RobotEvent::LinkSilent { link: Link::Dashboard, detail });
                self.closes.push_back(Link::Dashboard);
            }
            DashboardEvent::Fault(detail) => {
                self.lose_dashboard(&detail);
                self.report_fault(now, Link::Dashboard, detail);
                self.closes.push_back(Link::Dashboard);
            }
            DashboardEvent::Reply { command, reply } => self.dashboard_reply(now, command, reply),
        }
    }

    fn dashboard_reply(&mut self, now: Timestamp, command: Command, reply: Reply) {
        if let Some(at) = self.dropped.iter().position(|dropped| *dropped == command) {
            self.dropped.remove(at);
            return;
        }
        match (command, reply) {
            (Command::PolyscopeVersion, Reply::Text(text)) => self.identify(|i| i.version = Some(text)),
            (Command::GetSerialNumber, Reply::Text(text)) => self.identify(|i| i.serial = Some(text)),
            (Command::GetRobotModel, Reply::Text(text)) => self.identify(|i| i.model = Some(text)),
            (Command::IsInRemoteControl, Reply::Flag(on)) => {
                self.remote_control_at = now;
                self.remote_control_is(on);
            }
            (Command::RobotMode, Reply::RobotMode(mode)) => self.modes_without_rtde(now, Some(mode), None),
            (Command::SafetyMode, Reply::SafetyMode(mode)) => self.modes_without_rtde(now, None, Some(mode)),
            (Command::Stop, Reply::Accepted(_)) => self.dashboard_stopped(),
            (Command::PowerOff, Reply::Accepted(_)) => {
                if let Some(powering) = &mut self.powering_off {
                    powering.accepted = true;
                }
            }
            (Command::CloseSafetyPopup, Reply::Accepted(_)) => {
                self.report(RobotEvent::Completed { what: "close safety popup".into() });
            }
            // Power, brakes and unlock: accepted is not done, the arm's modes show it.
            (command, Reply::Accepted(_)) => {
                self.arm_waits.iter_mut().filter(|wait| wait.command == command).for_each(|wait| {
                    wait.answered = true;
                });
            }
            (command, refusal) => self.dashboard_refused(&command, &refusal),
        }
    }

    /// A stop came: power and brakes are wanted no more. What was sent already is answered still, and the
    /// answer must not count for the same command sent again later; nor may the brakes open seconds after a
    /// person was informed that the arm is at rest.
    pub(super) fn drop_arm_waits(&mut self, now: Timestamp) {
        for wait in std::mem::take(&mut self.arm_waits) {
            if self.dashboard.forget(&wait.command) {
                self.powers = wait.powered_before;
            } else if !wait.answered {
                self.dropped.push(wait.command);
            }
        }
        if std::mem::take(&mut self.powers) {
            // Without a dashboard what was sent comes true, and the time that it takes at most passes.
            let _ = self.dashboard.request_first(now, Command::PowerOff);
            let until = now + POWERED_WITHIN;
            self.powering_off = Some(PoweringOff { accepted: false, off_since: None, until });
        }
    }

    /// Whether the arm is off, and stays so, after a stop took power and brakes back.
    pub(super) fn follow_powering_off(&mut self, now: Timestamp) {
        let mode = self.state.as_ref().map(|state| state.robot_mode);
        // An arm that is ready stays powered: a stop in its work is none of its bring-up.
        self.powers &= mode != Some(RobotMode::Running);
        let off = mode == Some(RobotMode::PowerOff);
        self.powering_off.take_if(|powering| {
            // Right after the answer the last state may be from before what was ordered first.
            let counts = powering.accepted && off;
            powering.off_since = powering.off_since.or(Some(now)).filter(|_| counts);
            now >= powering.until || powering.off_since.is_some_and(|since| now.since(since) >= STAYS_OFF)
        });
    }

    fn dashboard_refused(&mut self, command: &Command, reply: &Reply) {
        self.arm_waits.retain(|wait| wait.command != *command);
        let what = command.line().trim_end().to_string();
        let reply = reply.line(command).trim_end().to_string();
        self.report(RobotEvent::Refused { what, reply });
        if *command == Command::Stop {
            self.dashboard_stop_refused();
        }
    }

    fn identify(&mut self, set: impl FnOnce(&mut Identity)) {
        set(&mut self.identity);
        let Identity { serial: Some(serial), model: Some(model), version: Some(version), reported: false } =
            &self.identity
        else {
            return;
        };
        let (serial, model, version) = (serial.clone(), model.clone(), version.clone());
        self.identity.reported = true;
        self.report(RobotEvent::Identity { serial, model, version });
    }

    /// After a switch between local and remote the controller wants both links made anew: until then it goes
    /// on refusing, and the primary interface stays read-only.
    fn remote_control_is(&mut self, on: bool) {
        let before = self.remote_control.replace(on).or(self.remote_control_before);
        if let Some(state) = &mut self.state {
            state.remote_control = Some(on);
        }
        if before == Some(on) {
            return;
        }
        self.report(RobotEvent::RemoteControl { on });
        if before.is_some() {
            self.lose_dashboard("remote control was switched");
            self.closes.push_back(Link::Dashboard);
            self.primary.disconnected();
            self.closes.push_back(Link::Primary);
        }
    }

    fn modes_without_rtde(&mut self, now: Timestamp, mode: Option<RobotMode>, safety: Option<SafetyMode>) {
        if self.rtde.ready() {
            return;
        }
        if let Some(mode) = mode {
            self.mode_is(now, mode);
        }
        if let Some(safety) = safety {
            self.safety_is(now, safety);
        }
    }

    fn mode_is(&mut self, now: Timestamp, mode: RobotMode) {
        if self.reported.mode.replace(mode) == Some(mode) {
            return;
        }
        self.report(RobotEvent::Mode { mode });
        if !mode.is_known() {
            self.report_fault(now, Link::Rtde, format!("robot_mode has {mode}"));
        }
    }

    fn safety_is(&mut self, now: Timestamp, mode: SafetyMode) {
        if self.reported.safety.replace(mode) == Some(mode) {
            return;
        }
        self.report(RobotEvent::Safety { mode });
        if !mode.is_known() {
            self.report_fault(now, Link::Rtde, format!("safety_mode has {mode}"));
        }
    }

    fn primary_event(&mut self, now: Timestamp, event: PrimaryEvent) {
        match event {
            PrimaryEvent::Kinematics(data) => {
                self.dh = DhParameters { a: data.a, d: data.d, alpha: data.alpha, theta: data.theta };
                self.report(RobotEvent::Kinematics { dh: self.dh, checksum: data.checksum });
            }
            PrimaryEvent::SafetyChecksum(checksum) => self.report(RobotEvent::SafetyChecksum { checksum }),
            // The nonce over RTDE says more than the name does.
            PrimaryEvent::ProgramStarted(_) => {}
            PrimaryEvent::ProgramStopped(name) => self.program_stopped_message(&name),
            PrimaryEvent::RuntimeException { line, column, text } => {
                self.exception = Some(ProgramEnd::Exception { line, column, text: text.clone() });
                self.report(RobotEvent::RuntimeException { line, column, text });
                self.program_failed();
            }
            PrimaryEvent::ReadOnly => self.upload_refused(),
            PrimaryEvent::ErrorCode { code, argument, level, text } => {
                self.report(RobotEvent::ErrorCode { code, argument, level, text });
            }
            PrimaryEvent::Message(text) => self.report(RobotEvent::Message { text }),
            PrimaryEvent::Silent(detail) => {
                self.report(RobotEvent::LinkSilent { link: Link::Primary, detail });
                self.closes.push_back(Link::Primary);
                self.primary.disconnected();
            }
            PrimaryEvent::Fault(detail) => {
                self.report_fault(now, Link::Primary, detail);
                self.closes.push_back(Link::Primary);
                self.primary.disconnected();
            }
        }
    }

    /// Takes over the latest state and reports what changed in it.
    pub(super) fn take_state(&mut self, now: Timestamp) {
        let Some(latest) = self.rtde.latest() else { return };
        let state = RobotState { remote_control: self.remote_control, ..latest.clone() };
        self.mode_is(now, state.robot_mode);
        self.safety_is(now, state.safety_mode);
        let paused = match state.runtime_state {
            RuntimeState::Pausing | RuntimeState::Paused => true,
            RuntimeState::Stopping
            | RuntimeState::Stopped
            | RuntimeState::Playing
            | RuntimeState::Resuming
            | RuntimeState::Unknown(_) => false,
        };
        let playing = state.runtime_state == RuntimeState::Playing;
        self.state = Some(state);
        if paused && !self.reported.paused {
            self.reported.paused = true;
            self.report(RobotEvent::Paused);
        } else if self.reported.paused && !paused {
            self.reported.paused = false;
            if playing {
                self.report(RobotEvent::Resumed);
            }
        }
    }

    /// Things requested of the arm: done, or overdue.
    pub(super) fn check_arm_waits(&mut self, now: Timestamp) {
        for wait in std::mem::take(&mut self.arm_waits) {
            if self.state.as_ref().is_some_and(|state| wait.goal.reached(state)) {
                self.powers = false;
                self.report(RobotEvent::Completed { what: wait.what });
            } else if now >= wait.deadline {
                let reply = "accepted, but not done in time".into();
                self.report(RobotEvent::Refused { what: wait.what.into(), reply });
            } else {
                self.arm_waits.push(wait);
            }
        }
    }
}
