//! What the controller sends without a request: which client gets what, how often, and what happens when a
//! client does not read.
//!
//! In: connections that subscribe, and the controller's state at the end of every frame. Out: bytes into one
//! bounded queue per connection ([`Line`]). A full queue means that the client is behind: its package is
//! skipped, never stored elsewhere. An RTDE client that stays behind for 10 s is dropped, as on the
//! controller; the others are not, because real clients keep a script connection open for hours without
//! reading it. Clients with equal recipes share one encoding.
//! Also here, because it concerns the same connections: how punctual packages are on their way out.

use crate::controller::outputs::Output;
use crate::controller::registers::ClientId;
use crate::controller::{Controller, realtime, robot_state};
use crate::motion::FRAMES_PER_SECOND;
use crate::robot_server::latency::LatencyHistogram;
use crate::robot_server::line::{Bytes, Inlet, Line, Passed, Way};
use std::sync::Arc;
use std::time::Instant;
use ur_wire::bytes::Writer;
use ur_wire::primary::Package;
use ur_wire::primary_message::{Message, MessageBody};
use ur_wire::primary_state::SubPackage;
use ur_wire::rtde::{Reply, Version};
use ur_wire::rtde_values::Recipe;

/// Frames without room after which an RTDE client is dropped (10 s).
const PATIENCE: u64 = 10 * FRAMES_PER_SECOND;

/// Frames between two robot states (10 Hz).
const STATE_INTERVAL: u64 = FRAMES_PER_SECOND / 10;

/// Sender of robot messages as the vendor's interface numbers it.
const SOURCE_ROBOT: i8 = -3;

/// `requested type` of a popup that requests nothing.
const NO_VALUE: u32 = 8;

/// What a connection is fed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feed {
    /// Robot state and all messages.
    Primary,
    /// Robot state.
    Secondary,
    /// The real-time block.
    Realtime,
    /// An RTDE recipe.
    Rtde,
}

/// What an RTDE client wants to be sent.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The recipe.
    pub recipe: Recipe,
    /// How to sample its fields.
    pub fields: Vec<Output>,
    /// For the encoding.
    pub version: Version,
}

impl Plan {
    /// The data package of this frame.
    fn encode(&self, controller: &Controller) -> Bytes {
        let mut payload = Writer::new();
        for field in &self.fields {
            field.sample(controller).encode(&mut payload);
        }
        let reply = Reply::Data { recipe: self.recipe.id, payload: payload.finish() };
        reply.encode(self.version).into()
    }

    fn same(&self, other: &Plan) -> bool {
        self.recipe == other.recipe && self.version == other.version
    }
}

/// A plan, shared with the clients who want the same, and how often.
#[derive(Clone, Debug)]
struct Subscription {
    plan: Arc<Plan>,
    interval: u64,
}

#[derive(Debug)]
struct Client {
    id: ClientId,
    feed: Feed,
    /// Its port takes no scripts.
    read_only: bool,
    line: Line,
    behind: u64,
    given_up: bool,
    subscription: Option<Subscription>,
    started: bool,
}

/// All connections that are sent something.
#[derive(Debug, Default)]
pub struct Publisher {
    clients: Vec<Client>,
    last_id: u64,
    switches: u64,
    sent: u64,
    skipped: u64,
    /// Of the sent ones, those that needed no queue.
    at_once: u64,
    /// Frames between RTDE packages whatever was agreed (a fault).
    forced_interval: Option<u64>,
    /// The popup of the last frame.
    popup: Option<String>,
    /// A protective stop was in force in the last frame.
    stopped: bool,
}

impl Publisher {
    /// Adds a connection; RTDE connections get data only after [`Publisher::subscribe`] and
    /// [`Publisher::start`]. With a `way` to the client packages need not wait for its writer.
    pub fn open(&mut self, feed: Feed, read_only: bool, way: Option<Arc<dyn Way>>) -> (ClientId, Inlet) {
        self.last_id += 1;
        let id = ClientId(self.last_id);
        let (line, inlet) = Line::open(way);
        self.clients.push(Client {
            id,
            feed,
            read_only,
            line,
            behind: 0,
            given_up: false,
            subscription: None,
            started: false,
        });
        (id, inlet)
    }

    /// Removes a connection.
    pub fn close(&mut self, id: ClientId) {
        self.clients.retain(|client| client.id != id);
    }

    /// Sets a connection's recipe, in place of an earlier one; `interval` in frames between packages.
    pub fn subscribe(&mut self, id: ClientId, plan: Plan, interval: u64) {
        let known = self.clients.iter().filter_map(|client| client.subscription.as_ref());
        let known = known.map(|subscription| &subscription.plan).find(|known| known.same(&plan)).cloned();
        if let Some(client) = self.find(id) {
            let plan = known.unwrap_or_else(|| Arc::new(plan));
            client.subscription = Some(Subscription { plan, interval });
        }
    }

    /// Sends RTDE packages at another rate than was agreed (a fault); `None`: as agreed.
    pub fn force_rate(&mut self, hz: Option<f64>) {
        self.forced_interval = hz.map(|hz| (FRAMES_PER_SECOND as f64 / hz).round().max(1.0) as u64);
    }

    /// True if it is agreed what the connection's data are.
    pub fn has_recipe(&self, id: ClientId) -> bool {
        self.clients.iter().any(|client| client.id == id && client.subscription.is_some())
    }

    /// Starts a connection's data.
    pub fn start(&mut self, id: ClientId) {
        if let Some(client) = self.find(id) {
            client.started = client.subscription.is_some();
        }
    }

    /// Pauses a connection's data.
    pub fn pause(&mut self, id: ClientId) {
        if let Some(client) = self.find(id) {
            client.started = false;
        }
    }

    /// An RTDE client's queue is more than half full, and was not given up.
    pub fn a_client_is_behind(&self) -> bool {
        self.clients.iter().any(Client::is_behind)
    }

    /// Gives up waiting for the clients that are behind, until their queues have room again.
    pub fn give_up(&mut self) {
        for client in &mut self.clients {
            client.given_up |= client.is_behind();
        }
    }

    /// Whether anyone is connected.
    pub fn has_clients(&self) -> bool {
        !self.clients.is_empty()
    }

    /// True until the connection was closed or dropped.
    pub fn is_open(&self, id: ClientId) -> bool {
        self.clients.iter().any(|client| client.id == id)
    }

    /// Connections with this feed.
    pub fn subscribers(&self, feed: Feed) -> usize {
        self.clients.iter().filter(|client| client.feed == feed).count()
    }

    /// RTDE packages sent and skipped so far.
    pub fn counts(&self) -> (u64, u64) {
        (self.sent, self.skipped)
    }

    /// RTDE packages that the system took at once, without the connection's queue.
    pub fn sent_at_once(&self) -> u64 {
        self.at_once
    }

    fn find(&mut self, id: ClientId) -> Option<&mut Client> {
        self.clients.iter_mut().find(|client| client.id == id)
    }

    /// Sends what is due at the end of a frame; `due` is when the frame was, and what leaves at once is
    /// recorded.
    pub fn publish(&mut self, controller: &mut Controller, due: Option<Instant>, latency: &LatencyHistogram) {
        self.close_after_switch(controller);
        self.report_popup(controller);
        self.send_states(controller);
        self.send_packages(controller, due, latency);
        self.drop_the_hopeless();
    }

    /// Messages, robot states and real-time blocks. A state with a protective stop goes out at once and
    /// before the messages about it: clients that read an error look at the state they have.
    fn send_states(&mut self, controller: &mut Controller) {
        let step = controller.core.step;
        let messages = controller.core.take_messages();
        let messages: Vec<Bytes> =
            messages.into_iter().map(|body| encode_message(controller, body)).collect();
        let fed = |feed: Feed| self.clients.iter().any(|client| client.feed == feed);
        let stopped = controller.core.modes.protective_stopped();
        let stops = stopped && !std::mem::replace(&mut self.stopped, stopped);
        self.stopped = stopped;
        let state_due =
            (stops || step.is_multiple_of(STATE_INTERVAL)) && (fed(Feed::Primary) || fed(Feed::Secondary));
        let state = state_due.then(|| encode_state(robot_state::periodic(controller)));
        let block: Option<Bytes> = fed(Feed::Realtime).then(|| realtime::block(controller).into());
        for client in &mut self.clients {
            let due: Vec<&Bytes> = match client.feed {
                Feed::Primary if stops => state.iter().chain(&messages).collect(),
                Feed::Primary => messages.iter().chain(&state).collect(),
                Feed::Secondary => state.iter().collect(),
                Feed::Realtime => block.iter().collect(),
                Feed::Rtde => Vec::new(),
            };
            for bytes in due {
                client.send(bytes, None);
            }
        }
    }

    /// RTDE packages.
    fn send_packages(&mut self, controller: &Controller, due: Option<Instant>, latency: &LatencyHistogram) {
        let mut encoded: Vec<(Arc<Plan>, Bytes)> = Vec::new();
        for client in &mut self.clients {
            let Some(plan) = client.plan_of(controller.core.step, self.forced_interval) else { continue };
            let shared = encoded.iter().find(|(known, _)| Arc::ptr_eq(known, &plan));
            let bytes = match shared {
                Some((_, bytes)) => bytes.clone(),
                None => plan.encode(controller),
            };
            let at_once = matches!(client.send(&bytes, due), Passed::Written);
            self.at_once += u64::from(at_once);
            if let Some(due) = due.filter(|_| at_once) {
                latency.record(due.elapsed());
            }
            self.sent += u64::from(client.behind == 0);
            self.skipped += u64::from(client.behind > 0);
            encoded.push((plan, bytes));
        }
    }

    /// A popup that has come up is reported on the primary interface, whatever opened it.
    fn report_popup(&mut self, controller: &mut Controller) {
        if self.popup == controller.core.popup {
            return;
        }
        self.popup = controller.core.popup.clone();
        let Some(text) = self.popup.clone() else { return };
        controller.core.message(MessageBody::Popup {
            request: 0,
            value_type: NO_VALUE,
            warning: false,
            error: false,
            blocking: false,
            title: "Popup".to_owned(),
            text,
        });
    }

    fn drop_the_hopeless(&mut self) {
        self.clients.retain(|client| {
            let hopeless = client.feed == Feed::Rtde && client.behind > PATIENCE;
            if hopeless {
                client.line.hang_up();
            }
            !hopeless && !client.line.is_closed()
        });
    }

    /// A switch to local control closes the connections that take scripts.
    fn close_after_switch(&mut self, controller: &Controller) {
        let switches = controller.core.modes.switches();
        if std::mem::replace(&mut self.switches, switches) == switches || controller.core.modes.remote() {
            return;
        }
        self.clients.retain(|client| {
            let stays = client.feed == Feed::Rtde || client.read_only;
            if !stays {
                client.line.hang_up();
            }
            stays
        });
    }
}

impl Client {
    fn is_behind(&self) -> bool {
        self.started && !self.given_up && self.line.is_behind()
    }

    /// Sends a package, or counts the frames it was to last if there is no room.
    fn send(&mut self, bytes: &Bytes, due: Option<Instant>) -> Passed {
        self.given_up &= self.line.is_behind();
        let frames = self.subscription.as_ref().map_or(1, |subscription| subscription.interval);
        let passed = self.line.pass(bytes, due);
        self.behind = if matches!(passed, Passed::Refused) { self.behind + frames } else { 0 };
        passed
    }

    /// What is to be sent in this frame, if anything.
    fn plan_of(&self, step: u64, forced_interval: Option<u64>) -> Option<Arc<Plan>> {
        let subscription = self.subscription.as_ref().filter(|_| self.started)?;
        let interval = forced_interval.unwrap_or(subscription.interval);
        step.is_multiple_of(interval).then(|| subscription.plan.clone())
    }
}

/// A robot message as a package.
pub fn encode_message(controller: &Controller, body: MessageBody) -> Bytes {
    let timestamp = (controller.core.timestamp() * 1e6) as u64;
    Package::Message(Message { timestamp, source: SOURCE_ROBOT, body }).encode().into()
}

/// A robot state as a package.
pub fn encode_state(parts: Vec<SubPackage>) -> Bytes {
    Package::RobotState(parts).encode().into()
}
