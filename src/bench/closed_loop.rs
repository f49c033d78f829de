//! `bench loop`: how fast the closed loop in virtual time runs, and whether it holds what it promises on
//! many seeds.
//!
//! In: seeds and numbers of jobs. Out: [`Figure`]s and their table. Speed is of one thread; the others use
//! all cores.

use crate::pair::Choice;
use crate::pair::camera_view::SightKind;
use crate::pair::page::{PAGE, PAGE_SEED, expected};
use crate::pair::run::run_jobs;
use crate::pair::storm::{storm, strikes};
use crate::pair::sweep::{case, cases, judge};
use crate::pair::table::stage;
use rayon::iter::{IntoParallelIterator, IntoParallelRefIterator, ParallelIterator};
use std::time::Instant;

/// Figures of one measurement.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Figure {
    /// What was measured.
    pub what: &'static str,
    /// How many.
    pub runs: usize,
    /// Of how many that there are; `None` where there is no end of them.
    pub of: Option<usize>,
    /// How long all of it took, s.
    pub wall_s: f64,
    /// Simulated seconds in which a job was under way, over wall seconds, where one thread was measured.
    pub times_real_time: Option<f64>,
    /// Runs that broke a rule or did not end.
    pub failures: usize,
}

/// The figures for people.
pub fn table(figures: &[Figure]) -> String {
    let mut text =
        format!("{:<22} {:>11} {:>9} {:>11} {:>9}\n", "", "runs", "wall s", "x real time", "failures");
    for figure in figures {
        let speed = figure.times_real_time.map_or(String::new(), |times| format!("{times:.0}"));
        let runs = figure.of.map_or(figure.runs.to_string(), |of| format!("{} of {of}", figure.runs));
        text.push_str(&format!(
            "{:<22} {runs:>11} {:>9.1} {speed:>11} {:>9}\n",
            figure.what, figure.wall_s, figure.failures
        ));
    }
    text
}

/// Jobs one after the other in one cell, on one thread.
///
/// # Errors
/// The loop cannot be set up.
pub fn speed(what: &'static str, eye: SightKind, jobs: usize, seed: u64) -> Result<Figure, String> {
    let stage = stage(seed, eye)?;
    let choice = Choice { eye, ..Choice::of(seed) };
    let began = Instant::now();
    let (summary, _) = run_jobs(&stage, choice, jobs, &[], &mut |_| {}).map_err(|error| error.to_string())?;
    let wall_s = began.elapsed().as_secs_f64();
    let failures = summary.breaches.len() + summary.stuck.len();
    let times_real_time = Some(summary.busy_s / wall_s.max(1e-9));
    Ok(Figure { what, runs: summary.jobs, of: None, wall_s, times_real_time, failures })
}

/// Every seed twice.
///
/// # Errors
/// The loop cannot be set up.
pub fn twice(first: u64, seeds: u64) -> Result<Figure, String> {
    let began = Instant::now();
    let same: Result<Vec<bool>, String> = (first..first.saturating_add(seeds))
        .into_par_iter()
        .map(|seed| {
            let stage = stage(seed, SightKind::Corners)?;
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
        of: None,
        wall_s,
        times_real_time: None,
        failures,
    })
}

/// Jobs with random faults; `failed` is called with the seed of each that failed.
///
/// # Errors
/// The loop cannot be set up.
pub fn faults(first: u64, jobs: u64, failed: &(dyn Fn(u64) + Sync)) -> Result<Figure, String> {
    let began = Instant::now();
    let ran: Result<Vec<usize>, String> = (first..first.saturating_add(jobs))
        .into_par_iter()
        .map(|seed| {
            let (aftermath, _) = storm(&stage(seed, SightKind::Corners)?, Choice::of(seed), &strikes(seed))?;
            if !aftermath.faults.is_empty() {
                failed(seed);
            }
            Ok(aftermath.faults.len().min(1))
        })
        .collect();
    let ran = ran?;
    Ok(Figure {
        what: "jobs, random faults",
        runs: ran.len(),
        of: None,
        wall_s: began.elapsed().as_secs_f64(),
        times_real_time: None,
        failures: ran.iter().sum(),
    })
}

/// Every fault in every phase, or every so many of these cases.
///
/// # Errors
/// The loop cannot be set up.
pub fn sweep(every: usize) -> Result<Figure, String> {
    let stage = stage(PAGE_SEED, SightKind::Corners)?;
    let page = expected(PAGE);
    let all = cases().count();
    let cases: Vec<_> = cases().step_by(every).collect();
    let began = Instant::now();
    let ran: Result<Vec<usize>, String> = cases
        .par_iter()
        .map(|(row, phase)| {
            let (outcome, _) = case(&stage, row, *phase, PAGE_SEED, false)?;
            let failed = !judge(row, *phase, &outcome, Some(&page)).is_empty();
            Ok(usize::from(failed))
        })
        .collect();
    let ran = ran?;
    Ok(Figure {
        what: "faults in phases",
        runs: ran.len(),
        of: Some(all),
        wall_s: began.elapsed().as_secs_f64(),
        times_real_time: None,
        failures: ran.iter().sum(),
    })
}
