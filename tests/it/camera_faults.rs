//! Faults of the camera, end to end: the real daemon against the simulator that was told to break its camera.
//!
//! Each fault is named while the arm stands and waits, and when it ends the job goes on by itself; one that does not end
//! fails the job under that name, and the next job is worked on as if nothing had been.

use crate::cell::{CELLD, PATIENCE, Running, celld, configuration, result_of, text, wait_until};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

const ADDRESS: &str = "127.7.5.2";

/// What is asked of the simulator's control server.
fn control(path: &str, body: Option<&str>) -> serde_json::Value {
    let url = format!("http://{ADDRESS}:8091{path}");
    let agent: ureq::Agent = ureq::Agent::config_builder().timeout_global(Some(PATIENCE)).build().into();
    let answer = match body {
        Some(body) => agent.post(&url).send(body),
        None => agent.get(&url).call(),
    };
    let text = answer.expect("the control server").body_mut().read_to_string().expect("text");
    serde_json::from_str(&text).expect("JSON")
}

fn fault(order: &str) {
    assert_eq!(control("/fault", Some(order))["ok"], true, "{order}");
}

/// Where the lid truly is, and how often something was gripped.
fn truth() -> (f64, usize) {
    let world = control("/world.json", None);
    let objects = world["objects"].as_array().expect("objects");
    let lid = objects.iter().find(|object| object["id"] == "lid").expect("the lid");
    let grips = world["events"].as_array().expect("events").iter();
    let grips = grips.filter(|event| event.to_string().contains("grip")).count();
    (lid["pose"][0].as_f64().expect("a number"), grips)
}

/// The example cell with its calibration, and the simulator with a control server.
fn start(folder: &Path) -> (Running, Running) {
    let (cell, sim) = configuration(folder, ADDRESS, 2);
    let calibration = folder.join("calibration/sim");
    std::fs::create_dir_all(&calibration).expect("created");
    let made = Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/sim");
    for name in ["camera.yaml", "hand_eye.yaml", "table.yaml"] {
        std::fs::copy(made.join(name), calibration.join(name)).expect("the simulated cell's calibration");
    }
    let mut simulator = Command::new(CELLD)
        .args(["sim", "--control", "--config"])
        .arg(sim)
        .stdout(Stdio::piped())
        .spawn()
        .expect("the binary runs");
    let mut line = String::new();
    let stdout = simulator.stdout.take().expect("piped");
    BufReader::new(stdout).read_line(&mut line).expect("a line");
    assert!(line.contains("\"ready\":true"), "{line}");
    let daemon = Command::new(CELLD)
        .args(["run", "--config"])
        .arg(cell)
        .current_dir(folder)
        .stderr(Stdio::null())
        .spawn()
        .expect("the binary runs");
    (Running(simulator), Running(daemon))
}

#[test]
fn cell_waits_for_a_broken_camera_names_the_fault_and_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let _running = start(folder.path());
    let state = folder.path().join("state");
    let incoming = state.join("jobs/incoming");
    wait_until("the daemon opens its folders", || incoming.is_dir());
    let submit = |id: &str, x: f64| {
        let job =
            format!("version: 1\nid: {id}\ngoal:\n  objects:\n    - {{id: lid, pose: [{x}, 0.38, 0]}}\n");
        std::fs::write(incoming.join(format!("{id}.yaml")), job).expect("written");
    };
    let status = || text(&celld(&["status"], folder.path()).stdout);
    let ended = |id: &str| ["done", "failed"].into_iter().find_map(|end| result_of(&state, end, id));
    let done = |id: &str| {
        wait_until("the job ends", || ended(id).is_some());
        let result = ended(id).expect("a result");
        assert!(result.contains("status: done"), "{id}: {result}");
    };

    submit("good", 0.36);
    wait_until("the cell is armed", || celld(&["arm"], folder.path()).status.code() == Some(0));
    done("good");
    let cases = [
        ("{do: camera.off}", "camera_unplugged"),
        ("{do: camera.freeze}", "camera_frozen"),
        ("{do: camera.repeat}", "camera_repeats"),
        ("{do: camera.gain, args: {gain: 0.1}}", "camera_dark"),
        ("{do: camera.gain, args: {gain: 50}}", "camera_overexposed"),
        ("{do: camera.fog, args: {share: 0.95}}", "camera_sees_nothing"),
        ("{do: camera.blur, args: {sigma_px: 6}}", "camera_blurred"),
    ];
    for (number, (order, code)) in cases.into_iter().enumerate() {
        let id = format!("job-{number}");
        fault(order);
        // The first one has something to move, so that standing still means something.
        let x = if number == 0 { 0.30 } else { truth().0 };
        let before = truth();
        submit(&id, x);
        wait_until(code, || status().contains(code) || ended(&id).is_some());
        assert!(ended(&id).is_none(), "{code}: {:?}", ended(&id));
        assert_eq!(truth(), before, "{code}: nothing is touched while nothing is seen");
        fault("{do: clear}");
        done(&id);
    }
    assert!((truth().0 - 0.30).abs() < 0.003, "the lid was carried after all");

    fault("{do: camera.off}");
    submit("blind", 0.40);
    wait_until("the job is given up", || ended("blind").is_some());
    let result = ended("blind").expect("a result");
    assert!(result.contains("code: \"camera_unplugged\""), "{result}");
    assert!(result.contains("cable") && result.contains("asked again 2 x, connected anew 2 x"), "{result}");
    assert!(status().contains("armed") && !status().contains("disarmed"), "{}", status());
    fault("{do: clear}");
    submit("again", 0.40);
    done("again");
}
