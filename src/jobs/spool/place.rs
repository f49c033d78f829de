//! Brings files to where the journal says they belong; every function here may be repeated after a crash.
//!
//! In: journal rows that are not in place. Out: moved files. A file is recognised by its identity (device,
//! inode, size, time): a new file of the same name is left to the next scan.

use crate::jobs::journal::places::Placed;
use crate::jobs::journal::rows::source_text;
use crate::jobs::journal::{Journal, Rejection};
use crate::jobs::record::{JobRecord, JobState};
use crate::jobs::spool::{Spool, SpoolError};
use crate::jobs::utc;
use cell_edge::files::{FileError, create_folder, identify, rename_new, sync_folder, write_atomic};
use cell_machine::code::JobStatus;
use std::path::{Path, PathBuf};

impl Spool {
    /// Finishes what a crash cut short and moves folders after their jobs' states. Cheap when all is in
    /// place.
    ///
    /// # Errors
    /// A file or folder cannot be read, written or moved ([`SpoolError::Files`]), or the journal fails
    /// ([`SpoolError::Journal`]).
    pub fn reconcile(&mut self, journal: &mut Journal) -> Result<(), SpoolError> {
        for placed in journal.placed(false)? {
            self.place(journal, &placed)?;
        }
        for rejection in journal.unsettled_rejections()? {
            let path = self.find_incoming(&rejection.source)?;
            self.store_rejected(journal, &rejection, path.as_deref())?;
        }
        Ok(())
    }

    /// [`Spool::reconcile`], and besides a check of all unfinished jobs' folders against the journal: to be
    /// called once, at start. A folder that the journal does not know goes back to `incoming`.
    ///
    /// # Errors
    /// As [`Spool::reconcile`].
    pub fn reconcile_at_start(&mut self, journal: &mut Journal) -> Result<(), SpoolError> {
        self.reconcile(journal)?;
        for placed in journal.placed(true)? {
            if !matches!(placed.job.state, JobState::Ended(_)) {
                self.place(journal, &placed)?;
            }
        }
        for folder in ["hold", "active"] {
            for id in folders_in(&self.jobs.join(folder))? {
                if journal.job(&id)?.is_none() {
                    self.return_to_incoming(&self.jobs.join(folder).join(&id), &id)?;
                }
            }
        }
        Ok(())
    }

    /// The folder of a job, where there is one.
    ///
    /// # Errors
    /// The journal cannot be read ([`SpoolError::Journal`]).
    pub fn folder_of(&self, journal: &Journal, id: &str) -> Result<Option<PathBuf>, SpoolError> {
        let job = journal.job(id)?;
        Ok(job.map(|job| self.jobs.join(wanted_folder(&job))))
    }

    /// The folder in which the files of a job are now.
    ///
    /// # Errors
    /// As [`Spool::folder_of`].
    pub fn folder_now(&self, journal: &Journal, id: &str) -> Result<Option<PathBuf>, SpoolError> {
        Ok(journal.folder_of(id)?.map(|folder| self.jobs.join(folder)))
    }

    pub(super) fn place_new(
        &mut self,
        journal: &mut Journal,
        id: &str,
        path: &Path,
    ) -> Result<(), SpoolError> {
        let Some(job) = journal.job(id)? else { return Ok(()) };
        let target = self.jobs.join(wanted_folder(&job));
        let known = journal.source_of(id)?.unwrap_or_default();
        self.fill(&target, &job, Some((path, &known)))?;
        Ok(journal.set_place(&job, &wanted_folder(&job))?)
    }

    fn place(&mut self, journal: &mut Journal, placed: &Placed) -> Result<(), SpoolError> {
        let wanted = wanted_folder(&placed.job);
        let target = self.jobs.join(&wanted);
        let present = self.present_folder(placed, &target);
        let known = placed.source.as_deref().unwrap_or_default();
        let source = match &placed.source {
            Some(source) => self.find_incoming(source)?,
            None => None,
        };
        let source = source.as_deref().map(|path| (path, known));
        if let Some(present) = present.filter(|_| !target.exists()) {
            self.fill(&present, &placed.job, source)?;
            self.point()?;
            if let Some(month) = target.parent() {
                create_folder(month)?;
            }
            rename_new(&present, &target)?;
        } else {
            self.fill(&target, &placed.job, source)?;
        }
        self.point()?;
        Ok(journal.set_place(&placed.job, &wanted)?)
    }

    /// Where the job's files are, if not in `target`: a crash between a rename and its note in the journal
    /// leaves them one state ahead of what the journal remembers.
    fn present_folder(&self, placed: &Placed, target: &Path) -> Option<PathBuf> {
        let id = &placed.job.id;
        let candidates = [placed.folder.clone(), Some(format!("hold/{id}")), Some(format!("active/{id}"))];
        let paths = candidates.into_iter().flatten().map(|folder| self.jobs.join(folder));
        paths.into_iter().find(|path| path != target && path.exists())
    }

    /// Makes `folder` hold the job's file, and its result once it ended. The result comes before any rename
    /// into `done` or `failed`, so that an ended job is never seen without one. The file is written anew and
    /// not moved: one that belongs to whoever dropped it could be changed by them later.
    fn fill(&self, folder: &Path, job: &JobRecord, source: Option<(&Path, &str)>) -> Result<(), SpoolError> {
        create_folder(folder)?;
        self.point()?;
        let file = folder.join("job.yaml");
        let is_whole = std::fs::read(&file).ok().as_deref() == Some(job.text.as_bytes());
        if source.is_some() || !is_whole {
            write_atomic(&file, job.text.as_bytes())?;
            self.point()?;
        }
        // Another file may have come under that name meanwhile: it is not the one that was read.
        let is_it = |(path, known): &(&Path, &str)| {
            identify(path).is_ok_and(|(identity, _)| source_text(&identity) == *known)
        };
        if let Some((path, _)) = source.filter(is_it) {
            cell_edge::files::remove(path)?;
            self.point()?;
        }
        if let Some(result) = &job.result {
            write_atomic(&folder.join("result.yaml"), (result.to_yaml() + &job.times_yaml()).as_bytes())?;
        }
        Ok(())
    }

    /// The entry of `incoming` with this identity.
    fn find_incoming(&self, source: &str) -> Result<Option<PathBuf>, SpoolError> {
        let is_it = |path: &Path| identify(path).is_ok_and(|(identity, _)| source_text(&identity) == source);
        Ok(self.entries()?.into_iter().map(|entry| entry.path).find(|path| is_it(path)))
    }

    /// Writes the reason first, then moves the file beside it: never a refused file without a reason.
    pub(super) fn store_rejected(
        &self,
        journal: &mut Journal,
        rejection: &Rejection,
        path: Option<&Path>,
    ) -> Result<(), SpoolError> {
        write_atomic(&self.reason_path(&rejection.stored), rejection.reason.as_bytes())?;
        self.point()?;
        if let Some(path) = path.filter(|_| rejection.moves) {
            rename_new(path, &self.rejected(&rejection.stored))?;
            self.point()?;
        }
        Ok(journal.settle_rejection(rejection.sequence)?)
    }

    fn return_to_incoming(&self, folder: &Path, id: &str) -> Result<(), SpoolError> {
        let file = folder.join("job.yaml");
        if file.is_file() {
            match rename_new(&file, &self.incoming().join(format!("{id}.yaml"))) {
                Err(error) if error.is_present() => return Ok(()),
                other => other?,
            }
        }
        // Only an empty folder goes; whatever else was put there stays.
        if std::fs::remove_dir(folder).is_ok() {
            sync_folder(folder.parent().unwrap_or(folder))?;
        }
        Ok(())
    }
}

/// Folder below `jobs` in which a job's files belong.
fn wanted_folder(job: &JobRecord) -> String {
    let month = || utc::month(job.ended_unix_s.unwrap_or(job.claimed_unix_s));
    match job.state {
        JobState::Waiting => format!("hold/{}", job.id),
        JobState::Active => format!("active/{}", job.id),
        JobState::Ended(JobStatus::Done) => format!("done/{}/{}", month(), job.id),
        JobState::Ended(JobStatus::Failed | JobStatus::Cancelled | JobStatus::Interrupted) => {
            format!("failed/{}/{}", month(), job.id)
        }
    }
}

fn folders_in(path: &Path) -> Result<Vec<String>, SpoolError> {
    let fail = |source| FileError::Io { action: "list", path: path.to_owned(), source };
    let mut names = Vec::new();
    for entry in std::fs::read_dir(path).map_err(fail)? {
        let entry = entry.map_err(fail)?;
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    names.sort();
    Ok(names)
}
