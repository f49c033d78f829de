//! What every command does at the terminal: print, complain, read a file that was named, keep a log.
//!
//! In: text, paths. Out: text on standard output and standard error, or one line that says why a file cannot
//! be read or a value cannot be used.

use crate::files::read_named;
use std::io::Write;
use std::ops::RangeInclusive;
use std::path::Path;

/// Larger files are nothing that a command reads; they would only fill the memory.
pub const LARGEST_FILE_BYTES: u64 = 32 << 20;

/// The text of a plain file of reasonable size.
///
/// # Errors
/// One line with the path and what to do.
pub fn read_text(path: &Path) -> Result<String, String> {
    read_named(path, LARGEST_FILE_BYTES)
        .map_err(|error| format!("{}: cannot be read: {}", path.display(), error.reason()))
}

/// Writes results to standard output. A reader that has gone away is no error of ours.
pub fn print(text: &str) {
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// Writes complaints and progress to standard error.
pub fn complain(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// A number in a range; `unit` is for the message.
///
/// # Errors
/// One sentence that says what to give.
pub fn within(text: &str, range: RangeInclusive<f64>, unit: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if range.contains(&value) => Ok(value),
        _ => Err(format!("give a number between {} and {} {unit}", range.start(), range.end())),
    }
}

/// Logs go to stderr; `CELLD_LOG` chooses what (`info`, `celld::daemon=debug`, ...).
pub fn start_log() {
    let filter = tracing_subscriber::EnvFilter::try_from_env("CELLD_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("error"));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
}
