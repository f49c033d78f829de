//! Calibration as a user does it, against simulated devices over sockets: poses proposed in a taught box and visited, points of
//! the table touched, the table tied to both. What comes out is held against the world's truth, which only the test reads.

use crate::cell::{CELLD, configuration, text, wait_until};
use celld::cli::sim::sim_config;
use celld::config::load::load_sim;
use celld::motion::kinematics::forward;
use celld::sim::cell::{RunningSim, start};
use celld::sim::robot_server::RobotPorts;
use celld::sim::world::spec::CameraMount;
use celld::units::Joints;
use celld::vision::calibration::hand_eye::{HandEyeCalibration, Mount};
use celld::vision::calibration::table::TableCalibration;
use nalgebra::{Isometry3, Point3};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::process::{Command, Output, Stdio};

const ADDRESS: &str = "127.7.1.9";

/// From where the arm touches, degrees: four corners of a square and more, the hand turned differently at each.
const TOUCHED_FROM: [[f64; 6]; 4] = [
    [-111.7, -110.8, 121.1, -100.3, -90.0, -21.7],
    [-142.9, -96.0, 98.3, -63.3, -69.8, -29.5],
    [-100.6, -69.4, 55.0, -47.7, -95.0, 5.0],
    [-77.4, -70.1, 64.8, -55.1, -109.6, 40.8],
];

/// The tip in the flange frame, m.
const TIP: [f64; 3] = [0.002, -0.001, 0.15];

fn celld(arguments: &[&str], folder: &Path) -> Output {
    Command::new(CELLD).args(arguments).current_dir(folder).output().expect("the binary runs")
}

fn off(found: &Isometry3<f64>, truth: &Isometry3<f64>) -> (f64, f64) {
    let off = found.inverse() * truth;
    (off.translation.vector.norm() * 1e3, off.rotation.angle().to_degrees())
}

/// Jogs the arm as the pendant would, and returns when it stands there.
fn jog(sim: &RunningSim, secondary: SocketAddr, q: &Joints) {
    let joints = q.0.map(|q| format!("{q:.9}")).join(", ");
    let mut socket = TcpStream::connect(secondary).expect("the secondary interface");
    let script = format!("def jog():\n  movej([{joints}], a=2.0, v=1.0)\nend\n");
    socket.write_all(script.as_bytes()).expect("sent");
    let target = {
        let controller = sim.robot().controller();
        forward(&controller.core.mover.arm.dh, q)
    };
    wait_until("the arm is jogged", || {
        let there = off(&sim.robot().controller().core.base_from_flange(), &target);
        there.0 < 0.02 && there.1 < 0.002
    });
}

#[test]
fn cell_calibrates_itself_in_a_taught_box_and_the_table_is_tied_to_touches() {
    let folder = tempfile::tempdir().expect("a folder");
    let (cell, sim_path) = configuration(folder.path(), ADDRESS, 4);
    let cell = cell.display().to_string();
    let file = load_sim(&sim_path).expect("the simulation");
    let config = sim_config(&file, ADDRESS.parse().expect("an address"), RobotPorts::REAL);
    let (dh, base_from_table) = (config.controller.dh, config.world.base_from_table);
    let CameraMount::Flange(flange_from_camera) = config.camera.mount else { panic!("on the flange") };
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("a runtime");
    let sim = runtime.block_on(start(config)).expect("the simulation starts");

    // On paper first: poses as text, and no motion without a word.
    let printed = celld(&["calibrate", "hand-eye", "--config", &cell, "--propose"], folder.path());
    assert_eq!(printed.status.code(), Some(0), "{}", text(&printed.stderr));
    assert_eq!(text(&printed.stdout).matches("\n  - [").count(), 15, "{}", text(&printed.stdout));
    let unsure = celld(&["calibrate", "hand-eye", "--config", &cell, "--visit"], folder.path());
    assert_eq!(unsure.status.code(), Some(2));
    assert!(text(&unsure.stderr).contains("add --yes"), "{}", text(&unsure.stderr));

    let visit = ["calibrate", "hand-eye", "--config", &cell, "--visit", "--yes", "--record", "round"];
    let visited = celld(&visit, folder.path());
    let said = text(&visited.stderr);
    assert_eq!(visited.status.code(), Some(0), "{said}");
    let read = |name: &str| {
        std::fs::read_to_string(folder.path().join("calibration/sim").join(name)).expect("written")
    };
    let hand_eye = HandEyeCalibration::parse(&read("hand_eye.yaml"), "hand_eye.yaml").expect("sound");
    let Mount::Flange { flange_from_camera: found } = hand_eye.mount else { panic!("on the flange") };
    let (mm, deg) = off(&found, &flange_from_camera);
    println!("camera off by {mm:.3} mm, {deg:.4} degrees\n{said}");
    assert!(mm < 0.5 && deg < 0.1, "{mm} mm, {deg} degrees\n{said}");

    // Points that the tip really meets at those poses, to a tenth of a millimetre, as a person would note them.
    let touched = TOUCHED_FROM.map(|degrees| Joints(degrees.map(f64::to_radians)));
    let point = |q: &Joints| base_from_table.inverse() * forward(&dh, q) * Point3::from(TIP);
    let points = touched.map(|q| point(&q)).map(|p| format!("{:.4}/{:.4}/{:.4}", p.x, p.y, p.z)).join(",");
    let mut touches = Command::new(CELLD)
        .args(["calibrate", "touches", "--config", &cell, "--points", &points])
        .args(["--tip-mm", "2,-1,150", "--save", "touches.yaml"])
        .current_dir(folder.path())
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary runs");
    let mut enter = touches.stdin.take().expect("piped");
    let mut told = BufReader::new(touches.stderr.take().expect("piped"));
    let mut line = String::new();
    for (number, q) in touched.iter().enumerate() {
        while !line.contains(&format!("touch {}/4", number + 1)) {
            line.clear();
            assert!(told.read_line(&mut line).expect("text") > 0, "it asks for touch {}", number + 1);
        }
        jog(&sim, sim.addresses.robot.secondary, q);
        enter.write_all(b"\n").expect("pressed");
    }
    let mut rest = String::new();
    told.read_to_string(&mut rest).expect("text");
    assert_eq!(touches.wait().expect("it ends").code(), Some(0), "{rest}");

    let tie = ["calibrate", "table", "--config", &cell, "--from", "round", "--touches", "touches.yaml"];
    let tied = celld(&tie, folder.path());
    let said = text(&tied.stderr);
    assert_eq!(tied.status.code(), Some(0), "{rest}\n{said}");
    let table = TableCalibration::parse(&read("table.yaml"), "table.yaml").expect("sound");
    let (mm, deg) = off(&table.base_from_table, &base_from_table);
    println!("table off by {mm:.3} mm, {deg:.4} degrees\n{rest}\n{said}");
    assert!(mm < 0.5 && deg < 0.1, "{mm} mm, {deg} degrees\n{said}");
    let by_touch = table.touches.expect("it says that it was touched");
    assert!(by_touch.residuals_m.len() == 4 && by_touch.residuals_m.iter().all(|m| *m < 5e-4));

    // A tip that is 3 mm longer than was said: nothing is written.
    let before = read("table.yaml");
    let touched = std::fs::read_to_string(folder.path().join("touches.yaml")).expect("written");
    let longer = touched.replace("0.15]", "0.153]");
    assert_ne!(longer, touched);
    std::fs::write(folder.path().join("touches.yaml"), longer).expect("written");
    let refused = celld(&tie, folder.path());
    let said = text(&refused.stderr);
    assert!(refused.status.code() == Some(1) && said.contains("touch and camera disagree"), "{said}");
    assert_eq!(read("table.yaml"), before);

    // Ctrl-C while it waits for the person ends it, with nothing written.
    let mut waiting = Command::new(CELLD)
        .args(["calibrate", "touches", "--config", &cell, "--points", "500,501,502", "--save", "none.yaml"])
        .current_dir(folder.path())
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary runs");
    let mut told = BufReader::new(waiting.stderr.take().expect("piped"));
    told.read_line(&mut line).expect("text");
    let interrupt = format!("kill -INT {}", waiting.id());
    assert!(Command::new("sh").args(["-c", &interrupt]).status().expect("sh").success());
    let mut rest = String::new();
    told.read_to_string(&mut rest).expect("text");
    assert_eq!(waiting.wait().expect("it ends").code(), Some(1), "{rest}");
    assert!(!folder.path().join("none.yaml").exists());
    runtime.block_on(sim.shutdown());
}
