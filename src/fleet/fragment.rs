//! The shared part of the cell's configuration: kept in its state folder, checked as `celld check` does.
//!
//! In: what the fleet wants, the cell's own file. Out: the configuration to start with; where there is
//! something else to run with, a file in the state folder, with which the next start begins. The cell's own
//! file is never written. A kept part that does not fit (the own file has changed since) is left out and
//! said: a cell starts without its fleet.

use crate::config::calibrated::read_calibration;
use crate::config::cell::CellConfig;
use crate::config::load::{load_cell, load_cell_with};
use crate::config::read_fragment::read_fragment;
use crate::config::setup::cell_objects;
use cell_edge::files::{FileError, read_regular, write_atomic};
use cell_fleet::fragments::{FRAGMENT_MAX, Published, Wanted};
use rearrange::document::chain::chain;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// What is kept in the state folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptFragment {
    /// Its number in the fleet.
    pub revision: u64,
    /// For whom it was published.
    pub target: String,
    /// By whom.
    pub by: String,
    /// YAML.
    pub text: String,
}

/// Larger than any that was taken, in JSON.
const FILE_MAX: u64 = 4 * FRAGMENT_MAX as u64;

fn file(state: &Path) -> PathBuf {
    state.join("fleet-fragment.json")
}

impl KeptFragment {
    fn of(published: &Published) -> KeptFragment {
        KeptFragment {
            revision: published.revision,
            target: published.target.to_string(),
            by: published.by.clone(),
            text: published.fragment.text.clone(),
        }
    }

    fn name(&self) -> String {
        format!("fragment {} of {} by {}", self.revision, self.target, self.by)
    }
}

/// The cell's configuration with a shared part: read, compared and checked as before a start.
///
/// # Errors
/// Every complaint.
pub fn checked(config: &Path, kept: &KeptFragment) -> Result<CellConfig, String> {
    let shared = read_fragment(&kept.text, &kept.name()).map_err(|fault| fault.to_string())?;
    let cell =
        load_cell_with(config, Some(&shared)).map_err(|fault| format!("with {}: {fault}", kept.name()))?;
    read_calibration(&cell)?;
    cell_objects(&cell).map_err(|fault| format!("with {}: {fault}", kept.name()))?;
    Ok(cell)
}

/// What a cell starts with.
pub struct Start {
    /// Its configuration.
    pub config: CellConfig,
    /// Number of the shared part in it.
    pub runs: Option<u64>,
    /// Why a kept one is not in it.
    pub fault: Option<String>,
}

/// The configuration to start with: the cell's own, and what is kept of its fleet.
///
/// # Errors
/// The own file is wrong.
pub fn start_with(config: &Path, state: &Path) -> Result<Start, String> {
    let own = load_cell(config).map_err(|error| error.to_string())?;
    let kept = match own.fleet {
        Some(_) => kept(state),
        None => Ok(None),
    };
    let fault = match kept {
        Ok(None) => return Ok(Start { config: own, runs: None, fault: None }),
        Ok(Some(kept)) => match checked(config, &kept) {
            Ok(config) => return Ok(Start { config, runs: Some(kept.revision), fault: None }),
            Err(fault) => fault,
        },
        Err(fault) => fault,
    };
    let fault = format!("the cell starts with its own configuration alone: {fault}");
    Ok(Start { config: own, runs: None, fault: Some(fault) })
}

fn kept(state: &Path) -> Result<Option<KeptFragment>, String> {
    let path = file(state);
    if !path.exists() {
        return Ok(None);
    }
    let fault = |error: String| format!("{}: {error}", path.display());
    let (text, _) = read_regular(&path, FILE_MAX).map_err(|error| fault(chain(&error)))?;
    serde_json::from_str(&text).map(Some).map_err(|error| fault(error.to_string()))
}

/// Keeps what the next start begins with.
///
/// # Errors
/// What the disk says.
pub fn keep(state: &Path, wanted: Wanted) -> Result<(), String> {
    let path = file(state);
    match wanted {
        Wanted::This(published) => {
            let bytes =
                serde_json::to_vec_pretty(&KeptFragment::of(published)).map_err(|error| error.to_string())?;
            write_atomic(&path, &bytes).map_err(|error: FileError| chain(&error))
        }
        Wanted::None => match std::fs::remove_file(&path) {
            Ok(()) => Ok(()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(format!("{}: {error}", path.display())),
        },
    }
}

/// Where the cell is with what the fleet wants; see [`Follower::next`].
#[derive(Debug)]
pub struct Follower {
    config: PathBuf,
    state: PathBuf,
    runs: Option<u64>,
    /// Of the start.
    fault: Option<String>,
    /// The one that was refused, and why.
    refused: Option<(u64, String)>,
    kept: bool,
}

/// What is to be done about the fragment.
#[derive(Clone, Debug, PartialEq)]
pub enum Next {
    /// Nothing.
    Stay,
    /// Wait until the cell is idle and disarmed, for this number; 0: for none.
    Wait(u64),
    /// It cannot be used.
    Fault(String),
    /// It is kept: start anew.
    StartAnew,
}

impl Follower {
    /// Of a cell that has started.
    pub fn new(config: &Path, state: &Path, runs: Option<u64>, fault: Option<String>) -> Follower {
        let (config, state) = (config.to_path_buf(), state.to_path_buf());
        Follower { config, state, runs, fault, refused: None, kept: false }
    }

    /// The one that the cell runs with.
    pub fn runs(&self) -> Option<u64> {
        self.runs
    }

    /// What is to be done: `quiet` says that the cell is idle and disarmed, and that this is of now.
    pub fn next(&mut self, wanted: Option<Wanted>, quiet: bool) -> Next {
        let Some(wanted) = wanted else { return self.stays() };
        let number = match wanted {
            Wanted::This(published) => Some(published.revision),
            Wanted::None => None,
        };
        if number == self.runs || self.kept {
            return self.stays();
        }
        if let Some((refused, reason)) = self.refused.as_ref().filter(|(refused, _)| Some(*refused) == number)
        {
            return Next::Fault(format!("fragment {refused} is not taken: {reason}"));
        }
        if !quiet {
            return Next::Wait(number.unwrap_or(0));
        }
        let fits = match wanted {
            Wanted::This(published) => checked(&self.config, &KeptFragment::of(published)).map(drop),
            Wanted::None => load_cell(&self.config).map(drop).map_err(|error| error.to_string()),
        };
        match fits.and_then(|()| keep(&self.state, wanted)) {
            Ok(()) => {
                self.kept = true;
                Next::StartAnew
            }
            Err(reason) => {
                let number = number.unwrap_or(0);
                self.refused = Some((number, reason.clone()));
                Next::Fault(format!("fragment {number} is not taken: {reason}"))
            }
        }
    }

    fn stays(&self) -> Next {
        self.fault.clone().map_or(Next::Stay, Next::Fault)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::demo::cells::DemoCell;
    use cell_fleet::fragments::Fragment;
    use cell_fleet::payloads::sha256;
    use cell_fleet::subjects::Target;
    use std::net::Ipv4Addr;

    const PLANNER: &str = "version: 1\nplanner: {solver: auto, objective: ti, time_limit_s: 3, seed: 0}\n";

    fn cell() -> (tempfile::TempDir, PathBuf, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let cell = DemoCell::new(0, Ipv4Addr::new(127, 0, 40, 1), folder.path()).unwrap();
        cell.write("demo", "nats://127.0.0.1:4222").unwrap();
        std::fs::create_dir_all(cell.state()).unwrap();
        (folder, cell.config(), cell.state())
    }

    fn published(revision: u64, text: &str) -> Published {
        let fragment = Fragment { version: 1, text: text.into(), sha256: sha256(text), unix_s: 0.0 };
        Published { target: Target::any(), by: "anna".into(), revision, fragment }
    }

    #[test]
    fn it_is_taken_when_idle_and_disarmed_and_one_can_go_back() {
        let (_folder, config, state) = cell();
        let start = start_with(&config, &state).unwrap();
        assert_eq!((start.runs, start.config.planner.time_limit_s), (None, 2.0));
        let mut follower = Follower::new(&config, &state, None, None);
        let wanted = published(7, PLANNER);
        assert_eq!(follower.next(None, true), Next::Stay);
        assert_eq!(follower.next(Some(Wanted::This(&wanted)), false), Next::Wait(7));
        assert!(start_with(&config, &state).unwrap().runs.is_none(), "nothing is kept of what waits");
        assert_eq!(follower.next(Some(Wanted::This(&wanted)), true), Next::StartAnew);
        assert_eq!(follower.next(Some(Wanted::This(&wanted)), true), Next::Stay, "once");

        let start = start_with(&config, &state).unwrap();
        assert_eq!((start.runs, start.config.planner.time_limit_s), (Some(7), 3.0));
        let mut follower = Follower::new(&config, &state, start.runs, None);
        assert_eq!(follower.next(Some(Wanted::This(&wanted)), true), Next::Stay);
        assert_eq!(follower.next(None, true), Next::Stay, "a server that has lost all changes nothing");
        assert_eq!(follower.next(Some(Wanted::None), true), Next::StartAnew);
        assert!(start_with(&config, &state).unwrap().runs.is_none());
    }

    #[test]
    fn what_does_not_fit_is_refused_once_and_nothing_is_changed() {
        let (_folder, config, state) = cell();
        let mut follower = Follower::new(&config, &state, None, None);
        let wrong = published(3, "version: 1\nlimits: {tool_speed_m_s: 1}\n");
        for _ in 0..2 {
            let Next::Fault(fault) = follower.next(Some(Wanted::This(&wrong)), true) else { panic!("taken") };
            assert!(fault.contains("fragment 3") && fault.contains("limits"), "{fault}");
        }
        assert!(!file(&state).exists());
        let right = published(4, PLANNER);
        assert_eq!(follower.next(Some(Wanted::This(&right)), true), Next::StartAnew);
    }

    #[test]
    fn a_kept_one_that_no_longer_fits_is_left_out_and_said() {
        let (_folder, config, state) = cell();
        for spoilt in ["{", r#"{"revision":1,"target":"any","by":"a","text":"version: 1\nx: 1\n"}"#] {
            std::fs::write(file(&state), spoilt).unwrap();
            let start = start_with(&config, &state).unwrap();
            let fault = start.fault.unwrap();
            assert!(start.runs.is_none() && fault.contains("its own configuration alone"), "{fault}");
        }
    }
}
