//! Scripts' sockets on the real network.
//!
//! In: orders through [`ScriptSockets`] from the frame thread. Out: TCP connections to the addresses the
//! script names. Nothing here waits: connecting happens on a thread of its own that ends after
//! `CONNECT_TIMEOUT` at the latest, reading and writing are non-blocking. What a script does not read stays
//! with the operating system once [`MAX_BUFFER`] bytes are here, so a flood slows its sender down instead of
//! filling memory.

use crate::controller::sockets::{MAX_BUFFER, ScriptSockets, SocketState};
use cell_edge::priority;
use socket2::{Domain, Socket as Socket2, Type};
use std::collections::HashMap;
use std::io::{ErrorKind, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};
use std::time::Duration;

/// The script manual's time for `socket_open`, wall time.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);

/// Sockets a program may have, and connections that may be tried at once.
const MAX_SOCKETS: usize = 32;

/// Scripts' sockets.
#[derive(Debug, Default)]
pub struct TcpScriptSockets {
    sockets: HashMap<String, Socket>,
    connecting: Arc<AtomicUsize>,
    /// The controller's own address, which peers may look at.
    source: Option<IpAddr>,
    /// Servers that scripts look for on the controller itself, by the port there, and where they are.
    own: Vec<(u16, SocketAddr)>,
}

impl TcpScriptSockets {
    /// Sockets of a controller with this address.
    pub fn from_address(source: IpAddr) -> TcpScriptSockets {
        TcpScriptSockets { source: Some(source), ..TcpScriptSockets::default() }
    }

    /// The same, with servers of URCaps on the controller, by the port there.
    pub fn with_own<const N: usize>(self, servers: [(u16, Option<SocketAddr>); N]) -> TcpScriptSockets {
        let own = servers.into_iter().filter_map(|(port, at)| Some((port, at?))).collect();
        TcpScriptSockets { own, ..self }
    }
}

#[derive(Debug)]
struct Socket {
    link: Link,
    received: Vec<u8>,
    unsent: Vec<u8>,
}

#[derive(Debug)]
enum Link {
    Connecting(Receiver<TcpStream>),
    Open(TcpStream),
    Closed,
}

impl ScriptSockets for TcpScriptSockets {
    fn open(&mut self, name: &str, host: &str, port: u16) {
        self.close(name);
        if self.sockets.len() >= MAX_SOCKETS {
            return;
        }
        let here = matches!(host, "127.0.0.1" | "localhost");
        let own = self.own.iter().find(|(known, _)| here && *known == port);
        let (host, port) = own.map_or((host.to_owned(), port), |(_, at)| (at.ip().to_string(), at.port()));
        let link = connect(&host, port, self.source, &self.connecting).map_or(Link::Closed, Link::Connecting);
        self.sockets.insert(name.to_owned(), Socket { link, received: Vec::new(), unsent: Vec::new() });
    }

    fn state(&mut self, name: &str) -> SocketState {
        self.sockets.get_mut(name).map_or(SocketState::Closed, Socket::state)
    }

    fn received(&mut self, name: &str) -> Option<&mut Vec<u8>> {
        let socket = self.sockets.get_mut(name)?;
        socket.read();
        Some(&mut socket.received)
    }

    fn send(&mut self, name: &str, bytes: &[u8]) -> bool {
        let Some(socket) = self.sockets.get_mut(name) else { return false };
        if socket.state() != SocketState::Open || socket.unsent.len() + bytes.len() > MAX_BUFFER {
            return false;
        }
        socket.unsent.extend_from_slice(bytes);
        socket.write();
        !matches!(socket.link, Link::Closed)
    }

    fn close(&mut self, name: &str) {
        self.sockets.remove(name);
    }

    fn close_all(&mut self) {
        self.sockets.clear();
    }

    fn flush(&mut self) {
        self.sockets.values_mut().for_each(Socket::write);
    }
}

impl Socket {
    fn state(&mut self) -> SocketState {
        if let Link::Connecting(answer) = &self.link {
            match answer.try_recv() {
                Ok(stream) => self.link = Link::Open(stream),
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => self.link = Link::Closed,
            }
        }
        match self.link {
            Link::Connecting(_) => SocketState::Connecting,
            Link::Open(_) => SocketState::Open,
            Link::Closed => SocketState::Closed,
        }
    }

    /// Takes in what has arrived, as far as there is room.
    fn read(&mut self) {
        let mut chunk = [0; 4096];
        while let Link::Open(stream) = &mut self.link {
            let room = MAX_BUFFER.saturating_sub(self.received.len()).min(chunk.len());
            if room == 0 {
                return;
            }
            match stream.read(&mut chunk[..room]) {
                Ok(0) => self.link = Link::Closed,
                Ok(count) => self.received.extend_from_slice(&chunk[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.link = Link::Closed,
            }
        }
    }

    fn write(&mut self) {
        while !self.unsent.is_empty()
            && let Link::Open(stream) = &mut self.link
        {
            match stream.write(&self.unsent) {
                Ok(count) => drop(self.unsent.drain(..count)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.link = Link::Closed,
            }
        }
    }
}

/// Connects on a thread; the stream arrives once connected, and the channel closes when connecting fails.
/// `None` if too many are being tried.
fn connect(
    host: &str,
    port: u16,
    source: Option<IpAddr>,
    connecting: &Arc<AtomicUsize>,
) -> Option<Receiver<TcpStream>> {
    if connecting.fetch_add(1, Ordering::Relaxed) >= MAX_SOCKETS {
        connecting.fetch_sub(1, Ordering::Relaxed);
        return None;
    }
    let (found, answer) = sync_channel(1);
    let (host, counter) = (host.to_owned(), connecting.clone());
    let thread = std::thread::Builder::new().name("script-socket".to_owned()).spawn(move || {
        // It is started by the thread of the frames, and would go before everything else like that one.
        priority::ordinary();
        if let Some(stream) = stream_to(&host, port, source) {
            // The program may have gone meanwhile; the stream then closes with it.
            let _ = found.send(stream);
        }
        counter.fetch_sub(1, Ordering::Relaxed);
    });
    if thread.is_err() {
        connecting.fetch_sub(1, Ordering::Relaxed);
    }
    Some(answer)
}

fn stream_to(host: &str, port: u16, source: Option<IpAddr>) -> Option<TcpStream> {
    let mut addresses = (host, port).to_socket_addrs().ok()?;
    let stream = addresses.find_map(|address| {
        // Another computer cannot answer a loopback address, and bind may be "any": then the system chooses.
        match source.and_then(|source| bound(source, address).ok()) {
            Some(socket) => {
                socket.connect_timeout(&address.into(), CONNECT_TIMEOUT).ok().map(|()| socket.into())
            }
            None => TcpStream::connect_timeout(&address, CONNECT_TIMEOUT).ok(),
        }
    })?;
    stream.set_nodelay(true).ok()?;
    stream.set_nonblocking(true).ok()?;
    Some(stream)
}

/// A socket with this address, for a peer that can answer it.
fn bound(source: IpAddr, address: SocketAddr) -> std::io::Result<Socket2> {
    if source.is_loopback() != address.ip().is_loopback() {
        return Err(ErrorKind::AddrNotAvailable.into());
    }
    let socket = Socket2::new(Domain::for_address(address), Type::STREAM, None)?;
    socket.bind(&SocketAddr::new(source, 0).into())?;
    Ok(socket)
}

#[cfg(test)]
mod tests;
