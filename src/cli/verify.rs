//! `celld verify`: checks a plan file against its instance, independently of the solver that made it.
//!
//! In: an instance and a plan file. Out: whether the plan can be carried out as written, whether what the
//! file says of itself is true, and which given overlaps were taken as they are. Exit code 0 when all is
//! well, 1 when a fault was found or the time was up before all was known, 2 for files that cannot be read,
//! 130 after Ctrl-C.

use crate::cli::plan::seconds;
use crate::cli::task::TaskArgs;
use cell_edge::terminal::{complain, print, read_text};
use rearrange::planning::check::{self, GivenIn};
use rearrange::planning::claims::{Examined, examine};
use rearrange::planning::plan::{Action, PlanFile};
use rearrange::planning::problem::Problem;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Arguments of `celld verify`.
#[derive(Clone, Debug, clap::Args)]
pub struct VerifyArgs {
    /// The task
    #[command(flatten)]
    pub task: TaskArgs,
    /// The plan file to check
    pub plan: PathBuf,
    /// Seconds for the check; a plan that is not checked to the end by then is not valid (exit code 1)
    #[arg(long, value_name = "S", default_value_t = 600.0, value_parser = seconds)]
    pub time_limit: f64,
    /// What standard output gets
    #[arg(long, default_value = "text", value_parser = ["text", "json"])]
    pub format: String,
}

/// What `verify` found.
#[derive(Debug, serde::Serialize)]
struct Report {
    valid: bool,
    /// False where the time was up first.
    finished: bool,
    fault: Option<String>,
    moves: usize,
    /// Given overlaps that are exempt.
    exempt: Vec<Exempt>,
}

#[derive(Debug, serde::Serialize)]
struct Exempt {
    arrangement: &'static str,
    object: String,
    meets: String,
    depth_mm: f64,
}

/// Runs `celld verify`; `stop` is set by Ctrl-C. Returns the exit code.
pub fn run(args: &VerifyArgs, stop: &AtomicBool) -> u8 {
    let begun = Instant::now();
    let read = || -> Result<(Problem, PlanFile, Vec<Action>), String> {
        let problem = args.task.read()?;
        let located = |error: &dyn std::fmt::Display| format!("{}: {error}", args.plan.display());
        let file = PlanFile::parse(&read_text(&args.plan)?).map_err(|error| located(&error))?;
        let actions = file.actions_for(&problem).map_err(|error| located(&error))?;
        Ok((problem, file, actions))
    };
    let (problem, file, actions) = match read() {
        Ok(all) => all,
        Err(complaints) => {
            complain(&complaints);
            return 2;
        }
    };
    let interrupted = || stop.load(Ordering::Relaxed);
    let over = || interrupted() || begun.elapsed().as_secs_f64() >= args.time_limit;
    let Examined { fault, exempt, finished } = examine(&problem, &file, &actions, &over);
    if !finished && interrupted() {
        complain("stopped before the plan was checked to the end");
        return 130;
    }
    let limit = args.time_limit;
    let late = |fault: String| format!("{fault} after {limit} s; give it longer with --time-limit");
    let fault = if finished { fault } else { fault.map(late) };
    let exempt = exempt.iter().map(Exempt::new).collect();
    let report = Report { valid: fault.is_none(), finished, fault, moves: actions.len(), exempt };
    print(&if args.format == "json" { json(&report) } else { text(&report) });
    if report.valid { 0 } else { 1 }
}

impl Exempt {
    fn new(exempt: &check::Exempt) -> Exempt {
        let arrangement = match exempt.given {
            GivenIn::Start => "start",
            GivenIn::Goal => "goal",
        };
        let (object, meets) = (exempt.object.clone(), exempt.meets.clone());
        Exempt { arrangement, object, meets, depth_mm: exempt.depth_m * 1e3 }
    }
}

fn json(report: &Report) -> String {
    // The report has string keys and finite numbers only; nothing in it can fail to serialise.
    serde_json::to_string_pretty(report).unwrap_or_default() + "\n"
}

fn text(report: &Report) -> String {
    let mut text = match &report.fault {
        None => format!("valid: {} moves\n", report.moves),
        Some(fault) if !report.finished => format!("not verified: {fault}\n"),
        Some(fault) => format!("not valid: {fault}\n"),
    };
    for e in &report.exempt {
        text += &format!(
            "taken as given: {} overlaps {} by {:.3} mm in the {} arrangement\n",
            e.object, e.meets, e.depth_mm, e.arrangement
        );
    }
    text
}
