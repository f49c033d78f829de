//! Things without a marker as obstacles, end to end: the real daemon works round one that the simulator put on the table.
//!
//! That nothing is moved while there is one, the other rule, is tested in `cell`.

use crate::cell::{CELLD, PATIENCE, Running, celld, configuration, fault, result_of, start_sim, wait_until};
use std::cell::RefCell;
use std::path::Path;
use std::process::{Command, Stdio};

const ADDRESS: &str = "127.7.6.2";

/// Middle, half an edge and height of the box that stands between the lid's start and its goal, m.
const BOX: [f64; 2] = [0.285, 0.295];
const HALF_M: f64 = 0.03;
const HEIGHT_M: f64 = 0.06;
const LID_RADIUS_M: f64 = 0.045;
const MARGIN_M: f64 = 0.01;

/// How often a job is handed in again that was stopped because a busy machine kept the robot's states from coming.
const HANDED_IN: usize = 6;

fn world() -> serde_json::Value {
    let agent: ureq::Agent = ureq::Agent::config_builder().timeout_global(Some(PATIENCE)).build().into();
    let mut answer =
        agent.get(format!("http://{ADDRESS}:8091/world.json")).call().expect("the control server");
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
    let folder = tempfile::tempdir().expect("a folder");
    let (cell, sim) = configuration(folder.path(), ADDRESS, 2);
    let text = std::fs::read_to_string(&cell).expect("the configuration");
    assert!(text.contains("foreign: {mode: refuse}"));
    let rule = format!("foreign: {{mode: obstacle, margin_m: {MARGIN_M}}}");
    std::fs::write(&cell, text.replace("foreign: {mode: refuse}", &rule)).expect("written");
    let calibration = folder.path().join("calibration/sim");
    std::fs::create_dir_all(&calibration).expect("created");
    let made = Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/sim");
    for name in ["camera.yaml", "hand_eye.yaml", "table.yaml"] {
        std::fs::copy(made.join(name), calibration.join(name)).expect("the simulated cell's calibration");
    }
    let _sim = start_sim(&sim);
    let log = folder.path().join("log.txt");
    let _daemon = Running(
        Command::new(CELLD)
            .args(["run", "--config"])
            .arg(&cell)
            .current_dir(folder.path())
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(&log).expect("a file"))
            .spawn()
            .expect("the binary runs"),
    );
    let state = folder.path().join("state");
    let incoming = state.join("jobs/incoming");
    wait_until("the daemon opens its folders", || incoming.is_dir());
    let thing = format!(
        r#"{{"do": "world.foreign", "args": {{"shape": "box", "size_m": [0.06, 0.06], "height_m": {HEIGHT_M}, "pose": [{}, {}, 0]}}}}"#,
        BOX[0], BOX[1]
    );
    fault(ADDRESS, &thing);
    let objects = world();
    let ids: Vec<&str> = objects["objects"]
        .as_array()
        .expect("objects")
        .iter()
        .filter_map(|object| object["id"].as_str())
        .collect();
    let stranger = *ids.iter().find(|id| id.starts_with("foreign")).expect("the box stands there");
    let stood = place(&objects, stranger);

    let nearest = RefCell::new((f64::INFINITY, false));
    let look_on = || {
        let [x, y, z] = place(&world(), "lid");
        let mut nearest = nearest.borrow_mut();
        let away = beside([x, y]) - LID_RADIUS_M;
        if away < 0.0 {
            nearest.1 = true;
            nearest.0 = nearest.0.min(z - HEIGHT_M);
        }
    };
    let mut result = String::new();
    for attempt in 0..HANDED_IN {
        let id = format!("round-{attempt}");
        let goal = "goal:\n  objects:\n    - {id: lid, pose: [0.21, 0.21, 0]}\n";
        std::fs::write(incoming.join(format!("{id}.yaml")), format!("version: 1\nid: {id}\n{goal}"))
            .expect("written");
        wait_until("the cell is armed", || celld(&["arm"], folder.path()).status.code() == Some(0));
        let ended = || ["done", "failed"].into_iter().find_map(|end| result_of(&state, end, &id));
        wait_until("the job ends", || {
            look_on();
            ended().is_some()
        });
        result = ended().expect("a result");
        if !result.contains("robot's state stopped coming") {
            break;
        }
    }
    let said = std::fs::read_to_string(&log).expect("the log");
    assert!(result.contains("status: done") && result.contains("moves: 1"), "{result} {said}");
    assert!(said.contains("is kept clear of"), "{said}");

    let after = world();
    let [x, y, z] = place(&after, "lid");
    assert!((x - 0.21).hypot(y - 0.21) < 3e-3 && z < 1e-3, "{x} {y} {z}");
    let (air, over) = *nearest.borrow();
    assert!(over, "the way leads over the box, and somebody looked while it did");
    assert!(air > 0.5 * MARGIN_M, "carried {air} m over the box");
    assert_eq!(place(&after, stranger), stood, "nobody touched it");
    let touched = |event: &&serde_json::Value| {
        let text = event.to_string();
        text.contains(stranger) && !text.contains("\"fault\"")
    };
    let events = after["events"].as_array().expect("events");
    assert_eq!(events.iter().find(touched), None);
}
