//! The sockets: three TCP connections to the controller, one Modbus connection to the gripper (`gripper`).
//! `stream`: one connection.
//!
//! In: the machine's connect, close, send and register effects. Out: events. Everything that lies in the
//! sockets is read in one call, so that nothing of it is missing when time is judged. Writing never waits:
//! what the system does not take is kept, and a controller that does not read for 2 s is disconnected.

mod gripper;
mod stream;

use crate::config::cell::Devices;
use crate::daemon::messages::{Made, Message, Peer};
use crate::daemon::sockets::gripper::GripperLine;
use crate::daemon::sockets::stream::{Over, Stream, attempt};
use cell_edge::clock::{Clock, Mark};
use cell_machine::device::gripper_types::ModbusRequest;
use cell_machine::device::robot_types::Link;
use cell_machine::event::Event;
use cell_values::time::Timestamp;
use std::net::{SocketAddr, ToSocketAddrs};
use std::task::{Context, Poll};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

/// Where the devices listen.
#[derive(Clone, Copy, Debug)]
pub struct Addresses {
    /// RTDE, port 30004.
    pub rtde: SocketAddr,
    /// Dashboard, port 29999.
    pub dashboard: SocketAddr,
    /// Primary interface, port 30001.
    pub primary: SocketAddr,
    /// Compute Box of the gripper.
    pub gripper: SocketAddr,
    /// Its Modbus unit.
    pub gripper_unit: u8,
}

impl Addresses {
    /// Where the devices of the configuration listen.
    ///
    /// # Errors
    /// The first name that cannot be resolved.
    pub fn of(devices: &Devices) -> Result<Addresses, String> {
        let robot = |port| resolve(&devices.robot_host, port);
        Ok(Addresses {
            rtde: robot(30004)?,
            dashboard: robot(29999)?,
            primary: robot(30001)?,
            gripper: resolve(&devices.gripper_host, devices.gripper_port)?,
            gripper_unit: devices.gripper_unit,
        })
    }
}

/// The first address of a host.
///
/// # Errors
/// The name, and why it has none.
pub fn resolve(host: &str, port: u16) -> Result<SocketAddr, String> {
    let fault = |cause: String| format!("{host}:{port}: {cause}; check `devices` in the configuration");
    let mut found = (host, port).to_socket_addrs().map_err(|error| fault(error.to_string()))?;
    found.next().ok_or_else(|| fault("no address".to_string()))
}

/// Bytes read at once.
const READ: usize = 64 * 1024;

/// One connection to the controller.
struct Line {
    link: Link,
    address: SocketAddr,
    connecting: Option<JoinHandle<()>>,
    /// Counts attempts: what an earlier one leads to is dropped.
    attempt: u64,
    stream: Option<Stream>,
}

/// All connections.
pub struct Sockets {
    lines: [Line; 3],
    gripper: GripperLine,
    /// How far a simulator was when the sockets were read last.
    taken: Option<Mark>,
    clock: Clock,
    messages: mpsc::Sender<Message>,
    buffer: Vec<u8>,
}

impl Sockets {
    /// Nothing is connected yet; what is made is reported through `messages`.
    pub fn new(addresses: &Addresses, clock: Clock, messages: mpsc::Sender<Message>) -> Sockets {
        let line = |link: Link| Line {
            link,
            address: match link {
                Link::Rtde => addresses.rtde,
                Link::Dashboard => addresses.dashboard,
                Link::Primary => addresses.primary,
            },
            connecting: None,
            attempt: 0,
            stream: None,
        };
        Sockets {
            lines: Link::ALL.map(line),
            gripper: GripperLine::new(
                (addresses.gripper, addresses.gripper_unit),
                clock.clone(),
                messages.clone(),
            ),
            taken: None,
            clock,
            messages,
            buffer: vec![0; READ],
        }
    }

    fn line(&mut self, link: Link) -> &mut Line {
        let [rtde, dashboard, primary] = &mut self.lines;
        match link {
            Link::Rtde => rtde,
            Link::Dashboard => dashboard,
            Link::Primary => primary,
        }
    }

    /// Begins to connect; [`Made`] follows.
    pub fn connect(&mut self, link: Link) {
        let messages = self.messages.clone();
        let line = self.line(link);
        line.close();
        line.attempt += 1;
        line.connecting = Some(attempt(Peer::Controller(link), line.attempt, line.address, messages));
    }

    /// A connection was made, or could not be.
    pub fn made(&mut self, made: Made) -> Option<Event> {
        let Peer::Controller(link) = made.to else {
            self.gripper.made(made);
            return None;
        };
        let line = self.line(link);
        if made.attempt != line.attempt || line.connecting.take().is_none() {
            return None;
        }
        match made.result.and_then(Stream::new) {
            Ok(stream) => {
                line.stream = Some(stream);
                Some(Event::Connected(link))
            }
            Err(error) => Some(Event::Disconnected(link, format!("{}: {error}", line.address))),
        }
    }

    /// Drops a connection or the attempt to make it; nothing more is reported of it.
    pub fn close(&mut self, link: Link) {
        self.line(link).close();
    }

    /// Sends as much as the system takes; the rest follows.
    pub fn send(&mut self, link: Link, bytes: &[u8]) {
        let now = self.clock.now();
        if let Some(stream) = &mut self.line(link).stream {
            stream.send(now, bytes);
        }
    }

    /// Starts a register transaction.
    pub fn transact(&mut self, request: ModbusRequest) {
        self.gripper.request(request);
    }

    /// Everything that has arrived, and what has broken.
    pub fn take(&mut self, events: &mut Vec<Event>) {
        self.taken = Some(self.clock.mark());
        let now = self.clock.now();
        for line in &mut self.lines {
            if let Some(reason) = line.read(now, &mut self.buffer, events) {
                line.close();
                events.push(Event::Disconnected(line.link, reason));
            }
        }
        self.gripper.take(&mut self.buffer, events);
    }

    /// When to call [`Sockets::take`] next, also if nothing arrives.
    pub fn next_wake(&self) -> Option<Timestamp> {
        self.gripper.next_wake()
    }

    /// What the last [`Sockets::take`] brought has been worked on: a simulator need not wait for that.
    pub fn taken_in(&mut self) {
        if let Some(mark) = self.taken {
            self.clock.taken_in(mark);
        }
    }

    /// Returns when something has arrived or can be sent.
    pub async fn ready(&self) {
        std::future::poll_fn(|context| self.poll_ready(context)).await;
    }

    fn poll_ready(&self, context: &mut Context<'_>) -> Poll<()> {
        let controller = self.lines.iter().filter_map(|line| line.stream.as_ref());
        let mut ready = Poll::Pending;
        // Each has to be polled: only then does it wake this task.
        for stream in controller.chain(self.gripper.streams()) {
            if stream.poll_ready(context).is_ready() {
                ready = Poll::Ready(());
            }
        }
        ready
    }
}

impl Line {
    fn close(&mut self) {
        if let Some(task) = self.connecting.take() {
            task.abort();
        }
        self.stream = None;
    }

    /// Reads until there is nothing more; the reason if the connection is over.
    fn read(&mut self, now: Timestamp, buffer: &mut [u8], events: &mut Vec<Event>) -> Option<String> {
        let stream = self.stream.as_mut()?;
        stream.write(now);
        let link = self.link;
        let over = stream.read(now, buffer, |bytes| events.push(Event::Received(link, bytes)))?;
        Some(match over {
            Over::Closed => "the controller closed the connection".to_string(),
            Over::Broken(error) => error.to_string(),
            Over::Unread => "the controller does not read".to_string(),
        })
    }
}

#[cfg(test)]
mod tests;
