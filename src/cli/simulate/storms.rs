//! `celld simulate --faults random`: many jobs with one to three faults each, on all cores.
//!
//! In: the first seed, how many jobs, and for a repetition which of the faults. Out: how the jobs and those
//! after them ended, and for each failure the fewest faults it needs, with the command that repeats it.

use super::args::{SimulateArgs, keep_trace};
use crate::cli::progress::Progress;
use crate::pair::Choice;
use crate::pair::camera_view::SightKind;
use crate::pair::storm::{Aftermath, Strike, fewest, storm, strikes};
use cell_edge::terminal::{complain, print};
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use std::collections::BTreeMap;
use std::time::Instant;

/// Runs it; returns the exit code.
pub(super) fn run(args: &SimulateArgs) -> u8 {
    let bar = Progress::new(args.jobs, "jobs");
    let began = Instant::now();
    let seeds = args.seed..args.seed.saturating_add(args.jobs as u64);
    let ran: Result<Vec<(usize, Aftermath)>, String> = seeds
        .into_par_iter()
        .map(|seed| {
            let one = one(args, seed, &bar);
            bar.inc();
            one
        })
        .collect();
    bar.finish();
    match ran {
        Ok(ran) => {
            print(&text(&ran, began.elapsed().as_secs_f64()));
            u8::from(ran.iter().any(|(_, aftermath)| !aftermath.faults.is_empty()))
        }
        Err(message) => {
            complain(&message);
            2
        }
    }
}

fn one(args: &SimulateArgs, seed: u64, bar: &Progress) -> Result<(usize, Aftermath), String> {
    let stage = args.stage(seed, SightKind::Corners)?;
    let all = strikes(seed);
    let chosen = chosen(args.only.as_deref(), &all)?;
    let choice = Choice { keep_trace: args.trace.is_some(), replay: args.replay, ..Choice::of(seed) };
    let (aftermath, pair) = storm(&stage, choice, &chosen)?;
    keep_trace(args, &pair)?;
    if args.only.is_some() {
        let notices = pair.notices().iter().map(|notice| format!("    celld said: {}\n", notice.text));
        bar.suspend(|| print(&notices.collect::<String>()));
    }
    if !aftermath.faults.is_empty() {
        let needed = fewest(&stage, choice, &chosen);
        bar.suspend(|| print(&failure(args, seed, &chosen, &needed, &aftermath)));
    }
    Ok((chosen.len(), aftermath))
}

fn chosen(only: Option<&str>, all: &[Strike]) -> Result<Vec<Strike>, String> {
    let Some(only) = only else { return Ok(all.to_vec()) };
    let mut chosen = Vec::new();
    for word in only.split(',').filter(|word| !word.is_empty()) {
        let strike = word.trim().parse::<usize>().ok().and_then(|number| all.get(number));
        let last = all.len().saturating_sub(1);
        let strike = strike
            .ok_or(format!("--only {only}: {word:?} is no number from 0 to {last}, this seed's faults"))?;
        chosen.push(*strike);
    }
    Ok(chosen)
}

fn failure(
    args: &SimulateArgs,
    seed: u64,
    chosen: &[Strike],
    needed: &[usize],
    aftermath: &Aftermath,
) -> String {
    let mut text = format!("seed {seed}\n");
    for number in needed {
        let strike = &chosen[*number];
        text.push_str(&format!("    at {:.2} s: {} {}\n", strike.at_s, strike.row.number, strike.row.name));
    }
    for fault in &aftermath.faults {
        text.push_str(&format!("    {fault}\n"));
    }
    let numbers: Vec<String> = needed.iter().map(usize::to_string).collect();
    let numbers = numbers.join(",");
    text + &format!(
        "    repeat with: celld simulate --faults random --jobs 1 --seed {seed} --only {numbers:?}{}\n",
        args.repeat_arguments()
    )
}

fn text(ran: &[(usize, Aftermath)], seconds: f64) -> String {
    let faults: usize = ran.iter().map(|(count, _)| count).sum();
    let failed = ran.iter().filter(|(_, aftermath)| !aftermath.faults.is_empty()).count();
    let mut text = format!(
        "{} jobs with {faults} faults, and as many after them, in {seconds:.0} s: {failed} with something \
         that must \
         not be\n",
        ran.len()
    );
    let mut ends: BTreeMap<String, (usize, usize)> = BTreeMap::new();
    let word =
        |code: Option<cell_machine::code::Code>| code.map_or("waits".to_string(), |code| code.to_string());
    for (_, aftermath) in ran {
        ends.entry(word(aftermath.code)).or_default().0 += 1;
        ends.entry(word(aftermath.next)).or_default().1 += 1;
    }
    for (code, (first, next)) in ends {
        text.push_str(&format!("  {first:6} {next:6} {code}\n"));
    }
    text
}
