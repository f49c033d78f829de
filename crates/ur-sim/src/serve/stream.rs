//! Sockets that can go wrong: every connection of the simulator's servers passes through here.
//!
//! In: a TCP connection and the state of its server's [`Link`]. Out: the same bytes, or what the faults
//! leave of them. Without faults nothing is copied or delayed. A cut cable is modelled as silence: both
//! directions wait, and go on where they were when the fault ends, as TCP does.
//!
//! A [`Shortcut`] writes to the socket from any thread, without waking a task first: a second wake-up is a
//! second chance to be late. It works only while nothing is wrong.

use crate::faults::link::{Link, LinkState};
use crate::robot_server::line::Way;
use crate::serve::seats::{Seat, Seats};
use rustix::event::{PollFd, PollFlags, Timespec};
use std::collections::VecDeque;
use std::future::Future;
use std::io::{Error, ErrorKind};
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::task::{Context, Poll, Waker, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::time::{Instant, Sleep};

/// Most bytes held back for a delay.
const MOST_DELAYED: usize = 4 << 20;

/// A listener whose connections pass through a link, for the HTTP server.
#[derive(Debug)]
pub struct LinkListener {
    /// The listener.
    pub listener: TcpListener,
    /// The link.
    pub link: Arc<Link>,
    /// Places for connections.
    pub seats: Seats,
}

impl axum::serve::Listener for LinkListener {
    type Io = LinkStream;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (LinkStream, SocketAddr) {
        loop {
            match self.listener.accept().await {
                // A controller that boots has no servers.
                Ok(_) if self.link.state().down => {}
                Ok((stream, address)) => {
                    return (LinkStream::new(stream, &self.link, Some(self.seats.take())), address);
                }
                // Accepting can fail for want of file handles; the next attempt may succeed.
                Err(_) => tokio::time::sleep(Duration::from_millis(10)).await,
            }
        }
    }

    fn local_addr(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

type Change = Pin<Box<dyn Future<Output = watch::Receiver<LinkState>> + Send + Sync>>;

/// The state as one direction of a connection sees it; it wakes that direction when it changes.
struct Follower {
    now: LinkState,
    change: Change,
}

impl Follower {
    fn new(mut receiver: watch::Receiver<LinkState>) -> Follower {
        let now = receiver.borrow_and_update().clone();
        Follower { now, change: next_change(receiver) }
    }

    fn poll(&mut self, context: &mut Context<'_>) -> &LinkState {
        while let Poll::Ready(mut receiver) = self.change.as_mut().poll(context) {
            self.now = receiver.borrow_and_update().clone();
            self.change = next_change(receiver);
        }
        &self.now
    }
}

fn next_change(mut receiver: watch::Receiver<LinkState>) -> Change {
    Box::pin(async move {
        if receiver.changed().await.is_err() {
            // The link is gone, and with it everything that could change.
            std::future::pending::<()>().await;
        }
        receiver
    })
}

/// The socket of a connection, and what its two ways of writing have to know of each other.
#[derive(Debug)]
struct Lane {
    stream: TcpStream,
    /// Bytes sent so far, for faults that count them.
    written: AtomicU64,
    /// Bytes are held back for a delay: nothing may overtake them.
    holds_back: AtomicBool,
    /// What was read last is still being worked on.
    at_work: AtomicBool,
}

impl Lane {
    fn poll_write(&self, context: &mut Context<'_>, bytes: &[u8]) -> Poll<std::io::Result<usize>> {
        loop {
            ready!(self.stream.poll_write_ready(context))?;
            match self.stream.try_write(bytes) {
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                result => return Poll::Ready(result),
            }
        }
    }

    fn poll_read(&self, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<std::io::Result<()>> {
        loop {
            ready!(self.stream.poll_read_ready(context))?;
            match self.stream.try_read(buffer.initialize_unfilled()) {
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) => return Poll::Ready(Err(error)),
                Ok(count) => {
                    buffer.advance(count);
                    return Poll::Ready(Ok(()));
                }
            }
        }
    }
}

/// The way to a connection's socket past its task. Its user makes sure that the task writes nothing
/// meanwhile.
#[derive(Clone, Debug)]
pub struct Shortcut {
    lane: Arc<Lane>,
    link: watch::Receiver<LinkState>,
    resets: u64,
    seat: Option<Arc<Seat>>,
}

impl Shortcut {
    /// No fault acts on the link.
    fn is_sound(&self) -> bool {
        *self.link.borrow() == LinkState { resets: self.resets, ..LinkState::default() }
    }

    /// True if the connection's tasks could do something: read, go on with what was read, or write what is
    /// `queued`. Never while a fault acts on the link.
    pub fn has_work(&self, queued: bool) -> bool {
        if !self.is_sound() {
            return false;
        }
        if self.lane.at_work.load(Ordering::Acquire) {
            return true;
        }
        let wanted = if queued { PollFlags::IN | PollFlags::OUT } else { PollFlags::IN };
        let mut sockets = [PollFd::new(&self.lane.stream, wanted)];
        let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
        let ready = rustix::event::poll(&mut sockets, Some(&at_once));
        ready.is_ok_and(|count| count > 0) && sockets.iter().any(|one| one.revents().intersects(wanted))
    }
}

impl Way for Shortcut {
    /// 0 also when something is wrong with the link, which is for the connection's task to find.
    fn try_write(&self, bytes: &[u8]) -> usize {
        if !self.is_sound() || self.lane.holds_back.load(Ordering::Acquire) {
            return 0;
        }
        let count = self.lane.stream.try_write(bytes).unwrap_or(0);
        if let Some(seat) = self.seat.as_ref().filter(|_| count > 0) {
            seat.heard();
        }
        self.lane.written.fetch_add(count as u64, Ordering::Relaxed);
        count
    }
}

/// A connection that passes through a link.
pub struct LinkStream {
    lane: Arc<Lane>,
    link: watch::Receiver<LinkState>,
    reading: Follower,
    writing: Follower,
    resets: u64,
    dead: bool,
    /// A slice was just sent: others come first.
    pause: bool,
    delayed: VecDeque<(Instant, Vec<u8>)>,
    delayed_bytes: usize,
    timer: Pin<Box<Sleep>>,
    /// The task that waits to read, which sends what is held back when its time has come.
    reader: Option<Waker>,
    /// Its place, at a server that has a limit of them.
    seat: Option<Arc<Seat>>,
}

impl LinkStream {
    /// A connection just made.
    pub fn new(stream: TcpStream, link: &Link, seat: Option<Arc<Seat>>) -> LinkStream {
        let (reading, writing) = (Follower::new(link.watch()), Follower::new(link.watch()));
        let (holds_back, at_work) = (AtomicBool::new(false), AtomicBool::new(false));
        let lane = Lane { stream, written: AtomicU64::new(0), holds_back, at_work };
        LinkStream {
            lane: Arc::new(lane),
            link: link.watch(),
            resets: reading.now.resets,
            reading,
            writing,
            dead: false,
            pause: false,
            delayed: VecDeque::new(),
            delayed_bytes: 0,
            timer: Box::pin(tokio::time::sleep(Duration::ZERO)),
            reader: None,
            seat,
        }
    }

    /// A way to write to the socket from another thread.
    pub fn shortcut(&self) -> Shortcut {
        let (link, seat) = (self.link.clone(), self.seat.clone());
        Shortcut { lane: self.lane.clone(), link, resets: self.resets, seat }
    }

    /// Sends what has been held back long enough.
    fn send_delayed(&mut self, context: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        while let Some((due, bytes)) = self.delayed.front_mut() {
            if Instant::now() < *due {
                self.timer.as_mut().reset(*due);
                ready!(self.timer.as_mut().poll(context));
                continue;
            }
            let count = ready!(self.lane.poll_write(context, bytes))?;
            self.delayed_bytes = self.delayed_bytes.saturating_sub(count);
            bytes.drain(..count);
            if bytes.is_empty() {
                self.delayed.pop_front();
            }
        }
        self.lane.holds_back.store(false, Ordering::Release);
        Poll::Ready(Ok(()))
    }

    fn die(&mut self) -> Error {
        self.dead = true;
        Error::from(ErrorKind::ConnectionReset)
    }
}

impl AsyncRead for LinkStream {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<std::io::Result<()>> {
        let this = self.get_mut();
        this.lane.at_work.store(false, Ordering::Release);
        this.reader = Some(context.waker().clone());
        if let Some(Poll::Ready(())) = this.seat.as_ref().map(|seat| seat.poll_leave(context)) {
            return Poll::Ready(Err(ErrorKind::ConnectionAborted.into()));
        }
        let state = this.reading.poll(context);
        let (resets, silent) = (state.resets, state.silent);
        if resets != this.resets {
            return Poll::Ready(Err(this.die()));
        }
        if silent {
            return Poll::Pending;
        }
        // Who writes may have nothing more to write; who reads is always waiting, so what is held back is
        // sent from here.
        if let Poll::Ready(Err(error)) = this.send_delayed(context) {
            return Poll::Ready(Err(error));
        }
        let before = buffer.filled().len();
        ready!(this.lane.poll_read(context, buffer))?;
        this.lane.at_work.store(buffer.filled().len() > before, Ordering::Release);
        if let Some(seat) = &this.seat {
            seat.heard();
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for LinkStream {
    fn poll_write(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<std::io::Result<usize>> {
        let this = self.get_mut();
        let state = this.writing.poll(context);
        let (resets, silent, latency) = (state.resets, state.silent, state.latency);
        let (slice, limit) = (state.slice, state.limit);
        let left =
            limit.map_or(u64::MAX, |limit| limit.saturating_sub(this.lane.written.load(Ordering::Relaxed)));
        if resets != this.resets || (left == 0 && !bytes.is_empty()) {
            return Poll::Ready(Err(this.die()));
        }
        if silent {
            return Poll::Pending;
        }
        if std::mem::take(&mut this.pause) {
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        this.pause = slice.is_some();
        let most =
            bytes.len().min(slice.unwrap_or(usize::MAX)).min(usize::try_from(left).unwrap_or(usize::MAX));
        let piece = &bytes[..most];
        let count = if latency.is_zero() && this.delayed.is_empty() {
            ready!(this.lane.poll_write(context, piece))?
        } else {
            this.lane.holds_back.store(true, Ordering::Release);
            this.delayed.push_back((Instant::now() + latency, piece.to_vec()));
            this.delayed_bytes += piece.len();
            if this.delayed_bytes > MOST_DELAYED {
                return Poll::Ready(Err(this.die()));
            }
            match this.reader.take() {
                Some(reader) => reader.wake(),
                None => {
                    if let Poll::Ready(Err(error)) = this.send_delayed(context) {
                        return Poll::Ready(Err(error));
                    }
                }
            }
            piece.len()
        };
        this.lane.written.fetch_add(count as u64, Ordering::Relaxed);
        if let Some(seat) = &this.seat {
            seat.heard();
        }
        Poll::Ready(Ok(count))
    }

    fn poll_flush(self: Pin<&mut Self>, _context: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        // A socket holds nothing back; what a delay holds back is not owed yet.
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _context: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(rustix::net::shutdown(&self.lane.stream, rustix::net::Shutdown::Write)?))
    }
}

impl Drop for LinkStream {
    fn drop(&mut self) {
        if self.dead {
            // The peer sees a reset instead of an orderly end; failing that, it sees the end.
            let _ = rustix::net::sockopt::set_socket_linger(&self.lane.stream, Some(Duration::ZERO));
        }
    }
}
