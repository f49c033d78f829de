//! Layout of the state folder, through which the daemon and its commands find each other.
//!
//! In: the folder given with `--state`. Out: the paths below it, and the lock that makes the daemon the only
//! one. The lock is the kernel's and ends with the process, however it ends: there is no stale lock.

use cell_edge::files::{FileError, FileLock, create_folder};
use std::path::{Path, PathBuf};

/// Paths below one state folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StateFolder {
    root: PathBuf,
}

/// Why the state folder could not be had.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// Another daemon works on it.
    #[error(
        "another celld runs on the state folder {path}; `celld status --state {path}` asks it, or give this one a folder of its own"
    )]
    Taken {
        /// The folder.
        path: PathBuf,
    },
    /// The system refused.
    #[error("state folder")]
    Files(#[from] FileError),
}

impl StateFolder {
    /// The folder at `root`; nothing is created yet.
    pub fn new(root: impl Into<PathBuf>) -> StateFolder {
        StateFolder { root: root.into() }
    }

    /// The folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The journal database.
    pub fn journal(&self) -> PathBuf {
        self.root.join("history.sqlite")
    }

    /// Where job files are dropped.
    pub fn incoming(&self) -> PathBuf {
        self.root.join("jobs/incoming")
    }

    /// Where commands are left for the daemon.
    pub fn commands(&self) -> PathBuf {
        self.root.join("commands")
    }

    /// What the daemon says about itself.
    pub fn status(&self) -> PathBuf {
        self.root.join("status.json")
    }

    /// Held by the daemon.
    pub fn lock_file(&self) -> PathBuf {
        self.root.join("lock")
    }

    /// Takes the folder for this process, creating it where needed.
    ///
    /// # Errors
    /// [`StateError::Taken`] while another daemon holds it.
    pub fn take(&self) -> Result<FileLock, StateError> {
        create_folder(&self.root)?;
        create_folder(&self.commands())?;
        let note = format!("{}\n", std::process::id());
        FileLock::take(&self.lock_file(), &note)?.ok_or_else(|| StateError::Taken { path: self.root.clone() })
    }

    /// True while a daemon holds the folder.
    ///
    /// # Errors
    /// The lock file is present, but the system refuses to open it or to try the lock
    /// ([`StateError::Files`]).
    pub fn is_taken(&self) -> Result<bool, StateError> {
        Ok(FileLock::is_held(&self.lock_file())?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_daemon_is_turned_away_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path().join("state"));
        assert!(!state.is_taken().unwrap());
        let lock = state.take().unwrap();
        assert!(state.is_taken().unwrap());
        let error = state.take().unwrap_err();
        assert!(matches!(&error, StateError::Taken { path } if path == state.root()), "{error}");
        drop(lock);
        state.take().unwrap();
    }
}
