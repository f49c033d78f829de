//! The simulator alone: `celld sim` under a name of its own. It uses no OpenCV, so it needs none of the two
//! hundred libraries behind it, and it starts in milliseconds; that is what makes it worth having in other
//! people's tests.

use clap::{Parser, Subcommand};
use std::process::ExitCode;
use ur_sim::command::compare::{self, CompareArgs};
use ur_sim::command::{self, SimArgs};

#[derive(Parser, Debug)]
#[command(name = "celld-sim", version, about = "Simulated UR5e, VGC10 and camera behind the real protocols")]
#[command(args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    args: SimArgs,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Is the simulated arm where a real one was? Compares a recording of ur_rtde with the program it is of.
    Compare(CompareArgs),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let _log = cell_edge::log::start("error");
    ExitCode::from(match &cli.command {
        Some(Command::Compare(args)) => compare::run(args),
        None => command::run(&cli.args),
    })
}
