//! Repairs a damaged journal: a new database with every row of the damaged one that can still be read.
//!
//! In: the path of a journal that no celld has open, the time. Out: the new journal in its place, the
//! damaged files beside it under a name with the time, and how many rows of each table were kept and lost.
//! All work is done on copies, so the damaged files are as they were until the new journal is complete,
//! checked and on the disk. Rows that today's celld cannot read, or that the tables' own rules forbid, count
//! as lost.

mod files;
mod salvage;
#[cfg(test)]
mod tests;

use crate::jobs::journal::schema::SCHEMA_VERSION;
use crate::jobs::journal::{Journal, JournalError};
use crate::jobs::utc;
use files::{Workshop, copy_database, graft_first_page, keep_damaged, put_in_place};
use rusqlite::types::{ToSql, Value};
use rusqlite::{Connection, ErrorCode, OptionalExtension, params};
use salvage::read_rows;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

pub use crate::jobs::journal::repair::files::FileFault;

/// The tables, each after those that its rows refer to.
const TABLES: [&str; 3] = ["jobs", "steps", "rejections"];

/// A number of a later version that a person may have used; above it is garbage.
const LATEST_VERSION: i64 = 1000;

/// What was kept of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Kept {
    /// Its name.
    pub table: &'static str,
    /// Rows in the new journal.
    pub rows: u64,
    /// Rows that are not; `None` where the damage hides how many there were.
    pub lost: Option<u64>,
}

/// What a repair did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Repaired {
    /// Nothing: the journal is sound.
    Sound,
    /// A new journal is in place.
    Replaced {
        /// Table by table.
        tables: Vec<Kept>,
        /// The damaged database; its `-wal` and `-shm` are beside it.
        damaged: PathBuf,
    },
}

/// Why a journal was not repaired; its files are still there.
#[derive(Debug, thiserror::Error)]
pub enum RepairError {
    /// The system refused.
    #[error(transparent)]
    Files(#[from] FileFault),
    /// The new journal cannot be written, or the old one is of a later version of celld.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// SQLite refuses to work on the copy at all.
    #[error("copy {path} of the damaged journal")]
    Copy {
        /// The copy.
        path: PathBuf,
        /// The cause.
        #[source]
        source: rusqlite::Error,
    },
}

/// Repairs the journal at `path`, which no process may have open. A sound journal is left as it is.
///
/// # Errors
/// The files cannot be read, written or renamed ([`RepairError::Files`]); the new journal cannot be written,
/// or the old one is of a later version ([`RepairError::Journal`]). The damaged files are kept in any case.
pub fn repair(path: &Path, unix_s: f64) -> Result<Repaired, RepairError> {
    let real =
        path.canonicalize().map_err(|source| FileFault { action: "find", path: path.to_owned(), source })?;
    let workshop = Workshop::make(&real)?;
    let copy = workshop.file("copy.sqlite");
    let was_cut_off = copy_database(&real, &copy)?;
    if !was_cut_off && is_sound(&copy) {
        return Ok(Repaired::Sound);
    }
    copy_database(&real, &copy)?;
    if let Some(found) = later_version(&copy) {
        return Err(JournalError::Version { path: real, found }.into());
    }
    let mut new = workshop.file("new.sqlite");
    let mut tables = rebuild(&copy, &new)?;
    if tables.first().is_none_or(|jobs| jobs.rows == 0) {
        // Without its first page a database is unreadable; that page is the same in every new journal.
        copy_database(&real, &copy)?;
        let page = workshop.file("empty.sqlite");
        at_rest(Journal::open(&page)?)?;
        set_wal(&page)?;
        graft_first_page(&page, &copy)?;
        let other = workshop.file("grafted.sqlite");
        let found = rebuild(&copy, &other)?;
        if all_rows(&found) >= all_rows(&tables) {
            (new, tables) = (other, found);
        }
    }
    let damaged = keep_damaged(&real, &utc::compact(unix_s))?;
    put_in_place(&new, &real)?;
    Ok(Repaired::Replaced { tables, damaged })
}

fn all_rows(tables: &[Kept]) -> u64 {
    tables.iter().map(|kept| kept.rows).sum()
}

/// True for a journal that SQLite finds whole and of which celld can read every row.
fn is_sound(copy: &Path) -> bool {
    let Ok(journal) = Journal::open_to_read(copy) else { return false };
    let check = "PRAGMA integrity_check(1)";
    let whole = journal.database.query_row(check, [], |row| row.get::<_, String>(0));
    whole.is_ok_and(|found| found == "ok")
        && TABLES.iter().all(|table| {
            let numbers =
                journal.database.prepare(&format!("SELECT rowid FROM {table}")).and_then(|mut rows| {
                    rows.query_map([], |row| row.get::<_, i64>(0))?.collect::<Result<Vec<_>, _>>()
                });
            numbers.is_ok_and(|numbers| numbers.iter().all(|row| journal.is_readable(table, *row)))
        })
}

fn open_damaged(copy: &Path) -> Result<Connection, RepairError> {
    let fail = |source| RepairError::Copy { path: copy.to_owned(), source };
    let database = Connection::open(copy).map_err(fail)?;
    // With this SQLite reads what is there of a file that is cut off, or whose schema has a damaged entry.
    match database.execute_batch("PRAGMA writable_schema=ON") {
        Err(source) if !is_damage(&source) => Err(fail(source)),
        _ => Ok(database),
    }
}

fn is_damage(error: &rusqlite::Error) -> bool {
    matches!(error.sqlite_error_code(), Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase))
}

fn later_version(copy: &Path) -> Option<i64> {
    let database = open_damaged(copy).ok()?;
    let found = database.query_row("PRAGMA user_version", [], |row| row.get(0)).ok()?;
    (SCHEMA_VERSION + 1..=LATEST_VERSION).contains(&found).then_some(found)
}

/// Writes a new journal with the readable rows of the damaged one, checked and at rest.
fn rebuild(damaged: &Path, new: &Path) -> Result<Vec<Kept>, RepairError> {
    let source = open_damaged(damaged)?;
    let journal = Journal::open(new)?;
    let fail = |source| RepairError::from(journal.fail(source));
    journal.database.execute_batch("BEGIN IMMEDIATE").map_err(fail)?;
    let mut tables = Vec::new();
    for table in TABLES {
        tables.push(journal.take_over(&source, table)?);
    }
    journal.keep_counters(&source)?;
    journal.database.execute_batch("COMMIT").map_err(fail)?;
    journal.check_pages()?;
    at_rest(journal)?;
    Ok(tables)
}

/// Brings everything from the log into the database, which is one file then.
fn at_rest(journal: Journal) -> Result<(), JournalError> {
    let rest = "PRAGMA journal_mode=DELETE";
    journal.database.query_row(rest, [], |_| Ok(())).map_err(|source| journal.fail(source))
}

/// Marks a database at rest as one with a write-ahead log, so that SQLite reads the log beside a copy.
fn set_wal(path: &Path) -> Result<(), RepairError> {
    let fail = |source| RepairError::Copy { path: path.to_owned(), source };
    let database = Connection::open(path).map_err(fail)?;
    database.query_row("PRAGMA journal_mode=WAL", [], |_| Ok(())).map_err(fail)
}

fn columns_of(database: &Connection, table: &str) -> Result<Vec<String>, rusqlite::Error> {
    let mut rows = database.prepare(&format!("PRAGMA table_info({table})"))?;
    rows.query_map([], |row| row.get(1))?.collect()
}

impl Journal {
    /// Inserts what can be read of a damaged table.
    fn take_over(&self, source: &Connection, table: &'static str) -> Result<Kept, JournalError> {
        let known = columns_of(&self.database, table).map_err(|e| self.fail(e))?;
        let mut columns = columns_of(source, table).unwrap_or_default();
        // `sequence` is the row's number.
        columns.retain(|column| known.contains(column) && column != "sequence");
        let (mut rows, mut read) = (0, 0);
        let mut take = |row: i64, values: Option<Vec<Value>>| {
            read += 1;
            let kept = values.map_or(Ok(false), |values| self.take_row(table, &columns, row, values));
            match kept {
                Ok(kept) => {
                    rows += u64::from(kept);
                    ControlFlow::Continue(())
                }
                Err(error) => ControlFlow::Break(error),
            }
        };
        let whole = match read_rows(source, table, &columns, &mut take) {
            Ok(ControlFlow::Break(error)) => return Err(self.fail(error)),
            Ok(ControlFlow::Continue(whole)) => whole && !columns.is_empty(),
            Err(_) => false,
        };
        // An index can be whole where the table is not, and the other way round.
        let count = format!("SELECT count(*) FROM {table}");
        let counted = source.query_row(&count, [], |row| row.get::<_, i64>(0));
        let counted = counted.ok().and_then(|count| u64::try_from(count).ok());
        let all =
            if whole { Some(counted.unwrap_or(read).max(read)) } else { counted.filter(|all| *all >= read) };
        Ok(Kept { table, rows, lost: all.map(|all| all - rows) })
    }

    /// Inserts one row; false where the tables' rules forbid it, or celld could not read it back.
    fn take_row(
        &self,
        table: &str,
        columns: &[String],
        row: i64,
        values: Vec<Value>,
    ) -> Result<bool, rusqlite::Error> {
        let places: String = (0..values.len()).map(|at| format!(", ?{}", at + 2)).collect();
        let names: String = columns.iter().map(|column| format!(", {column}")).collect();
        let insert = format!("INSERT INTO {table} (rowid{names}) VALUES (?1{places})");
        let mut all: Vec<&dyn ToSql> = vec![&row];
        all.extend(values.iter().map(|value| value as &dyn ToSql));
        match self.database.prepare_cached(&insert)?.execute(all.as_slice()) {
            Err(error) if error.sqlite_error_code() == Some(ErrorCode::ConstraintViolation) => {
                return Ok(false);
            }
            other => other?,
        };
        if self.is_readable(table, row) {
            return Ok(true);
        }
        self.database.execute(&format!("DELETE FROM {table} WHERE rowid = ?1"), [row])?;
        Ok(false)
    }

    /// True where celld can read the row.
    fn is_readable(&self, table: &str, row: i64) -> bool {
        match table {
            "jobs" => self.select("WHERE sequence = ?1", params![row]).is_ok_and(|found| found.len() == 1),
            "steps" => self.step_at(row).is_ok(),
            _ => self.rejection_at(row).is_ok(),
        }
    }

    /// Takes over the highest numbers that were ever given, so that none is given twice.
    fn keep_counters(&self, source: &Connection) -> Result<(), JournalError> {
        for table in ["jobs", "rejections"] {
            let select = "SELECT seq FROM sqlite_sequence WHERE name = ?1";
            let seq = source.query_row(select, [table], |row| row.get::<_, i64>(0)).optional();
            let Some(seq) = seq.ok().flatten().filter(|seq| (1..salvage::HIGHEST_ROW).contains(seq)) else {
                continue;
            };
            let update = "UPDATE sqlite_sequence SET seq = max(seq, ?2) WHERE name = ?1";
            let insert = "INSERT INTO sqlite_sequence (name, seq) VALUES (?1, ?2)";
            let changed = self.database.execute(update, params![table, seq]).map_err(|e| self.fail(e))?;
            if changed == 0 {
                self.database.execute(insert, params![table, seq]).map_err(|e| self.fail(e))?;
            }
        }
        Ok(())
    }
}
