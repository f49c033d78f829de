//! `celld calibrate empty`: how the empty table looks from the look poses, for cameras without depth.
//!
//! In: the cell's configuration, live devices, a table with nothing on it. Out: a recorded round in the
//! folder that the configuration names under `calibration: {empty: ...}`. Nothing is solved: the daemon
//! compares its looks with these pictures.

use crate::calibration::fit::Sample;
use crate::cli::calibrate::round::SAMPLES;
use crate::config::cell::CellConfig;
use crate::config::load::load_cell;
use cell_edge::files;
use cell_edge::terminal::complain;
use rearrange::document::chain::chain;
use rearrange::tabletop::instance::ObjectSpec;
use std::path::{Path, PathBuf};

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

/// The cell as it goes round its look poses, and the folder for the pictures; without, the reason has been
/// reported.
pub(super) fn prepare(args: &EmptyArgs) -> Option<(CellConfig, PathBuf)> {
    let mut config = load_cell(&args.config).map_err(|error| complain(&error.to_string())).ok()?;
    let Some(folder) = config.calibration.empty.clone() else {
        let path = args.config.display();
        complain(&format!("{path}: name a folder for the pictures, `empty: FOLDER` under `calibration`"));
        return None;
    };
    config.calibration_poses.clone_from(&config.look_poses);
    complain("the arm goes round its look poses; the table is to be clear but for the reference markers");
    Some((config, folder))
}

/// Leaves the pictures in the folder if the table was empty.
///
/// # Errors
/// What was seen on it.
pub(super) fn judge(config: &CellConfig, folder: &Path, samples: &[Sample]) -> Result<(), String> {
    let Some(seen) = not_empty(config, samples) else { return Ok(()) };
    // The daemon must not take it for what belongs there.
    files::remove(&folder.join(SAMPLES)).map_err(|error| chain(&error))?;
    Err(seen)
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
