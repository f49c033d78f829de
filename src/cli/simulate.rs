//! `celld simulate`: whole cells in virtual time, one thread each.
//!
//! In: a seed, how many jobs, faults, how the cell sees. Out: what became of the jobs, every breach of a
//! rule, and the one command that repeats a failure. Exit codes: 0 no rule was broken and every job ended; 1
//! one was, or one did not; 2 bad input.

mod storms;

use crate::cli::daemon::machine_parameters;
use crate::cli::demo::cell::{CUP_DIAMETER_M, DemoChoice, LOOK_DISTANCE_M, cell_config, sim_file};
use crate::cli::sim::{FOCAL_PX, faults_of, sim_config};
use crate::cli::task::{complain, print};
use crate::config::cell::CellConfig;
use crate::config::setup::CUP_MARGIN_M;
use crate::config::simulated::SimFile;
use crate::jobs::policy::JobObjective;
use crate::pair::eyes::Eye;
use crate::pair::outcome::{Outcome, Phase};
use crate::pair::page::{self, PAGE, PAGE_SEED, expected, title};
use crate::pair::reactions::Row;
use crate::pair::run::{Summary, run_jobs};
use crate::pair::stage::Stage;
use crate::pair::sweep::{case, cases, judge};
use crate::pair::{Choice, Pair};
use crate::sim::robot_server::RobotPorts;
use crate::tabletop::fit::{Requirements, fit};
use crate::tabletop::parse::parse_instance;
use crate::tabletop::room::Cup;
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use std::net::{IpAddr, Ipv4Addr};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// `celld simulate`
#[derive(Args, Clone, Debug)]
#[command(after_help = HELP)]
pub struct SimulateArgs {
    /// Seed of the cell's truth, of every delay and of the jobs
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Jobs of two to four moves
    #[arg(long, default_value_t = 3)]
    jobs: usize,
    /// A fault file, as for `celld sim`; or `sweep`: every fault in every phase of a pick-n-place; or
    /// `random`: one to three faults in every job, each job of the next seed
    #[arg(long, value_name = "FILE|sweep|random")]
    faults: Option<PathBuf>,
    /// Of the sweep: only cases whose number, name or phase contains this; of random faults: only these, by
    /// number
    #[arg(long, value_name = "TEXT")]
    only: Option<String>,
    /// Of the sweep: write the page of reactions to this file
    #[arg(long, value_name = "FILE")]
    write: Option<PathBuf>,
    /// How the cell sees: rendered pictures with the real detector, or marker corners with its noise
    #[arg(long, value_enum, default_value_t = EyeArg::Corners)]
    eye: EyeArg,
    /// Write what happened, line by line, to this file; the same seed writes the same bytes
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
}

const HELP: &str = "\
The machine that drives a real robot, the simulated cell, a network and a disk run on one thread without socket, file or
clock: the same seed gives the same trace, byte for byte. After every 2 ms of simulated time the rules that hold at all times
are checked against the simulated truth.";

/// How the cell sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum EyeArg {
    /// Rendered pictures with the real detector.
    Pictures,
    /// Marker corners with the detector's noise.
    Corners,
}

/// Six objects on a small table: enough for buffers, small enough for thousands of jobs.
const TABLE: &str = "\
workspace: {width: 0.4, height: 0.4}
clearance: 0.002
objects:
  - {id: plank-1, footprint: {rectangle: {length: 0.10, width: 0.05}}, start: [0.08, 0.08, 0.0]}
  - {id: plank-2, footprint: {rectangle: {length: 0.10, width: 0.05}}, start: [0.22, 0.08, 0.3]}
  - {id: block-1, footprint: {rectangle: {length: 0.06, width: 0.06}}, start: [0.32, 0.20, 0.0]}
  - {id: block-2, footprint: {rectangle: {length: 0.06, width: 0.06}}, start: [0.08, 0.24, 0.5]}
  - {id: lid-1, footprint: {disc: {radius: 0.035}}, start: [0.20, 0.22, 0.0]}
  - {id: lid-2, footprint: {disc: {radius: 0.035}}, start: [0.32, 0.32, 0.0]}
";

/// The closed loop's cell: a small table with six objects, as demo and simulator would configure it.
///
/// # Errors
/// What does not fit together.
pub fn stage(seed: u64, eye: Eye) -> Result<Stage, String> {
    let given = parse_instance(TABLE, "table", &|_| None).map_err(|complaints| complaints.to_string())?;
    let needs = Requirements {
        pixels_per_metre: FOCAL_PX / LOOK_DISTANCE_M,
        least_module_px: 3.0,
        cups: vec![Cup { x: 0.0, y: 0.0, radius: CUP_DIAMETER_M / 2.0 }],
        cup_margin: CUP_MARGIN_M,
    };
    let instance = fit(&given, &needs).map_err(|error| error.to_string())?.instance;
    let choice = DemoChoice {
        bind: IpAddr::V4(Ipv4Addr::LOCALHOST),
        time_factor: 1.0,
        seed,
        solver: "auto".to_string(),
        objective: JobObjective::Pp,
        time_limit_s: 2.0,
    };
    let mut config = cell_config(&instance, &choice, Path::new("."))?;
    if eye == Eye::Corners {
        // Corners have no depth.
        config.foreign = crate::cell::supervisor::model::ForeignRule::Off;
    }
    let file = sim_file(&instance, &config, &choice)?;
    stage_of(&config, &file, seed)
}

/// The closed loop's cell as two configurations have it: the daemon's and the simulator's.
///
/// # Errors
/// What does not fit together.
pub fn stage_of(config: &CellConfig, sim: &SimFile, seed: u64) -> Result<Stage, String> {
    let sim = sim_config(sim, IpAddr::V4(Ipv4Addr::LOCALHOST), RobotPorts::ANY);
    let parameters = machine_parameters(config, seed.wrapping_add(1));
    Stage::new(config, sim, parameters, seed)
}

/// Runs the subcommand; returns the exit code.
pub fn run(args: &SimulateArgs) -> u8 {
    let eye = match args.eye {
        EyeArg::Pictures => Eye::Pictures,
        EyeArg::Corners => Eye::Corners,
    };
    match args.faults.as_deref().and_then(Path::to_str) {
        Some("sweep") => return sweep(args),
        Some("random") => return storms::run(args),
        _ => {}
    }
    let faults = args.faults.as_deref().map_or(Ok(Vec::new()), faults_of);
    let prepared = faults.and_then(|faults| Ok((faults, stage(args.seed, eye)?)));
    let (faults, stage) = match prepared {
        Ok(prepared) => prepared,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    let choice = Choice { eye, keep_trace: args.trace.is_some(), ..Choice::of(args.seed) };
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
    let eye = if eye == Eye::Pictures { " --eye pictures" } else { "" };
    complain(&format!("repeat with: celld simulate --seed {} --jobs {}{faults}{eye}", args.seed, args.jobs));
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
    let stage = match stage(args.seed, Eye::Corners) {
        Ok(stage) => stage,
        Err(message) => {
            complain(&message);
            return 2;
        }
    };
    let expected = (args.seed == PAGE_SEED).then(|| expected(PAGE));
    let bar = ProgressBar::new(chosen.len() as u64);
    let began = Instant::now();
    let ran: Result<Vec<(&Row, Phase, Outcome)>, String> = chosen
        .par_iter()
        .map(|(row, phase)| {
            let (outcome, pair) = case(&stage, row, *phase, args.seed, args.trace.is_some())?;
            bar.inc(1);
            let faults = judge(row, *phase, &outcome, expected.as_ref());
            if !faults.is_empty() || args.only.is_some() {
                bar.suspend(|| print(&case_text(&title(row, *phase), &faults, &pair, args.only.is_some())));
            }
            keep_trace(args, &pair)?;
            Ok((*row, *phase, outcome))
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
        .filter(|(row, phase, found)| !judge(row, *phase, found, expected.as_ref()).is_empty());
    let (mut bad, seconds) = (bad.count(), began.elapsed().as_secs_f64());
    print(&format!("{} cases, {bad} not as expected, {seconds:.0} s\n", outcomes.len()));
    if args.seed == PAGE_SEED && args.only.is_none() && bad == 0 && page::write(&outcomes) != PAGE {
        bad += 1;
        print("docs/reactions.md is not what the sweep writes: see the known violations\n");
    }
    if args.seed != PAGE_SEED {
        print("with this seed only the rules were checked: docs/reactions.md is written with seed 0\n");
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

fn keep_trace(args: &SimulateArgs, pair: &Pair) -> Result<(), String> {
    let Some(path) = &args.trace else { return Ok(()) };
    std::fs::write(path, pair.trace.lines().join("\n") + "\n")
        .map_err(|error| format!("{}: {error}", path.display()))
}
