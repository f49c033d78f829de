//! `celld doctor`: what is missing between this computer and a moving robot.
//!
//! In: the configuration, the state folder. Out: one page on stdout, as text or JSON. Exit codes: 0 nothing
//! is missing, 1 something is, 2 the configuration cannot be read. Nothing moves and nothing is written to a
//! device.

use crate::cli::client::Format;
use crate::cli::client::StateArg;
use crate::config::load::load_cell;
use crate::doctor::probe::examine;
use cell_edge::terminal::{complain, print};
use clap::Args;
use std::path::PathBuf;

const HELP: &str = "\
Each line says what was found; below a line marked MISSING stands what to do about it, and `note`
is worth knowing and no hindrance. Nothing moves: the doctor reads, and claims the controller's
input registers for two seconds as celld will. While a celld runs on the state folder, gripper and
camera are left to it. docs/commissioning.md goes through all of it from a crated robot to the
first pick.";

/// Arguments of `celld doctor`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub struct DoctorArgs {
    /// The cell's configuration.
    #[arg(long, default_value = "config/cell.yaml", value_name = "FILE")]
    config: PathBuf,
    #[command(flatten)]
    state: StateArg,
    /// Text or JSON.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Runs the subcommand and returns the exit code.
pub fn run(args: &DoctorArgs) -> u8 {
    let config = match load_cell(&args.config) {
        Ok(config) => config,
        Err(error) => {
            complain(&error.to_string());
            return 2;
        }
    };
    let mut say = |part: &str| complain(&format!("looking at {part}"));
    let sheet = examine(&args.config.display().to_string(), &config, &args.state.folder(), &mut say);
    match args.format {
        Format::Text => print(&sheet.text()),
        Format::Json => {
            let text = serde_json::to_string_pretty(&sheet).expect("a sheet has string keys only");
            print(&format!("{text}\n"));
        }
    }
    u8::from(!sheet.ready)
}
