//! `celld plan` and `celld verify` from files to files, with the exit codes of the design.

use crate::cell::{CELLD, wait_until};
use crate::edit::replace_once;
use celld::cli::plan::{PlanArgs, run as plan};
use celld::cli::verify::{VerifyArgs, run as verify};
use clap::{Args, Command};
use rearrange::planning::plan::{PlanFile, Status};
use std::io::{BufRead, BufReader, Lines};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Stdio};
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
        self.verify_with(instance, &[], false)
    }

    fn verify_with(&self, instance: &str, more: &[&str], stopped: bool) -> u8 {
        let plan = self.path("plan.json").display().to_string();
        let words = [&[instance, &plan], more].concat();
        verify(&args::<VerifyArgs>(&words), &AtomicBool::new(stopped))
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

/// A grid of squares of which each has to go where its right neighbour is, and the last in a row to the
/// first.
fn rotated_rows(per_row: usize, rows: usize, vacant: usize) -> String {
    let pitch = 1.0 / per_row.max(rows) as f64;
    let mut text = "workspace: {width: 1.0, height: 1.0}\nobjects:\n".to_string();
    let count = per_row * rows - vacant;
    for k in 0..count {
        let in_row = per_row.min(count - k / per_row * per_row);
        let at = |column: usize, row: usize| {
            format!("[{}, {}, 0.0]", (column as f64 + 0.5) * pitch, (row as f64 + 0.5) * pitch)
        };
        let (column, row) = (k % per_row, k / per_row);
        let (start, goal) = (at(column, row), at((column + 1) % in_row, row));
        let size = 0.9 * pitch;
        text += &format!(
            "  - {{id: o{k}, footprint: {{rectangle: {{length: {size}, width: {size}}}}}, start: {start}, goal: {goal}}}\n"
        );
    }
    text
}

/// 255 objects were one too many for stops, 256 for the proof about room, 257 for every set.
#[test]
fn more_objects_than_a_bitset_holds_get_a_plan_or_a_timeout_from_every_solver() {
    let files = Files::new();
    for (name, vacant) in [("255", 1), ("256", 0)] {
        let instance = files.write(&format!("{name}.yaml"), &rotated_rows(16, 16, vacant));
        for solver in ["tbm", "rbm", "etbm", "erbm", "mcts", "emcts", "auto"] {
            let code = files.plan(&instance, &["--solver", solver, "--work", "2000"], false);
            let file = read(&files.path("plan.json"));
            assert_eq!(code == 0, file.moves.is_some(), "{name} {solver}: {:?}", file.status);
            assert!(code <= 1 && file.lower_bound >= 240.0, "{name} {solver}: {code} {}", file.lower_bound);
        }
    }
    let instance = files.write("300.yaml", &rotated_rows(20, 15, 0));
    assert_eq!(files.plan(&instance, &["--work", "4000", "--first"], false), 0);
    assert_eq!(files.verify(&instance), 0);
}

#[test]
fn a_check_that_has_no_time_says_so_and_vouches_for_nothing() {
    let files = Files::new();
    let instance = files.write("swap.yaml", SWAP);
    assert_eq!(files.plan(&instance, &["--work", "100000"], false), 0);
    assert_eq!(files.verify_with(&instance, &["--time-limit", "60"], false), 0);
    assert_eq!(files.verify_with(&instance, &["--time-limit", "0"], false), 1);
    assert_eq!(files.verify_with(&instance, &[], true), 130);
}

/// The real program, planning, and the lines that it says.
fn planning(words: &[&str]) -> (Child, Lines<BufReader<ChildStderr>>) {
    let mut program = std::process::Command::new(CELLD)
        .arg("plan")
        .args(words)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary runs");
    let said = program.stderr.take().expect("piped");
    (program, BufReader::new(said).lines())
}

fn interrupt(program: &Child) {
    let kill = format!("kill -INT {}", program.id());
    let sent = std::process::Command::new("sh").args(["-c", &kill]).status().expect("sh");
    assert!(sent.success());
}

/// The kernel's list of signals that a process handles itself has SIGINT, which is signal 2.
fn handles_interrupts(program: &Child) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{}/status", program.id())).expect("it runs");
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).expect("a mask of signals");
    u64::from_str_radix(caught.trim(), 16).expect("hexadecimal") >> 1 & 1 == 1
}

#[test]
fn ctrl_c_leaves_the_best_plan_there_is() {
    let files = Files::new();
    let instance = files.write("swap.yaml", SWAP);
    let out = files.path("plan.json").display().to_string();
    // No bound reaches the seconds of a plan: this search goes on for ten minutes.
    let words = [instance.as_str(), "--objective", "time", "--time-limit", "600", "--out", &out];
    let (mut program, mut said) = planning(&words);
    assert!(said.any(|line| line.expect("text").contains("cost ")), "a first plan is reported");
    interrupt(&program);
    assert_eq!(program.wait().expect("it ends").code(), Some(0));
    let file = read(&files.path("plan.json"));
    assert!(file.status == Status::Solved && file.seconds < 300.0, "{file:?}");
    assert_eq!(files.verify(&instance), 0);
}

#[test]
fn ctrl_c_without_a_plan_is_exit_code_130() {
    let files = Files::new();
    // Two squares fill the table: they cannot change places, and no search can prove that.
    let full = "\
workspace: {width: 0.4, height: 0.2}
objects:
  - {id: a, footprint: {rectangle: {length: 0.2, width: 0.2}}, start: [0.1, 0.1, 0.0], goal: [0.3, 0.1, 0.0]}
  - {id: b, footprint: {rectangle: {length: 0.2, width: 0.2}}, start: [0.3, 0.1, 0.0], goal: [0.1, 0.1, 0.0]}
";
    let instance = files.write("full.yaml", full);
    let out = files.path("plan.json").display().to_string();
    let (mut program, mut said) = planning(&[&instance, "--time-limit", "600", "--out", &out]);
    wait_until("it listens for Ctrl-C", || handles_interrupts(&program));
    interrupt(&program);
    assert_eq!(program.wait().expect("it ends").code(), Some(130));
    assert!(said.any(|line| line.expect("text").contains("stopped before a plan was found")));
    assert!(!files.path("plan.json").exists());
}
