//! `celld calibrate empty`: how the empty table looks from the look poses, for cameras without depth.
//!
//! In: the cell's configuration, live devices, a table with nothing on it. Out: a recorded round in the folder that the configuration names
//! under `calibration: {empty: ...}`. Nothing is solved: the daemon compares its looks with these pictures.

use crate::cli::calibrate::live;
use crate::cli::daemon::with_runtime;
use crate::cli::task::complain;
use crate::config::load::load_cell;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

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
    with_runtime(stop, move |stop| async move { live(&config, Some(&folder), None, stop).await.map(|_| ()) })
}
