//! What the commands that reach the daemon through the state folder have in common.
//!
//! In: `--state` on the command line; faults. Out: the state folder, and a fault with its causes on stderr.

use crate::cli::task::outln;
use crate::jobs::command::{Command, Given, Sent};
use crate::jobs::inbox::FOR_ANOTHER;
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
use std::sync::atomic::{AtomicBool, Ordering};
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
    #[error(
        "the daemon did not take the command within {0} s; it was taken back, nothing was done; see `celld status`"
    )]
    NotTaken(u64),
    #[error(
        "the daemon did not take the stop within {0} s; it still counts when the daemon takes it. If the arm moves, \
         use the emergency stop"
    )]
    StopNotTaken(u64),
    #[error(
        "the daemon took the stop and did not answer within {0} s; the stop counts. If the arm moves, use the \
         emergency stop"
    )]
    StopNotAnswered(u64),
    #[error(
        "the daemon took the command and did not answer within {0} s; unless it was decided by now, nothing is done; \
         see `celld status`"
    )]
    NoReply(u64),
    #[error(
        "celld ended before it answered. It may have carried out the command; check with `celld status`. If the arm \
         moves, use the emergency stop"
    )]
    Ended {
        /// By Ctrl-C.
        interrupted: bool,
    },
    #[error("taken back: nothing was done")]
    TakenBack,
    #[error("a stop is not taken back; it counts when the daemon takes it")]
    StopStands,
    #[error(
        "the daemon has the command; if it was decided before Ctrl-C, it goes on (see `celld status`, `celld abort` \
         stops the arm), else nothing is done"
    )]
    Interrupted,
    #[error("{0}")]
    Refused(String),
    #[error("the terminal fails")]
    Terminal(#[source] std::io::Error),
    #[error(transparent)]
    State(#[from] StateError),
    #[error(transparent)]
    Files(#[from] FileError),
    #[error(transparent)]
    Journal(#[from] JournalError),
}

/// The error with its causes on stderr; the exit code: 1, or 130 after Ctrl-C.
pub(super) fn complain(error: &ClientError) -> u8 {
    cell_edge::terminal::complain(&chain(error));
    match error {
        ClientError::TakenBack
        | ClientError::StopStands
        | ClientError::Interrupted
        | ClientError::Ended { interrupted: true } => 130,
        _ => 1,
    }
}

/// A complaint about usage on stderr; exit code 2.
pub(super) fn exit_2(text: &str) -> u8 {
    cell_edge::terminal::complain(text);
    2
}

/// How long a daemon may take to take a command.
const TAKEN_WITHIN: Duration = Duration::from_secs(10);

/// How long it may take to answer one that it has taken: the arm may have to stop first.
const ANSWER_WITHIN: Duration = Duration::from_secs(20);

/// After Ctrl-C, for the answer to a command that was decided before.
const LAST_WORD_WITHIN: Duration = Duration::from_secs(1);

/// How long a daemon may take from its start to its first status.
const START_WITHIN: Duration = Duration::from_secs(20);

/// How often the answer is looked for.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Gives a command and waits for its answer.
pub(super) fn request(
    state: &StateFolder,
    command: &Command,
    stop: &AtomicBool,
) -> Result<Reply, ClientError> {
    let status = running_daemon(state)?;
    if status.state == STARTING {
        return Err(ClientError::Starting(status.message));
    }
    sent(state, &status.daemon, command, stop)
}

/// Gives a command and prints the answer; the exit code.
pub(super) fn send(state: &StateFolder, command: &Command, stop: &AtomicBool) -> Result<u8, ClientError> {
    let Reply { accepted, message, .. } = request(state, command, stop)?;
    outln!("{message}");
    Ok(if accepted { 0 } else { 1 })
}

/// As [`request`], for what a daemon that waits for its robot takes too; one that has just been started is
/// waited for.
pub(super) fn request_at_start(
    state: &StateFolder,
    command: &Command,
    stop: &AtomicBool,
) -> Result<Reply, ClientError> {
    let begun = Instant::now();
    loop {
        let answered = running_daemon(state).and_then(|status| sent(state, &status.daemon, command, stop));
        match answered {
            // Its status may still be that of an earlier daemon, whose name no command reaches.
            Err(
                ClientError::NoDaemon { .. }
                | ClientError::NotTaken(_)
                | ClientError::NoReply(_)
                | ClientError::Ended { interrupted: false },
            ) if begun.elapsed() < START_WITHIN && state.is_taken()? => {
                std::thread::sleep(LOOK_EVERY);
            }
            Ok(reply) if reply.message == FOR_ANOTHER && begun.elapsed() < START_WITHIN => {
                std::thread::sleep(LOOK_EVERY);
            }
            answered => return answered,
        }
    }
}

fn sent(
    state: &StateFolder,
    daemon: &str,
    command: &Command,
    stop: &AtomicBool,
) -> Result<Reply, ClientError> {
    let given = Given { unix_s: unix_now_s(), boot_s: boot_now_s() };
    let sent = Sent::send(&state.commands(), daemon, command, given)?;
    let begun = Instant::now();
    let mut taken = false;
    loop {
        if let Some(reply) = sent.poll()? {
            return Ok(reply);
        }
        // A command that was taken may have been decided, even if the daemon has ended since.
        taken |= !sent.waits()?;
        let interrupted = stop.load(Ordering::Relaxed);
        let limit = if taken { ANSWER_WITHIN } else { TAKEN_WITHIN };
        if interrupted || begun.elapsed() >= limit {
            let (stops, runs) = (command.only_stops(), || runs_as(state, daemon));
            return give_up(sent, GivenUp { stops, taken, interrupted }, runs);
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

/// A command whose client stops waiting.
struct GivenUp {
    /// It only stops.
    stops: bool,
    /// The daemon took it.
    taken: bool,
    /// By Ctrl-C; otherwise by timeout.
    interrupted: bool,
}

/// The daemon of this name still runs.
fn runs_as(state: &StateFolder, daemon: &str) -> Result<bool, ClientError> {
    let runs = state.is_taken()?;
    Ok(runs && Status::read(&state.status())?.is_some_and(|status| status.daemon == daemon))
}

/// Waits no longer for the answer to a command. One that was not taken is taken back, so it is not obeyed
/// once nobody expects it; a stop never is. One that was taken is carried out only if it was decided before.
fn give_up(
    sent: Sent,
    GivenUp { stops, taken, interrupted }: GivenUp,
    runs: impl Fn() -> Result<bool, ClientError>,
) -> Result<Reply, ClientError> {
    let late = TAKEN_WITHIN.as_secs();
    if !taken && (stops || sent.withdraw()?) {
        return Err(match (runs()?, stops, interrupted) {
            (false, ..) => ClientError::Ended { interrupted },
            (true, true, true) => ClientError::StopStands,
            (true, true, false) => ClientError::StopNotTaken(late),
            (true, false, true) => ClientError::TakenBack,
            (true, false, false) => ClientError::NotTaken(late),
        });
    }
    let last_word = sent.let_go();
    let since = Instant::now();
    while since.elapsed() < LAST_WORD_WITHIN {
        if let Some(reply) = last_word.poll()? {
            return Ok(reply);
        }
        std::thread::sleep(LOOK_EVERY);
    }
    if !runs()? {
        return Err(ClientError::Ended { interrupted });
    }
    let seconds = ANSWER_WITHIN.as_secs();
    Err(match (stops, interrupted) {
        (true, true) => ClientError::StopStands,
        (true, false) => ClientError::StopNotAnswered(seconds),
        (false, true) => ClientError::Interrupted,
        (false, false) => ClientError::NoReply(seconds),
    })
}

/// The status of the daemon that runs on `state`.
pub(super) fn running_daemon(state: &StateFolder) -> Result<Status, ClientError> {
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
