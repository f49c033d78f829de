//! The recording of a run: the daemon's events into MCAP files.
//!
//! In: events as they happen. Out: the files, and at the end what went wrong with them, if anything did. A
//! recording that fails never stops a run, and never silently: the first fault is kept, and logged. All
//! writing and encoding is on a thread of its own: a slow disk must not keep the robot waiting for a message
//! from us.

use crate::config::cell::RecordingConfig;
use crate::daemon::messages::Displayed;
use crate::daemon::recordings_folder::RecordingsFolder;
use crate::daemon::shell::Scene;
use crate::io::recording::{PictureFormat, RecordedObject, Recording, Severity};
use cell_edge::clock::unix_now_s;
use cell_edge::priority;
use cell_values::image::Image;
use cell_values::time::{Duration, Timestamp};
use cell_values::units::Joints;
use cell_vision::observe::Observation;
use rearrange::document::chain::chain;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Instant;

/// How often joint states are recorded, in the cell's time.
const JOINTS_EVERY: Duration = Duration::from_millis(40);

/// Pictures that may wait for the encoder: 90 MB at most.
const WAITING_PICTURES: usize = 32;

/// Entries that may wait for the disk: minutes of joint states.
const WAITING_ENTRIES: usize = 4096;

/// How often the length of the file and the space on the disk are looked at.
const LOOK_EVERY: std::time::Duration = std::time::Duration::from_secs(5);

/// When a recording that failed is tried again.
const AGAIN_AFTER: std::time::Duration = std::time::Duration::from_secs(60);

/// How long the end of a run waits for what is left to be written.
const CLOSE_WITHIN: std::time::Duration = std::time::Duration::from_secs(10);

/// Something to be written, with its time.
enum Entry {
    Log(Severity, String),
    Picture(Image),
    Arrangement(Vec<RecordedObject>),
    Plan(Value),
    Joints(Joints, [f64; 6]),
}

/// The loop's end of a recording.
pub struct Recorder {
    entries: Option<SyncSender<(Timestamp, Entry)>>,
    ended: Receiver<Option<String>>,
    pictures: Option<Arc<AtomicUsize>>,
    last_joints: Timestamp,
    dropped: usize,
    fault: Option<String>,
}

/// New files in the recording folder, named by the time.
///
/// # Errors
/// A folder or file that cannot be made: the operator who requests a recording wants to know before, not
/// after. A disk without room is none: it is logged, and recorded again once there is room.
pub fn start(config: &RecordingConfig) -> Result<Recorder, String> {
    let folder = RecordingsFolder::open(config)?;
    let mut tape = Tape::new(Some(folder));
    tape.open_next();
    match tape.fault.take() {
        Some(fault) if tape.tries_again.is_none() => Err(format!("recording: {fault}")),
        fault => {
            tape.fault = fault;
            Ok(Recorder::of(tape, config.pictures))
        }
    }
}

impl Recorder {
    /// Creates the one file; `pictures`: also what the camera saw. A file that cannot be created is the
    /// first fault.
    pub fn create(path: &Path, pictures: bool) -> Recorder {
        let mut tape = Tape::new(None);
        tape.open(path.to_path_buf());
        Recorder::of(tape, pictures)
    }

    fn of(mut tape: Tape, pictures: bool) -> Recorder {
        let (entries, waiting) = sync_channel(WAITING_ENTRIES);
        let (ends, ended) = sync_channel(1);
        let count = pictures.then(Arc::<AtomicUsize>::default);
        let (taken, fault) = (count.clone(), tape.fault.clone());
        std::thread::spawn(move || {
            priority::lower();
            tape.run(&waiting, taken.as_deref());
            // There may be no reader any more.
            let _ = ends.send(tape.close());
        });
        let last_joints = Timestamp::ZERO;
        Recorder { entries: Some(entries), ended, pictures: count, last_joints, dropped: 0, fault }
    }

    /// What is wrong with the recording from the start.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// Takes one event in.
    pub fn on(&mut self, now: Timestamp, scene: &Scene) {
        match scene {
            Scene::Notice(notice) => {
                let severity = if notice.alarm { Severity::Warning } else { Severity::Info };
                self.put(now, Entry::Log(severity, notice.text.clone()));
            }
            Scene::Displayed(Displayed::Picture { image, .. } | Displayed::Sample { image, .. }) => {
                self.picture(now, image);
            }
            Scene::Displayed(Displayed::Observed { seen: observation, .. }) => {
                self.put(now, Entry::Arrangement(recorded(observation)));
            }
            Scene::Route(route) => {
                let steps: Vec<_> = route
                    .iter()
                    .map(|s| json!({"object": s.object, "from": s.from, "to": s.to, "goal": s.to_goal}))
                    .collect();
                self.put(now, Entry::Plan(json!({ "actions": steps })));
            }
            Scene::Robot(state) if now.since(self.last_joints) >= JOINTS_EVERY => {
                self.last_joints = now;
                self.put(now, Entry::Joints(state.q, state.qd));
            }
            Scene::Ended(report) => {
                let text = format!("job {} ended: {}: {}", report.id, report.code_text(), report.message);
                self.put(now, Entry::Log(Severity::Info, text));
            }
            Scene::Robot(_) | Scene::Status(_) | Scene::Vacuum(_) | Scene::Turn => {}
        }
    }

    /// Waits for what is still to be written, ends the file, and says what went wrong.
    pub fn close(&mut self) -> Option<String> {
        self.entries = None;
        let fault = match self.ended.recv_timeout(CLOSE_WITHIN) {
            Ok(fault) => fault,
            Err(_) => Some("the disk did not take the end of the recording".to_string()),
        };
        let dropped = (self.dropped > 0)
            .then(|| format!("{} entries came faster than they could be written", self.dropped));
        fault.or(dropped)
    }

    fn picture(&mut self, now: Timestamp, image: &Image) {
        let Some(waiting) = &self.pictures else { return };
        if waiting.load(Ordering::Relaxed) >= WAITING_PICTURES {
            self.dropped += 1;
        } else {
            waiting.fetch_add(1, Ordering::Relaxed);
            self.put(now, Entry::Picture(image.clone()));
        }
    }

    fn put(&mut self, now: Timestamp, entry: Entry) {
        let sent = self.entries.as_ref().is_some_and(|entries| entries.try_send((now, entry)).is_ok());
        self.dropped += usize::from(!sent);
    }
}

/// The writing end: one file at a time.
struct Tape {
    folder: Option<RecordingsFolder>,
    /// Calendar time of the run's beginning, for every file of it.
    epoch_unix_s: f64,
    file: Option<(PathBuf, Recording)>,
    looked: Instant,
    /// When a recording that failed is tried again.
    tries_again: Option<Instant>,
    /// The first fault.
    fault: Option<String>,
}

impl Tape {
    fn new(folder: Option<RecordingsFolder>) -> Tape {
        let (epoch_unix_s, looked) = (unix_now_s(), Instant::now());
        Tape { folder, epoch_unix_s, file: None, looked, tries_again: None, fault: None }
    }

    /// Until no more can come.
    fn run(&mut self, waiting: &Receiver<(Timestamp, Entry)>, pictures: Option<&AtomicUsize>) {
        loop {
            match waiting.recv_timeout(LOOK_EVERY) {
                Ok((now, entry)) => {
                    let is_picture = matches!(entry, Entry::Picture(_));
                    self.write(now, entry);
                    if let Some(pictures) = pictures.filter(|_| is_picture) {
                        pictures.fetch_sub(1, Ordering::Relaxed);
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if self.looked.elapsed() >= LOOK_EVERY {
                self.looked = Instant::now();
                self.look_at_the_disk();
            }
        }
    }

    /// Writes; the first failure ends the file.
    fn write(&mut self, now: Timestamp, entry: Entry) {
        let Some((_, recording)) = &mut self.file else { return };
        let written = match entry {
            Entry::Log(severity, text) => recording.log(now, severity, "cell", &text),
            Entry::Arrangement(objects) => recording.arrangement(now, "camera", &objects),
            Entry::Plan(plan) => recording.plan(now, &plan),
            Entry::Joints(q, qd) => recording.joints(now, &q, &qd),
            // A picture that cannot be encoded is a fault of this program, and no reason to end a recording.
            Entry::Picture(image) => match image.encode_png() {
                Ok(png) => recording.picture(now, PictureFormat::Png, &png),
                Err(_) => Ok(()),
            },
        };
        if let Err(error) = written {
            self.file = None;
            self.failed(chain(&error));
        }
    }

    /// A file that has become long is followed by the next one; where there is no room, there is none.
    fn look_at_the_disk(&mut self) {
        let Some(folder) = &self.folder else { return };
        match &self.file {
            Some((path, _)) => match folder.make_room(Some(path)) {
                Err(fault) => {
                    self.finish();
                    self.failed(fault);
                }
                Ok(()) if folder.is_full(path) => {
                    self.finish();
                    self.open_next();
                }
                Ok(()) => {}
            },
            None if self.tries_again.is_some_and(|at| Instant::now() >= at) => self.open_next(),
            None => {}
        }
        if self.file.is_none() && self.tries_again.is_none() {
            self.failed(self.fault.clone().unwrap_or_default());
        }
    }

    fn open_next(&mut self) {
        let Some(folder) = &self.folder else { return };
        match folder.make_room(None) {
            Ok(()) => {
                let path = folder.next(unix_now_s());
                self.open(path);
            }
            Err(fault) => self.failed(fault),
        }
    }

    fn open(&mut self, path: PathBuf) {
        match Recording::create(&path, self.epoch_unix_s) {
            Ok(recording) => {
                if self.tries_again.take().is_some() {
                    tracing::info!("recording again, into {}", path.display());
                }
                self.file = Some((path, recording));
            }
            Err(error) => {
                self.fault.get_or_insert_with(|| chain(&error));
            }
        }
    }

    fn finish(&mut self) {
        if let Some(Err(error)) = self.file.take().map(|(_, recording)| recording.finish()) {
            self.failed(chain(&error));
        }
    }

    fn failed(&mut self, fault: String) {
        if self.tries_again.replace(Instant::now() + AGAIN_AFTER).is_none() {
            tracing::warn!("nothing is recorded for now: {fault}");
        }
        self.fault.get_or_insert(fault);
    }

    fn close(&mut self) -> Option<String> {
        self.finish();
        self.fault.take()
    }
}

fn recorded(observation: &Observation) -> Vec<RecordedObject> {
    let object = |o: &cell_vision::observe::ObjectEstimate| RecordedObject {
        id: o.id.clone(),
        x: o.pose.x,
        y: o.pose.y,
        theta: o.pose.theta,
        std_xy_m: o.std_xy_m,
        std_theta_rad: o.std_theta_rad,
    };
    observation.objects.iter().map(object).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::supervisor::input::Notice;

    fn pictures_in(path: &Path) -> usize {
        let bytes = std::fs::read(path).unwrap();
        let messages = mcap::MessageStream::new(&bytes).unwrap();
        messages.filter(|message| message.as_ref().unwrap().channel.topic == "/camera/image").count()
    }

    #[test]
    fn the_last_pictures_are_in_the_file_even_when_it_is_closed_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut recorder = Recorder::create(&path, true);
        let image = Image::filled(64, 48, [10, 20, 30]);
        for k in 0..5 {
            let now = Timestamp::from_secs_f64(f64::from(k));
            let displayed = Displayed::Picture { image: image.clone(), views: Vec::new() };
            recorder.on(now, &Scene::Displayed(&displayed));
        }
        assert_eq!(recorder.close(), None);
        assert_eq!(pictures_in(&path), 5);
    }

    #[test]
    fn a_recording_that_cannot_be_made_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::create(&folder.path().join("missing/run.mcap"), false);
        let notice = Notice { alarm: true, text: "x".to_string() };
        recorder.on(Timestamp::ZERO, &Scene::Notice(&notice));
        assert!(recorder.close().is_some_and(|fault| fault.contains("run.mcap")));
    }

    fn config(folder: &Path, budget_bytes: u64, reserve_bytes: u64) -> RecordingConfig {
        RecordingConfig { folder: folder.to_path_buf(), pictures: false, budget_bytes, reserve_bytes }
    }

    #[test]
    fn a_long_file_is_followed_by_the_next_and_the_oldest_goes() {
        let folder = tempfile::tempdir().unwrap();
        let within = |budget| Some(RecordingsFolder::open(&config(folder.path(), budget, 0)).unwrap());
        let mut tape = Tape::new(within(1 << 30));
        tape.open_next();
        let first = tape.file.as_ref().expect("a file").0.clone();
        tape.write(Timestamp::ZERO, Entry::Log(Severity::Info, "x".repeat(1000)));
        tape.look_at_the_disk();
        assert_eq!(tape.file.as_ref().map(|(path, _)| path), Some(&first), "it is short");
        tape.finish();
        let length = std::fs::metadata(&first).unwrap().len();
        // More than an eighth of this budget.
        tape.folder = within(4 * length);
        tape.file = Some((first.clone(), Recording::create(&folder.path().join("other"), 0.0).unwrap()));
        tape.look_at_the_disk();
        let second = tape.file.as_ref().expect("the next file").0.clone();
        assert!(first != second && first.exists());
        tape.folder = within(length / 2);
        tape.look_at_the_disk();
        assert!(!first.exists(), "the oldest goes");
        assert_eq!(tape.close(), None);
    }

    #[test]
    fn without_room_nothing_is_recorded_and_that_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = start(&config(folder.path(), 1 << 30, u64::MAX)).unwrap();
        let notice = Notice { alarm: true, text: "x".to_string() };
        recorder.on(Timestamp::ZERO, &Scene::Notice(&notice));
        let fault = recorder.close().expect("a fault");
        assert!(fault.contains("MB are left on the disk"), "{fault}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
