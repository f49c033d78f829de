//! A recording made a page: where everything was at any time of the run.
//!
//! In: the messages of a recording as they are replayed, and the machine that the replay has by then; or
//! the files of a job. Out: the [`RecordedRun`] that `report::replay_page` draws, or the page. An object
//! that is carried is where the tool takes it; one that was put down stays there until it is seen again.

use crate::daemon::carried::{Carried, CarriedView};
use crate::daemon::recorder::{Said, piece_of};
use crate::io::recording::read::{Entry, Item, Items};
use crate::io::recording::{ABOUT, log_time_at};
use crate::report::colour;
use crate::report::replay_page::{
    RecordedMove, RecordedObject, RecordedRun, RecordedSentence, RecordedState, data_address, drawn,
    replay_page,
};
use cell_machine::event::{Effect, Event, News};
use cell_machine::machine::Machine;
use cell_machine::supervisor::model::CellModel;
use cell_machine::supervisor::order::RouteAction;
use cell_machine::supervisor::status::{Status, StopNote};
use cell_motion::bodies::Bodies;
use cell_motion::put_down::Grasp;
use cell_replay::{Kind, Replay, effect_of, event_of};
use cell_values::time::{Duration, Timestamp};
use cell_values::units::{Joints, mm_from_m};
use cell_vision::observe::Observation;
use foxglove::Decode;
use foxglove::messages::CompressedImage;
use foxglove::messages::log::Level;
use nalgebra::Point3;
use rearrange::geometry::pose::Pose2;
use std::fs::File;
use std::io::BufReader;
use std::path::PathBuf;

/// Where pictures are in a recording.
pub const PICTURES: &str = "/camera/image";

/// How often the arm is drawn, in the cell's time.
const ARM_EVERY: Duration = Duration::from_millis(100);

/// A joint that moved by less is where it was, rad.
const STILL_RAD: f64 = 5e-4;

/// Corners that represent a curve.
const CURVE_CORNERS: usize = 32;

/// See the module.
#[derive(Default)]
pub struct Playback {
    run: RecordedRun,
    /// The cell's time at which the run begins.
    began: Option<Timestamp>,
    arm_at: Option<Timestamp>,
    arm: Option<Joints>,
    /// The object on the gripper.
    held: Option<String>,
    carried: Carried,
    said: Said,
}

impl Playback {
    /// With a title, and where the cell's time 0 was, s since 1970.
    pub fn new(title: String, epoch_unix_s: f64) -> Playback {
        Playback {
            run: RecordedRun { title, began_unix_s: epoch_unix_s, ..RecordedRun::default() },
            ..Playback::default()
        }
    }

    /// The same where the cell's time 0 was then, s since 1970; once something was taken, nothing changes.
    pub fn since(mut self, epoch_unix_s: f64) -> Playback {
        if self.began.is_none() {
            self.run.began_unix_s = epoch_unix_s;
        }
        self
    }

    /// All of it.
    pub fn finish(self) -> RecordedRun {
        self.run
    }

    /// s since the page's beginning; the first time of all is that.
    fn seconds(&mut self, at: Timestamp) -> f64 {
        let began = *self.began.get_or_insert_with(|| {
            self.run.began_unix_s += at.as_secs_f64();
            at
        });
        (at.since(began).as_secs_f64() * 1e3).round() / 1e3
    }

    /// One message that `replay` has taken in, which began at `epoch_unix_s`.
    pub fn take(&mut self, entry: &Entry, replay: &Replay, epoch_unix_s: f64) {
        match piece_of(&entry.channel.topic) {
            Some(Kind::Event) => {
                if let Some((at, event)) = event_of(&entry.piece()) {
                    self.event(at, &event, replay.machine());
                }
            }
            Some(Kind::Effect) => {
                if let Some(effect) = effect_of(&entry.piece()) {
                    self.held = held_by(replay.machine()).map(|(id, _)| id.to_string());
                    self.effect(replay.so_far().until, &effect);
                }
            }
            None if entry.channel.topic == PICTURES => {
                self.picture(log_time_at(epoch_unix_s, entry.log_time), entry);
            }
            Some(Kind::Machine) | None => {}
        }
    }

    /// A picture, as it was recorded.
    fn picture(&mut self, at: Timestamp, entry: &Entry) {
        let Ok(picture) = CompressedImage::decode(entry.data.as_slice()) else { return };
        let at = self.seconds(at);
        self.run.pictures.push((at, data_address(&picture.data)));
    }

    /// What the machine has taken in, and what it is now.
    fn event(&mut self, at: Timestamp, event: &Event, machine: Option<&Machine>) {
        let seconds = self.seconds(at);
        let model = machine.and_then(|machine| machine.supervisor()).map(|supervisor| supervisor.model());
        if let (true, Some(model)) = (self.run.objects.is_empty(), model) {
            self.cell(model);
        }
        // A recording begins with the machine, and the first status may be long in coming.
        if let (true, Some(cell)) = (self.run.states.is_empty(), machine.and_then(Machine::supervisor)) {
            self.status(seconds, &cell.status());
        }
        if let Event::Observed(_, Ok(seen)) = event {
            self.seen(seconds, seen);
        }
        let held = held_by(machine);
        self.held = held.map(|(id, _)| id.to_string());
        self.carried.hangs(held);
        let q = machine.and_then(|machine| machine.robot_state()).map(|state| state.q);
        if let (Some(model), Some(q)) = (model, q)
            && self.arm_at.is_none_or(|last| at.since(last) >= ARM_EVERY)
            && self.arm.is_none_or(|last| q.0.iter().zip(last.0).any(|(a, b)| (a - b).abs() > STILL_RAD))
        {
            (self.arm_at, self.arm) = (Some(at), Some(q));
            self.arm(seconds, model, &q);
        }
    }

    /// What the machine has decided.
    fn effect(&mut self, at: Timestamp, effect: &Effect) {
        let seconds = self.seconds(at);
        if let Some((level, line)) = self.said.line(effect) {
            self.say(seconds, level == Level::Warning, line);
        }
        let Effect::Notify(news) = effect else { return };
        match news {
            News::Notice(notice) => self.say(seconds, notice.alarm, notice.text.clone()),
            News::Status(status) => self.status(seconds, status),
            News::Route(route) => {
                let planned = |RouteAction { object, from, to, to_goal }: &RouteAction| RecordedMove {
                    object: object.clone(),
                    from: drawn(from),
                    to: drawn(to),
                    goal: *to_goal,
                };
                self.run.plans.push((seconds, route.iter().map(planned).collect()));
            }
            News::Ended(report) => {
                let text = format!("job {} {}: {}", report.id, report.end.as_str(), report.message);
                self.say(seconds, report.code.exit_code() != 0, text);
            }
            News::Identified(_) => {}
        }
    }

    fn say(&mut self, at: f64, alarm: bool, text: String) {
        self.run.sentences.push(RecordedSentence { at, alarm, text });
    }

    fn status(&mut self, at: f64, status: &Status) {
        let in_words = |stop: &StopNote| {
            let hint = if stop.hint.is_empty() { String::new() } else { format!("; to do: {}", stop.hint) };
            format!("{} ({}){hint}", stop.message, stop.code.as_str())
        };
        let state = RecordedState {
            text: status.text(),
            armed: status.armed,
            moving: status.moving,
            job: status.job.clone(),
            moves: status.moves,
            held: status.held.clone(),
            carried: self.held.clone().filter(|_| status.held.is_some()),
            stopped: status.stopped.as_ref().map(in_words),
            // What the stop has to say is said with it.
            hint: match &status.stopped {
                Some(stop) => status.hint.replacen(&stop.hint, "", 1).trim_matches([';', ' ']).to_string(),
                None => status.hint.clone(),
            },
        };
        if self.run.states.last().is_none_or(|(_, last)| *last != state) {
            self.run.states.push((at, state));
        }
    }

    fn cell(&mut self, model: &CellModel) {
        self.run.table = [model.workspace.width, model.workspace.height];
        let outline = |footprint: &rearrange::geometry::footprint::Footprint, pose: &Pose2| {
            let corners = footprint.outline(CURVE_CORNERS).into_iter();
            corners.map(|corner| pose.transform(corner).map(|v| (v * 1e4).round() / 1e4)).collect::<Vec<_>>()
        };
        self.run.kept_free = model.keep_out.iter().map(|kept| outline(&kept.footprint, &kept.pose)).collect();
        let object =
            |(index, object): (usize, &cell_machine::supervisor::model::CellObject)| RecordedObject {
                id: object.id.clone(),
                colour: colour::of(index),
                outline: outline(&object.footprint, &Pose2::new(0.0, 0.0, 0.0)),
                at: Vec::new(),
            };
        self.run.objects = model.objects.iter().enumerate().map(object).collect();
    }

    fn seen(&mut self, at: f64, seen: &Observation) {
        for object in &mut self.run.objects {
            if let Some(found) = seen.object(&object.id) {
                object.at.push((at, drawn(&found.pose)));
            }
        }
        let foreign: Vec<_> = seen
            .foreign
            .iter()
            .flat_map(|report| &report.objects)
            .map(|thing| thing.outline.clone())
            .collect();
        if self.run.foreign.last().map_or(!foreign.is_empty(), |(_, last)| *last != foreign) {
            self.run.foreign.push((at, foreign));
        }
    }

    fn arm(&mut self, at: f64, model: &CellModel, q: &Joints) {
        let table_from_base = model.arm.base_from_table.inverse();
        let mut joints: Vec<[i32; 3]> = origins(&model.arm.bodies, q)
            .iter()
            .map(|origin| millimetres(&(table_from_base * Point3::from(*origin))))
            .collect();
        let tool = model.arm.tool_at(q);
        joints.push(millimetres(&Point3::from(tool.translation.vector)));
        self.run.arm.push((at, joints));
        self.carried.arm(&model.arm, q);
        if let Some(CarriedView { id, pose, .. }) = self.carried.held()
            && let Some(object) = self.run.objects.iter_mut().find(|object| object.id == *id)
        {
            object.at.push((at, drawn(pose)));
        }
    }
}

/// Longer recordings are no page: all of it is in memory while it is made, and in the browser after.
const MOST_BYTES: u64 = 200 << 20;

/// The recordings of one job on a page, one after the other.
///
/// # Errors
/// A file that is no recording, none of them holds decisions, or together they are too large.
pub fn page_of(title: String, files: &[PathBuf]) -> Result<String, String> {
    page_within(title, files, MOST_BYTES)
}

fn page_within(title: String, files: &[PathBuf], most: u64) -> Result<String, String> {
    let bytes: u64 = files.iter().filter_map(|path| path.metadata().ok()).map(|file| file.len()).sum();
    if bytes > most {
        return Err(format!(
            "the recording has {} MB, and a page shows {} at most: Foxglove opens the file",
            bytes >> 20,
            most >> 20
        ));
    }
    let mut page = Playback::new(title, 0.0);
    let mut decided = false;
    for path in files {
        let located = |what: String| format!("{}: {what}", path.display());
        let file = File::open(path).map_err(|error| located(error.to_string()))?;
        let (mut replay, mut epoch) = (Replay::default(), 0.0);
        for item in Items::new(BufReader::new(file)) {
            match item {
                Ok(Item::About(metadata)) if metadata.name == ABOUT => {
                    let text = metadata.metadata.get("epoch_unix_s");
                    epoch = text.and_then(|text| text.parse().ok()).unwrap_or(0.0);
                    page = page.since(epoch);
                }
                Ok(Item::About(_)) => {}
                Ok(Item::Message(entry)) => {
                    let kind = piece_of(&entry.channel.topic);
                    let taken = kind.map_or(Ok(None), |kind| replay.take(kind, &entry.piece()));
                    // What this celld would decide otherwise is not what was: the page ends there.
                    if taken.map_err(|error| located(error.to_string()))?.is_some() {
                        break;
                    }
                    page.take(&entry, &replay, epoch);
                }
                // Its writer is at work on it, or was killed: what is there is shown.
                Err(_) => break,
            }
        }
        decided |= replay.machine().is_some();
    }
    if !decided {
        return Err(
            "the recording holds no decisions; `recording: {decisions: true}` records them".to_string()
        );
    }
    replay_page(&page.finish()).map_err(|error| error.to_string())
}

/// The object on the gripper, and how it hangs there, if that is known.
fn held_by(machine: Option<&Machine>) -> Option<(&str, Option<&Grasp>)> {
    machine.and_then(|machine| machine.supervisor()?.object_on_the_gripper())
}

/// Of the frames 0 to 6 and the flange, in the base frame, m.
fn origins(bodies: &Bodies, q: &Joints) -> [[f64; 3]; 8] {
    bodies.frames(q).map(|frame| [frame.translation.x, frame.translation.y, frame.translation.z])
}

fn millimetres(point: &Point3<f64>) -> [i32; 3] {
    [point.x, point.y, point.z].map(|m| mm_from_m(m).round() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_that_is_too_large_for_a_page_is_refused_before_it_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let files = ["a.mcap", "b.mcap"].map(|name| folder.path().join(name));
        files.iter().for_each(|path| std::fs::write(path, vec![0; 2 << 20]).unwrap());
        let refused = page_within("job a".into(), &files, 3 << 20).unwrap_err();
        assert!(refused.contains("has 4 MB") && refused.contains("3 at most"), "{refused}");
        let read = page_within("job a".into(), &files, 4 << 20).unwrap_err();
        assert!(read.contains("no decisions"), "{read}");
    }
}
