//! One cell of the storm: its part in the fleet is the real one, its journal a small one.
//!
//! In: a folder, server and work by the environment. Out: `journal.sqlite` there, written through to the
//! disk: one row a job, and one row each time that the arm sets out. Ends by being killed.

use crate::work::{Ended, Timed, Virtual, Work};
use cell_fleet::connect::Access;
use cell_fleet::files::FileKind;
use cell_fleet::fragments::Wanted;
use cell_fleet::payloads::{CellState, Job, Outcome};
use cell_fleet::run::run as take_part;
use cell_fleet::server::Storage;
use cell_fleet::side::{CellEvent, CellSide, FilesRequested, FragmentState, Ordered, Settings};
use cell_fleet::store::Limits;
use cell_fleet::subjects::{Fleet, RequestKind};
use cell_fleet::values::Local;
use rusqlite::{Connection, OptionalExtension};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::oneshot;

struct Side {
    journal: Connection,
    work: Box<dyn Work>,
    busy: bool,
}

fn fault(error: rusqlite::Error) -> String {
    error.to_string()
}

impl Side {
    fn open(folder: &Path, work: Box<dyn Work>) -> Side {
        let journal = Connection::open(folder.join("journal.sqlite")).unwrap();
        journal
            .execute_batch(
                "PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL;
                 CREATE TABLE IF NOT EXISTS job (id TEXT PRIMARY KEY, status TEXT, moves INTEGER);
                 CREATE TABLE IF NOT EXISTS carried (id TEXT);
                 UPDATE job SET status='interrupted' WHERE status IS NULL;",
            )
            .unwrap();
        Side { journal, work, busy: false }
    }

    fn work(&mut self) {
        if let Some(Ended { job, status, moves }) = self.work.ended() {
            let row = "UPDATE job SET status=?2, moves=?3 WHERE id=?1";
            self.journal.execute(row, (job, status, moves)).unwrap();
            self.busy = false;
        }
    }
}

/// How many jobs a cell has carried out to their end, and with how many moves.
pub fn done(folder: &Path) -> (i64, i64) {
    let journal = Connection::open(folder.join("journal.sqlite")).unwrap();
    let sums = "SELECT count(*), coalesce(sum(moves), 0) FROM job WHERE status='done'";
    journal.query_row(sums, [], |row| Ok((row.get(0)?, row.get(1)?))).unwrap()
}

/// The jobs that a cell has set out for, once for each time.
pub fn carried_out(folder: &Path) -> Vec<String> {
    let journal = Connection::open(folder.join("journal.sqlite")).unwrap();
    let mut rows = journal.prepare("SELECT id FROM carried").unwrap();
    let rows = rows.query_map([], |row| row.get(0)).unwrap();
    rows.map(Result::unwrap).collect()
}

impl CellSide for Side {
    fn state(&mut self) -> CellState {
        self.work();
        let (armed, idle) = (self.work.is_ready(), !self.busy);
        CellState { armed, idle, state: "idle".into(), ..CellState::default() }
    }

    fn events(&mut self) -> Vec<CellEvent> {
        Vec::new()
    }

    fn judge(&mut self, _: &Job) -> Result<(), String> {
        Ok(())
    }

    fn hand_in(&mut self, job: &Job) -> Result<(), String> {
        // Both rows or none: the real journal has one.
        let both = self.journal.unchecked_transaction().map_err(fault)?;
        let new =
            self.journal.execute("INSERT OR IGNORE INTO job (id) VALUES (?1)", [&job.id]).map_err(fault)?;
        if new == 1 {
            self.journal.execute("INSERT INTO carried (id) VALUES (?1)", [&job.id]).map_err(fault)?;
            both.commit().map_err(fault)?;
            self.work.begin(&job.id);
            self.busy = true;
        }
        Ok(())
    }

    fn look(&mut self, job: &str) -> Result<Local, String> {
        self.work();
        let mut row =
            self.journal.prepare_cached("SELECT status, moves FROM job WHERE id=?1").map_err(fault)?;
        let found: Option<(Option<String>, Option<i64>)> =
            row.query_row([job], |row| Ok((row.get(0)?, row.get(1)?))).optional().map_err(fault)?;
        Ok(match found {
            None => Local::Unknown,
            Some((None, _)) => Local::Open,
            Some((Some(status), moves)) => Local::Ended(Outcome {
                status,
                moves: u32::try_from(moves.unwrap_or(0)).unwrap_or(0),
                ..Outcome::default()
            }),
        })
    }

    fn order(&mut self, _: RequestKind, _: &str, _: Option<u64>, _: &str) -> Ordered {
        oneshot::channel().1
    }

    fn files(&mut self, _: &str, _: &[FileKind]) -> FilesRequested {
        oneshot::channel().1
    }

    fn fragment(&mut self, _: Option<Wanted<'_>>) -> FragmentState {
        FragmentState::default()
    }

    fn complaints(&mut self, _: &[String]) {}
}

/// The machine in virtual time, with a seed of the cell's own; with a number of milliseconds only that.
fn work(name: &str, takes_ms: &str) -> Box<dyn Work> {
    match takes_ms.parse() {
        Ok(ms) => Box::new(Timed { takes: Duration::from_millis(ms), works: None }),
        Err(_) => {
            let number = name.trim_start_matches("cell-").parse().unwrap_or(0);
            Box::new(Virtual::start(number))
        }
    }
}

/// Takes part until the process is killed.
pub fn run(folder: &Path) {
    let variable = |name: &str| std::env::var(name).unwrap();
    let name = folder.file_name().unwrap().to_string_lossy().into_owned();
    let side = Side::open(folder, work(&name, &variable("CELLD_STORM_TAKES_MS")));
    let settings = Settings {
        fleet: Fleet::new(super::FLEET).unwrap(),
        cell: name.clone(),
        labels: Vec::new(),
        access: Access {
            servers: variable("CELLD_STORM_NATS").split(',').map(str::to_string).collect(),
            credentials: None,
            authority: None,
            tls: false,
            domain: None,
            name,
        },
        storage: Storage { replicas: variable("CELLD_STORM_NODES").parse().unwrap(), ..Storage::USUAL },
        database: folder.join("fleet.sqlite"),
        series: "storm".to_string(),
        limits: Limits::USUAL,
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(take_part(settings, Box::new(side), Arc::default()));
}
