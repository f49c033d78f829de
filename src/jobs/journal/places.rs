//! Where the files of jobs are, and which files were refused: the columns that the spool works with; and
//! what has happened to jobs since a reader's last look.
//!
//! In: places and refusals. Out: what is not yet in its place, what is new. A place is written here after
//! the file got there; after a crash in between, both are found and the work is finished (`jobs::spool`).

use crate::jobs::journal::rows::source_text;
use crate::jobs::journal::{Journal, JournalError, Rejection};
use crate::jobs::record::JobRecord;
use cell_edge::files::FileIdentity;
use rusqlite::{OptionalExtension, Row, params};
use std::collections::BTreeSet;

/// A job with the places of its files.
#[derive(Clone, Debug)]
pub(in crate::jobs) struct Placed {
    /// The job.
    pub job: JobRecord,
    /// Identity text of the file in `incoming`, while that may still be there.
    pub source: Option<String>,
    /// Folder below `jobs`, once there is one.
    pub folder: Option<String>,
}

/// Jobs that a reader who follows the journal looks at.
#[derive(Clone, Debug, Default)]
pub struct Since {
    /// Those that have not ended.
    pub open: BTreeSet<String>,
    /// Those that were claimed since, whether they have ended or not.
    pub newer: Vec<String>,
    /// Order of arrival of the last job that there is; 0 without any.
    pub last: i64,
}

/// A refusal about to be written down.
#[derive(Clone, Debug)]
pub(in crate::jobs) struct NewRejection<'a> {
    pub name: &'a str,
    pub stored: &'a str,
    pub code: &'a str,
    pub reason: &'a str,
    pub moves: bool,
    pub source: &'a FileIdentity,
}

impl Journal {
    /// Jobs with the places of their files, in the order of arrival; with `all`, also those at rest.
    pub(in crate::jobs) fn placed(&self, all: bool) -> Result<Vec<Placed>, JournalError> {
        let filter = if all { "" } else { "WHERE placed_as IS NOT state OR source IS NOT NULL" };
        let jobs = self.select(&format!("{filter} ORDER BY sequence"), params![])?;
        jobs.into_iter().map(|job| self.placed_one(job)).collect()
    }

    fn placed_one(&self, job: JobRecord) -> Result<Placed, JournalError> {
        let (source, folder) = self
            .database
            .query_row("SELECT source, folder FROM jobs WHERE id = ?1", [&job.id], |row| {
                Ok((row.get(0)?, row.get(1)?))
            })
            .map_err(|e| self.fail(e))?;
        Ok(Placed { job, source, folder })
    }

    /// The folder of a job below `jobs`, once there is one.
    ///
    /// # Errors
    /// SQLite fails ([`JournalError::Database`]).
    pub fn folder_of(&self, id: &str) -> Result<Option<String>, JournalError> {
        let select = "SELECT folder FROM jobs WHERE id = ?1";
        let row = self.database.query_row(select, [id], |row| row.get(0)).optional();
        row.map(Option::flatten).map_err(|e| self.fail(e))
    }

    /// Identity text of the file in `incoming` that a job was claimed from, while that may still be there.
    pub(in crate::jobs) fn source_of(&self, id: &str) -> Result<Option<String>, JournalError> {
        let select = "SELECT source FROM jobs WHERE id = ?1";
        let row = self.database.query_row(select, [id], |row| row.get(0)).optional();
        row.map(Option::flatten).map_err(|e| self.fail(e))
    }

    /// Notes that a job's files are in `folder`, as its state wants, and no longer in `incoming`.
    pub(in crate::jobs) fn set_place(&mut self, job: &JobRecord, folder: &str) -> Result<(), JournalError> {
        let update = "UPDATE jobs SET folder = ?2, placed_as = ?3, source = NULL WHERE id = ?1";
        self.transact(|transaction| {
            transaction.execute(update, params![job.id, folder, job.state.as_str()])
        })?;
        Ok(())
    }

    /// The job that was claimed from this very file and whose file is not in its place yet.
    pub(in crate::jobs) fn claim_of(&self, source: &FileIdentity) -> Result<Option<String>, JournalError> {
        let select = "SELECT id FROM jobs WHERE source = ?1";
        self.database
            .query_row(select, [source_text(source)], |row| row.get(0))
            .optional()
            .map_err(|e| self.fail(e))
    }

    /// Writes down a refusal and returns its number.
    pub(in crate::jobs) fn reject(&mut self, new: &NewRejection, unix_s: f64) -> Result<i64, JournalError> {
        self.transact(|transaction| {
            transaction.execute(
                "INSERT INTO rejections (name, stored, code, reason, time, source, moves)
                 VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
                params![
                    new.name,
                    new.stored,
                    new.code,
                    new.reason,
                    unix_s,
                    source_text(new.source),
                    new.moves
                ],
            )?;
            Ok(transaction.last_insert_rowid())
        })
    }

    /// True when a refused file has this name in `rejected`.
    pub(in crate::jobs) fn is_stored(&self, stored: &str) -> Result<bool, JournalError> {
        let select = "SELECT 1 FROM rejections WHERE stored = ?1";
        let found = self.database.query_row(select, [stored], |_| Ok(())).optional();
        Ok(found.map_err(|e| self.fail(e))?.is_some())
    }

    /// The newest refusal of this very file.
    pub(in crate::jobs) fn rejection_of(
        &self,
        source: &FileIdentity,
    ) -> Result<Option<Rejection>, JournalError> {
        let select = "SELECT sequence, name, stored, code, reason, moves, source FROM rejections
                      WHERE source = ?1 ORDER BY sequence DESC LIMIT 1";
        self.database.query_row(select, [source_text(source)], rejection).optional().map_err(|e| self.fail(e))
    }

    /// Jobs that have not ended, and all that were claimed after the one with the order of arrival `after`.
    ///
    /// # Errors
    /// SQLite fails ([`JournalError::Database`]).
    pub fn since(&self, after: i64) -> Result<Since, JournalError> {
        let last = "SELECT coalesce(max(sequence), 0) FROM jobs";
        let last: i64 = self.database.query_row(last, [], |row| row.get(0)).map_err(|e| self.fail(e))?;
        // What is claimed between the two questions is left for the next look.
        let select = "SELECT id, state IN ('waiting','active'), sequence > ?1 FROM jobs
                      WHERE sequence <= ?2 AND (state IN ('waiting','active') OR sequence > ?1)";
        let mut found = Since { last, ..Since::default() };
        let rows: Result<Vec<(String, bool, bool)>, _> =
            self.database.prepare(select).and_then(|mut rows| {
                rows.query_map(params![after, last], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))?
                    .collect()
            });
        for (id, open, newer) in rows.map_err(|e| self.fail(e))? {
            if newer {
                found.newer.push(id.clone());
            }
            if open {
                found.open.insert(id);
            }
        }
        Ok(found)
    }

    /// The newest job that came in a file of this name.
    ///
    /// # Errors
    /// As [`Journal::active`].
    pub fn job_of_file(&self, name: &str) -> Result<Option<JobRecord>, JournalError> {
        Ok(self.select("WHERE name = ?1 ORDER BY sequence DESC LIMIT 1", params![name])?.pop())
    }

    /// The newest refusal of a file of this name.
    ///
    /// # Errors
    /// SQLite fails ([`JournalError::Database`]).
    pub fn rejection_of_name(&self, name: &str) -> Result<Option<Rejection>, JournalError> {
        let select = "SELECT sequence, name, stored, code, reason, moves, source FROM rejections
                      WHERE name = ?1 ORDER BY sequence DESC LIMIT 1";
        self.database.query_row(select, [name], rejection).optional().map_err(|e| self.fail(e))
    }

    /// The refusal in this row of the table.
    pub(super) fn rejection_at(&self, row: i64) -> Result<Rejection, JournalError> {
        let select = "SELECT sequence, name, stored, code, reason, moves, source FROM rejections
                      WHERE sequence = ?1";
        self.database.query_row(select, [row], rejection).map_err(|e| self.fail(e))
    }

    /// Refusals whose files may not be in their place yet.
    pub(in crate::jobs) fn unsettled_rejections(&self) -> Result<Vec<Rejection>, JournalError> {
        let select = "SELECT sequence, name, stored, code, reason, moves, source FROM rejections
                      WHERE settled = 0 ORDER BY sequence";
        let mut statement = self.database.prepare(select).map_err(|e| self.fail(e))?;
        statement
            .query_map([], rejection)
            .and_then(Iterator::collect::<Result<Vec<_>, _>>)
            .map_err(|e| self.fail(e))
    }

    /// Notes that a refused file and its reason are in their place.
    pub(in crate::jobs) fn settle_rejection(&mut self, sequence: i64) -> Result<(), JournalError> {
        let update = "UPDATE rejections SET settled = 1 WHERE sequence = ?1";
        self.transact(|transaction| transaction.execute(update, [sequence]))?;
        Ok(())
    }
}

fn rejection(row: &Row) -> Result<Rejection, rusqlite::Error> {
    Ok(Rejection {
        sequence: row.get(0)?,
        name: row.get(1)?,
        stored: row.get(2)?,
        code: row.get(3)?,
        reason: row.get(4)?,
        moves: row.get(5)?,
        source: row.get(6)?,
    })
}
