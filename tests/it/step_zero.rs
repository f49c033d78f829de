//! Step 0 of docs/commissioning.md against the simulator: the same commands, the same readings.
//!
//! The readings are printed with `--nocapture`: on a real controller they are what to write down.

use crate::cell::{LOG, celld, configuration, copy_calibration, start_daemon, start_sim, start_strict_sim};
use crate::cell::{text, wait_until};
use crate::edit::replace_once;
use cell_calibration::blends::{JointTrack, SentPath, judge};
use cell_machine::supervisor::round::RoundOrder;
use cell_motion::bodies::Room;
use cell_motion::crossing::Crossing;
use celld::pair::camera_view::SightKind;
use celld::pair::run::bring_up;
use celld::pair::table::stage;
use celld::pair::worst::worst;
use celld::pair::{Choice, Pair};
use std::path::{Path, PathBuf};
use ur_sim::compare::recording::read_recording;
use ur_sim::motion::rounding::{BlendConfig, ENTRY_SPEEDS};

const ADDRESS: &str = "127.0.6.41";
const STRICT: &str = "127.0.6.42";

/// Controller frames between two samples: 8 ms.
const EVERY: u64 = 4;

/// The configuration of the same cell as one of real devices.
fn as_real(cell: &Path) -> PathBuf {
    let simulated = std::fs::read_to_string(cell).expect("the configuration");
    let real = cell.with_file_name("real.yaml");
    std::fs::write(&real, replace_once(&simulated, "simulation: {clock_factor: 1}\n", "")).expect("written");
    real
}

/// What the doctor says of blends.
fn blends_line(folder: &Path) -> (String, String) {
    let run = celld(&["doctor", "--config", "config/real.yaml", "--format", "json"], folder);
    let sheet: serde_json::Value = serde_json::from_slice(&run.stdout).expect("a sheet");
    let mut lines = sheet["lines"].as_array().expect("lines").iter();
    let line = lines.find(|line| line["item"] == "blends").unwrap_or_else(|| panic!("{sheet:#}"));
    let word = |key: &str| line[key].as_str().unwrap_or_default().to_string();
    (word("verdict"), word("found"))
}

#[test]
fn cell_step_zero_records_blends_and_a_real_arm_has_none_before() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    copy_calibration(folder);
    let (cell, sim) = configuration(folder, ADDRESS, 1);
    let real = as_real(&cell);
    let _sim = start_sim(&sim);
    let (verdict, found) = blends_line(folder);
    assert!(verdict == "note" && found.contains("blends.yaml"), "{verdict}: {found}");

    let log = || std::fs::read_to_string(folder.join(LOG)).unwrap_or_default();
    let daemon = start_daemon(folder, &real);
    wait_until("the daemon runs", || log().contains("celld runs"));
    assert!(log().contains("the arm stops at each corner"), "{}", log());
    drop(daemon);

    let asked = celld(&["calibrate", "blends", "--config", "config/cell.yaml"], folder);
    assert_eq!(asked.status.code(), Some(1), "{}", text(&asked.stderr));
    assert!(text(&asked.stderr).contains("nothing has moved"), "{}", text(&asked.stderr));
    assert!(!folder.join("calibration/sim/blends.yaml").exists());

    let recorded = celld(&["calibrate", "blends", "--config", "config/cell.yaml", "--yes"], folder);
    let said = text(&recorded.stderr);
    println!("{said}");
    assert_eq!(recorded.status.code(), Some(0), "{said}");
    for reading in ["program: ", " bytes, plays ", "way 4: ", "blend of 30.0 mm"] {
        assert!(said.contains(reading), "{reading} in {said}");
    }
    let (verdict, found) = blends_line(folder);
    assert!(verdict == "ok" && found.contains("4 ways"), "{verdict}: {found}");
    let daemon = start_daemon(folder, &real);
    wait_until("the daemon runs", || log().contains("celld runs"));
    assert!(!log().contains("the arm stops at each corner"), "{}", log());
    drop(daemon);

    // What `celld-sim compare` reads, and a program that the simulator can carry out.
    let kept = |name: &str| std::fs::read_to_string(folder.join("calibration/sim").join(name)).expect(name);
    let track = read_recording(&kept("blends.csv"), None).expect("a recording");
    assert!(track.times_s.len() > 500, "{}", track.times_s.len());
    let checked = celld(&["sim", "--check-script", "calibration/sim/blends.script"], folder);
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stdout));

    // An update of the controller voids it, and so does a recording that was changed.
    let file = folder.join("calibration/sim/blends.yaml");
    let whole = kept("blends.yaml");
    let software = whole.lines().find(|line| line.starts_with("software:")).expect("the software");
    std::fs::write(&file, replace_once(&whole, software, "software: URSoftware 5.12.0")).expect("written");
    let (verdict, found) = blends_line(folder);
    assert!(verdict == "note" && found.contains("now it is URSoftware"), "{verdict}: {found}");
    std::fs::write(&file, &whole).expect("written");
    let joints = folder.join("calibration/sim/blends.csv");
    let half: Vec<String> = kept("blends.csv").lines().take(300).map(|line| format!("{line}\n")).collect();
    std::fs::write(joints, half.concat()).expect("written");
    let (verdict, found) = blends_line(folder);
    assert!(verdict == "note" && found.contains("does not show"), "{verdict}: {found}");
}

/// Nobody waits for anybody: what is silent is late.
#[test]
fn cell_step_zero_measures_how_the_arm_stops() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let (_, sim) = configuration(folder, STRICT, 1);
    let _sim = start_strict_sim(&sim);
    // A computer that is held up for a moment ends a way before it is stopped; then it is begun again.
    wait_until("three stops are measured", || {
        let run = celld(&["calibrate", "stops", "--config", "config/cell.yaml", "--yes"], folder);
        let said = text(&run.stderr);
        println!("{said}");
        assert!(!said.contains("DID NOT"), "{said}");
        if run.status.code() != Some(0) {
            return false;
        }
        let stands_ms = |name: &str| {
            let line = said.lines().find(|line| line.starts_with(name)).expect(name);
            let (_, after) = line.rsplit_once("stands after ").expect("a figure");
            after.trim_end_matches(" ms").parse::<f64>().expect("a number")
        };
        // The watchdog waits for 200 ms.
        stands_ms("watchdog") > 200.0
            && stands_ms("stop by order") < 1000.0
            && stands_ms("dashboard stop") < 1000.0
    });
}

#[test]
fn cell_record_only_listens() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let (_, sim) = configuration(folder, "127.0.6.43", 1);
    let _sim = start_sim(&sim);
    let run = celld(&["record", "--robot", "127.0.6.43", "--out", "moves.csv", "--seconds", "1"], folder);
    assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
    let kept = std::fs::read_to_string(folder.join("moves.csv")).expect("a recording");
    let track = read_recording(&kept, None).expect("a recording");
    assert!((490..=501).contains(&track.times_s.len()), "{}", track.times_s.len());
    let nobody = celld(&["record", "--robot", "127.0.6.44", "--out", "none.csv"], folder);
    assert_eq!(nobody.status.code(), Some(1), "{}", text(&nobody.stderr));
    assert!(!folder.join("none.csv").exists());
}

/// Whatever a controller does inside blends, what comes of it is within what paths are checked for.
#[test]
fn blends_of_every_reading_pass_the_judgement() {
    for (name, entry_speed) in ENTRY_SPEEDS {
        for seed in 1..=2 {
            let mut stage = stage(seed, SightKind::Corners).expect("a cell");
            if seed == 2 {
                worst(&mut stage, seed).expect("a cell");
            }
            stage.controller.blends = BlendConfig { entry_speed: *entry_speed, seed };
            let (arm, cycle) = (&stage.model.arm, &stage.model.cycle);
            let room = Room::new(&arm.bodies, &cycle.tabletop(Vec::new()), None);
            let workspace = [stage.model.workspace.width, stage.model.workspace.height];
            let crossing =
                Crossing::over_table(arm, &stage.model.park, workspace, cycle, &room).expect("a way");
            let crossings = crossing.both_ways();
            let sent = |crossing: &Crossing| {
                let path = crossing.path(arm, &crossing.start, cycle, &room, f64::INFINITY).expect("free");
                SentPath { start: crossing.start, segments: path.segments().to_vec() }
            };
            let paths: Vec<SentPath> = crossings.iter().map(sent).collect();
            let mut pair = Pair::new(stage.clone(), Choice::of(seed)).expect("a cell");
            assert!(bring_up(&mut pair), "{name}, {seed}: {:?}", pair.notices());
            pair.visit(RoundOrder::crossings(crossings));
            let (mut track, mut frame) = (JointTrack::default(), 0);
            let over = pair.run_until(300.0, |pair| {
                frame += 1;
                if frame % EVERY == 0 {
                    track.times_s.push(pair.seconds());
                    track.joints.push(pair.simulator().core().robot.controller().core.mover.q());
                }
                pair.round_over().is_some()
            });
            assert!(
                over && pair.round_over().is_some_and(Result::is_ok),
                "{name}, {seed}: {:?}",
                pair.notices()
            );
            let passages = judge(arm, &paths, &track);
            let passages =
                passages.unwrap_or_else(|(path, fault)| panic!("{name}, {seed}, way {path}: {fault}"));
            assert!(passages[2].corners.len() == 2 && passages[3].corners.len() == 2, "{passages:?}");
            assert!(!pair.machine().supervisor().expect("a cell").mode().armed(), "{name}, {seed}");
            assert_eq!(pair.breaches(), [], "{name}, {seed}");
        }
    }
}
