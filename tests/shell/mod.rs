//! The shell of the real daemon, disturbed from outside: processes that are stopped, clients that give up,
//! logs that nobody reads, a suspended terminal, folders that vanish, disks and journals that cannot be
//! used, handles that run out, a thousand command files.
//!
//! Each test has a simulated robot at a real one's pace and an address of its own, starts the binary, does
//! what an operator, a full disk or another program does, and judges by what the robot was seen to do, by
//! what the daemon answers and by what its status says. Names begin with `cell_`, so that `make test` runs
//! them with the other whole cells.

mod approval;
mod held_up;
mod intake;
mod records;
mod unreachable;

use crate::cell::{
    CELLD, LOG, PATIENCE, Running, celld, configuration, copy_calibration, start_daemon_with,
    start_strict_sim, text, wait_until,
};
use serde_json::Value;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Where the measured joints are in a message of the real-time interface (port 30003), bytes: size, time,
/// and five times six numbers before them.
const Q_ACTUAL: usize = 4 + 8 + 5 * 6 * 8;

/// SIGTERM ends the daemon within this time, also if nothing takes its output.
const END_WITHIN: Duration = Duration::from_secs(10);

/// A job that moves `lid`.
const JOB: &str = "version: 1\nid: carry\ngoal: {objects: [{id: lid, pose: [0.3, 0.38, 0]}]}\n";

/// A simulated robot and a daemon that work at a real robot's pace.
struct Cell {
    folder: tempfile::TempDir,
    address: &'static str,
    config: PathBuf,
    daemon: Option<Running>,
    robot_config: PathBuf,
    robot: Option<Running>,
}

impl Drop for Cell {
    /// A test that fails shows what the daemon said.
    fn drop(&mut self) {
        if std::thread::panicking() {
            let log = self.log();
            let lines: Vec<&str> = log.lines().rev().take(60).collect();
            lines.iter().rev().for_each(|line| eprintln!("{line}"));
        }
    }
}

impl Cell {
    /// Both run; the cell is disarmed.
    fn start(address: &'static str, environment: &[(&str, &Path)]) -> Cell {
        let mut cell = Cell::without_daemon(address);
        cell.start_daemon(environment);
        cell
    }

    fn without_daemon(address: &'static str) -> Cell {
        let mut cell = Cell::without_robot(address);
        cell.start_robot();
        cell
    }

    fn without_robot(address: &'static str) -> Cell {
        let folder = tempfile::tempdir().expect("a folder");
        let (config, robot_config) = configuration(folder.path(), address, 1);
        copy_calibration(folder.path());
        Cell { folder, address, config, daemon: None, robot_config, robot: None }
    }

    fn start_daemon(&mut self, environment: &[(&str, &Path)]) {
        self.daemon = Some(start_daemon_with(self.path(), &self.config, environment));
        self.takes_orders();
    }

    fn takes_orders(&self) {
        wait_until("the daemon takes orders", || self.celld(&["disarm"]).0 == Some(0));
    }

    /// `celld run`, not started yet.
    fn run(&self) -> Command {
        let mut command = Command::new(CELLD);
        command.args(["run", "--config"]).arg(&self.config).current_dir(self.path());
        command
    }

    /// SIGTERM ends the daemon in time.
    fn end(&self) {
        terminate(self.daemon.as_ref().expect("a daemon runs").0.id());
    }

    fn start_robot(&mut self) {
        self.robot = Some(start_strict_sim(&self.robot_config));
    }

    fn stop_robot(&mut self) {
        self.robot = None;
    }

    /// How long ago the robot answered last, s.
    fn robot_silent_s(&self) -> f64 {
        let status = self.status();
        let devices = status["devices"].as_array().map_or(&[][..], Vec::as_slice);
        let robot = devices.iter().find(|device| device["name"] == "robot");
        robot.and_then(|robot| robot["age_s"].as_f64()).unwrap_or(f64::NAN)
    }

    fn path(&self) -> &Path {
        self.folder.path()
    }

    fn state(&self) -> PathBuf {
        self.path().join("state")
    }

    /// A command to its end: exit code, what it said.
    fn celld(&self, arguments: &[&str]) -> (Option<i32>, String) {
        let output = celld(arguments, self.path());
        (output.status.code(), format!("{}{}", text(&output.stdout), text(&output.stderr)))
    }

    /// A command that runs beside the test.
    fn client(&self, arguments: &[&str]) -> Running {
        let mut command = Command::new(CELLD);
        command.args(arguments).current_dir(self.path()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Running(command.spawn().expect("the binary runs"))
    }

    fn daemon(&mut self) -> &mut Child {
        &mut self.daemon.as_mut().expect("a daemon runs").0
    }

    fn signal(&self, name: &str) {
        signal(name, self.daemon.as_ref().expect("a daemon runs").0.id());
    }

    fn status(&self) -> Value {
        let status = std::fs::read_to_string(self.state().join("status.json")).unwrap_or_default();
        serde_json::from_str(&status).unwrap_or_default()
    }

    fn armed(&self) -> bool {
        self.status()["armed"] == true
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.path().join(LOG)).unwrap_or_default()
    }

    /// A token with which the page shows the status, also when the state folder is gone.
    fn token(&self) -> String {
        let (code, token) = self.celld(&["open", "--token", "--role", "view", "--name", "test"]);
        assert_eq!(code, Some(0), "{token}");
        token.trim().to_string()
    }

    /// The status as the page shows it.
    fn shown(&self, token: &str) -> Value {
        get(self.address, 8737, "/api/v1/status", &format!("authorization: Bearer {token}\r\n"))
    }

    fn arm(&self) {
        wait_until("the cell is armed", || self.celld(&["arm"]).0 == Some(0));
    }

    fn submit(&self, job: &str) {
        std::fs::write(self.path().join("carry.yaml"), job).expect("written");
        assert_eq!(self.celld(&["submit", "carry.yaml"]).0, Some(0));
    }

    /// Submits [`JOB`]; the arm carries `lid` when this returns.
    fn carry(&self) {
        self.submit(JOB);
        self.arm();
        self.works_until("lid hangs on the gripper", || self.carries());
    }

    fn carries(&self) -> bool {
        self.holds() && self.status()["holding"].as_str().is_some_and(|held| held.contains("lid"))
    }

    /// Waits for a condition while the cell works. On a busy computer the robot may miss a heartbeat: the
    /// job goes on once armed again.
    fn works_until(&self, what: &str, condition: impl Fn() -> bool) {
        wait_until(what, || {
            if !self.armed() && self.status()["holding"].is_null() {
                self.celld(&["arm"]);
            }
            condition()
        });
    }

    /// The joints of the simulated arm from the controller's real-time interface, not from celld.
    fn joints(&self) -> Vec<f64> {
        let mut stream = TcpStream::connect((self.address, 30003)).expect("the real-time interface");
        stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
        let mut message = [0; Q_ACTUAL + 6 * 8];
        stream.read_exact(&mut message).expect("a message");
        let angle = |bytes: &[u8]| f64::from_be_bytes(bytes.try_into().expect("eight bytes"));
        message[Q_ACTUAL..].chunks_exact(8).map(angle).collect()
    }

    /// The arm has come to rest, in the world.
    fn rests(&self) -> bool {
        let first = self.joints();
        std::thread::sleep(std::time::Duration::from_millis(200));
        first.iter().zip(self.joints()).all(|(a, b)| (a - b).abs() < 1e-3)
    }

    /// lid hangs on the gripper, in the world.
    fn holds(&self) -> bool {
        let world = get(self.address, 8091, "/world.json", "");
        let objects = world["objects"].as_array().expect("objects in the world");
        objects.iter().any(|object| object["id"] == "lid" && object["state"] == "held")
    }
}

fn signal(name: &str, process: u32) {
    let sent = Command::new("sh").args(["-c", &format!("kill -{name} {process}")]).status();
    assert!(sent.expect("sh").success());
}

/// SIGTERM ends this process in time.
fn terminate(process: u32) {
    signal("TERM", process);
    let since = Instant::now();
    while runs(process) {
        let threads = || threads(process).join(", ");
        assert!(since.elapsed() < END_WITHIN, "it has not ended within {END_WITHIN:?}: {}", threads());
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A process that has ended is a zombie until its parent has waited for it.
fn runs(process: u32) -> bool {
    // The state follows the name, which is in parentheses and may hold any characters (proc(5)).
    let ended = |stat: &String| stat.rsplit_once(") ").is_none_or(|(_, after)| after.starts_with(['Z', 'X']));
    !thread_files(process, "stat").iter().all(ended)
}

/// The name of each thread of a process, and where in the kernel it waits.
fn threads(process: u32) -> Vec<String> {
    let names = thread_files(process, "comm").into_iter().zip(thread_files(process, "wchan"));
    names.map(|(name, place)| format!("{} in {place}", name.trim())).collect()
}

/// This file of each thread of a process (proc(5)).
fn thread_files(process: u32, name: &str) -> Vec<String> {
    let threads = std::fs::read_dir(format!("/proc/{process}/task")).into_iter().flatten().flatten();
    threads.filter_map(|thread| std::fs::read_to_string(thread.path().join(name)).ok()).collect()
}

/// The JSON that a server answers with; `headers` are whole lines.
fn get(address: &str, port: u16, path: &str, headers: &str) -> Value {
    let answer = request(address, port, path, headers);
    let body = answer.find("\r\n\r\n").map(|at| &answer[at + 4..]).expect("a body");
    let body = &body[body.find('{').unwrap_or(0)..=body.rfind('}').unwrap_or(0)];
    serde_json::from_str(body).unwrap_or_else(|error| panic!("{error}: {answer}"))
}

/// A server's whole answer.
fn request(address: &str, port: u16, path: &str, headers: &str) -> String {
    let mut stream = TcpStream::connect((address, port)).expect("a server");
    stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
    let head = format!("GET {path} HTTP/1.1\r\nhost: {address}:{port}\r\n{headers}connection: close");
    let request = format!("{head}\r\n\r\n");
    stream.write_all(request.as_bytes()).expect("sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("an answer");
    answer
}

/// A process's end and what it said.
fn ended(mut process: Running) -> (Option<i32>, String) {
    let status = process.0.wait().expect("a child");
    let mut said = String::new();
    process.0.stdout.take().expect("piped").read_to_string(&mut said).expect("text");
    process.0.stderr.take().expect("piped").read_to_string(&mut said).expect("text");
    (status.code(), said)
}

/// Files of this kind in the command folder.
fn files(cell: &Cell, suffix: &str) -> usize {
    let Ok(entries) = std::fs::read_dir(cell.state().join("commands")) else { return 0 };
    let named = |entry: &std::fs::DirEntry| {
        let name = entry.file_name().to_string_lossy().into_owned();
        name.ends_with(suffix) && !name.starts_with('.')
    };
    entries.flatten().filter(named).count()
}
