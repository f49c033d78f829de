//! What the controller sends without being asked: who gets what, how often, and what happens when a client
//! does not read.
//!
//! In: connections that subscribe, and the controller's state at the end of every frame. Out: bytes into one
//! bounded queue per connection. A full queue means that the client is behind: its package is skipped, never
//! stored elsewhere. An RTDE client that stays behind for 10 s is dropped, as on the controller; the others
//! are not, because real clients keep a script connection open for hours without reading it.
//! Also here, because it concerns the same connections: when a client that writes inputs regularly is late.

use crate::sim::controller::outputs::Output;
use crate::sim::controller::registers::ClientId;
use crate::sim::controller::{Controller, FRAMES_PER_SECOND, realtime, robot_state};
use crate::wire::primary::Package;
use crate::wire::primary_message::Message;
use crate::wire::primary_state::SubPackage;
use crate::wire::rtde::{Reply, Version};
use crate::wire::rtde_values::Recipe;
use std::sync::Arc;
use tokio::sync::{Notify, mpsc};

/// Packages a connection may be behind.
const QUEUE: usize = 128;

/// Frames without room after which an RTDE client is dropped (10 s).
const PATIENCE: u64 = 10 * FRAMES_PER_SECOND;

/// Frames between two robot states (10 Hz).
const STATE_INTERVAL: u64 = FRAMES_PER_SECOND / 10;

/// Frames of silence after which a regular writer is late (60 ms), and intervals that make one regular.
const LATE_FRAMES: u64 = 30;
const REGULAR_INTERVALS: u32 = 5;

/// Sender of robot messages as the vendor's interface numbers it.
const SOURCE_ROBOT: i8 = -3;

/// Bytes on their way to a client.
pub type Bytes = Arc<[u8]>;

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

/// An RTDE client's output recipe.
#[derive(Clone, Debug)]
pub struct Subscription {
    /// The recipe.
    pub recipe: Recipe,
    /// How to sample its fields.
    pub fields: Vec<Output>,
    /// Frames between two packages.
    pub interval: u64,
    /// For the encoding.
    pub version: Version,
}

/// The receiving end of a connection's queue, for its writer.
#[derive(Debug)]
pub struct Inlet {
    /// The connection.
    pub id: ClientId,
    /// What to write.
    pub queue: mpsc::Receiver<Bytes>,
    /// Wakes when the connection is to be dropped at once.
    pub dropped: Arc<Notify>,
    /// For replies of the connection itself.
    pub replies: mpsc::Sender<Bytes>,
}

#[derive(Debug)]
struct Outlet {
    id: ClientId,
    feed: Feed,
    queue: mpsc::Sender<Bytes>,
    dropped: Arc<Notify>,
    behind: u64,
    given_up: bool,
    subscription: Option<Subscription>,
    started: bool,
    writes: Writes,
}

/// When a client wrote inputs.
#[derive(Debug, Default)]
struct Writes {
    last_step: u64,
    intervals: u32,
}

/// All connections that are sent something.
#[derive(Debug, Default)]
pub struct Outlets {
    outlets: Vec<Outlet>,
    last_id: u64,
    switches: u64,
    sent: u64,
    skipped: u64,
}

impl Outlets {
    /// Adds a connection; RTDE connections get data only after [`Outlets::subscribe`] and
    /// [`Outlets::start`].
    pub fn open(&mut self, feed: Feed) -> Inlet {
        self.last_id += 1;
        let id = ClientId(self.last_id);
        let (sender, queue) = mpsc::channel(QUEUE);
        let dropped = Arc::new(Notify::new());
        self.outlets.push(Outlet {
            id,
            feed,
            queue: sender.clone(),
            dropped: dropped.clone(),
            behind: 0,
            given_up: false,
            subscription: None,
            started: false,
            writes: Writes::default(),
        });
        Inlet { id, queue, dropped, replies: sender }
    }

    /// Removes a connection.
    pub fn close(&mut self, id: ClientId) {
        self.outlets.retain(|outlet| outlet.id != id);
    }

    /// Sets a connection's recipe, in place of an earlier one.
    pub fn subscribe(&mut self, id: ClientId, subscription: Subscription) {
        if let Some(outlet) = self.find(id) {
            outlet.subscription = Some(subscription);
        }
    }

    /// Starts or pauses a connection's data; false without a recipe.
    pub fn start(&mut self, id: ClientId, started: bool) -> bool {
        let Some(outlet) = self.find(id) else { return false };
        outlet.started = started && outlet.subscription.is_some();
        outlet.started == started
    }

    /// Notes that a client wrote inputs in the frame `step`.
    pub fn wrote(&mut self, id: ClientId, step: u64) {
        let Some(outlet) = self.find(id) else { return };
        let gap = step.saturating_sub(outlet.writes.last_step);
        // Several packages in one frame are one sign of life.
        if gap > 0 {
            outlet.writes.intervals =
                if gap <= LATE_FRAMES { outlet.writes.intervals.saturating_add(1) } else { 0 };
            outlet.writes.last_step = step;
        }
    }

    /// A client that writes regularly has not written for 60 ms.
    pub fn someone_is_late(&self, step: u64) -> bool {
        self.outlets.iter().any(|outlet| outlet.is_late(step))
    }

    /// An RTDE client's queue is more than half full, and was not given up.
    pub fn someone_is_behind(&self) -> bool {
        self.outlets.iter().any(Outlet::is_behind)
    }

    /// Gives up waiting: who is late counts as irregular until it writes regularly again, who is behind until
    /// its queue has room again.
    pub fn give_up(&mut self, step: u64) {
        for outlet in &mut self.outlets {
            if outlet.is_late(step) {
                outlet.writes.intervals = 0;
            }
            outlet.given_up |= outlet.is_behind();
        }
    }

    /// Connections with this feed.
    pub fn outlets_of(&self, feed: Feed) -> usize {
        self.outlets.iter().filter(|outlet| outlet.feed == feed).count()
    }

    /// RTDE packages sent and skipped so far.
    pub fn counts(&self) -> (u64, u64) {
        (self.sent, self.skipped)
    }

    fn find(&mut self, id: ClientId) -> Option<&mut Outlet> {
        self.outlets.iter_mut().find(|outlet| outlet.id == id)
    }

    /// Sends what is due at the end of a frame.
    pub fn publish(&mut self, controller: &mut Controller) {
        self.close_after_switch(controller);
        let step = controller.core.step;
        let messages: Vec<Bytes> = controller
            .core
            .take_messages()
            .into_iter()
            .map(|body| encode_message(controller, body))
            .collect();
        let fed = |feed: Feed| self.outlets.iter().any(|outlet| outlet.feed == feed);
        let state_due = step.is_multiple_of(STATE_INTERVAL) && (fed(Feed::Primary) || fed(Feed::Secondary));
        let state = state_due.then(|| encode_state(robot_state::periodic(controller)));
        let block: Option<Bytes> = fed(Feed::Realtime).then(|| realtime::block(controller).into());
        let (mut sent, mut skipped) = (0, 0);
        for outlet in &mut self.outlets {
            match outlet.feed {
                Feed::Primary => messages.iter().chain(&state).for_each(|bytes| outlet.send(bytes.clone())),
                Feed::Secondary => state.iter().for_each(|bytes| outlet.send(bytes.clone())),
                Feed::Realtime => block.iter().for_each(|bytes| outlet.send(bytes.clone())),
                Feed::Rtde => {
                    if let Some(bytes) = outlet.data(controller, step) {
                        outlet.send(bytes);
                        sent += u64::from(outlet.behind == 0);
                        skipped += u64::from(outlet.behind > 0);
                    }
                }
            }
        }
        self.sent += sent;
        self.skipped += skipped;
        self.drop_the_hopeless();
    }

    fn drop_the_hopeless(&mut self) {
        self.outlets.retain(|outlet| {
            let hopeless = outlet.feed == Feed::Rtde && outlet.behind > PATIENCE;
            if hopeless {
                outlet.dropped.notify_one();
            }
            !hopeless && !outlet.queue.is_closed()
        });
    }

    /// A switch to local control closes the connections that take scripts.
    fn close_after_switch(&mut self, controller: &Controller) {
        let switches = controller.core.modes.switches();
        if std::mem::replace(&mut self.switches, switches) == switches || controller.core.modes.remote() {
            return;
        }
        self.outlets.retain(|outlet| {
            if outlet.feed != Feed::Rtde {
                outlet.dropped.notify_one();
            }
            outlet.feed == Feed::Rtde
        });
    }
}

impl Outlet {
    fn is_behind(&self) -> bool {
        self.started && !self.given_up && self.queue.capacity() < QUEUE / 2
    }

    fn is_late(&self, step: u64) -> bool {
        self.writes.intervals >= REGULAR_INTERVALS && step.saturating_sub(self.writes.last_step) > LATE_FRAMES
    }

    /// Queues a package, or counts the frames it was to last if there is no room.
    fn send(&mut self, bytes: Bytes) {
        self.given_up &= self.queue.capacity() < QUEUE / 2;
        let frames = self.subscription.as_ref().map_or(1, |subscription| subscription.interval);
        match self.queue.try_send(bytes) {
            Ok(()) => self.behind = 0,
            Err(_) => self.behind += frames,
        }
    }

    fn data(&self, controller: &Controller, step: u64) -> Option<Bytes> {
        let subscription = self.subscription.as_ref().filter(|_| self.started)?;
        if !step.is_multiple_of(subscription.interval) {
            return None;
        }
        let values: Vec<_> = subscription.fields.iter().map(|field| field.sample(controller)).collect();
        let payload = subscription.recipe.encode(&values).ok()?;
        let reply = Reply::Data { recipe: subscription.recipe.id, payload };
        Some(reply.encode(subscription.version).into())
    }
}

/// A robot message as a package.
pub fn encode_message(controller: &Controller, body: crate::wire::primary_message::MessageBody) -> Bytes {
    let timestamp = (controller.core.timestamp() * 1e6) as u64;
    Package::Message(Message { timestamp, source: SOURCE_ROBOT, body }).encode().into()
}

/// A robot state as a package.
pub fn encode_state(parts: Vec<SubPackage>) -> Bytes {
    Package::RobotState(parts).encode().into()
}
