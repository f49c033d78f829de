//! A configuration file opened: its text and its folder.
//!
//! In: a path. Out: the text, and the folder against which the paths inside the file resolve, or a message
//! for the terminal. The only part of this crate that opens anything.

use cell_edge::files::read_named;
use rearrange::document::Diagnostics;
use std::path::{Path, PathBuf};

/// Largest file that is read, bytes.
const MAX_BYTES: u64 = 16 << 20;

/// Why there is no configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("{path}: {reason}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// The file is wrong; one line for each complaint.
    #[error("{0}")]
    Wrong(Diagnostics),
}

/// Text of a configuration file, and the folder it lies in, absolute.
///
/// # Errors
/// The file cannot be read.
pub fn open(path: &Path) -> Result<(String, PathBuf), ConfigError> {
    let unreadable = |reason| ConfigError::Unreadable { path: path.to_owned(), reason };
    let text = read_text(path).map_err(unreadable)?;
    let absolute = std::path::absolute(path).map_err(|error| unreadable(error.to_string()))?;
    Ok((text, absolute.parent().unwrap_or(Path::new("/")).to_owned()))
}

/// Text of a plain file of reasonable size (links are followed); why not, in words.
///
/// # Errors
/// The file is absent, no plain file, larger than 16 MiB or not UTF-8 text, or the system refuses to read
/// it.
pub fn read_text(path: &Path) -> Result<String, String> {
    read_named(path, MAX_BYTES).map_err(|error| error.reason())
}
