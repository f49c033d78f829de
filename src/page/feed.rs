//! What happens in the cell, for those who watch: the last of everything, and messages as things change.
//!
//! In: what the loop shows its observers, each status that is written, the cell once it is known. Out: the
//! last status, arm, arrangement, sentences and picture; messages to every viewer. Nothing here blocks: the
//! loop hands over and goes on, and a viewer that does not take its messages loses them all and is dropped.

use crate::daemon::carried::{Carried, CarriedView, merged};
use crate::daemon::film::{Film, Shown};
use crate::daemon::last_picture::LastPicture;
use crate::daemon::messages::Displayed;
use crate::daemon::shell::{Observer, Scene};
use crate::jobs::status::{STARTING, Status};
use crate::page::turns::Turns;
use crate::page::views::{ArmView, SightView, arm_view, sight_view};
use axum::body::Bytes;
use cell_calibration::files::camera::CameraCalibration;
use cell_edge::clock::unix_now_s;
use cell_machine::device::robot_types::RobotState;
use cell_machine::event::{Arm, Effect};
use cell_machine::machine::Machine;
use cell_machine::supervisor::cell::Supervisor;
use cell_machine::supervisor::model::CellModel;
use cell_values::time::{Duration, Timestamp};
use cell_values::units::Joints;
use cell_vision::observe::Observation;
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use tokio::sync::broadcast;

/// Messages that a viewer may be behind by: three seconds' worth.
const BEHIND: usize = 64;

/// Sentences that are kept.
const SENTENCES: usize = 200;

/// How often the arm is shown, in the cell's time.
const ARM_EVERY: Duration = Duration::from_millis(100);

/// A message to viewers: its kind, and JSON.
#[derive(Debug)]
pub struct Message {
    /// Name of the event.
    pub kind: &'static str,
    /// Its data.
    pub json: String,
}

/// A sentence with its time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sentence {
    /// s since 1970.
    pub unix_s: f64,
    /// A person should read it.
    pub alarm: bool,
    /// What happened.
    pub text: String,
}

/// One point of a trend: s since 1970, and the value.
pub type Point = (f64, f64);

/// How things have been going.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Trends {
    /// How far the reference markers seemed to be from where they were surveyed, mm, look by look.
    pub reference_residual_mm: VecDeque<Point>,
    /// The most relative vacuum of each grip, %, of the channel that had more: what the cups still reach.
    pub vacuum_percent: VecDeque<Point>,
}

/// The cell once the robot is known.
pub struct KnownCell {
    /// As the supervisor has it.
    pub model: CellModel,
    /// The lens, for what is drawn over pictures and calibrations.
    pub lens: CameraCalibration,
    /// Which arm it is.
    pub arm: Arm,
    /// What the camera showed last.
    pub pictures: LastPicture,
}

/// The table as it was measured last.
#[derive(Clone)]
pub struct Sight {
    /// What was seen.
    pub seen: Arc<Observation>,
    /// When, s since 1970.
    pub unix_s: f64,
    /// The last look was at all of it.
    pub whole: bool,
}

/// Joints, rad, and their speeds, rad/s, and when they were shown.
#[derive(Clone, Copy)]
struct ArmMotion {
    q: Joints,
    qd: [f64; 6],
    shown: Instant,
}

#[derive(Default)]
struct Last {
    status: Option<Arc<Status>>,
    arm: Option<ArmView>,
    moving: Option<ArmMotion>,
    seen: Option<Sight>,
    carried: Vec<CarriedView>,
    sentences: VecDeque<Sentence>,
    cell: Option<Arc<KnownCell>>,
    trends: Trends,
    /// The last picture as it was encoded, with its number.
    encoded: Option<(u64, Bytes)>,
}

/// Points of a trend that are kept.
const POINTS: usize = 500;

fn push(list: &mut VecDeque<Point>, point: Point) {
    list.push_back(point);
    if list.len() > POINTS {
        list.pop_front();
    }
}

/// The last of everything. See the module.
#[derive(Clone)]
pub struct Feed {
    last: Arc<Mutex<Last>>,
    messages: broadcast::Sender<Arc<Message>>,
    /// Number of the last picture.
    picture: Arc<AtomicU64>,
    /// When the loop last came round and the last status was written, ms since `begun`; 0 before.
    turned: Arc<AtomicU64>,
    stated: Arc<AtomicU64>,
    begun: Instant,
    turns: Arc<Turns>,
}

/// A state older than this is not of now: the loop turns hundreds of times a second, and a status is written
/// every second.
const OF_NOW_MS: u64 = 2500;

impl Default for Feed {
    fn default() -> Feed {
        let (messages, _) = broadcast::channel(BEHIND);
        let (picture, turned, stated) = Default::default();
        let (last, turns) = Default::default();
        Feed { last, messages, picture, turned, stated, begun: Instant::now(), turns }
    }
}

impl Feed {
    /// The observer of the loop.
    pub fn observer(&self) -> Watcher {
        Watcher {
            feed: self.clone(),
            film: None,
            carried: Carried::default(),
            arm_at: None,
            vacuum_at: None,
            holds: None,
            turned: None,
        }
    }

    /// Messages from now on.
    pub fn messages(&self) -> broadcast::Receiver<Arc<Message>> {
        self.messages.subscribe()
    }

    /// How many watch.
    pub fn viewers(&self) -> usize {
        self.messages.receiver_count()
    }

    /// The robot is known.
    pub fn known(&self, cell: KnownCell) {
        self.last().cell = Some(Arc::new(cell));
        self.send("cell", &true);
    }

    fn ms(&self) -> u64 {
        u64::try_from(self.begun.elapsed().as_millis()).unwrap_or(u64::MAX).max(1)
    }

    /// Whether what is shown is of now: the loop turns, and what it decides is written down. Before orders
    /// are taken there is nothing to be late.
    pub fn is_of_now(&self) -> bool {
        let recent = |at: &AtomicU64| self.ms().saturating_sub(at.load(Ordering::Relaxed)) < OF_NOW_MS;
        let starting = self.last().status.as_ref().is_none_or(|status| status.state == STARTING);
        starting || (recent(&self.turned) && recent(&self.stated))
    }

    /// A status was written.
    pub fn status(&self, status: &Status) {
        self.stated.store(self.ms(), Ordering::Relaxed);
        let status = Arc::new(status.clone());
        self.last().status = Some(status.clone());
        self.send("status", &*status);
    }

    /// Something else that viewers should see.
    pub fn send(&self, kind: &'static str, data: &impl Serialize) {
        if self.viewers() == 0 {
            return;
        }
        if let Ok(json) = serde_json::to_string(data) {
            // Whoever watched has gone meanwhile: nothing is lost.
            let _ = self.messages.send(Arc::new(Message { kind, json }));
        }
    }

    /// The last status.
    pub fn last_status(&self) -> Option<Arc<Status>> {
        self.last().status.clone()
    }

    /// The arm.
    pub fn last_arm(&self) -> Option<ArmView> {
        self.last().arm.clone()
    }

    /// Where the arm's joints are (rad) and how fast they move (rad/s), as shown within this time.
    pub fn joints_now(&self, within: std::time::Duration) -> Option<(Joints, [f64; 6])> {
        let ArmMotion { q, qd, shown } = self.last().moving?;
        (shown.elapsed() < within).then_some((q, qd))
    }

    /// How evenly the loop turns.
    pub fn turns(&self) -> &Turns {
        &self.turns
    }

    /// The table as it was measured last.
    pub fn last_sight(&self) -> Option<Sight> {
        self.last().seen.clone()
    }

    /// The same for viewers.
    pub fn last_sight_view(&self) -> Option<SightView> {
        let last = self.last();
        last.seen.as_ref().map(|sight| sight_view(&sight.seen, sight.unix_s, &last.carried))
    }

    /// What the arm has carried since it was seen.
    pub fn carried(&self) -> Vec<CarriedView> {
        self.last().carried.clone()
    }

    /// What was said, the newest last.
    pub fn sentences(&self) -> Vec<Sentence> {
        self.last().sentences.iter().cloned().collect()
    }

    /// The cell; `None` before the robot is known.
    pub fn cell(&self) -> Option<Arc<KnownCell>> {
        self.last().cell.clone()
    }

    /// Number of the last picture; 0 before there is one.
    pub fn picture_number(&self) -> u64 {
        self.picture.load(Ordering::Relaxed)
    }

    /// How things have been going.
    pub fn trends(&self) -> Trends {
        self.last().trends.clone()
    }

    /// The picture with this number as it was encoded before.
    pub fn encoded(&self, number: u64) -> Option<Bytes> {
        self.last().encoded.as_ref().filter(|(kept, _)| *kept == number).map(|(_, jpeg)| jpeg.clone())
    }

    /// Keeps it for other viewers.
    pub fn keep_encoded(&self, number: u64, jpeg: Bytes) -> Bytes {
        self.last().encoded = Some((number, jpeg.clone()));
        jpeg
    }

    fn last(&self) -> MutexGuard<'_, Last> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn say(&self, alarm: bool, text: String) {
        let sentence = Sentence { unix_s: unix_now_s(), alarm, text };
        self.send("sentence", &sentence);
        let mut last = self.last();
        last.sentences.push_back(sentence);
        if last.sentences.len() > SENTENCES {
            last.sentences.pop_front();
        }
    }
}

/// The loop's end of the feed.
pub struct Watcher {
    feed: Feed,
    /// Where pictures of a calibration round go.
    film: Option<Film>,
    carried: Carried,
    turned: Option<Instant>,
    arm_at: Option<Timestamp>,
    vacuum_at: Option<Timestamp>,
    /// The most vacuum since something is held.
    holds: Option<f64>,
}

/// Less vacuum than this is none: what the pump leaves in open cups.
const HOLDS: f64 = 0.05;

/// How often the vacuum is shown, in the cell's time.
const VACUUM_EVERY: Duration = Duration::from_millis(250);

impl Watcher {
    /// Pictures of calibration rounds go there.
    pub fn with_film(self, film: Option<Film>) -> Watcher {
        Watcher { film, ..self }
    }

    fn turned(&mut self) {
        let now = Instant::now();
        if let Some(before) = self.turned.replace(now) {
            self.feed.turns.turned(before, now);
        }
        self.feed.turned.store(self.feed.ms(), Ordering::Relaxed);
    }

    fn observed(&mut self, seen: &Observation, partial: bool) {
        let unix_s = unix_now_s();
        self.carried.seen(seen, partial);
        let before = self.feed.last_sight().filter(|_| partial).map(|sight| sight.seen);
        let seen = Arc::new(merged(seen.clone(), before.as_deref()));
        self.feed.send("sight", &sight_view(&seen, unix_s, self.carried.objects()));
        let mut last = self.feed.last();
        last.carried = self.carried.objects().to_vec();
        last.seen = Some(Sight { seen: seen.clone(), unix_s, whole: !partial });
        if let Some(residual) = seen.reference_residual_m {
            push(&mut last.trends.reference_residual_mm, (unix_s, residual * 1e3));
        }
    }

    /// The arm, and what it carries.
    fn arm(&mut self, now: Timestamp, state: &RobotState) {
        self.arm_at = Some(now);
        let cell = self.feed.cell();
        if let Some(cell) = &cell {
            self.carried.arm(&cell.model.arm, &state.q);
        }
        let bodies = cell.as_ref().map(|cell| &cell.model.arm.bodies);
        let view = ArmView { carried: self.carried.held().cloned(), ..arm_view(state, bodies) };
        self.feed.send("arm", &view);
        let mut last = self.feed.last();
        last.arm = Some(view);
        last.moving = Some(ArmMotion { q: state.q, qd: state.qd, shown: Instant::now() });
        last.carried = self.carried.objects().to_vec();
    }

    /// What hangs on the gripper: where that changes, the table is another.
    fn hangs(&mut self, machine: &Machine) {
        if self.carried.hangs(machine.supervisor().and_then(Supervisor::object_on_the_gripper)) {
            let mut last = self.feed.last();
            last.carried = self.carried.objects().to_vec();
            // The arm sends nothing more where its link is lost.
            if let Some(arm) = &mut last.arm {
                arm.carried = self.carried.held().cloned();
            }
            drop(last);
            self.feed.send("carried", &self.carried.objects());
        }
    }

    fn show(&self, shown: impl FnOnce() -> Shown) {
        if let Some(film) = &self.film {
            film.show(shown());
        }
    }

    fn vacuum(&mut self, now: Timestamp, channels: [f64; 2]) {
        if self.vacuum_at.is_some_and(|at| now.since(at) < VACUUM_EVERY) {
            return;
        }
        self.vacuum_at = Some(now);
        let percent = channels.map(|channel| (channel * 100.0).round());
        self.feed.send("vacuum", &percent);
        let most = channels[0].max(channels[1]);
        if let Some(reached) = reached(&mut self.holds, most) {
            push(
                &mut self.feed.last().trends.vacuum_percent,
                (unix_now_s(), (reached * 1000.0).round() / 10.0),
            );
        }
    }
}

/// What a grip has reached, when it is over: the way up and the way down say nothing about the cups.
fn reached(holds: &mut Option<f64>, vacuum: f64) -> Option<f64> {
    if vacuum > HOLDS {
        *holds = Some(holds.map_or(vacuum, |most| most.max(vacuum)));
        return None;
    }
    holds.take()
}

impl Observer for Watcher {
    fn on(&mut self, now: Timestamp, scene: Scene) {
        match scene {
            Scene::Turn => self.turned(),
            Scene::Machine(machine) => self.hangs(machine),
            Scene::Robot(state) if self.arm_at.is_none_or(|at| now.since(at) >= ARM_EVERY) => {
                self.arm(now, state);
            }
            Scene::Notice(notice) => self.feed.say(notice.alarm, notice.text.clone()),
            Scene::Displayed(Displayed::Observed { seen, partial }) => self.observed(seen, *partial),
            Scene::Displayed(Displayed::Picture { .. }) => {
                let number = self.feed.picture.fetch_add(1, Ordering::Relaxed) + 1;
                self.feed.send("picture", &number);
            }
            Scene::Vacuum(channels) => self.vacuum(now, channels),
            Scene::Displayed(Displayed::Sample { pose, image, sample }) => {
                self.show(|| Shown::Sample { pose: *pose, image: image.clone(), sample: sample.clone() });
            }
            Scene::Effect(Effect::RoundOver(result)) => self.show(|| Shown::RoundOver(result.clone())),
            Scene::Robot(_)
            | Scene::Status(_)
            | Scene::Route(_)
            | Scene::Ended(_)
            | Scene::Event(_)
            | Scene::Effect(_) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::carried::tests::estimate;
    use cell_machine::supervisor::input::Notice;

    #[test]
    fn viewers_see_what_happens_and_one_that_does_not_read_falls_behind() {
        let feed = Feed::default();
        let mut watcher = feed.observer();
        let say = |text: &str| Notice { alarm: true, text: text.to_string() };
        watcher.on(Timestamp::ZERO, Scene::Notice(&say("before")));
        let mut viewer = feed.messages();
        watcher.on(Timestamp::ZERO, Scene::Notice(&say("a \u{1b} word")));
        let message = viewer.try_recv().expect("a message");
        assert!(message.kind == "sentence" && message.json.contains(r#""alarm":true"#), "{message:?}");
        assert!(message.json.contains("\\u001b"), "control characters travel escaped: {}", message.json);
        for _ in 0..=BEHIND {
            watcher.on(Timestamp::ZERO, Scene::Notice(&say("more")));
        }
        assert!(matches!(viewer.try_recv(), Err(broadcast::error::TryRecvError::Lagged(_))));
        assert_eq!(feed.sentences().first().map(|sentence| sentence.text.as_str()), Some("before"));
        (0..SENTENCES).for_each(|_| watcher.on(Timestamp::ZERO, Scene::Notice(&say("x"))));
        assert_eq!(feed.sentences().len(), SENTENCES);
    }

    /// A beat says that the state is of now: not before both the loop and the status have come round.
    #[test]
    fn what_neither_turns_nor_is_written_down_is_not_of_now() {
        let feed = Feed::default();
        let mut watcher = feed.observer();
        assert!(feed.is_of_now(), "at the start there is nothing to be late");
        feed.status(&Status { state: STARTING.to_string(), ..Status::default() });
        assert!(feed.is_of_now(), "nor while the robot is waited for");
        let idle = Status { state: "idle".to_string(), ..Status::default() };
        feed.status(&idle);
        assert!(feed.is_of_now(), "the loop has just begun");
        watcher.feed.begun -= std::time::Duration::from_secs(3);
        let late = watcher.feed.clone();
        assert!(!late.is_of_now(), "3 s later neither has come round");
        watcher.on(Timestamp::ZERO, Scene::Turn);
        assert!(!late.is_of_now(), "the loop turns, and the journal's thread hangs");
        late.status(&idle);
        assert!(late.is_of_now());
    }

    #[test]
    fn a_grip_is_one_point_of_the_trend_and_the_most_it_reached() {
        let mut holds = None;
        let course = [0.0, 0.2, 0.58, 0.61, 0.6, 0.3, 0.02, 0.01, 0.4, 0.0];
        let points: Vec<f64> = course.iter().filter_map(|vacuum| reached(&mut holds, *vacuum)).collect();
        assert_eq!(points, [0.61, 0.4]);
    }

    #[test]
    fn a_look_at_a_part_of_the_table_takes_nothing_else_away() {
        let before =
            Observation { objects: vec![estimate("a", 0.1), estimate("b", 0.2)], ..Default::default() };
        let part = Observation {
            objects: vec![estimate("a", 0.3)],
            missing: vec!["b".into(), "c".into()],
            ..Default::default()
        };
        let both = merged(part.clone(), Some(&before));
        let at = |id: &str| both.object(id).map(|object| object.pose.x);
        assert_eq!(
            (at("a"), at("b"), both.missing.as_slice()),
            (Some(0.3), Some(0.2), &["c".to_string()][..])
        );
        assert_eq!(merged(part.clone(), None), part, "a look at all of it is all there is");
    }
}
