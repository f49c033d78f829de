//! The cell's own database of its part in the fleet: jobs it has in hand, events that wait for the network.
//!
//! In: entries and events. Out: the same after any end of the process. Events are numbered without holes in
//! a series that begins with the database; they stay until the server has stored them. What is older than
//! [`Limits::days`] or beyond [`Limits::bytes`] is given up, the oldest first, and one gap event stands in
//! the place of all that were, with the number of the last: a reader sees what is missing. SQLite as the
//! journal has it: write-ahead log, each commit on the disk.

use crate::payloads::{Event, Outcome, Totals, VERSION, What};
use crate::values::{Entry, Kept};
use rusqlite::{Connection, OptionalExtension, Transaction, params};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Version of the tables.
const SCHEMA_VERSION: i64 = 1;

const SCHEMA: &str = "
CREATE TABLE entries (
    job TEXT PRIMARY KEY,
    kept TEXT NOT NULL,
    entry TEXT NOT NULL,
    changed REAL NOT NULL
) STRICT;
CREATE TABLE events (
    number INTEGER PRIMARY KEY,
    unix_s REAL NOT NULL,
    event TEXT NOT NULL,
    bytes INTEGER NOT NULL
) STRICT;
CREATE TABLE about (
    one INTEGER PRIMARY KEY CHECK (one = 1),
    series TEXT NOT NULL,
    last_number INTEGER NOT NULL,
    event_bytes INTEGER NOT NULL,
    totals TEXT NOT NULL
) STRICT;
";

/// Jobs that are over are remembered for so long, s: that they are not taken again.
const REMEMBERED_S: f64 = 90.0 * 86_400.0;

/// Why the database cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// SQLite.
    #[error("{path}: {source}")]
    Database {
        /// The file.
        path: PathBuf,
        /// What SQLite says.
        source: rusqlite::Error,
    },
    /// Of a later celld.
    #[error("{path} is of version {found}, this celld knows {SCHEMA_VERSION}; use the celld that wrote it")]
    Version {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: i64,
    },
    /// A row that is none of ours.
    #[error("{path}: {column} holds {value:?}, which is damaged")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where.
        column: &'static str,
        /// What is there.
        value: String,
    },
}

/// How much is kept while the network is away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Bytes of events.
    pub bytes: u64,
    /// Their age, days.
    pub days: f64,
}

impl Limits {
    /// 1 GB or 7 days.
    pub const USUAL: Limits = Limits { bytes: 1_000_000_000, days: 7.0 };
}

/// The database.
#[derive(Debug)]
pub struct Store {
    database: Connection,
    path: PathBuf,
    cell: String,
    series: String,
    limits: Limits,
    /// Events that the disk did not take since the last that it did.
    missed: Missed,
}

/// Events without a row: their number in the series, and what the jobs among them add to the totals.
#[derive(Clone, Debug, Default)]
struct Missed {
    events: u32,
    outcomes: Vec<Outcome>,
}

/// Outcomes that are kept for the totals while the disk takes nothing.
const MOST_OUTCOMES: usize = 10_000;

impl Store {
    /// Opens the database, or makes it; `series` names the events of a new one and must be unlike any
    /// before.
    ///
    /// # Errors
    /// SQLite cannot open it ([`StoreError::Database`]), or it is of a later version
    /// ([`StoreError::Version`]).
    pub fn open(path: &Path, cell: &str, series: &str, limits: Limits) -> Result<Store, StoreError> {
        let fail = |source| StoreError::Database { path: path.to_owned(), source };
        let mut database = Connection::open(path).map_err(fail)?;
        database.busy_timeout(Duration::from_secs(5)).map_err(fail)?;
        database.execute_batch("PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL;").map_err(fail)?;
        let version: i64 = database.query_row("PRAGMA user_version", [], |row| row.get(0)).map_err(fail)?;
        match version {
            0 => create(&mut database, series).map_err(fail)?,
            SCHEMA_VERSION => {}
            found => return Err(StoreError::Version { path: path.to_owned(), found }),
        }
        let series = database.query_row("SELECT series FROM about", [], |row| row.get(0)).map_err(fail)?;
        Ok(Store {
            database,
            path: path.to_owned(),
            cell: cell.to_string(),
            series,
            limits,
            missed: Missed::default(),
        })
    }

    fn fail(&self, source: rusqlite::Error) -> StoreError {
        StoreError::Database { path: self.path.clone(), source }
    }

    fn damaged(&self, column: &'static str, value: &str) -> StoreError {
        StoreError::Damaged { path: self.path.clone(), column, value: value.chars().take(80).collect() }
    }

    fn transact<T>(
        &mut self,
        work: impl FnOnce(&Transaction) -> Result<T, rusqlite::Error>,
    ) -> Result<T, StoreError> {
        let path = &self.path;
        let fail = |source| StoreError::Database { path: path.clone(), source };
        let transaction = self.database.transaction().map_err(fail)?;
        let value = work(&transaction).map_err(fail)?;
        transaction.commit().map_err(fail)?;
        Ok(value)
    }

    /// What is known of jobs, the open ones and those that must not be taken again.
    ///
    /// # Errors
    /// SQLite, or a damaged row.
    pub fn entries(&self) -> Result<Vec<Entry>, StoreError> {
        let mut statement =
            self.database.prepare("SELECT entry FROM entries ORDER BY job").map_err(|e| self.fail(e))?;
        let rows = statement
            .query_map([], |row| row.get::<_, String>(0))
            .and_then(Iterator::collect::<Result<Vec<_>, _>>)
            .map_err(|e| self.fail(e))?;
        let read =
            |text: &String| serde_json::from_str(text).map_err(|_| self.damaged("entries.entry", text));
        rows.iter().map(read).collect()
    }

    /// Writes an entry; it is on the disk when this returns. One that is over and was not begun here is
    /// forgotten.
    ///
    /// # Errors
    /// SQLite.
    pub fn keep(&mut self, entry: &Entry, unix_s: f64) -> Result<(), StoreError> {
        let job = entry.job.id.clone();
        if entry.kept == Kept::Closed && !entry.begun_here {
            return self.transact(|t| t.execute("DELETE FROM entries WHERE job = ?1", [job]).map(drop));
        }
        let mut entry = entry.clone();
        if entry.kept == Kept::Closed {
            entry.job.text.clear();
        }
        let text = serde_json::to_string(&entry).map_err(|_| self.damaged("entry", &job))?;
        let kept = serde_json::to_string(&entry.kept).unwrap_or_default();
        let put = "INSERT INTO entries (job, kept, entry, changed) VALUES (?1, ?2, ?3, ?4)
                   ON CONFLICT (job) DO UPDATE SET kept = ?2, entry = ?3, changed = ?4";
        let old = "DELETE FROM entries WHERE kept = '\"closed\"' AND changed < ?1";
        self.transact(|transaction| {
            transaction.execute(put, params![job, kept, text, unix_s])?;
            transaction.execute(old, params![unix_s - REMEMBERED_S]).map(drop)
        })
    }

    /// Notes an event; its number is the next of the series. What is beyond the limits makes way. Events
    /// that a full disk did not take are a gap before the next one that it does.
    ///
    /// # Errors
    /// SQLite.
    pub fn record(&mut self, job: Option<String>, what: What, unix_s: f64) -> Result<Event, StoreError> {
        let missed = self.missed.clone();
        let mut outcomes = missed.outcomes;
        if let What::Done { outcome } = &what {
            outcomes.push(outcome.clone());
        }
        let (version, cell, series) = (VERSION, self.cell.clone(), self.series.clone());
        let event = Event { version, cell, series, number: 0, unix_s, job, what };
        let limits = self.limits;
        let noted = self.transact(|transaction| note(transaction, event, missed.events, &outcomes, limits));
        match &noted {
            Ok(_) => self.missed = Missed::default(),
            Err(error) => {
                tracing::warn!(path = %self.path.display(), %error, "an event was not noted");
                outcomes.truncate(MOST_OUTCOMES);
                self.missed = Missed { events: missed.events.saturating_add(1), outcomes };
            }
        }
        noted
    }

    /// The oldest events that were not delivered yet, in their order, at most `limit`.
    ///
    /// # Errors
    /// SQLite, or a damaged row.
    pub fn undelivered(&self, limit: u32) -> Result<Vec<Event>, StoreError> {
        let select = "SELECT event FROM events ORDER BY number LIMIT ?1";
        let mut statement = self.database.prepare_cached(select).map_err(|e| self.fail(e))?;
        let rows = statement
            .query_map([limit], |row| row.get::<_, String>(0))
            .and_then(Iterator::collect::<Result<Vec<_>, _>>)
            .map_err(|e| self.fail(e))?;
        let read = |text: &String| serde_json::from_str(text).map_err(|_| self.damaged("events.event", text));
        rows.iter().map(read).collect()
    }

    /// How many were not delivered yet.
    ///
    /// # Errors
    /// SQLite.
    pub fn waiting(&self) -> Result<u64, StoreError> {
        let count: i64 = self
            .database
            .query_row("SELECT count(*) FROM events", [], |row| row.get(0))
            .map_err(|e| self.fail(e))?;
        Ok(u64::try_from(count).unwrap_or(0))
    }

    /// The server has stored all up to this number.
    ///
    /// # Errors
    /// SQLite.
    pub fn delivered(&mut self, number: u64) -> Result<(), StoreError> {
        let number = i64::try_from(number).unwrap_or(i64::MAX);
        self.transact(|transaction| {
            let bytes: i64 = transaction.query_row(
                "SELECT coalesce(sum(bytes), 0) FROM events WHERE number <= ?1",
                [number],
                |row| row.get(0),
            )?;
            transaction.execute("DELETE FROM events WHERE number <= ?1", [number])?;
            transaction.execute("UPDATE about SET event_bytes = event_bytes - ?1", [bytes]).map(drop)
        })
    }

    /// What the cell has done for the fleet.
    ///
    /// # Errors
    /// SQLite, or a damaged row.
    pub fn totals(&self) -> Result<Totals, StoreError> {
        let text: Option<String> = self
            .database
            .query_row("SELECT totals FROM about", [], |row| row.get(0))
            .optional()
            .map_err(|e| self.fail(e))?;
        let text = text.unwrap_or_default();
        serde_json::from_str(&text).map_err(|_| self.damaged("about.totals", &text))
    }
}

/// Gives the event its number, behind a gap for those that were missed before it, and puts it in; adds what
/// jobs came to.
fn note(
    transaction: &Transaction,
    event: Event,
    missed: u32,
    outcomes: &[Outcome],
    limits: Limits,
) -> Result<Event, rusqlite::Error> {
    let about = "SELECT last_number, totals FROM about";
    let (last, totals): (i64, String) =
        transaction.query_row(about, [], |row| Ok((row.get(0)?, row.get(1)?)))?;
    let missing = last + i64::from(missed);
    let number = |value: i64| u64::try_from(value).unwrap_or(1);
    if missed > 0 {
        let what = What::Gap { first: number(last + 1), lost: u64::from(missed) };
        put(transaction, &Event { number: number(missing), what, job: None, ..event.clone() })?;
    }
    let event = Event { number: number(missing + 1), ..event };
    put(transaction, &event)?;
    transaction.execute("UPDATE about SET last_number = ?1", [missing + 1])?;
    if !outcomes.is_empty() {
        let mut totals: Totals = serde_json::from_str(&totals).unwrap_or_default();
        outcomes.iter().for_each(|outcome| totals.add(outcome));
        let totals = serde_json::to_string(&totals).unwrap_or_default();
        transaction.execute("UPDATE about SET totals = ?1", [totals])?;
    }
    trim(transaction, &event, limits)?;
    Ok(event)
}

fn create(database: &mut Connection, series: &str) -> Result<(), rusqlite::Error> {
    let transaction = database.transaction()?;
    transaction.execute_batch(SCHEMA)?;
    let totals = serde_json::to_string(&Totals::default()).unwrap_or_default();
    let about = "INSERT INTO about (one, series, last_number, event_bytes, totals) VALUES (1, ?1, 0, 0, ?2)";
    transaction.execute(about, params![series, totals])?;
    transaction.execute_batch(&format!("PRAGMA user_version={SCHEMA_VERSION}"))?;
    transaction.commit()
}

fn put(transaction: &Transaction, event: &Event) -> Result<(), rusqlite::Error> {
    let text =
        serde_json::to_string(event).map_err(|e| rusqlite::Error::ToSqlConversionFailure(Box::new(e)))?;
    let bytes = i64::try_from(text.len()).unwrap_or(i64::MAX);
    let number = i64::try_from(event.number).unwrap_or(i64::MAX);
    let insert = "INSERT INTO events (number, unix_s, event, bytes) VALUES (?1, ?2, ?3, ?4)";
    transaction.execute(insert, params![number, event.unix_s, text, bytes])?;
    transaction.execute("UPDATE about SET event_bytes = event_bytes + ?1", [bytes]).map(drop)
}

/// Gives up what is beyond the limits: the oldest events become one gap event. A tenth more than needed
/// goes, so that not every further event has to.
fn trim(transaction: &Transaction, newest: &Event, limits: Limits) -> Result<(), rusqlite::Error> {
    let bytes: i64 = transaction.query_row("SELECT event_bytes FROM about", [], |row| row.get(0))?;
    let most = i64::try_from(limits.bytes).unwrap_or(i64::MAX);
    let oldest = newest.unix_s - limits.days * 86_400.0;
    let newest_number = i64::try_from(newest.number).unwrap_or(i64::MAX);
    let mut last: Option<i64> = transaction.query_row(
        "SELECT max(number) FROM events WHERE unix_s < ?1 AND number < ?2",
        params![oldest, newest_number],
        |row| row.get(0),
    )?;
    if bytes > most {
        let keep = most - most / 10;
        let by_size: Option<i64> = transaction.query_row(
            "SELECT max(number) FROM (SELECT number, sum(bytes) OVER (ORDER BY number DESC) AS kept FROM events)
             WHERE kept > ?1 AND number < ?2",
            params![keep, newest_number],
            |row| row.get(0),
        )?;
        last = last.max(by_size);
    }
    let Some(last) = last else { return Ok(()) };
    let (first, size): (String, i64) = (
        transaction.query_row("SELECT event FROM events ORDER BY number LIMIT 1", [], |row| row.get(0))?,
        transaction
            .query_row("SELECT sum(bytes) FROM events WHERE number <= ?1", [last], |row| row.get(0))?,
    );
    let Ok(first) = serde_json::from_str::<Event>(&first) else { return Ok(()) };
    let number = u64::try_from(last).unwrap_or(0);
    // A gap before grows.
    let begins = if let What::Gap { first, .. } = first.what { first } else { first.number };
    if begins == number && matches!(first.what, What::Gap { .. }) {
        return Ok(());
    }
    transaction.execute("DELETE FROM events WHERE number <= ?1", [last])?;
    transaction.execute("UPDATE about SET event_bytes = event_bytes - ?1", [size])?;
    let what = What::Gap { first: begins, lost: number + 1 - begins };
    // Of now, so that age does not give it up at once.
    put(transaction, &Event { number, what, job: None, unix_s: newest.unix_s, ..newest.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::payloads::Job;

    const DAY: f64 = 86_400.0;

    fn fault(message: &str) -> What {
        What::Fault { code: "x".into(), message: message.into() }
    }

    fn open(folder: &Path, limits: Limits) -> Store {
        Store::open(&folder.join("fleet.sqlite"), "c1", "first", limits).unwrap()
    }

    fn numbers(store: &Store) -> Vec<u64> {
        store.undelivered(1000).unwrap().iter().map(|event| event.number).collect()
    }

    /// Every number from 1 on is there or in a gap, in order.
    fn whole(store: &Store, last: u64) {
        let mut next = 1;
        for event in store.undelivered(u32::MAX).unwrap() {
            match event.what {
                What::Gap { first, lost } => {
                    assert_eq!((first, event.number), (next, first + lost - 1), "{event:?}");
                }
                _ => assert_eq!(event.number, next),
            }
            next = event.number + 1;
        }
        assert_eq!(next, last + 1);
    }

    #[test]
    fn events_stay_in_order_until_delivered_and_go_on_after_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = open(folder.path(), Limits::USUAL);
        (0..5).for_each(|n| drop(store.record(None, fault("a"), f64::from(n)).unwrap()));
        store.delivered(2).unwrap();
        assert_eq!(numbers(&store), [3, 4, 5]);
        drop(store);
        let mut store = open(folder.path(), Limits::USUAL);
        let event = store.record(Some("tidy".into()), fault("b"), 9.0).unwrap();
        assert_eq!((event.number, event.series.as_str()), (6, "first"));
        store.delivered(6).unwrap();
        assert_eq!((store.waiting().unwrap(), numbers(&store)), (0, vec![]));
        assert_eq!(store.record(None, fault("c"), 10.0).unwrap().number, 7, "no number is given twice");
    }

    #[test]
    fn too_many_events_leave_one_gap_that_names_what_is_missing() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = open(folder.path(), Limits { bytes: 20_000, days: 7.0 });
        for n in 1..=500_u32 {
            store.record(None, fault(&"a".repeat(100)), f64::from(n)).unwrap();
            let bytes: i64 =
                store.database.query_row("SELECT event_bytes FROM about", [], |row| row.get(0)).unwrap();
            assert!(bytes <= 20_500, "{bytes}");
        }
        whole(&store, 500);
        let first = store.undelivered(1).unwrap().remove(0);
        assert!(matches!(first.what, What::Gap { first: 1, lost } if lost > 300), "{first:?}");
        let sum: i64 = store
            .database
            .query_row("SELECT sum(bytes) - (SELECT event_bytes FROM about) FROM events", [], |row| {
                row.get(0)
            })
            .unwrap();
        assert_eq!(sum, 0, "the count of bytes is right");
    }

    #[test]
    fn events_that_a_full_disk_does_not_take_are_a_gap_before_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = open(folder.path(), Limits::USUAL);
        let outcome = Outcome {
            status: "done".into(),
            code: "done".into(),
            message: String::new(),
            moves: 3,
            lower_bound: None,
            seconds: 1.0,
        };
        store.record(None, fault("a"), 1.0).unwrap();
        // SQLite's own limit: beyond it a write fails as on a full disk.
        let pages = |store: &Store, most: &str| {
            let pragma = format!("PRAGMA max_page_count={most}");
            store.database.query_row(&pragma, [], |row| row.get::<_, i64>(0)).unwrap()
        };
        pages(&store, "1");
        let mut taken = 1;
        while store.record(None, fault(&"b".repeat(500)), 2.0).is_ok() {
            taken += 1;
        }
        store.record(None, What::Done { outcome: outcome.clone() }, 3.0).unwrap_err();
        store.record(None, fault(&"b".repeat(500)), 4.0).unwrap_err();
        pages(&store, "1000000");
        let event = store.record(None, What::Done { outcome }, 5.0).unwrap();
        assert_eq!(event.number, taken + 4);
        whole(&store, taken + 4);
        let gaps = store.undelivered(u32::MAX).unwrap().into_iter();
        let gaps: Vec<_> = gaps.filter(|event| matches!(event.what, What::Gap { lost: 3, .. })).collect();
        assert_eq!(gaps.len(), 1, "{gaps:?}");
        let totals = store.totals().unwrap();
        assert_eq!((totals.done, totals.moves), (2, 6), "the jobs among them count");
    }

    #[test]
    fn old_events_leave_a_gap_too() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = open(folder.path(), Limits::USUAL);
        for day in 0..30 {
            store.record(None, fault("a"), f64::from(day) * DAY).unwrap();
        }
        whole(&store, 30);
        assert_eq!(store.undelivered(100).unwrap().len(), 1 + 8);
    }

    #[test]
    fn jobs_in_hand_survive_and_closed_ones_are_remembered_only_if_begun() {
        let folder = tempfile::tempdir().unwrap();
        let entry = |id: &str, kept, begun_here| Entry {
            job: Job::new(id, "text", 1.0),
            target: "any".into(),
            priority: "normal".into(),
            by: "anna".into(),
            kept,
            begun_here,
            outcome: None,
        };
        let mut store = open(folder.path(), Limits::USUAL);
        store.keep(&entry("a", Kept::Claimed, false), 1.0).unwrap();
        store.keep(&entry("b", Kept::Wanted, false), 1.0).unwrap();
        store.keep(&entry("a", Kept::Begun, true), 2.0).unwrap();
        store.keep(&entry("b", Kept::Closed, false), 2.0).unwrap();
        drop(store);
        let mut store = open(folder.path(), Limits::USUAL);
        assert_eq!(store.entries().unwrap(), [entry("a", Kept::Begun, true)]);
        store.keep(&entry("a", Kept::Closed, true), 3.0).unwrap();
        assert_eq!(store.entries().unwrap().len(), 1);
        store.keep(&entry("c", Kept::Wanted, false), 100.0 * DAY).unwrap();
        let jobs: Vec<String> = store.entries().unwrap().into_iter().map(|entry| entry.job.id).collect();
        assert_eq!(jobs, ["c"], "after a quarter of a year nothing of it comes again");
    }

    #[test]
    fn totals_count_what_ended() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = open(folder.path(), Limits::USUAL);
        let done = |status: &str| What::Done {
            outcome: Outcome {
                status: status.into(),
                moves: 4,
                lower_bound: Some(3.0),
                seconds: 20.0,
                ..Outcome::default()
            },
        };
        store.record(Some("a".into()), done("done"), 1.0).unwrap();
        store.record(Some("b".into()), done("failed"), 2.0).unwrap();
        let totals = Totals { done: 1, failed: 1, moves: 8, bound: 6.0, seconds: 40.0 };
        assert_eq!(store.totals().unwrap(), totals);
    }

    #[test]
    fn a_database_of_a_later_celld_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        drop(open(folder.path(), Limits::USUAL));
        let path = folder.path().join("fleet.sqlite");
        Connection::open(&path).unwrap().execute_batch("PRAGMA user_version=9").unwrap();
        let error = Store::open(&path, "c1", "s", Limits::USUAL).unwrap_err();
        assert!(error.to_string().contains("version 9"), "{error}");
    }
}
