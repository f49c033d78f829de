//! The controller's TCP servers: dashboard (29999), primary (30001), secondary (30002), real-time (30003),
//! RTDE (30004), and the read-only twins of the three that take scripts (30011 to 30013), around the
//! frame-stepped [`Controller`].
//!
//! In: an address to listen on, and one call of [`RobotShared::frame`] per controller frame from the thread
//! that keeps the time. Out: whatever the clients of the real controller expect. Connections act on the
//! controller under one lock, held for single requests, so an input package takes effect as a whole in the
//! frame that follows; the frame thread samples the outputs under the same lock at the frame's end.
//! Nothing waits for a client: what is sent goes through a bounded queue per connection ([`outlets`]).

pub mod dashboard;

pub mod outlets;

pub mod punctuality;

pub mod rtde;

pub mod script_channel;

pub mod script_ports;

use crate::sim::controller::Controller;
use crate::sim::faults::link::{Link, LinkName, LinkStream, Links};
use crate::sim::robot_server::outlets::{Feed, Outlets};
use crate::sim::robot_server::punctuality::Punctuality;
use crate::sim::robot_server::script_ports::Port;
use crate::sim::script_sockets::TcpScriptSockets;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Instant;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::{JoinHandle, JoinSet};

/// Wait before a port is listened on again after a failure.
const LISTEN_AGAIN: std::time::Duration = std::time::Duration::from_millis(10);

/// Connections each port takes at once; further ones are closed.
const MAX_CONNECTIONS: usize = 32;

/// Port numbers; 0 lets the system choose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RobotPorts {
    /// Dashboard.
    pub dashboard: u16,
    /// Primary interface.
    pub primary: u16,
    /// Secondary interface.
    pub secondary: u16,
    /// Real-time interface.
    pub realtime: u16,
    /// RTDE.
    pub rtde: u16,
    /// Primary, secondary and real-time interface without scripts.
    pub read_only: [u16; 3],
}

impl RobotPorts {
    /// Those of a real controller.
    pub const REAL: RobotPorts = RobotPorts {
        dashboard: 29999,
        primary: 30001,
        secondary: 30002,
        realtime: 30003,
        rtde: 30004,
        read_only: [30011, 30012, 30013],
    };
    /// Any that are free.
    pub const ANY: RobotPorts =
        RobotPorts { dashboard: 0, primary: 0, secondary: 0, realtime: 0, rtde: 0, read_only: [0; 3] };
}

/// Where the servers listen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RobotAddresses {
    /// Dashboard.
    pub dashboard: SocketAddr,
    /// Primary interface.
    pub primary: SocketAddr,
    /// Secondary interface.
    pub secondary: SocketAddr,
    /// Real-time interface.
    pub realtime: SocketAddr,
    /// RTDE.
    pub rtde: SocketAddr,
    /// Primary, secondary and real-time interface without scripts.
    pub read_only: [SocketAddr; 3],
}

/// Why the servers cannot start.
#[derive(Debug, thiserror::Error)]
#[error("the simulated controller's {server} cannot listen on {address}")]
pub struct ListenError {
    /// Which server.
    pub server: &'static str,
    /// Where.
    pub address: SocketAddr,
    /// Why.
    #[source]
    pub source: std::io::Error,
}

/// The controller and the connections to it.
#[derive(Debug)]
pub struct RobotShared {
    controller: Mutex<Controller>,
    outlets: Mutex<Outlets>,
    /// What is wrong with the connections, those of gripper and camera included.
    pub links: Links,
    /// How late RTDE packages leave.
    pub punctuality: Punctuality,
}

impl RobotShared {
    /// Around a controller, which gets the network for its scripts' sockets; they come from `address`.
    pub fn new(mut controller: Controller, address: IpAddr) -> Arc<RobotShared> {
        controller.core.sockets = Box::new(TcpScriptSockets::from_address(address));
        RobotShared::without_network(controller)
    }

    /// Around a controller whose scripts' sockets are what they are: for a simulator without sockets.
    pub fn without_network(controller: Controller) -> Arc<RobotShared> {
        Arc::new(RobotShared {
            controller: Mutex::new(controller),
            outlets: Mutex::new(Outlets::default()),
            links: Links::default(),
            punctuality: Punctuality::default(),
        })
    }

    /// The controller. A panic while it was locked leaves it in a state between two requests, which is fit
    /// to go on with.
    pub fn controller(&self) -> MutexGuard<'_, Controller> {
        self.controller.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// The connections.
    pub fn outlets(&self) -> MutexGuard<'_, Outlets> {
        self.outlets.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// One controller frame, and its outputs to all connections; packages record how late after `due` they
    /// leave.
    pub fn frame(&self, due: Option<Instant>) {
        let mut controller = self.controller();
        controller.frame();
        self.outlets().publish(&mut controller, due, &self.punctuality);
    }
}

/// The running servers.
#[derive(Debug)]
pub struct RobotServers {
    /// Where they listen.
    pub addresses: RobotAddresses,
    tasks: Vec<JoinHandle<()>>,
}

impl RobotServers {
    /// Waits until all connections are closed, after the shutdown signal was given.
    pub async fn stopped(self) {
        for task in self.tasks {
            // A task that panicked has been reported by the runtime; the others are still waited for.
            let _ = task.await;
        }
    }
}

/// Starts the servers. They run until `shutdown` becomes true.
///
/// # Errors
/// When an address cannot be listened on.
pub async fn serve(
    shared: &Arc<RobotShared>,
    bind: IpAddr,
    ports: &RobotPorts,
    shutdown: &watch::Receiver<bool>,
) -> Result<RobotServers, ListenError> {
    let dashboard = listen("dashboard server", bind, ports.dashboard).await?;
    let primary = listen("primary interface", bind, ports.primary).await?;
    let secondary = listen("secondary interface", bind, ports.secondary).await?;
    let realtime = listen("real-time interface", bind, ports.realtime).await?;
    let rtde = listen("RTDE server", bind, ports.rtde).await?;
    let [first, second, third] = ports.read_only;
    let primary_read = listen("read-only primary interface", bind, first).await?;
    let secondary_read = listen("read-only secondary interface", bind, second).await?;
    let realtime_read = listen("read-only real-time interface", bind, third).await?;
    let addresses = RobotAddresses {
        dashboard: dashboard.1,
        primary: primary.1,
        secondary: secondary.1,
        realtime: realtime.1,
        rtde: rtde.1,
        read_only: [primary_read.1, secondary_read.1, realtime_read.1],
    };
    let feed = |listener, name, serve: fn(Arc<RobotShared>, LinkStream) -> Connection| {
        accept(listener, shared, shared.links.get(name), shutdown, serve)
    };
    let tasks = vec![
        feed(dashboard, LinkName::Dashboard, |shared, stream| {
            Box::pin(dashboard::connection(shared, stream))
        }),
        feed(primary, LinkName::Primary, |shared, stream| scripts(shared, stream, Feed::Primary, false)),
        feed(secondary, LinkName::Secondary, |shared, stream| {
            scripts(shared, stream, Feed::Secondary, false)
        }),
        feed(realtime, LinkName::Realtime, |shared, stream| scripts(shared, stream, Feed::Realtime, false)),
        feed(primary_read, LinkName::Primary, |shared, stream| scripts(shared, stream, Feed::Primary, true)),
        feed(secondary_read, LinkName::Secondary, |shared, stream| {
            scripts(shared, stream, Feed::Secondary, true)
        }),
        feed(realtime_read, LinkName::Realtime, |shared, stream| {
            scripts(shared, stream, Feed::Realtime, true)
        }),
        feed(rtde, LinkName::Rtde, |shared, stream| Box::pin(rtde::connection(shared, stream))),
    ];
    Ok(RobotServers { addresses, tasks })
}

fn scripts(shared: Arc<RobotShared>, stream: LinkStream, feed: Feed, read_only: bool) -> Connection {
    Box::pin(script_ports::connection(shared, stream, Port { feed, read_only }))
}

async fn listen(
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

type Connection = std::pin::Pin<Box<dyn Future<Output = ()> + Send>>;

/// Takes connections until shutdown, and ends them with it. While the link is down nobody listens.
fn accept(
    (listener, address): (TcpListener, SocketAddr),
    shared: &Arc<RobotShared>,
    link: &Arc<Link>,
    shutdown: &watch::Receiver<bool>,
    serve: fn(Arc<RobotShared>, LinkStream) -> Connection,
) -> JoinHandle<()> {
    let (shared, link, mut shutdown) = (shared.clone(), link.clone(), shutdown.clone());
    tokio::spawn(async move {
        let mut connections = JoinSet::new();
        let (mut listener, mut changes) = (Some(listener), link.watch());
        loop {
            let down = changes.borrow_and_update().down;
            listener = at_work(listener, address, down).await;
            tokio::select! {
                _ = shutdown.wait_for(|stop| *stop) => break,
                // The link lives as long as this task, so this is a change.
                _ = changes.changed() => {}
                () = tokio::time::sleep(LISTEN_AGAIN), if listener.is_none() && !down => {}
                Some(stream) = accepted(listener.as_ref()) => {
                    while connections.try_join_next().is_some() {}
                    if connections.len() < MAX_CONNECTIONS && stream.set_nodelay(true).is_ok() {
                        connections.spawn(serve(shared.clone(), LinkStream::new(stream, &link)));
                    }
                }
            }
        }
        connections.shutdown().await;
    })
}

/// The listener as it should be: gone while the server is down, and there again afterwards.
async fn at_work(listener: Option<TcpListener>, address: SocketAddr, down: bool) -> Option<TcpListener> {
    match listener {
        _ if down => None,
        None => TcpListener::bind(address).await.ok(),
        there => there,
    }
}

/// The next connection. Accepting can fail for want of file handles; the next attempt may succeed.
async fn accepted(listener: Option<&TcpListener>) -> Option<TcpStream> {
    match listener {
        Some(listener) => Some(listener.accept().await.ok()?.0),
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests;
