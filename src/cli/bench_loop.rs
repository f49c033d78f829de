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
#[command(after_help = HELP)]
pub struct BenchLoopArgs {
    /// All sizes in full, and every case of the sweep, in place of the smaller ones below
    #[arg(long)]
    full: bool,
    /// Jobs without faults, seen by corners, for the speed: 50, in full 200
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Jobs without faults, seen by rendered pictures, for the speed: 1, in full 2
    #[arg(long, value_name = "N")]
    pictures: Option<usize>,
    /// Seeds that are run twice, a job each; both runs have to be the same, frame by frame: 20, in full 50
    #[arg(long, value_name = "N")]
    seeds: Option<u64>,
    /// Jobs with one to three random faults each: 25, in full 100
    #[arg(long, value_name = "N")]
    faults: Option<u64>,
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

const HELP: &str = "\
The default sizes end within three minutes on two cores and take every eighth case of the sweep;
--full measures all of it.";

/// Of the sweep every so many cases, unless all are requested.
const SWEEP_EVERY: usize = 8;

/// How much is measured.
struct Sizes {
    jobs: usize,
    pictures: usize,
    seeds: u64,
    faults: u64,
    sweep_every: usize,
}

impl BenchLoopArgs {
    fn sizes(&self) -> Sizes {
        let usual = if self.full {
            Sizes { jobs: 200, pictures: 2, seeds: 50, faults: 100, sweep_every: 1 }
        } else {
            Sizes { jobs: 50, pictures: 1, seeds: 20, faults: 25, sweep_every: SWEEP_EVERY }
        };
        Sizes {
            jobs: self.jobs.unwrap_or(usual.jobs),
            pictures: self.pictures.unwrap_or(usual.pictures),
            seeds: self.seeds.unwrap_or(usual.seeds),
            faults: self.faults.unwrap_or(usual.faults),
            ..usual
        }
    }
}

/// Runs `celld bench loop`. Returns the exit code.
pub fn run(args: &BenchLoopArgs) -> u8 {
    let mut figures = Vec::new();
    let sizes = args.sizes();
    let parts: [(bool, Part); 5] = [
        (sizes.jobs > 0, |seed, sizes| speed("jobs, corners", SightKind::Corners, sizes.jobs, seed)),
        (sizes.pictures > 0, |seed, sizes| {
            speed("jobs, pictures", SightKind::Pictures, sizes.pictures, seed)
        }),
        (sizes.seeds > 0, |seed, sizes| twice(seed, sizes.seeds)),
        (sizes.faults > 0, |seed, sizes| faults(seed, sizes.faults, &repeat_with)),
        (!args.no_sweep, |_, sizes| sweep(sizes.sweep_every)),
    ];
    for (wanted, part) in parts {
        if !wanted {
            continue;
        }
        match part(args.seed, &sizes) {
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

type Part = fn(u64, &Sizes) -> Result<Figure, String>;

fn repeat_with(seed: u64) {
    complain(&format!("repeat with: celld simulate --faults random --jobs 1 --seed {seed}"));
}
