//! How the server of a fleet is reached from a terminal, and by whom.
//!
//! In: options, or the `fleet:` section of a cell's configuration. Out: a connection, or why there is none.

use crate::config::fleet::FleetConfig;
use crate::config::load::load_cell;
use crate::fleet::start::{access, fleet, storage};
use cell_fleet::client::Client;
use clap::Args;
use std::path::PathBuf;

/// How the server is reached, and by whom.
#[derive(Args, Clone, Debug)]
pub struct ReachArgs {
    /// A cell's configuration whose `fleet:` section names fleet and server
    #[arg(long, value_name = "FILE", conflicts_with = "server")]
    config: Option<PathBuf>,
    /// The NATS server, as tls://HOST:4222
    #[arg(long, value_name = "URL", default_value = "nats://127.0.0.1:4222")]
    server: String,
    /// Name of the fleet
    #[arg(long, value_name = "NAME", default_value = "fleet")]
    fleet: String,
    /// Credentials of the person at the server
    #[arg(long, value_name = "FILE")]
    credentials: Option<PathBuf>,
    /// File with the seed of the person's nkey, instead
    #[arg(long, value_name = "FILE", conflicts_with = "credentials")]
    nkey: Option<PathBuf>,
    /// Certificate authority of the server, PEM
    #[arg(long, value_name = "FILE")]
    authority: Option<PathBuf>,
    /// JetStream domain of the fleet's server, where SERVER is a leaf node
    #[arg(long, value_name = "NAME")]
    domain: Option<String>,
    /// Name of the person, which the server's permissions enforce [default: that of the system]
    #[arg(long, value_name = "NAME")]
    user: Option<String>,
}

impl ReachArgs {
    fn section(&self) -> Result<FleetConfig, String> {
        let mut section = match &self.config {
            Some(file) => {
                let cell = load_cell(file).map_err(|error| error.to_string())?;
                cell.fleet.ok_or_else(|| format!("{}: it has no `fleet:`", file.display()))?
            }
            None => FleetConfig {
                name: self.fleet.clone(),
                cell: String::new(),
                labels: Vec::new(),
                servers: vec![self.server.clone()],
                credentials: None,
                nkey: None,
                authority: None,
                domain: None,
                replicas: 1,
                keep_bytes: 0,
                keep_days: 0.0,
            },
        };
        if self.credentials.is_some() || self.nkey.is_some() {
            (section.credentials, section.nkey) = (self.credentials.clone(), self.nkey.clone());
        }
        section.authority = self.authority.clone().or(section.authority);
        section.domain = self.domain.clone().or(section.domain);
        Ok(section)
    }

    /// The person's name as a token of a subject.
    fn user(&self) -> Result<String, String> {
        let system = || std::env::var("USER").or_else(|_| std::env::var("LOGNAME")).unwrap_or_default();
        let name = self.user.clone().unwrap_or_else(system);
        let name = if name.is_empty() { "unknown".to_string() } else { name };
        match cell_fleet::subjects::is_name(&name) {
            true => Ok(name),
            false => {
                Err(format!("{name:?} cannot be a name at the server; give --user letters, digits, - and _"))
            }
        }
    }

    /// Connects.
    ///
    /// # Errors
    /// Bad options, or no connection.
    pub async fn client(&self) -> Result<Client, Failure> {
        let section = self.section().map_err(Failure::Usage)?;
        let user = self.user().map_err(Failure::Usage)?;
        let fleet = fleet(&section).map_err(Failure::Usage)?;
        let reach = access(&section, &format!("celld fleet, {user}"));
        let client = Client::open(&reach, fleet, &user, storage(&section)).await;
        client.map_err(|fault| Failure::Failed(fault.to_string()))
    }
}

/// Why a command ends without success.
pub enum Failure {
    /// Bad input: exit code 2.
    Usage(String),
    /// Understood, and not succeeded: exit code 1.
    Failed(String),
    /// Ctrl-C: exit code 130.
    Stopped,
}

impl From<String> for Failure {
    fn from(message: String) -> Failure {
        Failure::Failed(message)
    }
}
