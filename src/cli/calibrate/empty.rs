//! `celld calibrate empty`: how the empty table looks from the look poses, for cameras without depth.
//!
//! In: the cell's configuration, live devices, a table with nothing on it. Out: a recorded round in the
//! folder that the configuration names under `calibration: {empty: ...}`. Nothing is solved: the daemon
//! compares its looks with these pictures.

use crate::calibration::fit::Sample;
use crate::cli::calibrate::{SAMPLES, live};
use crate::cli::daemon::with_runtime;
use crate::cli::task::complain;
use crate::config::cell::CellConfig;
use crate::config::load::load_cell;
use crate::document::chain::chain;
use crate::io::files;
use crate::tabletop::instance::ObjectSpec;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Shown under `celld calibrate empty --help`.
pub(super) const HELP: &str = "\
The arm moves: through the taught look poses, slower than 0.1 m/s, within `calibration_box` where there is one. As with every
round of taught poses nobody asks again (--yes is for poses that celld proposes itself), so keep the arm's reach free of people.
Clear the table first; only the reference markers stay. If an object of the configuration is seen, nothing is kept.";

/// Arguments of `celld calibrate empty`.
#[derive(clap::Args, Clone, Debug)]
pub struct EmptyArgs {
    /// The cell's configuration, with look poses and the folder
    #[arg(long, default_value = "config/cell.yaml", value_name = "FILE")]
    config: PathBuf,
}

/// Takes the pictures; returns the exit code.
pub fn run(args: &EmptyArgs, stop: Arc<AtomicBool>) -> u8 {
    let mut config = match load_cell(&args.config) {
        Ok(config) => config,
        Err(error) => {
            complain(&error.to_string());
            return 2;
        }
    };
    let Some(folder) = config.calibration.empty.clone() else {
        let path = args.config.display();
        complain(&format!("{path}: name a folder for the pictures, `empty: FOLDER` under `calibration`"));
        return 2;
    };
    config.calibration_poses.clone_from(&config.look_poses);
    complain("the arm goes round its look poses; the table is to be clear but for the reference markers");
    with_runtime(stop, move |stop| async move {
        let taken = live(&config, Some(&folder), None, &|_| Ok(()), stop).await?;
        let Some(seen) = not_empty(&config, &taken.samples) else { return Ok(()) };
        // The daemon must not take it for what belongs there.
        files::remove(&folder.join(SAMPLES)).map_err(|error| chain(&error))?;
        Err(seen)
    })
}

/// The sentence about an object whose marker is seen, if there is one.
fn not_empty(config: &CellConfig, samples: &[Sample]) -> Option<String> {
    let seen = |id: u32| samples.iter().flat_map(|sample| &sample.detections).any(|found| found.id == id);
    let there = |object: &&ObjectSpec| object.marker.as_ref().is_some_and(|marker| seen(marker.id));
    let mut names =
        config.objects.iter().filter(|object| !object.fixed).filter(there).map(|object| &*object.id);
    let first = names.next()?;
    let all = names.fold(format!("{first:?}"), |all, name| format!("{all}, {name:?}"));
    Some(format!("the table is not empty, {all} can be seen: clear it and take the pictures again"))
}
