//! One look into `incoming`: watch, read, claim or refuse.
//!
//! In: the folder, the journal, the reader of job files, the time. Out: events. A file that changes while it
//! is read is watched again; a file that cannot be handled stays and is reported once.

use crate::jobs::journal::places::NewRejection;
use crate::jobs::journal::{Claim, Journal, NewJob};
use crate::jobs::spool::names::{id_of_file, is_plain_name, is_unfinished_name, plain_name};
use crate::jobs::spool::{ReadJob, Refusal, Spool, SpoolError, SpoolEvent, Watched};
use cell_edge::files::{FileError, FileIdentity, Unfit, identify, read_regular, remove};
use cell_machine::code::Code;
use cell_values::time::{Duration, Timestamp};
use sha2::{Digest, Sha256};
use std::path::PathBuf;

/// An entry of `incoming`. `name` is for people and records; `path` may hold bytes that are not text.
#[derive(Debug)]
pub(super) struct Entry {
    pub name: String,
    pub path: PathBuf,
}

/// A round through `incoming` that lasts longer begins anew: a cancellation must not wait for ten thousand
/// files.
const RELIST: Duration = Duration::from_secs(1);

/// Cancellations are no jobs, and need no room.
fn is_cancel(entry: &Entry) -> bool {
    entry.name.ends_with(".cancel")
}

/// Time and reader, passed down together.
struct Round<'a> {
    read: &'a ReadJob<'a>,
    now: Timestamp,
    unix_s: f64,
}

impl Spool {
    /// Looks into `incoming`: at as many entries as the settings allow for one call, going on where the last
    /// one ended. To be called at start, every few seconds, when something hints at news, and again at once
    /// while [`Spool::has_more`].
    ///
    /// `now` is the daemon's clock and counts the settle time; `unix_s` dates names and records.
    ///
    /// # Errors
    /// When the folders or the journal fail; a bad file is an event.
    pub fn scan(
        &mut self,
        journal: &mut Journal,
        read: &ReadJob,
        now: Timestamp,
        unix_s: f64,
    ) -> Result<Vec<SpoolEvent>, SpoolError> {
        if self.listing.is_empty() || now.since(self.listed) >= RELIST {
            self.list(now)?;
        }
        let full = self.full && journal.waiting()? >= self.settings.queue_limit;
        let round = Round { read, now, unix_s };
        let mut events = Vec::new();
        for _ in 0..self.settings.entries_at_once {
            if events.len() >= self.settings.at_once {
                break;
            }
            let Some(entry) = self.listing.pop_front() else { break };
            self.last_name.clone_from(&entry.name);
            if full && !is_cancel(&entry) {
                // Nothing is read before there is room.
                self.listing.clear();
                break;
            }
            match self.consider(journal, &entry, &round) {
                Ok(event) => events.extend(event),
                Err(SpoolError::Files(error)) if error.is_absent() => {}
                Err(SpoolError::Files(error)) => events.extend(self.unreadable(&entry, &error)),
                Err(error) => return Err(error),
            }
        }
        Ok(events)
    }

    /// True while the last look into `incoming` has not come to its end.
    pub fn has_more(&self) -> bool {
        !self.listing.is_empty()
    }

    /// Lists `incoming` anew: cancellations first, then what comes after the entry that was considered last,
    /// so that many files that stay keep no other from its turn.
    fn list(&mut self, now: Timestamp) -> Result<(), SpoolError> {
        let mut entries = self.entries()?;
        let is_there = |name: &String| entries.binary_search_by(|entry| entry.name.cmp(name)).is_ok();
        self.watched.retain(|name, _| is_there(name));
        self.unreadable_names.retain(|name| is_there(name));
        let next = match self.listing.is_empty() {
            true => 0,
            false => entries.partition_point(|entry| entry.name <= self.last_name),
        };
        entries.rotate_left(next);
        entries.sort_by_key(|entry| !is_cancel(entry));
        (self.listing, self.listed) = (entries.into(), now);
        Ok(())
    }

    /// Entries of `incoming` that are not left alone, by name.
    pub(super) fn entries(&self) -> Result<Vec<Entry>, SpoolError> {
        let incoming = self.incoming();
        let fail = |source| FileError::Io { action: "list", path: incoming.clone(), source };
        let mut entries = Vec::new();
        for entry in std::fs::read_dir(&incoming).map_err(fail)? {
            let entry = entry.map_err(fail)?;
            let name = entry.file_name().to_string_lossy().into_owned();
            if !is_unfinished_name(&name) {
                entries.push(Entry { name, path: entry.path() });
            }
        }
        entries.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(entries)
    }

    /// How many files of `incoming` are neither claimed nor refused yet.
    ///
    /// # Errors
    /// The folder cannot be listed.
    pub fn unread(&self) -> Result<usize, SpoolError> {
        self.entries().map(|entries| entries.len())
    }

    fn unreadable(&mut self, entry: &Entry, error: &FileError) -> Option<SpoolEvent> {
        let cause = std::error::Error::source(error).map(|cause| format!(": {cause}")).unwrap_or_default();
        let first = self.unreadable_names.insert(entry.name.clone());
        let name = entry.name.clone();
        first.then(|| SpoolEvent::Unreadable { name, message: format!("{error}{cause}") })
    }

    fn consider(
        &mut self,
        journal: &mut Journal,
        entry: &Entry,
        round: &Round,
    ) -> Result<Option<SpoolEvent>, SpoolError> {
        let (mut identity, regular) = identify(&entry.path)?;
        if !regular {
            // A folder changes its size and time with its content and is still the same one.
            identity = FileIdentity { size: 0, modified_ns: 0, ..identity };
        }
        if regular && !self.has_settled(&entry.name, identity, round.now) {
            return Ok(None);
        }
        if let Some(id) = journal.claim_of(&identity)? {
            self.place_new(journal, &id, &entry.path)?;
            return Ok(None);
        }
        if let Some(rejection) = journal.rejection_of(&identity)? {
            if rejection.moves {
                self.store_rejected(journal, &rejection, Some(&entry.path))?;
            }
            return Ok(None);
        }
        if !regular {
            return self.refuse_unfit(journal, entry, &identity, Unfit::NotRegular, round).map(Some);
        }
        self.take(journal, entry, identity, round)
    }

    /// Starts watching a new or changed file; true once it has not changed for the settle time.
    fn has_settled(&mut self, name: &str, identity: FileIdentity, now: Timestamp) -> bool {
        let watched = self.watched.entry(name.to_owned()).or_insert(Watched { identity, since: now });
        if watched.identity != identity {
            *watched = Watched { identity, since: now };
        }
        now.since(watched.since) >= self.settings.settle
    }

    fn take(
        &mut self,
        journal: &mut Journal,
        entry: &Entry,
        identity: FileIdentity,
        round: &Round,
    ) -> Result<Option<SpoolEvent>, SpoolError> {
        if let Some(id) = entry.name.strip_suffix(".cancel") {
            remove(&entry.path)?;
            return Ok(Some(SpoolEvent::Cancel { id: id.to_owned() }));
        }
        // Not read before there is room: nothing would come of it, again and again.
        if self.full && journal.waiting()? >= self.settings.queue_limit {
            return Ok(None);
        }
        let text = match read_regular(&entry.path, self.settings.max_bytes) {
            Ok((_, read)) if read != identity => return Ok(None),
            Ok((text, _)) => text,
            Err(FileError::Unfit { problem, .. }) => {
                return self.refuse_unfit(journal, entry, &identity, problem, round).map(Some);
            }
            Err(error) => return Err(error.into()),
        };
        let sha256 = hex(&Sha256::digest(text.as_bytes()));
        if !is_plain_name(&entry.name) {
            let refusal = Refusal::new(
                Code::BadName,
                "file names of jobs have 1 to 80 letters, digits, dots, dashes and underscores",
                "rename the file",
            );
            return self.refuse(journal, entry, &identity, &refusal, Some(&sha256), round).map(Some);
        }
        match (round.read)(&text, &entry.name) {
            Err(refusal) if refusal.incomplete && self.may_grow(&entry.name, round.now) => Ok(None),
            Err(mut refusal) => {
                if refusal.incomplete {
                    refusal.code = Code::Incomplete;
                }
                self.refuse(journal, entry, &identity, &refusal, Some(&sha256), round).map(Some)
            }
            Ok(spec) => self.claim(journal, entry, identity, (&text, &sha256), &spec, round),
        }
    }

    fn may_grow(&self, name: &str, now: Timestamp) -> bool {
        self.watched.get(name).is_some_and(|watched| now.since(watched.since) < self.settings.incomplete)
    }

    fn claim(
        &mut self,
        journal: &mut Journal,
        entry: &Entry,
        source: FileIdentity,
        (text, sha256): (&str, &str),
        spec: &crate::jobs::record::JobSpec,
        round: &Round,
    ) -> Result<Option<SpoolEvent>, SpoolError> {
        if journal.waiting()? >= self.settings.queue_limit {
            let first = !self.full;
            self.full = true;
            return Ok(first.then(|| SpoolEvent::Full { name: entry.name.clone() }));
        }
        self.full = false;
        let made = id_of_file(&entry.name, sha256, round.unix_s);
        let id = spec.id.as_deref().unwrap_or(&made);
        self.point()?;
        let job = NewJob { id, name: &entry.name, sha256, text, spec, source };
        let refusal = match journal.claim(&job, round.unix_s)? {
            Claim::Claimed { id } => {
                self.point()?;
                self.place_new(journal, &id, &entry.path)?;
                return Ok(Some(SpoolEvent::Claimed { id, name: entry.name.clone() }));
            }
            Claim::Duplicate { of } => self.duplicate(journal, &of)?,
            Claim::Conflict { with } => Refusal::new(
                Code::IdConflict,
                format!("another job is known as {with:?}, with other content"),
                "give the job an id of its own, or none",
            ),
        };
        self.refuse(journal, entry, &source, &refusal, Some(sha256), round).map(Some)
    }

    fn duplicate(&self, journal: &Journal, of: &str) -> Result<Refusal, SpoolError> {
        let folder = self.folder_of(journal, of)?.unwrap_or_default();
        Ok(Refusal::new(
            Code::Duplicate,
            format!("job {of:?} with this content is known already; see {}", folder.display()),
            "nothing to do if this was a repeated submission; to run it again add `rerun: true`",
        ))
    }

    fn refuse_unfit(
        &mut self,
        journal: &mut Journal,
        entry: &Entry,
        identity: &FileIdentity,
        problem: Unfit,
        round: &Round,
    ) -> Result<SpoolEvent, SpoolError> {
        let code = match problem {
            Unfit::NotRegular | Unfit::HardLinked(_) => Code::NotAPlainFile,
            Unfit::TooLarge(_) => Code::TooLarge,
            Unfit::NotText => Code::NotText,
        };
        let refusal = Refusal::new(code, problem.to_string(), "copy the job's text into a new file here");
        self.refuse(journal, entry, identity, &refusal, None, round)
    }

    fn refuse(
        &mut self,
        journal: &mut Journal,
        entry: &Entry,
        identity: &FileIdentity,
        refusal: &Refusal,
        sha256: Option<&str>,
        round: &Round,
    ) -> Result<SpoolEvent, SpoolError> {
        self.point()?;
        let stored = self.free_rejected_name(journal, &entry.name)?;
        let reason = refusal.to_yaml(&entry.name, sha256, round.unix_s);
        let new = NewRejection {
            name: &entry.name,
            stored: &stored,
            code: refusal.code.as_str(),
            reason: &reason,
            moves: refusal.code != Code::NotAPlainFile,
            source: identity,
        };
        journal.reject(&new, round.unix_s)?;
        self.point()?;
        if let Some(rejection) = journal.rejection_of(identity)? {
            self.store_rejected(journal, &rejection, Some(&entry.path))?;
        }
        Ok(SpoolEvent::Rejected {
            name: entry.name.clone(),
            code: refusal.code,
            message: refusal.message.clone(),
            reason: self.reason_path(&stored),
        })
    }

    /// `name` made plain, with a number before its extension if that name is taken in `rejected`.
    fn free_rejected_name(&self, journal: &Journal, name: &str) -> Result<String, SpoolError> {
        let plain = plain_name(name);
        let (stem, extension) = match plain.rsplit_once('.') {
            Some((stem, extension)) if !stem.is_empty() => (stem.to_owned(), format!(".{extension}")),
            _ => (plain.clone(), String::new()),
        };
        let mut candidate = plain;
        let mut number = 2_u32;
        while journal.is_stored(&candidate)? || self.rejected(&candidate).symlink_metadata().is_ok() {
            candidate = format!("{stem}.{number}{extension}");
            number += 1;
        }
        Ok(candidate)
    }

    pub(super) fn rejected(&self, stored: &str) -> PathBuf {
        self.jobs.join("rejected").join(stored)
    }

    pub(super) fn reason_path(&self, stored: &str) -> PathBuf {
        self.rejected(&format!("{stored}.reason.yaml"))
    }
}

/// Lower-case hex.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
