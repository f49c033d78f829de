//! Recordings on disk: what is in them, when files follow each other, what happens without room.

use super::*;
use crate::config::load::load_cell;
use crate::config::sessions::machine_parameters;
use crate::config::setup::{cell_objects, nominal_model};
use crate::daemon::carried::tests::estimate;
use crate::io::recording::read::{Entry as Read, Item, Items};
use cell_machine::event::Arm;
use cell_machine::machine::Machine;
use cell_machine::orders::Reply;
use cell_machine::supervisor::input::Notice;
use cell_machine::supervisor::model::CellModel;
use cell_motion::bodies::Load;
use cell_motion::put_down::Grasp;
use cell_replay::Replay;
use cell_values::units::Joints;
use cell_vision::observe::Observation;
use foxglove::messages::SceneEntity;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use std::f64::consts::FRAC_PI_2;
use std::fs::File;
use std::path::PathBuf;
use ur_arm::kinematics::DhParameters;

/// Waits for a condition of the writing thread.
fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let began = std::time::Instant::now();
    while !holds() {
        assert!(began.elapsed().as_secs() < 60, "{what}");
        std::thread::yield_now();
    }
}

fn machine() -> Machine {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml");
    Machine::new(machine_parameters(&load_cell(&config).unwrap(), 7)).unwrap()
}

fn messages(path: &Path) -> Vec<Read> {
    let items = Items::new(File::open(path).unwrap()).map(|item| item.unwrap());
    items.filter_map(|item| if let Item::Message(entry) = item { Some(entry) } else { None }).collect()
}

fn on(path: &Path, topic: &str) -> usize {
    messages(path).iter().filter(|entry| entry.channel.topic == topic).count()
}

fn at(seconds: f64) -> Timestamp {
    Timestamp::from_secs_f64(seconds)
}

/// One turn of the loop, as the shell does it.
fn turn(recorder: &mut Recorder, machine: &mut Machine, now: Timestamp) {
    recorder.on(now, &Scene::Event(&Event::Time));
    machine.handle(now, Event::Time);
    while let Some(effect) = machine.poll() {
        recorder.on(now, &Scene::Effect(&effect));
    }
    recorder.on(now, &Scene::Machine(machine));
}

#[test]
fn the_last_pictures_are_in_the_file_even_when_it_is_closed_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut recorder = Recorder::create(&path, RecordedPictures::Lossless, None);
    let mut machine = machine();
    turn(&mut recorder, &mut machine, at(0.0));
    let image = Image::filled(64, 48, [10, 20, 30]);
    for k in 0..5 {
        let displayed = Displayed::Picture { image: image.clone(), views: Vec::new() };
        recorder.on(at(f64::from(k)), &Scene::Displayed(&displayed));
    }
    assert_eq!(recorder.close(), None);
    assert_eq!(on(&path, "/camera/image"), 5);
}

#[test]
fn a_run_in_a_file_is_decided_the_same_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut recorder = Recorder::create(&path, RecordedPictures::Off, None);
    let mut machine = machine();
    for k in 0..400 {
        turn(&mut recorder, &mut machine, at(f64::from(k) * 0.05));
    }
    assert_eq!(recorder.close(), None);
    let mut replay = Replay::default();
    for entry in messages(&path) {
        if let Some(kind) = piece_of(&entry.channel.topic) {
            assert_eq!(replay.take(kind, &entry.piece()).unwrap(), None);
        }
    }
    let so_far = replay.so_far();
    assert_eq!((so_far.events, so_far.gaps), (399, 0), "the first turn comes before the first machine");
    assert!(so_far.decisions > 3, "connections are wanted: {so_far:?}");
}

#[test]
fn a_recording_that_cannot_be_made_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing/run.mcap");
    let mut recorder = Recorder::create(&missing, RecordedPictures::Off, None);
    turn(&mut recorder, &mut machine(), at(0.0));
    assert!(recorder.close().is_some_and(|fault| fault.contains("run.mcap")));
}

fn config(folder: &Path, budget_bytes: u64, reserve_bytes: u64) -> RecordingConfig {
    let (pictures, decisions) = (RecordedPictures::Off, true);
    RecordingConfig { folder: folder.to_path_buf(), pictures, decisions, budget_bytes, reserve_bytes }
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

fn named(folder: &Path, start: &str) -> usize {
    let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
    files(folder).iter().filter(|path| name(path).starts_with(start)).count()
}

#[test]
fn a_job_s_progress_and_refused_orders_are_lines_of_the_log() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut recorder = Recorder::create(&path, RecordedPictures::Off, None);
    turn(&mut recorder, &mut machine(), at(0.0));
    let approved = Effect::Commit { number: 1, record: Record::Approved };
    let refused = Effect::Reply { number: 2, reply: Reply::refuse("no") };
    for effect in [approved, refused, Effect::WantJob] {
        recorder.on(at(0.1), &Scene::Effect(&effect));
    }
    assert_eq!(recorder.close(), None);
    assert_eq!(on(&path, "/log"), 2);
}

/// A job has a file of its own, and of the time without one only the last files stay.
#[test]
fn each_job_has_its_file_and_the_time_without_one_a_ring() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = start(&config(folder.path(), 1 << 30, 0), None).unwrap();
    let (mut machine, mut now) = (machine(), 0.0);
    let mut pass = |recorder: &mut Recorder, job: Option<&str>, seconds: f64| {
        let status = Status { job: job.map(str::to_string), ..Status::idle() };
        recorder.on(at(now), &Scene::Status(&status));
        turn(recorder, &mut machine, at(now));
        now += seconds;
    };
    for _ in 0..6 {
        pass(&mut recorder, None, 301.0);
    }
    pass(&mut recorder, Some("tidy-1"), 1.0);
    pass(&mut recorder, Some("tidy-1"), 1000.0);
    pass(&mut recorder, Some("tidy-2"), 1.0);
    pass(&mut recorder, None, 1.0);
    assert_eq!(recorder.close(), None);
    let count = |start: &str| named(folder.path(), start);
    assert_eq!((count("job-tidy-1-"), count("job-tidy-2-")), (1, 1), "{:?}", files(folder.path()));
    assert_eq!(
        count("idle-"),
        2 + 1,
        "the one before, its last, and the new one: {:?}",
        files(folder.path())
    );
    for path in files(folder.path()) {
        assert_eq!(on(&path, "/replay/machine"), 1, "{}", path.display());
    }
}

/// What a stop ends is not over before the arm rests; an arm that is not known to rest keeps no file open.
#[test]
fn the_file_of_a_job_ends_once_the_arm_rests() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = start(&config(folder.path(), 1 << 30, 0), None).unwrap();
    let (mut machine, shared) = (machine(), Arc::clone(&recorder.shared));
    let mut pass = |now: f64, job: Option<&str>, moving: bool| {
        let status = Status { job: job.map(str::to_string), moving, ..Status::idle() };
        recorder.on(at(now), &Scene::Status(&status));
        turn(&mut recorder, &mut machine, at(now));
        recorder.open.as_ref().map(|(segment, _)| segment.clone())
    };
    let job = |id: &str| Some(Segment::Job(id.to_string()));
    assert_eq!(pass(0.0, Some("a"), true), job("a"));
    assert_eq!(pass(1.0, None, true), job("a"), "it brakes");
    shared.wants_file.store(true, Ordering::Relaxed);
    assert_eq!(pass(1.5, None, true), job("a"), "in the next file, where one is due");
    assert_eq!(pass(2.0, None, false), Some(Segment::Idle));
    assert_eq!(pass(3.0, None, true), Some(Segment::Idle), "another motion is no part of it");
    assert_eq!(pass(4.0, Some("b"), true), job("b"));
    assert_eq!(pass(5.0, None, true), job("b"));
    assert_eq!(pass(6.0, Some("c"), true), job("c"), "the next job has its own");
    assert_eq!(pass(7.0, None, true), job("c"));
    assert_eq!(pass(38.0, None, true), Some(Segment::Idle), "whether it rests or not");
}

#[test]
fn a_long_file_is_followed_by_the_next_and_the_oldest_goes() {
    let folder = tempfile::tempdir().unwrap();
    let within = |budget| Some(RecordingsFolder::open(&config(folder.path(), budget, 0)).unwrap());
    let mut tape = Tape::new(within(1 << 30), RecordedPictures::Off, Drawing::default());
    tape.open_next(&Segment::Idle);
    let first = tape.file.as_ref().expect("a file").0.clone();
    tape.take(Timestamp::ZERO, Entry::Log(Level::Info, "x".repeat(1000)));
    tape.look_at_the_disk();
    assert!(!tape.shared.wants_file.load(Ordering::Relaxed), "it is short");
    tape.folder = within(8);
    tape.look_at_the_disk();
    assert!(tape.shared.wants_file.load(Ordering::Relaxed), "it has more than an eighth of this budget");
    tape.open_next(&Segment::Job("a".to_string()));
    let second = tape.file.as_ref().expect("the next file").0.clone();
    assert!(first != second && !first.exists(), "the oldest goes");
    assert_eq!(tape.close(), None);
}

#[test]
fn without_room_nothing_is_recorded_and_that_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = start(&config(folder.path(), 1 << 30, u64::MAX), None).unwrap();
    turn(&mut recorder, &mut machine(), at(0.0));
    recorder.on(at(0.1), &Scene::Notice(&Notice { alarm: true, text: "x".to_string() }));
    let fault = recorder.close().expect("a fault");
    assert!(fault.contains("MB are left on the disk"), "{fault}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// What a killed daemon left has an end again after the next start.
#[test]
fn a_broken_recording_is_made_whole_at_the_next_start() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = start(&config(folder.path(), 1 << 30, 0), None).unwrap();
    let mut machine = machine();
    for k in 0..100 {
        turn(&mut recorder, &mut machine, at(f64::from(k) * 0.05));
    }
    assert_eq!(recorder.close(), None);
    let path = files(folder.path()).remove(0);
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() - 9]).unwrap();
    let mut next = start(&config(folder.path(), 1 << 30, 0), None).unwrap();
    until("repaired", || crate::io::recording::repair::is_whole(&path).unwrap());
    assert_eq!(next.close(), None);
    assert_eq!(
        mcap::Summary::read(&std::fs::read(&path).unwrap()).unwrap().unwrap().stats.unwrap().message_count
            as usize,
        messages(&path).len()
    );
}

/// A cell as it is drawn, with the arm's tool straight down over the table.
fn drawn_cell() -> Drawing {
    let config = load_cell(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml")).unwrap();
    let arm = Arm {
        dh: DhParameters::UR5E,
        checksum: String::new(),
        serial: String::new(),
        software: String::new(),
    };
    let lens = CameraModel {
        serial: String::new(),
        fx: 640.0,
        fy: 640.0,
        cx: 640.0,
        cy: 360.0,
        width: 1280,
        height: 720,
        distortion: [0.0; 5],
    };
    let model = nominal_model(&config, &arm, &lens);
    let mut drawing = Drawing::new(Some(lens));
    drawing.cell(Box::new(CellModel { objects: cell_objects(&config).unwrap(), ..model }));
    drawing.joints(&Joints([0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, -FRAC_PI_2, 0.0]));
    drawing
}

/// A viewer that goes to another time has the last message of a topic and nothing before it.
#[test]
fn every_message_of_the_objects_has_all_of_them_where_they_are() {
    let mut drawing = drawn_cell();
    let mut now_drawn = move |change: &dyn Fn(&mut Drawing)| {
        change(&mut drawing);
        let scene = drawing.objects(foxglove::messages::Timestamp::default());
        let named = |id: &str| id.strip_prefix("object/").map(str::to_string);
        let drawn = scene.entities.iter().filter_map(|one| Some((named(&one.id)?, one.frame_id.clone())));
        let gone: Vec<_> = scene.deletions.iter().filter_map(|one| named(&one.id)).collect();
        (drawn.collect::<Vec<_>>(), gone)
    };
    let on = |frame: &str, id: &str| (id.to_string(), frame.to_string());
    let look = |ids: &[&str]| Observation {
        objects: ids.iter().map(|id| estimate(id, 0.1)).collect(),
        ..Observation::default()
    };
    let both = (vec![on("table", "lid"), on("table", "plank-1")], vec![]);
    assert_eq!(now_drawn(&|drawing| drawing.observed(&look(&["lid", "plank-1"]), false)), both);
    let part = now_drawn(&|drawing| drawing.observed(&look(&["plank-1"]), true));
    assert_eq!(part, both, "a look at a part of the table");
    let footprint = Footprint::disc(0.04).unwrap();
    let load = Load { name: "lid".into(), footprint, tool_from_object: Pose2::default(), height: 0.02 };
    let grasp = Grasp::remembered(load, 1.0);
    let held = now_drawn(&|drawing| assert!(drawing.hangs(Some(("lid", Some(&grasp))))));
    assert_eq!(held, (vec![on("flange", "lid"), on("table", "plank-1")], vec![]));
    let fell = now_drawn(&|drawing| assert!(drawing.hangs(None)));
    assert_eq!(fell, (vec![on("table", "plank-1")], vec!["lid".to_string()]), "let go high over the table");
    let whole = now_drawn(&|drawing| drawing.observed(&look(&["lid"]), false));
    assert_eq!(whole, (vec![on("table", "lid")], vec!["plank-1".to_string()]));
}

#[test]
fn every_body_of_the_cell_is_drawn_as_a_solid() {
    let scene = drawn_cell().surroundings(foxglove::messages::Timestamp::default()).unwrap();
    let solid = |one: &SceneEntity| {
        one.cubes.len() + one.cylinders.len() + one.triangles.iter().filter(|t| t.points.len() >= 12).count()
    };
    assert!(scene.entities.len() > 8, "table, arm, tool, stand");
    for entity in &scene.entities {
        assert_eq!(solid(entity), 1, "{}", entity.id);
    }
}
