//! Things without a marker, end to end: worked round as obstacles, and found by colour where there is no
//! depth.
//!
//! The real daemon against the simulator that puts them on the table. That nothing is moved while depth shows
//! one is tested in `cell`.

use crate::cell::{
    LOG, PATIENCE, Running, celld, configuration, copy_calibration, fault, result_of, start_daemon,
    start_sim, text, wait_until,
};
use crate::edit::replace_once;
use std::cell::RefCell;
use std::path::{Path, PathBuf};

/// Middle, half an edge and height of the box that stands between the lid's start and its goal, m.
const BOX: [f64; 2] = [0.285, 0.295];
const HALF_M: f64 = 0.03;
const HEIGHT_M: f64 = 0.045;
const LID_RADIUS_M: f64 = 0.045;
const MARGIN_M: f64 = 0.01;

/// The example cell with its calibration and `changes` to its text.
fn cell_with(folder: &Path, address: &str, changes: &[(&str, &str)]) -> (PathBuf, PathBuf) {
    let (cell, sim) = configuration(folder, address, 1);
    let mut yaml = std::fs::read_to_string(&cell).expect("the configuration");
    for (from, to) in changes {
        yaml = replace_once(&yaml, from, to);
    }
    std::fs::write(&cell, yaml).expect("written");
    copy_calibration(folder);
    (cell, sim)
}

/// The running daemon, its state folder and its log.
struct Daemon<'a> {
    folder: &'a Path,
    state: PathBuf,
    log: PathBuf,
    _process: Running,
}

impl Daemon<'_> {
    fn start<'a>(folder: &'a Path, cell: &Path) -> Daemon<'a> {
        let (state, log) = (folder.join("state"), folder.join(LOG));
        Daemon { folder, state, log, _process: start_daemon(folder, cell) }
    }

    fn said(&self) -> String {
        std::fs::read_to_string(&self.log).expect("the log")
    }

    /// The result of a job that wants the lid there; `meanwhile` is called again and again until it has
    /// ended.
    fn job(&self, id: &str, [x, y]: [f64; 2], meanwhile: impl Fn()) -> String {
        let goal = format!("goal:\n  objects:\n    - {{id: lid, pose: [{x}, {y}, 0]}}\n");
        let file = self.state.join("jobs/incoming").join(format!("{id}.yaml"));
        std::fs::write(file, format!("version: 1\nid: {id}\n{goal}")).expect("written");
        wait_until("the cell is armed", || celld(&["arm"], self.folder).status.code() == Some(0));
        let ended = || ["done", "failed"].into_iter().find_map(|end| result_of(&self.state, end, id));
        wait_until("the job ends", || {
            meanwhile();
            ended().is_some()
        });
        ended().expect("a result")
    }
}

fn world(address: &str) -> serde_json::Value {
    let agent: ureq::Agent = ureq::Agent::config_builder().timeout_global(Some(PATIENCE)).build().into();
    let mut answer =
        agent.get(format!("http://{address}:8091/world.json")).call().expect("the control server");
    serde_json::from_str(&answer.body_mut().read_to_string().expect("text")).expect("JSON")
}

/// Where something truly is: x, y, and the height of its underside, m.
fn place(world: &serde_json::Value, id: &str) -> [f64; 3] {
    let objects = world["objects"].as_array().expect("objects");
    let object = objects.iter().find(|object| object["id"] == id).expect("it is there");
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    [number(&object["pose"][0]), number(&object["pose"][1]), number(&object["z_m"])]
}

/// Distance of a place from the box, seen from above, m.
fn beside([x, y]: [f64; 2]) -> f64 {
    let out = |at: f64, middle: f64| ((at - middle).abs() - HALF_M).max(0.0);
    out(x, BOX[0]).hypot(out(y, BOX[1]))
}

#[test]
fn cell_works_round_an_obstacle_without_a_marker_and_nothing_comes_near_it() {
    let address = "127.7.6.2";
    let folder = tempfile::tempdir().expect("a folder");
    let rule = format!("foreign: {{mode: obstacle, margin_m: {MARGIN_M}}}");
    let (cell, sim) = cell_with(folder.path(), address, &[("foreign: {mode: refuse}", &rule)]);
    let _sim = start_sim(&sim);
    let daemon = Daemon::start(folder.path(), &cell);
    let thing = format!(
        r#"{{"do": "world.foreign", "args":
            {{"shape": "box", "size_m": [0.06, 0.06], "height_m": {HEIGHT_M}, "pose": [{}, {}, 0]}}}}"#,
        BOX[0], BOX[1]
    );
    fault(address, &thing);
    let before = world(address);
    let objects = before["objects"].as_array().expect("objects");
    let mut ids = objects.iter().filter_map(|object| object["id"].as_str());
    let stranger = ids.find(|id| id.starts_with("foreign")).expect("the box stands there");
    let stood = place(&before, stranger);

    // The least air under the lid while it is over the box.
    let over: RefCell<Option<f64>> = RefCell::new(None);
    let result = daemon.job("round", [0.225, 0.205], || {
        let [x, y, z] = place(&world(address), "lid");
        if beside([x, y]) < LID_RADIUS_M {
            let air = z - HEIGHT_M;
            over.replace_with(|least| Some(least.map_or(air, |least| least.min(air))));
        }
    });
    let said = daemon.said();
    assert!(result.contains("status: done") && result.contains("moves: 1"), "{result} {said}");
    assert!(said.contains("is kept clear of"), "{said}");

    let after = world(address);
    let [x, y, z] = place(&after, "lid");
    assert!((x - 0.225).hypot(y - 0.205) < 3e-3 && z < 1e-3, "{x} {y} {z}");
    let air = over.borrow().expect("the way leads over the box, and somebody looked while it did");
    assert!(air > 0.5 * MARGIN_M, "carried {air} m over the box");
    assert_eq!(place(&after, stranger), stood, "nobody touched it");
    let touched = |event: &&serde_json::Value| {
        let by = ["object", "by", "moving", "against"].iter().filter_map(|key| event[*key].as_str());
        let on = event["on"].as_array().into_iter().flatten().filter_map(|on| on.as_str());
        by.chain(on).any(|name| name == stranger)
    };
    assert_eq!(after["events"].as_array().expect("events").iter().find(touched), None);
}

/// The table is bare: without pictures of it the daemon says what to do, and does not start; then they are
/// taken. Returns their list, `samples.yaml`.
fn take_the_empty_table(folder: &Path, cell: &str, sim: &Path) -> PathBuf {
    let full = std::fs::read_to_string(sim).expect("the simulator's configuration");
    let (head, rest) = full.split_once("objects:\n").expect("objects");
    let (_, tail) = rest.split_once("# Markers fixed").expect("reference markers");
    let bare = sim.with_file_name("bare.yaml");
    std::fs::write(&bare, format!("{head}objects: []\n\n# Markers fixed{tail}")).expect("written");
    let _sim = start_sim(&bare);
    let refused = celld(&["run", "--config", cell], folder);
    assert!(text(&refused.stderr).contains("celld calibrate empty"), "{}", text(&refused.stderr));
    let taken = celld(&["calibrate", "empty", "--config", cell], folder);
    assert_eq!(taken.status.code(), Some(0), "{}", text(&taken.stderr));
    folder.join("empty/samples.yaml")
}

/// Pictures of another camera or robot, or cut short, are none of this table.
fn refuses_pictures_of_another_table(folder: &Path, cell: &str, samples: &Path) {
    let taken = std::fs::read_to_string(samples).expect("written");
    assert_eq!(taken.matches(".png").count(), 2, "one for each look pose: {taken}");
    for (from, to, wanted) in [
        ("camera_serial: ", "camera_serial: other-", "taken with camera"),
        ("robot_serial: ", "robot_serial: other-", "taken with robot"),
        ("01.png", "03.png", "03.png"),
    ] {
        std::fs::write(samples, replace_once(&taken, from, to)).expect("written");
        let refused = celld(&["run", "--config", cell], folder);
        let said = text(&refused.stderr);
        assert!(said.contains(wanted) && said.contains("celld calibrate empty"), "{said}");
        assert_ne!(refused.status.code(), Some(0));
    }
    std::fs::write(samples, &taken).expect("written");
}

#[test]
fn cell_finds_what_was_not_on_the_empty_table_by_its_colour() {
    let address = "127.7.6.4";
    let folder = tempfile::tempdir().expect("a folder");
    let changes = [("8090, depth: true}", "8090}"), ("table.yaml}", "table.yaml, empty: ../empty}")];
    let (cell, sim) = cell_with(folder.path(), address, &changes);
    let cell_text = cell.display().to_string();
    let samples = take_the_empty_table(folder.path(), &cell_text, &sim);
    let _sim = start_sim(&sim);
    refuses_pictures_of_another_table(folder.path(), &cell_text, &samples);
    let daemon = Daemon::start(folder.path(), &cell);
    let result = daemon.job("clean", [0.30, 0.38], || {});
    assert!(result.contains("status: done") && result.contains("moves: 1"), "{result} {}", daemon.said());

    let mug = r#"{"do": "world.foreign", "args":
        {"shape": "mug", "size_m": [0.08, 0.08], "height_m": 0.09, "pose": [0.23, 0.22, 0]}}"#;
    fault(address, mug);
    let result = daemon.job("mug", [0.40, 0.38], || {});
    assert!(result.contains("code: \"foreign_object\"") && result.contains("moves: 0"), "{result}");
    let status = text(&celld(&["status"], folder.path()).stdout);
    assert!(status.contains("disarmed"), "how high it is nobody knows: {status}");
    assert!(daemon.said().contains("of unknown height"), "{}", daemon.said());
    assert!(daemon.state.join("doubt-1.png").is_file(), "the look is drawn");

    fault(address, r#"{"do": "clear"}"#);
    let result = daemon.job("again", [0.40, 0.38], || {});
    assert!(result.contains("status: done"), "{result} {}", daemon.said());

    // With the objects on it the table is not empty; then there is nothing left to compare with.
    drop(daemon);
    let taken = celld(&["calibrate", "empty", "--config", &cell_text], folder.path());
    let said = text(&taken.stderr);
    assert!(taken.status.code() == Some(1) && said.contains("the table is not empty"), "{said}");
    assert!(said.contains("\"lid\"") && !samples.exists(), "{said}");
}
