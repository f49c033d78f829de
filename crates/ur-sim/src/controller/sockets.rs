//! The network as scripts see it: sockets by name, opened from the controller to a server.
//!
//! In: orders of the socket functions, once per frame at most. Out: bytes that have arrived, and whether the
//! connection is open. The controller is pure, so the real network is behind this trait (`script_sockets`);
//! nothing of it waits. [`NoNetwork`] is a controller whose cable is not plugged in.

/// Bytes kept for a script that does not read, and bytes a script may send ahead of its peer.
pub const MAX_BUFFER: usize = 65_536;

/// What a socket is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SocketState {
    /// The server has not answered yet.
    Connecting,
    /// Bytes go both ways.
    Open,
    /// Refused, timed out, closed by either side, or never opened.
    Closed,
}

/// Sockets of the running program.
pub trait ScriptSockets: std::fmt::Debug + Send {
    /// Starts to connect; what was open under that name is closed first.
    fn open(&mut self, name: &str, host: &str, port: u16);

    /// State of the socket called `name`.
    fn state(&mut self, name: &str) -> SocketState;

    /// Bytes that have arrived and were not taken yet, at most [`MAX_BUFFER`]; the caller removes what it
    /// takes. `None` if no socket has that name.
    fn received(&mut self, name: &str) -> Option<&mut Vec<u8>>;

    /// Hands over bytes; false if the socket is not open or its peer has too many to read already.
    fn send(&mut self, name: &str, bytes: &[u8]) -> bool;

    /// Closes one; a name that is not open is no error.
    fn close(&mut self, name: &str);

    /// Closes all, at the end of a program.
    fn close_all(&mut self);

    /// Once per frame: passes on what a full connection has held up.
    fn flush(&mut self);
}

/// No network: every connection fails.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoNetwork;

impl ScriptSockets for NoNetwork {
    fn open(&mut self, _: &str, _: &str, _: u16) {}

    fn state(&mut self, _: &str) -> SocketState {
        SocketState::Closed
    }

    fn received(&mut self, _: &str) -> Option<&mut Vec<u8>> {
        None
    }

    fn send(&mut self, _: &str, _: &[u8]) -> bool {
        false
    }

    fn close(&mut self, _: &str) {}

    fn close_all(&mut self) {}

    fn flush(&mut self) {}
}
