//! Configuration from files: the only place here that opens any.
//!
//! In: a path. Out: the checked configuration, or a message for the terminal. Paths inside a file are relative
//! to its own folder, so that a configuration works from wherever celld is started.

use crate::config::cell::CellConfig;
use crate::config::read_cell::read_cell;
use crate::config::read_sim::read_sim;
use crate::config::simulated::SimFile;
use crate::document::Complaints;
use crate::io::files::read_named;
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
    Wrong(Complaints),
}

/// Reads the configuration of a cell.
pub fn load_cell(path: &Path) -> Result<CellConfig, ConfigError> {
    let (text, folder) = open(path)?;
    let source = path.display().to_string();
    read_cell(&text, &source, &folder, &|file| read_text(file)).map_err(ConfigError::Wrong)
}

/// Reads the configuration of a simulated cell.
pub fn load_sim(path: &Path) -> Result<SimFile, ConfigError> {
    let (text, _) = open(path)?;
    read_sim(&text, &path.display().to_string()).map_err(ConfigError::Wrong)
}

fn open(path: &Path) -> Result<(String, PathBuf), ConfigError> {
    let unreadable = |reason| ConfigError::Unreadable { path: path.to_owned(), reason };
    let text = read_text(path).map_err(unreadable)?;
    let absolute = std::path::absolute(path).map_err(|error| unreadable(error.to_string()))?;
    Ok((text, absolute.parent().unwrap_or(Path::new("/")).to_owned()))
}

/// Text of a plain file of reasonable size (links are followed); why not, in words.
pub fn read_text(path: &Path) -> Result<String, String> {
    read_named(path, MAX_BYTES).map_err(|error| error.reason())
}
