//! The journal's file as it was at the last look: what `watch` compares.

use rusqlite::Connection;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// The file as it was at the last look.
#[derive(Debug)]
pub(super) struct Seen {
    pub(super) identity: (u64, u64),
    pub(super) length: u64,
    pub(super) data_version: i64,
}

impl Seen {
    /// The file and the connection as they are now.
    pub(super) fn of(path: &Path, database: &Connection) -> Option<Seen> {
        let metadata = path.metadata().ok()?;
        let data_version = database.query_row("PRAGMA data_version", [], |row| row.get(0)).ok()?;
        Some(Seen { identity: (metadata.dev(), metadata.ino()), length: metadata.len(), data_version })
    }
}
