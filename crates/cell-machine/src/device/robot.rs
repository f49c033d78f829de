//! The robot: one session over RTDE, dashboard and primary interface.
//!
//! In: bytes of three links, [`RobotCommand`]s, the time. Out: bytes, [`RobotEvent`]s, the latest
//! [`RobotState`], and which link should be made anew. It uploads the on-robot program and proves by nonce
//! that it runs, streams checked paths to it, keeps its heartbeat, and stops it. It never acknowledges a
//! safety stop by itself, and never moves the arm on a state older than 100 ms.
//!
//! Three ways lead to standstill, each the fall-back of the one before: the stop opcode (the arm decelerates
//! and the program reports it), `stop` on the dashboard, and silence (the program's own watchdog).
//!
//! Time passes in [`Robot::tick`] alone. Everything that has arrived is handed over first (`connected`,
//! `received`, `disconnected`), so that a computer that was held up judges deadlines by fresh states and
//! never calls a robot silent whose states wait in a socket.
//!
//! The work is split by subject: `links` takes what the link sessions report, `commands` what is requested,
//! `life` follows the program, `feed` gives it work; `parts` is what they share.

mod commands;
mod feed;
mod life;
mod links;
mod parts;
#[cfg(test)]
mod tests;

use crate::device::dashboard_session::DashboardSession;
use crate::device::outbox::earlier;
use crate::device::primary_session::PrimarySession;
use crate::device::program::{ProgramTemplate, TemplateError};
use crate::device::robot_types::{
    Link, ProgramEnd, Refused, RobotCommand, RobotEvent, RobotParameters, RobotState, STALE_AFTER,
};
use crate::device::rtde_session::RtdeSession;
use crate::device::stream::Stream;
use cell_values::time::{Duration, Timestamp};
use parts::{ArmWait, Heartbeat, Identity, PoweringOff, Program, Reported, SEND_WITHIN, Setup};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use ur_arm::kinematics::DhParameters;
use ur_wire::dashboard::Command;

/// Reason of a connection that celld itself has dropped.
pub const DROPPED: &str = "dropped by celld";

/// Faults older than this are forgotten when they are counted.
const FAULT_WINDOW: Duration = Duration::from_secs(60);

/// The session. See the module.
#[derive(Deserialize, Serialize)]
pub struct Robot {
    template: ProgramTemplate,
    rtde: RtdeSession,
    dashboard: DashboardSession,
    primary: PrimarySession,
    program: Program,
    heartbeat: Heartbeat,
    stream: Stream,
    setup: Setup,
    state: Option<RobotState>,
    /// As last reported on the dashboard link that is established now.
    remote_control: Option<bool>,
    /// When the dashboard reported it.
    remote_control_at: Timestamp,
    /// As last reported on an earlier one: a change since then means that links have to be made anew.
    remote_control_before: Option<bool>,
    /// Since when commands wait although the program runs.
    held_since: Option<Timestamp>,
    identity: Identity,
    dh: DhParameters,
    reported: Reported,
    arm_waits: Vec<ArmWait>,
    /// Commands on their way whose answers count for nothing, oldest first: a stop came between.
    dropped: Vec<Command>,
    /// Power or brakes were ordered, and the arm is not known to be ready.
    powers: bool,
    /// A stop has taken power and brakes back, and the arm is not known to be off yet.
    powering_off: Option<PoweringOff>,
    /// The nonce that was in the registers when a stop was written for a program that is not followed here.
    stop_written_for: Option<i32>,
    exception: Option<ProgramEnd>,
    faults: VecDeque<Timestamp>,
    /// When a jump of a joint was reported last.
    jumped: Option<Timestamp>,
    /// Time of the last advance.
    last_advance: Timestamp,
    /// Time of the last call, for how old a state is.
    clock: Timestamp,
    events: VecDeque<RobotEvent>,
    closes: VecDeque<Link>,
}

impl Robot {
    /// A session without links.
    ///
    /// # Errors
    /// The program text is not a template.
    pub fn new(parameters: RobotParameters) -> Result<Robot, TemplateError> {
        Ok(Robot {
            template: ProgramTemplate::new(&parameters.program_text, parameters.watchdog_frames)?,
            rtde: RtdeSession::new(parameters.frequency_hz, parameters.process),
            dashboard: DashboardSession::default(),
            primary: PrimarySession::default(),
            program: Program::Absent,
            heartbeat: Heartbeat::default(),
            stream: Stream::default(),
            setup: Setup::default(),
            state: None,
            remote_control: None,
            remote_control_at: Timestamp::ZERO,
            remote_control_before: None,
            held_since: None,
            identity: Identity::default(),
            dh: DhParameters::UR5E,
            reported: Reported::default(),
            arm_waits: Vec::new(),
            dropped: Vec::new(),
            powers: false,
            powering_off: None,
            stop_written_for: None,
            exception: None,
            faults: VecDeque::new(),
            jumped: None,
            last_advance: Timestamp::ZERO,
            clock: Timestamp::ZERO,
            events: VecDeque::new(),
            closes: VecDeque::new(),
        })
    }

    /// A TCP connection is established.
    pub fn connected(&mut self, now: Timestamp, link: Link) {
        self.clock = now;
        match link {
            Link::Rtde => {
                self.lose_rtde(now);
                self.rtde.connected(now);
            }
            Link::Dashboard => {
                self.lose_dashboard("made anew");
                self.identity = Identity::default();
                self.dashboard.connected(now);
            }
            Link::Primary => self.primary.connected(now),
        }
    }

    /// A TCP connection is gone, or could not be made; `reason` is for people.
    pub fn disconnected(&mut self, now: Timestamp, link: Link, reason: &str) {
        self.clock = now;
        match link {
            Link::Rtde => self.lose_rtde(now),
            Link::Dashboard => self.lose_dashboard(reason),
            Link::Primary => {
                self.primary.disconnected();
                self.renew_dashboard(reason);
            }
        }
    }

    /// The controller closes its script connections when the pendant is switched between local and remote,
    /// and from then on refuses commands on dashboard connections made before: a switch there and back,
    /// between two questions, shows in nothing else.
    fn renew_dashboard(&mut self, reason: &str) {
        if reason != DROPPED && self.dashboard.ready() {
            self.lose_dashboard("made anew with the primary interface");
            self.closes.push_back(Link::Dashboard);
        }
    }

    /// Bytes arrived; what they mean is looked at in the next [`Robot::tick`].
    pub fn received(&mut self, now: Timestamp, link: Link, bytes: &[u8]) {
        self.clock = now;
        match link {
            Link::Rtde => self.rtde.received(now, bytes),
            Link::Dashboard => self.dashboard.received(now, bytes),
            Link::Primary => self.primary.received(now, bytes),
        }
    }

    /// Requests something.
    ///
    /// # Errors
    /// Why it is not done; then nothing has changed.
    pub fn command(&mut self, now: Timestamp, command: RobotCommand) -> Result<(), Refused> {
        self.clock = now;
        self.advance(now);
        self.take_command(now, command)?;
        self.advance(now);
        Ok(())
    }

    /// Time went by, and everything that has arrived by now was handed over.
    pub fn tick(&mut self, now: Timestamp) {
        self.clock = now;
        self.advance(now);
    }

    /// Bytes to send, and where.
    pub fn poll_transmit(&mut self) -> Option<(Link, Vec<u8>)> {
        // RTDE first: it carries the stop and the heartbeat.
        if let Some(bytes) = self.rtde.poll_transmit() {
            return Some((Link::Rtde, bytes));
        }
        if let Some(bytes) = self.dashboard.poll_transmit() {
            return Some((Link::Dashboard, bytes));
        }
        self.primary.poll_transmit().map(|bytes| (Link::Primary, bytes))
    }

    /// What happened.
    pub fn poll_event(&mut self) -> Option<RobotEvent> {
        self.events.pop_front()
    }

    /// When to call [`Robot::tick`] next, and why.
    pub fn poll_timeout(&self) -> Option<(Timestamp, &'static str)> {
        let links = earlier(
            earlier(self.rtde.poll_timeout(), self.dashboard.poll_timeout()),
            self.primary.poll_timeout(),
        );
        let heartbeat = self.heartbeat.next().map(|at| (at, "heartbeat"));
        let program = self.program.deadline().map(|at| (at, "program"));
        let setup = self.setup.deadline.map(|at| (at, "payload and TCP"));
        let held = self.held_since.map(|at| (at + SEND_WITHIN, "commands held back"));
        let waits = self.arm_waits.iter().map(|wait| wait.deadline).min().map(|at| (at, "arm"));
        [heartbeat, program, setup, held, waits].into_iter().fold(links, earlier)
    }

    /// A link that should be dropped and made anew.
    pub fn poll_close(&mut self) -> Option<Link> {
        self.closes.pop_front()
    }

    /// The latest state; `None` while RTDE does not stream.
    pub fn state(&self) -> Option<&RobotState> {
        self.state.as_ref()
    }

    /// True if the state may be used to start a motion.
    pub fn fresh(&self, now: Timestamp) -> bool {
        self.state.as_ref().is_some_and(|state| now.since(state.received) <= STALE_AFTER)
    }

    /// True unless a program is being started, stopped or ended: a new one would be refused meanwhile.
    pub fn program_settled(&self) -> bool {
        match self.program {
            Program::Absent | Program::Running { .. } => true,
            Program::Clearing { .. }
            | Program::Starting { .. }
            | Program::Stopping { .. }
            | Program::Ending { .. }
            | Program::Halting { .. } => false,
        }
    }

    /// True unless power or brakes that a stop took back may still come on.
    pub fn arm_settled(&self) -> bool {
        self.powering_off.is_none()
    }

    /// Number of the path that was taken last; its events carry it.
    pub fn last_batch(&self) -> u32 {
        self.stream.last_batch()
    }

    /// The one place where everything moves on.
    fn advance(&mut self, now: Timestamp) {
        let passed = now.since(self.last_advance);
        self.last_advance = now;
        self.rtde.tick(now);
        self.dashboard.tick(now);
        self.primary.tick(now);
        self.take_link_events(now);
        self.take_state(now);
        self.follow_program(now);
        self.take_progress(now, passed);
        self.check_arm_waits(now);
        self.follow_powering_off(now);
        self.send_heartbeat(now);
        self.send_commands(now);
    }

    fn report(&mut self, event: RobotEvent) {
        self.events.push_back(event);
    }

    /// Reports a breach of protocol with the number of those lately.
    fn report_fault(&mut self, now: Timestamp, link: Link, detail: String) {
        self.faults.push_back(now);
        while self.faults.front().is_some_and(|at| now.since(*at) > FAULT_WINDOW) || self.faults.len() > 100 {
            self.faults.pop_front();
        }
        let recent = u32::try_from(self.faults.len()).unwrap_or(u32::MAX);
        self.report(RobotEvent::ProtocolFault { link, detail, recent });
    }
}
