//! The way from a session to its client: a bounded queue, and a shortcut past it.
//!
//! In: what answers and outlets send on a [`Line`]. Out: [`Packet`]s at its [`Inlet`], in order, for the
//! writer that sends them to the client. A full queue means that the client is behind. While nothing is
//! queued a package may go straight to the socket on the [`Way`] that the shell has given, from the thread
//! that makes the frames; without one everything is queued.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use tokio::sync::{Notify, mpsc};

/// Packages a connection may be behind.
const QUEUE: usize = 128;

/// Bytes on their way to a client.
pub type Bytes = Arc<[u8]>;

/// Bytes in a connection's queue, and when the frame they are from was due.
#[derive(Debug)]
pub struct Packet {
    bytes: Bytes,
    due: Option<Instant>,
}

impl Packet {
    /// What goes to the client.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// When the frame that it is from was due, for packages whose punctuality counts.
    pub fn due(&self) -> Option<Instant> {
        self.due
    }
}

impl From<Vec<u8>> for Packet {
    fn from(bytes: Vec<u8>) -> Packet {
        Packet { bytes: bytes.into(), due: None }
    }
}

impl From<Bytes> for Packet {
    fn from(bytes: Bytes) -> Packet {
        Packet { bytes, due: None }
    }
}

/// What takes bytes to a client at once, past the queue. Its user makes sure that nothing else writes
/// meanwhile.
pub trait Way: fmt::Debug + Send + Sync {
    /// Takes as many of `bytes` as go at once; 0 also when the connection is broken.
    fn try_write(&self, bytes: &[u8]) -> usize;
}

/// The receiving end of a connection, for its writer.
#[derive(Debug)]
pub struct Inlet {
    /// What to write.
    pub queue: Queue,
    /// Wakes when the connection is to be dropped at once.
    pub dropped: Arc<Notify>,
    /// For replies of the connection itself.
    pub replies: Line,
}

impl Inlet {
    /// The next bytes for the client, without waiting: for a simulator that is driven by calls.
    pub fn take(&mut self) -> Option<Bytes> {
        let packet = self.queue.packets.try_recv().ok()?;
        self.queue.written();
        Some(packet.bytes)
    }
}

/// What is queued for a client.
#[derive(Debug)]
pub struct Queue {
    packets: mpsc::Receiver<Packet>,
    backlog: Backlog,
}

impl Queue {
    /// The next parcel when there is one; `None` when no sender is left.
    pub async fn next(&mut self) -> Option<Packet> {
        self.packets.recv().await
    }

    /// A parcel of [`Queue::next`] is on its way.
    pub fn written(&self) {
        *self.backlog.lock() -= 1;
    }
}

/// The sending end of a connection's queue. It counts what is queued and not written yet: while that is
/// nothing, and the count is locked, no task writes to the socket.
#[derive(Clone, Debug)]
pub struct Line {
    queue: mpsc::Sender<Packet>,
    backlog: Backlog,
    dropped: Arc<Notify>,
    way: Option<Arc<dyn Way>>,
}

/// How many parcels are queued and not written yet.
#[derive(Clone, Debug, Default)]
struct Backlog(Arc<Mutex<usize>>);

impl Backlog {
    fn lock(&self) -> MutexGuard<'_, usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Line {
    /// Both ends of a connection's queue; with a way packages need not wait for the writer.
    pub fn open(way: Option<Arc<dyn Way>>) -> (Line, Inlet) {
        let (sender, packets) = mpsc::channel(QUEUE);
        let (backlog, dropped) = (Backlog::default(), Arc::new(Notify::new()));
        let line = Line { queue: sender, backlog: backlog.clone(), dropped: dropped.clone(), way };
        let inlet = Inlet { queue: Queue { packets, backlog }, dropped, replies: line.clone() };
        (line, inlet)
    }

    /// Queues a parcel when there is room; false when the connection is over.
    pub async fn send(&self, packet: Packet) -> bool {
        *self.backlog.lock() += 1;
        self.queue.send(packet).await.is_ok()
    }

    /// Queues a parcel; false when there is no room.
    pub fn try_send(&self, packet: Packet) -> bool {
        let mut backlog = self.backlog.lock();
        let queued = self.queue.try_send(packet).is_ok();
        *backlog += usize::from(queued);
        queued
    }

    /// Sends bytes of the frame that was due at `due`: at once if nothing is queued, and what does not go at
    /// once through the queue.
    pub fn pass(&self, bytes: &Bytes, due: Option<Instant>) -> Passed {
        let mut backlog = self.backlog.lock();
        let written = match &self.way {
            Some(way) if *backlog == 0 => way.try_write(bytes),
            _ => 0,
        };
        if written == bytes.len() {
            return Passed::Written;
        }
        let rest = if written == 0 { bytes.clone() } else { Arc::from(&bytes[written..]) };
        if self.queue.try_send(Packet { bytes: rest, due }).is_err() {
            return Passed::Refused;
        }
        *backlog += 1;
        Passed::Queued
    }

    /// Something is queued that is not written yet.
    pub fn has_queued(&self) -> bool {
        *self.backlog.lock() > 0
    }

    /// The queue is more than half full.
    pub fn is_behind(&self) -> bool {
        self.queue.capacity() < QUEUE / 2
    }

    /// Nothing is taken from the queue any more.
    pub fn is_closed(&self) -> bool {
        self.queue.is_closed()
    }

    /// Ends the connection.
    pub fn hang_up(&self) {
        self.dropped.notify_one();
    }
}

/// What became of a package.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Passed {
    /// The system has it.
    Written,
    /// The connection's writer will write it, or its end.
    Queued,
    /// The client is too far behind.
    Refused,
}
