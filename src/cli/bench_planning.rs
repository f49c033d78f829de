//! `celld bench planning`: a solver over the public instances, as CSV rows on standard output.
//!
//! In: the folder with the public data, which cells and how many cases of each, solver and limits. Out: CSV on
//! standard output (with `--format table` the summary alone), the summary and progress on standard error.
//! Exit code 0 when all cases ran, 2 for usage and unreadable files, 130 after Ctrl-C.

use crate::bench::planning::{CSV_HEADER, Label, Row, Run, run_case, summary};
use crate::cli::plan::{objective_parser, seconds, solver_parser};
use crate::cli::task::{TaskArgs, complain, print};
use crate::planning::plan::Objective;
use crate::planning::solver::SolverKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Arguments of `celld bench planning`.
#[derive(Clone, Debug, clap::Args)]
pub struct BenchPlanningArgs {
    /// Folder of the public data, with `hetori` and `trlb` in it
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Families: rand, sq, disk, stick, or the name of a folder in `hetori/instances`
    #[arg(long, value_delimiter = ',', default_value = "rand,sq")]
    pub scenario: Vec<String>,
    /// Densities
    #[arg(long, value_delimiter = ',', default_value = "0.20,0.30,0.40", value_parser = seconds)]
    pub density: Vec<f64>,
    /// Numbers of objects
    #[arg(long, value_delimiter = ',', default_value = "20")]
    pub n: Vec<usize>,
    /// Ids of the cases; pairs like 1-3 for discs and sticks
    #[arg(long, value_delimiter = ',', default_value = "0,1,2,3,4")]
    pub ids: Vec<String>,
    /// Solvers
    #[arg(long, value_delimiter = ',', default_value = "erbm", value_parser = solver_parser())]
    pub solver: Vec<SolverKind>,
    /// Objectives
    #[arg(long, value_delimiter = ',', default_value = "pp", value_parser = objective_parser())]
    pub objective: Vec<Objective>,
    /// Seeds
    #[arg(long, value_delimiter = ',', default_value = "0")]
    pub seed: Vec<u64>,
    /// Seconds for one case
    #[arg(long, value_name = "S", default_value = "60", value_parser = seconds)]
    pub time_limit: f64,
    /// Deterministic steps for one case
    #[arg(long, value_name = "N")]
    pub work: Option<u64>,
    /// What standard output gets
    #[arg(long, default_value = "json", value_parser = ["json", "table"])]
    pub format: String,
}

/// Runs the benchmark; `stop` is set by Ctrl-C. Returns the exit code.
pub fn run(args: &BenchPlanningArgs, stop: &AtomicBool) -> u8 {
    let csv = args.format == "json";
    if csv {
        print(&format!("{CSV_HEADER}\n"));
    }
    let mut rows = Vec::new();
    for (label, task) in cases(args) {
        match run_one(args, &label, &task, stop, csv) {
            Ok(more) => rows.extend(more),
            Err(error) => {
                complain(&error);
                return 2;
            }
        }
        if stop.load(Ordering::Relaxed) {
            return 130;
        }
    }
    if rows.is_empty() {
        complain(&format!("{}: no case of the cells asked for", args.data.display()));
        return 2;
    }
    if csv {
        complain(&summary(&rows))
    } else {
        print(&summary(&rows))
    }
    0
}

fn run_one(
    args: &BenchPlanningArgs,
    label: &Label,
    task: &TaskArgs,
    stop: &AtomicBool,
    csv: bool,
) -> Result<Vec<Row>, String> {
    let problem = task.read()?;
    let mut rows = Vec::new();
    for &solver in &args.solver {
        for &objective in &args.objective {
            for &seed in &args.seed {
                let run =
                    Run { solver, objective, seed, limit_seconds: args.time_limit, work_limit: args.work };
                let row = run_case(&problem, label.clone(), run, &|| stop.load(Ordering::Relaxed))
                    .map_err(|error| format!("{}: {error}", task.instance.display()))?;
                if csv {
                    print(&format!("{}\n", row.csv()));
                }
                rows.push(row);
            }
        }
    }
    Ok(rows)
}

/// The cases that exist, in the order asked for.
fn cases(args: &BenchPlanningArgs) -> Vec<(Label, TaskArgs)> {
    let mut cases = Vec::new();
    for scenario in &args.scenario {
        for &density in &args.density {
            for &n in &args.n {
                for id in &args.ids {
                    let task = public_task(&args.data, scenario, density, n, id);
                    if task.instance.is_file() {
                        let label = Label {
                            scenario: scenario.clone(),
                            density: format!("{density:.2}"),
                            id: id.clone(),
                        };
                        cases.push((label, task));
                    }
                }
            }
        }
    }
    cases
}

/// Where a case of the public data lies.
pub fn public_task(data: &Path, scenario: &str, density: f64, n: usize, id: &str) -> TaskArgs {
    let pair = |folder: &str| {
        let cell = data.join("trlb").join(folder).join(format!("D={density:.1}/n={n}"));
        let (start, goal) = id.split_once('-').unwrap_or((id, id));
        let file = |id: &str| cell.join(format!("{id}_{n}_{density:.1}.json"));
        TaskArgs { instance: file(start), goal: Some(file(goal)), shapes: None }
    };
    let folder = match scenario {
        "disk" => return pair("disks"),
        "stick" => return pair("sticks"),
        "rand" => "random_general",
        "sq" => "Klotski_blocks_2large",
        other => other,
    };
    let cell = data.join("hetori/instances").join(folder).join(format!("Density={density:.2}/numObjs={n}"));
    TaskArgs { instance: cell.join(format!("{id}_{n}_{density:.2}.json")), goal: None, shapes: None }
}
