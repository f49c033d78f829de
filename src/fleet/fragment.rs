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
use cell_edge::files::{read_regular, write_atomic};
use cell_fleet::fragments::{FRAGMENT_MAX, Published, Wanted};
use cell_fleet::payloads::sentence;
use rearrange::document::chain::chain;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A shared part as it lies in the state folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptFragment {
    /// Its number in the fleet.
    pub revision: u64,
    /// For whom it was published.
    pub target: String,
    /// By whom.
    pub by: String,
    /// YAML; empty in a staged one: the cell's own file alone.
    pub text: String,
}

/// Larger than any that was taken, in JSON.
const FILE_MAX: u64 = 8 * FRAGMENT_MAX as u64;

/// What the cell runs with.
fn kept_file(state: &Path) -> PathBuf {
    state.join("fleet-fragment.json")
}

/// What it runs with after the next start that the daemon makes by itself.
fn staged_file(state: &Path) -> PathBuf {
    state.join("fleet-fragment.next.json")
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

    /// For people.
    pub fn name(&self) -> String {
        format!("fragment {} of {} by {}", self.revision, self.target, self.by)
    }
}

/// The cell's configuration with a shared part: read, compared and checked as before a start.
///
/// # Errors
/// Every complaint.
pub fn checked(config: &Path, kept: &KeptFragment) -> Result<CellConfig, String> {
    let shared = read_fragment(&kept.text, &kept.name()).map_err(|fault| fault.to_string())?;
    let with = |fault: &dyn std::fmt::Display| {
        format!("with {} (what it shares counts its own lines): {fault}", kept.name())
    };
    let cell = load_cell_with(config, Some(&shared)).map_err(|fault| with(&fault))?;
    read_calibration(&cell)?;
    cell_objects(&cell).map_err(|fault| with(&fault))?;
    Ok(cell)
}

/// What a cell starts with.
pub struct Start {
    /// Its configuration.
    pub config: CellConfig,
    /// The shared part in it.
    pub runs: Option<KeptFragment>,
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
        Some(_) => read(&kept_file(state)),
        None => Ok(None),
    };
    let fault = match kept {
        Ok(None) => return Ok(Start { config: own, runs: None, fault: None }),
        Ok(Some(kept)) => match checked(config, &kept) {
            Ok(config) => return Ok(Start { config, runs: Some(kept), fault: None }),
            Err(fault) => fault,
        },
        Err(fault) => fault,
    };
    let fault = format!("the cell starts with its own configuration alone: {fault}");
    Ok(Start { config: own, runs: None, fault: Some(fault) })
}

fn read(path: &Path) -> Result<Option<KeptFragment>, String> {
    if !path.exists() {
        return Ok(None);
    }
    let fault = |error: String| format!("{}: {error}", path.display());
    let (text, _) = read_regular(path, FILE_MAX).map_err(|error| fault(chain(&error)))?;
    serde_json::from_str(&text).map(Some).map_err(|error| fault(error.to_string()))
}

fn remove(path: &Path) -> Result<(), String> {
    match std::fs::remove_file(path) {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(format!("{}: {error}", path.display())),
    }
}

/// What was staged is what the cell runs with from the next start on. The state folder is this process's.
///
/// # Errors
/// What the disk says; the cell runs with what it ran with.
pub fn take_staged(state: &Path) -> Result<(), String> {
    let staged = staged_file(state);
    match read(&staged)? {
        None => Ok(()),
        Some(next) if next.text.is_empty() => {
            remove(&kept_file(state))?;
            remove(&staged)
        }
        Some(_) => std::fs::rename(&staged, kept_file(state))
            .map_err(|error| format!("{}: {error}", staged.display())),
    }
}

/// Which fragment, whatever server gave the number.
type Identity = (u64, String);

/// Where the cell is with what the fleet wants: checks it, stages it, and proposes a start with it. When
/// that is decides the daemon's loop, in a turn in which the cell is idle and disarmed.
#[derive(Debug)]
pub struct Follower {
    config: PathBuf,
    state: PathBuf,
    runs: Option<KeptFragment>,
    /// Why a kept one is not in what it runs with.
    fault: Option<String>,
    /// The one that was refused, and why.
    refused: Option<(Identity, String)>,
    staged: Option<Identity>,
}

/// What is to be done about the fragment.
#[derive(Clone, Debug, PartialEq)]
pub enum Next {
    /// Nothing.
    Stay,
    /// It is staged: start anew with it as soon as the cell is idle and disarmed. Its number; 0: none.
    Start(u64),
    /// It cannot be used.
    Fault(String),
}

impl Follower {
    /// Of a cell that has started.
    pub fn new(config: &Path, state: &Path, runs: Option<KeptFragment>, fault: Option<String>) -> Follower {
        // Of an earlier run that ended before.
        let _ = remove(&staged_file(state));
        let (config, state) = (config.to_path_buf(), state.to_path_buf());
        Follower { config, state, runs, fault, refused: None, staged: None }
    }

    /// Number of the one that the cell runs with.
    pub fn runs(&self) -> Option<u64> {
        self.runs.as_ref().map(|kept| kept.revision)
    }

    /// What is to be done.
    pub fn next(&mut self, wanted: Option<Wanted>) -> Next {
        match wanted {
            Some(Wanted::This(published)) => self.with(&KeptFragment::of(published)),
            Some(Wanted::None) => self.alone(),
            None => self.stays(),
        }
    }

    fn with(&mut self, wanted: &KeptFragment) -> Next {
        if self
            .runs
            .as_ref()
            .is_some_and(|kept| (kept.revision, &kept.text) == (wanted.revision, &wanted.text))
        {
            return self.unstaged();
        }
        let identity = (wanted.revision, wanted.text.clone());
        if self.staged.as_ref() == Some(&identity) {
            return Next::Start(wanted.revision);
        }
        if let Some((_, fault)) = self.refused.as_ref().filter(|(refused, _)| *refused == identity) {
            return Next::Fault(fault.clone());
        }
        if let Err(reason) = checked(&self.config, wanted) {
            let fault = sentence(&format!("fragment {} is not taken: {reason}", wanted.revision));
            self.refused = Some((identity, fault.clone()));
            return Next::Fault(fault);
        }
        self.stage(wanted, identity)
    }

    /// With the cell's own file and nothing else.
    fn alone(&mut self) -> Next {
        if self.runs.is_some() {
            let none =
                KeptFragment { revision: 0, target: String::new(), by: String::new(), text: String::new() };
            return self.stage(&none, (0, String::new()));
        }
        // What is kept and did not fit is not wanted any more; it would come back once it fits.
        if self.fault.is_some() && remove(&kept_file(&self.state)).is_ok() {
            self.fault = None;
        }
        self.unstaged()
    }

    fn stage(&mut self, wanted: &KeptFragment, identity: Identity) -> Next {
        if self.staged.as_ref() != Some(&identity) {
            let bytes = serde_json::to_vec_pretty(wanted).unwrap_or_default();
            if let Err(error) = write_atomic(&staged_file(&self.state), &bytes) {
                // Not remembered: the disk may get room.
                return Next::Fault(format!("fragment {}: {}", wanted.revision, chain(&error)));
            }
            self.staged = Some(identity);
        }
        Next::Start(wanted.revision)
    }

    /// What was staged is not wanted any more.
    fn unstaged(&mut self) -> Next {
        if self.staged.take().is_some() {
            // Left there, it would be what the cell runs with already, or what it checks again.
            let _ = remove(&staged_file(&self.state));
        }
        self.stays()
    }

    fn stays(&self) -> Next {
        self.fault.as_ref().map_or(Next::Stay, |fault| Next::Fault(sentence(fault)))
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
    fn it_is_staged_and_taken_and_one_can_go_back() {
        let (_folder, config, state) = cell();
        let start = start_with(&config, &state).unwrap();
        assert_eq!((start.runs, start.config.planner.time_limit_s), (None, 2.0));
        let mut follower = Follower::new(&config, &state, None, None);
        let wanted = published(7, PLANNER);
        assert_eq!(follower.next(None), Next::Stay);
        assert_eq!(follower.next(Some(Wanted::This(&wanted))), Next::Start(7));
        assert_eq!(follower.next(Some(Wanted::This(&wanted))), Next::Start(7), "until the loop ends");
        assert!(start_with(&config, &state).unwrap().runs.is_none(), "what is staged is not taken");
        take_staged(&state).unwrap();

        let start = start_with(&config, &state).unwrap();
        assert_eq!(start.config.planner.time_limit_s, 3.0);
        assert_eq!(start.runs.as_ref().map(KeptFragment::name).unwrap(), "fragment 7 of label=any by anna");
        let mut follower = Follower::new(&config, &state, start.runs, None);
        assert_eq!(follower.next(Some(Wanted::This(&wanted))), Next::Stay);
        assert_eq!(follower.next(None), Next::Stay, "a server that has lost all changes nothing");
        let other = published(7, &PLANNER.replace("seed: 0", "seed: 1"));
        assert_eq!(follower.next(Some(Wanted::This(&other))), Next::Start(7), "of another server");
        assert_eq!(follower.next(Some(Wanted::This(&wanted))), Next::Stay, "and not any more");
        take_staged(&state).unwrap();
        assert_eq!(start_with(&config, &state).unwrap().config.planner.seed, 0);
        assert_eq!(follower.next(Some(Wanted::None)), Next::Start(0));
        take_staged(&state).unwrap();
        assert!(start_with(&config, &state).unwrap().runs.is_none() && !staged_file(&state).exists());
    }

    #[test]
    fn what_does_not_fit_is_refused_once_and_nothing_is_changed() {
        let (_folder, config, state) = cell();
        let mut follower = Follower::new(&config, &state, None, None);
        let wrong = published(3, "version: 1\nlimits: {tool_speed_m_s: 1}\n");
        for _ in 0..2 {
            let Next::Fault(fault) = follower.next(Some(Wanted::This(&wrong))) else { panic!("taken") };
            assert!(fault.contains("fragment 3") && fault.contains("limits"), "{fault}");
        }
        assert!(!staged_file(&state).exists() && !kept_file(&state).exists());
        let long = published(4, &format!("version: 1\n{}: 1\n", "\u{7f}".repeat(200_000)));
        let Next::Fault(fault) = follower.next(Some(Wanted::This(&long))) else { panic!("taken") };
        assert!(fault.chars().count() <= 2000, "it goes into the cell's state");
        assert_eq!(follower.next(Some(Wanted::This(&published(5, PLANNER)))), Next::Start(5));
    }

    #[test]
    fn a_kept_one_that_no_longer_fits_is_left_out_said_and_withdrawn() {
        let (_folder, config, state) = cell();
        for spoilt in ["{", r#"{"revision":1,"target":"any","by":"a","text":"version: 1\nx: 1\n"}"#] {
            std::fs::write(kept_file(&state), spoilt).unwrap();
            let start = start_with(&config, &state).unwrap();
            let fault = start.fault.clone().unwrap();
            assert!(start.runs.is_none() && fault.contains("its own configuration alone"), "{fault}");
            let mut follower = Follower::new(&config, &state, start.runs, start.fault);
            assert!(matches!(follower.next(None), Next::Fault(_)));
            assert_eq!(follower.next(Some(Wanted::None)), Next::Stay);
            assert!(!kept_file(&state).exists(), "it does not come back once it fits");
        }
    }
}
