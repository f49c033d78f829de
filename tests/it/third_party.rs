//! Clients that others wrote, unmodified, against `celld sim` as a process: SDU's ur_rtde, Universal Robots'
//! own Python RTDE client, pymodbus.
//!
//! In: the scripts of `tests/clients` and the Python environment that `make test-clients` prepares. Out:
//! what they found, printed check by check. Each simulation has a loopback address of its own, because the
//! clients insist on the controller's port numbers. Without the environment the tests are skipped, loudly;
//! with `CELLD_CLIENTS` set they must run.

#![allow(clippy::unwrap_used, reason = "helpers of tests: an unwrap that fails is the test that fails")]

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// A running `celld sim`; it ends with this value.
struct Simulator(Child);

impl Drop for Simulator {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Simulator {
    fn start(address: &str) -> Simulator {
        // As users start it: from anywhere, with the configuration that is in the program.
        let mut child = Command::new(env!("CARGO_BIN_EXE_celld"))
            .args(["sim", "--control", "--bind", address])
            .current_dir(std::env::temp_dir())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut ready = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut ready).unwrap();
        let simulator = Simulator(child);
        assert!(ready.contains("\"ready\":true"), "celld sim at {address}: {ready}");
        simulator
    }
}

/// The interpreter with the clients; `None` if there is none and none was promised.
fn python() -> Option<PathBuf> {
    let promised = std::env::var_os("CELLD_CLIENTS").map(PathBuf::from);
    let beside =
        Path::new(env!("CARGO_BIN_EXE_celld")).ancestors().nth(2).map(|target| target.join("clients"));
    let python = promised.clone().or(beside)?.join("bin/python");
    match python.exists() {
        true => Some(python),
        false if promised.is_none() => {
            eprintln!(
                "SKIPPED: no third-party clients at {}; `make clients` installs them",
                python.display()
            );
            None
        }
        false => panic!("CELLD_CLIENTS is set, and there is no {}", python.display()),
    }
}

fn passes(script: &str, address: &str) {
    let Some(python) = python() else { return };
    let _simulator = Simulator::start(address);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/clients").join(script);
    let mut child =
        Command::new(python).arg("-B").arg(&script).arg(address).stdout(Stdio::piped()).spawn().unwrap();
    let mut last = String::new();
    // Line by line, so that a script which hangs has said how far it came.
    for line in BufReader::new(child.stdout.take().unwrap()).lines() {
        last = line.unwrap();
        println!("{last}");
    }
    let status = child.wait().unwrap();
    // The closing line too: a script that ends early must not pass for one that found nothing.
    assert!(status.success() && last.ends_with(" checks, 0 failed"), "{}", script.display());
}

#[test]
fn ur_rtde_moves_the_arm() {
    passes("ur_rtde_moves.py", "127.71.0.1");
}

#[test]
fn ur_rtde_calls_return_what_they_promise() {
    passes("ur_rtde_calls.py", "127.71.0.2");
}

#[test]
fn ur_rtde_receives_switches_and_asks_the_dashboard() {
    passes("ur_rtde_rest.py", "127.71.0.3");
}

#[test]
fn the_vendor_s_python_client_exchanges_data() {
    passes("ur_python_rtde.py", "127.71.0.4");
}

#[test]
fn pymodbus_drives_the_gripper_on_the_arm() {
    passes("vgc10_pymodbus.py", "127.71.0.5");
}
