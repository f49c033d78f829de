//! `page:` where the daemon serves its page, under which names, and from where the arm may be moved.
//!
//! In: the located value. Out: [`PageConfig`]. An address beyond this computer needs TLS: orders and the
//! tokens that allow them do not go over a network in the clear.

use cell_parts::fields::{is_host, list, optional, path};
use rearrange::document::decode::{At, Decoder, Fields};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};

/// Where the page is, and for whom.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PageConfig {
    /// Address and port it is served at.
    pub listen: SocketAddr,
    /// Names under which browsers may call it, besides its address.
    pub hosts: Vec<String>,
    /// Computers from which orders may come that move the arm, besides this one.
    pub control_from: Vec<IpAddr>,
    /// Certificate and key, PEM files.
    pub tls: Option<TlsFiles>,
    /// Files with its texts in other languages.
    pub texts: Vec<PathBuf>,
}

/// A certificate with its chain, and its key; PEM.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// The server's certificate first.
    pub certificate: PathBuf,
    /// Its private key.
    pub key: PathBuf,
}

/// The address unless the configuration names one: this computer alone.
const LISTEN: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8737);

impl PageConfig {
    /// What a browser on this computer is pointed at.
    pub fn address(&self) -> String {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        let ip = match self.listen.ip() {
            ip if ip.is_unspecified() => IpAddr::V4(Ipv4Addr::LOCALHOST),
            ip => ip,
        };
        format!("{scheme}://{}", SocketAddr::new(ip, self.listen.port()))
    }

    /// Whether orders that move the arm may come from there.
    pub fn moves_from(&self, peer: IpAddr) -> bool {
        let peer = peer.to_canonical();
        peer.is_loopback() || self.control_from.contains(&peer)
    }
}

/// Reads the section.
pub(super) fn page(decoder: &mut Decoder, at: &At, folder: &Path) -> Option<PageConfig> {
    let fields = decoder.map(at, &["listen", "hosts", "control_from", "tls", "texts"])?;
    let listen = optional(decoder, &fields, "listen", LISTEN, address);
    let hosts = optional(decoder, &fields, "hosts", Vec::new(), |d, at| list(d, at, host_name));
    let control_from = optional(decoder, &fields, "control_from", Vec::new(), |d, at| list(d, at, computer));
    let tls = optional(decoder, &fields, "tls", None, |d, at| tls(d, at, folder).map(Some));
    let file = |d: &mut Decoder, at: &At| path(d, at, folder);
    let texts = optional(decoder, &fields, "texts", Vec::new(), |d, at| list(d, at, file));
    let config =
        PageConfig { listen: listen?, hosts: hosts?, control_from: control_from?, tls: tls?, texts: texts? };
    if !config.listen.ip().is_loopback() && config.tls.is_none() {
        complain_open(decoder, at, &fields, config.listen);
        return None;
    }
    Some(config)
}

fn complain_open(decoder: &mut Decoder, at: &At, fields: &Fields, listen: SocketAddr) {
    let place = fields.optional("listen");
    let message = format!("{listen} can be reached from other computers, and there is no `tls`");
    let help = "add tls: {certificate: FILE, key: FILE} (PEM), or listen on 127.0.0.1: orders and tokens do \
                not go over a network in the clear";
    decoder.complain_at(place.as_ref().unwrap_or(at), message, help);
}

fn address(decoder: &mut Decoder, at: &At) -> Option<SocketAddr> {
    let text = decoder.text(at)?;
    // Port 0 is whichever is free: no address that could be opened again, or given to anyone.
    let found = text.parse().ok().filter(|address: &SocketAddr| address.port() != 0);
    if found.is_none() {
        let help = "write an address with its port, such as 127.0.0.1:8737 or [::1]:8737";
        decoder.complain_at(at, format!("{text:?} is no address with a port"), help);
    }
    found
}

fn computer(decoder: &mut Decoder, at: &At) -> Option<IpAddr> {
    let text = decoder.text(at)?;
    let found = text.parse::<IpAddr>().ok().map(|ip| ip.to_canonical());
    if found.is_none() {
        let help = "write the address of one computer, such as 192.168.1.20";
        decoder.complain_at(at, format!("{text:?} is no IP address"), help);
    }
    found
}

fn host_name(decoder: &mut Decoder, at: &At) -> Option<String> {
    let text = decoder.text(at)?.to_ascii_lowercase();
    if text.contains(':') || !is_host(&text) {
        let help = "write the name alone, such as cell-1.plant, without http:// and port";
        decoder.complain_at(at, format!("{text:?} is no host name"), help);
        return None;
    }
    Some(text)
}

fn tls(decoder: &mut Decoder, at: &At, folder: &Path) -> Option<TlsFiles> {
    let fields = decoder.map(at, &["certificate", "key"])?;
    let certificate = fields.required("certificate", decoder).and_then(|at| path(decoder, &at, folder));
    let key = fields.required("key", decoder).and_then(|at| path(decoder, &at, folder));
    Some(TlsFiles { certificate: certificate?, key: key? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rearrange::document::decode::read;

    fn read_page(text: &str) -> Result<PageConfig, String> {
        read(text, "cell.yaml", |at, decoder| page(decoder, at, Path::new("/etc/celld")))
            .map_err(|complaints| complaints.to_string())
    }

    #[test]
    fn this_computer_alone_unless_tls_protects_what_goes_out() {
        let bare = read_page("{}").unwrap();
        assert_eq!((bare.listen, bare.address().as_str()), (LISTEN, "http://127.0.0.1:8737"));
        for open in ["{listen: '0.0.0.0:80'}", "{listen: '192.168.1.5:8737'}", "{listen: '[::]:8737'}"] {
            let complaint = read_page(open).unwrap_err();
            assert!(complaint.contains("other computers") && complaint.contains("tls"), "{complaint}");
        }
        let texts = read_page("{texts: [fr.json, /es.json]}").unwrap().texts;
        assert_eq!(texts, [Path::new("/etc/celld/fr.json"), Path::new("/es.json")]);
        let tls = "{listen: '0.0.0.0:443', tls: {certificate: c.pem, key: /k.pem}, hosts: [Cell-1.plant]}";
        let open = read_page(tls).unwrap();
        assert_eq!(open.tls.as_ref().unwrap().certificate, Path::new("/etc/celld/c.pem"));
        assert_eq!(
            (open.hosts[0].as_str(), open.address().as_str()),
            ("cell-1.plant", "https://127.0.0.1:443")
        );
    }

    #[test]
    fn the_arm_is_moved_from_this_computer_and_from_those_named() {
        let page = read_page("{control_from: [192.168.1.20]}").unwrap();
        let from = |text: &str| page.moves_from(text.parse().unwrap());
        assert!(from("127.0.0.1") && from("::1") && from("192.168.1.20") && from("::ffff:192.168.1.20"));
        assert!(!from("192.168.1.21") && !from("10.0.0.1"));
        for wrong in [
            "{control_from: [cell-pc]}",
            "{listen: 8737}",
            "{listen: '127.0.0.1:0'}",
            "{hosts: [a..b]}",
            "{hosts: ['http://x']}",
            "{listem: x}",
        ] {
            assert!(read_page(wrong).is_err(), "{wrong}");
        }
    }
}
