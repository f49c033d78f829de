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
use crate::page::orders::Desk;
use cell_edge::terminal::complain;
use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

const NO: u8 = 0;
const WANTED: u8 = 1;
const NEVER: u8 = 2;

/// Whether celld starts anew once it has stopped: whoever ends it does not find it running again.
#[derive(Clone, Default)]
pub struct Anew(Arc<AtomicU8>);

impl Anew {
    /// It should, unless a person ends it.
    pub fn want(&self) {
        // Otherwise it is ended by a person.
        let _ = self.0.compare_exchange(NO, WANTED, Ordering::Relaxed, Ordering::Relaxed);
    }

    /// A person ends it.
    pub fn never(&self) {
        self.0.store(NEVER, Ordering::Relaxed);
    }

    /// This program again, with the same arguments and disarmed: whoever has disarmed the cell does not find
    /// it armed because a configuration was taken. `None` where it just ends; a code where it could not.
    pub fn start_if_wanted(&self) -> Option<u8> {
        if self.0.load(Ordering::Relaxed) != WANTED {
            return None;
        }
        let mut arguments: Vec<OsString> = std::env::args_os().skip(1).collect();
        if !arguments.iter().any(|argument| argument == "--disarmed") {
            arguments.push("--disarmed".into());
        }
        let error = match std::env::current_exe() {
            Ok(celld) => Command::new(celld).args(arguments).exec(),
            Err(error) => error,
        };
        complain(&format!("celld could not start anew: {error}"));
        Some(1)
    }
}

/// What the configuration has of a fleet's shared part.
#[derive(Clone, Debug, Default)]
pub struct Shared {
    /// Its number.
    pub runs: Option<u64>,
    /// Why a kept one is not in it.
    pub fault: Option<String>,
}

/// The configuration, with what the cell has taken of its fleet.
///
/// # Errors
/// The cell's own file is wrong.
#[cfg(feature = "fleet")]
pub fn start_with(config: &Path, state: &Path) -> Result<(CellConfig, Shared), String> {
    let start = crate::fleet::fragment::start_with(config, state)?;
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
pub type Told = Box<dyn Fn(&Status) + Send>;

/// What the cell's part in its fleet works with.
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
    pub desk: &'a Desk,
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
pub fn fleet(parts: Parts) -> Result<Told, String> {
    use crate::fleet::fragment::Follower;
    let Some(section) = &parts.config.fleet else { return Ok(Box::new(|_| {})) };
    let Shared { runs, fault } = parts.shared;
    let (anew, stop) = (parts.anew, parts.stop.clone());
    let daemon = crate::fleet::side::Daemon {
        config: parts.config.clone(),
        state: parts.state.clone(),
        feed: parts.feed.clone(),
        desk: parts.desk.clone(),
        remarks: parts.remarks.clone(),
        fragments: Follower::new(parts.config_file, parts.state.root(), runs, fault),
        start_anew: Box::new(move || {
            anew.want();
            stop.store(true, Ordering::Relaxed);
        }),
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
pub fn fleet(parts: Parts) -> Result<Told, String> {
    match parts.config.fleet {
        None => Ok(Box::new(|_| {})),
        Some(_) => {
            Err("the configuration has `fleet:`, and this celld was built without the feature `fleet`; \
                        build it with `cargo build --release --features fleet`"
                .to_string())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_ends_celld_does_not_find_it_running_again() {
        let anew = Anew::default();
        assert!(anew.start_if_wanted().is_none());
        anew.never();
        anew.want();
        assert!(anew.start_if_wanted().is_none(), "it would have been this test's program");
        let anew = Anew::default();
        anew.want();
        anew.never();
        assert!(anew.start_if_wanted().is_none());
    }
}
