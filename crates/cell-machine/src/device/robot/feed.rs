//! Feeding the program: its progress, the commands it may have next, payload and TCP before a path.
//!
//! In: what the program reports, the time. Out: commands in registers, events of what was carried out, and a
//! stop where something takes too long.

use crate::device::robot::Robot;
use crate::device::robot::parts::{Program, REMOTE_CONTROL_WITHIN, SEND_WITHIN, Setup};
use crate::device::robot_types::{Link, ProgramEnd, Refused, RobotEvent, RobotState};
use crate::device::stream::Done;
use cell_values::time::{Duration, Timestamp};
use nalgebra::{Isometry3, Vector3};
use ur_wire::enumerations::RuntimeState;

/// From payload or TCP being set to the controller showing it.
const SETUP_WITHIN: Duration = Duration::from_secs(1);
/// Least share of full speed at which deadlines run while the program plays: a slider at 1 % is slow, not
/// forgiven for ever.
const LEAST_SPEED_SHARE: f64 = 0.01;

impl Robot {
    /// Hands the program's progress to the stream, and time with it.
    pub(super) fn take_progress(&mut self, now: Timestamp, passed: Duration) {
        let Program::Running { .. } = &self.program else { return };
        let Some(state) = &self.state else { return };
        let playing = if state.runtime_state == RuntimeState::Playing { passed.as_secs_f64() } else { 0.0 };
        let scaled = playing * state.speed_share().max(LEAST_SPEED_SHARE);
        let progress = self.stream.progress(state.accepted, state.finished);
        let in_time = progress.is_ok().then(|| self.stream.elapse(playing, scaled));
        while let Some(done) = self.stream.poll_done() {
            self.stream_done(done);
        }
        if let Err(detail) = progress {
            self.report_fault(now, Link::Rtde, detail.clone());
            self.halt(now, Some(ProgramEnd::Overdue(detail)), false);
        } else if let Some(Err(detail)) = in_time {
            self.report(RobotEvent::ArmStalled { detail: detail.clone() });
            self.halt(now, Some(ProgramEnd::Overdue(detail)), false);
        }
    }

    fn stream_done(&mut self, done: Done) {
        let event = match done {
            Done::Segment { batch, index } => RobotEvent::SegmentFinished { batch, index },
            Done::Path { batch } => RobotEvent::PathFinished { batch },
            Done::Payload { mass_kg, centre_of_gravity_m } => {
                self.setup.payload = Some((mass_kg, centre_of_gravity_m));
                RobotEvent::PayloadSet
            }
            Done::Tcp(tcp) => {
                self.setup.tcp = Some(tcp);
                RobotEvent::TcpSet
            }
        };
        self.report(event);
    }

    /// True if the controller shows the payload and TCP that the program was given; a path waits for that,
    /// and not for ever.
    pub(super) fn setup_is_reported(&mut self, now: Timestamp) -> bool {
        let Some(state) = &self.state else { return false };
        let Some(difference) = setup_difference(&self.setup, state) else {
            self.setup.deadline = None;
            return true;
        };
        let deadline = *self.setup.deadline.get_or_insert(now + SETUP_WITHIN);
        if now >= deadline {
            self.halt(now, Some(ProgramEnd::Overdue(difference)), false);
        }
        false
    }

    /// Writes what the program can take now. Nothing is written on a stale state or outside remote control
    /// and normal safety, whatever was streamed before.
    pub(super) fn send_commands(&mut self, now: Timestamp) {
        if let Err(refused) = self.program_takes_commands() {
            return self.hold_commands(now, refused);
        }
        let remote_control_is_old = now.since(self.remote_control_at) > REMOTE_CONTROL_WITHIN;
        if self.stream.path_is_next() && remote_control_is_old {
            return self.hold_commands(now, Refused::RemoteControlUnknown);
        }
        self.held_since = None;
        if self.stream.path_begins() && !self.setup_is_reported(now) {
            return;
        }
        if let Some(command) = self.stream.poll_command() {
            self.rtde.write_command(&command);
        }
    }

    /// Commands wait and may not be written now. A pause may last; anything else has to end.
    pub(super) fn hold_commands(&mut self, now: Timestamp, why: Refused) {
        let playing = self.state.as_ref().is_some_and(|state| state.runtime_state == RuntimeState::Playing);
        if !matches!(self.program, Program::Running { .. }) || self.stream.is_idle() || !playing {
            self.held_since = None;
            return;
        }
        let since = *self.held_since.get_or_insert(now);
        if now.since(since) >= SEND_WITHIN {
            self.held_since = None;
            self.halt(now, Some(ProgramEnd::Overdue(format!("commands could not be sent: {why}"))), false);
        }
    }
}

/// What the controller shows differently from what the program was given; `None` if nothing.
fn setup_difference(setup: &Setup, state: &RobotState) -> Option<String> {
    if let Some((mass, cog)) = setup.payload {
        let cog_off = cog.iter().zip(state.payload_cog).any(|(a, b)| (a - b).abs() > 1e-3);
        if (mass - state.payload).abs() > 1e-3 || cog_off {
            return Some(format!(
                "payload reads {:.3} kg at {:?}, {mass:.3} kg at {cog:?} was set",
                state.payload, state.payload_cog
            ));
        }
    }
    let tcp = setup.tcp?;
    let pose = |p: [f64; 6]| Isometry3::new(Vector3::new(p[0], p[1], p[2]), Vector3::new(p[3], p[4], p[5]));
    let (set, reported) = (pose(tcp), pose(state.tcp_offset));
    let way = (set.translation.vector - reported.translation.vector).norm();
    let turn = set.rotation.angle_to(&reported.rotation);
    let differs = way > 1e-4 || turn > 1e-3;
    differs.then(|| format!("TCP reads {:?}, {tcp:?} was set", state.tcp_offset))
}
