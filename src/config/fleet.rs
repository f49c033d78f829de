//! `fleet:` which fleet the cell belongs to, under which name, and where its server is.
//!
//! In: the located value. Out: [`FleetConfig`]. A server beyond this computer needs TLS: jobs and approvals
//! do not go over a network in the clear. Read by every celld; what it says is carried out by one that was
//! built with the feature `fleet`.

use cell_parts::fields::{is_host, list, optional, path};
use rearrange::document::decode::{At, Decoder, Fields};
use std::net::IpAddr;
use std::path::{Path, PathBuf};

/// The cell's part in a fleet.
#[derive(Clone, Debug, PartialEq)]
pub struct FleetConfig {
    /// The fleet.
    pub name: String,
    /// This cell's name in it.
    pub cell: String,
    /// What jobs may require, besides its name.
    pub labels: Vec<String>,
    /// `nats://HOST:PORT` or `tls://HOST:PORT`, one or several of a cluster.
    pub servers: Vec<String>,
    /// A credentials file.
    pub credentials: Option<PathBuf>,
    /// A file with the seed of an nkey.
    pub nkey: Option<PathBuf>,
    /// A certificate authority besides those of the system, PEM.
    pub authority: Option<PathBuf>,
    /// The JetStream domain of the fleet's server, where the cell's own server is a leaf node.
    pub domain: Option<String>,
    /// Nodes of the server's cluster that hold each message.
    pub replicas: u8,
    /// Bytes of events that are kept while the network is away.
    pub keep_bytes: u64,
    /// How long they are kept, days.
    pub keep_days: f64,
}

const KEYS: &[&str] =
    &["name", "cell", "labels", "servers", "credentials", "nkey", "authority", "domain", "replicas", "keep"];

/// Longest name of a fleet, cell or label.
const NAME_MAX: usize = 40;

impl FleetConfig {
    /// A server that is reached over TLS alone.
    pub fn is_tls(server: &str) -> bool {
        server.starts_with("tls://")
    }
}

/// Reads the section.
pub(super) fn fleet(decoder: &mut Decoder, at: &At, folder: &Path) -> Option<FleetConfig> {
    let fields = decoder.map(at, KEYS)?;
    let file = |decoder: &mut Decoder, key: &'static str| {
        optional(decoder, &fields, key, None, |d, at| path(d, at, folder).map(Some))
    };
    let (credentials, nkey) = (file(decoder, "credentials"), file(decoder, "nkey"));
    let authority = file(decoder, "authority");
    let name = fields.required("name", decoder).and_then(|at| token(decoder, &at));
    let cell = fields.required("cell", decoder).and_then(|at| token(decoder, &at));
    let labels = optional(decoder, &fields, "labels", Vec::new(), |d, at| list(d, at, token));
    let servers = fields.required("servers", decoder).and_then(|at| servers(decoder, &at));
    let domain = optional(decoder, &fields, "domain", None, |d, at| token(d, at).map(Some));
    let replicas = optional(decoder, &fields, "replicas", 1, |d, at| d.integer(at, 1..=5));
    let keep = optional(decoder, &fields, "keep", (1.0, 7.0), keep);
    if let (Some(Some(_)), Some(Some(_))) = (&credentials, &nkey) {
        complain_twice(decoder, &fields);
        return None;
    }
    let (gb, days) = keep?;
    Some(FleetConfig {
        name: name?,
        cell: cell?,
        labels: labels?,
        servers: servers?,
        credentials: credentials?,
        nkey: nkey?,
        authority: authority?,
        domain: domain?,
        replicas: u8::try_from(replicas?).ok()?,
        keep_bytes: (gb * 1e9) as u64,
        keep_days: days,
    })
}

fn complain_twice(decoder: &mut Decoder, fields: &Fields) {
    if let Some(at) = fields.optional("nkey") {
        let help = "keep one of `credentials` and `nkey`: a cell is one user of the server";
        decoder.complain_at(&at, "there are two ways to say who the cell is", help);
    }
}

fn keep(decoder: &mut Decoder, at: &At) -> Option<(f64, f64)> {
    let fields = decoder.map(at, &["gb", "days"])?;
    let gb = optional(decoder, &fields, "gb", 1.0, |d, at| d.number_in(at, 0.001..=1000.0, "GB"));
    let days = optional(decoder, &fields, "days", 7.0, |d, at| d.number_in(at, 0.01..=365.0, "days"));
    Some((gb?, days?))
}

/// A name that is one token of a subject.
fn token(decoder: &mut Decoder, at: &At) -> Option<String> {
    let text = decoder.text(at)?;
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if (1..=NAME_MAX).contains(&text.len()) && text.chars().all(plain) {
        return Some(text);
    }
    let help = format!("write 1 to {NAME_MAX} letters, digits, - and _, such as cell-1");
    decoder.complain_at(at, format!("{text:?} is no name of a fleet, cell, label or domain"), help);
    None
}

fn servers(decoder: &mut Decoder, at: &At) -> Option<Vec<String>> {
    let servers = list(decoder, at, server)?;
    if servers.is_empty() {
        decoder.complain_at(at, "no server is named", "write servers: [nats://127.0.0.1:4222]");
        return None;
    }
    Some(servers)
}

fn server(decoder: &mut Decoder, at: &At) -> Option<String> {
    let text = decoder.text(at)?;
    let Some((scheme, host)) = parts(&text) else {
        let help = "write nats://127.0.0.1:4222 for a server on this computer, tls://HOST:4222 for any other";
        decoder.complain_at(at, format!("{text:?} is no address of a NATS server"), help);
        return None;
    };
    if scheme == "nats" && !is_loopback(host) {
        let message =
            format!("{text:?} is another computer, and jobs and approvals would go there in the clear");
        let help =
            "write tls:// and set up TLS at the server, or run a leaf node on this computer (docs/fleet.md)";
        decoder.complain_at(at, message, help);
        return None;
    }
    Some(text)
}

/// Scheme and host of an address.
fn parts(text: &str) -> Option<(&str, &str)> {
    let (scheme, rest) = text.split_once("://")?;
    let (host, port) = rest.rsplit_once(':')?;
    let is_port =
        port.bytes().all(|byte| byte.is_ascii_digit()) && port.parse::<u16>().is_ok_and(|port| port > 0);
    let sound = matches!(scheme, "nats" | "tls") && is_port && is_host(host) && !host.contains(':');
    sound.then_some((scheme, host))
}

fn is_loopback(host: &str) -> bool {
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rearrange::document::decode::read;

    fn read_fleet(text: &str) -> Result<FleetConfig, String> {
        read(text, "cell.yaml", |at, decoder| fleet(decoder, at, Path::new("/etc/celld")))
            .map_err(|complaints| complaints.to_string())
    }

    #[test]
    fn a_cell_has_a_name_a_fleet_and_a_server() {
        let read = read_fleet("{name: plant, cell: cell-1, servers: ['nats://127.0.0.1:4222'], nkey: c.nk}")
            .unwrap();
        assert_eq!((read.name.as_str(), read.cell.as_str(), read.replicas), ("plant", "cell-1", 1));
        assert_eq!(read.nkey.as_deref(), Some(Path::new("/etc/celld/c.nk")));
        assert_eq!((read.keep_bytes, read.keep_days), (1_000_000_000, 7.0));
        let leaf = "{name: p, cell: c, servers: ['nats://127.0.0.1:4222'], domain: hub}";
        assert_eq!(read_fleet(leaf).unwrap().domain.as_deref(), Some("hub"));
        let far = "{name: p, cell: c, servers: ['tls://nats.plant:4222'], keep: {gb: 0.5, days: 2}}";
        assert_eq!(read_fleet(far).unwrap().keep_bytes, 500_000_000);
    }

    #[test]
    fn another_computer_is_reached_over_tls_alone() {
        let complaint = read_fleet("{name: p, cell: c, servers: ['nats://10.0.0.2:4222']}").unwrap_err();
        assert!(complaint.contains("in the clear") && complaint.contains("tls://"), "{complaint}");
    }

    #[test]
    fn what_cannot_be_a_token_of_a_subject_is_no_name() {
        for wrong in [
            "{name: 'a.b', cell: c, servers: ['nats://localhost:4222']}",
            "{name: p, cell: '*', servers: ['nats://localhost:4222']}",
            "{name: p, cell: c, labels: ['a b'], servers: ['nats://localhost:4222']}",
            "{name: p, cell: c, servers: []}",
            "{name: p, cell: c, servers: ['http://localhost:4222']}",
            "{name: p, cell: c, servers: ['nats://localhost']}",
            "{name: p, cell: c, servers: ['nats://localhost:+1']}",
            "{name: p, cell: c, servers: ['nats://localhost:4222'], nkey: a, credentials: b}",
            "{name: p, cell: c, servers: ['nats://localhost:4222'], domain: 'a.b'}",
            "{name: p, cell: c}",
            "{name: p, cell: c, servers: ['nats://localhost:4222'], port: 1}",
        ] {
            assert!(read_fleet(wrong).is_err(), "{wrong}");
        }
    }
}
