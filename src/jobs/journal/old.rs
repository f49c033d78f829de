//! What the journal may forget: ended jobs and refusals beyond the limits of the history.
//!
//! In: the limits, the time. Out: a few rows at a time whose files are to be removed, and then the rows. The
//! files go first: after a crash in between the row is found again. The job of the last step is never
//! forgotten, for that step says what may hang on the gripper.

use crate::jobs::journal::{Journal, JournalError};
use rusqlite::{Row, params};

/// How much of the history is kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HistoryLimits {
    /// Ended jobs and refusals older than this go, days.
    pub days: f64,
    /// More ended jobs, and more refusals, than this go; the oldest first.
    pub jobs: u32,
    /// So many of the newest stay whatever their age: a calendar that is set years ahead by mistake must not
    /// empty the history.
    pub always: u32,
}

impl HistoryLimits {
    /// What is kept unless the configuration says otherwise.
    pub const YEAR: HistoryLimits = HistoryLimits { days: 365.0, jobs: 20_000, always: 100 };
}

/// Rows that are looked at in one call: each takes a few files with it, and the arm's records must not wait.
const AT_ONCE: u32 = 2;

const SECONDS_A_DAY: f64 = 86_400.0;

/// An ended job that is to be forgotten.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::jobs) struct OldJob {
    pub sequence: i64,
    /// Below `jobs`.
    pub folder: Option<String>,
}

/// A refusal that is to be forgotten.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::jobs) struct OldRejection {
    pub sequence: i64,
    /// Name in `rejected`.
    pub stored: String,
}

impl Journal {
    /// Ended jobs beyond the limits whose files are in their place, the oldest first.
    pub(in crate::jobs) fn old_jobs(
        &self,
        limits: &HistoryLimits,
        unix_s: f64,
    ) -> Result<Vec<OldJob>, JournalError> {
        let select = "
            SELECT sequence, folder FROM jobs
            WHERE ended IS NOT NULL AND placed_as IS state AND source IS NULL
              AND (sequence <= (SELECT sequence FROM jobs WHERE ended IS NOT NULL
                                ORDER BY sequence DESC LIMIT 1 OFFSET ?2)
                OR ended < ?1 AND sequence <= (SELECT sequence FROM jobs WHERE ended IS NOT NULL
                                               ORDER BY sequence DESC LIMIT 1 OFFSET ?4))
              AND sequence IS NOT (SELECT job FROM steps ORDER BY rowid DESC LIMIT 1)
            ORDER BY sequence LIMIT ?3";
        self.beyond(select, limits, unix_s, |row| Ok(OldJob { sequence: row.get(0)?, folder: row.get(1)? }))
    }

    /// Refusals beyond the limits, the oldest first; not of what stays in `incoming`, which would be refused
    /// again.
    pub(in crate::jobs) fn old_rejections(
        &self,
        limits: &HistoryLimits,
        unix_s: f64,
    ) -> Result<Vec<OldRejection>, JournalError> {
        let select = "
            SELECT sequence, stored FROM rejections
            WHERE settled = 1 AND moves = 1
              AND (sequence <= (SELECT sequence FROM rejections ORDER BY sequence DESC LIMIT 1 OFFSET ?2)
                OR time < ?1 AND sequence <= (SELECT sequence FROM rejections
                                              ORDER BY sequence DESC LIMIT 1 OFFSET ?4))
            ORDER BY sequence LIMIT ?3";
        self.beyond(select, limits, unix_s, |row| {
            Ok(OldRejection { sequence: row.get(0)?, stored: row.get(1)? })
        })
    }

    /// The first rows of a query with the limits: ?1 what is older goes, ?2 how many stay, ?3 how many rows,
    /// ?4 how many stay whatever their age.
    fn beyond<T>(
        &self,
        select: &str,
        limits: &HistoryLimits,
        unix_s: f64,
        row: impl FnMut(&Row) -> Result<T, rusqlite::Error>,
    ) -> Result<Vec<T>, JournalError> {
        let mut statement = self.database.prepare(select).map_err(|e| self.fail(e))?;
        let before = unix_s - limits.days * SECONDS_A_DAY;
        let rows = statement.query_map(params![before, limits.jobs, AT_ONCE, limits.always], row);
        rows.and_then(Iterator::collect).map_err(|e| self.fail(e))
    }

    /// Forgets a job and its steps, once its files are gone.
    pub(in crate::jobs) fn forget_job(&mut self, sequence: i64) -> Result<(), JournalError> {
        self.transact(|transaction| {
            transaction.execute("DELETE FROM steps WHERE job = ?1", [sequence])?;
            transaction.execute("DELETE FROM jobs WHERE sequence = ?1", [sequence])
        })?;
        Ok(())
    }

    /// Forgets a refusal, once its files are gone.
    pub(in crate::jobs) fn forget_rejection(&mut self, sequence: i64) -> Result<(), JournalError> {
        let delete = "DELETE FROM rejections WHERE sequence = ?1";
        self.transact(|transaction| transaction.execute(delete, [sequence]))?;
        Ok(())
    }
}
