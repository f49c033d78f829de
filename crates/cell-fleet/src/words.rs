//! Texts on their way: their hash, a length that can be passed on, the server's times. Pure.

use sha2::{Digest, Sha256};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Longest sentence that is passed on.
const SENTENCE_MAX: usize = 2000;

/// The hash of a job's text, lower-case hex.
pub fn sha256(text: &str) -> String {
    use std::fmt::Write as _;
    Sha256::digest(text.as_bytes()).iter().fold(String::new(), |mut hex, byte| {
        let _ = write!(hex, "{byte:02x}");
        hex
    })
}

/// A sentence of a length that can be passed on.
pub fn sentence(text: &str) -> String {
    text.chars().take(SENTENCE_MAX).collect()
}

/// Seconds since 1970 of a time as the server writes it: `2026-11-21T08:00:00.123456789Z`.
pub fn unix_s_of(text: &str) -> Option<f64> {
    let time = OffsetDateTime::parse(text, &Rfc3339).ok()?;
    Some(time.unix_timestamp_nanos() as f64 / 1e9)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_the_server_are_read() {
        assert_eq!(unix_s_of("1970-01-01T00:00:00Z"), Some(0.0));
        assert_eq!(unix_s_of("2026-11-21T08:00:00.5Z"), Some(1_795_248_000.5));
        assert_eq!(
            unix_s_of("2024-03-01T00:00:00Z").zip(unix_s_of("2024-02-28T00:00:00Z")).map(|(a, b)| a - b),
            Some(172_800.0)
        );
        for foreign in ["", "2026-11-21", "2026-13-01T00:00:00Z", "aT:Z"] {
            assert_eq!(unix_s_of(foreign), None, "{foreign}");
        }
    }
}
