//! Whether the journal's file is still the one that was opened, whole, and changed by nobody else.
//!
//! In: the file's name, device, inode and length, SQLite's `data_version`. Out: what has happened to it. A
//! database goes on without a word when its file is removed or replaced: its commits reach a file that no
//! next celld will find. A check of all pages takes as long as reading them, so it runs at the start, and
//! later on a connection of its own.

use crate::jobs::journal::seen::Seen;
use crate::jobs::journal::{Journal, JournalError};
use rusqlite::{Connection, OpenFlags};
use std::path::{Path, PathBuf};

/// What has happened to the journal's file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum JournalFault {
    /// There is no file of its name, or another one.
    #[error("the journal {0} was removed or replaced while celld ran")]
    Gone(PathBuf),
    /// It has become shorter.
    #[error("the journal {path} was cut from {from} to {to} bytes")]
    Cut {
        /// The file.
        path: PathBuf,
        /// Bytes before.
        from: u64,
        /// Bytes now.
        to: u64,
    },
    /// Another process has written into it.
    #[error("another program has changed the journal {0}")]
    Changed(PathBuf),
    /// SQLite finds it damaged.
    #[error("the journal {path} is damaged: {found}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// SQLite's first complaint.
        found: String,
    },
}

impl Journal {
    /// Looks whether the file is still whole and celld's own; cheap.
    ///
    /// # Errors
    /// What has happened to it.
    pub fn look_at_file(&mut self) -> Result<(), JournalFault> {
        let path = || self.path.clone();
        let now = Seen::of(&self.path, &self.database).ok_or_else(|| JournalFault::Gone(path()))?;
        let Some(before) = &self.seen else {
            self.seen = Some(now);
            return Ok(());
        };
        if now.identity != before.identity {
            return Err(JournalFault::Gone(path()));
        }
        if now.length < before.length {
            return Err(JournalFault::Cut { path: path(), from: before.length, to: now.length });
        }
        if now.data_version != before.data_version {
            return Err(JournalFault::Changed(path()));
        }
        self.seen = Some(now);
        Ok(())
    }

    /// Has SQLite check every page, on this connection.
    pub(super) fn check_pages(&self) -> Result<(), JournalError> {
        let found = first_complaint(&self.database).map_err(|e| self.fail(e))?;
        found.map_or(Ok(()), |found| Err(JournalError::Broken { path: self.path.clone(), found }))
    }
}

/// Checks every page of the journal at `path` on a connection of its own, beside a running daemon.
///
/// # Errors
/// What SQLite finds; also where the file cannot be opened.
pub fn check_file(path: &Path) -> Result<(), JournalFault> {
    let fault = |found: String| JournalFault::Damaged { path: path.to_owned(), found };
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let database = Connection::open_with_flags(path, flags).map_err(|error| fault(error.to_string()))?;
    match first_complaint(&database) {
        Ok(None) => Ok(()),
        Ok(Some(found)) => Err(fault(found)),
        Err(error) => Err(fault(error.to_string())),
    }
}

fn first_complaint(database: &Connection) -> Result<Option<String>, rusqlite::Error> {
    let found: String = database.query_row("PRAGMA quick_check(1)", [], |row| row.get(0))?;
    Ok((found != "ok").then_some(found))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::OpenOptions;

    fn journal() -> (tempfile::TempDir, PathBuf, Journal) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("history.sqlite");
        let mut journal = Journal::open(&path).unwrap();
        journal.look_at_file().unwrap();
        (folder, path, journal)
    }

    #[test]
    fn own_commits_and_readers_change_nothing() {
        let (_folder, path, mut journal) = journal();
        journal.let_go("by hand", 1.0).unwrap();
        let reader = Journal::open_to_read(&path).unwrap();
        assert_eq!(reader.waiting().unwrap(), 0);
        assert_eq!((journal.look_at_file(), check_file(&path)), (Ok(()), Ok(())));
    }

    #[test]
    fn a_file_that_is_removed_replaced_cut_or_written_by_others_is_named() {
        let (_one, path, mut removed) = journal();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(removed.look_at_file(), Err(JournalFault::Gone(path.clone())));
        std::fs::write(&path, vec![0; 1 << 20]).unwrap();
        assert_eq!(removed.look_at_file(), Err(JournalFault::Gone(path)));

        let (_two, path, mut cut) = journal();
        let to = path.metadata().unwrap().len() - 1;
        OpenOptions::new().write(true).open(&path).unwrap().set_len(to).unwrap();
        assert!(matches!(cut.look_at_file(), Err(JournalFault::Cut { to: now, .. }) if now == to));

        let (_three, path, mut changed) = journal();
        let other = Connection::open(&path).unwrap();
        other.execute("INSERT INTO rejections VALUES (9,'a','a','c','r',1.0,'s',0,0)", []).unwrap();
        assert_eq!(changed.look_at_file(), Err(JournalFault::Changed(path)));
    }

    #[test]
    fn a_damaged_journal_is_refused_at_the_start_and_found_beside_a_daemon() {
        let (_folder, path, journal) = journal();
        drop(journal);
        let mut bytes = std::fs::read(&path).unwrap();
        let length = bytes.len();
        bytes[length / 2..].fill(0x5a);
        std::fs::write(&path, bytes).unwrap();
        assert!(matches!(check_file(&path), Err(JournalFault::Damaged { .. })));
        let error = Journal::open(&path).expect_err("damaged");
        assert!(error.is_damage() && error.to_string().contains("`celld journal repair`"), "{error}");
    }
}
