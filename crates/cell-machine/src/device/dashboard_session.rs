//! Dashboard session: one question at a time, answers matched to questions, remote control polled.
//!
//! In: bytes of TCP 29999, commands, the time. Out: bytes and [`DashboardEvent`]s. Right after the greeting
//! the session queries who the controller is; every second it polls whether remote control is on, and the
//! modes. A reply means accepted, not done: the requester watches the state.

use crate::device::outbox::{Outbox, earlier};
use cell_values::time::{Duration, Timestamp};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use ur_wire::dashboard::{Command, LineSplitter, Reply};

/// The server greets within this time.
const GREETING_WITHIN: Duration = Duration::from_secs(10);
/// It answers a command within this time.
const REPLY_WITHIN: Duration = Duration::from_secs(2);
/// Pause between two rounds of questions.
const POLL_EVERY: Duration = Duration::from_secs(1);
/// Commands that may wait; more are refused.
const MAX_WAITING: usize = 16;

const GREETING_START: &str = "Connected:";

const ON_CONNECT: [Command; 3] =
    [Command::PolyscopeVersion, Command::GetSerialNumber, Command::GetRobotModel];
const POLLED: [Command; 3] = [Command::IsInRemoteControl, Command::RobotMode, Command::SafetyMode];

/// What the session reports.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub enum DashboardEvent {
    /// An answer.
    Reply {
        /// To what.
        command: Command,
        /// The answer.
        reply: Reply,
    },
    /// The link is dropped because of this.
    Fault(String),
    /// The link is dropped because nothing came for this long.
    Silent(String),
}

#[derive(Deserialize, Serialize)]
enum Step {
    Down,
    Greeting { deadline: Timestamp },
    Idle,
    Requested { command: Command, deadline: Timestamp },
}

/// The session. See the module.
#[derive(Deserialize, Serialize)]
pub struct DashboardSession {
    step: Step,
    splitter: LineSplitter,
    waiting: VecDeque<Command>,
    next_poll: Timestamp,
    outbox: Outbox<DashboardEvent>,
}

impl Default for DashboardSession {
    fn default() -> DashboardSession {
        DashboardSession {
            step: Step::Down,
            splitter: LineSplitter::default(),
            waiting: VecDeque::new(),
            next_poll: Timestamp::ZERO,
            outbox: Outbox::default(),
        }
    }
}

impl DashboardSession {
    /// The TCP connection is established.
    pub fn connected(&mut self, now: Timestamp) {
        self.outbox.reset_link();
        self.splitter = LineSplitter::default();
        self.waiting = ON_CONNECT.into_iter().collect();
        self.next_poll = now;
        self.step = Step::Greeting { deadline: now + GREETING_WITHIN };
    }

    /// The TCP connection is gone; commands that waited are lost.
    pub fn disconnected(&mut self) {
        self.step = Step::Down;
        self.waiting.clear();
        self.outbox.reset_link();
    }

    /// True between greeting and loss.
    pub fn ready(&self) -> bool {
        match self.step {
            Step::Idle | Step::Requested { .. } => true,
            Step::Down | Step::Greeting { .. } => false,
        }
    }

    /// Sends a command as soon as those before it are answered; false if too many wait or the link is down.
    #[must_use]
    pub fn request(&mut self, now: Timestamp, command: Command) -> bool {
        if !self.ready() || self.waiting.len() >= MAX_WAITING {
            return false;
        }
        self.waiting.push_back(command);
        self.send_next(now);
        true
    }

    /// As [`DashboardSession::request`], before everything that waits.
    #[must_use]
    pub fn request_first(&mut self, now: Timestamp, command: Command) -> bool {
        if !self.ready() {
            return false;
        }
        self.waiting.push_front(command);
        self.send_next(now);
        true
    }

    /// Takes a command back that waits to be sent; false where it is on its way already, or unknown. Its
    /// line may be written and not polled yet: an order to stop can come in the same turn.
    pub fn forget(&mut self, command: &Command) -> bool {
        let waiting = self.waiting.len();
        self.waiting.retain(|waits| waits != command);
        let written = matches!(&self.step, Step::Requested { command: asked, .. } if asked == command);
        if written && self.outbox.take_back() {
            self.step = Step::Idle;
            return true;
        }
        self.waiting.len() < waiting
    }

    /// Bytes arrived.
    pub fn received(&mut self, now: Timestamp, bytes: &[u8]) {
        self.splitter.push(bytes);
        while !matches!(self.step, Step::Down) {
            match self.splitter.next_line() {
                Ok(Some(line)) => self.line(now, &line),
                Ok(None) => return,
                Err(error) => self.fault(error.to_string()),
            }
        }
    }

    /// Time went by.
    pub fn tick(&mut self, now: Timestamp) {
        match &self.step {
            Step::Down => return,
            Step::Greeting { deadline } if now >= *deadline => {
                self.silent("no greeting within 10 s".into());
            }
            Step::Requested { command, deadline } if now >= *deadline => {
                let detail = format!("no answer to {:?} within 2 s", command.line().trim_end());
                self.silent(detail);
            }
            Step::Greeting { .. } | Step::Requested { .. } | Step::Idle => {}
        }
        if self.ready() && now >= self.next_poll {
            self.next_poll = now + POLL_EVERY;
            for command in POLLED {
                if !self.waiting.contains(&command) {
                    self.waiting.push_back(command);
                }
            }
        }
        self.send_next(now);
    }

    /// When to call [`DashboardSession::tick`] next, and why.
    pub fn poll_timeout(&self) -> Option<(Timestamp, &'static str)> {
        match &self.step {
            Step::Down => None,
            Step::Greeting { deadline } => Some((*deadline, "dashboard greeting")),
            Step::Idle => Some((self.next_poll, "dashboard poll")),
            Step::Requested { deadline, .. } => {
                earlier(Some((*deadline, "dashboard reply")), Some((self.next_poll, "dashboard poll")))
            }
        }
    }

    /// Bytes to send.
    pub fn poll_transmit(&mut self) -> Option<Vec<u8>> {
        self.outbox.poll_transmit()
    }

    /// What happened.
    pub fn poll_event(&mut self) -> Option<DashboardEvent> {
        self.outbox.poll_event()
    }

    /// True once if the link should be dropped.
    pub fn poll_close(&mut self) -> bool {
        self.outbox.poll_close()
    }

    fn send_next(&mut self, now: Timestamp) {
        if !matches!(self.step, Step::Idle) {
            return;
        }
        if let Some(command) = self.waiting.pop_front() {
            self.outbox.send(command.line().into_bytes());
            self.step = Step::Requested { command, deadline: now + REPLY_WITHIN };
        }
    }

    fn fault(&mut self, detail: String) {
        self.drop_link(DashboardEvent::Fault(detail));
    }

    fn silent(&mut self, detail: String) {
        self.drop_link(DashboardEvent::Silent(detail));
    }

    fn drop_link(&mut self, event: DashboardEvent) {
        self.step = Step::Down;
        self.waiting.clear();
        self.outbox.report(event);
        self.outbox.close();
    }

    fn line(&mut self, now: Timestamp, line: &str) {
        match std::mem::replace(&mut self.step, Step::Idle) {
            Step::Down => self.step = Step::Down,
            Step::Greeting { .. } if line.starts_with(GREETING_START) => self.tick(now),
            Step::Greeting { .. } => self.fault(format!("greeting is {line:?}")),
            Step::Idle => self.fault(format!("line without a question: {line:?}")),
            Step::Requested { command, .. } => match Reply::parse(&command, line) {
                Ok(reply) => {
                    self.outbox.report(DashboardEvent::Reply { command, reply });
                    self.send_next(now);
                }
                Err(error) => self.fault(format!("answer to {:?}: {error}", command.line().trim_end())),
            },
        }
    }
}
