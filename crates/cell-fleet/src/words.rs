//! Texts on their way: their hash, and a length that can be passed on. Pure.

use sha2::{Digest, Sha256};

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
