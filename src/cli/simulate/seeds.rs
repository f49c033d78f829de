//! `celld simulate --faults hands` and `shell`: many jobs that are disturbed by seed, on all cores.
//!
//! In: the first seed, how many jobs, how one is carried out. Out: what must not be, and the command that
//! repeats it.

use super::args::{SimulateArgs, keep_trace};
use crate::cli::progress::Progress;
use crate::pair::Pair;
use crate::pair::camera_view::SightKind;
use crate::pair::hands::hands;
use crate::pair::shell_jobs::shell_job;
use crate::pair::stage::Stage;
use cell_edge::terminal::{complain, print};
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use std::time::Instant;

/// A job of a seed: what must not be, and the loop, with its trace where that is kept.
type Job = fn(&Stage, u64, bool) -> Result<(Vec<String>, Pair), String>;

/// With a hand on the table between looks; returns the exit code.
pub(super) fn with_hands(args: &SimulateArgs) -> u8 {
    run(args, "hands", "a hand on the table", hands)
}

/// With a disturbed shell around the machine; returns the exit code.
pub(super) fn with_shell(args: &SimulateArgs) -> u8 {
    run(args, "shell", "a disturbed shell", shell_job)
}

fn run(args: &SimulateArgs, name: &str, what: &str, job: Job) -> u8 {
    let bar = Progress::new(args.jobs, "jobs");
    let began = Instant::now();
    let seeds = args.seed..args.seed.saturating_add(args.jobs as u64);
    let ran: Result<Vec<usize>, String> = seeds
        .into_par_iter()
        .map(|seed| {
            let (faults, pair) = job(&args.stage(seed, SightKind::Corners)?, seed, args.trace.is_some())?;
            keep_trace(args, &pair)?;
            bar.inc();
            if !faults.is_empty() {
                let again = format!(
                    "repeat with: celld simulate --faults {name} --jobs 1 --seed {seed}{}",
                    args.repeat_arguments()
                );
                bar.suspend(|| print(&format!("seed {seed}\n    {}\n    {again}\n", faults.join("\n    "))));
            }
            Ok(faults.len())
        })
        .collect();
    bar.finish();
    match ran {
        Ok(ran) => {
            let missed = ran.iter().filter(|count| **count > 0).count();
            let (jobs, seconds) = (ran.len(), began.elapsed().as_secs_f64());
            print(&format!(
                "{jobs} jobs with {what}, in {seconds:.0} s: {missed} with something that must not be\n"
            ));
            u8::from(missed > 0)
        }
        Err(message) => {
            complain(&message);
            2
        }
    }
}
