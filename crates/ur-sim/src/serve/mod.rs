//! Real sockets for the simulated cell: bytes from TCP to [`Session`] and back; this decides nothing.
//!
//! In: ports to listen on, the [`Core`] that something else advances. Out: the addresses, and tasks that run
//! until the shutdown signal. Each connection has a task that reads and one that writes: a client that does
//! not read can still send. All of them pass through their server's link ([`stream`]), where faults act;
//! while a server is down nothing listens.

pub mod seats;

pub mod stream;

use crate::core::Core;
use crate::robot_api_server;
use crate::robot_server::lateness::Check;
use crate::robot_server::line::{Inlet, Line, Packet, Queue};
use crate::robot_server::shared::RobotShared;
use crate::robot_server::{RobotAddresses, RobotPorts};
use crate::serve::seats::Seats;
use crate::serve::stream::LinkStream;
use crate::session::{Port, Session};
use crate::world::lock;
use cell_edge::pace::{LEAD, PATIENCE};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt, ReadHalf, WriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::{JoinHandle, JoinSet};

/// Wait before a port is listened on again after a failure.
const LISTEN_AGAIN: Duration = Duration::from_millis(10);

/// Connections a server that only answers takes at once. A further one takes the place of the one that has
/// been silent longest.
pub const MAX_CONNECTIONS: usize = 32;

/// The same for servers that send unrequested: many may listen there.
pub const MAX_LISTENERS: usize = 128;

/// Connections that may still be on their way out, times those that have a place; more wait to be taken.
const LEAVING: usize = 4;

/// Bytes read at once.
const READ: usize = 64 * 1024;

/// Longest that the last answers on a connection may take, wall time: a client that has said goodbye may
/// never read them.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// Why the servers cannot start.
#[derive(Debug, thiserror::Error)]
#[error("the simulated cell's {server} cannot listen on {address}")]
pub struct ListenError {
    /// Which server.
    pub server: &'static str,
    /// Where.
    pub address: SocketAddr,
    /// Why.
    #[source]
    pub source: std::io::Error,
}

/// Servers at work.
#[derive(Debug, Default)]
pub struct Servers(Vec<JoinHandle<()>>);

impl Servers {
    /// Waits until all connections are closed, after the shutdown signal was given.
    pub async fn stopped(self) {
        for task in self.0 {
            // A task that panicked has been reported by the runtime; the others are still waited for.
            let _ = task.await;
        }
    }

    /// Starts taking connections to a port. It goes on until `shutdown` becomes true.
    pub fn take(&mut self, door: (TcpListener, SocketAddr), core: &Core, port: Port, shutdown: &Shutdown) {
        self.0.push(tokio::spawn(accept(door, core.clone(), port, shutdown.clone())));
    }

    fn take_robot_api(&mut self, listener: TcpListener, core: &Core, shutdown: &Shutdown) {
        let (robot, shutdown) = (core.robot.clone(), shutdown.clone());
        self.0.push(tokio::spawn(async move {
            if let Err(error) = robot_api_server::serve(listener, robot, MAX_CONNECTIONS, shutdown).await {
                tracing::error!(%error, "the Robot API has ended");
            }
        }));
    }

    /// Listens on all ports of the controller, then starts taking connections.
    ///
    /// # Errors
    /// When an address cannot be listened on; then nothing was started.
    pub async fn take_robot(
        &mut self,
        core: &Core,
        bind: IpAddr,
        ports: &RobotPorts,
        shutdown: &Shutdown,
    ) -> Result<RobotAddresses, ListenError> {
        let [first, second, third] = ports.read_only;
        let polyscope_x = core.robot.controller().core.config.is_polyscope_x();
        let front_name = if polyscope_x { "Robot API" } else { Port::Dashboard.name() };
        let front = listen(front_name, bind, ports.dashboard).await?;
        let wanted = [
            (Port::Primary, ports.primary),
            (Port::Secondary, ports.secondary),
            (Port::Realtime, ports.realtime),
            (Port::Rtde, ports.rtde),
            (Port::PrimaryReadOnly, first),
            (Port::SecondaryReadOnly, second),
            (Port::RealtimeReadOnly, third),
            (Port::Interpreter, ports.interpreter),
        ];
        let mut doors = Vec::new();
        for (port, number) in wanted {
            doors.push((port, listen(port.name(), bind, number).await?));
        }
        let optional = optional_doors(core, bind, ports).await?;
        let mut at = wanted.map(|_| SocketAddr::new(bind, 0));
        for (place, (port, door)) in at.iter_mut().zip(doors) {
            *place = door.1;
            self.take(door, core, port, shutdown);
        }
        let [primary, secondary, realtime, rtde, first, second, third, interpreter] = at;
        let (read_only, dashboard) = ([first, second, third], front.1);
        if polyscope_x {
            self.take_robot_api(front.0, core, shutdown);
        } else {
            self.take(front, core, Port::Dashboard, shutdown);
        }
        let [modbus, robotiq, tool_serial] = optional.map(|(port, door)| {
            let door = door?;
            let address = door.1;
            self.take(door, core, port, shutdown);
            Some(address)
        });
        Ok(RobotAddresses {
            dashboard,
            primary,
            secondary,
            realtime,
            rtde,
            read_only,
            interpreter,
            modbus,
            robotiq,
            tool_serial,
        })
    }
}

/// A server that listens.
type Door = (TcpListener, SocketAddr);

/// The servers that depend on the configuration and on what is on the hand.
async fn optional_doors(
    core: &Core,
    bind: IpAddr,
    ports: &RobotPorts,
) -> Result<[(Port, Option<Door>); 3], ListenError> {
    let (with_fingers, on_tool) = {
        let world = lock(&core.world);
        (world.has_fingers(), world.is_on_tool_line())
    };
    let modbus = listen_if(Port::Modbus, bind, ports.modbus).await?;
    let robotiq = listen_if(Port::Robotiq, bind, ports.robotiq.filter(|_| with_fingers)).await?;
    let serial = listen_if(Port::ToolSerial, bind, ports.tool_serial.filter(|_| on_tool)).await?;
    Ok([(Port::Modbus, modbus), (Port::Robotiq, robotiq), (Port::ToolSerial, serial)])
}

/// Becomes true when everything has to end.
pub type Shutdown = watch::Receiver<bool>;

/// Listens on an address; port 0 lets the system choose.
///
/// # Errors
/// It is taken or not ours.
pub async fn listen(
    server: &'static str,
    bind: IpAddr,
    port: u16,
) -> Result<(TcpListener, SocketAddr), ListenError> {
    let address = SocketAddr::new(bind, port);
    let failed = |source| ListenError { server, address, source };
    let listener = TcpListener::bind(address).await.map_err(failed)?;
    let address = listener.local_addr().map_err(failed)?;
    Ok((listener, address))
}

/// The same for a server that may be absent.
async fn listen_if(port: Port, bind: IpAddr, number: Option<u16>) -> Result<Option<Door>, ListenError> {
    match number {
        Some(number) => Ok(Some(listen(port.name(), bind, number).await?)),
        None => Ok(None),
    }
}

/// Takes connections until shutdown, and ends them with it. While the link is down nothing listens.
async fn accept(
    (listener, address): (TcpListener, SocketAddr),
    core: Core,
    port: Port,
    mut shutdown: Shutdown,
) {
    let link = core.robot.links.get(port.link()).clone();
    let mut connections = JoinSet::new();
    let most = if port.only_answers() { MAX_CONNECTIONS } else { MAX_LISTENERS };
    let seats = Seats::new(most);
    let (mut listener, mut changes) = (Some(listener), link.watch());
    loop {
        let down = changes.borrow_and_update().down;
        listener = at_work(listener, address, down).await;
        tokio::select! {
            _ = shutdown.wait_for(|stop| *stop) => break,
            // The link lives as long as this task, so this is a change.
            _ = changes.changed() => {}
            () = tokio::time::sleep(LISTEN_AGAIN), if listener.is_none() && !down => {}
            _ = connections.join_next(), if !connections.is_empty() => {}
            stream = accepted(listener.as_ref()), if connections.len() < LEAVING * most => {
                if let Some(stream) = stream.filter(|stream| stream.set_nodelay(true).is_ok()) {
                    let stream = LinkStream::new(stream, &link, Some(seats.take()));
                    connections.spawn(connection(core.clone(), port, stream));
                }
            }
        }
    }
    connections.shutdown().await;
}

/// The listener as it should be: gone while the server is down, and there again afterwards.
async fn at_work(listener: Option<TcpListener>, address: SocketAddr, down: bool) -> Option<TcpListener> {
    match listener {
        _ if down => None,
        None => TcpListener::bind(address).await.ok(),
        there => there,
    }
}

/// The next connection. Accepting can fail for want of file handles; then the next attempt, a little later,
/// may succeed.
async fn accepted(listener: Option<&TcpListener>) -> Option<TcpStream> {
    let Some(listener) = listener else { return std::future::pending().await };
    match listener.accept().await {
        Ok((stream, _)) => Some(stream),
        Err(_) => {
            tokio::time::sleep(LISTEN_AGAIN).await;
            None
        }
    }
}

/// One connection to its end.
async fn connection(core: Core, port: Port, stream: LinkStream) {
    let shortcut = Arc::new(stream.shortcut());
    let (mut reader, writer) = tokio::io::split(stream);
    let (mut session, Inlet { queue, dropped, replies }) = Session::open(&core, port, Some(shortcut.clone()));
    let has_work: Arc<Check> = {
        let replies = replies.clone();
        Arc::new(move || shortcut.has_work(replies.has_queued()))
    };
    core.robot.lateness.watch(&has_work, LEAD, PATIENCE);
    let mut writing = JoinSet::new();
    writing.spawn(write_all(queue, writer, core.robot.clone()));
    let ends_in_order = tokio::select! {
        () = read_all(&core, &mut session, &mut reader, &replies) => true,
        () = dropped.notified() => false,
        _ = writing.join_next() => false,
    };
    session.close(&core);
    // Both have an end of the queue.
    drop((has_work, replies));
    if ends_in_order {
        // What is queued still goes to the client; what it does not take is not owed.
        let _ = tokio::time::timeout(LAST_WORDS, writing.join_next()).await;
    }
}

/// Hands over what the client sends until one of the two has enough.
async fn read_all(core: &Core, session: &mut Session, reader: &mut ReadHalf<LinkStream>, replies: &Line) {
    let mut buffer = vec![0; READ];
    loop {
        let count = match reader.read(&mut buffer).await {
            Ok(0) => return session.finish(core),
            Ok(count) => count,
            Err(_) => return,
        };
        let outcome = session.receive(core, &buffer[..count]);
        for answer in outcome.answers {
            if !replies.send(Packet::from(answer)).await {
                return;
            }
        }
        if outcome.over {
            return;
        }
        session.answered(core);
    }
}

/// Writes what is queued until the connection breaks or no sender is left.
async fn write_all(mut queue: Queue, mut writer: WriteHalf<LinkStream>, robot: Arc<RobotShared>) {
    while let Some(packet) = queue.next().await {
        if writer.write_all(packet.bytes()).await.is_err() {
            return;
        }
        if let Some(due) = packet.due() {
            robot.latency.record(due.elapsed());
        }
        queue.written();
    }
}

#[cfg(test)]
mod tests;
