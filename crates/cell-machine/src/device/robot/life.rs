//! The life of the on-robot program: cleared for, uploaded, proved by nonce, fed, stopped, ended.
//!
//! In: the robot's state, messages of the other links, the time. Out: changes of [`Program`], heartbeats,
//! stops. Whatever cannot be explained ends in a stop: first by opcode, then by dashboard, last by silence.

use crate::device::program::{Nonce, program_name};
use crate::device::registers::{Opcode, ProgramStatus};
use crate::device::robot::Robot;
use crate::device::robot::parts::{Program, Setup};
use crate::device::robot_types::{Link, ProgramEnd, Refused, RobotEvent, RobotState};
use cell_values::time::{Duration, Timestamp};
use ur_wire::dashboard::Command;
use ur_wire::enumerations::RuntimeState;

/// Heartbeat period: five of them fit into the program's watchdog twice over.
const HEARTBEAT_EVERY: Duration = Duration::from_millis(20);
/// The program echoes the heartbeat each frame; this long without a new echo and it does not run.
const ECHO_WITHIN: Duration = Duration::from_millis(500);
/// From upload to nonce.
const START_WITHIN: Duration = Duration::from_secs(5);
/// From the stop opcode to standstill: 3.1 rad/s at 4 rad/s2 take 0.8 s.
const STOP_WITHIN: Duration = Duration::from_secs(2);
/// From the end opcode to the program's end, which may include a stop.
const END_WITHIN: Duration = Duration::from_secs(3);
/// From the dashboard's `stop` to the program's end.
const HALT_WITHIN: Duration = Duration::from_secs(3);

impl Robot {
    /// Uploads the program, after stopping what runs.
    pub(super) fn start_program(&mut self, now: Timestamp, nonce: Nonce) -> Result<(), Refused> {
        match &self.program {
            Program::Absent | Program::Running { .. } => {}
            Program::Clearing { .. }
            | Program::Starting { .. }
            | Program::Stopping { .. }
            | Program::Ending { .. }
            | Program::Halting { .. } => return Err(Refused::Busy("it is being started, stopped or ended")),
        }
        if !self.primary.ready() {
            return Err(Refused::NotConnected(Link::Primary));
        }
        let idle = self.state.as_ref().is_some_and(|state| state.runtime_state == RuntimeState::Stopped);
        if idle {
            self.upload(now, nonce, false, now + START_WITHIN);
            return Ok(());
        }
        if !self.dashboard.request_first(now, Command::Stop) {
            return Err(Refused::NotConnected(Link::Dashboard));
        }
        if !matches!(self.program, Program::Absent) {
            self.program_ended(ProgramEnd::AsRequested);
        }
        self.program = Program::Clearing { nonce, deadline: now + HALT_WITHIN };
        Ok(())
    }

    fn upload(&mut self, now: Timestamp, nonce: Nonce, retried: bool, deadline: Timestamp) {
        self.exception = None;
        self.stream.clear();
        self.setup = Setup::default();
        self.stop_written_for = None;
        let sent = self.primary.upload(&self.template.render_for(nonce, self.identity.version.as_deref()));
        self.program = Program::Starting { nonce, deadline, upload_again: !sent, retried };
        self.heartbeat.next = Some(now);
    }

    /// Stops the arm by the quickest way there is. What was wanted of power and brakes is wanted no more.
    pub(super) fn stop(&mut self, now: Timestamp) {
        self.drop_arm_waits(now);
        let runtime = self.state.as_ref().map(|state| state.runtime_state);
        match &mut self.program {
            Program::Running { .. } if runtime == Some(RuntimeState::Playing) => {
                self.stream.clear();
                self.setup.deadline = None;
                self.write_at_once(Opcode::Stop);
                self.program = Program::Stopping { deadline: now + STOP_WITHIN };
            }
            Program::Stopping { .. } => {}
            Program::Halting { requested, .. } => *requested = true,
            Program::Absent if runtime == Some(RuntimeState::Stopped) => self.report(RobotEvent::Stopped),
            Program::Absent => self.halt(now, None, true),
            // A paused program does not read its registers.
            Program::Running { .. }
            | Program::Clearing { .. }
            | Program::Starting { .. }
            | Program::Ending { .. } => self.halt(now, Some(ProgramEnd::StoppedByUs), true),
        }
    }

    /// Stops by dashboard and by silence. The opcode goes out as well: a program that is paused, and that
    /// the dashboard cannot end, reads it in the first frame after a person presses play.
    pub(super) fn halt(&mut self, now: Timestamp, reason: Option<ProgramEnd>, requested: bool) {
        self.stream.clear();
        self.setup.deadline = None;
        if self.program.reads_registers() {
            self.write_at_once(Opcode::Stop);
        }
        // If the dashboard is not there, silence alone has to do.
        let _ = self.dashboard.request_first(now, Command::Stop);
        self.program = Program::Halting { reason, requested, deadline: now + HALT_WITHIN };
    }

    /// Ends the program in good order.
    pub(super) fn end_program(&mut self, now: Timestamp) -> Result<(), Refused> {
        match &self.program {
            Program::Running { .. } => {}
            Program::Absent => return Err(Refused::NoProgram),
            Program::Clearing { .. } | Program::Starting { .. } => {
                return Err(Refused::Busy("it is being started"));
            }
            Program::Stopping { .. } | Program::Halting { .. } => {
                return Err(Refused::Busy("it is being stopped"));
            }
            Program::Ending { .. } => return Ok(()),
        }
        self.begin_end(now, ProgramEnd::AsRequested);
        Ok(())
    }

    fn begin_end(&mut self, now: Timestamp, reason: ProgramEnd) {
        self.stream.clear();
        self.setup.deadline = None;
        self.write_at_once(Opcode::End);
        self.program = Program::Ending { reason, deadline: now + END_WITHIN };
    }

    /// Our program is over, whatever the reason: nothing streamed to it counts any more.
    fn program_ended(&mut self, reason: ProgramEnd) {
        self.stop_written_for = None;
        self.program = Program::Absent;
        self.stream.clear();
        self.setup = Setup::default();
        self.heartbeat.next = None;
        self.report(RobotEvent::ProgramEnded { reason });
    }

    /// RTDE is gone: nothing can be known or said any more, except `stop` on the dashboard.
    pub(super) fn program_lost_rtde(&mut self, now: Timestamp) {
        self.stop_written_for = None;
        match &self.program {
            Program::Absent | Program::Halting { .. } => {}
            Program::Clearing { .. }
            | Program::Starting { .. }
            | Program::Running { .. }
            | Program::Stopping { .. }
            | Program::Ending { .. } => {
                let _ = self.dashboard.request_first(now, Command::Stop);
                self.program_ended(ProgramEnd::LinkLost);
            }
        }
    }

    /// The dashboard accepted `stop`. While RTDE streams, its runtime state counts instead; without, that
    /// has to do for what is known of the program, and nothing is known of the arm.
    pub(super) fn dashboard_stopped(&mut self) {
        if !self.rtde.ready()
            && let Program::Halting { requested, .. } = &mut self.program
        {
            *requested = false;
            self.halted();
        }
    }

    /// The dashboard refused `stop`: silence has to do, within the deadline that runs already.
    pub(super) fn dashboard_stop_refused(&mut self) {
        if let Program::Clearing { .. } = self.program {
            self.program_ended(ProgramEnd::NotStarted("the program that runs could not be stopped".into()));
        }
    }

    fn halted(&mut self) {
        if let Program::Halting { reason, requested, .. } =
            std::mem::replace(&mut self.program, Program::Absent)
        {
            if requested {
                self.report(RobotEvent::Stopped);
            }
            if let Some(reason) = reason {
                self.program_ended(reason);
            }
        }
    }

    /// A STOPPED message with a program's name.
    pub(super) fn program_stopped_message(&mut self, name: &str) {
        if let Program::Starting { nonce, .. } = &self.program
            && program_name(*nonce) == name
        {
            self.program_failed();
        }
    }

    /// A runtime exception, or the end of a program that has only just been uploaded.
    pub(super) fn program_failed(&mut self) {
        if let Program::Starting { .. } = &self.program {
            let detail = self.exception.take().map_or("it ended at once".into(), |end| end.to_string());
            self.program_ended(ProgramEnd::NotStarted(detail));
        }
    }

    /// The controller took the upload for one on a read-only connection (made in local mode).
    pub(super) fn upload_refused(&mut self) {
        let Program::Starting { upload_again, retried, .. } = &mut self.program else { return };
        if *retried {
            let detail = "the controller takes no program on this connection (C210)".into();
            return self.program_ended(ProgramEnd::NotStarted(detail));
        }
        *upload_again = true;
        *retried = true;
        self.primary.disconnected();
        self.closes.push_back(Link::Primary);
    }

    /// Compares the state with what the program should be doing.
    pub(super) fn follow_program(&mut self, now: Timestamp) {
        if self.program.deadline().is_some_and(|deadline| now >= deadline) {
            self.program_is_late(now);
        }
        let Some(state) = self.state.clone() else { return };
        let over = state.runtime_state == RuntimeState::Stopped;
        match &self.program {
            Program::Absent => self.follow_left_behind(&state),
            Program::Clearing { nonce, .. } => {
                if over {
                    let nonce = *nonce;
                    self.upload(now, nonce, false, now + START_WITHIN);
                }
            }
            Program::Starting { nonce, deadline, upload_again, retried } => {
                let (nonce, deadline, again, retried) = (*nonce, *deadline, *upload_again, *retried);
                self.follow_start(now, &state, nonce, deadline, again, retried);
            }
            Program::Running { nonce } => self.follow_running(now, &state, *nonce),
            // The arm at rest is not enough: the program must be gone.
            Program::Stopping { .. } => {
                if over {
                    self.report(RobotEvent::Stopped);
                    self.program_ended(ProgramEnd::StoppedByUs);
                }
            }
            Program::Ending { reason, .. } => {
                if over {
                    let reason = reason.clone();
                    self.program_ended(reason);
                }
            }
            Program::Halting { .. } => {
                if over {
                    self.halted();
                }
            }
        }
    }

    /// A program that is none of those given up here may be on the controller: one that was paused when its
    /// link was lost, or that an earlier daemon has left. It finds a stop in its registers in its first
    /// frame after a person presses play; programs of others do not read these registers.
    fn follow_left_behind(&mut self, state: &RobotState) {
        if state.runtime_state == RuntimeState::Stopped {
            self.stop_written_for = None;
        } else if self.stop_written_for.replace(state.nonce) != Some(state.nonce) {
            self.stream.start(state.accepted);
            // The number after the accepted one may be in the registers already, for a move.
            self.stream.skip_sequence();
            self.write_at_once(Opcode::Stop);
        }
    }

    fn follow_start(
        &mut self,
        now: Timestamp,
        state: &RobotState,
        nonce: Nonce,
        deadline: Timestamp,
        again: bool,
        retried: bool,
    ) {
        if again && self.primary.ready() {
            return self.upload(now, nonce, retried, deadline);
        }
        let ours = state.nonce == nonce.number();
        if ours && state.runtime_state == RuntimeState::Playing && state.program_status == ProgramStatus::Idle
        {
            self.stream.start(state.accepted);
            self.heartbeat.echo_changed = now;
            self.program = Program::Running { nonce };
            self.report(RobotEvent::ProgramRunning { nonce });
        }
    }

    fn follow_running(&mut self, now: Timestamp, state: &RobotState, nonce: Nonce) {
        let status = state.program_status;
        if status == ProgramStatus::HeartbeatLost {
            self.stream.clear();
            let reason = ProgramEnd::HeartbeatLost;
            self.program = Program::Ending { reason, deadline: now + END_WITHIN };
            return;
        }
        if state.runtime_state == RuntimeState::Stopped {
            let reason = self.exception.take().unwrap_or(ProgramEnd::FromOutside);
            return self.program_ended(reason);
        }
        if state.nonce != nonce.number() {
            return self.program_ended(ProgramEnd::Replaced);
        }
        if !state.safety_mode.allows_motion() {
            return self.halt(now, Some(ProgramEnd::StoppedByUs), true);
        }
        match status {
            ProgramStatus::Rejected => {
                let sequence = state.accepted.wrapping_add(1);
                return self.begin_end(now, ProgramEnd::Rejected { sequence });
            }
            ProgramStatus::Unknown(code) => {
                self.report_fault(now, Link::Rtde, format!("program status is {code}"));
                return self.halt(
                    now,
                    Some(ProgramEnd::Overdue(format!("unknown program status {code}"))),
                    false,
                );
            }
            ProgramStatus::Stopped => {
                // Not by us, or this would be another state.
                return self.begin_end(now, ProgramEnd::FromOutside);
            }
            ProgramStatus::Idle | ProgramStatus::Moving | ProgramStatus::HeartbeatLost => {}
        }
        if let RuntimeState::Unknown(code) = state.runtime_state {
            self.report_fault(now, Link::Rtde, format!("runtime_state has unknown value {code}"));
            return self.halt(now, Some(ProgramEnd::Overdue(format!("unknown runtime state {code}"))), false);
        }
        self.follow_echo(now, state);
    }

    fn follow_echo(&mut self, now: Timestamp, state: &RobotState) {
        let heartbeat = &mut self.heartbeat;
        if state.heartbeat_echo != heartbeat.echo || state.runtime_state != RuntimeState::Playing {
            heartbeat.echo = state.heartbeat_echo;
            heartbeat.echo_changed = now;
        } else if now.since(heartbeat.echo_changed) > ECHO_WITHIN {
            let reason = ProgramEnd::Overdue("the program does not echo the heartbeat".into());
            self.halt(now, Some(reason), false);
        }
    }

    fn program_is_late(&mut self, now: Timestamp) {
        match &self.program {
            Program::Absent | Program::Running { .. } => {}
            Program::Clearing { .. } => {
                let detail = "the program that runs did not stop within 3 s".to_string();
                self.program_ended(ProgramEnd::NotStarted(detail));
            }
            Program::Starting { .. } => {
                let detail = "it did not identify itself within 5 s".to_string();
                self.halt(now, Some(ProgramEnd::NotStarted(detail)), false);
            }
            Program::Stopping { .. } => self.halt(now, Some(ProgramEnd::StoppedByUs), true),
            Program::Ending { reason, .. } => {
                let reason = reason.clone();
                self.halt(now, Some(reason), false);
            }
            Program::Halting { reason, .. } => {
                let reason = reason.clone();
                self.program = Program::Absent;
                let reply = "no sign within 3 s that the program has stopped".to_string();
                self.report(RobotEvent::Refused { what: "stop".into(), reply });
                if let Some(reason) = reason {
                    self.program_ended(reason);
                }
            }
        }
    }

    /// Writes the heartbeat when it is due.
    pub(super) fn send_heartbeat(&mut self, now: Timestamp) {
        if !self.program.wants_heartbeat() {
            self.heartbeat.next = None;
            return;
        }
        if self.heartbeat.next.is_none_or(|next| now >= next) {
            self.heartbeat.count = self.heartbeat.count.wrapping_add(1);
            self.heartbeat.next = Some(now + HEARTBEAT_EVERY);
            self.rtde.write_heartbeat(self.heartbeat.count);
        }
    }
}
