//! `celld simulate --faults cuts`: the daemon is gone after every single effect of many jobs, on all cores.
//!
//! In: the first seed, how many jobs, and for a repetition after which of the effects. Out: what must not
//! be, and the command that repeats it. Views and reach of a cell are computed once a job, not once a cut:
//! they take longer than the job itself.

use super::args::{SimulateArgs, keep_trace};
use crate::cli::progress::Progress;
use crate::pair::camera_view::SightKind;
use crate::pair::cuts::{cut, moments};
use crate::pair::stage::Stage;
use cell_edge::terminal::{complain, print};
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use std::sync::Arc;
use std::time::Instant;

/// One power cut.
struct Case {
    /// The job's cell; a copy of it shares what was computed of it.
    stage: Arc<Stage>,
    /// Of the job.
    seed: u64,
    /// The effect after which the daemon is gone.
    moment: usize,
}

/// Runs it; returns the exit code.
pub(super) fn run(args: &SimulateArgs) -> u8 {
    let began = Instant::now();
    let cases = match all_cases(args) {
        Ok(cases) => cases,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    let bar = Progress::new(cases.len(), "power cuts");
    let ran: Result<Vec<bool>, String> = cases
        .into_par_iter()
        .map(|case| {
            let sound = one(args, &case, &bar);
            bar.inc();
            sound
        })
        .collect();
    bar.finish();
    match ran {
        Ok(ran) => {
            let wrong = ran.iter().filter(|sound| !**sound).count();
            let (cuts, seconds) = (ran.len(), began.elapsed().as_secs_f64());
            print(&format!(
                "{cuts} power cuts in {} jobs, in {seconds:.0} s: {wrong} with something that must not be\n",
                args.jobs
            ));
            u8::from(wrong > 0)
        }
        Err(message) => {
            complain(&message);
            2
        }
    }
}

/// Every moment of every job, or the one that was chosen.
fn all_cases(args: &SimulateArgs) -> Result<Vec<Case>, String> {
    let only = args.only.as_deref().map(|only| only.parse::<usize>().map_err(|_| only.to_string()));
    let only = only.transpose().map_err(|only| format!("--only {only}: give the number of an effect"))?;
    let seeds = args.seed..args.seed.saturating_add(args.jobs as u64);
    let bar = Progress::new(args.jobs, "jobs carried out whole");
    let count = |seed| {
        let stage = Arc::new(args.stage(seed, SightKind::Corners)?);
        let count = moments(&stage, seed)?;
        bar.inc();
        Ok((stage, seed, count))
    };
    let counts: Result<Vec<(Arc<Stage>, u64, usize)>, String> = seeds.into_par_iter().map(count).collect();
    bar.finish();
    let cases = counts?.into_iter().flat_map(|(stage, seed, count)| {
        (0..count).map(move |moment| Case { stage: Arc::clone(&stage), seed, moment })
    });
    let cases: Vec<_> = cases.filter(|case| only.is_none_or(|only| only == case.moment)).collect();
    match (cases.is_empty(), only) {
        (true, Some(only)) => Err(format!("--only {only}: no job of these seeds has so many effects")),
        _ => Ok(cases),
    }
}

fn one(args: &SimulateArgs, case: &Case, bar: &Progress) -> Result<bool, String> {
    let Case { stage, seed, moment } = case;
    let (found, pair) = cut(stage, *seed, *moment, args.trace.is_some())?;
    keep_trace(args, &pair)?;
    if !found.faults.is_empty() {
        let again = format!(
            "repeat with: celld simulate --faults cuts --jobs 1 --seed {seed} --only {moment}{}",
            args.repeat_arguments()
        );
        let faults = found.faults.join("\n    ");
        bar.suspend(|| print(&format!("seed {seed}, after effect {moment}\n    {faults}\n    {again}\n")));
    }
    Ok(found.faults.is_empty())
}
