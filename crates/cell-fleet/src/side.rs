//! The cell as its part in the fleet sees it, and what the configuration says of that part.
//!
//! In and out: what [`crate::run`] needs from the daemon: state, events, the journal, the spool, orders.
//! Nothing of it arms, resumes, recovers or releases.

use crate::connect::Access;
use crate::files::{FileKind, FileToSend};
use crate::fragments::Wanted;
use crate::payloads::{CellState, Job, What};
use crate::server::Storage;
use crate::store::Limits;
use crate::subjects::{Fleet, RequestKind};
use crate::values::Local;
use std::path::PathBuf;
use tokio::sync::oneshot;

/// What an order is answered with, later.
pub type Ordered = oneshot::Receiver<(bool, String)>;

/// Files that are requested, later.
pub type FilesRequested = oneshot::Receiver<Result<Vec<FileToSend>, String>>;

/// Where a cell is with its configuration fragment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FragmentState {
    /// The one it runs with.
    pub runs: Option<u64>,
    /// The one it is to run with, as soon as it is idle and disarmed; 0: with its own configuration alone.
    pub waits: Option<u64>,
    /// Why it cannot.
    pub fault: Option<String>,
}

/// What has happened in the cell.
#[derive(Clone, Debug, PartialEq)]
pub struct CellEvent {
    /// The job it is about.
    pub job: Option<String>,
    /// What.
    pub what: What,
    /// When, s since 1970.
    pub unix_s: f64,
}

/// The cell, as its part in the fleet sees it. All of it is what other clients of the daemon have too.
pub trait CellSide: Send {
    /// The cell's state; what only the fleet knows is filled in later.
    fn state(&mut self) -> CellState;

    /// What has happened since the last call.
    fn events(&mut self) -> Vec<CellEvent>;

    /// Whether the cell can do a job.
    ///
    /// # Errors
    /// Why not.
    fn judge(&mut self, job: &Job) -> Result<(), String>;

    /// Puts a job into the spool, under its id.
    ///
    /// # Errors
    /// What the disk says.
    fn hand_in(&mut self, job: &Job) -> Result<(), String>;

    /// What the journal says of a job.
    ///
    /// # Errors
    /// It cannot be read.
    fn look(&mut self, job: &str) -> Result<Local, String>;

    /// Gives an order in the name of a person; the answer comes after it was decided. To approve goes with
    /// the number of the plan that the person was shown.
    fn order(&mut self, requested: RequestKind, job: &str, plan: Option<u64>, by: &str) -> Ordered;

    /// The files of a job, of these kinds; nothing waits for them.
    fn files(&mut self, job: &str, kinds: &[FileKind]) -> FilesRequested;

    /// What the cell should run with; it takes that when it is idle and disarmed, by starting anew. `None`:
    /// nothing is known of it.
    fn fragment(&mut self, wanted: Option<Wanted<'_>>) -> FragmentState;

    /// What is wrong with the cell's part in the fleet, for its own log and status; empty when nothing is.
    fn complaints(&mut self, complaints: &[String]);
}

/// What the configuration says.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The fleet.
    pub fleet: Fleet,
    /// This cell's name.
    pub cell: String,
    /// Its labels.
    pub labels: Vec<String>,
    /// The server.
    pub access: Access,
    /// What is made there if it is missing.
    pub storage: Storage,
    /// The own database.
    pub database: PathBuf,
    /// Names the events of a new database.
    pub series: String,
    /// How much waits for the network.
    pub limits: Limits,
}
