//! Configuration from files: the only place here that opens any.
//!
//! In: a path. Out: the checked configuration, or a message for the terminal. Paths inside a file are
//! relative to its own folder, so that a configuration works from wherever celld is started.

use crate::config::cell::CellConfig;
use crate::config::fragment::ConfigFragment;
use crate::config::read_cell::read_cell;
use cell_parts::file::{ConfigError, open, read_text};
use std::path::Path;

/// Reads the configuration of a cell.
///
/// # Errors
/// The file cannot be read ([`ConfigError::Unreadable`]), or its content or that of a file it names is wrong
/// ([`ConfigError::Wrong`]).
pub fn load_cell(path: &Path) -> Result<CellConfig, ConfigError> {
    load_cell_with(path, None)
}

/// The same with a part that the cell shares with others.
///
/// # Errors
/// As [`load_cell`].
pub fn load_cell_with(path: &Path, shared: Option<&ConfigFragment>) -> Result<CellConfig, ConfigError> {
    let (text, folder) = open(path)?;
    let source = path.display().to_string();
    read_cell(&text, &source, shared, &folder, &|file| read_text(file)).map_err(ConfigError::Wrong)
}
