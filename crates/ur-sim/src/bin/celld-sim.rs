//! The simulator alone: `celld sim` under a name of its own. It uses no OpenCV, so it needs none of the two
//! hundred libraries behind it, and it starts in milliseconds; that is what makes it worth having in other
//! people's tests.

use clap::Parser;
use std::process::ExitCode;
use ur_sim::command::{self, SimArgs};

#[derive(Parser, Debug)]
#[command(name = "celld-sim", version, about = "Simulated UR5e, VGC10 and camera behind the real protocols")]
struct Cli {
    #[command(flatten)]
    args: SimArgs,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    cell_edge::terminal::start_log("error");
    ExitCode::from(command::run(&cli.args))
}
