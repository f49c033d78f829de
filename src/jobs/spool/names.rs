//! Names of job files: which are taken, what they become, and the ids made of them.
//!
//! In: a name as it was written. Out: whether it may stay as it is, one that may, and the id of a job
//! that states none.

use crate::jobs::utc;
use std::path::Path;

/// Name endings of files that are still being written.
const UNFINISHED: [&str; 5] = [".tmp", ".part", ".swp", "~", ".crdownload"];

/// True for names that a job or its file may have: `[A-Za-z0-9._-]{1,80}`, not hidden.
pub fn is_plain_name(name: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'_' | b'-');
    (1..=80).contains(&name.len()) && !name.starts_with('.') && name.bytes().all(plain)
}

/// Names that are left alone: hidden, or still being written.
pub(super) fn is_unfinished_name(name: &str) -> bool {
    name.starts_with('.') || UNFINISHED.iter().any(|ending| name.ends_with(ending))
}

/// `name` with every other character replaced, short and not hidden.
pub(super) fn plain_name(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-') { c } else { '_' };
    let text: String = name.chars().map(plain).take(80).collect();
    if text.is_empty() { "unnamed".to_owned() } else { text }
}

/// The id of a job that states none: `<utc>-<name>-<first 8 of the hash>`, or the file's name if it is of
/// that form already, as `celld submit` names its files.
pub fn id_of_file(name: &str, sha256: &str, unix_s: f64) -> String {
    let stem = Path::new(name).file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let stem: String = stem.unwrap_or_default().chars().take(60).collect();
    let hash = sha256.get(..8).unwrap_or(sha256);
    let named = stem.get(17..).is_some_and(|rest| rest.contains(&format!("-{hash}")));
    if named && stem.as_bytes().get(16) == Some(&b'-') && stem.as_bytes().get(15) == Some(&b'Z') {
        return stem;
    }
    let stem: String = stem.chars().take(40).collect();
    format!("{}-{stem}-{hash}", utc::compact(unix_s))
}
