//! Layout of the state folder, through which the daemon and its commands find each other.
//!
//! In: the folder given with `--state`. Out: the paths below it, and the lock that makes the daemon the only
//! one. The lock is the kernel's and ends with the process, however it ends: there is no stale lock.

use crate::jobs::status::Status;
use crate::jobs::utc;
use cell_edge::file_lock::FileLock;
use cell_edge::files::{
    FileError, create_folder, create_group_folder, read_regular, remove, remove_drafts, write_atomic,
};
use cell_machine::orders::ConfirmedGripper;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A draft of this age in a folder that people write into was left by a process that is gone.
const LEFT_FOR: Duration = Duration::from_secs(3600);

/// Paths below one state folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StateFolder {
    root: PathBuf,
}

/// What is in the file about the gripper.
#[derive(Serialize, Deserialize)]
struct Confirmed {
    address: String,
    /// Its serial number, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    serial: Option<String>,
    /// When, UTC.
    confirmed: String,
}

/// Why the state folder could not be had.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// Another daemon works on it.
    #[error(
        "another celld runs on the state folder {path}; `celld status --state {path}` shows its state, or give this \
         one a folder of its own"
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

    /// Which gripper a person has confirmed.
    pub fn gripper(&self) -> PathBuf {
        self.root.join("gripper.json")
    }

    /// Remembers which gripper a person has confirmed, at `address`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn confirm_gripper(
        &self,
        address: &str,
        gripper: &ConfirmedGripper,
        unix_s: f64,
    ) -> Result<(), FileError> {
        let serial = match gripper {
            ConfirmedGripper::Serial(serial) => Some(serial.clone()),
            ConfirmedGripper::None | ConfirmedGripper::NotNeeded | ConfirmedGripper::AtAddress => None,
        };
        let confirmed = Confirmed { address: address.to_string(), serial, confirmed: utc::text(unix_s) };
        let text = serde_json::to_string(&confirmed).expect("text has string keys only");
        write_atomic(&self.gripper(), text.as_bytes())
    }

    /// Which gripper a person has confirmed. One without a serial number is known by its `address`: another
    /// address or unit is another device. A file that cannot be read confirms nothing.
    pub fn confirmed_gripper(&self, address: &str) -> ConfirmedGripper {
        let text = read_regular(&self.gripper(), 4096).map(|(text, _)| text).unwrap_or_default();
        match serde_json::from_str::<Confirmed>(&text) {
            Ok(Confirmed { serial: Some(serial), .. }) => ConfirmedGripper::Serial(serial),
            Ok(confirmed) if confirmed.address == address => ConfirmedGripper::AtAddress,
            Ok(_) | Err(_) => ConfirmedGripper::None,
        }
    }

    /// Held by the daemon.
    pub fn lock_file(&self) -> PathBuf {
        self.root.join("lock")
    }

    /// Takes the folder for this process, creating it where needed. `first` takes the place of the status
    /// that an earlier daemon left: with the lock held that would read as one of now, an armed cell perhaps.
    ///
    /// # Errors
    /// [`StateError::Taken`] while another daemon holds it.
    pub fn take(&self, first: &Status) -> Result<FileLock, StateError> {
        create_folder(&self.root)?;
        create_group_folder(&self.root, &self.commands())?;
        create_folder(&self.root.join("jobs"))?;
        create_group_folder(&self.root, &self.incoming())?;
        let note = format!("{}\n", std::process::id());
        let taken = || StateError::Taken { path: self.root.clone() };
        let lock = FileLock::take(&self.lock_file(), &note)?.ok_or_else(taken)?;
        if first.write(&self.status()).is_err() {
            // A full disk still lets a file go; what it says of its own is named by what needs it.
            remove(&self.status())?;
        }
        remove_drafts(&self.root, Duration::ZERO)?;
        for folder in [self.commands(), self.incoming()] {
            remove_drafts(&folder, LEFT_FOR)?;
        }
        Ok(lock)
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
    fn a_gripper_is_known_by_its_serial_number_and_without_one_by_its_address() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        let (one, other) = ("10.0.0.3:502, unit 65", "10.0.0.3:502, unit 66");
        assert_eq!(state.confirmed_gripper(one), ConfirmedGripper::None);
        state.confirm_gripper(one, &ConfirmedGripper::AtAddress, 1.8e9).unwrap();
        assert_eq!(state.confirmed_gripper(one), ConfirmedGripper::AtAddress);
        assert_eq!(state.confirmed_gripper(other), ConfirmedGripper::None);
        let serial = ConfirmedGripper::Serial("VG-0815".into());
        state.confirm_gripper(one, &serial, 1.8e9).unwrap();
        assert_eq!([one, other].map(|address| state.confirmed_gripper(address)), [serial.clone(), serial]);
        std::fs::write(state.gripper(), "{").unwrap();
        assert_eq!(state.confirmed_gripper(one), ConfirmedGripper::None);
    }

    #[test]
    fn a_second_daemon_is_turned_away_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path().join("state"));
        assert!(!state.is_taken().unwrap());
        let lock = state.take(&Status::default()).unwrap();
        assert!(state.is_taken().unwrap());
        let error = state.take(&Status::default()).unwrap_err();
        assert!(matches!(&error, StateError::Taken { path } if path == state.root()), "{error}");
        drop(lock);
        state.take(&Status::default()).unwrap();
    }

    #[test]
    fn what_an_earlier_daemon_said_is_gone_with_the_lock_in_other_hands() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        let said = |state: &StateFolder| Status::read(&state.status()).unwrap().unwrap();
        let first = |name: &str| Status::starting(name.into(), 1.0, 1.0, "celld starts".into());
        let lock = state.take(&first("d1")).unwrap();
        Status { armed: true, state: "working".into(), ..first("d1") }.write(&state.status()).unwrap();
        state.take(&first("d2")).unwrap_err();
        assert!(said(&state).armed, "who is turned away changes nothing");
        drop(lock);
        let _lock = state.take(&first("d2")).unwrap();
        assert_eq!(said(&state), first("d2"));
    }
}
