//! `celld bench loop`: how fast the closed loop runs, and whether it holds what it promises on many seeds.
//!
//! In: how many jobs, pictures, seeds, and jobs with random faults. Out: a table, or one JSON object. The
//! first two figures are of one thread; the others use all cores. Exit code 0; 1 when a rule was broken that
//! is not known to be, a job did not end, or a seed gave two different runs.

use crate::cli::simulate::table::stage;
use crate::pair::Choice;
use crate::pair::eyes::Eye;
use crate::pair::page::{PAGE, PAGE_SEED, expected};
use crate::pair::reactions::KNOWN;
use crate::pair::run::run_jobs;
use crate::pair::storm::{storm, strikes};
use crate::pair::sweep::{case, cases, judge};
use cell_edge::terminal::{complain, print};
use rayon::iter::{IntoParallelIterator, IntoParallelRefIterator, ParallelIterator};
use std::time::Instant;

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

/// Figures of one measurement.
#[derive(Clone, Debug, serde::Serialize)]
struct Figure {
    what: &'static str,
    runs: usize,
    wall_s: f64,
    /// Simulated seconds in which a job was under way, over wall seconds, where one thread was measured.
    times_real_time: Option<f64>,
    failures: usize,
    /// Runs in which only rules were broken that are known to be.
    known: usize,
}

/// Runs `celld bench loop`. Returns the exit code.
pub fn run(args: &BenchLoopArgs) -> u8 {
    let mut figures = Vec::new();
    let parts: [(bool, Part); 5] = [
        (args.jobs > 0, |args| speed("jobs, corners", Eye::Corners, args.jobs, args.seed)),
        (args.pictures > 0, |args| speed("jobs, pictures", Eye::Pictures, args.pictures, args.seed)),
        (args.seeds > 0, |args| twice(args.seed, args.seeds)),
        (args.faults > 0, |args| faults(args.seed, args.faults)),
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

fn table(figures: &[Figure]) -> String {
    let mut text = format!(
        "{:<22} {:>7} {:>9} {:>11} {:>9} {:>6}\n",
        "", "runs", "wall s", "x real time", "failures", "known"
    );
    for figure in figures {
        let speed = figure.times_real_time.map_or(String::new(), |times| format!("{times:.0}"));
        text.push_str(&format!(
            "{:<22} {:>7} {:>9.1} {speed:>11} {:>9} {:>6}\n",
            figure.what, figure.runs, figure.wall_s, figure.failures, figure.known
        ));
    }
    text
}

/// Jobs one after the other in one cell, on one thread.
fn speed(what: &'static str, eye: Eye, jobs: usize, seed: u64) -> Result<Figure, String> {
    let stage = stage(seed, eye)?;
    let choice = Choice { eye, ..Choice::of(seed) };
    let began = Instant::now();
    let (summary, _) = run_jobs(&stage, choice, jobs, &[], &mut |_| {}).map_err(|error| error.to_string())?;
    let wall_s = began.elapsed().as_secs_f64();
    let failures = summary.breaches.len() + summary.stuck.len();
    let times_real_time = Some(summary.busy_s / wall_s.max(1e-9));
    Ok(Figure { what, runs: summary.jobs, wall_s, times_real_time, failures, known: 0 })
}

/// Every seed twice.
fn twice(first: u64, seeds: u64) -> Result<Figure, String> {
    let began = Instant::now();
    let same: Result<Vec<bool>, String> = (first..first.saturating_add(seeds))
        .into_par_iter()
        .map(|seed| {
            let stage = stage(seed, Eye::Corners)?;
            let once = || run_jobs(&stage, Choice::of(seed), 1, &[], &mut |_| {}).map(|(summary, _)| summary);
            let (one, other) = (once(), once());
            Ok(matches!((one, other), (Ok(one), Ok(other)) if one == other && one.is_clean()))
        })
        .collect();
    let same = same?;
    let failures = same.iter().filter(|same| !**same).count();
    let wall_s = began.elapsed().as_secs_f64();
    Ok(Figure {
        what: "seeds, each twice",
        runs: same.len(),
        wall_s,
        times_real_time: None,
        failures,
        known: 0,
    })
}

/// Jobs with random faults.
fn faults(first: u64, jobs: u64) -> Result<Figure, String> {
    let began = Instant::now();
    let ran: Result<Vec<(usize, usize)>, String> = (first..first.saturating_add(jobs))
        .into_par_iter()
        .map(|seed| {
            let (aftermath, _) = storm(&stage(seed, Eye::Corners)?, seed, &strikes(seed), false)?;
            if !aftermath.faults.is_empty() {
                complain(&format!("repeat with: celld simulate --faults random --jobs 1 --seed {seed}"));
            }
            Ok((aftermath.faults.len().min(1), aftermath.known.min(1)))
        })
        .collect();
    let ran = ran?;
    Ok(Figure {
        what: "jobs, random faults",
        runs: ran.len(),
        wall_s: began.elapsed().as_secs_f64(),
        times_real_time: None,
        failures: ran.iter().map(|(failed, _)| failed).sum(),
        known: ran.iter().map(|(_, known)| known).sum(),
    })
}

/// Every fault in every phase.
fn sweep() -> Result<Figure, String> {
    let stage = stage(PAGE_SEED, Eye::Corners)?;
    let page = expected(PAGE);
    let cases: Vec<_> = cases().collect();
    let began = Instant::now();
    let ran: Result<Vec<(usize, usize)>, String> = cases
        .par_iter()
        .map(|(row, phase)| {
            let (outcome, _) = case(&stage, row, *phase, PAGE_SEED, false)?;
            let known = outcome.breaches.iter().any(|breach| KNOWN.contains(breach));
            let failed = !judge(row, *phase, &outcome, Some(&page)).is_empty();
            Ok((usize::from(failed), usize::from(known)))
        })
        .collect();
    let ran = ran?;
    Ok(Figure {
        what: "faults in phases",
        runs: ran.len(),
        wall_s: began.elapsed().as_secs_f64(),
        times_real_time: None,
        failures: ran.iter().map(|(failed, _)| failed).sum(),
        known: ran.iter().map(|(_, known)| known).sum(),
    })
}
