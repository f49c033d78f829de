//! `celld demo`: the whole cell in simulation, one command.
//!
//! In: a named scene or an instance file. Out: the table rearranged, a summary on stdout, and in the output
//! folder `report.html`, `plan.svg`, `start.png`, `end.png`, `run.mcap`, `result.json`. Exit 0 when every
//! object ended at its goal, 1 when not, 2 for bad input, 130 after Ctrl-C.

mod output;
pub mod run;
pub mod watch;

use crate::cli::task::TaskArgs;
use crate::cli::task::outln;
use crate::cli::values;
use crate::demo::cell::DemoChoice;
use crate::demo::task::{fitted, possible_cell, smallest_table_m};
use cell_edge::priority;
use clap::Args;
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;
use rearrange::tabletop::fit;
use rearrange::tabletop::instance::Instance;
use rearrange::tabletop::scenes::{SCENES, scene};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use ur_sim::command::faults_of;

/// Longer side of the table that instance files are scaled to, m.
const FILE_TABLE_M: f64 = 0.5;

/// `celld demo`
#[derive(Args, Clone, Debug)]
pub struct DemoArgs {
    /// Named scene: tetris-heart, planks, blocks or desk.
    #[arg(long, conflicts_with = "instance")]
    scene: Option<String>,
    /// An instance file (YAML or JSON, ours or of the public data) instead of a scene.
    #[arg(long, value_name = "FILE")]
    instance: Option<PathBuf>,
    /// Edge of the table, m; instance files are scaled to it.
    #[arg(long, value_name = "M", value_parser = values::table_size)]
    table_size: Option<f64>,
    /// Solver: tbm, rbm, etbm, erbm, mcts, emcts or auto.
    #[arg(long, default_value = "auto")]
    solver: SolverKind,
    /// What plans are judged by: pp moves, ti total impedance, time the arm's seconds.
    #[arg(long, default_value = "pp")]
    objective: Objective,
    /// Seed of the simulated world's truth, its errors and the planner.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Planning budget, s.
    #[arg(long, default_value_t = 2.0, value_name = "S", value_parser = values::planning_seconds)]
    time_limit: f64,
    /// Simulated seconds per second.
    #[arg(long, default_value_t = 5.0, value_name = "F", value_parser = ur_sim::command::time_factor)]
    time_factor: f64,
    /// Loopback address of the simulated devices.
    #[arg(long, default_value = "127.0.0.1", value_parser = values::loopback)]
    bind: IpAddr,
    /// What goes wrong and when (docs/faults.md); nothing without it.
    #[arg(long, value_name = "FILE")]
    faults: Option<PathBuf>,
    /// Where the report, pictures and recording go.
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Print the smallest table size every object allows, and stop.
    #[arg(long)]
    fit_only: bool,
}

/// Runs the demo; returns the exit code.
pub fn run(args: &DemoArgs, stop: Arc<AtomicBool>) -> u8 {
    match prepare(args) {
        Ok(Some(instance)) => perform(args, &instance, stop),
        Ok(None) => 0,
        Err(message) => {
            eprintln!("celld demo: {message}");
            2
        }
    }
}

fn prepare(args: &DemoArgs) -> Result<Option<Instance>, String> {
    let given = match &args.instance {
        Some(path) => read_instance(path)?,
        None => {
            let name = args.scene.as_deref().unwrap_or(SCENES[0].name);
            scene(name).map_err(|error| error.to_string())?
        }
    };
    if args.fit_only {
        outln!("{:.2}", smallest_table_m(&given)?);
        return Ok(None);
    }
    let of_a_file = args.instance.as_ref().map(|_| FILE_TABLE_M);
    fitted(&given, args.table_size.or(of_a_file)).map(Some)
}

fn read_instance(path: &Path) -> Result<Instance, String> {
    TaskArgs { instance: path.to_path_buf(), goal: None, shapes: None }.read_instance()
}

fn perform(args: &DemoArgs, instance: &Instance, stop: Arc<AtomicBool>) -> u8 {
    let choice = DemoChoice {
        bind: args.bind,
        time_factor: args.time_factor,
        seed: args.seed,
        solver: args.solver,
        objective: args.objective,
        time_limit_s: args.time_limit,
    };
    if let Err(error) = std::fs::create_dir_all(&args.out) {
        eprintln!("celld demo: {}: {error}", args.out.display());
        return 2;
    }
    let table = fit::table_size(instance);
    eprintln!(
        "{} objects on a table of {table:.2} m, density {:.2}",
        instance.objects.len(),
        instance.density()
    );
    let config = match possible_cell(instance, &choice, &args.out) {
        Ok(config) => config,
        Err(message) => {
            eprintln!("celld demo: {message}");
            return 2;
        }
    };
    let faults = match args.faults.as_deref().map_or(Ok(Vec::new()), faults_of) {
        Ok(faults) => faults,
        Err(message) => {
            eprintln!("celld demo: {message}");
            return 2;
        }
    };
    let runtime = match tokio::runtime::Builder::new_multi_thread()
        .worker_threads(3)
        .enable_all()
        .on_thread_start(priority::raise)
        .build()
    {
        Ok(runtime) => runtime,
        Err(error) => {
            eprintln!("celld demo: {error}");
            return 1;
        }
    };
    let interrupted = Arc::new(AtomicBool::new(false));
    priority::raise();
    let watcher = watch_for_interrupt(&runtime, stop.clone(), interrupted.clone());
    let outcome = runtime.block_on(run::demo(instance, &choice, &config, faults, &args.out, stop));
    watcher.abort();
    let code = match outcome {
        Ok(outcome) => output::write(&outcome, instance, &choice, &args.out),
        Err(error) => {
            eprintln!("celld demo: {error}");
            if matches!(error, run::DemoError::Faults(_)) { 2 } else { 1 }
        }
    };
    if interrupted.load(Ordering::Relaxed) { 130 } else { code }
}

/// Ctrl-C raises `stop`: the daemon stops the arm and ends.
fn watch_for_interrupt(
    runtime: &tokio::runtime::Runtime,
    stop: Arc<AtomicBool>,
    interrupted: Arc<AtomicBool>,
) -> tokio::task::JoinHandle<()> {
    runtime.spawn(async move {
        if tokio::signal::ctrl_c().await.is_ok() {
            interrupted.store(true, Ordering::Relaxed);
            stop.store(true, Ordering::Relaxed);
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Command, FromArgMatches as _};

    fn args(words: &[&str]) -> Result<DemoArgs, clap::Error> {
        let command = DemoArgs::augment_args(Command::new("celld").no_binary_name(true));
        DemoArgs::from_arg_matches(&command.try_get_matches_from(words)?)
    }

    #[test]
    fn wrong_options_are_refused_before_anything_starts() {
        let wrong = [
            ("--solver=foo", "\"foo\" is not known here; one of: tbm, rbm"),
            ("--objective=foo", "one of: pp, ti, time"),
            ("--time-limit=-1", "between 0.001 and 86400 s"),
            ("--time-limit=nan", "between 0.001 and 86400 s"),
            ("--time-limit=1e30", "between 0.001 and 86400 s"),
            ("--time-factor=0", "between 0.01 and 1000"),
            ("--table-size=5", "between 0.1 and 2 m"),
            ("--bind=0.0.0.0", "loopback"),
        ];
        for (word, expected) in wrong {
            let error = args(&[word]).unwrap_err();
            assert_eq!(error.exit_code(), 2, "{word}");
            assert!(error.to_string().contains(expected), "{word}: {error}");
        }
        assert!(args(&["--solver=mcts", "--time-limit=0.5", "--time-factor=20"]).is_ok());
    }

    #[test]
    fn an_object_with_a_marker_of_the_table_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("task.yaml");
        let task = |id: u32| {
            format!(
                "workspace: {{width: 0.5, height: 0.5}}\n\
                 objects:\n  - {{id: mug, footprint: {{disc: {{radius: 0.05}}}}, \
                 start: [0.2, 0.2, 0], marker: {{id: {id}, size: 0.05}}}}\n"
            )
        };
        let prepared = |id: u32| {
            std::fs::write(&path, task(id)).unwrap();
            prepare(&args(&[&format!("--instance={}", path.display())]).unwrap())
        };
        let reported = prepared(505).unwrap_err();
        assert!(
            reported.contains("object `mug` carries marker 505") && reported.contains("500 to 511"),
            "{reported}"
        );
        assert!(prepared(7).unwrap().is_some());
    }
}
