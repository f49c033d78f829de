//! The thread of the cell's part in the fleet.
//!
//! In: the configuration's section and what the daemon has. Out: a thread that ends with `stop`, and the
//! statuses' way to it, which never waits: a thread that is behind loses statuses and looks at the last.

use crate::config::fleet::FleetConfig;
use crate::fleet::side::{Daemon, Side, Written};
use crate::jobs::status::Status;
use cell_edge::clock::unix_now_s;
use cell_fleet::connect::{Access, Credentials};
use cell_fleet::run::run;
use cell_fleet::server::Storage;
use cell_fleet::side::Settings;
use cell_fleet::store::Limits;
use cell_fleet::subjects::Fleet;
use std::fmt::Write as _;
use std::sync::mpsc::{SyncSender, sync_channel};

/// Statuses that wait to be looked at: more than a minute's worth of them.
const BEHIND: usize = 256;

/// How the server is reached, by the configuration.
pub fn access(config: &FleetConfig, name: &str) -> Access {
    let credentials = match (&config.credentials, &config.nkey) {
        (Some(file), _) => Some(Credentials::File(file.clone())),
        (None, Some(seed)) => Some(Credentials::Nkey(seed.clone())),
        (None, None) => None,
    };
    Access {
        servers: config.servers.clone(),
        credentials,
        authority: config.authority.clone(),
        tls: config.servers.iter().any(|server| FleetConfig::is_tls(server)),
        name: name.to_string(),
        domain: config.domain.clone(),
    }
}

/// What is made on the server where it is missing.
pub fn storage(config: &FleetConfig) -> Storage {
    Storage { replicas: usize::from(config.replicas), ..Storage::USUAL }
}

/// The fleet that the section names.
///
/// # Errors
/// The name cannot be a token.
pub fn fleet(config: &FleetConfig) -> Result<Fleet, String> {
    Fleet::new(&config.name).ok_or_else(|| format!("{:?} is no name of a fleet", config.name))
}

/// Where statuses go.
pub struct Statuses(SyncSender<Written>);

impl Statuses {
    /// Passes a status on, or drops it where too many wait.
    pub fn written(&self, status: &Status) {
        // The thread looks at the last status anyhow.
        let _ = self.0.try_send((status.clone(), unix_now_s()));
    }
}

/// Starts the thread.
///
/// # Errors
/// A name that cannot be one, no random numbers, no thread.
pub fn start(section: &FleetConfig, daemon: Daemon) -> Result<Statuses, String> {
    let stop = daemon.stop.clone();
    let settings = Settings {
        fleet: fleet(section)?,
        cell: section.cell.clone(),
        labels: section.labels.clone(),
        access: access(section, &format!("celld cell {}", section.cell)),
        storage: storage(section),
        database: daemon.state.root().join("fleet.sqlite"),
        series: series()?,
        limits: Limits { bytes: section.keep_bytes, days: section.keep_days },
    };
    let (sender, statuses) = sync_channel(BEHIND);
    let side = Side::new(daemon, statuses);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
    let runtime = runtime.map_err(|error| format!("fleet: {error}"))?;
    let work = move || runtime.block_on(run(settings, Box::new(side), stop));
    std::thread::Builder::new()
        .name("fleet".to_string())
        .spawn(work)
        .map_err(|error| format!("fleet: {error}"))?;
    Ok(Statuses(sender))
}

/// A name for the events of a new database, unlike any before.
fn series() -> Result<String, String> {
    let mut bytes = [0_u8; 6];
    getrandom::fill(&mut bytes).map_err(|error| format!("no random numbers: {error}"))?;
    Ok(bytes.iter().fold(String::new(), |mut hex, byte| {
        let _ = write!(hex, "{byte:02x}");
        hex
    }))
}
