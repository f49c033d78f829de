//! `celld run` as part of a fleet: the configuration it starts with, the thread, and starting anew.
//!
//! In: the configuration file, the state folder, what the daemon has. Out: where each status goes; a start
//! anew where a shared part of the configuration was taken. Without the feature `fleet` none of it is there,
//! and a configuration with `fleet:` is refused.

use crate::config::cell::CellConfig;
#[cfg(not(feature = "fleet"))]
use crate::config::load::load_cell;
use crate::jobs::state::StateFolder;
use crate::jobs::status::{Remarks, Status};
use crate::page::feed::Feed;
use crate::page::orders::OrderSender;
use cell_edge::terminal::complain;
use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

/// The code with which a service manager starts celld again: a shared part of the configuration was taken.
pub const ANEW: u8 = 75;

#[cfg(feature = "fleet")]
const NO: u8 = 0;
const PROPOSED: u8 = 1;
const BEGUN: u8 = 2;
const NEVER: u8 = 3;

/// Whether celld starts anew, with another shared part of its configuration. The fleet proposes it; the
/// daemon's loop begins it, in a turn in which the cell is idle and disarmed; whoever ends celld does not
/// find it running again.
#[derive(Clone, Default)]
pub struct Anew(Arc<AtomicU8>);

impl Anew {
    fn change(&self, from: u8, to: u8) -> bool {
        self.0.compare_exchange(from, to, Ordering::SeqCst, Ordering::SeqCst).is_ok()
    }

    /// It is proposed, or not any more.
    #[cfg(feature = "fleet")]
    pub fn propose(&self, wanted: bool) {
        let (from, to) = if wanted { (NO, PROPOSED) } else { (PROPOSED, NO) };
        // Otherwise it is so already, or it has begun, or celld is ended by a person.
        self.change(from, to);
    }

    /// Whether it begins in this turn: it was proposed, and the cell is `quiet`.
    pub fn begins(&self, quiet: bool) -> bool {
        quiet && self.change(PROPOSED, BEGUN)
    }

    /// A person ends celld.
    pub fn never(&self) {
        self.0.store(NEVER, Ordering::SeqCst);
    }

    /// What follows an end with this code. `take` makes what was staged the configuration of the next start.
    pub fn next(&self, code: u8, take: impl FnOnce() -> Result<(), String>) -> NextStart {
        if code != 0 || self.0.load(Ordering::SeqCst) != BEGUN {
            return NextStart::None(code);
        }
        match take() {
            Ok(()) => NextStart::Anew,
            // A start that could not be marked as disarmed is none that celld makes by itself.
            Err(fault) => {
                complain(&format!(
                    "the shared part of the configuration is not taken, and celld ends: {fault}"
                ));
                NextStart::None(1)
            }
        }
    }
}

/// What follows the end of the daemon.
#[derive(Debug, PartialEq, Eq)]
pub enum NextStart {
    /// Nothing: this exit code.
    None(u8),
    /// celld with another shared part of its configuration.
    Anew,
}

impl NextStart {
    /// The exit code; or this program again. A service manager starts it by the code. By itself it only does
    /// so where all devices are simulated: a camera's handle could outlive this process in the next.
    pub fn carry_out(self, simulated: bool) -> u8 {
        match self {
            NextStart::None(code) => code,
            NextStart::Anew if std::env::var_os("NOTIFY_SOCKET").is_some() => ANEW,
            NextStart::Anew if simulated => {
                let arguments: Vec<OsString> = std::env::args_os().skip(1).collect();
                let error = Command::new("/proc/self/exe").args(arguments).exec();
                complain(&format!("celld could not start anew: {error}"));
                1
            }
            NextStart::Anew => {
                complain(
                    "a shared part of the configuration was taken, and celld has ended: start it again. As a \
                     service it starts by itself (docs/operation.md)",
                );
                ANEW
            }
        }
    }
}

/// A start that celld makes by itself is disarmed, whatever `arm_at_start` says: whoever has disarmed the
/// cell does not find it armed because a configuration was taken.
fn disarmed_mark(state: &Path) -> PathBuf {
    state.join("start-disarmed")
}

/// Whether this start is one that celld made by itself; the next one is not.
pub fn is_to_start_disarmed(state: &Path) -> bool {
    let mark = disarmed_mark(state);
    // One that cannot be removed keeps the next starts disarmed too.
    mark.exists() && {
        let _ = std::fs::remove_file(&mark);
        true
    }
}

/// Makes what was staged the configuration of the next start, which is disarmed.
///
/// # Errors
/// What the disk says.
pub fn take_shared(state: &StateFolder) -> Result<(), String> {
    let mark = disarmed_mark(state.root());
    std::fs::write(&mark, b"").map_err(|error| format!("{}: {error}", mark.display()))?;
    #[cfg(feature = "fleet")]
    crate::fleet::fragment::take_staged(state.root())?;
    Ok(())
}

/// What the configuration has of a fleet's shared part.
#[derive(Clone, Debug, Default)]
pub struct Shared {
    #[cfg(feature = "fleet")]
    runs: Option<crate::fleet::fragment::KeptFragment>,
    #[cfg(feature = "fleet")]
    fault: Option<String>,
}

impl Shared {
    /// The shared part, for people; none where the cell runs with its own file alone.
    pub fn name(&self) -> Option<String> {
        #[cfg(feature = "fleet")]
        return self.runs.as_ref().map(crate::fleet::fragment::KeptFragment::name);
        #[cfg(not(feature = "fleet"))]
        None
    }
}

/// The configuration, with what the cell has taken of its fleet.
///
/// # Errors
/// The cell's own file is wrong.
#[cfg(feature = "fleet")]
pub fn start_with(config: &Path, state: &Path) -> Result<(CellConfig, Shared), String> {
    let start = crate::fleet::fragment::start_with(config, state)?;
    if let Some(shared) = &start.runs {
        tracing::info!("fleet: the configuration is {} with {}", config.display(), shared.name());
    }
    Ok((start.config, Shared { runs: start.runs, fault: start.fault }))
}

/// The configuration.
///
/// # Errors
/// The file is wrong.
#[cfg(not(feature = "fleet"))]
pub fn start_with(config: &Path, _state: &Path) -> Result<(CellConfig, Shared), String> {
    Ok((load_cell(config).map_err(|error| error.to_string())?, Shared::default()))
}

/// Is given each status for the cell's fleet; must not block.
pub type StatusSink = Box<dyn Fn(&Status) + Send>;

/// What the cell's part in its fleet works with.
#[cfg_attr(not(feature = "fleet"), expect(dead_code, reason = "a cell that is in no fleet"))]
pub struct Parts<'a> {
    /// The configuration, with its shared part.
    pub config: &'a CellConfig,
    /// The cell's own file.
    pub config_file: &'a Path,
    /// What of it is shared.
    pub shared: Shared,
    /// Jobs and journal.
    pub state: &'a StateFolder,
    /// What happens.
    pub feed: &'a Feed,
    /// Where orders go.
    pub order_sender: &'a OrderSender,
    /// What the status says of the fleet.
    pub remarks: &'a Remarks,
    /// To be started anew.
    pub anew: Anew,
    /// Stops celld.
    pub stop: Arc<AtomicBool>,
}

/// The cell's part in its fleet, on a thread of its own; without `fleet:` there is none.
///
/// # Errors
/// As [`crate::fleet::start::start`].
#[cfg(feature = "fleet")]
pub fn fleet(parts: Parts) -> Result<StatusSink, String> {
    use crate::fleet::fragment::Follower;
    let Some(section) = &parts.config.fleet else { return Ok(Box::new(|_| {})) };
    let Shared { runs, fault } = parts.shared;
    let anew = parts.anew;
    let daemon = crate::fleet::side::Daemon {
        config: parts.config.clone(),
        state: parts.state.clone(),
        feed: parts.feed.clone(),
        order_sender: parts.order_sender.clone(),
        remarks: parts.remarks.clone(),
        fragments: Follower::new(parts.config_file, parts.state.root(), runs, fault),
        start_anew: Box::new(move |wanted| anew.propose(wanted)),
        stop: parts.stop,
    };
    let statuses = crate::fleet::start::start(section, daemon)?;
    Ok(Box::new(move |status| statuses.written(status)))
}

/// Nothing, or that this celld has no part in fleets.
///
/// # Errors
/// The configuration has `fleet:`.
#[cfg(not(feature = "fleet"))]
pub fn fleet(parts: Parts) -> Result<StatusSink, String> {
    match parts.config.fleet {
        None => Ok(Box::new(|_| {})),
        Some(_) => {
            Err("the configuration has `fleet:`, and this celld was built without the feature `fleet`; \
                        build it with `cargo build --release --features fleet`"
                .to_string())
        }
    }
}

#[cfg(all(test, feature = "fleet"))]
mod tests {
    use super::*;

    #[test]
    fn it_begins_in_a_quiet_turn_and_not_where_a_person_ends_celld() {
        let anew = Anew::default();
        assert!(!anew.begins(true), "nothing is proposed");
        anew.propose(true);
        assert!(!anew.begins(false), "the cell is armed, say");
        anew.propose(false);
        assert!(!anew.begins(true), "it is not wanted any more");
        anew.propose(true);
        assert!(anew.begins(true) && !anew.begins(true), "once");
        anew.propose(false);
        assert_eq!(anew.next(0, || Ok(())), NextStart::Anew);
        assert_eq!(anew.next(1, || Ok(())), NextStart::None(1), "it ended with a fault");
        assert_eq!(anew.next(0, || Err("no room".to_string())), NextStart::None(1), "not marked as disarmed");
        anew.never();
        assert_eq!(anew.next(0, || panic!("nothing is taken")), NextStart::None(0));
        let anew = Anew::default();
        anew.propose(true);
        anew.never();
        assert!(!anew.begins(true));
    }

    #[test]
    fn the_start_that_follows_is_disarmed_and_the_one_after_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        assert!(!is_to_start_disarmed(state.root()));
        take_shared(&state).unwrap();
        assert!(is_to_start_disarmed(state.root()) && !is_to_start_disarmed(state.root()));
    }
}
