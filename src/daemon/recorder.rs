//! The recording of a run: the daemon's events into MCAP files, one a job, and the last minutes without one.
//!
//! In: everything that the loop takes in, decides and shows. Out: the files, each of which begins with the
//! whole cell, so that it opens and replays by itself; at the end what went wrong with them, if anything
//! did. A recording that fails never stops a run, and never silently: the first fault is kept, and logged.
//! All writing and encoding is on a thread of its own (`tape`): a slow disk must not keep the robot waiting
//! for a message from us.

mod drawing;
mod said;
mod tape;

pub use said::Said;
pub use tape::{piece_of, topic_of};

use crate::config::cell::{RecordedPictures, RecordingConfig};
use crate::daemon::messages::Displayed;
use crate::daemon::recordings_folder::{RecordingsFolder, Segment};
use crate::daemon::shell::Scene;
use cell_edge::clock::unix_now_s;
use cell_edge::priority;
use cell_machine::device::robot_types::RobotState;
use cell_machine::event::{Effect, Event};
use cell_machine::machine::Machine;
use cell_machine::supervisor::input::Record;
use cell_machine::supervisor::status::Status;
use cell_replay::Piece;
use cell_values::image::Image;
use cell_values::time::{Duration, Timestamp};
use cell_vision::camera::CameraModel;
use drawing::Drawing;
use foxglove::messages::log::Level;
use nalgebra::Isometry3;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use tape::{Entry, Hanging, Moment, Shared, Tape};

/// How often joint states and the vacuum are recorded, in the cell's time.
const JOINTS_EVERY: Duration = Duration::from_millis(40);
const VACUUM_EVERY: Duration = Duration::from_millis(100);

/// Pictures that may wait for the encoder: 90 MB at most.
const WAITING_PICTURES: usize = 32;

/// Entries that may wait for the disk: seconds of turns of the loop.
const WAITING_ENTRIES: usize = 4096;

/// How long a file without a job becomes, in the cell's time; the one before it is kept too.
const IDLE_FILE: Duration = Duration::from_secs(300);

/// How long a job's file goes on after the job where the arm is not known to be at rest, in the cell's time.
const REST_WITHIN: Duration = Duration::from_secs(30);

/// At the end of a run celld waits at most this long for the recording, after the journal. The next start
/// repairs a recording that was cut off.
const CLOSE_WITHIN: std::time::Duration = std::time::Duration::from_secs(3);

/// The loop's end of a recording.
pub struct Recorder {
    entries: Option<SyncSender<(Timestamp, Entry)>>,
    ended: Receiver<Option<String>>,
    shared: Arc<Shared>,
    pictures: RecordedPictures,
    /// Events and effects too.
    decisions: bool,
    /// One file for everything.
    single: bool,
    /// Of the last status.
    job: Option<String>,
    moving: bool,
    /// When the file of the last job ends, whether the arm rests or not.
    rests_by: Timestamp,
    /// What the present file is of, and when it began; `None` before the first.
    open: Option<(Segment, Timestamp)>,
    moments: Vec<(Timestamp, Moment)>,
    said: Said,
    /// Something was lost since the last turn: what follows needs the machine anew.
    gap: bool,
    /// What hangs on the gripper, and how.
    hanging: Hanging,
    last_joints: Timestamp,
    last_vacuum: Timestamp,
    last_robot: Option<Value>,
    dropped: usize,
    fault: Option<String>,
}

/// New files in the recording folder, named by job and time. Files that an earlier celld could not finish
/// are made whole beside it.
///
/// # Errors
/// A folder that cannot be made: the operator who requests a recording wants to know before, not after. A
/// disk without room is none: it is logged, and recorded again once there is room.
pub fn start(config: &RecordingConfig, lens: Option<CameraModel>) -> Result<Recorder, String> {
    let folder = RecordingsFolder::open(config)?;
    folder.repair_in_the_background();
    let tape = Tape::new(Some(folder), config.pictures, Drawing::new(lens));
    Ok(Recorder::of(tape, config.decisions))
}

impl Recorder {
    /// The one file, with pictures and decisions, by this lens; its first fault comes with
    /// [`Recorder::close`].
    pub fn create(path: &Path, pictures: RecordedPictures, lens: Option<CameraModel>) -> Recorder {
        let mut tape = Tape::new(None, pictures, Drawing::new(lens));
        tape.single = Some(path.to_path_buf());
        Recorder { single: true, ..Recorder::of(tape, true) }
    }

    fn of(mut tape: Tape, decisions: bool) -> Recorder {
        let (entries, waiting) = sync_channel(WAITING_ENTRIES);
        let (ends, ended) = sync_channel(1);
        let (shared, pictures, fault) = (Arc::clone(&tape.shared), tape.pictures, tape.fault.clone());
        std::thread::spawn(move || {
            priority::lower();
            tape.run(&waiting);
            // There may be no reader any more.
            let _ = ends.send(tape.close());
        });
        Recorder {
            entries: Some(entries),
            ended,
            shared,
            pictures,
            decisions,
            single: false,
            job: None,
            moving: false,
            rests_by: Timestamp::ZERO,
            open: None,
            moments: Vec::new(),
            said: Said::default(),
            gap: false,
            hanging: None,
            last_joints: Timestamp::ZERO,
            last_vacuum: Timestamp::ZERO,
            last_robot: None,
            dropped: 0,
            fault,
        }
    }

    /// What is wrong with the recording from the start.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// Takes one event in.
    pub fn on(&mut self, now: Timestamp, scene: &Scene) {
        match scene {
            Scene::Event(event) => self.event(now, event),
            Scene::Effect(effect) => self.effect(now, effect),
            Scene::Machine(machine) => self.turn(now, machine),
            Scene::Notice(notice) => {
                let level = if notice.alarm { Level::Warning } else { Level::Info };
                self.put(now, Entry::Log(level, notice.text.clone()));
            }
            Scene::Displayed(Displayed::Picture { image, views }) => {
                self.picture(now, image, views.last().map(|view| view.table_from_camera));
            }
            Scene::Displayed(Displayed::Sample { image, .. }) => self.picture(now, image, None),
            Scene::Displayed(Displayed::Observed { seen, partial }) => {
                self.put(now, Entry::Seen(seen.clone(), *partial));
            }
            Scene::Route(route) => self.put(now, Entry::Route(route.to_vec())),
            Scene::Robot(state) => self.robot(now, state),
            Scene::Vacuum(vacuum) if now.since(self.last_vacuum) >= VACUUM_EVERY => {
                self.last_vacuum = now;
                self.put(now, Entry::Vacuum(*vacuum));
            }
            Scene::Status(status) => {
                if self.job.is_some() && status.job.is_none() {
                    self.rests_by = now + REST_WITHIN;
                }
                self.job.clone_from(&status.job);
                self.moving = status.moving;
                self.put(now, Entry::Status(status_json(status)));
            }
            Scene::Ended(report) => {
                let text = format!("job {} ended: {}: {}", report.id, report.code_text(), report.message);
                self.put(now, Entry::Log(Level::Info, text));
            }
            Scene::Vacuum(_) | Scene::Turn => {}
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

    fn event(&mut self, now: Timestamp, event: &Event) {
        match event {
            Event::Job(order) => self.put(now, Entry::Goals(order.goals.clone())),
            Event::Commission { .. } => self.open = None,
            _ => {}
        }
        if self.decisions && self.open.is_some() {
            self.moments.push((now, Moment::Event(Box::new(event.clone()))));
        }
    }

    fn effect(&mut self, now: Timestamp, effect: &Effect) {
        if let Effect::Commit { record: Record::Found { goals, .. }, .. } = effect {
            self.put(now, Entry::Goals(goals.clone()));
        }
        if let Some((level, line)) = self.said.line(effect) {
            self.put(now, Entry::Log(level, line));
        }
        if self.decisions && self.open.is_some() {
            self.moments.push((now, Moment::Effect(Box::new(effect.clone()))));
        }
    }

    /// Between two turns the machine is whole: here files begin, and gaps end.
    fn turn(&mut self, now: Timestamp, machine: &Machine) {
        let hanging = machine.supervisor().and_then(|cell| cell.object_on_the_gripper());
        if hanging != self.hanging.as_ref().map(|(id, grasp)| (id.as_str(), grasp.as_ref())) {
            let hanging = hanging.map(|(id, grasp)| (id.to_string(), grasp.cloned()));
            if self.sent(now, Entry::Hanging(Box::new(hanging.clone()))) {
                self.hanging = hanging;
            }
        }
        if !self.moments.is_empty() {
            let moments = std::mem::take(&mut self.moments);
            self.gap |= !self.sent(now, Entry::Moments(moments));
        }
        if let Some(segment) = self.next_segment(now) {
            let cell = machine.supervisor().map(|cell| Box::new(cell.model().clone()));
            let machine = self.decisions.then(|| Piece::machine(now, machine, false).ok()).flatten();
            let open = Entry::Open { segment: segment.clone(), unix_s: unix_now_s(), cell, machine };
            if self.sent(now, open) {
                self.open = Some((segment, now));
                self.gap = false;
                self.last_robot = None;
            }
        } else if self.gap
            && let Ok(piece) = Piece::machine(now, machine, true)
        {
            self.gap = !self.sent(now, Entry::Stitch(piece));
        }
    }

    /// What the next file is of, where one is due.
    fn next_segment(&self, now: Timestamp) -> Option<Segment> {
        let segment = self.job.as_ref().map_or(Segment::Idle, |job| Segment::Job(job.clone()));
        let Some((present, since)) = &self.open else { return Some(segment) };
        if self.single {
            return None;
        }
        let wanted = self.shared.wants_file.swap(false, Ordering::Relaxed);
        let over = segment == Segment::Idle && now.since(*since) >= IDLE_FILE;
        // How the arm came to rest belongs to the job that it ended.
        let comes_to_rest = self.moving && now < self.rests_by && matches!(present, Segment::Job(_));
        if comes_to_rest && segment == Segment::Idle {
            return wanted.then(|| present.clone());
        }
        (wanted || over || segment != *present).then_some(segment)
    }

    fn robot(&mut self, now: Timestamp, state: &RobotState) {
        if now.since(self.last_joints) < JOINTS_EVERY {
            return;
        }
        self.last_joints = now;
        self.put(now, Entry::Joints(state.q, state.qd));
        let robot = json!({
            "robot_mode": format!("{:?}", state.robot_mode),
            "safety_mode": format!("{:?}", state.safety_mode),
            "program": format!("{:?}", state.runtime_state),
            "payload_kg": state.payload,
        });
        if self.last_robot.as_ref() != Some(&robot) && self.sent(now, Entry::Robot(robot.clone())) {
            self.last_robot = Some(robot);
        }
    }

    /// With it, where the camera was; `None`: where it is now.
    fn picture(&mut self, now: Timestamp, image: &Image, table_from_camera: Option<Isometry3<f64>>) {
        if self.pictures == RecordedPictures::Off {
            return;
        }
        if self.shared.pictures.load(Ordering::Relaxed) >= WAITING_PICTURES {
            self.dropped += 1;
        } else {
            self.shared.pictures.fetch_add(1, Ordering::Relaxed);
            if !self.sent(now, Entry::Picture(image.clone(), table_from_camera)) {
                self.shared.pictures.fetch_sub(1, Ordering::Relaxed);
            }
        }
    }

    fn put(&mut self, now: Timestamp, entry: Entry) {
        self.sent(now, entry);
    }

    /// False when there is no room for it.
    fn sent(&mut self, now: Timestamp, entry: Entry) -> bool {
        let sent = self.entries.as_ref().is_some_and(|entries| entries.try_send((now, entry)).is_ok());
        self.dropped += usize::from(!sent);
        sent
    }
}

fn status_json(status: &Status) -> Value {
    // Viewers want one type for a key: no job and nothing held are empty texts.
    let or_empty = |text: &Option<String>| text.clone().unwrap_or_default();
    let (job, held) = (or_empty(&status.job), or_empty(&status.held));
    json!({"text": status.text(), "armed": status.armed, "job": job, "moves": status.moves, "held": held})
}

#[cfg(test)]
mod tests;
