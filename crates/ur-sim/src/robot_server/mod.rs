//! The controller's TCP servers without their sockets: dashboard (29999), primary (30001), secondary
//! (30002), real-time (30003), RTDE (30004), interpreter mode (30020), Modbus (502), and the read-only
//! twins of the three that take scripts (30011 to 30013), around the frame-stepped controller.
//!
//! In: a client's bytes, and one call of [`shared::RobotShared::frame`] per controller frame. Out: whatever
//! the clients of the real controller expect. Sessions act on the controller under one lock. Nothing waits
//! for a client: what is sent without a request goes through a bounded queue per connection (`line`).

pub mod dashboard;

pub mod interpreter;

pub mod lateness;

pub mod line;

pub mod modbus;

pub mod publisher;

pub mod latency;

pub mod rtde;

pub mod script_channel;

pub mod script_ports;

pub mod shared;

use std::net::SocketAddr;

/// Port numbers; 0 lets the system choose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RobotPorts {
    /// Dashboard, or the Robot API that PolyScope X has in its place.
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
    /// Interpreter mode.
    pub interpreter: u16,
    /// The controller's own Modbus server, which is not started without.
    pub modbus: Option<u16>,
    /// The socket of a Robotiq gripper's URCap, which is not started without, nor with other grippers.
    pub robotiq: Option<u16>,
    /// The serial line of the tool connector, likewise with a gripper there.
    pub tool_serial: Option<u16>,
}

/// Port of the Robot API on a real controller.
pub const ROBOT_API_PORT: u16 = 80;

/// Port of a Robotiq gripper's URCap on a real controller.
pub const ROBOTIQ_PORT: u16 = 63_352;

/// Port of the forwarder of the tool's serial line on a real controller.
pub const TOOL_SERIAL_PORT: u16 = 54_321;

impl RobotPorts {
    /// Those of a real controller.
    pub const REAL: RobotPorts = RobotPorts {
        dashboard: 29999,
        primary: 30001,
        secondary: 30002,
        realtime: 30003,
        rtde: 30004,
        read_only: [30011, 30012, 30013],
        interpreter: 30020,
        modbus: None,
        robotiq: None,
        tool_serial: None,
    };
    /// Any that are free.
    pub const ANY: RobotPorts = RobotPorts {
        dashboard: 0,
        primary: 0,
        secondary: 0,
        realtime: 0,
        rtde: 0,
        read_only: [0; 3],
        interpreter: 0,
        modbus: Some(0),
        robotiq: Some(0),
        tool_serial: Some(0),
    };

    /// All of them higher by `offset`; `None` if there are no such ports.
    pub fn moved(self, offset: u16) -> Option<RobotPorts> {
        let up = |port: u16| port.checked_add(offset);
        let [first, second, third] = self.read_only;
        Some(RobotPorts {
            dashboard: up(self.dashboard)?,
            primary: up(self.primary)?,
            secondary: up(self.secondary)?,
            realtime: up(self.realtime)?,
            rtde: up(self.rtde)?,
            read_only: [up(first)?, up(second)?, up(third)?],
            interpreter: up(self.interpreter)?,
            modbus: self.modbus.map_or(Some(None), |port| up(port).map(Some))?,
            robotiq: self.robotiq.map_or(Some(None), |port| up(port).map(Some))?,
            tool_serial: self.tool_serial.map_or(Some(None), |port| up(port).map(Some))?,
        })
    }
}

/// Where the servers listen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RobotAddresses {
    /// Dashboard, or the Robot API that PolyScope X has in its place.
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
    /// Interpreter mode.
    pub interpreter: SocketAddr,
    /// The controller's own Modbus server.
    pub modbus: Option<SocketAddr>,
    /// The socket of a Robotiq gripper's URCap.
    pub robotiq: Option<SocketAddr>,
    /// The serial line of the tool connector.
    pub tool_serial: Option<SocketAddr>,
}
