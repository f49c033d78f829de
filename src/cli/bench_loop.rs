//! `celld bench loop`: how fast the closed loop runs, and whether it holds what it promises on many seeds.
//!
//! In: how many jobs, pictures, seeds, and jobs with random faults. Out: a table, or one JSON object. The
//! first two figures are of one thread; the others use all cores. Exit code 0; 1 when a rule was broken, a
//! job did not end, or a seed gave two different runs.

use crate::bench::closed_loop::{Figure, faults, speed, sweep, table, twice};
use crate::pair::camera_view::SightKind;
use cell_edge::terminal::{complain, print};

/// Arguments of `celld bench loop`.
#[derive(Clone, Debug, clap::Args)]
pub struct BenchLoopArgs {
    /// Jobs without faults, seen by corners, for the speed
    #[arg(long, value_name = "N", default_value_t = 200)]
    jobs: usize,
    /// Jobs without faults, seen by rendered pictures, for the speed
    #[arg(long, value_name = "N", default_value_t = 2)]
    pictures: usize,
    /// Seeds that are run twice, a job each; both runs have to be the same, frame by frame
    #[arg(long, value_name = "N", default_value_t = 50)]
    seeds: u64,
    /// Jobs with one to three random faults each
    #[arg(long, value_name = "N", default_value_t = 100)]
    faults: u64,
    /// Leave the sweep of all faults in all phases out
    #[arg(long)]
    no_sweep: bool,
    /// First seed
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// What standard output gets
    #[arg(long, default_value = "table", value_parser = ["table", "json"])]
    format: String,
}

/// Runs `celld bench loop`. Returns the exit code.
pub fn run(args: &BenchLoopArgs) -> u8 {
    let mut figures = Vec::new();
    let parts: [(bool, Part); 5] = [
        (args.jobs > 0, |args| speed("jobs, corners", SightKind::Corners, args.jobs, args.seed)),
        (args.pictures > 0, |args| speed("jobs, pictures", SightKind::Pictures, args.pictures, args.seed)),
        (args.seeds > 0, |args| twice(args.seed, args.seeds)),
        (args.faults > 0, |args| faults(args.seed, args.faults, &repeat_with)),
        (!args.no_sweep, |_| sweep()),
    ];
    for (wanted, part) in parts {
        if !wanted {
            continue;
        }
        match part(args) {
            Ok(figure) => {
                complain(&format!("measured: {} {} in {:.0} s", figure.runs, figure.what, figure.wall_s));
                figures.push(figure);
            }
            Err(message) => {
                complain(&message);
                return 1;
            }
        }
    }
    match args.format.as_str() {
        "json" => print(&format!("{}\n", serde_json::json!(figures))),
        _ => print(&table(&figures)),
    }
    u8::from(figures.iter().any(|figure| figure.failures > 0))
}

type Part = fn(&BenchLoopArgs) -> Result<Figure, String>;

fn repeat_with(seed: u64) {
    complain(&format!("repeat with: celld simulate --faults random --jobs 1 --seed {seed}"));
}
