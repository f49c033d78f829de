//! Recordings on disk: what is in them, when files follow each other, what happens without room.

use super::*;
use crate::config::load::load_cell;
use crate::config::sessions::machine_parameters;
use crate::io::recording::read::{Entry as Read, Item, Items};
use cell_machine::machine::Machine;
use cell_machine::supervisor::input::Notice;
use cell_replay::Replay;
use std::fs::File;
use std::path::PathBuf;

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
            assert_eq!(replay.take(kind, &entry.data).unwrap(), None);
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
