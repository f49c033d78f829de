//! Programs that others wrote, unmodified: SDU's ur_rtde, Universal Robots' own Python RTDE client and
//! pymodbus against `celld sim` as a process, readers of recordings on files of celld.
//!
//! In: the scripts of `tests/clients` and the Python environment that `make test-clients` prepares. Out:
//! what they found, printed check by check. Each simulation has a loopback address of its own, because the
//! clients insist on the controller's port numbers. Without the environment the tests are skipped, loudly;
//! with `CELLD_CLIENTS` set they must run.

#![allow(clippy::unwrap_used, reason = "helpers of tests: an unwrap that fails is the test that fails")]

use cell_machine::supervisor::input::Notice;
use cell_machine::supervisor::order::RouteAction;
use cell_values::image::Image;
use cell_values::time::Timestamp;
use celld::config::cell::RecordedPictures;
use celld::daemon::messages::Displayed;
use celld::daemon::recorder::Recorder;
use celld::daemon::shell::Scene;
use celld::io::recording::repair::{Repaired, repair};
use celld::pair::camera_view::SightKind;
use celld::pair::run::{bring_up, true_poses};
use celld::pair::table::stage;
use celld::pair::{Choice, Pair};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
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
    runs(&python, script, address);
}

fn runs(python: &Path, script: &str, argument: &str) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/clients").join(script);
    let mut child =
        Command::new(python).arg("-B").arg(&script).arg(argument).stdout(Stdio::piped()).spawn().unwrap();
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
fn ur_rtde_receives_switches_and_requests_the_dashboard() {
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

/// A cell that stands, with everything that a recording may hold, pictures of this size.
fn record(path: &Path, [width, height]: [u32; 2]) {
    let stage = stage(3, SightKind::Corners).unwrap();
    let mut pair = Pair::new(stage.clone(), Choice::of(3)).unwrap();
    assert!(bring_up(&mut pair));
    let lens = stage.model.sight.as_ref().map(|sight| sight.camera.clone());
    let mut recorder = Recorder::create(path, RecordedPictures::Jpeg, lens);
    let at = |k: u32| Timestamp::from_secs_f64(f64::from(k) * 0.1);
    recorder.on(at(0), &Scene::Machine(pair.machine()));
    recorder.on(at(0), &Scene::Notice(&Notice { alarm: false, text: "the table is seen".to_string() }));
    let poses = true_poses(&pair, &stage.model);
    let step = RouteAction { object: poses[0].0.clone(), from: poses[0].1, to: poses[1].1, to_goal: true };
    recorder.on(at(0), &Scene::Route(&[step]));
    for k in 1..30 {
        let noise = |x: u32, y: u32| ((x * 7919 + y * 104_729 + k * 31) % 251) as u8;
        let mut image = Image::filled(width, height, [0; 3]);
        for (index, byte) in image.rgb.iter_mut().enumerate() {
            *byte = noise(index as u32 % (3 * width), index as u32 / (3 * width));
        }
        recorder.on(at(k), &Scene::Displayed(&Displayed::Picture { image, views: Vec::new() }));
        recorder.on(at(k), &Scene::Robot(pair.machine().robot_state().expect("a state")));
        recorder.on(at(k), &Scene::Vacuum([0.1, 0.2]));
        recorder.on(at(k), &Scene::Status(pair.status().expect("a status")));
        // The encoder takes no more than some pictures at a time.
        pair.run_until(0.1, |_| false);
        std::thread::yield_now();
    }
    assert_eq!(recorder.close(), None);
}

/// The file cut at a thousand random places, and each of these repaired.
fn cut_anywhere(path: &Path, folder: &Path) {
    let whole = std::fs::read(path).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(17);
    for name in ["cuts", "repaired"] {
        std::fs::create_dir(folder.join(name)).unwrap();
    }
    for number in 0..1_000 {
        let at = random.random_range(16..whole.len());
        for name in ["cuts", "repaired"] {
            std::fs::write(folder.join(name).join(format!("{number}.mcap")), &whole[..at]).unwrap();
        }
        let repaired = repair(&folder.join(format!("repaired/{number}.mcap")));
        assert!(matches!(repaired, Ok(Repaired::Mended { kept: None, .. })), "cut at {at}: {repaired:?}");
    }
}

#[test]
fn recordings_open_in_other_programs() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    record(&file("whole.mcap"), [640, 480]);
    let whole = std::fs::read(file("whole.mcap")).unwrap();
    for name in ["cut.mcap", "repaired.mcap"] {
        std::fs::write(file(name), &whole[..whole.len() * 2 / 3]).unwrap();
    }
    assert!(matches!(repair(&file("repaired.mcap")), Ok(Repaired::Mended { .. })));
    record(&file("small.mcap"), [64, 48]);
    cut_anywhere(&file("small.mcap"), folder.path());
    runs(&python, "recordings.py", &folder.path().display().to_string());
}
