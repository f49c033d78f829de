//! The one truth about jobs and their steps: a SQLite database, committed before anything moves.
//!
//! In: claims, step phases, results. Out: records, and after a restart what to do with unfinished jobs.
//! WAL with `synchronous=FULL`: a commit that returned has reached the disk, so a power cut cannot forget an
//! intent whose motion began. Folders follow this database (`jobs::spool`), never the other way round; only a
//! file in `incoming` that is not known here is new.

pub(in crate::jobs) mod places;
pub(in crate::jobs) mod rows;

use crate::io::files::FileIdentity;
use crate::jobs::journal::rows::{
    JOB_COLUMNS, JobRow, encode, free_id, interrupted, job_row, source_text, storable,
};
use crate::jobs::record::{JobRecord, JobResult, JobSpec, JobState, StepIntent, StepPhase, StepRecord};
use rusqlite::{Connection, OpenFlags, Transaction, params};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Number in `PRAGMA user_version`; a database of another number is refused, not converted.
const SCHEMA_VERSION: i64 = 1;

const SCHEMA: &str = "
CREATE TABLE jobs (
  sequence      INTEGER PRIMARY KEY AUTOINCREMENT,
  id            TEXT NOT NULL UNIQUE,
  name          TEXT NOT NULL,
  sha256        TEXT NOT NULL,
  text          TEXT NOT NULL,
  spec          TEXT NOT NULL,
  state         TEXT NOT NULL CHECK (state IN ('waiting','active','done','failed','cancelled','interrupted')),
  priority      INTEGER NOT NULL,
  head          INTEGER NOT NULL DEFAULT 0,
  not_before    REAL,
  approved      TEXT,
  claimed       REAL NOT NULL,
  started       REAL,
  ended         REAL,
  result        TEXT,
  source        TEXT,
  folder        TEXT,
  placed_as     TEXT
);
CREATE UNIQUE INDEX one_active ON jobs (state) WHERE state = 'active';
CREATE INDEX jobs_state ON jobs (state);
CREATE INDEX jobs_source ON jobs (source) WHERE source IS NOT NULL;
CREATE TABLE steps (
  job     INTEGER NOT NULL REFERENCES jobs (sequence),
  step    INTEGER NOT NULL,
  intent  TEXT NOT NULL,
  phase   TEXT NOT NULL CHECK (phase IN ('intent','gripped','released','done','abandoned')),
  changed REAL NOT NULL,
  PRIMARY KEY (job, step)
);
CREATE UNIQUE INDEX one_open_step ON steps (job) WHERE phase IN ('intent','gripped','released');
CREATE TABLE rejections (
  sequence INTEGER PRIMARY KEY AUTOINCREMENT,
  name     TEXT NOT NULL,
  stored   TEXT NOT NULL UNIQUE,
  code     TEXT NOT NULL,
  reason   TEXT NOT NULL,
  time     REAL NOT NULL,
  source   TEXT NOT NULL,
  moves    INTEGER NOT NULL,
  settled  INTEGER NOT NULL DEFAULT 0
);
CREATE INDEX rejections_source ON rejections (source);
";

/// Why the journal did not do what it was asked.
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
    /// Written by another version of celld.
    #[error(
        "journal {path} has schema version {found}, this celld knows {SCHEMA_VERSION}; use the celld that wrote it, or start with a new state folder"
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
        /// What was asked for.
        id: String,
    },
    /// The job is in a state that does not allow it.
    #[error("job {id:?} is {state}: cannot {action}")]
    WrongState {
        /// The job.
        id: String,
        /// Where it stands.
        state: &'static str,
        /// What was asked for.
        action: &'static str,
    },
    /// The step is not the open one.
    #[error("job {id:?}: step {step} is not open: cannot mark it {action}")]
    WrongStep {
        /// The job.
        id: String,
        /// The step.
        step: u32,
        /// What was asked for.
        action: &'static str,
    },
    /// A row that this program cannot have written.
    #[error("journal {path}: column {column} holds {value:?}, which no celld writes")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where.
        column: &'static str,
        /// What was there.
        value: String,
    },
}

/// A checked job file about to be claimed.
#[derive(Clone, Debug)]
pub struct NewJob<'a> {
    /// From the file, or made from time, name and hash.
    pub id: &'a str,
    /// Name of the file.
    pub name: &'a str,
    /// Hash of the file, lower-case hex.
    pub sha256: &'a str,
    /// The file, verbatim.
    pub text: &'a str,
    /// What it asks for.
    pub spec: &'a JobSpec,
    /// The very file in `incoming`.
    pub source: FileIdentity,
}

/// What came of a claim.
#[derive(Clone, Debug, PartialEq)]
pub enum Claim {
    /// It is ours now, and on disk.
    Claimed {
        /// The job's unique id.
        id: String,
    },
    /// The same content is known under this id.
    Duplicate {
        /// The first job.
        of: String,
    },
    /// The id is known with other content.
    Conflict {
        /// The first job.
        with: String,
    },
}

/// What was done about a job that was unfinished when celld ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Recovered {
    /// No motion was under way: it waits at the head of the queue for a new look and a new plan.
    Requeued {
        /// The job.
        id: String,
    },
    /// A step was open: nobody knows how far it got. The job ended as `interrupted`.
    Interrupted {
        /// The job.
        id: String,
        /// The open step.
        step: StepRecord,
    },
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

/// The open database.
#[derive(Debug)]
pub struct Journal {
    database: Connection,
    path: PathBuf,
}

impl Journal {
    /// Opens or creates the database.
    pub fn open(path: &Path) -> Result<Journal, JournalError> {
        let fail = |source| JournalError::Database { path: path.to_owned(), source };
        let database = Connection::open(path).map_err(fail)?;
        database.busy_timeout(Duration::from_secs(5)).map_err(fail)?;
        database
            .execute_batch("PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL; PRAGMA foreign_keys=ON;")
            .map_err(fail)?;
        let mut journal = Journal { database, path: path.to_owned() };
        match journal.version()? {
            0 => journal.create()?,
            SCHEMA_VERSION => {}
            found => return Err(JournalError::Version { path: path.to_owned(), found }),
        }
        Ok(journal)
    }

    /// Opens an existing database to read it beside a running daemon.
    pub fn open_to_read(path: &Path) -> Result<Journal, JournalError> {
        let fail = |source| JournalError::Database { path: path.to_owned(), source };
        // Not read-only: a reader of a WAL database may have to create its shared-memory file.
        let database = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_WRITE).map_err(fail)?;
        database.busy_timeout(Duration::from_secs(5)).map_err(fail)?;
        database.execute_batch("PRAGMA query_only=ON;").map_err(fail)?;
        let journal = Journal { database, path: path.to_owned() };
        match journal.version()? {
            SCHEMA_VERSION => Ok(journal),
            found => Err(JournalError::Version { path: path.to_owned(), found }),
        }
    }

    fn version(&self) -> Result<i64, JournalError> {
        self.database.query_row("PRAGMA user_version", [], |row| row.get(0)).map_err(|e| self.fail(e))
    }

    fn create(&mut self) -> Result<(), JournalError> {
        self.transact(|transaction| {
            transaction.execute_batch(SCHEMA)?;
            transaction.execute_batch(&format!("PRAGMA user_version={SCHEMA_VERSION}"))
        })
    }

    fn fail(&self, source: rusqlite::Error) -> JournalError {
        JournalError::Database { path: self.path.clone(), source }
    }

    /// Runs `work` in one transaction; what it did is on disk when this returns `Ok`.
    fn transact<T>(
        &mut self,
        work: impl FnOnce(&Transaction) -> Result<T, rusqlite::Error>,
    ) -> Result<T, JournalError> {
        let path = &self.path;
        let fail = |source| JournalError::Database { path: path.clone(), source };
        let transaction = self.database.transaction().map_err(fail)?;
        let value = work(&transaction).map_err(fail)?;
        transaction.commit().map_err(fail)?;
        Ok(value)
    }

    /// Claims a job: known from now on, once and for all.
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
    pub fn active(&self) -> Result<Option<JobRecord>, JournalError> {
        Ok(self.select("WHERE state = 'active'", params![])?.pop())
    }

    /// The job whose turn it is: at the head after a restart, then by priority, `not_before`, arrival.
    pub fn next_ready(&self, unix_s: f64) -> Result<Option<JobRecord>, JournalError> {
        let order = "WHERE state = 'waiting' AND (not_before IS NULL OR not_before <= ?1)
                     ORDER BY head DESC, priority DESC, coalesce(not_before, 0), sequence LIMIT 1";
        Ok(self.select(order, params![unix_s])?.pop())
    }

    /// Number of jobs that wait.
    pub fn waiting(&self) -> Result<u32, JournalError> {
        let count = "SELECT count(*) FROM jobs WHERE state = 'waiting'";
        self.database.query_row(count, [], |row| row.get(0)).map_err(|e| self.fail(e))
    }

    /// One job.
    pub fn job(&self, id: &str) -> Result<Option<JobRecord>, JournalError> {
        Ok(self.select("WHERE id = ?1", params![id])?.pop())
    }

    /// Jobs in the order of arrival, newest first, at most `limit`.
    pub fn latest(&self, limit: u32) -> Result<Vec<JobRecord>, JournalError> {
        self.select("ORDER BY sequence DESC LIMIT ?1", params![limit])
    }

    /// Makes a waiting job the active one.
    pub fn start(&mut self, id: &str, unix_s: f64) -> Result<(), JournalError> {
        let update = "UPDATE jobs SET state = 'active', started = coalesce(started, ?2), head = 0
                      WHERE id = ?1 AND state = 'waiting' AND NOT EXISTS (SELECT 1 FROM jobs WHERE state = 'active')";
        self.change(id, "start it beside another job", update, params![id, unix_s])
    }

    /// Puts an active job back to the head of the queue; only without an open step.
    pub fn requeue(&mut self, id: &str) -> Result<(), JournalError> {
        let update = "UPDATE jobs SET state = 'waiting', head = 1 WHERE id = ?1 AND state = 'active'
                      AND NOT EXISTS (SELECT 1 FROM steps WHERE job = sequence AND phase IN ('intent','gripped','released'))";
        self.change(id, "put it back into the queue", update, params![id])
    }

    /// Notes that a person approved `what` (the caller's name for a plan).
    pub fn approve(&mut self, id: &str, what: &str) -> Result<(), JournalError> {
        let update = "UPDATE jobs SET approved = ?2 WHERE id = ?1 AND state IN ('waiting','active')";
        self.change(id, "approve it", update, params![id, what])
    }

    /// Ends a job. Folders follow with the next `Spool::reconcile`.
    pub fn finish(&mut self, id: &str, result: &JobResult, unix_s: f64) -> Result<(), JournalError> {
        let text = encode(&storable(result));
        let state = result.status.word();
        let update = "UPDATE jobs SET state = ?2, result = ?3, ended = ?4 WHERE id = ?1 AND state IN ('waiting','active')";
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
            Some(job) => Err(JournalError::WrongState { id: id.to_owned(), state: job.state.word(), action }),
        }
    }

    /// Writes down a step before its first byte of motion leaves the PC, and returns its number.
    ///
    /// # Errors
    /// [`JournalError::WrongState`] unless the job is active and has no open step: no motion is ordered twice.
    pub fn step_intent(&mut self, id: &str, intent: &StepIntent, unix_s: f64) -> Result<u32, JournalError> {
        let job = self.job(id)?.ok_or_else(|| JournalError::UnknownJob { id: id.to_owned() })?;
        let open = self.steps(id)?.iter().any(|step| step.phase.is_open());
        if job.state != JobState::Active || open {
            let state = if open { "in the middle of a step" } else { job.state.word() };
            return Err(JournalError::WrongState { id: id.to_owned(), state, action: "begin a step" });
        }
        let text = encode(intent);
        self.transact(|transaction| {
            let next = "SELECT coalesce(max(step), 0) + 1 FROM steps WHERE job = ?1";
            let step: u32 = transaction.query_row(next, [job.sequence], |row| row.get(0))?;
            transaction.execute(
                "INSERT INTO steps (job, step, intent, phase, changed) VALUES (?1, ?2, ?3, 'intent', ?4)",
                params![job.sequence, step, text, unix_s],
            )?;
            Ok(step)
        })
    }

    /// The vacuum holds: the object left the table.
    pub fn step_gripped(&mut self, id: &str, step: u32, unix_s: f64) -> Result<(), JournalError> {
        self.step_phase(id, step, StepPhase::Gripped, unix_s)
    }

    /// The vacuum is off at the place.
    pub fn step_released(&mut self, id: &str, step: u32, unix_s: f64) -> Result<(), JournalError> {
        self.step_phase(id, step, StepPhase::Released, unix_s)
    }

    /// The step is over.
    pub fn step_done(&mut self, id: &str, step: u32, unix_s: f64) -> Result<(), JournalError> {
        self.step_phase(id, step, StepPhase::Done, unix_s)
    }

    /// The step was given up after a fault that is understood; a new look has to come first.
    pub fn step_abandoned(&mut self, id: &str, step: u32, unix_s: f64) -> Result<(), JournalError> {
        self.step_phase(id, step, StepPhase::Abandoned, unix_s)
    }

    fn step_phase(&mut self, id: &str, step: u32, to: StepPhase, unix_s: f64) -> Result<(), JournalError> {
        let update = "UPDATE steps SET phase = ?3, changed = ?4 WHERE step = ?2
             AND job = (SELECT sequence FROM jobs WHERE id = ?1) AND phase IN ('intent','gripped','released')";
        let changed =
            self.transact(|transaction| transaction.execute(update, params![id, step, to.word(), unix_s]))?;
        if changed == 1 {
            return Ok(());
        }
        Err(JournalError::WrongStep { id: id.to_owned(), step, action: to.word() })
    }

    /// All steps of a job, in order.
    pub fn steps(&self, id: &str) -> Result<Vec<StepRecord>, JournalError> {
        let select =
            "SELECT step, intent, phase FROM steps WHERE job = (SELECT sequence FROM jobs WHERE id = ?1)
                      ORDER BY step";
        let mut statement = self.database.prepare(select).map_err(|e| self.fail(e))?;
        let rows = statement
            .query_map([id], |row| {
                Ok((row.get::<_, u32>(0)?, row.get::<_, String>(1)?, row.get::<_, String>(2)?))
            })
            .and_then(Iterator::collect::<Result<Vec<_>, _>>)
            .map_err(|e| self.fail(e))?;
        rows.into_iter().map(|(step, intent, phase)| self.step_record(step, &intent, &phase)).collect()
    }

    fn step_record(&self, step: u32, intent: &str, phase: &str) -> Result<StepRecord, JournalError> {
        let phase = StepPhase::from_word(phase).ok_or_else(|| self.damaged("steps.phase", phase))?;
        Ok(StepRecord { step, intent: self.decode("steps.intent", intent)?, phase })
    }

    /// Decides about jobs that were active when celld ended; to be called once, at start, before anything else.
    pub fn recover(&mut self, unix_s: f64) -> Result<Vec<Recovered>, JournalError> {
        let mut recovered = Vec::new();
        for job in self.select("WHERE state = 'active'", params![])? {
            let steps = self.steps(&job.id)?;
            match steps.iter().find(|step| step.phase.is_open()) {
                None => {
                    self.requeue(&job.id)?;
                    recovered.push(Recovered::Requeued { id: job.id });
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
        let select = format!("SELECT {JOB_COLUMNS} FROM jobs {clause}");
        let mut statement = self.database.prepare(&select).map_err(|e| self.fail(e))?;
        let rows = statement
            .query_map(values, job_row)
            .and_then(Iterator::collect::<Result<Vec<_>, _>>)
            .map_err(|e| self.fail(e))?;
        rows.into_iter().map(|row| self.job_record(row)).collect()
    }

    fn job_record(&self, row: JobRow) -> Result<JobRecord, JournalError> {
        let state = JobState::from_word(&row.state).ok_or_else(|| self.damaged("jobs.state", &row.state))?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose::Pose2;
    use crate::jobs::record::JobStatus;

    const NOW: f64 = 1_795_248_000.0;

    fn spec(priority: i64, not_before_unix_s: Option<f64>, rerun: bool) -> JobSpec {
        JobSpec {
            id: None,
            goal: Vec::new(),
            objective: None,
            solver: None,
            time_limit_s: None,
            seed: None,
            priority,
            not_before_unix_s,
            approval: None,
            rerun,
        }
    }

    fn claim(journal: &mut Journal, id: &str, sha256: &str, spec: &JobSpec) -> Claim {
        let source = FileIdentity { device: 1, inode: 2, size: 3, modified_ns: 4 };
        let job = NewJob { id, name: "job.yaml", sha256, text: "version: 1", spec, source };
        journal.claim(&job, NOW).unwrap()
    }

    fn intent() -> StepIntent {
        StepIntent {
            object: "mug".into(),
            from: Pose2::default(),
            to: Pose2::new(0.1, 0.2, 0.3),
            kind: "goal".into(),
        }
    }

    fn folder() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("history.sqlite");
        (folder, path)
    }

    #[test]
    fn a_job_is_claimed_once() {
        let (_folder, path) = folder();
        let mut journal = Journal::open(&path).unwrap();
        let plain = JobSpec { id: Some("a".into()), ..spec(0, None, false) };
        let claimed = |id: &str| Claim::Claimed { id: id.into() };
        assert_eq!(claim(&mut journal, "a", "00", &plain), claimed("a"));
        assert_eq!(claim(&mut journal, "a", "00", &plain), Claim::Duplicate { of: "a".into() });
        assert_eq!(claim(&mut journal, "a", "11", &plain), Claim::Conflict { with: "a".into() });
        let rerun = JobSpec { rerun: true, ..plain.clone() };
        assert_eq!(claim(&mut journal, "a", "00", &rerun), claimed("a.2"));
        assert_eq!(claim(&mut journal, "a", "00", &rerun), claimed("a.3"));
        let nameless = spec(0, None, false);
        assert_eq!(claim(&mut journal, "made-up", "00", &nameless), claimed("made-up"));
        assert_eq!(claim(&mut journal, "made-up", "00", &nameless), claimed("made-up.2"));
        drop(journal);
        let mut journal = Journal::open(&path).unwrap();
        assert_eq!(claim(&mut journal, "a", "00", &plain), Claim::Duplicate { of: "a".into() });
    }

    #[test]
    fn commits_reach_the_disk_before_they_return() {
        let (_folder, path) = folder();
        let journal = Journal::open(&path).unwrap();
        let mode: String = journal.database.query_row("PRAGMA journal_mode", [], |row| row.get(0)).unwrap();
        let synchronous: i64 =
            journal.database.query_row("PRAGMA synchronous", [], |row| row.get(0)).unwrap();
        assert_eq!((mode.as_str(), synchronous), ("wal", 2));
    }

    #[test]
    fn order_is_priority_then_time_then_arrival() {
        let (_folder, path) = folder();
        let mut journal = Journal::open(&path).unwrap();
        claim(&mut journal, "first", "1", &spec(0, None, false));
        claim(&mut journal, "second", "2", &spec(0, None, false));
        claim(&mut journal, "later", "3", &spec(9, Some(NOW + 60.0), false));
        claim(&mut journal, "urgent", "4", &spec(5, None, false));
        let mut order = Vec::new();
        while let Some(job) = journal.next_ready(NOW).unwrap() {
            journal.start(&job.id, NOW).unwrap();
            journal.finish(&job.id, &result(&job.id, JobStatus::Done), NOW).unwrap();
            order.push(job.id);
        }
        assert_eq!(order, ["urgent", "first", "second"]);
        assert_eq!(journal.next_ready(NOW + 61.0).unwrap().unwrap().id, "later");
    }

    fn result(id: &str, status: JobStatus) -> JobResult {
        JobResult {
            id: id.into(),
            status,
            code: "OK".into(),
            message: String::new(),
            remedy: String::new(),
            moves: 0,
            lower_bound: Some(f64::NAN),
            seconds: f64::INFINITY,
            objects: Vec::new(),
        }
    }

    #[test]
    fn one_job_is_active_and_ends_once() {
        let (_folder, path) = folder();
        let mut journal = Journal::open(&path).unwrap();
        for id in ["a", "b"] {
            claim(&mut journal, id, id, &spec(0, None, false));
        }
        journal.start("a", NOW).unwrap();
        assert!(matches!(journal.start("b", NOW), Err(JournalError::WrongState { .. })));
        assert!(matches!(journal.start("c", NOW), Err(JournalError::UnknownJob { .. })));
        journal.finish("a", &result("a", JobStatus::Done), NOW).unwrap();
        let again = journal.finish("a", &result("a", JobStatus::Failed), NOW);
        assert!(matches!(again, Err(JournalError::WrongState { state: "done", .. })));
        assert_eq!(journal.job("a").unwrap().unwrap().result.unwrap().seconds, 0.0);
    }

    #[test]
    fn no_step_begins_while_one_is_open() {
        let (_folder, path) = folder();
        let mut journal = Journal::open(&path).unwrap();
        claim(&mut journal, "a", "1", &spec(0, None, false));
        assert!(journal.step_intent("a", &intent(), NOW).is_err(), "the job is not active yet");
        journal.start("a", NOW).unwrap();
        assert_eq!(journal.step_intent("a", &intent(), NOW).unwrap(), 1);
        assert!(matches!(journal.step_intent("a", &intent(), NOW), Err(JournalError::WrongState { .. })));
        journal.step_gripped("a", 1, NOW).unwrap();
        assert!(matches!(journal.requeue("a"), Err(JournalError::WrongState { .. })));
        journal.step_done("a", 1, NOW).unwrap();
        assert!(matches!(journal.step_done("a", 1, NOW), Err(JournalError::WrongStep { step: 1, .. })));
        assert_eq!(journal.step_intent("a", &intent(), NOW).unwrap(), 2);
        journal.step_abandoned("a", 2, NOW).unwrap();
        assert_eq!(journal.step_intent("a", &intent(), NOW).unwrap(), 3);
    }

    #[track_caller]
    fn check_recovery(steps: impl FnOnce(&mut Journal), expected: &str) {
        let (_folder, path) = folder();
        let mut journal = Journal::open(&path).unwrap();
        claim(&mut journal, "other", "0", &spec(9, None, false));
        claim(&mut journal, "a", "1", &spec(0, None, false));
        journal.start("a", NOW).unwrap();
        steps(&mut journal);
        drop(journal);
        let mut journal = Journal::open(&path).unwrap();
        journal.recover(NOW).unwrap();
        assert!(journal.recover(NOW).unwrap().is_empty(), "recovery is done once");
        let job = journal.job("a").unwrap().unwrap();
        let code = job.result.map(|result| result.code).unwrap_or_default();
        assert_eq!(format!("{} {code}", job.state.word()).trim(), expected);
        let next = journal.next_ready(NOW).unwrap().unwrap().id;
        assert_eq!(next, if expected == "waiting" { "a" } else { "other" });
    }

    #[test]
    fn after_a_crash_only_a_job_at_rest_goes_on() {
        let intend = |journal: &mut Journal| journal.step_intent("a", &intent(), NOW).unwrap();
        check_recovery(|_| {}, "waiting");
        check_recovery(
            |journal| {
                intend(journal);
            },
            "interrupted E_INTERRUPTED",
        );
        check_recovery(
            |journal| {
                intend(journal);
                journal.step_gripped("a", 1, NOW).unwrap();
            },
            "interrupted E_INTERRUPTED_CARRYING",
        );
        check_recovery(
            |journal| {
                intend(journal);
                journal.step_released("a", 1, NOW).unwrap();
            },
            "interrupted E_INTERRUPTED",
        );
        check_recovery(
            |journal| {
                intend(journal);
                journal.step_done("a", 1, NOW).unwrap();
            },
            "waiting",
        );
    }

    #[test]
    fn another_schema_version_is_refused() {
        let (_folder, path) = folder();
        Journal::open(&path).unwrap().database.execute_batch("PRAGMA user_version=7").unwrap();
        assert!(matches!(Journal::open(&path), Err(JournalError::Version { found: 7, .. })));
        assert!(matches!(Journal::open_to_read(&path), Err(JournalError::Version { found: 7, .. })));
    }

    #[test]
    fn a_reader_sees_jobs_beside_the_daemon_and_changes_nothing() {
        let (_folder, path) = folder();
        let mut journal = Journal::open(&path).unwrap();
        claim(&mut journal, "a", "1", &spec(0, None, false));
        let mut reader = Journal::open_to_read(&path).unwrap();
        assert_eq!(reader.latest(10).unwrap().len(), 1);
        assert!(reader.start("a", NOW).is_err());
    }
}
