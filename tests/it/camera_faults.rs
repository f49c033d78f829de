//! Faults of the camera, end to end: the real daemon against the simulator that was told to break its camera.
//!
//! Each fault is named while the arm stands and waits, and when it ends the job goes on by itself; one that
//! does not end fails the job under that name, and the next job is worked on as if nothing had been.

use crate::cell::{
    LOG, PATIENCE, Running, celld, configuration, copy_calibration, result_of, start_daemon, start_sim, text,
    wait_until,
};
use std::cell::Cell;
use std::path::{Path, PathBuf};

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

/// The example cell with its calibration, and the simulator with a control server; `camera` is a line instead
/// of the configured one, of a camera without depth.
fn start(folder: &Path, address: &str, camera: Option<&str>) -> (Running, Running) {
    let (cell, sim) = configuration(folder, address, 1);
    if let Some(camera) = camera {
        let text = std::fs::read_to_string(&cell).expect("text");
        let line =
            text.lines().find(|line| line.starts_with("  camera: {kind: simulator")).expect("a camera");
        let foreign = text.lines().find(|line| line.starts_with("foreign:")).expect("what to do about mugs");
        let text = text.replace(line, camera).replace(foreign, "foreign: {mode: off}");
        std::fs::write(&cell, text).expect("written");
    }
    copy_calibration(folder);
    let simulator = start_sim(&sim);
    (simulator, start_daemon(folder, &cell))
}

/// The running cell as a person sees it.
struct Desk<'a> {
    folder: &'a Path,
    state: PathBuf,
}

/// How often a job is handed in again that a busy machine stopped.
const HANDED_IN: usize = 6;
/// What such a job says: one side was not served in time.
const BUSY: [&str; 3] =
    ["robot's state stopped coming", "missed celld's heartbeat", "celld's program does not run on the robot"];

impl Desk<'_> {
    fn status(&self) -> String {
        text(&celld(&["status"], self.folder).stdout)
    }

    fn ended(&self, id: &str) -> Option<String> {
        ["done", "failed"].into_iter().find_map(|end| result_of(&self.state, end, id))
    }

    fn arm(&self) {
        wait_until("the cell is armed", || celld(&["arm"], self.folder).status.code() == Some(0));
    }

    /// Hands in a job that wants the lid at `x`, does something `meanwhile`, and returns the job's result.
    fn job(&self, id: &str, x: f64, meanwhile: impl Fn(&str)) -> String {
        let mut stopped = Vec::new();
        for attempt in 0..HANDED_IN {
            let id = format!("{id}-{attempt}");
            let goal = format!("goal:\n  objects:\n    - {{id: lid, pose: [{x}, 0.38, 0]}}\n");
            let file = self.state.join("jobs/incoming").join(format!("{id}.yaml"));
            std::fs::write(file, format!("version: 1\nid: {id}\n{goal}")).expect("written");
            meanwhile(&id);
            wait_until("the job ends", || {
                let disarmed = self.status().contains("disarmed");
                let ended = self.ended(&id).is_some();
                if disarmed && !ended {
                    // A busy machine stopped the cell between two jobs.
                    self.arm();
                }
                ended
            });
            let result = self.ended(&id).expect("a result");
            if !BUSY.iter().any(|words| result.contains(words)) {
                return result;
            }
            stopped.push(result);
            self.arm();
        }
        panic!("{id}: the machine is too busy for a robot: {stopped:#?}");
    }

    /// That nothing but a busy machine has disarmed the cell.
    fn no_fault_disarmed_it(&self) {
        let log = std::fs::read_to_string(self.folder.join(LOG)).expect("what the daemon said");
        let disarmed = log.lines().filter(|line| line.contains("disarmed: "));
        let other: Vec<&str> =
            disarmed.filter(|line| !BUSY.iter().any(|words| line.contains(words))).collect();
        assert!(other.is_empty(), "{other:?}");
    }
}

#[test]
fn cell_waits_for_a_broken_camera_names_the_fault_and_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let _running = start(folder.path(), ADDRESS, None);
    let desk = Desk { folder: folder.path(), state: folder.path().join("state") };
    desk.arm();
    let result = desk.job("good", 0.36, |_| {});
    assert!(result.contains("status: done"), "{result}");
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
        // There is always something to move, so that standing still means something.
        let x = if number % 2 == 0 { 0.30 } else { 0.36 };
        let named = Cell::new(false);
        let result = desk.job(code, x, |id| {
            fault(order);
            let before = truth();
            wait_until(code, || desk.status().contains(code) || desk.ended(id).is_some());
            named.set(named.get() || desk.status().contains(code));
            assert_eq!(truth(), before, "{code}: nothing is touched while nothing is seen");
            fault("{do: clear}");
        });
        assert!(named.get() && result.contains("status: done"), "{code}: {result}");
        assert!((truth().0 - x).abs() < 0.003, "{code}: the lid was carried after all");
    }

    let result = desk.job("blind", 0.40, |_| fault("{do: camera.off}"));
    assert!(result.contains("code: \"camera_unplugged\""), "{result}");
    assert!(result.contains("cable") && result.contains("asked again 2 x, connected anew 2 x"), "{result}");
    let status = desk.status();
    assert!(status.contains("armed") && !status.contains("disarmed"), "{status}");
    fault("{do: clear}");
    let result = desk.job("again", 0.40, |_| {});
    assert!(result.contains("status: done"), "{result}");
    desk.no_fault_disarmed_it();
}

#[test]
fn cell_starts_without_its_camera_and_waits_for_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let camera = "  camera: {kind: uvc, device: /dev/v4l/by-id/usb-away-video-index0, serial: sim-d405, width: 1280, \
                  height: 720, fps: 30}";
    let _running = start(folder.path(), "127.7.5.3", Some(camera));
    let desk = Desk { folder: folder.path(), state: folder.path().join("state") };
    desk.arm();
    let file = desk.state.join("jobs/incoming/away.yaml");
    let goal = "goal:\n  objects:\n    - {id: lid, pose: [0.36, 0.38, 0]}\n";
    std::fs::write(file, format!("version: 1\nid: away\n{goal}")).expect("written");
    wait_until("the look waits for the camera", || desk.status().contains("waiting: camera_unplugged"));
}
