//! What the commands that reach the daemon through the state folder have in common.
//!
//! In: `--state` on the command line; faults. Out: the state folder, and a fault with its causes on stderr.

use crate::jobs::journal::JournalError;
use crate::jobs::state::{StateError, StateFolder};
use cell_edge::files::FileError;
use clap::{Args, ValueEnum};
use rearrange::document::chain::chain;
use std::path::{Path, PathBuf};

/// Output for people or programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For people.
    Text,
    /// For programs.
    Json,
}

/// Where the daemon is found.
#[derive(Args, Clone, Debug)]
pub struct StateArg {
    /// The state folder; default: ./state where there is one, else /var/lib/celld.
    #[arg(long, value_name = "DIR")]
    pub state: Option<PathBuf>,
}

/// The state folder of a cell that is not installed, below the present folder.
const HERE: &str = "./state";

/// The state folder of the installed service.
const INSTALLED: &str = "/var/lib/celld";

impl StateArg {
    pub(super) fn folder(&self) -> StateFolder {
        let fallback = || {
            let installed = !Path::new(HERE).exists() && Path::new(INSTALLED).exists();
            PathBuf::from(if installed { INSTALLED } else { HERE })
        };
        StateFolder::new(self.state.clone().unwrap_or_else(fallback))
    }
}

/// Why a command did not come about. All are exit code 1.
#[derive(Debug, thiserror::Error)]
pub(super) enum ClientError {
    #[error("no daemon runs on the state folder {0}; start it with `celld run --config ... --state {0}`")]
    NoDaemon(PathBuf),
    #[error("celld is starting and takes no orders yet: {0}; `celld doctor` says what is missing")]
    Starting(String),
    #[error("the daemon did not take the command within {0} s; see `celld status`")]
    NoAnswer(u64),
    #[error("the daemon took the command and did not answer within {0} s; see `celld status`")]
    NoReply(u64),
    #[error(transparent)]
    State(#[from] StateError),
    #[error(transparent)]
    Files(#[from] FileError),
    #[error(transparent)]
    Journal(#[from] JournalError),
}

/// The error with its causes on stderr; exit code 1.
pub(super) fn complain(error: &ClientError) -> u8 {
    cell_edge::terminal::complain(&chain(error));
    1
}
