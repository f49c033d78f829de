//! Faults of the camera, end to end: the real daemon against the simulator with a broken camera.
//!
//! Each fault is named while the arm is stopped and waits, and when it ends the job goes on by itself; one
//! that does not end fails the job under that name, and the next job is worked on as if nothing had been.

use crate::cell::{
    LOG, PATIENCE, celld, configuration, copy_calibration, result_of, start_daemon, start_sim, text,
    wait_until,
};
use crate::edit::replace_once;
use std::cell::Cell;
use std::path::{Path, PathBuf};

const ADDRESS: &str = "127.7.5.2";

/// A request to the simulator's control server.
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

/// The same configuration with this line instead of the configured camera, which has no depth.
fn with_camera(cell: &Path, camera: &str) {
    let text = std::fs::read_to_string(cell).expect("text");
    let line = text.lines().find(|line| line.starts_with("  camera: {kind: simulator")).expect("a camera");
    let foreign = text.lines().find(|line| line.starts_with("foreign:")).expect("what to do about mugs");
    let text = replace_once(&replace_once(&text, line, camera), foreign, "foreign: {mode: off}");
    std::fs::write(cell, text).expect("written");
}

/// The running cell as a person sees it.
struct CellInUse<'a> {
    folder: &'a Path,
    state: PathBuf,
}

impl CellInUse<'_> {
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
    /// It is handed in once: a heartbeat or state that was lost on the way is a failure, and named.
    fn job(&self, id: &str, x: f64, meanwhile: impl FnOnce()) -> String {
        let goal = format!("goal:\n  objects:\n    - {{id: lid, pose: [{x}, 0.38, 0]}}\n");
        let file = self.state.join("jobs/incoming").join(format!("{id}.yaml"));
        std::fs::write(file, format!("version: 1\nid: {id}\n{goal}")).expect("written");
        meanwhile();
        wait_until("the job ends", || {
            self.nothing_has_disarmed_it();
            self.ended(id).is_some()
        });
        self.ended(id).expect("a result")
    }

    /// No fault of a camera disarms the cell, and nothing else is wrong with it.
    fn nothing_has_disarmed_it(&self) {
        let log = std::fs::read_to_string(self.folder.join(LOG)).expect("what the daemon said");
        let disarmed: Vec<&str> = log.lines().filter(|line| line.contains("disarmed")).collect();
        assert!(disarmed.is_empty(), "{disarmed:#?}");
    }
}

/// What a picture shows is judged in virtual time (`sights`); here it is what only a real connection has: a
/// camera that is gone, that sends the same frame number, or the same picture.
#[test]
fn cell_waits_for_a_broken_camera_names_the_fault_and_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let (cell, sim) = configuration(folder.path(), ADDRESS, 2);
    copy_calibration(folder.path());
    let _simulator = start_sim(&sim);
    let daemon = start_daemon(folder.path(), &cell);
    let cell_in_use = CellInUse { folder: folder.path(), state: folder.path().join("state") };
    cell_in_use.arm();
    let cases = [
        ("{do: camera.off}", "camera_unplugged"),
        ("{do: camera.freeze}", "camera_frozen"),
        ("{do: camera.repeat}", "camera_repeats"),
    ];
    for (number, (order, code)) in cases.into_iter().enumerate() {
        // There is always something to move, so that the absence of motion means something.
        let x = if number % 2 == 0 { 0.30 } else { 0.36 };
        let result = cell_in_use.job(code, x, || {
            fault(order);
            let (before, named) = (truth(), Cell::new(false));
            wait_until(code, || {
                named.set(cell_in_use.status().contains(code));
                named.get() || cell_in_use.ended(code).is_some()
            });
            assert!(named.get(), "{code} is not named: {:?}", cell_in_use.ended(code));
            assert_eq!(truth(), before, "{code}: nothing is touched while nothing is seen");
            fault("{do: clear}");
        });
        assert!(result.contains("status: done"), "{code}: {result}");
        assert!((truth().0 - x).abs() < 0.003, "{code}: the lid was carried after all");
    }

    let result = cell_in_use.job("blind", 0.40, || fault("{do: camera.off}"));
    assert!(result.contains("code: \"camera_unplugged\""), "{result}");
    assert!(
        result.contains("cable") && result.contains("another picture 2 x, connected anew 2 x"),
        "{result}"
    );
    let status = cell_in_use.status();
    assert!(status.contains("armed") && !status.contains("disarmed"), "{status}");
    fault("{do: clear}");
    let result = cell_in_use.job("again", 0.40, || {});
    assert!(result.contains("status: done"), "{result}");
    cell_in_use.nothing_has_disarmed_it();

    drop(daemon);
    waits_for_a_camera_that_was_never_there(&cell_in_use, &cell);
}

/// The daemon starts without its camera and waits for it.
fn waits_for_a_camera_that_was_never_there(cell_in_use: &CellInUse, cell: &Path) {
    with_camera(
        cell,
        "  camera: {kind: uvc, device: /dev/v4l/by-id/usb-away-video-index0, serial: sim-d405, width: 1280, \
         height: 720, fps: 30}",
    );
    let _daemon = start_daemon(cell_in_use.folder, cell);
    cell_in_use.arm();
    let file = cell_in_use.state.join("jobs/incoming/away.yaml");
    let goal = "goal:\n  objects:\n    - {id: lid, pose: [0.36, 0.38, 0]}\n";
    std::fs::write(file, format!("version: 1\nid: away\n{goal}")).expect("written");
    wait_until("the look waits for the camera", || {
        cell_in_use.status().contains("waiting: camera_unplugged")
    });
}
