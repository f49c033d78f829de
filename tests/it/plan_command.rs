//! `celld plan` and `celld verify` from files to files, with the exit codes of the design.

use crate::edit::replace_once;
use celld::cli::plan::{PlanArgs, run as plan};
use celld::cli::verify::{VerifyArgs, run as verify};
use clap::{Args, Command};
use rearrange::planning::plan::{PlanFile, Status};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

const SWAP: &str = "\
workspace: {width: 1.0, height: 0.5}
objects:
  - id: left
    footprint: {rectangle: {length: 0.1, width: 0.2}}
    start: [0.2, 0.25, 0.0]
    goal: [0.6, 0.25, 0.1]
  - id: right
    footprint: {ellipse: {length: 0.12, width: 0.2}}
    start: [0.6, 0.25, 0.3]
    goal_deg: [0.2, 0.25, 30]
";

fn args<A: Args>(words: &[&str]) -> A {
    let command = A::augment_args(Command::new("celld").no_binary_name(true));
    let matches = command.try_get_matches_from(words).expect("valid arguments");
    A::from_arg_matches(&matches).expect("valid arguments")
}

struct Files {
    folder: tempfile::TempDir,
}

impl Files {
    fn new() -> Files {
        Files { folder: tempfile::tempdir().expect("a temporary folder") }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) -> String {
        std::fs::write(self.path(name), text).expect("writable");
        self.path(name).display().to_string()
    }

    fn plan(&self, instance: &str, more: &[&str], stopped: bool) -> u8 {
        let out = self.path("plan.json").display().to_string();
        let words = [&[instance, "--out", &out], more].concat();
        plan(&args::<PlanArgs>(&words), &AtomicBool::new(stopped))
    }

    fn verify(&self, instance: &str) -> u8 {
        let plan = self.path("plan.json").display().to_string();
        verify(&args::<VerifyArgs>(&[instance, &plan]))
    }
}

fn read(path: &Path) -> PlanFile {
    PlanFile::parse(&std::fs::read_to_string(path).expect("written")).expect("a plan file")
}

#[test]
fn a_plan_is_written_drawn_and_verified() {
    let files = Files::new();
    let instance = files.write("swap.yaml", SWAP);
    let svg = files.path("plan.svg").display().to_string();
    assert_eq!(files.plan(&instance, &["--work", "100000", "--svg", &svg, "--format", "json"], false), 0);
    let file = read(&files.path("plan.json"));
    assert_eq!((file.status, file.moves, file.lower_bound), (Status::Optimal, Some(3), 3.0));
    assert!(std::fs::read_to_string(svg).expect("drawn").starts_with("<svg"));
    assert_eq!(files.verify(&instance), 0);
}

#[test]
fn every_false_claim_is_found() {
    let files = Files::new();
    let instance = files.write("swap.yaml", SWAP);
    assert_eq!(files.plan(&instance, &["--work", "100000"], false), 0);
    let good = read(&files.path("plan.json"));
    let spoilt = |spoil: &dyn Fn(&mut PlanFile)| {
        let mut file = good.clone();
        spoil(&mut file);
        files.write("plan.json", &file.to_json());
        files.verify(&instance)
    };
    assert_eq!(spoilt(&|_| ()), 0);
    assert_eq!(spoilt(&|file| file.moves = Some(2)), 1);
    assert_eq!(spoilt(&|file| file.cost = Some(2.0)), 1);
    assert_eq!(spoilt(&|file| file.lower_bound = 4.0), 1);
    assert_eq!(spoilt(&|file| file.actions[2].to.x += 1e-6), 1);
    assert_eq!(spoilt(&|file| file.actions.swap(0, 1)), 1);
    assert_eq!(spoilt(&|file| file.status = Status::Timeout), 1);
    assert_eq!(spoilt(&|file| file.actions[0].object = "nobody".into()), 2);
    files.write("plan.json", "{");
    assert_eq!(files.verify(&instance), 2);
}

#[test]
fn exit_codes_report_how_it_ended() {
    let files = Files::new();
    let overlapping = files.write("a.yaml", &replace_once(SWAP, "[0.2, 0.25, 30]", "[0.55, 0.25, 30]"));
    assert_eq!(files.plan(&overlapping, &[], false), 1);
    let file = read(&files.path("plan.json"));
    assert_eq!((file.status, file.cost, file.moves), (Status::Infeasible, None, None));
    assert!(file.witness.is_some_and(|witness| witness.contains("left")));
    assert_eq!(files.verify(&overlapping), 1);
    let on_top = files.write("b.yaml", &replace_once(SWAP, "start: [0.6,", "start: [0.22,"));
    assert_eq!(files.plan(&on_top, &[], false), 2);
    let unknown_key = files.write("c.yaml", &replace_once(SWAP, "objects:", "objetcs:"));
    assert_eq!(files.plan(&unknown_key, &[], false), 2);
    assert_eq!(files.plan("/nowhere/at/all.yaml", &[], false), 2);
    let good = files.write("swap.yaml", SWAP);
    assert_eq!(files.plan(&good, &[], true), 130);
    assert_eq!(files.plan(&good, &["--work", "1"], false), 1);
}

#[test]
fn seconds_are_minimised_without_a_cell_too() {
    let files = Files::new();
    let instance = files.write("swap.yaml", SWAP);
    assert_eq!(files.plan(&instance, &["--objective", "time", "--work", "20000"], false), 0);
    let file = read(&files.path("plan.json"));
    // Three moves of four seconds at least, and the ways between them.
    assert!(file.moves == Some(3) && file.lower_bound == 12.0, "{file:?}");
    assert!(file.cost.is_some_and(|seconds| seconds > 12.0), "{file:?}");
    assert_eq!(files.verify(&instance), 0);
}

#[test]
fn every_solver_of_the_paper_plans_and_help_distinguishes_them() {
    let files = Files::new();
    let instance = files.write("swap.yaml", SWAP);
    let mut command = PlanArgs::augment_args(Command::new("celld").no_binary_name(true));
    let help = command.render_long_help().to_string();
    for solver in ["tbm", "rbm", "etbm", "erbm", "mcts", "emcts"] {
        for more in [&[][..], &["--first"], &["--strict-paper", "--objective", "ti"]] {
            let words = [&["--solver", solver, "--work", "20000"], more].concat();
            assert_eq!(files.plan(&instance, &words, false), 0, "{words:?}");
            assert_eq!(read(&files.path("plan.json")).solver, solver);
            assert_eq!(files.verify(&instance), 0, "{words:?}");
        }
        assert!(help.contains(&format!("\n            {solver} ")), "{solver} is explained in\n{help}");
    }
}

#[test]
fn same_seed_and_work_same_plan_on_any_number_of_threads() {
    let files = Files::new();
    let instance = files.write("swap.yaml", SWAP);
    for solver in ["tbm", "rbm", "etbm", "erbm", "mcts", "emcts"] {
        let plan = |threads: &str| {
            let words = ["--solver", solver, "--seed", "5", "--work", "20000", "--threads", threads];
            assert_eq!(files.plan(&instance, &words, false), 0, "{words:?}");
            let mut file = read(&files.path("plan.json"));
            (file.first_plan_seconds, file.seconds) = (None, 0.0);
            file.to_json()
        };
        let one = plan("1");
        for threads in ["2", "4"] {
            assert_eq!(plan(threads), one, "{solver} on {threads} threads");
        }
    }
}
