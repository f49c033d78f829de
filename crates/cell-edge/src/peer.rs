//! Whose program is at the other end of a connection that stays within this computer.
//!
//! In: both ends of a TCP connection. Out: the user that its far end belongs to, as the kernel has it
//! (`proc_pid_net(5)`); none where the other end is on another computer, or is gone. A secret that other
//! users can read, as the arguments of a process are, is no secret; the user of a connection is.

use procfs::net::{TcpNetEntry, TcpState, tcp, tcp6};
use std::net::SocketAddr;

/// The user of the program at `far`, which is connected to `near` here.
pub fn user_of(far: SocketAddr, near: SocketAddr) -> Option<u32> {
    let plain = |address: SocketAddr| SocketAddr::new(address.ip().to_canonical(), address.port());
    let is_it = |entry: &TcpNetEntry| {
        let ends = (plain(entry.local_address), plain(entry.remote_address));
        entry.state == TcpState::Established && ends == (plain(far), plain(near))
    };
    // A system without the newer protocol has no table of it.
    [tcp(), tcp6()].into_iter().flatten().flatten().find(is_it).map(|entry| entry.uid)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{TcpListener, TcpStream};

    #[test]
    fn the_user_at_the_other_end_is_known_as_long_as_it_is_connected() {
        for address in ["127.0.0.1:0", "[::1]:0"] {
            let Ok(listener) = TcpListener::bind(address) else { continue };
            let near = listener.local_addr().unwrap();
            let client = TcpStream::connect(near).unwrap();
            let (_server, far) = listener.accept().unwrap();
            let own = rustix::process::getuid().as_raw();
            assert_eq!(user_of(far, near), Some(own), "{address}");
            assert_eq!(user_of(near, far), Some(own), "our own end");
            let other = SocketAddr::new(near.ip(), near.port() ^ 1);
            assert_eq!(user_of(far, other), None, "connected to something else");
            drop(client);
            assert_eq!(user_of(far, near), None, "{address}: gone");
        }
    }
}
