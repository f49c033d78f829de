//! The writing end of a recording: one file at a time, on a thread of its own.
//!
//! In: entries with their times. Out: files in the recording folder, within its budget; the first fault. A
//! chunk ends at least every second, so that a process that is killed leaves a file that reads up to there.

use crate::config::cell::RecordedPictures;
use crate::daemon::recorder::drawing::{Drawing, joint_states};
use crate::daemon::recordings_folder::{RecordingsFolder, Segment};
use crate::io::recording::{JsonTopic, Recording, RecordingError};
use cell_edge::clock::unix_now_s;
use cell_machine::event::{Effect, Event};
use cell_machine::supervisor::model::CellModel;
use cell_machine::supervisor::order::RouteAction;
use cell_motion::put_down::Grasp;
use cell_replay::{Kind, Piece};
use cell_values::image::Image;
use cell_values::time::Timestamp;
use cell_values::units::Joints;
use cell_vision::observe::Observation;
use foxglove::messages::log::Level;
use foxglove::messages::{CompressedImage, Log, Timestamp as Stamp};
use nalgebra::Isometry3;
use rearrange::document::chain::chain;
use rearrange::geometry::pose::Pose2;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// How often the length of the file and the space on the disk are looked at.
const LOOK_EVERY: Duration = Duration::from_secs(5);

/// How often a chunk ends.
const FLUSH_EVERY: Duration = Duration::from_millis(500);

/// When a recording that failed is tried again.
const AGAIN_AFTER: Duration = Duration::from_secs(60);

/// Of JPEG: artefacts are not seen, a picture of 1280 x 720 takes about 100 KB.
const JPEG_QUALITY: u8 = 80;

const ROBOT: JsonTopic =
    JsonTopic { name: "/robot/state", schema: "celld.Robot", properties: robot_properties };
const VACUUM: JsonTopic =
    JsonTopic { name: "/gripper/vacuum", schema: "celld.Vacuum", properties: vacuum_properties };
const STATUS: JsonTopic =
    JsonTopic { name: "/cell/status", schema: "celld.Status", properties: status_properties };
const PLAN: JsonTopic = JsonTopic { name: "/plan", schema: "celld.Plan", properties: plan_properties };

fn text() -> Value {
    json!({"type": "string"})
}

fn robot_properties() -> Value {
    json!({"robot_mode": text(), "safety_mode": text(), "program": text(), "payload_kg": {"type": "number"}})
}

fn vacuum_properties() -> Value {
    json!({"a": {"type": "number"}, "b": {"type": "number"}})
}

fn status_properties() -> Value {
    json!({"text": text(), "armed": {"type": "boolean"}, "job": text(), "moves": {"type": "integer"},
        "held": text()})
}

fn plan_properties() -> Value {
    let pose = || json!({"type": "array", "items": {"type": "number"}});
    let action = json!({"object": text(), "from": pose(), "to": pose(), "goal": {"type": "boolean"}});
    let action = json!({"type": "object", "title": "celld.Action", "properties": action});
    let actions = json!({"actions": {"type": "array", "items": action}});
    json!({"plan": {"type": "object", "title": "celld.Actions", "properties": actions}})
}

/// Where a replay's pieces of a kind are in a recording.
pub fn topic_of(kind: Kind) -> &'static str {
    match kind {
        Kind::Machine => "/replay/machine",
        Kind::Event => "/replay/event",
        Kind::Effect => "/replay/effect",
    }
}

/// The kind of piece on a topic; `None` for what is there for people.
pub fn piece_of(topic: &str) -> Option<Kind> {
    [Kind::Machine, Kind::Event, Kind::Effect].into_iter().find(|kind| topic_of(*kind) == topic)
}

/// A topic for each part of the scene, and each message of it complete: a viewer that goes to another time
/// has the last message of every topic and nothing before.
const CELL: &str = "/scene/cell";
const OBJECTS: &str = "/scene/objects";
const GOALS: &str = "/scene/goals";
const ROUTE: &str = "/scene/plan";

/// The same for frames: those that stay, the arm's, and where the last picture was taken.
const FIXED_FRAMES: &str = "/tf_static";
const FRAMES: &str = "/tf";
const PICTURE_FRAME: &str = "/tf_picture";

/// What hangs on the gripper, and how as far as that is known.
pub(super) type Hanging = Option<(String, Option<Grasp>)>;

/// What the machine took in or gave out.
pub(super) enum Moment {
    Event(Box<Event>),
    Effect(Box<Effect>),
}

/// Something to be written.
pub(super) enum Entry {
    /// A new file, with what it is of and the machine from which a replay begins.
    Open {
        segment: Segment,
        /// By the calendar: where a slow disk has this wait, the file is of then all the same.
        unix_s: f64,
        cell: Option<Box<CellModel>>,
        machine: Option<Piece>,
    },
    /// After a gap, the machine again.
    Stitch(Piece),
    Moments(Vec<(Timestamp, Moment)>),
    Log(Level, String),
    /// With it, where the camera was; `None`: where it is now.
    Picture(Image, Option<Isometry3<f64>>),
    /// What a look shows, and whether it was of a part of the table.
    Seen(Box<Observation>, bool),
    Hanging(Box<Hanging>),
    Goals(Vec<(String, Pose2)>),
    Route(Vec<RouteAction>),
    Joints(Joints, [f64; 6]),
    Robot(Value),
    Vacuum([f64; 2]),
    Status(Value),
}

/// What both ends of a recording share.
#[derive(Default)]
pub(super) struct Shared {
    /// Pictures that wait for the encoder.
    pub pictures: AtomicUsize,
    /// A file is wanted: the last one is long enough, or could not be written.
    pub wants_file: AtomicBool,
}

/// The writing end.
pub(super) struct Tape {
    pub folder: Option<RecordingsFolder>,
    /// The one file, where there is no folder.
    pub single: Option<PathBuf>,
    pub pictures: RecordedPictures,
    pub drawing: Drawing,
    /// Calendar time of the cell's time 0, as at the beginning of the present file.
    epoch_unix_s: f64,
    pub file: Option<(PathBuf, Recording)>,
    looked: Instant,
    flushed: Instant,
    /// When a recording that failed is tried again.
    pub tries_again: Option<Instant>,
    /// The first fault.
    pub fault: Option<String>,
    pub shared: Arc<Shared>,
}

impl Tape {
    pub fn new(folder: Option<RecordingsFolder>, pictures: RecordedPictures, drawing: Drawing) -> Tape {
        let now = Instant::now();
        Tape {
            folder,
            single: None,
            pictures,
            drawing,
            epoch_unix_s: unix_now_s(),
            file: None,
            looked: now,
            flushed: now,
            tries_again: None,
            fault: None,
            shared: Arc::default(),
        }
    }

    /// Until no more can come.
    pub fn run(&mut self, waiting: &Receiver<(Timestamp, Entry)>) {
        loop {
            match waiting.recv_timeout(FLUSH_EVERY) {
                Ok((now, entry)) => self.take(now, entry),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if self.flushed.elapsed() >= FLUSH_EVERY {
                self.flushed = Instant::now();
                let flushed = self.file.as_mut().map_or(Ok(()), |(_, recording)| recording.flush());
                self.written(flushed);
            }
            if self.looked.elapsed() >= LOOK_EVERY {
                self.looked = Instant::now();
                self.look_at_the_disk();
            }
        }
    }

    pub fn take(&mut self, now: Timestamp, entry: Entry) {
        let is_picture = matches!(entry, Entry::Picture(..));
        match entry {
            Entry::Open { segment, unix_s, cell, machine } => {
                if let Some(cell) = cell {
                    self.drawing.cell(cell);
                }
                // Anew for every file: the cell's time may run faster than the calendar's, or that be set.
                self.epoch_unix_s = unix_s - now.as_secs_f64();
                self.open_next(&segment);
                let begun = self.beginning(now, machine.as_ref());
                self.written(begun);
            }
            // What is drawn is kept although nothing can be written.
            Entry::Goals(goals) => {
                self.drawing.goals(goals);
                self.with_file(|recording, drawing| {
                    recording.message(GOALS, now, &drawing.goal_lines(stamp(recording, now)))
                });
            }
            Entry::Route(route) => {
                let plan = json!({ "plan": {"actions": steps(&route)} });
                self.drawing.route(route);
                self.with_file(|recording, drawing| {
                    recording.message(ROUTE, now, &drawing.route_arrows(stamp(recording, now)))?;
                    recording.json(&PLAN, now, plan)
                });
            }
            Entry::Seen(seen, partial) => {
                self.drawing.observed(&seen, partial);
                self.draw_objects(now);
            }
            Entry::Hanging(hanging) => {
                let known = hanging.as_ref().as_ref().map(|(id, grasp)| (id.as_str(), grasp.as_ref()));
                if self.drawing.hangs(known) {
                    self.draw_objects(now);
                }
            }
            entry => {
                if let Entry::Joints(q, _) = &entry {
                    self.drawing.joints(q);
                }
                let pictures = self.pictures;
                self.with_file(|recording, drawing| plain(recording, drawing, pictures, now, entry));
            }
        }
        if is_picture {
            self.shared.pictures.fetch_sub(1, Ordering::Relaxed);
        }
    }

    /// The objects as far as is known; what is gone is deleted.
    fn draw_objects(&mut self, now: Timestamp) {
        let Some((_, recording)) = &mut self.file else { return };
        let scene = self.drawing.objects(stamp(recording, now));
        let written = recording.message(OBJECTS, now, &scene);
        self.written(written);
    }

    /// Everything that a viewer needs although it was said before this file began.
    fn beginning(&mut self, now: Timestamp, machine: Option<&Piece>) -> Result<(), RecordingError> {
        let Some((_, recording)) = &mut self.file else { return Ok(()) };
        let time = stamp(recording, now);
        if let Some(lens) = self.drawing.calibration(time) {
            recording.message("/camera/calibration", now, &lens)?;
        }
        if let Some(frames) = self.drawing.fixed_frames(time) {
            recording.message(FIXED_FRAMES, now, &frames)?;
        }
        if let Some(around) = self.drawing.surroundings(time) {
            recording.message(CELL, now, &around)?;
        }
        recording.message(OBJECTS, now, &self.drawing.objects(time))?;
        recording.message(GOALS, now, &self.drawing.goal_lines(time))?;
        recording.message(ROUTE, now, &self.drawing.route_arrows(time))?;
        machine.map_or(Ok(()), |piece| recording.piece(topic_of(piece.kind), piece.at, &piece.bytes))
    }

    fn with_file(&mut self, write: impl FnOnce(&mut Recording, &Drawing) -> Result<(), RecordingError>) {
        let Some((_, recording)) = &mut self.file else { return };
        let written = write(recording, &self.drawing);
        self.written(written);
    }

    /// The first failure ends the file.
    fn written(&mut self, written: Result<(), RecordingError>) {
        if let Err(error) = written {
            self.file = None;
            self.failed(chain(&error));
        }
    }

    /// A file that has become long is followed by the next one; where there is no room, there is none.
    pub fn look_at_the_disk(&mut self) {
        let Some(folder) = &self.folder else { return };
        match &self.file {
            Some((path, _)) => match folder.make_room(Some(path)) {
                Err(fault) => {
                    self.finish();
                    self.failed(fault);
                }
                Ok(()) if folder.is_full(path) => self.shared.wants_file.store(true, Ordering::Relaxed),
                Ok(()) => {}
            },
            None if self.tries_again.is_some_and(|at| Instant::now() >= at) => {
                self.shared.wants_file.store(true, Ordering::Relaxed);
            }
            None => {}
        }
    }

    pub fn open_next(&mut self, segment: &Segment) {
        self.finish();
        if let Some(path) = self.single.clone() {
            return self.open(path);
        }
        let Some(folder) = &self.folder else { return };
        match folder.make_room(None) {
            Ok(()) => {
                let path = folder.next(segment, unix_now_s());
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
            Err(error) => self.failed(chain(&error)),
        }
    }

    pub fn finish(&mut self) {
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

    pub fn close(&mut self) -> Option<String> {
        self.finish();
        self.fault.take()
    }
}

/// An entry that nothing later in the file depends on.
fn plain(
    recording: &mut Recording,
    drawing: &Drawing,
    pictures: RecordedPictures,
    now: Timestamp,
    entry: Entry,
) -> Result<(), RecordingError> {
    let time = stamp(recording, now);
    match entry {
        Entry::Stitch(piece) => recording.piece(topic_of(piece.kind), piece.at, &piece.bytes),
        Entry::Moments(moments) => moments.into_iter().try_for_each(|(at, moment)| {
            let piece = match moment {
                Moment::Event(event) => Piece::event(at, &event),
                Moment::Effect(effect) => Piece::effect(at, &effect),
            };
            // What cannot be encoded is a fault of this program, and no reason to end a recording: the
            // replay names the place.
            piece.map_or(Ok(()), |piece| recording.piece(topic_of(piece.kind), at, &piece.bytes))
        }),
        Entry::Log(level, message) => {
            let (name, level) = ("cell".to_string(), level as i32);
            let log = Log { timestamp: Some(time), level, message, name, ..Log::default() };
            recording.message("/log", now, &log)
        }
        Entry::Picture(image, table_from_camera) => {
            let (format, encoded) = match pictures {
                RecordedPictures::Off => return Ok(()),
                RecordedPictures::Jpeg => ("jpeg", image.encode_jpeg(JPEG_QUALITY)),
                RecordedPictures::Lossless => ("png", image.encode_png()),
            };
            // As for pieces.
            let Ok(data) = encoded else { return Ok(()) };
            if let Some(frame) = drawing.picture_frame(time, table_from_camera) {
                recording.message(PICTURE_FRAME, now, &frame)?;
            }
            let (frame_id, format) = ("picture".to_string(), format.to_string());
            let data = data.into();
            recording.message(
                "/camera/image",
                now,
                &CompressedImage { timestamp: Some(time), frame_id, data, format },
            )
        }
        Entry::Joints(q, qd) => {
            recording.message("/robot/joint_states", now, &joint_states(time, &q, &qd))?;
            let frames = drawing.moving_frames(time, &q);
            frames.map_or(Ok(()), |frames| recording.message(FRAMES, now, &frames))
        }
        Entry::Robot(state) => recording.json(&ROBOT, now, state),
        Entry::Vacuum([a, b]) => recording.json(&VACUUM, now, json!({"a": a, "b": b})),
        Entry::Status(status) => recording.json(&STATUS, now, status),
        Entry::Open { .. } | Entry::Goals(_) | Entry::Route(_) | Entry::Seen(..) | Entry::Hanging(_) => {
            Ok(())
        }
    }
}

fn stamp(recording: &Recording, now: Timestamp) -> Stamp {
    let unix = recording.log_time(now);
    let (seconds, nanos) = (unix / 1_000_000_000, unix % 1_000_000_000);
    Stamp::new(u32::try_from(seconds).unwrap_or(u32::MAX), u32::try_from(nanos).unwrap_or(0))
}

fn steps(route: &[RouteAction]) -> Vec<Value> {
    let step = |s: &RouteAction| json!({"object": s.object, "from": s.from, "to": s.to, "goal": s.to_goal});
    route.iter().map(step).collect()
}
