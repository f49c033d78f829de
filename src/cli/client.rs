//! What the commands that reach the daemon through the state folder have in common.
//!
//! In: `--state` on the command line; faults. Out: the state folder, and a fault with its causes on stderr.

use crate::jobs::command::{Command, FOR_ANOTHER, Given, Sent};
use crate::jobs::journal::JournalError;
use crate::jobs::state::{StateError, StateFolder};
use crate::jobs::status::{STARTING, Status};
use cell_edge::clock::{boot_now_s, unix_now_s};
use cell_edge::files::FileError;
use cell_edge::terminal::in_shell;
use cell_machine::orders::Reply;
use clap::{Args, ValueEnum};
use rearrange::document::chain::chain;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

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
    #[error("no daemon runs on the state folder {state}; {start} starts it")]
    NoDaemon { state: PathBuf, start: String },
    #[error("celld is starting and takes no orders yet: {0}; `celld doctor` says what is missing")]
    Starting(String),
    #[error("the daemon did not take the command within {0} s; see `celld status`")]
    NoAnswer(u64),
    #[error("the daemon took the command and did not answer within {0} s; see `celld status`")]
    NoReply(u64),
    #[error("the terminal fails")]
    Terminal(#[source] std::io::Error),
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

/// A complaint about usage on stderr; exit code 2.
pub(super) fn exit_2(text: &str) -> u8 {
    cell_edge::terminal::complain(text);
    2
}

/// How long a daemon may take to answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(10);

/// How long a daemon may take from its start to its first status.
const START_WITHIN: Duration = Duration::from_secs(20);

/// How often the answer is looked for.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Gives a command and waits for its answer.
pub(super) fn request(state: &StateFolder, command: &Command) -> Result<Reply, ClientError> {
    let status = running_daemon(state)?;
    if status.state == STARTING {
        return Err(ClientError::Starting(status.message));
    }
    sent(state, &status.daemon, command)
}

/// The same for what a daemon that waits for its robot takes too; one that has just been started is waited
/// for.
pub(super) fn request_at_start(state: &StateFolder, command: &Command) -> Result<Reply, ClientError> {
    let begun = Instant::now();
    loop {
        let answered = running_daemon(state).and_then(|status| sent(state, &status.daemon, command));
        match answered {
            // Its status may still be that of an earlier daemon, whose name no command reaches.
            Err(ClientError::NoDaemon { .. } | ClientError::NoAnswer(_) | ClientError::NoReply(_))
                if begun.elapsed() < START_WITHIN && state.is_taken()? =>
            {
                std::thread::sleep(LOOK_EVERY);
            }
            Ok(reply) if reply.message == FOR_ANOTHER && begun.elapsed() < START_WITHIN => {
                std::thread::sleep(LOOK_EVERY);
            }
            answered => return answered,
        }
    }
}

fn sent(state: &StateFolder, daemon: &str, command: &Command) -> Result<Reply, ClientError> {
    let given = Given { unix_s: unix_now_s(), boot_s: boot_now_s() };
    let sent = Sent::send(&state.commands(), daemon, command, given)?;
    let begun = Instant::now();
    while begun.elapsed() < ANSWER_WITHIN {
        if let Some(reply) = sent.poll()? {
            return Ok(reply);
        }
        std::thread::sleep(LOOK_EVERY);
    }
    // Taken back, so that it is not obeyed once it is no longer expected.
    let seconds = ANSWER_WITHIN.as_secs();
    Err(if sent.withdraw()? { ClientError::NoAnswer(seconds) } else { ClientError::NoReply(seconds) })
}

/// The status of the daemon that runs on `state`.
fn running_daemon(state: &StateFolder) -> Result<Status, ClientError> {
    let none = |last: Option<&Status>| ClientError::NoDaemon {
        state: state.root().to_owned(),
        start: start_line(state, last),
    };
    // The lock first: a daemon that ends in between has written its status before it lets go of that.
    let runs = state.is_taken()?;
    match Status::read(&state.status())? {
        Some(status) if runs => Ok(status),
        last => Err(none(last.as_ref())),
    }
}

/// The command that starts the daemon on a state folder: with the configuration that ran there last.
pub(super) fn start_line(state: &StateFolder, last: Option<&Status>) -> String {
    if state.root() == Path::new(INSTALLED) {
        return "`systemctl start celld`".to_string();
    }
    let config = last.map(|status| status.config.as_str()).filter(|config| !config.is_empty());
    let config = config.map_or("...".to_string(), |config| in_shell(Path::new(config)));
    format!("`celld run --config {config} --state {}`", in_shell(state.root()))
}
