//! The command line: one file a subcommand, and the dispatcher.
//!
//! In: arguments. Out: an exit code: 0 done, 1 understood and not succeeded, 2 bad input or usage, 130 after
//! Ctrl-C without a result.

mod approve;
pub mod bench_cases;
pub mod bench_figures;
pub mod bench_loop;
pub mod bench_motion;
pub mod bench_planning;
pub mod bench_rtde;
pub mod bench_vision;
pub mod calibrate;
pub mod capture;
pub mod check;
pub mod client;
pub mod daemon;
pub mod demo;
pub mod detect;
pub mod doctor;
#[cfg(feature = "fleet")]
pub mod fleet;
pub mod generate;
pub mod history;
mod in_fleet;
pub mod interrupt;
pub mod jobs;
pub mod journal;
pub mod markers;
pub mod open;
pub mod plan;
mod progress;
pub mod realsense;
pub mod record;
pub mod replay;
pub mod schema;
pub mod shell;
pub mod simulate;
pub mod submit;
pub mod task;
pub mod unit;
mod values;
pub mod verify;
pub mod watch;

use crate::io::camera::realsense::COMMAND;
use clap::{CommandFactory, Parser, Subcommand};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A robot cell that rearranges a cluttered table.
#[derive(Parser, Debug)]
#[command(name = "celld", version, about, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Run the whole cell in simulation, one command
    Demo(demo::DemoArgs),
    /// Run the daemon: job files in, a tidy table out
    Run(daemon::RunArgs),
    /// The address filter of a cell, as a drop-in for systemd
    Unit(unit::UnitArgs),
    /// What is missing between this computer and a moving robot, on one page
    Doctor(doctor::DoctorArgs),
    /// Simulated UR5e, VGC10 and camera behind the real protocols
    Sim(ur_sim::command::SimArgs),
    /// Whole cells in virtual time, checked against the rules that always hold
    Simulate(simulate::SimulateArgs),
    /// Calibrate lens, camera mount and table, live or from recorded pictures
    Calibrate(calibrate::CalibrateArgs),
    /// The arm's joints into a file, as the controller reports them; only listens
    #[command(after_help = record::HELP)]
    Record(record::RecordArgs),
    /// Markers found in a picture
    Detect(detect::DetectArgs),
    /// The table as it is now, as a goal file
    Capture(capture::CaptureArgs),
    /// Markers and calibration boards for the printer
    Markers(markers::MarkersArgs),
    /// Plan a rearrangement
    Plan(plan::PlanArgs),
    /// Check a plan independently
    Verify(verify::VerifyArgs),
    /// Check files: configuration, calibration, job, goal, instance
    Check(check::CheckArgs),
    /// Carry a recorded run out again: the same observations, and whether the cell decides the same
    Replay(replay::ReplayArgs),
    /// Recordings (MCAP): make whole what a killed daemon left
    #[command(subcommand)]
    Recordings(replay::RecordingsCommand),
    /// The journal (database of jobs and steps): repair a damaged one
    #[command(subcommand)]
    Journal(journal::JournalCommand),
    /// The shape of a kind of file as JSON Schema, for editors and other programs
    Schema(schema::SchemaArgs),
    /// What a shell completes behind `celld`
    Completions(shell::CompletionsArgs),
    /// Manual pages of all commands
    Man(shell::ManArgs),
    /// Make random instances of the paper's scenarios
    Generate(generate::GenerateArgs),
    /// Measure, print a table, draw figures
    #[command(subcommand)]
    Bench(Bench),
    /// Many cells, one queue: submit, look, agree, cancel
    #[cfg(feature = "fleet")]
    #[command(subcommand)]
    Fleet(fleet::FleetCommand),
    #[command(flatten)]
    Client(jobs::ClientCommand),
}

#[derive(Subcommand, Debug)]
enum Bench {
    /// Solvers on generated or public instances
    Planning(Box<bench_planning::BenchPlanningArgs>),
    /// Marker detection and poses on rendered pictures
    Vision(bench_vision::BenchVisionArgs),
    /// The paper's figures from result tables
    Figures(bench_figures::BenchFiguresArgs),
    /// What the RTDE codec costs, and how the simulator keeps its 500 Hz
    Rtde(bench_rtde::BenchRtdeArgs),
    /// Kinematics, the check of paths, reach and ways: what they cost, and how right they are
    Motion(bench_motion::BenchMotionArgs),
    /// The closed loop: its speed, repeated seeds, random faults, the sweep
    Loop(bench_loop::BenchLoopArgs),
}

/// Parses the process's arguments and runs the subcommand.
pub fn main() -> ExitCode {
    if std::env::args_os().nth(1).is_some_and(|word| word == COMMAND) {
        return ExitCode::from(realsense::run());
    }
    let cli = Cli::parse();
    // A daemon's log is its only voice.
    let _log = cell_edge::log::start(if matches!(cli.command, Command::Run(_)) { "info" } else { "error" });
    let stop = Arc::new(AtomicBool::new(false));
    ExitCode::from(match cli.command {
        Command::Demo(args) => demo::run(&args, stop),
        Command::Run(args) => daemon::run(&args, stop),
        Command::Unit(args) => unit::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Sim(args) => ur_sim::command::run(&args),
        Command::Simulate(args) => simulate::run(&args),
        Command::Calibrate(args) => calibrate::run(&args, stop),
        Command::Record(args) => {
            interrupt::watch(&stop);
            record::run(&args, &stop)
        }
        Command::Detect(args) => detect::run(&args),
        Command::Capture(args) => capture::run(&args),
        Command::Markers(args) => markers::run(&args),
        Command::Plan(args) => {
            interrupt::watch(&stop);
            plan::run(&args, &stop)
        }
        Command::Verify(args) => {
            interrupt::watch(&stop);
            verify::run(&args, &stop)
        }
        Command::Check(args) => check::run(&args),
        Command::Generate(args) => generate::run(&args),
        Command::Schema(args) => schema::run(&args),
        Command::Completions(args) => shell::completions(&args, Cli::command()),
        Command::Man(args) => shell::man(&args, Cli::command()),
        Command::Replay(args) => replay::run(&args),
        Command::Recordings(command) => replay::recordings(&command),
        Command::Journal(command) => journal::run(&command),
        Command::Bench(Bench::Planning(args)) => {
            interrupt::watch(&stop);
            bench_planning::run(&args, &stop)
        }
        Command::Bench(Bench::Vision(args)) => {
            interrupt::watch(&stop);
            bench_vision::run(&args, &stop)
        }
        Command::Bench(Bench::Figures(args)) => bench_figures::run(&args),
        Command::Bench(Bench::Rtde(args)) => bench_rtde::run(&args),
        Command::Bench(Bench::Motion(args)) => bench_motion::run(&args),
        Command::Bench(Bench::Loop(args)) => bench_loop::run(&args),
        #[cfg(feature = "fleet")]
        Command::Fleet(command) => fleet::run(command, &stop),
        Command::Client(jobs::ClientCommand::Watch(args)) => watch::run(&args, &stop),
        Command::Client(command) => jobs::run(command, &stop),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::ValueEnum;
    use std::path::Path;

    /// The commands in the indented blocks of a page, without the comments behind them; one that ends in
    /// `...` is cut there.
    fn commands(page: &str) -> Vec<String> {
        let page = page.replace(" \\\n", " ");
        let blocks = page.lines().filter_map(|line| line.strip_prefix("    "));
        let commands = blocks.map(str::trim).filter(|line| line.starts_with("celld "));
        let bare = commands.map(|line| line.split(" #").next().unwrap_or_default().trim());
        bare.map(|line| line.trim_end_matches("...").trim().to_string()).collect()
    }

    #[test]
    fn the_pages_name_no_command_that_does_not_exist() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let docs = std::fs::read_dir(root.join("docs")).expect("the pages");
        let mut pages: Vec<_> = docs.flatten().map(|entry| entry.path()).collect();
        pages.retain(|path| path.extension().is_some_and(|extension| extension == "md"));
        pages.extend(["README.md", "hardware/README.md"].map(|name| root.join(name)));
        let (mut tried, mut wrong) = (0, Vec::new());
        for path in pages {
            let page = std::fs::read_to_string(&path).expect("a page");
            for line in commands(&page) {
                tried += 1;
                let words = line.split_whitespace().map(|word| word.trim_matches(['\'', '"']));
                if let Err(error) = Cli::try_parse_from(words) {
                    wrong.push(format!("{}: {line}\n{error}", path.display()));
                }
            }
        }
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
        assert!(tried > 40, "{tried} commands");
    }

    /// Every command and option of the program is known to every shell.
    #[test]
    fn completions_know_every_command() {
        for shell in clap_complete::Shell::value_variants() {
            let mut script = Vec::new();
            clap_complete::generate(*shell, &mut Cli::command(), "celld", &mut script);
            let script = String::from_utf8(script).expect("text");
            for known in Cli::command().get_subcommands() {
                assert!(script.contains(known.get_name()), "{shell}: {}", known.get_name());
            }
            assert!(script.contains("time-limit"), "{shell}: options of `celld plan`");
        }
    }

    #[test]
    fn every_command_has_its_manual_page() {
        let folder = tempfile::tempdir().expect("a folder");
        shell::pages(Cli::command(), folder.path()).expect("written");
        let page = |name: &str| std::fs::read_to_string(folder.path().join(name)).expect("a page");
        for known in Cli::command().get_subcommands() {
            assert!(
                page(&format!("celld-{}.1", known.get_name())).starts_with(".ie"),
                "{}",
                known.get_name()
            );
        }
        assert!(page("celld.1").contains("celld\\-plan"), "the page of celld names the others");
        assert!(page("celld-plan.1").contains("time\\-limit"));
    }
}
