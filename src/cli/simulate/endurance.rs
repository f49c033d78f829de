//! `celld simulate --hours N`: one cell at work for hours of virtual time, with a fault every ten minutes.
//!
//! In: a seed, how many hours. Out: a line an hour: jobs, faults, the size of the machine and of this
//! process; at the end how much both have grown since the first hour. None of the sizes is judged; exit code
//! 1 where a rule was broken or work did not go on.

use super::args::{SimulateArgs, keep_trace};
use crate::pair::Choice;
use crate::pair::camera_view::SightKind;
use crate::pair::endurance::{Course, Period, endurance};
use cell_edge::terminal::{complain, print};
use std::collections::BTreeMap;
use std::time::Instant;

/// Simulated seconds between two faults.
const FAULT_EVERY_S: f64 = 600.0;

/// Runs it; returns the exit code.
pub(super) fn run(args: &SimulateArgs, hours: u32) -> u8 {
    match hours_of_work(args, hours) {
        Ok(code) => code,
        Err(message) => {
            complain(&message);
            2
        }
    }
}

fn hours_of_work(args: &SimulateArgs, hours: u32) -> Result<u8, String> {
    let course = Course { periods: hours, period_s: 3600.0, fault_every_s: FAULT_EVERY_S };
    let stage = args.stage(args.seed, SightKind::Corners)?;
    let choice = Choice { keep_trace: args.trace.is_some(), ..Choice::of(args.seed) };
    let began = Instant::now();
    let mut sizes: Vec<(Period, u64)> = Vec::new();
    let mut over = |period: &Period| {
        let process = process_bytes();
        print(&line(period, process));
        sizes.push((period.clone(), process));
    };
    let (wrong, pair) = endurance(&stage, choice, course, &mut over)?;
    keep_trace(args, &pair)?;
    wrong.iter().for_each(|fault| print(&format!("  {fault}\n")));
    print(&growth(&sizes, began.elapsed().as_secs_f64()));
    if !wrong.is_empty() {
        let again = args.repeat_arguments();
        complain(&format!("repeat with: celld simulate --seed {} --hours {hours}{again}", args.seed));
    }
    Ok(u8::from(!wrong.is_empty()))
}

fn line(period: &Period, process: u64) -> String {
    let Period { number, ends, faults, machine_bytes, starts } = period;
    let jobs: usize = ends.values().sum();
    format!(
        "hour {number:3}: {jobs:4} jobs, {faults} faults, machine {:.1} kB, process {:.1} MB, celld started \
         {starts} times\n",
        *machine_bytes as f64 / 1e3,
        process as f64 / 1e6
    )
}

/// How much has come since the first hour, in which all that grows once has grown.
fn growth(sizes: &[(Period, u64)], seconds: f64) -> String {
    let (Some((first, before)), Some((last, now))) = (sizes.first(), sizes.last()) else {
        return String::new();
    };
    let mut ends: BTreeMap<&str, usize> = BTreeMap::new();
    for (code, count) in sizes.iter().flat_map(|(period, _)| &period.ends) {
        *ends.entry(code).or_default() += count;
    }
    let jobs: usize = ends.values().sum();
    let faults: usize = sizes.iter().map(|(period, _)| period.faults).sum();
    let mut text: String = ends.iter().map(|(code, count)| format!("  {count:6} {code}\n")).collect();
    text.push_str(&format!(
        "{jobs} jobs and {faults} faults in {} hours, in {seconds:.0} s; since hour {}: machine {:+.1} kB, \
         process {:+.1} MB\n",
        last.number,
        first.number,
        (last.machine_bytes as f64 - first.machine_bytes as f64) / 1e3,
        (*now as f64 - *before as f64) / 1e6
    ));
    text
}

/// Memory of this process that is in use, bytes (`/proc/self/statm`, second field, in pages of 4 KiB); 0
/// where the system does not say.
fn process_bytes() -> u64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages = text.split_whitespace().nth(1).and_then(|word| word.parse::<u64>().ok());
    pages.unwrap_or(0) * 4096
}
