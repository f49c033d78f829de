//! RTDE session: handshake, state in, registers out.
//!
//! In: bytes of TCP 30004, command registers, heartbeats, the time. Out: bytes, [`RtdeEvent`]s, the latest
//! [`RobotState`]. The inputs are small recipes, so that a refusal names few registers: the heartbeat, the
//! command with its arguments (one package, hence one controller frame), and the mark of this process. Where
//! they are taken, the state is read for a moment without them: the mark of another celld is in it.
//!
//! Anything malformed, a NaN or a number that no arm can have included, is a fault that drops the link:
//! after it nothing on it can be trusted.

use crate::device::outbox::Outbox;
use crate::device::registers::{CommandRegisters, mark_of, process_of};
use crate::device::robot_types::{InputsTaken, RobotState};
use crate::device::rtde_jump::Jump;
use crate::device::rtde_recipes::{
    COMMAND, HEARTBEAT, OWNER, Refusal, agree, input_names, mark_in, output_names, state_of,
};
use crate::device::software::too_old;
use cell_values::time::{Duration, Timestamp};
use serde::{Deserialize, Serialize};
use ur_wire::rtde::{Reply, Request, Splitter, Version};
use ur_wire::rtde_ranges;
use ur_wire::rtde_values::{Leftover, Offer, Recipe, Value};
use ur_wire::rtde_variables::output_type;

/// An answer in the handshake may take this long.
const ANSWER_WITHIN: Duration = Duration::from_secs(2);
/// Without a package for this long the link is dead (RTDE has no heartbeat of its own).
const SILENT_AFTER: Duration = Duration::from_millis(2500);
/// A dead predecessor may still hold the registers: wait, then try again.
const IN_USE_RETRY: Duration = Duration::from_secs(5);
/// How long the registers are read for the mark of another celld.
const LOOK_FOR_OWNER: Duration = Duration::from_millis(500);
/// How often a session writes its mark.
const MARK_EVERY: Duration = Duration::from_millis(150);
/// The process of a session that leaves no mark: one that only looks.
pub const NO_MARK: u32 = 0;
/// Tries before the link is dropped.
const IN_USE_TRIES: u32 = 4;
/// While it boots the controller restarts its RTDE service once; before this time nothing is trusted.
const SETTLED_AT_S: f64 = 40.0;
/// Or until packages have come for this long, s.
const SETTLED_AFTER_S: f64 = 2.0;

/// What the session reports.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
pub enum RtdeEvent {
    /// The state is good to use from now on.
    Ready,
    /// Registers are taken; `attempt` counts the tries.
    InUse {
        /// Which, and by whom.
        taken: InputsTaken,
        /// Tries so far.
        attempt: u32,
    },
    /// A text for a person.
    Message(String),
    /// A joint is where it cannot have turned to since the package before: which, and by how much.
    Jump(String),
    /// The link is dropped because of this.
    Fault(String),
    /// The link is dropped because nothing came for this long.
    Silent(String),
}

#[derive(Deserialize, Serialize)]
enum Step {
    Down,
    RequestedVersion {
        deadline: Timestamp,
    },
    RequestedController {
        deadline: Timestamp,
    },
    RequestedOutputs {
        deadline: Timestamp,
    },
    RequestedInputs {
        index: usize,
        deadline: Timestamp,
        attempt: u32,
    },
    /// The registers are taken, and read for the mark of their owner.
    LookingForOwner {
        index: usize,
        names: Vec<String>,
        since: Timestamp,
        attempt: u32,
        /// Read last.
        mark: Option<i32>,
    },
    WaitingForInputs {
        index: usize,
        retry_at: Timestamp,
        attempt: u32,
    },
    RequestedPause {
        index: usize,
        deadline: Timestamp,
        attempt: u32,
    },
    RequestedStart {
        deadline: Timestamp,
    },
    Streaming {
        last_package: Timestamp,
        packages: u32,
        settled: bool,
    },
}

/// The session. See the module.
#[derive(Deserialize, Serialize)]
pub struct RtdeSession {
    frequency_hz: f64,
    process: u32,
    /// When the mark was written last, and with which turn.
    marked: Option<(Timestamp, bool)>,
    version: Version,
    step: Step,
    splitter: Splitter,
    outputs: Recipe,
    inputs: Vec<Recipe>,
    latest: Option<RobotState>,
    outbox: Outbox<RtdeEvent>,
}

impl RtdeSession {
    /// `frequency_hz` packages per second; `process` is the number that another celld reads
    /// ([`NO_MARK`]: none).
    pub fn new(frequency_hz: f64, process: u32) -> RtdeSession {
        RtdeSession {
            frequency_hz,
            process,
            marked: None,
            version: Version::V1,
            step: Step::Down,
            splitter: Splitter::default(),
            outputs: Recipe { id: 0, fields: Vec::new() },
            inputs: Vec::new(),
            latest: None,
            outbox: Outbox::default(),
        }
    }

    /// The TCP connection is established.
    pub fn connected(&mut self, now: Timestamp) {
        self.outbox.reset_link();
        self.splitter = Splitter::default();
        self.version = Version::V1;
        self.inputs.clear();
        (self.latest, self.marked) = (None, None);
        self.request(&Request::ProtocolVersion(2));
        self.step = Step::RequestedVersion { deadline: now + ANSWER_WITHIN };
    }

    /// The TCP connection is gone.
    pub fn disconnected(&mut self) {
        self.step = Step::Down;
        self.latest = None;
        self.outbox.reset_link();
    }

    /// True once the state is good to use.
    pub fn ready(&self) -> bool {
        matches!(self.step, Step::Streaming { settled: true, .. })
    }

    /// The last state; `None` before [`RtdeEvent::Ready`].
    pub fn latest(&self) -> Option<&RobotState> {
        self.latest.as_ref().filter(|_| self.ready())
    }

    /// Bytes arrived.
    pub fn received(&mut self, now: Timestamp, bytes: &[u8]) {
        self.splitter.push(bytes);
        while !matches!(self.step, Step::Down) {
            let reply = match self.splitter.next_frame() {
                Ok(Some(frame)) => Reply::decode(self.version, &frame),
                Ok(None) => return,
                Err(error) => Err(error),
            };
            match reply {
                Ok(reply) => self.handle(now, reply),
                Err(error) => self.fault(error.to_string()),
            }
        }
    }

    /// Time went by.
    pub fn tick(&mut self, now: Timestamp) {
        match self.step {
            Step::Down => {}
            Step::RequestedVersion { deadline }
            | Step::RequestedController { deadline }
            | Step::RequestedOutputs { deadline }
            | Step::RequestedInputs { deadline, .. }
            | Step::RequestedPause { deadline, .. }
            | Step::RequestedStart { deadline } => {
                if now >= deadline {
                    self.silent(format!("no answer to {} within 2 s", self.waiting_for()));
                }
            }
            Step::LookingForOwner { since, .. } => {
                if now >= since + LOOK_FOR_OWNER {
                    self.owner_found(None);
                }
            }
            Step::WaitingForInputs { index, retry_at, attempt } => {
                if now >= retry_at {
                    self.request(&Request::Pause);
                    self.step = Step::RequestedPause { index, deadline: now + ANSWER_WITHIN, attempt };
                }
            }
            Step::Streaming { last_package, .. } => {
                if now.since(last_package) >= SILENT_AFTER {
                    self.silent("no package for 2.5 s".into());
                }
            }
        }
    }

    /// When to call [`RtdeSession::tick`] next, and why.
    pub fn poll_timeout(&self) -> Option<(Timestamp, &'static str)> {
        match self.step {
            Step::Down => None,
            Step::RequestedVersion { deadline }
            | Step::RequestedController { deadline }
            | Step::RequestedOutputs { deadline }
            | Step::RequestedInputs { deadline, .. }
            | Step::RequestedPause { deadline, .. }
            | Step::RequestedStart { deadline } => Some((deadline, "RTDE handshake")),
            Step::LookingForOwner { since, .. } => Some((since + LOOK_FOR_OWNER, "RTDE owner of registers")),
            Step::WaitingForInputs { retry_at, .. } => Some((retry_at, "RTDE registers in use")),
            Step::Streaming { last_package, .. } => Some((last_package + SILENT_AFTER, "RTDE silence")),
        }
    }

    /// Bytes to send.
    pub fn poll_transmit(&mut self) -> Option<Vec<u8>> {
        self.outbox.poll_transmit()
    }

    /// What happened.
    pub fn poll_event(&mut self) -> Option<RtdeEvent> {
        self.outbox.poll_event()
    }

    /// True once if the link should be dropped.
    pub fn poll_close(&mut self) -> bool {
        self.outbox.poll_close()
    }

    /// Writes the heartbeat register; nothing happens before the session is ready.
    pub fn write_heartbeat(&mut self, heartbeat: i32) {
        self.write(HEARTBEAT, &[Value::Int32(heartbeat)]);
    }

    /// Writes a command; nothing happens before the session is ready.
    pub fn write_command(&mut self, command: &CommandRegisters) {
        self.write(COMMAND, &command.values());
    }

    fn write(&mut self, recipe: usize, values: &[Value]) {
        if !self.ready() {
            return;
        }
        let Some(recipe) = self.inputs.get(recipe) else { return };
        match recipe.encode(values) {
            Ok(payload) => {
                let request = Request::Data { recipe: recipe.id, payload };
                self.request(&request);
            }
            Err(error) => self.fault(format!("own command does not fit: {error}")),
        }
    }

    /// Writes the mark anew now and then, so that it shows a celld which is connected.
    fn write_mark(&mut self, now: Timestamp) {
        let due = self.marked.is_none_or(|(at, _)| now.since(at) >= MARK_EVERY);
        if self.process == NO_MARK || !self.ready() || !due {
            return;
        }
        let turn = !self.marked.is_some_and(|(_, turn)| turn);
        self.marked = Some((now, turn));
        self.write(OWNER, &[Value::Int32(mark_of(self.process, turn))]);
    }

    fn request(&mut self, request: &Request) {
        self.outbox.send(request.encode(self.version));
    }

    fn fault(&mut self, detail: String) {
        self.drop_link(RtdeEvent::Fault(detail));
    }

    fn silent(&mut self, detail: String) {
        self.drop_link(RtdeEvent::Silent(detail));
    }

    fn drop_link(&mut self, event: RtdeEvent) {
        self.step = Step::Down;
        self.latest = None;
        self.outbox.report(event);
        self.outbox.close();
    }

    fn waiting_for(&self) -> &'static str {
        match self.step {
            Step::RequestedVersion { .. } => "the protocol version request",
            Step::RequestedController { .. } => "the controller version request",
            Step::RequestedOutputs { .. } => "the output set-up",
            Step::RequestedInputs { .. } | Step::WaitingForInputs { .. } => "the input set-up",
            Step::RequestedStart { .. } => "the start request",
            Step::RequestedPause { .. } => "the pause request",
            Step::LookingForOwner { .. } => "the owner of the registers",
            Step::Down | Step::Streaming { .. } => "nothing",
        }
    }

    fn handle(&mut self, now: Timestamp, reply: Reply) {
        let deadline = now + ANSWER_WITHIN;
        match (reply, &self.step) {
            (Reply::Text(text), _) => {
                let text = if text.source.is_empty() {
                    text.message
                } else {
                    format!("{}: {}", text.source, text.message)
                };
                self.outbox.report(RtdeEvent::Message(text));
            }
            (Reply::ProtocolVersion(true), Step::RequestedVersion { .. }) => {
                self.version = Version::V2;
                self.request(&Request::ControllerVersion);
                self.step = Step::RequestedController { deadline };
            }
            (Reply::ProtocolVersion(false), Step::RequestedVersion { .. }) => {
                self.fault("the controller refuses RTDE version 2".into());
            }
            (Reply::ControllerVersion(version), Step::RequestedController { .. }) => {
                if let Some(fault) = too_old([version.major, version.minor]) {
                    return self.fault(fault);
                }
                let names = output_names();
                self.request(&Request::SetupOutputs { frequency_hz: Some(self.frequency_hz), names });
                self.step = Step::RequestedOutputs { deadline };
            }
            (Reply::SetupOutputs { recipe, offers }, Step::RequestedOutputs { .. }) => {
                self.outputs_offered(now, recipe, &offers);
            }
            (Reply::SetupInputs { recipe, offers }, &Step::RequestedInputs { index, attempt, .. }) => {
                self.inputs_offered(now, index, attempt, recipe, &offers);
            }
            (Reply::Start(true), Step::RequestedStart { .. }) => {
                self.step = Step::Streaming { last_package: now, packages: 0, settled: false };
            }
            (Reply::Start(false), Step::RequestedStart { .. }) => {
                self.fault("the controller refuses to start".into())
            }
            (Reply::Data { recipe, payload }, Step::Streaming { .. }) => self.data(now, recipe, &payload),
            (
                reply,
                Step::LookingForOwner { .. } | Step::WaitingForInputs { .. } | Step::RequestedPause { .. },
            ) => {
                self.while_taken(now, reply);
            }
            // On its way when the stream was paused.
            (Reply::Data { .. }, Step::RequestedInputs { attempt: 2.., .. }) => {}
            (unexpected, _) => {
                let kind = unexpected.name();
                self.fault(format!("unexpected {kind} while waiting for {}", self.waiting_for()));
            }
        }
    }

    fn outputs_offered(&mut self, now: Timestamp, recipe: u8, offers: &[Offer]) {
        match agree(recipe, &output_names(), offers) {
            Ok(recipe) => {
                let wrong = recipe.fields.iter().find(|(name, kind)| output_type(name) != Some(*kind));
                if let Some((name, kind)) = wrong {
                    return self.fault(format!("output {name} has type {}", kind.token()));
                }
                self.outputs = recipe;
                self.request_inputs(now, HEARTBEAT, 1);
            }
            Err(refusal) => self.fault(refusal.text("output")),
        }
    }

    fn request_inputs(&mut self, now: Timestamp, index: usize, attempt: u32) {
        self.request(&Request::SetupInputs { names: input_names(index) });
        self.step = Step::RequestedInputs { index, deadline: now + ANSWER_WITHIN, attempt };
    }

    /// The stream runs without inputs, to read who holds them.
    fn while_taken(&mut self, now: Timestamp, reply: Reply) {
        match (reply, &self.step) {
            (Reply::Data { payload, .. }, Step::LookingForOwner { .. }) => self.note_mark(&payload),
            (Reply::Pause(_), &Step::RequestedPause { index, attempt, .. }) => {
                self.request_inputs(now, index, attempt);
            }
            // A controller that does not start shows no owner; that is no fault.
            (Reply::Start(_) | Reply::Data { .. }, _) => {}
            (unexpected, _) => {
                let kind = unexpected.name();
                self.fault(format!("unexpected {kind} while waiting for {}", self.waiting_for()));
            }
        }
    }

    /// A mark that changes is that of a celld which is connected.
    fn note_mark(&mut self, payload: &[u8]) {
        let values = self.outputs.decode(payload, Leftover::Refuse);
        let Some(now) = values.ok().and_then(|values| mark_in(&values)) else { return };
        let Step::LookingForOwner { mark, .. } = &mut self.step else { return };
        if let Some(process) = mark.replace(now).and_then(|before| process_of(before, now)) {
            self.owner_found(Some(process));
        }
    }

    fn owner_found(&mut self, celld: Option<u32>) {
        let step = std::mem::replace(&mut self.step, Step::Down);
        let Step::LookingForOwner { index, names, since, attempt, .. } = step else { return };
        self.outbox.report(RtdeEvent::InUse { taken: InputsTaken { names, celld }, attempt });
        self.step = Step::WaitingForInputs { index, retry_at: since + IN_USE_RETRY, attempt: attempt + 1 };
    }

    fn inputs_offered(&mut self, now: Timestamp, index: usize, attempt: u32, recipe: u8, offers: &[Offer]) {
        match agree(recipe, &input_names(index), offers) {
            Ok(recipe) => {
                self.inputs.push(recipe);
                if index == OWNER {
                    self.request(&Request::Start);
                    self.step = Step::RequestedStart { deadline: now + ANSWER_WITHIN };
                } else {
                    self.request_inputs(now, index + 1, 1);
                }
            }
            Err(Refusal::InUse(names)) if attempt < IN_USE_TRIES => {
                self.request(&Request::Start);
                self.step = Step::LookingForOwner { index, names, since: now, attempt, mark: None };
            }
            Err(refusal) => self.fault(refusal.text("input")),
        }
    }

    fn data(&mut self, now: Timestamp, recipe: u8, payload: &[u8]) {
        if recipe != self.outputs.id {
            return self.fault(format!("data for recipe {recipe}, agreed was {}", self.outputs.id));
        }
        let values = match self.outputs.decode(payload, Leftover::Refuse) {
            Ok(values) => values,
            Err(error) => return self.fault(error.to_string()),
        };
        let mut fields = self.outputs.fields.iter().zip(&values);
        if let Err(fault) = fields.try_for_each(|((name, _), value)| rtde_ranges::check(name, value)) {
            return self.fault(fault.to_string());
        }
        match state_of(now, &values) {
            Some(state) => self.new_state(now, state),
            None => self.fault("a state package does not have the fields agreed".into()),
        }
    }

    fn new_state(&mut self, now: Timestamp, state: RobotState) {
        let before = self.latest.as_ref();
        let step_s =
            before.map_or(f64::INFINITY, |before| state.controller_time_s - before.controller_time_s);
        if step_s < 0.0 {
            return self.fault(format!("controller time jumped back by {:.3} s: it has restarted", -step_s));
        }
        let jump = before.filter(|_| self.ready()).and_then(|before| Jump::between(before, &state));
        // A package whose time does not advance proves nothing about now.
        let received = before.filter(|_| step_s == 0.0).map_or(state.received, |before| before.received);
        let settled_by_time = state.controller_time_s > SETTLED_AT_S;
        self.latest = Some(RobotState { received, ..state });
        // The link stays: the quickest stop goes over it.
        if let Some(jump) = jump {
            self.outbox.report(RtdeEvent::Jump(jump.to_string()));
        }
        if let Step::Streaming { last_package, packages, settled } = &mut self.step {
            *last_package = now;
            *packages = packages.saturating_add(1);
            let enough = f64::from(*packages) >= SETTLED_AFTER_S * self.frequency_hz;
            if !*settled && (settled_by_time || enough) {
                *settled = true;
                self.outbox.report(RtdeEvent::Ready);
            }
            self.write_mark(now);
        }
    }
}
