//! The sockets: three TCP connections to the controller, one Modbus connection to the gripper.
//!
//! In: the machine's connect, close, send and register effects. Out: events. Everything that lies in the
//! sockets is read in one call, so that nothing of it is missing when time is judged. Writing never waits:
//! what the system does not take is kept, and a controller that does not read for 2 s is disconnected.

use crate::config::cell::Devices;
use crate::daemon::messages::{Made, Message};
use cell_edge::clock::{Clock, Mark};
use cell_edge::reserve::with_spare;
use cell_machine::device::gripper_types::{ModbusFailure, ModbusRequest};
use cell_machine::device::robot_types::Link;
use cell_machine::event::Event;
use cell_values::time::Timestamp;
use std::io;
use std::net::{SocketAddr, ToSocketAddrs};
use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::net::{TcpSocket, TcpStream};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_modbus::prelude::{Reader, Slave, Writer, tcp};

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

/// How long what is to be sent may wait for the peer, in the cell's time.
const WRITE_WITHIN: Duration = Duration::from_secs(2);

/// Most reads of one connection in one go: a peer that floods must not keep the others from their turn.
const READS: usize = 64;

/// An answer of the gripper that takes longer is none, in the cell's time.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);

/// One connection to the controller.
struct Line {
    link: Link,
    address: SocketAddr,
    connecting: Option<JoinHandle<()>>,
    /// Counts attempts: what an earlier one leads to is dropped.
    attempt: u64,
    stream: Option<TcpStream>,
    unsent: Vec<u8>,
    /// In the cell's time.
    unsent_since: Option<Timestamp>,
}

/// All connections.
pub struct Sockets {
    lines: [Line; 3],
    gripper: mpsc::Sender<ModbusRequest>,
    gripper_work: Arc<GripperWork>,
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
            unsent: Vec::new(),
            unsent_since: None,
        };
        let gripper_work = Arc::<GripperWork>::default();
        Sockets {
            lines: Link::ALL.map(line),
            gripper: spawn_modbus(addresses, clock.clone(), messages.clone(), gripper_work.clone()),
            gripper_work,
            taken: None,
            clock,
            messages,
            buffer: vec![0; 64 * 1024],
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
        let (address, attempt) = (line.address, line.attempt);
        line.connecting = Some(tokio::spawn(async move {
            let result = connection_to(address).await;
            // The loop has ended if there is no receiver.
            let _ = messages.send(Message::Made(Made { link, attempt, result })).await;
        }));
    }

    /// A connection was made, or could not be.
    pub fn made(&mut self, made: Made) -> Option<Event> {
        let line = self.line(made.link);
        if made.attempt != line.attempt || line.connecting.take().is_none() {
            return None;
        }
        match made.result.and_then(|stream| stream.set_nodelay(true).map(|()| stream)) {
            Ok(stream) => {
                line.stream = Some(stream);
                Some(Event::Connected(made.link))
            }
            Err(error) => Some(Event::Disconnected(made.link, format!("{}: {error}", line.address))),
        }
    }

    /// Drops a connection or the attempt to make it; nothing more is reported of it.
    pub fn close(&mut self, link: Link) {
        self.line(link).close();
    }

    /// Sends as much as the system takes; the rest follows.
    pub fn send(&mut self, link: Link, bytes: &[u8]) {
        let clock = self.clock.clone();
        let line = self.line(link);
        line.unsent.extend_from_slice(bytes);
        line.write(&clock);
    }

    /// Starts a register transaction.
    pub fn transact(&mut self, request: ModbusRequest) {
        // One is under way at a time, so there is room; a task that has ended would be seen as silence.
        self.gripper_work.untaken.store(true, Ordering::Relaxed);
        if self.gripper.try_send(request).is_err() {
            self.gripper_work.untaken.store(false, Ordering::Relaxed);
            tracing::warn!("gripper queue full, request dropped");
        }
    }

    /// Everything that has arrived, and what has broken.
    pub fn take(&mut self, events: &mut Vec<Event>) {
        self.taken = Some(self.clock.mark());
        for line in &mut self.lines {
            line.write(&self.clock);
            if let Some(reason) = line.read(&mut self.buffer, &self.clock, events) {
                line.close();
                events.push(Event::Disconnected(line.link, reason));
            }
        }
    }

    /// What the last [`Sockets::take`] brought has been worked on: a simulator need not wait for that,
    /// unless the gripper's task is late.
    pub fn taken_in(&mut self) {
        if let Some(mark) = self.taken.filter(|_| !self.gripper_work.waits()) {
            self.clock.taken_in(mark);
        }
    }

    /// Returns when something has arrived or can be sent.
    pub async fn ready(&self) {
        let [a, b, c] = &self.lines;
        tokio::select! {
            () = a.ready() => {}
            () = b.ready() => {}
            () = c.ready() => {}
        }
    }
}

impl Line {
    fn close(&mut self) {
        if let Some(task) = self.connecting.take() {
            task.abort();
        }
        self.stream = None;
        self.unsent.clear();
        self.unsent_since = None;
    }

    fn write(&mut self, clock: &Clock) {
        while let Some(stream) = self.stream.as_ref().filter(|_| !self.unsent.is_empty()) {
            match stream.try_write(&self.unsent) {
                Ok(count) => drop(self.unsent.drain(..count)),
                // What is wrong with the connection is found when it is read.
                Err(_) => {
                    self.unsent_since.get_or_insert_with(|| clock.now());
                    return;
                }
            }
        }
        self.unsent_since = None;
    }

    /// Reads until there is nothing more; the reason if the connection is over.
    fn read(&mut self, buffer: &mut [u8], clock: &Clock, events: &mut Vec<Event>) -> Option<String> {
        let stream = self.stream.as_ref()?;
        for _ in 0..READS {
            match stream.try_read(buffer) {
                Ok(0) => return Some("the controller closed the connection".to_string()),
                Ok(count) => {
                    let bytes = buffer.get(..count).unwrap_or_default().to_vec();
                    events.push(Event::Received(self.link, bytes));
                }
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => break,
                Err(error) => return Some(error.to_string()),
            }
        }
        let stuck = self.unsent_since.is_some_and(|since| clock.now().since(since) > WRITE_WITHIN);
        stuck.then(|| "the controller does not read".to_string())
    }

    async fn ready(&self) {
        let Some(stream) = &self.stream else { return std::future::pending().await };
        if self.unsent.is_empty() {
            // An error is found by reading.
            let _ = stream.readable().await;
        } else {
            tokio::select! {
                _ = stream.readable() => {}
                _ = stream.writable() => {}
            }
        }
    }
}

/// What the task of the gripper has to do.
#[derive(Debug, Default)]
struct GripperWork {
    /// A request was handed over and not taken yet.
    untaken: AtomicBool,
    /// The socket of the connection.
    socket: Mutex<Option<OwnedFd>>,
}

impl GripperWork {
    fn socket(&self) -> MutexGuard<'_, Option<OwnedFd>> {
        self.socket.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn waits(&self) -> bool {
        let unread = |socket: &OwnedFd| rustix::io::ioctl_fionread(socket).is_ok_and(|bytes| bytes > 0);
        self.untaken.load(Ordering::Relaxed) || self.socket().as_ref().is_some_and(unread)
    }
}

/// Starts the task of the gripper: one request at a time, one answer each.
fn spawn_modbus(
    &Addresses { gripper, gripper_unit, .. }: &Addresses,
    clock: Clock,
    messages: mpsc::Sender<Message>,
    work: Arc<GripperWork>,
) -> mpsc::Sender<ModbusRequest> {
    let (requests_in, mut requests) = mpsc::channel::<ModbusRequest>(4);
    tokio::spawn(async move {
        let mut connection = GripperConnection::default();
        while let Some(request) = requests.recv().await {
            work.untaken.store(false, Ordering::Relaxed);
            let made = |socket| *work.socket() = socket;
            let exchange = exchange(&mut connection, (gripper, Slave(gripper_unit)), request, &made);
            let answer = tokio::select! {
                // An answer that is there counts, however late this task is.
                biased;
                answer = exchange => answer,
                () = passed(&clock, ANSWER_WITHIN) => Err(ModbusFailure::Timeout),
            };
            // After a failure the answer to an old request could be taken for that to a new one.
            if answer.is_err() {
                connection = None;
                *work.socket() = None;
            }
            if messages.send(Message::Event(Event::Registers(answer))).await.is_err() {
                return;
            }
        }
    });
    requests_in
}

/// Returns once so much of the cell's time is over.
async fn passed(clock: &Clock, span: Duration) {
    let until = clock.now() + span;
    loop {
        let left = until.since(clock.now());
        if left.is_zero() {
            return;
        }
        // The clock may stand meanwhile.
        tokio::time::sleep(clock.wall(left)).await;
    }
}

/// A connection to a device, with a handle of the reserve where there is no other.
async fn connection_to(address: SocketAddr) -> io::Result<TcpStream> {
    let socket = with_spare(|| match address {
        SocketAddr::V4(_) => TcpSocket::new_v4(),
        SocketAddr::V6(_) => TcpSocket::new_v6(),
    })?;
    socket.connect(address).await
}

/// The connection to the gripper, while there is one.
pub type GripperConnection = Option<tokio_modbus::client::Context>;

/// One request and its answer, over the connection that is there or a new one; `made` is given a second
/// handle of a new one's socket.
///
/// # Errors
/// The connection broke, or the device answers with an exception.
pub async fn exchange(
    connection: &mut GripperConnection,
    (address, unit): (SocketAddr, Slave),
    request: ModbusRequest,
    made: &(dyn Fn(Option<OwnedFd>) + Sync),
) -> Result<Vec<u16>, ModbusFailure> {
    let link = |error: &dyn std::fmt::Display| ModbusFailure::Connection(error.to_string());
    let context = match connection {
        Some(context) => context,
        None => {
            let stream = connection_to(address).await.map_err(|e| link(&e))?;
            made(rustix::io::fcntl_dupfd_cloexec(&stream, 0).ok());
            connection.insert(tcp::attach_slave(stream, unit))
        }
    };
    match request {
        ModbusRequest::Read { address, count } => {
            match context.read_holding_registers(address, count).await {
                Ok(Ok(words)) => Ok(words),
                Ok(Err(exception)) => Err(ModbusFailure::Exception(exception.into())),
                Err(error) => Err(link(&error)),
            }
        }
        ModbusRequest::Write { address, values } => {
            match context.write_multiple_registers(address, &values).await {
                Ok(Ok(())) => Ok(Vec::new()),
                Ok(Err(exception)) => Err(ModbusFailure::Exception(exception.into())),
                Err(error) => Err(link(&error)),
            }
        }
    }
}
