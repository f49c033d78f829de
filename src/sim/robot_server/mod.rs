//! The controller's TCP servers: dashboard (29999), primary (30001), secondary (30002), real-time (30003) and
//! RTDE (30004), around the frame-stepped [`Controller`].
//!
//! In: an address to listen on, and one call of [`RobotShared::frame`] per controller frame from the thread
//! that keeps the time. Out: whatever the clients of the real controller expect. Connections act on the
//! controller under one lock, held for single requests, so an input package takes effect as a whole in the
//! frame that follows; the frame thread samples the outputs under the same lock at the frame's end.
//! Nothing waits for a client: what is sent goes through a bounded queue per connection ([`outlets`]).

pub mod dashboard;

pub mod outlets;

pub mod rtde;

pub mod script_channel;

pub mod script_ports;

use crate::sim::controller::Controller;
use crate::sim::robot_server::outlets::Outlets;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::{JoinHandle, JoinSet};

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
}

impl RobotPorts {
    /// Those of a real controller.
    pub const REAL: RobotPorts =
        RobotPorts { dashboard: 29999, primary: 30001, secondary: 30002, realtime: 30003, rtde: 30004 };
    /// Any that are free.
    pub const ANY: RobotPorts = RobotPorts { dashboard: 0, primary: 0, secondary: 0, realtime: 0, rtde: 0 };
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
}

impl RobotShared {
    /// Around a controller.
    pub fn new(controller: Controller) -> Arc<RobotShared> {
        Arc::new(RobotShared { controller: Mutex::new(controller), outlets: Mutex::new(Outlets::default()) })
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

    /// One controller frame, and its outputs to all connections.
    pub fn frame(&self) {
        let mut controller = self.controller();
        controller.frame();
        self.outlets().publish(&mut controller);
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
    let addresses = RobotAddresses {
        dashboard: dashboard.1,
        primary: primary.1,
        secondary: secondary.1,
        realtime: realtime.1,
        rtde: rtde.1,
    };
    let tasks = vec![
        accept(dashboard.0, shared, shutdown, |shared, stream| {
            Box::pin(dashboard::connection(shared, stream))
        }),
        accept(primary.0, shared, shutdown, |shared, stream| {
            Box::pin(script_ports::connection(shared, stream, outlets::Feed::Primary))
        }),
        accept(secondary.0, shared, shutdown, |shared, stream| {
            Box::pin(script_ports::connection(shared, stream, outlets::Feed::Secondary))
        }),
        accept(realtime.0, shared, shutdown, |shared, stream| {
            Box::pin(script_ports::connection(shared, stream, outlets::Feed::Realtime))
        }),
        accept(rtde.0, shared, shutdown, |shared, stream| Box::pin(rtde::connection(shared, stream))),
    ];
    Ok(RobotServers { addresses, tasks })
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

/// Takes connections until shutdown, and ends them with it.
fn accept(
    listener: TcpListener,
    shared: &Arc<RobotShared>,
    shutdown: &watch::Receiver<bool>,
    serve: fn(Arc<RobotShared>, TcpStream) -> Connection,
) -> JoinHandle<()> {
    let (shared, mut shutdown) = (shared.clone(), shutdown.clone());
    tokio::spawn(async move {
        let mut connections = JoinSet::new();
        loop {
            tokio::select! {
                _ = shutdown.wait_for(|stop| *stop) => break,
                accepted = listener.accept() => {
                    while connections.try_join_next().is_some() {}
                    // Accepting can fail for want of file handles; the next attempt may succeed.
                    let Ok((stream, _)) = accepted else { continue };
                    if connections.len() < MAX_CONNECTIONS && stream.set_nodelay(true).is_ok() {
                        connections.spawn(serve(shared.clone(), stream));
                    }
                }
            }
        }
        connections.shutdown().await;
    })
}

#[cfg(test)]
mod tests;
