//! The folders in which people see and drop jobs, kept in line with the journal.
//!
//! In: `STATE/jobs/incoming` and the journal. Out: claims and refusals as [`SpoolEvent`]s, and every file in
//! the folder its job's state requires: `hold` (accepted, not begun), `active`, `done/<month>`,
//! `failed/<month>`, `rejected`. Order of work, always: the journal commits first, then files move, then the
//! journal notes that they are in place. A crash between any two of these leaves work that
//! [`Spool::reconcile`] finishes; a file may then be in two places, and never in none. Change notifications
//! are not needed: the folder is scanned, because notifications get lost.
//! Rules: a file is taken when it has not changed for a settle time; links, FIFOs, folders and files with a
//! second name are never opened and stay where they are; nothing is ever overwritten.

mod names;
mod old;
mod place;
mod scan;
#[cfg(test)]
mod tests;

use crate::jobs::journal::JournalError;
use crate::jobs::record::{JobSpec, quoted};
use crate::jobs::utc;
use cell_edge::files::{FileError, create_folder};
use cell_machine::code::Code;
use cell_values::time::{Duration, Timestamp};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt::Write as _;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

pub use crate::jobs::spool::names::{id_of_file, is_plain_name};

/// Folders below `STATE/jobs`.
pub const FOLDERS: [&str; 6] = ["incoming", "hold", "active", "done", "failed", "rejected"];

/// Why the spool stopped working. A single bad file is never a reason.
#[derive(Debug, thiserror::Error)]
pub enum SpoolError {
    /// A folder or file of ours.
    #[error("job folders")]
    Files(#[from] FileError),
    /// The database.
    #[error("job journal")]
    Journal(#[from] JournalError),
    /// Folders on different file systems cannot exchange files by rename.
    #[error(
        "{path} is on another file system than its neighbours: moving a job there could lose it; put the \
         whole state folder on one file system"
    )]
    OtherFileSystem {
        /// The folder.
        path: PathBuf,
    },
    /// Only in tests: the process "ended" here.
    #[cfg(test)]
    #[error("crash")]
    Crash,
}

/// How patient and how wide the spool is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SpoolSettings {
    /// A file that has not changed for so long is taken.
    pub settle: Duration,
    /// A file that ends in the middle of something is given so long before it is refused.
    pub incomplete: Duration,
    /// Larger files are refused unread.
    pub max_bytes: u64,
    /// Files taken in or refused in one look: each costs several syncs of the disk.
    pub at_once: usize,
    /// Entries looked at in one call, most of which only wait for their settle time.
    pub entries_at_once: usize,
    /// With so many jobs waiting, further files stay in `incoming`.
    pub queue_limit: u32,
}

impl SpoolSettings {
    /// The protocol's figures.
    pub const STANDARD: SpoolSettings = SpoolSettings {
        settle: Duration::from_millis(500),
        incomplete: Duration::from_secs(2),
        max_bytes: 256 * 1024,
        at_once: usize::MAX,
        entries_at_once: usize::MAX,
        queue_limit: 64,
    };
}

/// What the reader of job files says about a file it does not accept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// For programs.
    pub code: Code,
    /// One sentence.
    pub message: String,
    /// What to do.
    pub hint: String,
    /// Each single complaint.
    pub complaints: Vec<RefusalDetail>,
    /// The text ends in the middle of something: perhaps it is still being copied.
    pub incomplete: bool,
}

/// One complaint about one place of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RefusalDetail {
    /// Key path, as `goal.objects[2].id`.
    pub path: String,
    /// From 1.
    pub line: u32,
    /// From 1.
    pub column: u32,
    /// What is wrong.
    pub message: String,
    /// What to change; may be empty.
    pub help: String,
}

impl Refusal {
    /// A refusal without places.
    pub fn new(code: Code, message: impl Into<String>, hint: impl Into<String>) -> Refusal {
        Refusal {
            code,
            message: message.into(),
            hint: hint.into(),
            complaints: Vec::new(),
            incomplete: false,
        }
    }

    fn to_yaml(&self, name: &str, sha256: Option<&str>, unix_s: f64) -> String {
        let mut yaml = format!(
            "version: 1\ncode: {}\nmessage: {}\nhint: {}\nfile: {}\n",
            quoted(self.code.as_str()),
            quoted(&self.message),
            quoted(&self.hint),
            quoted(name)
        );
        if let Some(sha256) = sha256 {
            let _ = writeln!(yaml, "sha256: {}", quoted(sha256));
        }
        let _ = writeln!(yaml, "time: {}", quoted(&utc::text(unix_s)));
        let _ = writeln!(yaml, "celld: {}", quoted(env!("CARGO_PKG_VERSION")));
        if self.complaints.is_empty() {
            yaml.push_str("complaints: []\n");
            return yaml;
        }
        yaml.push_str("complaints:\n");
        for detail in &self.complaints {
            let _ = writeln!(
                yaml,
                "  - {{path: {}, line: {}, column: {}, message: {}, help: {}}}",
                quoted(&detail.path),
                detail.line,
                detail.column,
                quoted(&detail.message),
                quoted(&detail.help)
            );
        }
        yaml
    }
}

/// Reads the text of a job file (second argument: its name) into what it requests.
pub type ReadJob<'a> = dyn Fn(&str, &str) -> Result<JobSpec, Refusal> + 'a;

/// What a scan found.
#[derive(Clone, Debug, PartialEq)]
pub enum SpoolEvent {
    /// A new job waits.
    Claimed {
        /// Its id.
        id: String,
        /// Its file's name.
        name: String,
    },
    /// A file was refused; file and reason are in `rejected`, or the file stayed if it is no plain file.
    Rejected {
        /// Name in `incoming`.
        name: String,
        /// Constant for programs.
        code: Code,
        /// One sentence.
        message: String,
        /// The reason file.
        reason: PathBuf,
    },
    /// `<id>.cancel` was dropped.
    Cancel {
        /// The job.
        id: String,
    },
    /// The queue is full; `name` and what follows stay in `incoming`. Reported once until there is room.
    Full {
        /// First file that has to wait.
        name: String,
    },
    /// A file could not be handled; it stays and is tried again.
    Unreadable {
        /// Name in `incoming`.
        name: String,
        /// What happened.
        message: String,
    },
}

/// A file that is being watched until it stops changing.
#[derive(Clone, Copy, Debug)]
struct Watched {
    identity: cell_edge::files::FileIdentity,
    since: Timestamp,
}

/// The spool folders of one state folder. The caller holds the state folder's lock.
#[derive(Debug)]
pub struct Spool {
    jobs: PathBuf,
    settings: SpoolSettings,
    watched: BTreeMap<String, Watched>,
    unreadable_names: BTreeSet<String>,
    full: bool,
    /// What is still to be considered of the last listing of `incoming`.
    listing: VecDeque<scan::Entry>,
    listed: Timestamp,
    /// Considered last.
    last_name: String,
    #[cfg(test)]
    crash_after: std::cell::Cell<Option<u32>>,
}

impl Spool {
    /// Opens (and creates) the folders below `state/jobs`.
    ///
    /// # Errors
    /// A folder cannot be created ([`SpoolError::Files`]) or is on another file system
    /// ([`SpoolError::OtherFileSystem`]).
    pub fn open(state: &Path, settings: SpoolSettings) -> Result<Spool, SpoolError> {
        let jobs = state.join("jobs");
        for folder in FOLDERS {
            create_folder(&jobs.join(folder))?;
        }
        let spool = Spool {
            jobs,
            settings,
            watched: BTreeMap::new(),
            unreadable_names: BTreeSet::new(),
            full: false,
            listing: VecDeque::new(),
            listed: Timestamp::ZERO,
            last_name: String::new(),
            #[cfg(test)]
            crash_after: std::cell::Cell::new(None),
        };
        spool.check_file_system()?;
        Ok(spool)
    }

    fn check_file_system(&self) -> Result<(), SpoolError> {
        let device = |path: &Path| path.metadata().map(|metadata| metadata.dev()).ok();
        let home = device(&self.jobs);
        match FOLDERS.iter().map(|folder| self.jobs.join(folder)).find(|path| device(path) != home) {
            Some(path) => Err(SpoolError::OtherFileSystem { path }),
            None => Ok(()),
        }
    }

    /// The folder `STATE/jobs/incoming`.
    pub fn incoming(&self) -> PathBuf {
        self.jobs.join("incoming")
    }

    /// A place where a crash is simulated in tests; nothing otherwise.
    fn point(&self) -> Result<(), SpoolError> {
        #[cfg(test)]
        if let Some(left) = self.crash_after.get() {
            if left == 0 {
                return Err(SpoolError::Crash);
            }
            self.crash_after.set(Some(left - 1));
        }
        Ok(())
    }
}
