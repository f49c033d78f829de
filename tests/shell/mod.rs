//! The shell of the real daemon, disturbed from outside: processes that are stopped, clients that give up,
//! logs that nobody reads, folders that vanish, handles that run out, a thousand command files.
//!
//! Each test has a simulated robot at a real one's pace and an address of its own, starts the binary, does
//! what an operator, a full disk or another program does, and judges by what the robot was seen to do, by
//! what the daemon answers and by what its status says. Names begin with `cell_`, so that `make test` runs
//! them with the other whole cells.

mod held_up;
mod intake;
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

/// Where the measured joints are in a message of the real-time interface (port 30003), bytes: size, time,
/// and five times six numbers before them.
const Q_ACTUAL: usize = 4 + 8 + 5 * 6 * 8;

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
        let daemon = start_daemon_with(cell.path(), &cell.config, environment);
        cell.daemon = Some(daemon);
        wait_until("the daemon takes orders", || cell.celld(&["disarm"]).0 == Some(0));
        cell
    }

    fn without_daemon(address: &'static str) -> Cell {
        let folder = tempfile::tempdir().expect("a folder");
        let (config, robot_config) = configuration(folder.path(), address, 1);
        copy_calibration(folder.path());
        let mut cell = Cell { folder, address, config, daemon: None, robot_config, robot: None };
        cell.start_robot();
        cell
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

    fn arm(&self) {
        wait_until("the cell is armed", || self.celld(&["arm"]).0 == Some(0));
    }

    /// A job that carries `lid` to and fro; the arm is under way with it when this returns.
    fn carry(&self) {
        let job = "version: 1\nid: carry\ngoal: {objects: [{id: lid, pose: [0.3, 0.38, 0]}]}\n";
        std::fs::write(self.path().join("carry.yaml"), job).expect("written");
        assert_eq!(self.celld(&["submit", "carry.yaml"]).0, Some(0));
        self.arm();
        wait_until("lid hangs on the gripper", || {
            // On a busy computer the robot may miss a heartbeat before: the job goes on once armed again.
            if !self.armed() && self.status()["holding"].is_null() {
                self.celld(&["arm"]);
            }
            self.holds() && self.status()["holding"].as_str().is_some_and(|held| held.contains("lid"))
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
        let world = get(self.address, 8091, "/world.json");
        let objects = world["objects"].as_array().expect("objects in the world");
        objects.iter().any(|object| object["id"] == "lid" && object["state"] == "held")
    }
}

fn signal(name: &str, process: u32) {
    let sent = Command::new("sh").args(["-c", &format!("kill -{name} {process}")]).status();
    assert!(sent.expect("sh").success());
}

fn get(address: &str, port: u16, path: &str) -> Value {
    let mut stream = TcpStream::connect((address, port)).expect("the control server");
    stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
    let request = format!("GET {path} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).expect("sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("an answer");
    let body = answer.find("\r\n\r\n").map(|at| &answer[at + 4..]).expect("a body");
    let body = &body[body.find('{').unwrap_or(0)..=body.rfind('}').unwrap_or(0)];
    serde_json::from_str(body).unwrap_or_else(|error| panic!("{error}: {answer}"))
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
