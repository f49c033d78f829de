//! One TCP connection that never waits, and the attempt to make one.
//!
//! In: bytes to send, the time. Out: the bytes that have arrived, and how the connection ended. What the
//! system does not take is kept for the next call.

use crate::daemon::messages::{Made, Message, Peer};
use cell_edge::reserve::with_spare;
use cell_values::time::{Duration, Timestamp};
use std::io;
use std::net::SocketAddr;
use std::task::{Context, Poll};
use tokio::net::{TcpSocket, TcpStream};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

/// Bytes may wait this long for the peer to read, in the cell's time.
const WRITE_WITHIN: Duration = Duration::from_secs(2);

/// Most reads of one connection in one go: a peer that floods must not keep the others from their turn.
const READS: usize = 64;

/// A connection. See the module.
pub struct Stream {
    stream: TcpStream,
    unsent: Vec<u8>,
    unsent_since: Option<Timestamp>,
}

/// How a connection ended.
#[derive(Debug)]
pub enum Over {
    /// The peer closed it.
    Closed,
    /// It broke.
    Broken(io::Error),
    /// The peer does not read.
    Unread,
}

impl Stream {
    /// Takes over a connection; small packets leave at once.
    ///
    /// # Errors
    /// It is broken already.
    pub fn new(stream: TcpStream) -> io::Result<Stream> {
        stream.set_nodelay(true)?;
        Ok(Stream { stream, unsent: Vec::new(), unsent_since: None })
    }

    /// Sends as much as the system takes; the rest follows with [`Stream::write`].
    pub fn send(&mut self, now: Timestamp, bytes: &[u8]) {
        self.unsent.extend_from_slice(bytes);
        self.write(now);
    }

    /// Sends the rest, as much as the socket accepts.
    pub fn write(&mut self, now: Timestamp) {
        while !self.unsent.is_empty() {
            match self.stream.try_write(&self.unsent) {
                Ok(count) => drop(self.unsent.drain(..count)),
                // What is wrong with the connection is found when it is read.
                Err(_) => {
                    self.unsent_since.get_or_insert(now);
                    return;
                }
            }
        }
        self.unsent_since = None;
    }

    /// Reads until there is nothing more; how the connection ended, if it did.
    pub fn read(
        &mut self,
        now: Timestamp,
        buffer: &mut [u8],
        mut received: impl FnMut(Vec<u8>),
    ) -> Option<Over> {
        for _ in 0..READS {
            match self.stream.try_read(buffer) {
                Ok(0) => return Some(Over::Closed),
                Ok(count) => received(buffer.get(..count).unwrap_or_default().to_vec()),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(error) => return Some(Over::Broken(error)),
            }
        }
        self.unsent_since.is_some_and(|since| now.since(since) > WRITE_WITHIN).then_some(Over::Unread)
    }

    /// Ready when something has arrived, or can be sent that waits. Errors are found by reading.
    pub fn poll_ready(&self, context: &mut Context<'_>) -> Poll<()> {
        let readable = self.stream.poll_read_ready(context).is_ready();
        let writable = !self.unsent.is_empty() && self.stream.poll_write_ready(context).is_ready();
        if readable || writable { Poll::Ready(()) } else { Poll::Pending }
    }

    /// Retransmits lost packets at a steady interval instead of backing off, where the system supports that:
    /// the device answers as soon as its cable is back.
    pub fn repeats_soon(&self) {
        // If this fails, the connection recovers later.
        let _ = rustix::net::sockopt::set_tcp_thin_linear_timeouts(&self.stream, true);
    }

    /// From now on this connection is closed with a reset, even if this process dies. Undelivered data is
    /// discarded.
    pub fn ends_with_reset(&self) {
        // If this fails, the connection is closed in order.
        let _ = self.stream.set_zero_linger();
    }
}

/// Connects on a task of its own; [`Made`] follows.
pub fn attempt(
    to: Peer,
    attempt: u64,
    address: SocketAddr,
    messages: mpsc::Sender<Message>,
) -> JoinHandle<()> {
    tokio::spawn(async move {
        let result = connection_to(address).await;
        // The loop has ended if there is no receiver.
        let _ = messages.send(Message::Made(Made { to, attempt, result })).await;
    })
}

/// A connection to a device, with a handle of the reserve where there is no other.
async fn connection_to(address: SocketAddr) -> io::Result<TcpStream> {
    let socket = with_spare(|| match address {
        SocketAddr::V4(_) => TcpSocket::new_v4(),
        SocketAddr::V6(_) => TcpSocket::new_v6(),
    })?;
    socket.connect(address).await
}
