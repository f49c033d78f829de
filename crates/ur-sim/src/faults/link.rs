//! What is wrong with the connections of each server, for all who have to follow it.
//!
//! In: what the faults in force make of a server's connections ([`Link::set`], [`Link::reset`]). Out: a
//! [`LinkState`] that can be read and waited for. Who carries the bytes acts on it: `serve` on real
//! sockets, a simulated network in virtual time. Times in a [`LinkState`] are wall time: the injector has
//! divided them by the time factor.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::watch;

/// A server of the simulated cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkName {
    /// RTDE.
    Rtde,
    /// Dashboard.
    Dashboard,
    /// Primary interface.
    Primary,
    /// Secondary interface.
    Secondary,
    /// Real-time interface.
    Realtime,
    /// Modbus.
    Gripper,
    /// HTTP of the camera.
    Camera,
}

impl LinkName {
    /// Names in fault files; `all` is every server.
    pub const NAMES: [(&'static str, Option<LinkName>); 8] = [
        ("rtde", Some(LinkName::Rtde)),
        ("dashboard", Some(LinkName::Dashboard)),
        ("primary", Some(LinkName::Primary)),
        ("secondary", Some(LinkName::Secondary)),
        ("realtime", Some(LinkName::Realtime)),
        ("gripper", Some(LinkName::Gripper)),
        ("camera", Some(LinkName::Camera)),
        ("all", None),
    ];

    /// All servers.
    pub const ALL: [LinkName; 7] = [
        LinkName::Rtde,
        LinkName::Dashboard,
        LinkName::Primary,
        LinkName::Secondary,
        LinkName::Realtime,
        LinkName::Gripper,
        LinkName::Camera,
    ];

    /// True for the servers that run on the controller and go down with it.
    pub fn on_controller(self) -> bool {
        !matches!(self, LinkName::Gripper | LinkName::Camera)
    }
}

/// What is wrong with a server's connections.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinkState {
    /// Counts resets; connections made before the last one are dead.
    pub resets: u64,
    /// Nothing passes.
    pub silent: bool,
    /// What is sent arrives so much later.
    pub latency: Duration,
    /// Largest piece sent at once, bytes.
    pub slice: Option<usize>,
    /// Most bytes sent on a connection.
    pub limit: Option<u64>,
    /// Every Modbus request gets this exception.
    pub exception: Option<u8>,
    /// Every Modbus answer has the number of another request.
    pub wrong_transaction: bool,
    /// The server does not listen.
    pub down: bool,
}

/// One server's connections.
#[derive(Debug)]
pub struct Link {
    state: watch::Sender<LinkState>,
    silences: AtomicU64,
}

impl Default for Link {
    fn default() -> Link {
        Link { state: watch::Sender::new(LinkState::default()), silences: AtomicU64::new(0) }
    }
}

impl Link {
    /// What is wrong now.
    pub fn state(&self) -> LinkState {
        self.state.borrow().clone()
    }

    /// Follows what is wrong.
    pub fn watch(&self) -> watch::Receiver<LinkState> {
        self.state.subscribe()
    }

    /// Changes what is wrong; resets are kept.
    pub fn set(&self, state: LinkState) {
        self.state.send_if_modified(|now| {
            self.silences.fetch_add(u64::from(state.silent && !now.silent), Ordering::Relaxed);
            let state = LinkState { resets: now.resets, ..state };
            let changed = *now != state;
            *now = state;
            changed
        });
    }

    /// How often the cable was pulled so far.
    pub fn silences(&self) -> u64 {
        self.silences.load(Ordering::Relaxed)
    }

    /// Resets all connections.
    pub fn reset(&self) {
        self.state.send_modify(|now| now.resets += 1);
    }
}

/// All servers' connections.
#[derive(Debug, Default)]
pub struct Links([Arc<Link>; 7]);

impl Links {
    /// Those of one server.
    pub fn get(&self, name: LinkName) -> &Arc<Link> {
        &self.0[name as usize]
    }
}
