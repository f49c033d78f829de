//! `celld calibrate empty`: how the empty table looks from the look poses, for cameras without depth.
//!
//! In: the cell's configuration, live devices, a table with nothing on it. Out: a recorded round in the
//! folder that the configuration names under `calibration: {empty: ...}`. Nothing is solved: the daemon
//! compares its looks with these pictures.

use crate::config::cell::CellConfig;
use crate::config::load::load_cell;
use cell_edge::terminal::complain;
use std::path::PathBuf;

/// Shown under `celld calibrate empty --help`.
pub(super) const HELP: &str = "\
The arm moves: through the taught look poses, slower than 0.1 m/s, within `calibration_box` where
there is one. As with every round of taught poses there is no further question (--yes is for poses that celld
proposes itself), so keep the arm's reach free of people. Clear the table first; only the
reference markers stay. If an object of the configuration is seen, nothing is kept.";

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
