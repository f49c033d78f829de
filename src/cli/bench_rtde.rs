//! `celld bench rtde`: what the RTDE codec costs, and how the simulator keeps its 500 Hz.
//!
//! In: seconds, clients, a simulator's configuration and an address of this machine. Out: a table, or one
//! JSON object. The simulator is this program once more, as a process of its own. Exit code 0, or 1 when
//! something did not work.

use crate::bench::rtde::{Setup, run as measure, table};
use crate::cli::values;
use cell_edge::terminal::{complain, print};
use std::net::IpAddr;
use std::path::{Path, PathBuf};

/// Arguments of `celld bench rtde`.
#[derive(Clone, Debug, clap::Args)]
pub struct BenchRtdeArgs {
    /// Length of each of the two measurements
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = values::planning_seconds)]
    seconds: f64,
    /// RTDE clients, each at 500 Hz
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u16).range(1..=30))]
    clients: u16,
    /// Time factor of the fast measurement
    #[arg(long, value_name = "F", default_value_t = 20.0, value_parser = ur_sim::command::time_factor)]
    time_factor: f64,
    /// The simulator's configuration
    #[arg(long, default_value = "config/sim.yaml", value_name = "FILE")]
    config: PathBuf,
    /// Loopback address of the simulator
    #[arg(long, default_value = "127.0.0.9", value_parser = values::loopback)]
    bind: IpAddr,
    /// What standard output gets
    #[arg(long, default_value = "table", value_parser = ["table", "json"])]
    format: String,
}

/// The simulator as it is given to others, if it was built with this program; else this program.
fn simulator_beside(program: &Path) -> PathBuf {
    let alone = program.with_file_name("celld-sim");
    if alone.exists() { alone } else { program.to_owned() }
}

/// Runs `celld bench rtde`. Returns the exit code.
pub fn run(args: &BenchRtdeArgs) -> u8 {
    let program = match std::env::current_exe() {
        Ok(program) => simulator_beside(&program),
        Err(error) => {
            complain(&format!("this program's own file: {error}"));
            return 1;
        }
    };
    let setup = Setup {
        program,
        config: args.config.clone(),
        host: args.bind,
        seconds: args.seconds,
        clients: usize::from(args.clients),
        factor: args.time_factor,
    };
    match measure(&setup, &|next| complain(&format!("measuring: {next}"))) {
        Ok(figures) if args.format == "json" => {
            print(&format!("{}\n", serde_json::json!(figures)));
            0
        }
        Ok(figures) => {
            print(&table(&figures));
            0
        }
        Err(message) => {
            complain(&message);
            1
        }
    }
}
