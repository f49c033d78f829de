//! The whole cell as a user starts it: the binary, real sockets, the simulated devices in scaled time.
//!
//! Names begin with `cell_`, so that `make test` runs these by themselves (Makefile). Every simulation has
//! a loopback address of its own, because the robot's port numbers are fixed.

use crate::edit::{replace_once, replace_times};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

pub(crate) const CELLD: &str = env!("CARGO_BIN_EXE_celld");

/// Longest time a part of a test may take; a machine that needs more has another problem.
pub(crate) const PATIENCE: Duration = Duration::from_secs(240);

/// Two planks that have to change places, and a disc in the way of nothing.
const SWAP: &str = "\
workspace: {width: 0.4, height: 0.4}
clearance: 0.002
objects:
  - {id: a, footprint: {rectangle: {length: 0.12, width: 0.06}}, start: [0.1, 0.1, 0.0], goal: [0.3, 0.12, 0.4]}
  - {id: b, footprint: {rectangle: {length: 0.12, width: 0.06}}, start: [0.3, 0.1, 0.3], goal: [0.1, 0.1, 0.0]}
  - {id: c, footprint: {disc: {radius: 0.04}}, start: [0.2, 0.3, 0.0], goal: [0.2, 0.3, 0.0]}
";

pub(crate) fn celld(arguments: &[&str], folder: &Path) -> Output {
    Command::new(CELLD).args(arguments).current_dir(folder).output().expect("the binary runs")
}

pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn cell_demo_brings_every_object_to_its_goal_and_the_world_agrees() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("swap.yaml"), SWAP).expect("written");
    let run = celld(
        &[
            "demo",
            "--instance",
            "swap.yaml",
            "--table-size",
            "0.4",
            "--seed",
            "3",
            "--time-factor",
            "4",
            "--out",
            "o",
        ],
        folder.path(),
    );
    let said = format!("{}\n{}", text(&run.stdout), text(&run.stderr));
    assert_eq!(run.status.code(), Some(0), "{said}");
    let result = std::fs::read_to_string(folder.path().join("o/result.json")).expect("result");
    let result: serde_json::Value = serde_json::from_str(&result).expect("json");
    assert_eq!(result["lower_bound"], 3.0, "a swap needs a buffer: {result}");
    for object in result["objects"].as_array().expect("objects") {
        let error = object["true_error"]["mm"].as_f64().expect("a number");
        assert!(error < 2.0, "{object}");
        assert!(error > 0.0 || object["id"] == "c", "whatever was moved has an error: {object}");
    }
    for file in ["report.html", "plan.svg", "start.png", "end.png", "run.mcap"] {
        let size = std::fs::metadata(folder.path().join("o").join(file)).map(|meta| meta.len());
        assert!(size.as_ref().is_ok_and(|size| *size > 1000), "{file}: {size:?}");
    }
}

/// A library of this C code, to be loaded before libc (`LD_PRELOAD`).
pub(crate) fn preloaded(folder: &Path, code: &str) -> PathBuf {
    let (source, library) = (folder.join("preloaded.c"), folder.join("preloaded.so"));
    std::fs::write(&source, code).expect("written");
    let built = Command::new("cc").args(["-shared", "-fPIC", "-o"]).arg(&library).arg(&source).status();
    assert!(built.expect("a C compiler").success());
    library
}

/// A process that is ended with its test.
pub(crate) struct Running(pub(crate) Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Waits for a condition, not for a time.
pub(crate) fn wait_until(what: &str, condition: impl Fn() -> bool) {
    assert!(eventually(condition), "{what}");
}

/// True as soon as the condition holds; false after [`PATIENCE`], for who can say more than its name.
pub(crate) fn eventually(condition: impl Fn() -> bool) -> bool {
    let started = Instant::now();
    while !condition() {
        if started.elapsed() > PATIENCE {
            return false;
        }
        // Polling without a break would take the core from the processes that are polled.
        std::thread::sleep(Duration::from_millis(20));
    }
    true
}

/// The example configuration at an address and a time factor of this test's own.
pub(crate) fn configuration(folder: &Path, address: &str, factor: u32) -> (PathBuf, PathBuf) {
    let config = folder.join("config");
    std::fs::create_dir(&config).expect("created");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
    let example = |name: &str| std::fs::read_to_string(source.join(name)).expect("an example");
    let cell = replace_times(&example("cell.yaml"), "127.0.0.2", address, 3);
    let cell = replace_once(&cell, "clock_factor: 1}", &format!("clock_factor: {factor}}}"));
    let cell = replace_once(&cell, "\napproval: always", "\napproval: never");
    let cell =
        replace_once(&cell, "page: {listen: 127.0.0.1:8737}", &format!("page: {{listen: '{address}:8737'}}"));
    let sim = replace_once(&example("sim.yaml"), "127.0.0.2", address);
    let sim = replace_once(&sim, "\ntime_factor: 1\n", &format!("\ntime_factor: {factor}\n"));
    let write = |name: &str, text: String| {
        let path = config.join(name);
        std::fs::write(&path, text).expect("written");
        path
    };
    (write("cell.yaml", cell), write("sim.yaml", sim))
}

/// A simulator and daemons that wait for each other on a busy computer.
pub(crate) fn start_sim(config: &Path) -> Running {
    start_sim_with(&[], config)
}

/// A simulator that waits for nobody: for tests that hold a daemon up.
pub(crate) fn start_strict_sim(config: &Path) -> Running {
    start_sim_with(&["--strict"], config)
}

fn start_sim_with(options: &[&str], config: &Path) -> Running {
    let mut sim = Command::new(CELLD)
        .args(["sim", "--control"])
        .args(options)
        .arg("--config")
        .arg(config)
        .stdout(Stdio::piped())
        .spawn()
        .expect("the binary runs");
    let mut line = String::new();
    let stdout = sim.stdout.take().expect("piped");
    BufReader::new(stdout).read_line(&mut line).expect("a line");
    assert!(line.contains("\"ready\":true"), "{line}");
    Running(sim)
}

/// The files that a calibration of the example cell wrote, where its configuration in `folder` looks for
/// them.
pub(crate) fn copy_calibration(folder: &Path) {
    let files = folder.join("calibration/sim");
    std::fs::create_dir_all(&files).expect("created");
    let made = Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/sim");
    for name in ["camera.yaml", "hand_eye.yaml", "table.yaml"] {
        std::fs::copy(made.join(name), files.join(name)).expect("the simulated cell's calibration");
    }
}

/// What a daemon says, in its folder.
pub(crate) const LOG: &str = "log.txt";

/// The daemon, working in `folder` and ready for jobs in its `state/jobs/incoming`.
pub(crate) fn start_daemon(folder: &Path, cell: &Path) -> Running {
    start_daemon_with(folder, cell, &[])
}

/// The daemon in an environment of its own.
pub(crate) fn start_daemon_with(folder: &Path, cell: &Path, environment: &[(&str, &Path)]) -> Running {
    let process = Command::new(CELLD)
        .args(["run", "--config"])
        .arg(cell)
        .envs(environment.iter().copied())
        .current_dir(folder)
        .stderr(std::fs::File::create(folder.join(LOG)).expect("a file"))
        .spawn();
    let running = Running(process.expect("the binary runs"));
    wait_until("the daemon opens its folders", || folder.join("state/jobs/incoming").is_dir());
    running
}

pub(crate) fn interrupt(process: &Running) {
    let id = process.0.id().to_string();
    // The shell's own: a bare Debian has no such program.
    let sent = Command::new("sh").args(["-c", &format!("kill -INT {id}")]).status().expect("sh");
    assert!(sent.success());
}

/// What the simulated controller's dashboard says of its program.
fn program_state(address: &str) -> String {
    let mut dashboard = std::net::TcpStream::connect((address, 29999)).expect("the simulated dashboard");
    dashboard.set_read_timeout(Some(PATIENCE)).expect("a timeout");
    dashboard.write_all(b"programState\n").expect("sent");
    let mut lines = BufReader::new(dashboard).lines();
    lines.next().expect("a greeting").expect("text");
    let answer = lines.next().expect("an answer").expect("text");
    answer.split_whitespace().next().unwrap_or_default().to_string()
}

pub(crate) fn result_of(state: &Path, end: &str, job: &str) -> Option<String> {
    let months = std::fs::read_dir(state.join("jobs").join(end)).ok()?;
    months
        .flatten()
        .find_map(|month| std::fs::read_to_string(month.path().join(job).join("result.yaml")).ok())
}

/// No cell knows a lod.
const BAD: &str = "version: 1\ngoal:\n  objects:\n    - {id: lod, pose: [0, 0, 0]}\n";

/// What the daemon refuses, `submit` answers; both are in the log at its usual level, with their date.
fn refuses_at_once_and_in_its_log(folder: &Path) {
    std::fs::write(folder.join("bad2.yaml"), format!("{BAD}seed: 2\n")).expect("written");
    let refused = celld(&["submit", "bad2.yaml"], folder);
    assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
    assert!(text(&refused.stdout).contains("rejected: "), "{}", text(&refused.stdout));
    assert_eq!(celld(&["approve", "nothing", "--plan", "1"], folder).status.code(), Some(1));
    let log = std::fs::read_to_string(folder.join(LOG)).expect("the log");
    for said in ["WARN job rejected", "WARN order refused: "] {
        let line = log.lines().find(|line| line.contains(said));
        let line = line.unwrap_or_else(|| panic!("{said} is not in the log:\n{log}"));
        assert!(line.starts_with("20") && line[10..].starts_with('T'), "no date: {line}");
    }
}

/// While a job waits for a person to arm the cell.
fn says_what_to_do_and_how_each_device_is(status: &str) {
    assert!(status.contains("to do: `celld arm` once the cell is clear"), "{status}");
    for device in ["robot at 127.7.1.2: ", "gripper at 127.7.1.2:5020, unit 65: ready", "camera at "] {
        assert!(status.contains(device), "{device}: {status}");
    }
}

#[test]
fn cell_works_on_job_files_as_two_processes_and_ctrl_c_names_the_job() {
    let folder = tempfile::tempdir().expect("a folder");
    let (cell, sim) = configuration(folder.path(), "127.7.1.2", 2);
    let _sim = start_sim(&sim);
    let cell_text = cell.display().to_string();
    let calibrated = celld(&["calibrate", "--config", &cell_text], folder.path());
    assert_eq!(calibrated.status.code(), Some(0), "{}", text(&calibrated.stderr));

    let state = folder.path().join("state");
    let mut daemon = start_daemon(folder.path(), &cell);
    let incoming = state.join("jobs/incoming");
    let job = |id: &str, x: f64| {
        format!("version: 1\nid: {id}\ngoal:\n  objects:\n    - {{id: lid, pose: [{x}, 0.38, 0]}}\n")
    };
    std::fs::write(incoming.join("bad.yaml"), BAD).expect("written");
    let reason = state.join("jobs/rejected/bad.yaml.reason.yaml");
    wait_until("the bad job is rejected", || reason.is_file());
    assert!(std::fs::read_to_string(&reason).expect("text").contains("did you mean \\\"lid\\\""));
    refuses_at_once_and_in_its_log(folder.path());

    std::fs::write(incoming.join("one.yaml"), job("one", 0.30)).expect("written");
    wait_until("the job is taken up", || state.join("jobs/active/one").is_dir());
    let status = || text(&celld(&["status"], folder.path()).stdout);
    wait_until("the job waits for a person", || status().contains("the cell is disarmed"));
    says_what_to_do_and_how_each_device_is(&status());
    assert_eq!(program_state("127.7.1.2"), "STOPPED", "not even the program is started");
    wait_until("the cell is armed", || celld(&["arm"], folder.path()).status.code() == Some(0));
    wait_until("the job is done", || result_of(&state, "done", "one").is_some());
    let result = result_of(&state, "done", "one").expect("result");
    assert!(result.contains("status: done") && result.contains("moves: 1"), "{result}");

    let second = celld(&["run", "--config", &cell_text], folder.path());
    assert_eq!(second.status.code(), Some(1), "a second daemon on one state folder");

    // A stop, and work again once a person has armed the cell.
    let works = || status().contains("working (armed)");
    std::fs::write(incoming.join("two.yaml"), job("two", 0.40)).expect("written");
    wait_until("the second job is under way", works);
    assert_eq!(celld(&["abort"], folder.path()).status.code(), Some(0));
    wait_until("the second job has ended", || result_of(&state, "failed", "two").is_some());
    let result = result_of(&state, "failed", "two").expect("a result");
    assert!(result.contains("status: interrupted") && result.contains("code: \"aborted\""), "{result}");
    assert_eq!(celld(&["arm"], folder.path()).status.code(), Some(0));
    std::fs::write(incoming.join("three.yaml"), job("three", 0.40)).expect("written");
    wait_until("the third job is done", || result_of(&state, "done", "three").is_some());

    std::fs::write(incoming.join("four.yaml"), job("four", 0.30)).expect("written");
    wait_until("the fourth job is under way", works);
    interrupt(&daemon);
    let ended = daemon.0.wait().expect("the daemon ends");
    assert_eq!(ended.code(), Some(0));
    assert_eq!(celld(&["status"], folder.path()).status.code(), Some(1), "no daemon");
    let result = result_of(&state, "failed", "four").expect("a result");
    assert!(result.contains("status: interrupted") && result.contains("code: \"shutdown\""), "{result}");
    wait_until("the program ends with its daemon", || program_state("127.7.1.2") == "STOPPED");
    let recordings = std::fs::read_dir(folder.path().join("recordings")).expect("the configured folder");
    assert!(recordings.flatten().any(|file| file.metadata().is_ok_and(|meta| meta.len() > 1000)));
}
