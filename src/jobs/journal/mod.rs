//! The one truth about jobs and their steps: a SQLite database, committed before anything moves.
//!
//! In: claims, step phases, results. Out: records, and after a restart what to do with unfinished jobs.
//! WAL with `synchronous=FULL`: a commit that returned has reached the disk, so a power cut cannot forget an
//! intent whose motion began. Folders follow this database (`jobs::spool`), never the other way round; only
//! a file in `incoming` that is not known here is new.

mod claim;
pub mod old;
pub mod places;
pub mod repair;
pub(in crate::jobs) mod rows;
mod schema;
mod seen;
mod steps;
#[cfg(test)]
mod tests;
pub mod watch;

use crate::jobs::history::JobFilter;
use crate::jobs::journal::claim::free_id;
use crate::jobs::journal::rows::{JobRow, encode, interrupted, job_columns, job_row, source_text, storable};
use crate::jobs::journal::schema::{MIGRATIONS, SCHEMA, SCHEMA_VERSION};
use crate::jobs::journal::seen::Seen;
use crate::jobs::record::{GoalPose, JobRecord, JobResult, JobState, PlanRecord, StepRecord, moves_made};
use rusqlite::{Connection, ErrorCode, OpenFlags, OptionalExtension, Transaction, params};
use std::path::{Path, PathBuf};
use std::time::Duration;

pub use crate::jobs::journal::claim::{Claim, NewJob};

/// Why the journal did not do what was requested.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// SQLite's own answer.
    #[error("journal database {path}")]
    Database {
        /// The file.
        path: PathBuf,
        /// The cause.
        #[source]
        source: rusqlite::Error,
    },
    /// Written by a later version of celld.
    #[error(
        "journal {path} has schema version {found}, this celld knows up to {SCHEMA_VERSION}; use the celld \
         that wrote it, or start with a new state folder"
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// What the file says.
        found: i64,
    },
    /// No job of that id.
    #[error("no job {id:?} is known; `celld jobs` lists them")]
    UnknownJob {
        /// What was requested.
        id: String,
    },
    /// The job is in a state that does not allow it.
    #[error("job {id:?} is {state}: cannot {action}")]
    WrongState {
        /// The job.
        id: String,
        /// Its state.
        state: &'static str,
        /// What was requested.
        action: &'static str,
    },
    /// The step is not the open one.
    #[error("job {id:?}: step {step} is not open: cannot mark it {action}")]
    WrongStep {
        /// The job.
        id: String,
        /// The step.
        step: u32,
        /// What was requested.
        action: &'static str,
    },
    /// SQLite finds pages that do not fit together.
    #[error("journal {path} is damaged: {found}; `celld journal repair` keeps what can be read")]
    Broken {
        /// The file.
        path: PathBuf,
        /// SQLite's first complaint.
        found: String,
    },
    /// A row that this program cannot have written.
    #[error(
        "journal {path}: column {column} holds {value:?}, which no celld writes; stop celld, then run \
         `celld journal repair`: it keeps what can be read"
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where.
        column: &'static str,
        /// What was there.
        value: String,
    },
}

impl JournalError {
    /// SQLite's answer; where it says that the file is damaged, with the way on.
    fn of(path: &Path, source: rusqlite::Error) -> JournalError {
        let path = path.to_owned();
        match source.sqlite_error_code() {
            Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => {
                JournalError::Broken { path, found: source.to_string() }
            }
            _ => JournalError::Database { path, source },
        }
    }

    /// The file itself is damaged, or is no database: `celld journal repair` is the way on.
    pub fn is_damage(&self) -> bool {
        matches!(self, JournalError::Broken { .. })
    }
}

/// What was done about a job that was unfinished when celld ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Recovered {
    /// No motion was under way: it waits at the head of the queue for a new look and a new plan.
    Requeued {
        /// The job.
        id: String,
        /// Pick-n-places it has made.
        moves: u32,
    },
    /// A step was open: how far it got is not known. The job ended as `interrupted`.
    Interrupted {
        /// The job.
        id: String,
        /// The open step.
        step: StepRecord,
    },
}

impl std::fmt::Display for Recovered {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Recovered::Requeued { id, moves: 0 } => {
                write!(f, "job {id} had moved nothing when an earlier celld ended; it waits again")
            }
            Recovered::Requeued { id, moves } => write!(
                f,
                "job {id} had made {moves} moves when an earlier celld ended, none was under way; it waits \
                 again, looks and plans anew"
            ),
            Recovered::Interrupted { id, step } => {
                let (step, object) = (step.step, &step.intent.object);
                write!(f, "job {id} was cut off in step {step} ({object}) when an earlier celld ended")
            }
        }
    }
}

/// A refused file.
#[derive(Clone, Debug, PartialEq)]
pub struct Rejection {
    /// Order of arrival.
    pub sequence: i64,
    /// Name in `incoming`.
    pub name: String,
    /// Name in `rejected`.
    pub stored: String,
    /// Constant for programs.
    pub code: String,
    /// Content of the reason file.
    pub reason: String,
    /// The file is moved to `rejected` (not so for links, FIFOs and folders, which stay where they are).
    pub moves: bool,
    /// The very file in `incoming`.
    pub source: String,
}

/// The database's file with this behind its name.
fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

/// SQLite's name for a database that no process changes (`sqlite.org/uri.html`).
fn unchanging(path: &Path) -> PathBuf {
    use std::os::unix::ffi::OsStrExt;
    let mut name = String::from("file:");
    for &byte in path.as_os_str().as_bytes() {
        match byte {
            b'/' | b'.' | b'-' | b'_' => name.push(char::from(byte)),
            byte if byte.is_ascii_alphanumeric() => name.push(char::from(byte)),
            byte => name.push_str(&format!("%{byte:02x}")),
        }
    }
    PathBuf::from(name + "?immutable=1")
}

/// The open database.
#[derive(Debug)]
pub struct Journal {
    database: Connection,
    path: PathBuf,
    /// Of the database; less than [`SCHEMA_VERSION`] in a reader of one that no daemon has opened since.
    version: i64,
    /// The file at the last look.
    seen: Option<Seen>,
}

impl Journal {
    /// Opens or creates the database; one of an earlier version is brought up to this one, in one
    /// transaction.
    ///
    /// # Errors
    /// SQLite cannot open, create or read the file ([`JournalError::Database`]), or the file is of a later
    /// version ([`JournalError::Version`]).
    pub fn open(path: &Path) -> Result<Journal, JournalError> {
        let fail = |source| JournalError::of(path, source);
        let database = Connection::open(path).map_err(fail)?;
        database.busy_timeout(Duration::from_secs(5)).map_err(fail)?;
        database
            .execute_batch("PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL; PRAGMA foreign_keys=ON;")
            .map_err(fail)?;
        let mut journal = Journal { database, path: path.to_owned(), version: SCHEMA_VERSION, seen: None };
        journal.check_pages()?;
        match journal.read_version()? {
            0 => journal.create()?,
            SCHEMA_VERSION => {}
            older @ 1..SCHEMA_VERSION => journal.migrate(older)?,
            found => return Err(JournalError::Version { path: path.to_owned(), found }),
        }
        Ok(journal)
    }

    /// Opens an existing database to read it beside a running daemon.
    ///
    /// # Errors
    /// The file is absent or SQLite cannot open it ([`JournalError::Database`]), or it is of a later version
    /// ([`JournalError::Version`]).
    pub fn open_to_read(path: &Path) -> Result<Journal, JournalError> {
        // Not read-only: a reader of a WAL database may have to create its shared-memory file.
        let first = Journal::read_as(path, path, OpenFlags::SQLITE_OPEN_READ_WRITE);
        let at_rest = || !beside(path, "-wal").exists() && path.exists();
        match first {
            // Who may read the folder and not write into it cannot create that file. A database without a
            // log is at rest, and then it can be read as one that does not change.
            Err(JournalError::Database { source, .. })
                if matches!(
                    source.sqlite_error_code(),
                    Some(ErrorCode::CannotOpen | ErrorCode::ReadOnly)
                ) && at_rest() =>
            {
                let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI;
                Journal::read_as(path, &unchanging(path), flags)
            }
            other => other,
        }
    }

    fn read_as(path: &Path, name: &Path, flags: OpenFlags) -> Result<Journal, JournalError> {
        let fail = |source| JournalError::of(path, source);
        let database = Connection::open_with_flags(name, flags).map_err(fail)?;
        database.busy_timeout(Duration::from_secs(5)).map_err(fail)?;
        database.execute_batch("PRAGMA query_only=ON;").map_err(fail)?;
        let mut journal = Journal { database, path: path.to_owned(), version: SCHEMA_VERSION, seen: None };
        match journal.read_version()? {
            version @ 1..=SCHEMA_VERSION => {
                journal.version = version;
                Ok(journal)
            }
            found => Err(JournalError::Version { path: path.to_owned(), found }),
        }
    }

    fn read_version(&self) -> Result<i64, JournalError> {
        self.database.query_row("PRAGMA user_version", [], |row| row.get(0)).map_err(|e| self.fail(e))
    }

    fn create(&mut self) -> Result<(), JournalError> {
        self.transact(|transaction| {
            transaction.execute_batch(SCHEMA)?;
            transaction.execute_batch(&format!("PRAGMA user_version={SCHEMA_VERSION}"))
        })
    }

    fn migrate(&mut self, from: i64) -> Result<(), JournalError> {
        let first = usize::try_from(from - 1).unwrap_or(0);
        self.transact(|transaction| {
            MIGRATIONS.iter().skip(first).try_for_each(|step| transaction.execute_batch(step))?;
            transaction.execute_batch(&format!("PRAGMA user_version={SCHEMA_VERSION}"))
        })
    }

    fn fail(&self, source: rusqlite::Error) -> JournalError {
        JournalError::of(&self.path, source)
    }

    /// Runs `work` in one transaction; what it did is on disk when this returns `Ok`.
    fn transact<T>(
        &mut self,
        work: impl FnOnce(&Transaction) -> Result<T, rusqlite::Error>,
    ) -> Result<T, JournalError> {
        let path = &self.path;
        let fail = |source| JournalError::of(path, source);
        let transaction = self.database.transaction().map_err(fail)?;
        let value = work(&transaction).map_err(fail)?;
        transaction.commit().map_err(fail)?;
        Ok(value)
    }

    /// Claims a job: known from now on, once and for all.
    ///
    /// # Errors
    /// SQLite fails ([`JournalError::Database`]).
    pub fn claim(&mut self, job: &NewJob, unix_s: f64) -> Result<Claim, JournalError> {
        let spec = encode(job.spec);
        self.transact(|transaction| {
            let id = match free_id(transaction, job)? {
                Ok(id) => id,
                Err(known) => return Ok(known),
            };
            transaction.execute(
                "INSERT INTO jobs (id, name, sha256, text, spec, state, priority, not_before, claimed, source)
                 VALUES (?1, ?2, ?3, ?4, ?5, 'waiting', ?6, ?7, ?8, ?9)",
                params![
                    id,
                    job.name,
                    job.sha256,
                    job.text,
                    spec,
                    job.spec.priority,
                    job.spec.not_before_unix_s,
                    unix_s,
                    source_text(&job.source)
                ],
            )?;
            Ok(Claim::Claimed { id })
        })
    }

    /// The job that is worked on.
    ///
    /// # Errors
    /// SQLite fails ([`JournalError::Database`]), or a row is damaged ([`JournalError::Damaged`]).
    pub fn active(&self) -> Result<Option<JobRecord>, JournalError> {
        Ok(self.select("WHERE state = 'active'", params![])?.pop())
    }

    /// The job whose turn it is: at the head after a restart, then by priority, `not_before`, arrival.
    ///
    /// # Errors
    /// As [`Journal::active`].
    pub fn next_ready(&self, unix_s: f64) -> Result<Option<JobRecord>, JournalError> {
        let order = "WHERE state = 'waiting' AND (not_before IS NULL OR not_before <= ?1)
                     ORDER BY head DESC, priority DESC, coalesce(not_before, 0), sequence LIMIT 1";
        Ok(self.select(order, params![unix_s])?.pop())
    }

    /// Number of jobs that wait.
    ///
    /// # Errors
    /// SQLite fails ([`JournalError::Database`]).
    pub fn waiting(&self) -> Result<u32, JournalError> {
        let count = "SELECT count(*) FROM jobs WHERE state = 'waiting'";
        self.database.query_row(count, [], |row| row.get(0)).map_err(|e| self.fail(e))
    }

    /// One job.
    ///
    /// # Errors
    /// As [`Journal::active`].
    pub fn job(&self, id: &str) -> Result<Option<JobRecord>, JournalError> {
        Ok(self.select("WHERE id = ?1", params![id])?.pop())
    }

    /// Jobs in the order of arrival, newest first, at most `limit`.
    ///
    /// # Errors
    /// As [`Journal::active`].
    pub fn latest(&self, limit: u32) -> Result<Vec<JobRecord>, JournalError> {
        self.select("ORDER BY sequence DESC LIMIT ?1", params![limit])
    }

    /// The job that was begun last; none before the first.
    ///
    /// # Errors
    /// As [`Journal::active`].
    pub fn begun_last(&self) -> Result<Option<String>, JournalError> {
        let select = "SELECT id FROM jobs WHERE started IS NOT NULL ORDER BY started DESC LIMIT 1";
        self.database.query_row(select, [], |row| row.get(0)).optional().map_err(|e| self.fail(e))
    }

    /// Jobs that a person looks for, newest first, at most `limit`.
    ///
    /// # Errors
    /// As [`Journal::active`].
    pub fn search(&self, filter: &JobFilter, limit: u32) -> Result<Vec<JobRecord>, JournalError> {
        let goals = if self.version < 2 { "'[]'" } else { "coalesce(resolved, '[]')" };
        let clause = format!(
            "WHERE (NOT ?1 OR state IN ('failed','interrupted')) AND claimed >= ?2 AND (?3 IS NULL
               OR EXISTS (SELECT 1 FROM steps WHERE job = sequence AND json_extract(intent, '$.object') = ?3)
               OR EXISTS (SELECT 1 FROM json_each(spec, '$.goal') AS g WHERE json_extract(g.value, '$.id') = ?3)
               OR EXISTS (SELECT 1 FROM json_each({goals}) AS g WHERE json_extract(g.value, '$.id') = ?3))
             ORDER BY sequence DESC LIMIT ?4"
        );
        let since = filter.since_unix_s.unwrap_or(f64::MIN);
        self.select(&clause, params![filter.failed, since, filter.object, limit])
    }

    /// Makes a waiting job the active one.
    ///
    /// # Errors
    /// No job has this id ([`JournalError::UnknownJob`]), it does not wait or another job is active
    /// ([`JournalError::WrongState`]), or as [`Journal::active`].
    pub fn start(&mut self, id: &str, unix_s: f64) -> Result<(), JournalError> {
        let update = "UPDATE jobs SET state = 'active', started = coalesce(started, ?2), head = 0
                      WHERE id = ?1 AND state = 'waiting' AND NOT EXISTS (SELECT 1 FROM jobs WHERE state = 'active')";
        self.change(id, "start it beside another job", update, params![id, unix_s])
    }

    /// Puts an active job back to the head of the queue; only without an open step.
    ///
    /// # Errors
    /// No job has this id ([`JournalError::UnknownJob`]), it is not active or has an open step
    /// ([`JournalError::WrongState`]), or as [`Journal::active`].
    pub fn requeue(&mut self, id: &str) -> Result<(), JournalError> {
        let update = "UPDATE jobs SET state = 'waiting', head = 1 WHERE id = ?1 AND state = 'active'
                      AND NOT EXISTS (SELECT 1 FROM steps WHERE job = sequence AND phase IN ('intent','gripped','released'))";
        self.change(id, "put it back into the queue", update, params![id])
    }

    /// Notes what a job's first look showed, and the goals it has since; of a second look nothing.
    ///
    /// # Errors
    /// As [`Journal::approve`].
    pub fn found(
        &mut self,
        id: &str,
        objects: &[GoalPose],
        goals: &[GoalPose],
        unix_s: f64,
    ) -> Result<(), JournalError> {
        let update = "UPDATE jobs SET found = coalesce(found, ?2), resolved = coalesce(resolved, ?3),
                      found_at = CASE WHEN found IS NULL THEN ?4 ELSE found_at END WHERE id = ?1 AND state IN ('waiting','active')";
        self.change(id, "note what it found", update, params![id, encode(&objects), encode(&goals), unix_s])
    }

    /// The highest number of the plans that are noted, 0 where none is.
    ///
    /// # Errors
    /// As [`Journal::waiting`].
    pub fn highest_plan(&self) -> Result<u64, JournalError> {
        let query =
            "SELECT coalesce(max(json_extract(plan, '$.number')), 0) FROM jobs WHERE json_valid(plan)";
        let highest: i64 = self.database.query_row(query, [], |row| row.get(0)).map_err(|e| self.fail(e))?;
        Ok(u64::try_from(highest).unwrap_or(0))
    }

    /// Notes what is planned; an earlier plan of the job is forgotten.
    ///
    /// # Errors
    /// As [`Journal::approve`].
    pub fn planned(&mut self, id: &str, plan: &PlanRecord) -> Result<(), JournalError> {
        let update = "UPDATE jobs SET plan = ?2 WHERE id = ?1 AND state IN ('waiting','active')";
        self.change(id, "note its plan", update, params![id, encode(plan)])
    }

    /// Notes that a person approved what is planned; it holds after a restart.
    ///
    /// # Errors
    /// No job has this id ([`JournalError::UnknownJob`]), it has ended ([`JournalError::WrongState`]), or as
    /// [`Journal::active`].
    pub fn approve(&mut self, id: &str, unix_s: f64) -> Result<(), JournalError> {
        let update = "UPDATE jobs SET approved = json_extract(plan, '$.steps'), approved_at = ?2
                      WHERE id = ?1 AND state IN ('waiting','active')";
        self.change(id, "approve it", update, params![id, unix_s])
    }

    /// Ends a job. Folders follow with the next `Spool::reconcile`.
    ///
    /// # Errors
    /// As [`Journal::approve`].
    pub fn finish(&mut self, id: &str, result: &JobResult, unix_s: f64) -> Result<(), JournalError> {
        let text = encode(&storable(result));
        let state = result.status.as_str();
        let update = "UPDATE jobs SET state = ?2, result = ?3, ended = ?4 WHERE id = ?1 AND state IN \
                      ('waiting','active')";
        self.change(id, "end it", update, params![id, state, text, unix_s])
    }

    fn change(
        &mut self,
        id: &str,
        action: &'static str,
        update: &str,
        values: &[&dyn rusqlite::ToSql],
    ) -> Result<(), JournalError> {
        if self.transact(|transaction| transaction.execute(update, values))? == 1 {
            return Ok(());
        }
        match self.job(id)? {
            None => Err(JournalError::UnknownJob { id: id.to_owned() }),
            Some(job) => {
                Err(JournalError::WrongState { id: id.to_owned(), state: job.state.as_str(), action })
            }
        }
    }

    /// Decides about jobs that were active when celld ended; to be called once, at start, before anything
    /// else.
    ///
    /// # Errors
    /// SQLite fails ([`JournalError::Database`]), or a row is damaged ([`JournalError::Damaged`]).
    pub fn recover(&mut self, unix_s: f64) -> Result<Vec<Recovered>, JournalError> {
        let mut recovered = Vec::new();
        for job in self.select("WHERE state = 'active'", params![])? {
            let steps = self.steps(&job.id)?;
            match steps.iter().find(|step| step.phase.is_open()) {
                None => {
                    self.requeue(&job.id)?;
                    let moves = moves_made(&steps);
                    recovered.push(Recovered::Requeued { id: job.id, moves });
                }
                Some(open) => {
                    let result = interrupted(&job, &steps, open, unix_s);
                    self.finish(&job.id, &result, unix_s)?;
                    recovered.push(Recovered::Interrupted { id: job.id, step: open.clone() });
                }
            }
        }
        Ok(recovered)
    }

    fn select(&self, clause: &str, values: &[&dyn rusqlite::ToSql]) -> Result<Vec<JobRecord>, JournalError> {
        let select = format!("SELECT {} FROM jobs {clause}", job_columns(self.version));
        let mut statement = self.database.prepare(&select).map_err(|e| self.fail(e))?;
        let rows = statement
            .query_map(values, job_row)
            .and_then(Iterator::collect::<Result<Vec<_>, _>>)
            .map_err(|e| self.fail(e))?;
        rows.into_iter().map(|row| self.job_record(row)).collect()
    }

    fn job_record(&self, row: JobRow) -> Result<JobRecord, JournalError> {
        let state = row.state.parse::<JobState>().map_err(|_| self.damaged("jobs.state", &row.state))?;
        let result = row.result.map(|text| self.decode("jobs.result", &text)).transpose()?;
        Ok(JobRecord {
            sequence: row.sequence,
            id: row.id,
            name: row.name,
            sha256: row.sha256,
            text: row.text,
            spec: self.decode("jobs.spec", &row.spec)?,
            state,
            approved: row.approved,
            approved_unix_s: row.approved_at,
            found: row.found.map_or(Ok(Vec::new()), |text| self.decode("jobs.found", &text))?,
            found_unix_s: row.found_at,
            resolved: row.resolved.map(|text| self.decode("jobs.resolved", &text)).transpose()?,
            plan: row.plan.map(|text| self.decode("jobs.plan", &text)).transpose()?,
            claimed_unix_s: row.claimed,
            started_unix_s: row.started,
            ended_unix_s: row.ended,
            result,
        })
    }

    fn decode<T: serde::de::DeserializeOwned>(
        &self,
        column: &'static str,
        text: &str,
    ) -> Result<T, JournalError> {
        serde_json::from_str(text).map_err(|_| self.damaged(column, text))
    }

    fn damaged(&self, column: &'static str, value: &str) -> JournalError {
        JournalError::Damaged { path: self.path.clone(), column, value: value.chars().take(80).collect() }
    }
}
