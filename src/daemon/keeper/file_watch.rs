//! Watches the journal's file while celld runs.
//!
//! In: the journal, whether a job is active. Out: once, why the journal cannot be used any more. Its name,
//! inode and length are looked at with every commit and five times a second; all its pages are checked every
//! hour while no job is active, on a thread and a connection of their own, so that no commit waits.

use crate::jobs::journal::Journal;
use crate::jobs::journal::watch::check_file;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How often all pages are checked.
const PAGES_EVERY: Duration = Duration::from_secs(3600);

/// See the module.
#[derive(Debug)]
pub(super) struct FileWatch {
    path: PathBuf,
    pages: Arc<Mutex<Option<String>>>,
    checked: Instant,
    lost: Option<String>,
    reported: bool,
}

impl FileWatch {
    /// Of the journal at `path`, whose pages were checked when it was opened.
    pub(super) fn new(path: PathBuf) -> FileWatch {
        FileWatch { path, pages: Arc::default(), checked: Instant::now(), lost: None, reported: false }
    }

    /// The journal cannot be used any more.
    pub(super) fn is_lost(&self) -> bool {
        self.lost.is_some()
    }

    /// Why the journal cannot be used any more, if so.
    pub(super) fn look(&mut self, journal: &mut Journal) -> Option<String> {
        if self.lost.is_none() {
            let pages = self.pages.lock().unwrap_or_else(PoisonError::into_inner).take();
            self.lost = pages.or_else(|| journal.look_at_file().err().map(|fault| fault.to_string()));
        }
        self.lost.clone()
    }

    /// The same, once.
    pub(super) fn fault(&mut self, journal: &mut Journal, idle: bool) -> Option<String> {
        if idle && self.checked.elapsed() >= PAGES_EVERY {
            self.checked = Instant::now();
            let (path, found) = (self.path.clone(), Arc::clone(&self.pages));
            std::thread::spawn(move || {
                if let Err(fault) = check_file(&path) {
                    *found.lock().unwrap_or_else(PoisonError::into_inner) = Some(fault.to_string());
                }
            });
        }
        let lost = self.look(journal)?;
        (!std::mem::replace(&mut self.reported, true)).then_some(lost)
    }
}
