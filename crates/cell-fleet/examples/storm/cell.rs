//! One cell of the storm: its part in the fleet is the real one, its work is only time.
//!
//! In: a folder, the server by the environment. Out: `journal.sqlite` there, written through to the disk:
//! one row a job, and one row each time that the arm would set out. Ends by being killed.

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
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

struct Side {
    journal: Connection,
    takes: Duration,
    /// The job that is worked on, and when it is over.
    works: Option<(String, Instant)>,
}

fn fault(error: rusqlite::Error) -> String {
    error.to_string()
}

impl Side {
    fn open(folder: &Path, takes: Duration) -> Side {
        let journal = Connection::open(folder.join("journal.sqlite")).unwrap();
        journal
            .execute_batch(
                "PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL;
                 CREATE TABLE IF NOT EXISTS job (id TEXT PRIMARY KEY, status TEXT);
                 CREATE TABLE IF NOT EXISTS carried (id TEXT);
                 UPDATE job SET status='interrupted' WHERE status IS NULL;",
            )
            .unwrap();
        Side { journal, takes, works: None }
    }

    fn work(&mut self) {
        if let Some((job, _)) = self.works.take_if(|(_, over)| *over <= Instant::now()) {
            self.journal.execute("UPDATE job SET status='done' WHERE id=?1", [job]).unwrap();
        }
    }
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
        let idle = self.works.is_none();
        CellState { armed: true, idle, state: "idle".into(), ..CellState::default() }
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
            self.works = Some((job.id.clone(), Instant::now() + self.takes));
        }
        Ok(())
    }

    fn look(&mut self, job: &str) -> Result<Local, String> {
        self.work();
        let mut row = self.journal.prepare_cached("SELECT status FROM job WHERE id=?1").map_err(fault)?;
        let status: Option<Option<String>> =
            row.query_row([job], |row| row.get(0)).optional().map_err(fault)?;
        Ok(match status {
            None => Local::Unknown,
            Some(None) => Local::Open,
            Some(Some(status)) => Local::Ended(Outcome { status, moves: 2, ..Outcome::default() }),
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

/// Takes part until the process is killed.
pub fn run(folder: &Path) {
    let variable = |name: &str| std::env::var(name).unwrap();
    let takes = Duration::from_millis(variable("CELLD_STORM_TAKES_MS").parse().unwrap());
    let name = folder.file_name().unwrap().to_string_lossy().into_owned();
    let settings = Settings {
        fleet: Fleet::new(super::FLEET).unwrap(),
        cell: name.clone(),
        labels: Vec::new(),
        access: Access {
            servers: variable("CELLD_STORM_NATS").split(',').map(str::to_string).collect(),
            credentials: None,
            authority: None,
            tls: false,
            name,
        },
        storage: Storage { replicas: variable("CELLD_STORM_NODES").parse().unwrap(), ..Storage::USUAL },
        database: folder.join("fleet.sqlite"),
        series: "storm".to_string(),
        limits: Limits::USUAL,
    };
    let side = Side::open(folder, takes);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(take_part(settings, Box::new(side), Arc::default()));
}
