//! Removes what the history's limits no longer keep: folders of ended jobs, refused files, their rows.
//!
//! In: the limits, the time. Out: how many went. A few at a time, files before rows: a crash in between
//! leaves a row whose files are gone, and the next call finishes it.

use crate::jobs::journal::Journal;
use crate::jobs::journal::old::HistoryLimits;
use crate::jobs::spool::{Spool, SpoolError};
use cell_edge::files::{FileError, remove};
use std::io;
use std::path::Path;

impl Spool {
    /// Removes a few ended jobs and refusals beyond the limits; how many. To be called again until none is
    /// left.
    ///
    /// # Errors
    /// A file or folder cannot be removed ([`SpoolError::Files`]), or the journal fails
    /// ([`SpoolError::Journal`]).
    pub fn remove_old(
        &mut self,
        journal: &mut Journal,
        limits: &HistoryLimits,
        unix_s: f64,
    ) -> Result<usize, SpoolError> {
        let (jobs, rejections) = (journal.old_jobs(limits, unix_s)?, journal.old_rejections(limits, unix_s)?);
        for job in &jobs {
            if let Some(folder) = &job.folder {
                remove_folder(&self.jobs.join(folder))?;
            }
            self.point()?;
            journal.forget_job(job.sequence)?;
        }
        for rejection in &rejections {
            for path in [self.rejected(&rejection.stored), self.reason_path(&rejection.stored)] {
                remove(&path)?;
            }
            self.point()?;
            journal.forget_rejection(rejection.sequence)?;
        }
        Ok(jobs.len() + rejections.len())
    }
}

/// Removes a folder with what is in it; one that is not there is fine. Links in it are removed, and what
/// they point to is not.
fn remove_folder(path: &Path) -> Result<(), FileError> {
    match std::fs::remove_dir_all(path) {
        Err(source) if source.kind() != io::ErrorKind::NotFound => {
            Err(FileError::Io { action: "remove", path: path.to_owned(), source })
        }
        _ => Ok(()),
    }
}
