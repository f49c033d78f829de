//! Reads the rows of a damaged table one by one.
//!
//! In: a connection to a damaged database, a table's name. Out: every row that SQLite can still reach, once,
//! and whether the whole table was read. SQLite ends a query at the first damaged page, so each row is a
//! query of its own: forwards from the first row until one fails, backwards from the last, then into the gap
//! between with steps that grow with the distance from the last row found.

use rusqlite::types::Value;
use rusqlite::{Connection, Row, Statement, params};
use std::ops::ControlFlow;

/// Row numbers above this come from damaged pages: no journal counts so far, and the next row has to have a
/// higher number than all before.
pub(super) const HIGHEST_ROW: i64 = 1 << 40;

/// Queries into gaps, for one table.
const PROBES: u32 = 1_000_000;

/// A probe that finds nothing is followed by one this part of the distance further on, so that the first
/// rows behind a gap are tried one by one and the end of the numbers is reached all the same.
const GROWTH: i64 = 1024;

/// A row that was read; `None` for values that no celld writes (binary data, text that is not UTF-8).
pub(super) type Values = Option<Vec<Value>>;

/// Takes a row's number and values; `Break` ends the reading.
pub(super) type Take<'a, E> = &'a mut dyn FnMut(i64, Values) -> ControlFlow<E>;

/// What one query found.
enum Found {
    Row(i64, Values),
    Nothing,
    Unreadable,
}

/// The queries for one table.
struct Table<'a> {
    upwards: Statement<'a>,
    downwards: Statement<'a>,
}

impl<'a> Table<'a> {
    fn open(source: &'a Connection, table: &str, columns: &[String]) -> Result<Table<'a>, rusqlite::Error> {
        let columns: String = columns.iter().map(|column| format!(", {column}")).collect();
        let query = |order: &str| {
            source.prepare(&format!(
                "SELECT rowid{columns} FROM {table} NOT INDEXED WHERE rowid > ?1 AND rowid < ?2
                 ORDER BY rowid {order} LIMIT 1"
            ))
        };
        Ok(Table { upwards: query("ASC")?, downwards: query("DESC")? })
    }

    fn first_between(&mut self, above: i64, below: i64) -> Found {
        one(&mut self.upwards, above, below)
    }

    fn last_between(&mut self, above: i64, below: i64) -> Found {
        one(&mut self.downwards, above, below)
    }

    /// Reads on from `above` towards `below`; the last row found, and whether all of it was read.
    fn read_up<E>(&mut self, mut above: i64, below: i64, take: Take<E>) -> ControlFlow<E, (i64, bool)> {
        loop {
            match self.first_between(above, below) {
                Found::Row(row, values) => {
                    take(row, values)?;
                    above = row;
                }
                Found::Nothing => return ControlFlow::Continue((above, true)),
                Found::Unreadable => return ControlFlow::Continue((above, false)),
            }
        }
    }

    /// The same backwards from `below`.
    fn read_down<E>(&mut self, above: i64, mut below: i64, take: Take<E>) -> ControlFlow<E, (i64, bool)> {
        loop {
            match self.last_between(above, below) {
                Found::Row(row, values) => {
                    take(row, values)?;
                    below = row;
                }
                Found::Nothing => return ControlFlow::Continue((below, true)),
                Found::Unreadable => return ControlFlow::Continue((below, false)),
            }
        }
    }

    /// Reads what is between the last row from the front and the first one from the end.
    fn read_gap<E>(&mut self, mut above: i64, below: i64, take: Take<E>) -> ControlFlow<E> {
        let mut probe = above;
        for _ in 0..PROBES {
            if probe >= below {
                break;
            }
            match self.first_between(probe, below) {
                Found::Nothing => break,
                Found::Unreadable => probe += 1 + (probe - above) / GROWTH,
                Found::Row(row, values) => {
                    take(row, values)?;
                    self.read_down(above, row, take)?;
                    let (last, all) = self.read_up(row, below, take)?;
                    if all {
                        break;
                    }
                    (above, probe) = (last, last);
                }
            }
        }
        ControlFlow::Continue(())
    }
}

fn one(query: &mut Statement, above: i64, below: i64) -> Found {
    let columns = query.column_count();
    let read = |row: &Row| Ok((row.get::<_, i64>(0)?, (1..columns).map(|at| value(row, at)).collect()));
    match query.query_row(params![above, below], read) {
        // A damaged page can be out of order: a row twice, or the way back.
        Ok((row, values)) if row > above && row < below => Found::Row(row, values),
        Err(rusqlite::Error::QueryReturnedNoRows) => Found::Nothing,
        _ => Found::Unreadable,
    }
}

fn value(row: &Row, at: usize) -> Option<Value> {
    row.get::<_, Value>(at).ok().filter(|value| !matches!(value, Value::Blob(_)))
}

/// Hands every readable row of `table` to `take`; true when SQLite read the table without an error.
///
/// # Errors
/// The table cannot be read at all.
pub(super) fn read_rows<E>(
    source: &Connection,
    table: &str,
    columns: &[String],
    take: Take<E>,
) -> Result<ControlFlow<E, bool>, rusqlite::Error> {
    Ok(read_all(&mut Table::open(source, table, columns)?, take))
}

fn read_all<E>(table: &mut Table, take: Take<E>) -> ControlFlow<E, bool> {
    let (last, all) = table.read_up(0, HIGHEST_ROW, take)?;
    if all {
        return ControlFlow::Continue(true);
    }
    let (first, all) = table.read_down(last, HIGHEST_ROW, take)?;
    if !all {
        table.read_gap(last, first, take)?;
    }
    ControlFlow::Continue(false)
}
