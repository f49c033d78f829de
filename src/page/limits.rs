//! Whether a request may be looked at at all: the name it calls the page by, where it comes from, how often.
//!
//! In: header values, who or what computer it comes from, the time. Out: yes, or no. A page of a stranger
//! that the operator's browser has open (a foreign Origin), or a foreign name that leads here (a foreign
//! Host: DNS rebinding), must not give an order. Requests are counted by session for people who are signed
//! in, and by computer for all others: whoever tries secrets on a computer does not keep its operator from
//! stopping the cell. Pure.

use crate::config::page::PageConfig;
use std::collections::HashMap;
use std::net::IpAddr;
use std::time::{Duration, Instant};

/// So many requests may come at once, and so many in a second after that, of one session or computer: a page
/// with its pictures needs some 20.
const AT_ONCE: f64 = 200.0;
const PER_SECOND: f64 = 60.0;

/// The same of requests that were refused: whoever tries secrets is soon out of breath.
const REFUSED_AT_ONCE: f64 = 20.0;
const REFUSED_PER_SECOND: f64 = 0.5;

/// Sessions and computers that are remembered.
const SOURCES: usize = 1024;

/// Whether the Host header is a name of this page.
pub fn host_is_ours(config: &PageConfig, host: &str) -> bool {
    let host = host.to_ascii_lowercase();
    let (name, port) = split(&host);
    let usual = if config.tls.is_some() { 443 } else { 80 };
    let port = match port {
        Some(port) => port.parse::<u16>().ok(),
        None => Some(usual),
    };
    if port != Some(config.listen.port()) {
        return false;
    }
    if let Ok(ip) = name.trim_matches(['[', ']']).parse::<IpAddr>() {
        // An address is not looked up: no name server makes it lead elsewhere.
        return ip.is_loopback() || ip == config.listen.ip() || config.listen.ip().is_unspecified();
    }
    name == "localhost" || config.hosts.iter().any(|known| known == name)
}

/// Whether the Origin header, where there is one, is the page that the Host header names.
pub fn origin_is_ours(config: &PageConfig, origin: &str, host: &str) -> bool {
    let scheme = if config.tls.is_some() { "https" } else { "http" };
    origin.eq_ignore_ascii_case(&format!("{scheme}://{host}"))
}

/// Name and port of a Host header.
fn split(host: &str) -> (&str, Option<&str>) {
    match host.rsplit_once(':') {
        Some((name, port)) if !port.contains(']') => (name, Some(port)),
        Some(_) | None => (host, None),
    }
}

/// A bucket that fills by the second and from which every request takes one.
#[derive(Clone, Copy, Debug)]
struct Bucket {
    left: f64,
    at: Instant,
}

impl Bucket {
    fn take(&mut self, most: f64, per_second: f64, now: Instant) -> bool {
        let filled = now.duration_since(self.at).as_secs_f64() * per_second;
        (self.left, self.at) = ((self.left + filled).min(most), now);
        let enough = self.left >= 1.0;
        if enough {
            self.left -= 1.0;
        }
        enough
    }
}

/// How many requests each session or computer may still send.
#[derive(Debug, Default)]
pub struct Limits {
    sources: HashMap<String, [Bucket; 2]>,
}

impl Limits {
    /// A request came from there; false when it is one too many.
    pub fn request(&mut self, from: &str, now: Instant) -> bool {
        let [all, refused] = self.buckets(from, now);
        // Who was refused too often waits, whatever is sent.
        let patient = refused.left + now.duration_since(refused.at).as_secs_f64() * REFUSED_PER_SECOND >= 1.0;
        all.take(AT_ONCE, PER_SECOND, now) && patient
    }

    /// One was refused for a secret that is none, a name or an origin.
    pub fn refused(&mut self, from: &str, now: Instant) {
        self.buckets(from, now)[1].take(REFUSED_AT_ONCE, REFUSED_PER_SECOND, now);
    }

    fn buckets(&mut self, from: &str, now: Instant) -> &mut [Bucket; 2] {
        if self.sources.len() >= SOURCES && !self.sources.contains_key(from) {
            // Whoever was not seen for a minute has full buckets again.
            self.sources.retain(|_, [all, _]| now.duration_since(all.at) < Duration::from_secs(60));
            if self.sources.len() >= SOURCES {
                self.sources.clear();
            }
        }
        let full = |left: f64| Bucket { left, at: now };
        self.sources.entry(from.to_string()).or_insert([full(AT_ONCE), full(REFUSED_AT_ONCE)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page(listen: &str, hosts: &[&str]) -> PageConfig {
        PageConfig {
            listen: listen.parse().unwrap(),
            hosts: hosts.iter().map(|host| host.to_string()).collect(),
            control_from: Vec::new(),
            tls: None,
            texts: Vec::new(),
        }
    }

    #[test]
    fn a_foreign_name_or_page_is_refused() {
        let config = page("127.0.0.1:8737", &["cell-1.plant"]);
        for ours in ["127.0.0.1:8737", "localhost:8737", "LOCALHOST:8737", "[::1]:8737", "cell-1.plant:8737"]
        {
            assert!(host_is_ours(&config, ours), "{ours}");
        }
        for foreign in ["evil.example:8737", "127.0.0.1", "127.0.0.1:80", "10.0.0.1:8737", "", "localhost:x"]
        {
            assert!(!host_is_ours(&config, foreign), "{foreign}");
        }
        assert!(host_is_ours(&page("127.0.0.1:80", &[]), "localhost"));
        assert!(origin_is_ours(&config, "http://127.0.0.1:8737", "127.0.0.1:8737"));
        for foreign in ["https://127.0.0.1:8737", "http://127.0.0.1:1", "null", "http://evil.example", ""] {
            assert!(!origin_is_ours(&config, foreign, "127.0.0.1:8737"), "{foreign}");
        }
    }

    #[test]
    fn whoever_tries_secrets_has_to_wait_and_others_do_not() {
        let (mut limits, start) = (Limits::default(), Instant::now());
        let (stranger, operator) = ("127.0.0.1", "4711aa");
        for _ in 0..30 {
            if limits.request(stranger, start) {
                limits.refused(stranger, start);
            }
        }
        assert!(!limits.request(stranger, start) && limits.request(operator, start));
        assert!(limits.request(stranger, start + Duration::from_secs(3)), "later again");
        let requested = (0..1000).filter(|_| limits.request(operator, start)).count();
        assert!(requested < 250, "{requested}");
        for last in 0..3000_u32 {
            limits.request(&last.to_string(), start);
        }
        assert!(limits.sources.len() <= SOURCES);
    }
}
