//! Things without a marker, end to end: found by colour where there is no depth.
//!
//! The real daemon against the simulator that puts them on the table, and `celld calibrate empty` before it.
//! What depth shows is tested in virtual time, in `sights`.

use crate::cell::{
    LOG, Running, celld, configuration, copy_calibration, fault, result_of, start_daemon, start_sim, text,
    wait_until,
};
use crate::edit::replace_once;
use std::path::{Path, PathBuf};

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

    /// The result of a job that wants the lid there.
    fn job(&self, id: &str, [x, y]: [f64; 2]) -> String {
        let goal = format!("goal:\n  objects:\n    - {{id: lid, pose: [{x}, {y}, 0]}}\n");
        let file = self.state.join("jobs/incoming").join(format!("{id}.yaml"));
        std::fs::write(file, format!("version: 1\nid: {id}\n{goal}")).expect("written");
        wait_until("the cell is armed", || celld(&["arm"], self.folder).status.code() == Some(0));
        let ended = || ["done", "failed"].into_iter().find_map(|end| result_of(&self.state, end, id));
        wait_until("the job ends", || ended().is_some());
        ended().expect("a result")
    }
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
    let result = daemon.job("clean", [0.30, 0.38]);
    assert!(result.contains("status: done") && result.contains("moves: 1"), "{result} {}", daemon.said());

    let mug = r#"{"do": "world.foreign", "args":
        {"shape": "mug", "size_m": [0.08, 0.08], "height_m": 0.09, "pose": [0.23, 0.22, 0]}}"#;
    fault(address, mug);
    let result = daemon.job("mug", [0.40, 0.38]);
    assert!(result.contains("code: \"foreign_object\"") && result.contains("moves: 0"), "{result}");
    let status = text(&celld(&["status"], folder.path()).stdout);
    assert!(status.contains("disarmed"), "how high it is nobody knows: {status}");
    assert!(daemon.said().contains("of unknown height"), "{}", daemon.said());
    assert!(daemon.state.join("doubt-1.png").is_file(), "the look is drawn");

    fault(address, r#"{"do": "clear"}"#);
    let result = daemon.job("again", [0.40, 0.38]);
    assert!(result.contains("status: done"), "{result} {}", daemon.said());
    assert!(!daemon.state.join("doubt-1.png").exists(), "a good look leaves no doubts behind");

    // With the objects on it the table is not empty; then there is nothing left to compare with.
    drop(daemon);
    let taken = celld(&["calibrate", "empty", "--config", &cell_text], folder.path());
    let said = text(&taken.stderr);
    assert!(taken.status.code() == Some(1) && said.contains("the table is not empty"), "{said}");
    assert!(said.contains("\"lid\"") && !samples.exists(), "{said}");
}
