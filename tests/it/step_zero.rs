//! Step 0 of docs/commissioning.md against the simulator: the same commands, the same readings.
//!
//! The readings are printed with `--nocapture`: on a real controller they are what to write down.

use crate::cell::{
    CELLD, LOG, Running, celld, configuration, copy_calibration, interrupt, start_daemon, start_sim, text,
    wait_until,
};
use crate::edit::replace_once;
use cell_calibration::blends::{BlendFault, JointTrack, SentPath, judge};
use cell_machine::supervisor::round::RoundOrder;
use cell_motion::bodies::Room;
use cell_motion::crossing::Crossing;
use cell_motion::path::Segment;
use celld::pair::camera_view::SightKind;
use celld::pair::run::bring_up;
use celld::pair::table::stage;
use celld::pair::worst::worst;
use celld::pair::{Choice, Pair};
use clap::Parser;
use std::path::{Path, PathBuf};
use ur_sim::command::compare::{self, CompareArgs};
use ur_sim::compare::recording::read_recording;
use ur_sim::motion::rounding::{BlendConfig, ENTRY_SPEEDS};

const ADDRESS: &str = "127.0.6.41";
const STOPS: &str = "127.0.6.42";

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

/// Runs the daemon of the real configuration until it works; its log.
fn log_of_daemon(folder: &Path) -> String {
    let log = || std::fs::read_to_string(folder.join(LOG)).unwrap_or_default();
    let _daemon = start_daemon(folder, &folder.join("config/real.yaml"));
    wait_until("the daemon runs", || log().contains("celld runs"));
    log()
}

fn calibrate_blends(folder: &Path) -> (Option<i32>, String) {
    let run = celld(&["calibrate", "blends", "--config", "config/cell.yaml", "--yes"], folder);
    let said = text(&run.stderr);
    println!("{said}");
    (run.status.code(), said)
}

/// Records blends while a recorder listens, which takes nothing that celld needs.
fn record_beside(folder: &Path) -> (Option<i32>, String) {
    let beside = std::process::Command::new(CELLD)
        .args(["record", "--robot", ADDRESS, "--out", "moves.csv"])
        .current_dir(folder)
        .spawn();
    let mut beside = Running(beside.expect("the binary runs"));
    let recorded = calibrate_blends(folder);
    interrupt(&beside);
    assert_eq!(beside.0.wait().expect("it has ended").code(), Some(0), "Ctrl-C ends a recording");
    let moves = std::fs::read_to_string(folder.join("moves.csv")).expect("a recording");
    let moves = read_recording(&moves, None).expect("whole lines");
    assert!(moves.times_s.len() > 2000, "{} lines", moves.times_s.len());
    recorded
}

/// `celld-sim compare` in this process: cargo does not build another package's program for a test.
#[derive(Parser)]
struct Compare {
    #[command(flatten)]
    args: CompareArgs,
}

/// The figure between these words.
#[track_caller]
fn figure(text: &str, before: &str, after: &str) -> f64 {
    let number = text.split_once(before).and_then(|(_, rest)| rest.split_once(after));
    let number = number.unwrap_or_else(|| panic!("no {before:?} in\n{text}")).0.replace(',', "");
    number.parse().unwrap_or_else(|_| panic!("{before:?}: {number:?} is no number"))
}

/// Size and start of the program, and the recording, are within the figures of the page. The exit code of
/// the page's command proves the last.
fn keeps_what_the_page_promises(folder: &Path, said: &str) {
    let page = include_str!("../../docs/commissioning.md");
    let bytes = figure(said, "program: ", " bytes");
    assert!(bytes <= figure(page, "| `calibrate blends` | at most ", " bytes"), "{said}");
    assert!(figure(said, " bytes, plays ", " s ") <= figure(page, " bytes; plays within ", " s."), "{said}");

    let command = page.lines().find(|line| line.starts_with("    celld-sim compare ")).expect("the command");
    let promised = page.lines().find(|line| line.starts_with("| difference |")).expect("the reading");
    for (option, before, after) in
        [("--joint-tolerance ", "joints within ", " mrad"), ("--time-tolerance ", "as long within ", " ms")]
    {
        let (proved, promised) = (1e3 * figure(command, option, " "), figure(promised, before, after));
        assert!((proved - promised).abs() < 1e-6, "{option}: {proved}, and {promised} in the table");
    }
    let words = command.split(" #").next().unwrap_or_default().split_whitespace().skip(1);
    let words = words.map(|word| match word.starts_with("blends.") {
        true => folder.join("calibration/sim").join(word).into_os_string(),
        false => word.into(),
    });
    let Compare { args } = Compare::try_parse_from(words).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(compare::run(&args), 0, "beyond the tolerances: {command}");
}

#[test]
fn cell_step_zero_records_blends_and_a_real_arm_has_none_before() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    copy_calibration(folder);
    let (cell, sim) = configuration(folder, ADDRESS, 1);
    as_real(&cell);
    let _sim = start_sim(&sim);
    let (verdict, found) = blends_line(folder);
    assert!(verdict == "note" && found.contains("blends.yaml"), "{verdict}: {found}");
    let log = log_of_daemon(folder);
    assert!(log.contains("the arm stops at each corner"), "{log}");

    let shown = celld(&["calibrate", "blends", "--config", "config/cell.yaml"], folder);
    assert_eq!(shown.status.code(), Some(1), "{}", text(&shown.stderr));
    assert!(text(&shown.stderr).contains("nothing has moved"), "{}", text(&shown.stderr));
    assert!(!folder.join("calibration/sim/blends.yaml").exists());

    let (code, said) = record_beside(folder);
    assert_eq!(code, Some(0), "{said}");
    for reading in ["program: ", " bytes, plays ", "way 4: ", "blend of 30.0 mm"] {
        assert!(said.contains(reading), "{reading} in {said}");
    }
    let (verdict, found) = blends_line(folder);
    assert!(verdict == "ok" && found.contains("4 ways"), "{verdict}: {found}");
    let log = log_of_daemon(folder);
    assert!(!log.contains("the arm stops at each corner"), "{log}");
    let checked = celld(&["sim", "--check-script", "calibration/sim/blends.script"], folder);
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stdout));
    keeps_what_the_page_promises(folder, &said);

    changed_recordings_are_void(folder);

    // At half the speed nothing is proved, also not what an earlier recording showed.
    fault(r#"{"do": "ur.slider", "args": {"fraction": 0.5}}"#);
    let (code, said) = calibrate_blends(folder);
    assert!(code == Some(1) && said.contains("record at 100 %"), "{said}");
    assert!(!folder.join("calibration/sim/blends.yaml").exists(), "the recording before is void");
}

/// An update of the controller voids a recording, a larger limit, and half a recording.
fn changed_recordings_are_void(folder: &Path) {
    let place = |name: &str| folder.join("calibration/sim").join(name);
    let [whole, joints] =
        ["blends.yaml", "blends.csv"].map(|name| std::fs::read_to_string(place(name)).expect(name));
    let found_with = |yaml: &str, csv: &str| {
        std::fs::write(place("blends.yaml"), yaml).expect("written");
        std::fs::write(place("blends.csv"), csv).expect("written");
        let (verdict, found) = blends_line(folder);
        assert_eq!(verdict, "note", "{found}");
        found
    };
    let software = whole.lines().find(|line| line.starts_with("software:")).expect("the software");
    let found = found_with(&replace_once(&whole, software, "software: URSoftware 5.12.0"), &joints);
    assert!(found.contains("now it is URSoftware"), "{found}");
    let slower = replace_once(&whole, "tool_speed_m_s: 0.25", "tool_speed_m_s: 0.2");
    let found = found_with(&slower, &joints);
    assert!(found.contains("limits.tool_speed_m_s 0.2, now it is 0.25"), "{found}");
    let half: Vec<String> = joints.lines().take(300).map(|line| format!("{line}\n")).collect();
    let found = found_with(&whole, &half.concat());
    assert!(found.contains("no sample"), "{found}");
    std::fs::write(place("blends.csv"), joints).expect("written");
}

fn fault(order: &str) {
    let mut answer = ureq::post(format!("http://{ADDRESS}:8091/fault")).send(order).expect("an answer");
    let text = answer.body_mut().read_to_string().expect("text");
    assert!(text.contains("true"), "{order}: {text}");
}

/// Also against a simulator that would wait for a celld which follows its clock.
#[test]
fn cell_step_zero_measures_how_the_arm_stops() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let (_, sim) = configuration(folder, STOPS, 1);
    let _sim = start_sim(&sim);
    // A computer that is held up for a moment ends a way before it is stopped; then it is begun again.
    let tries = std::cell::Cell::new(0);
    wait_until("three stops are measured", || {
        tries.set(tries.get() + 1);
        assert!(tries.get() <= 5, "five tries");
        let run = celld(&["calibrate", "stops", "--config", "config/cell.yaml", "--yes"], folder);
        let said = text(&run.stderr);
        println!("{said}");
        assert!(!said.contains("DID NOT"), "{said}");
        if run.status.code() != Some(0) {
            return false;
        }
        let figures = |name: &str| {
            let line = said.lines().find(|line| line.starts_with(name)).expect(name);
            let words: Vec<&str> = line.split_whitespace().collect();
            let ms = words.iter().zip(words.iter().skip(1)).filter(|(_, unit)| **unit == "ms");
            let ms: Vec<f64> = ms.map(|(number, _)| number.parse().expect("a number")).collect();
            (ms[0], ms[1])
        };
        // The watchdog waits for 200 ms; the last heartbeat may be 20 ms old.
        let (slows, stands) = figures("watchdog");
        assert!((170.0..260.0).contains(&slows) && stands < 600.0, "{said}");
        for name in ["stop by order", "dashboard stop"] {
            let (slows, stands) = figures(name);
            assert!(slows < 150.0 && stands < 600.0, "{said}");
        }
        true
    });
}

#[test]
fn cell_record_writes_every_frame_of_a_second() {
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
            // A controller that cuts corners wider than it was sent does not pass.
            let mut narrow = paths.clone();
            for segment in narrow.iter_mut().flat_map(|path| &mut path.segments) {
                let (Segment::Joint { blend, .. } | Segment::Linear { blend, .. }) = segment;
                *blend *= 0.3;
            }
            let (_, wide) = judge(arm, &narrow, &track).expect_err("corners wider than sent");
            assert!(matches!(wide, BlendFault::Off { .. }), "{name}, {seed}: {wide}");
            assert!(!pair.machine().supervisor().expect("a cell").mode().armed(), "{name}, {seed}");
            assert_eq!(pair.breaches(), [], "{name}, {seed}");
        }
    }
}
