//! `celld verify`: checks a plan file against its instance, independently of the solver that made it.
//!
//! In: an instance and a plan file. Out: whether the plan can be carried out as written, whether what the
//! file says of itself is true, and which given overlaps were taken as they are. Exit code 0 when all is
//! well, 1 when a fault was found, 2 for files that cannot be read.

use crate::cli::task::TaskArgs;
use cell_edge::terminal::{complain, print, read_text};
use rearrange::planning::check::{self, GivenIn};
use rearrange::planning::claims::examine;
use rearrange::planning::plan::{Action, PlanFile};
use rearrange::planning::problem::Problem;
use std::path::PathBuf;

/// Arguments of `celld verify`.
#[derive(Clone, Debug, clap::Args)]
pub struct VerifyArgs {
    /// The task
    #[command(flatten)]
    pub task: TaskArgs,
    /// The plan file to check
    pub plan: PathBuf,
    /// What standard output gets
    #[arg(long, default_value = "text", value_parser = ["text", "json"])]
    pub format: String,
}

/// What `verify` found.
#[derive(Debug, serde::Serialize)]
struct Report {
    valid: bool,
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

/// Runs `celld verify`. Returns the exit code.
pub fn run(args: &VerifyArgs) -> u8 {
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
    let found = examine(&problem, &file, &actions);
    let exempt = found.exempt.iter().map(Exempt::new).collect();
    let report = Report { valid: found.fault.is_none(), fault: found.fault, moves: actions.len(), exempt };
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
