//! Calibration as a user does it, against simulated devices over sockets: poses proposed in a taught box and
//! visited, points of the table touched, the table tied to both; and a cell that works from a fixed
//! camera. What comes out is held against the world's truth, which only the test reads.

use crate::cell::{CELLD, celld, configuration, result_of, start_daemon, text, wait_until};
use crate::edit::replace_once;
use cell_calibration::files::hand_eye::{HandEyeCalibration, Mount};
use cell_calibration::files::round::Round;
use cell_calibration::files::table::TableCalibration;
use cell_values::units::Joints;
use celld::config::load::load_cell;
use celld::config::setup::arm_model;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use ur_arm::kinematics::{DhParameters, forward};
use ur_sim::cell::{RunningSim, start};
use ur_sim::command::sim_config;
use ur_sim::config::load::load_sim;
use ur_sim::robot_server::RobotPorts;
use ur_sim::world::lock;
use ur_sim::world::spec::{CameraMount, ForeignBody};

const ADDRESS: &str = "127.7.1.9";

/// From where the arm touches, degrees: four corners of a square and more, the hand turned differently at
/// each.
const TOUCHED_FROM: [[f64; 6]; 4] = [
    [-111.7, -110.8, 121.1, -100.3, -90.0, -21.7],
    [-142.9, -96.0, 98.3, -63.3, -69.8, -29.5],
    [-100.6, -69.4, 55.0, -47.7, -95.0, 5.0],
    [-77.4, -70.1, 64.8, -55.1, -109.6, 40.8],
];

/// The tip in the flange frame, m.
const TIP: [f64; 3] = [0.002, -0.001, 0.15];

fn off(found: &Isometry3<f64>, truth: &Isometry3<f64>) -> (f64, f64) {
    let off = found.inverse() * truth;
    (off.translation.vector.norm() * 1e3, off.rotation.angle().to_degrees())
}

/// A calibration file's text.
fn written(folder: &Path, name: &str) -> String {
    std::fs::read_to_string(folder.join("calibration/sim").join(name)).expect("written")
}

fn hand_eye_of(folder: &Path) -> HandEyeCalibration {
    HandEyeCalibration::parse(&written(folder, "hand_eye.yaml"), "hand_eye.yaml").expect("sound")
}

fn table_of(folder: &Path) -> TableCalibration {
    TableCalibration::parse(&written(folder, "table.yaml"), "table.yaml").expect("sound")
}

/// Holds what was written about a fixed camera and the table against the truth.
fn assert_stands(
    folder: &Path,
    base_from_camera: &Isometry3<f64>,
    base_from_table: &Isometry3<f64>,
    said: &str,
) {
    let Mount::Fixed { base_from_camera: found } = hand_eye_of(folder).mount else { panic!("it stands") };
    let (mm, deg) = off(&found, base_from_camera);
    println!("camera off by {mm:.3} mm, {deg:.4} degrees\n{said}");
    assert!(mm < 0.5 && deg < 0.1, "camera: {mm} mm, {deg} degrees\n{said}");
    let (mm, deg) = off(&table_of(folder).base_from_table, base_from_table);
    println!("table off by {mm:.3} mm, {deg:.4} degrees");
    assert!(mm < 0.5 && deg < 0.1, "table: {mm} mm, {deg} degrees\n{said}");
}

/// The flange stayed in the box, on the way and where it stopped, and it went somewhere. A controller's path
/// is within a millimetre.
fn assert_stayed_in(cell: &Path, recorded: &Path, way: &[Vector3<f64>]) {
    let room = load_cell(cell).expect("a configuration").calibration_box.expect("a box");
    let seen = std::fs::read_to_string(recorded.join("samples.yaml")).expect("recorded");
    let poses = Round::parse(&seen, "samples.yaml").expect("sound").samples;
    assert!(
        poses.len() == 15 && way.len() > 100,
        "{} poses, seen {} times on the way",
        poses.len(),
        way.len()
    );
    let stood = poses.iter().map(|sample| sample.base_from_flange.translation.vector);
    for flange in way.iter().copied().chain(stood) {
        assert!(room.outside_m(&flange) < 1e-3, "{flange} is outside");
    }
    let far = way.iter().map(|flange| (flange - way[0]).norm()).fold(0.0, f64::max);
    assert!(far > 0.1, "it moved {far} m");
}

/// Jogs the arm as the pendant would, and returns when it is there.
fn jog(sim: &RunningSim, secondary: SocketAddr, q: &Joints) {
    let joints = q.0.map(|q| format!("{q:.9}")).join(", ");
    let mut socket = TcpStream::connect(secondary).expect("the secondary interface");
    let script = format!("def jog():\n  movej([{joints}], a=2.0, v=1.0)\nend\n");
    socket.write_all(script.as_bytes()).expect("sent");
    let target = {
        let controller = sim.robot().controller();
        controller.core.mover.arm.kinematics.forward(q)
    };
    wait_until("the arm is jogged", || {
        let there = off(&sim.robot().controller().core.base_from_flange(), &target);
        there.0 < 0.02 && there.1 < 0.002
    });
}

/// Does `work`, and notes where the flange is meanwhile, base frame, m.
fn while_watched<T>(sim: &RunningSim, work: impl FnOnce() -> T) -> (T, Vec<Vector3<f64>>) {
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let watch = scope.spawn(|| {
            let mut way = Vec::new();
            while !done.load(Ordering::Relaxed) {
                way.push(sim.robot().controller().core.base_from_flange().translation.vector);
                std::thread::sleep(Duration::from_millis(10));
            }
            way
        });
        let worked = work();
        done.store(true, Ordering::Relaxed);
        (worked, watch.join().expect("it only looks"))
    })
}

/// A cell whose camera is on the hand, its devices running, and the truth about it.
struct OnHand<'a> {
    folder: &'a Path,
    cell: String,
    runtime: tokio::runtime::Runtime,
    sim: RunningSim,
    dh: DhParameters,
    flange_from_camera: Isometry3<f64>,
    base_from_table: Isometry3<f64>,
}

impl OnHand<'_> {
    fn start<'a>(folder: &'a Path, address: &str) -> OnHand<'a> {
        let (cell, sim_path) = configuration(folder, address, 4);
        let file = load_sim(&sim_path).expect("the simulation");
        let config = sim_config(&file, address.parse().expect("an address"), RobotPorts::REAL);
        let (dh, base_from_table) = (config.controller.dh, config.world.base_from_table);
        let CameraMount::Flange(flange_from_camera) = config.camera.mount else { panic!("on the flange") };
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("a runtime");
        let sim = runtime.block_on(start(config)).expect("the simulation starts");
        let cell = cell.display().to_string();
        OnHand { folder, cell, runtime, sim, dh, flange_from_camera, base_from_table }
    }

    /// `celld calibrate` with these words: its exit code, and what it says on stdout and stderr.
    fn calibrate(&self, words: &[&str]) -> (Option<i32>, String, String) {
        let [what, rest @ ..] = words else { panic!("what to calibrate") };
        let ran = celld(&[&["calibrate", what, "--config", &self.cell], rest].concat(), self.folder);
        (ran.status.code(), text(&ran.stdout), text(&ran.stderr))
    }

    /// `celld calibrate touches` with these words, which waits for a person, and what it says.
    fn touching(&self, words: &[&str]) -> (Child, BufReader<ChildStderr>) {
        let mut touches = Command::new(CELLD)
            .args(["calibrate", "touches", "--config", &self.cell])
            .args(words)
            .current_dir(self.folder)
            .stdin(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the binary runs");
        let reported = BufReader::new(touches.stderr.take().expect("piped"));
        (touches, reported)
    }

    /// Poses as text, and no motion without a word.
    fn proposes_on_paper(&self) {
        let (code, printed, said) = self.calibrate(&["hand-eye", "--propose"]);
        assert_eq!(code, Some(0), "{said}");
        assert_eq!(printed.matches("\n  - [").count(), 15, "{printed}");
        let (code, _, said) = self.calibrate(&["hand-eye", "--visit"]);
        assert_eq!(code, Some(2));
        assert!(said.contains("add --yes"), "{said}");
    }

    /// Visits poses of its own in the box, kept in the folder `round`, and finds the camera.
    fn finds_its_camera(&self) {
        let visit = || self.calibrate(&["hand-eye", "--visit", "--yes", "--record", "round"]);
        let ((code, _, said), way) = while_watched(&self.sim, visit);
        assert_eq!(code, Some(0), "{said}");
        assert_stayed_in(Path::new(&self.cell), &self.folder.join("round"), &way);
        let Mount::Flange { flange_from_camera } = hand_eye_of(self.folder).mount else {
            panic!("on the flange")
        };
        let (mm, deg) = off(&flange_from_camera, &self.flange_from_camera);
        println!("camera off by {mm:.3} mm, {deg:.4} degrees\n{said}");
        assert!(mm < 0.5 && deg < 0.1, "{mm} mm, {deg} degrees\n{said}");
    }

    /// Touches points that the tip really meets at those poses, to a tenth of a millimetre, as a person
    /// would note them; they are kept in `touches.yaml`.
    fn is_touched(&self) {
        let touched = TOUCHED_FROM.map(|degrees| Joints(degrees.map(f64::to_radians)));
        let point = |q: &Joints| self.base_from_table.inverse() * forward(&self.dh, q) * Point3::from(TIP);
        let points =
            touched.map(|q| point(&q)).map(|p| format!("{:.4}/{:.4}/{:.4}", p.x, p.y, p.z)).join(",");
        let words = ["--points", &points, "--tip-mm", "2,-1,150", "--save", "touches.yaml"];
        let (mut touches, mut reported) = self.touching(&words);
        let mut enter = touches.stdin.take().expect("piped");
        let mut line = String::new();
        for (number, q) in touched.iter().enumerate() {
            while !line.contains(&format!("touch {}/4", number + 1)) {
                line.clear();
                assert!(reported.read_line(&mut line).expect("text") > 0, "it asks for touch {}", number + 1);
            }
            jog(&self.sim, self.sim.addresses.robot.secondary, q);
            enter.write_all(b"\n").expect("pressed");
        }
        let mut rest = String::new();
        reported.read_to_string(&mut rest).expect("text");
        assert_eq!(touches.wait().expect("it ends").code(), Some(0), "{rest}");
        println!("{rest}");
    }

    /// Ties the table to touches of that file and to the round before.
    fn tie(&self) -> (Option<i32>, String) {
        let (code, _, said) = self.calibrate(&["table", "--from", "round", "--touches", "touches.yaml"]);
        (code, said)
    }

    fn table_is_tied(&self) {
        let (code, said) = self.tie();
        assert_eq!(code, Some(0), "{said}");
        let table = table_of(self.folder);
        let (mm, deg) = off(&table.base_from_table, &self.base_from_table);
        println!("table off by {mm:.3} mm, {deg:.4} degrees\n{said}");
        assert!(mm < 0.5 && deg < 0.1, "{mm} mm, {deg} degrees\n{said}");
        let by_touch = table.touches.expect("it says that it was touched");
        assert!(by_touch.residuals_m.len() == 4 && by_touch.residuals_m.iter().all(|m| *m < 5e-4));
    }

    /// Touches of another robot are reported as soon as this one has sent its identity; nothing
    /// moves for them.
    fn refuses_touches_of_another_robot(&self) {
        let touched = std::fs::read_to_string(self.folder.join("touches.yaml")).expect("written");
        let other = replace_once(&touched, "robot_serial: ", "robot_serial: other-");
        std::fs::write(self.folder.join("other.yaml"), other).expect("written");
        let stands = self.sim.robot().controller().core.base_from_flange();
        let (code, _, said) = self.calibrate(&["table", "--touches", "other.yaml"]);
        assert!(code == Some(1) && said.contains("touched with robot other-"), "{said}");
        assert!(!said.contains("pose 1/"), "{said}");
        let after = self.sim.robot().controller().core.base_from_flange();
        let moved_m = (after.translation.vector - stands.translation.vector).norm();
        let turned_rad = after.rotation.angle_to(&stands.rotation);
        // An arm that has just stopped creeps by up to 0.1 mrad a joint.
        assert!(moved_m < 5e-4 && turned_rad < 1e-3, "{moved_m} m, {turned_rad} rad");
    }

    /// A tip that is 3 mm longer than was said, which hands turned differently bring to light: nothing is
    /// written.
    fn refuses_a_longer_tip(&self) {
        let before = written(self.folder, "table.yaml");
        let path = self.folder.join("touches.yaml");
        let touched = std::fs::read_to_string(&path).expect("written");
        std::fs::write(&path, replace_once(&touched, "0.15]", "0.153]")).expect("written");
        let (code, said) = self.tie();
        assert!(code == Some(1) && said.contains("the tip's"), "{said}");
        assert_eq!(written(self.folder, "table.yaml"), before);
    }

    /// Ctrl-C while it waits for the person ends it, with nothing written.
    fn ends_with_ctrl_c_while_it_waits(&self) {
        let (mut waiting, mut reported) = self.touching(&["--points", "500,501,502", "--save", "none.yaml"]);
        reported.read_line(&mut String::new()).expect("text");
        let interrupt = format!("kill -INT {}", waiting.id());
        assert!(Command::new("sh").args(["-c", &interrupt]).status().expect("sh").success());
        let mut rest = String::new();
        reported.read_to_string(&mut rest).expect("text");
        assert_eq!(waiting.wait().expect("it ends").code(), Some(130), "{rest}");
        assert!(!self.folder.join("none.yaml").exists());
    }

    /// How the empty table looks, for a camera without depth: refused while objects are on it, taken once it
    /// is bare. Without such pictures the daemon does not start, and says what to do.
    fn takes_the_empty_table(&self) {
        let path = Path::new(&self.cell);
        let text = std::fs::read_to_string(path).expect("the configuration");
        let text = replace_once(&text, "8090, depth: true}", "8090}");
        std::fs::write(path, replace_once(&text, "table.yaml}", "table.yaml, empty: ../empty}"))
            .expect("written");
        let (_, said) = self.refuses_to_run();
        assert!(said.contains("celld calibrate empty"), "{said}");
        // What was taken earlier is no picture of this table either.
        let samples = self.folder.join("empty/samples.yaml");
        std::fs::create_dir_all(self.folder.join("empty")).expect("created");
        std::fs::write(&samples, "version: 1\n").expect("written");
        let (code, _, said) = self.calibrate(&["empty"]);
        assert!(code == Some(1) && said.contains("the table is not empty"), "{said}");
        assert!(said.contains("\"lid\"") && !samples.exists(), "{said}");

        let world = self.sim.world();
        let objects: Vec<String> = lock(&world).objects().iter().map(|body| body.id.clone()).collect();
        for object in objects {
            lock(&world).put(&object, &Pose2::new(2.0, 2.0, 0.0)).expect("it lies free");
        }
        let (code, _, said) = self.calibrate(&["empty"]);
        assert_eq!(code, Some(0), "{said}");
        let taken = std::fs::read_to_string(samples).expect("written");
        assert_eq!(taken.matches(".png").count(), 2, "one for each look pose: {taken}");
    }

    /// The daemon compares its looks with these pictures: a mug is found, and what made the look doubtful is
    /// drawn.
    fn finds_a_mug_by_its_colour(&self) {
        let daemon = start_daemon(self.folder, Path::new(&self.cell));
        let footprint = Footprint::disc(0.04).expect("valid");
        let mug = ForeignBody { footprint, height_m: 0.09, pose: Pose2::new(0.23, 0.22, 0.0) };
        lock(&self.sim.world()).put_foreign(&mug);
        wait_until("the cell is armed", || celld(&["arm"], self.folder).status.code() == Some(0));
        let job = "version: 1\nid: mug\ngoal:\n  objects:\n    - {id: lid, pose: [0.3, 0.38, 0]}\n";
        std::fs::write(self.folder.join("state/jobs/incoming/mug.yaml"), job).expect("written");
        let ended = || result_of(&self.folder.join("state"), "failed", "mug");
        wait_until("the job ends", || ended().is_some());
        let result = ended().expect("a result");
        assert!(result.contains("code: \"foreign_object\"") && result.contains("moves: 0"), "{result}");
        assert!(self.folder.join("state/doubt-1.png").is_file(), "the look is drawn");
        drop(daemon);
    }

    /// Pictures of another camera or robot, or cut short, are none of this table.
    fn refuses_pictures_of_another_table(&self) {
        let samples = self.folder.join("empty/samples.yaml");
        let taken = std::fs::read_to_string(&samples).expect("written");
        for (from, to, wanted) in [
            ("camera_serial: ", "camera_serial: other-", "taken with camera"),
            ("robot_serial: ", "robot_serial: other-", "taken with robot"),
            ("01.png", "03.png", "03.png"),
        ] {
            std::fs::write(&samples, replace_once(&taken, from, to)).expect("written");
            let (code, said) = self.refuses_to_run();
            assert!(said.contains(wanted) && said.contains("celld calibrate empty"), "{said}");
            assert_ne!(code, Some(0));
        }
        std::fs::write(&samples, &taken).expect("written");
    }

    fn refuses_to_run(&self) -> (Option<i32>, String) {
        let ran = celld(&["run", "--config", &self.cell], self.folder);
        (ran.status.code(), text(&ran.stderr))
    }
}

#[test]
fn cell_calibrates_itself_in_a_taught_box_and_the_table_is_tied_to_touches() {
    let folder = tempfile::tempdir().expect("a folder");
    let cell = OnHand::start(folder.path(), ADDRESS);
    cell.proposes_on_paper();
    cell.finds_its_camera();
    cell.is_touched();
    cell.table_is_tied();
    cell.refuses_touches_of_another_robot();
    cell.refuses_a_longer_tip();
    cell.ends_with_ctrl_c_while_it_waits();
    cell.takes_the_empty_table();
    cell.refuses_pictures_of_another_table();
    cell.finds_a_mug_by_its_colour();
    cell.runtime.block_on(cell.sim.shutdown());
}

/// Where the hand carries the board to, table frame, m: its middle, and how it is turned about x, y and z,
/// rad.
const CARRIED_TO: [([f64; 3], [f64; 3]); 14] = [
    ([0.25, 0.25, 0.30], [0.0, 0.0, 0.0]),
    ([0.20, 0.28, 0.34], [0.40, 0.0, 0.2]),
    ([0.30, 0.22, 0.30], [-0.40, 0.0, -0.2]),
    ([0.28, 0.24, 0.36], [0.0, 0.40, 0.3]),
    ([0.22, 0.27, 0.32], [0.0, -0.40, -0.3]),
    ([0.18, 0.22, 0.31], [0.30, 0.30, 0.0]),
    ([0.32, 0.28, 0.38], [-0.30, -0.30, 0.4]),
    ([0.26, 0.20, 0.33], [0.30, -0.30, -0.4]),
    ([0.24, 0.29, 0.30], [-0.30, 0.30, 0.5]),
    ([0.15, 0.25, 0.33], [0.42, 0.1, -0.5]),
    ([0.34, 0.24, 0.31], [-0.42, -0.1, 0.1]),
    ([0.25, 0.26, 0.40], [0.1, 0.42, -0.1]),
    ([0.27, 0.23, 0.30], [-0.1, -0.42, 0.6]),
    ([0.21, 0.24, 0.36], [0.2, -0.2, -0.6]),
];

/// The configuration of a cell whose camera is fixed, taught to carry a board through its picture; and its
/// simulation.
fn standing_camera(folder: &Path, address: &str) -> (PathBuf, PathBuf) {
    let (cell, sim) = configuration(folder, address, 4);
    let edit = |path: &Path, key: &str, next: &str, new: &str| {
        let text = std::fs::read_to_string(path).expect("text");
        let from = text.find(key).expect("the key");
        let to = from + text[from..].find(next).expect("what follows it");
        std::fs::write(path, format!("{}{new}{}", &text[..from], &text[to..])).expect("written");
    };
    let board = "{columns: 5, rows: 4, size: 0.02, first_id: 100}";
    let stands = "{translation: [0, 0.43, 0.75], quaternion: [1, 0, 0, 0]}";
    let clamped = Isometry3::from_parts(
        Translation3::new(0.05, 0.049, 0.03),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
    );
    let held = "{translation: [0.05, 0.049, 0.03], quaternion: [1, 0, 0, 0]}";
    edit(
        &sim,
        "flange_from_camera:",
        "\n\n# Optional. Which arm",
        &format!("base_from_camera: {stands}\nhand_board: {{board: {board}, flange_from_board: {held}}}"),
    );
    // The cell knows nothing of the clamp, and of the camera what a person measures with a tape.
    let roughly = "{translation: [0.03, 0.40, 0.78], quaternion: [1, 0, 0, 0]}";
    edit(
        &cell,
        "camera:\n  mount: flange",
        "\n# Taught joint poses",
        &format!("camera: {{mount: fixed, base_from_camera: {roughly}, board: {board}}}\n"),
    );
    let config = load_cell(&cell).expect("a configuration");
    let arm = arm_model(&config, DhParameters::UR5E, config.base_from_table);
    let taught = CARRIED_TO.map(|(at, turn)| {
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let flange = UnitQuaternion::from_scaled_axis(Vector3::from(turn)) * down;
        let middle = clamped * Point3::new(0.062, 0.049, 0.0);
        let flange =
            Isometry3::from_parts(Translation3::from(Vector3::from(at) - flange * middle.coords), flange);
        let q = arm.joints_in_work_posture(&(flange * arm.flange_from_tool), &arm.home).expect("in reach");
        format!("\n  - [{}]", q.0.map(|q| format!("{:.1}", q.to_degrees())).join(", "))
    });
    let taught = format!("calibration_poses_deg:{}\n", taught.concat());
    edit(&cell, "calibration_poses_deg:", "# Optional. Free of people", &taught);
    (cell, sim)
}

/// A cell whose camera is fixed, running, and the truth about it.
struct Standing {
    runtime: tokio::runtime::Runtime,
    sim: RunningSim,
    cell: PathBuf,
    base_from_camera: Isometry3<f64>,
    base_from_table: Isometry3<f64>,
}

fn start_standing(folder: &Path, address: &str) -> Standing {
    let (cell, sim_path) = standing_camera(folder, address);
    let file = load_sim(&sim_path).expect("the simulation");
    let config = sim_config(&file, address.parse().expect("an address"), RobotPorts::REAL);
    let CameraMount::Fixed(table_from_camera) = config.camera.mount else { panic!("it stands") };
    let base_from_table = config.world.base_from_table;
    let base_from_camera = base_from_table * table_from_camera;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("a runtime");
    let sim = runtime.block_on(start(config)).expect("the simulation starts");
    Standing { runtime, sim, cell, base_from_camera, base_from_table }
}

impl Standing {
    fn calibrate(&self, folder: &Path, words: &[&str]) -> (Option<i32>, String) {
        let config = self.cell.display().to_string();
        let ran = celld(&[&["calibrate", "hand-eye", "--config", &config], words].concat(), folder);
        (ran.status.code(), text(&ran.stderr))
    }

    fn edit(&self, from: &str, to: &str) {
        let yaml = std::fs::read_to_string(&self.cell).expect("text");
        std::fs::write(&self.cell, replace_once(&yaml, from, to)).expect("written");
    }

    /// From poses that a person taught; the clamp is not known.
    fn finds_its_camera_from_taught_poses(&self, folder: &Path) {
        let (code, said) = self.calibrate(folder, &["--record", "round"]);
        assert_eq!(code, Some(0), "{said}");
        assert_stands(folder, &self.base_from_camera, &self.base_from_table, &said);
        assert_eq!(hand_eye_of(folder).samples.len(), CARRIED_TO.len(), "{said}");
    }

    /// The same round from its pictures; and with another board in the configuration nothing is accepted.
    fn believes_no_other_board(&self, folder: &Path) {
        let again = ["--from", "round"];
        assert_eq!(self.calibrate(folder, &again).0, Some(0));
        let before = written(folder, "hand_eye.yaml");
        self.edit("first_id: 100}}\n\n", "first_id: 200}}\n\n");
        let (code, said) = self.calibrate(folder, &again);
        assert!(code == Some(1) && said.contains("show the board on the hand"), "{said}");
        assert_eq!(written(folder, "hand_eye.yaml"), before);
        self.edit("first_id: 200}}\n\n", "first_id: 100}}\n\n");
    }

    /// Shown the board from poses of its own, once it knows roughly how the hand holds it.
    fn finds_its_camera_from_poses_of_its_own(&self, folder: &Path) {
        let visit = ["--visit", "--yes", "--record", "visited"];
        let (code, said) = self.calibrate(folder, &visit);
        assert!(code == Some(2) && said.contains("camera.flange_from_board is missing"), "{said}");
        // As a person would measure the clamp: a centimetre and six degrees off.
        let roughly = "{translation: [0.06, 0.043, 0.025], quaternion: [0.9986, 0.0523, 0, 0]}";
        self.edit("first_id: 100}}\n\n", &format!("first_id: 100}}, flange_from_board: {roughly}}}\n\n"));
        self.edit(
            "calibration_box: {low: [-0.40, 0.12, 0.25], high: [0.40, 0.70, 0.75]}",
            "calibration_box: {low: [-0.25, 0.2, 0.25], high: [0.25, 0.65, 0.55]}",
        );
        let ((code, said), way) = while_watched(&self.sim, || self.calibrate(folder, &visit));
        assert_eq!(code, Some(0), "{said}");
        assert_stayed_in(&self.cell, &folder.join("visited"), &way);
        assert_stands(folder, &self.base_from_camera, &self.base_from_table, &said);
    }

    /// The daemon takes the camera's place from what was measured, and looks from one pose.
    fn works_with_what_it_found(&self, folder: &Path) {
        let yaml = std::fs::read_to_string(&self.cell).expect("text");
        let from = yaml.find("look_poses_deg:").expect("a key");
        let to = from + yaml[from..].find("# Where the arm waits.").expect("the next key");
        let away = "look_poses_deg: [[88.3, -110, 100, -80, -90, 0]]\n";
        std::fs::write(&self.cell, format!("{}{away}{}", &yaml[..from], &yaml[to..])).expect("written");
        let config = self.cell.display().to_string();
        let checked = celld(&["check", &config], folder);
        assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));
        let _daemon = start_daemon(folder, &self.cell);
        wait_until("the cell is armed", || celld(&["arm"], folder).status.code() == Some(0));
    }
}

#[test]
fn cell_with_a_camera_that_stands_is_calibrated_by_the_board_that_the_hand_carries() {
    let folder = tempfile::tempdir().expect("a folder");
    let cell = start_standing(folder.path(), "127.7.1.13");
    cell.finds_its_camera_from_taught_poses(folder.path());
    cell.believes_no_other_board(folder.path());
    cell.finds_its_camera_from_poses_of_its_own(folder.path());
    cell.works_with_what_it_found(folder.path());
    cell.runtime.block_on(cell.sim.shutdown());
}
