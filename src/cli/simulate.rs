//! `celld simulate`: whole cells in virtual time, one thread each.
//!
//! In: a seed, how many jobs, faults, how the cell sees. Out: what became of the jobs, every breach of a
//! rule, and the one command that repeats a failure. Exit codes: 0 no rule was broken and every job ended; 1
//! one was, or one did not; 2 bad input.

mod args;
mod cuts;
mod endurance;
mod orders;
mod seeds;
mod storms;

use crate::pair::camera_view::SightKind;
use crate::pair::outcome::Phase;
use crate::pair::page::{self, CaseOutcome, PAGE, PAGE_SEED, expected, title};
use crate::pair::reactions::Row;
use crate::pair::run::{Summary, run_jobs};
use crate::pair::sweep::{case, cases, judge};
use crate::pair::{Choice, Pair};
pub use args::SimulateArgs;
use args::{SightArg, keep_trace};
use cell_edge::terminal::{complain, print};
use indicatif::{ProgressBar, ProgressStyle};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use std::path::Path;
use std::time::Instant;
use ur_sim::command::faults_of;

/// Runs the subcommand; returns the exit code.
pub fn run(args: &SimulateArgs) -> u8 {
    let eye = match args.eye {
        SightArg::Pictures => SightKind::Pictures,
        SightArg::Corners => SightKind::Corners,
    };
    if args.orders {
        return orders::run(args);
    }
    if let Some(hours) = args.hours {
        return endurance::run(args, hours);
    }
    match args.faults.as_deref().and_then(Path::to_str) {
        Some("sweep") => return sweep(args),
        Some("random") => return storms::run(args),
        Some("hands") => return seeds::with_hands(args),
        Some("cuts") => return cuts::run(args),
        Some("shell") => return seeds::with_shell(args),
        _ => {}
    }
    let faults = args.faults.as_deref().map_or(Ok(Vec::new()), faults_of);
    let prepared = faults.and_then(|faults| Ok((faults, args.stage(args.seed, eye)?)));
    let (faults, stage) = match prepared {
        Ok(prepared) => prepared,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    let choice =
        Choice { eye, keep_trace: args.trace.is_some(), replay: args.replay, ..Choice::of(args.seed) };
    let bar = ProgressBar::new(args.jobs as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} jobs, {eta} left") {
        bar.set_style(style);
    }
    let began = Instant::now();
    let ran = run_jobs(&stage, choice, args.jobs, &faults, &mut |done| bar.set_position(done as u64));
    bar.finish_and_clear();
    let (summary, pair) = match ran {
        Ok(ran) => ran,
        Err(error) => {
            complain(&error.to_string());
            return 1;
        }
    };
    let seconds = began.elapsed().as_secs_f64();
    if let Err(message) = keep_trace(args, &pair) {
        complain(&message);
        return 2;
    }
    print(&text(&summary, &pair, seconds));
    if summary.is_clean() {
        return 0;
    }
    let faults = args.faults.as_ref().map(|path| format!(" --faults {}", path.display())).unwrap_or_default();
    let eye = if eye == SightKind::Pictures { " --eye pictures" } else { "" };
    let (seed, jobs, again) = (args.seed, args.jobs, args.repeat_arguments());
    complain(&format!("repeat with: celld simulate --seed {seed} --jobs {jobs}{faults}{eye}{again}"));
    1
}

fn text(summary: &Summary, pair: &Pair, seconds: f64) -> String {
    let mut text = format!(
        "{} jobs, {} moves, {:.0} simulated seconds at work in {seconds:.1} s: {:.0} times real time\n",
        summary.jobs,
        summary.moves,
        summary.busy_s,
        summary.busy_s / seconds.max(1e-9)
    );
    for (code, count) in &summary.ends {
        text.push_str(&format!("  {count:6} {code}\n"));
    }
    for breach in &summary.breaches {
        let at_s = breach.frame as f64 * 0.002;
        text.push_str(&format!("BREACH {:?} at {at_s:.3} s: {}\n", breach.rule, breach.detail));
    }
    for stuck in &summary.stuck {
        text.push_str(&format!("STUCK {stuck}\n"));
    }
    if !summary.is_clean() {
        for notice in pair.notices().iter().rev().take(8).rev() {
            text.push_str(&format!("  celld said: {}\n", notice.text));
        }
    }
    text.push_str(&format!("trace {:016x}\n", summary.fingerprint));
    text
}

/// Every fault in every phase; returns the exit code.
fn sweep(args: &SimulateArgs) -> u8 {
    let wanted = |title: &str| args.only.as_ref().is_none_or(|only| title.contains(only.as_str()));
    let chosen: Vec<(&Row, Phase)> = cases().filter(|(row, phase)| wanted(&title(row, *phase))).collect();
    let stage = match args.stage(args.seed, SightKind::Corners) {
        Ok(stage) => stage,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    if args.refuses_to_write() {
        return 2;
    }
    let as_written = args.seed == PAGE_SEED && args.is_usual();
    let expected = as_written.then(|| expected(PAGE));
    let bar = ProgressBar::new(chosen.len() as u64);
    let began = Instant::now();
    let ran: Result<Vec<CaseOutcome>, String> = chosen
        .par_iter()
        .map(|&(row, phase)| {
            let (outcome, pair) = case(&stage, row, phase, args.seed, args.trace.is_some())?;
            bar.inc(1);
            let faults = judge(row, phase, &outcome, expected.as_ref());
            if !faults.is_empty() || args.only.is_some() {
                bar.suspend(|| print(&case_text(&title(row, phase), &faults, &pair, args.only.is_some())));
            }
            keep_trace(args, &pair)?;
            Ok(CaseOutcome { row, phase, outcome })
        })
        .collect();
    bar.finish_and_clear();
    let outcomes = match ran {
        Ok(outcomes) => outcomes,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    if let Some(path) = &args.write
        && let Err(error) = std::fs::write(path, page::write(&outcomes))
    {
        complain(&format!("{}: {error}", path.display()));
        return 2;
    }
    let bad = outcomes
        .iter()
        .filter(|found| !judge(found.row, found.phase, &found.outcome, expected.as_ref()).is_empty());
    let (mut bad, seconds) = (bad.count(), began.elapsed().as_secs_f64());
    print(&format!("{} cases, {bad} not as expected, {seconds:.0} s\n", outcomes.len()));
    if as_written && args.only.is_none() && bad == 0 && page::write(&outcomes) != PAGE {
        bad += 1;
        print("docs/reactions.md is not what the sweep writes: its head or order has changed\n");
    }
    if !as_written {
        print(
            "only the rules were checked: docs/reactions.md is of seed 0, without --blend and --controller\n",
        );
    }
    u8::from(bad > 0)
}

fn case_text(title: &str, faults: &[String], pair: &Pair, notices: bool) -> String {
    let mut text = format!("{title}\n");
    for fault in faults {
        text.push_str(&format!("    {fault}\n"));
    }
    for breach in pair.breaches() {
        text.push_str(&format!("    {:?}: {}\n", breach.rule, breach.detail));
    }
    for notice in pair.notices().iter().filter(|_| notices) {
        text.push_str(&format!("    celld said: {}\n", notice.text));
    }
    text
}
