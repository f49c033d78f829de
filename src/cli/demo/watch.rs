//! What the demo keeps of a run while it happens: pictures, log, plans, times; and what it tells the person
//! in front of the screen.
//!
//! In: the daemon's events. Out: [`Watch`], from which the report is made, a recording, and lines on stderr.

use crate::daemon::run::{Event, Observer};
use crate::geometry::pose::Pose2;
use crate::io::priority;
use crate::io::recording::{PictureFormat, RecordedObject, Recording, Severity};
use crate::report::run::LogRow;
use crate::supervisor::order::JobReport;
use crate::time::{Duration, Timestamp};
use crate::vision::annotate::draw_detections;
use crate::vision::image::Image;
use crate::vision::observe::Observation;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use std::sync::mpsc::{Receiver, Sender, channel};

/// One step of a route: object, from, to, whether `to` is its goal.
pub type RouteStep = (String, Pose2, Pose2, bool);

/// A picture with the time it was taken, before and after encoding.
type Picture = (Timestamp, Image);
type EncodedPicture = (Timestamp, Vec<u8>);

/// How often joint states are recorded, in the cell's time.
const RECORD_EVERY: Duration = Duration::from_millis(40);

/// Everything kept of a run.
pub struct Watch {
    bar: ProgressBar,
    recording: Option<Recording>,
    last_recorded: Timestamp,
    to_encode: Sender<Picture>,
    encoded: Receiver<EncodedPicture>,
    /// Sentences with the cell's time.
    pub log: Vec<LogRow>,
    /// Annotated pictures of the look under way, then of the last one.
    look: Vec<Image>,
    look_over: bool,
    /// Annotated pictures of the first look.
    pub first_look: Vec<Image>,
    /// The first observation.
    pub first_seen: Option<Observation>,
    /// The last observation.
    pub last_seen: Option<Observation>,
    /// The first plan.
    pub plan: Vec<RouteStep>,
    /// Number of plans made.
    pub plans: usize,
    /// Number of looks.
    pub looks: usize,
    /// Carried-out moves with the time each ended.
    pub done: Vec<(RouteStep, Timestamp)>,
    route: Vec<RouteStep>,
    /// How the job ended.
    pub report: Option<JobReport>,
}

impl Watch {
    /// Shows progress on stderr and records to `recording`.
    pub fn new(recording: Option<Recording>) -> Watch {
        let bar = ProgressBar::new(0);
        let template = "{spinner} [{elapsed_precise}] {bar:24} {pos}/{len} moves  {msg}";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        let (to_encode, encoded) = encoder();
        Watch {
            bar,
            recording,
            last_recorded: Timestamp::ZERO,
            to_encode,
            encoded,
            log: Vec::new(),
            look: Vec::new(),
            look_over: true,
            first_look: Vec::new(),
            first_seen: None,
            last_seen: None,
            plan: Vec::new(),
            plans: 0,
            looks: 0,
            done: Vec::new(),
            route: Vec::new(),
            report: None,
        }
    }

    /// Pictures of the last look.
    pub fn last_look(&self) -> &[Image] {
        &self.look
    }

    /// Ends progress and recording; the recording's fault, if it had one.
    pub fn close(&mut self) -> Option<String> {
        self.bar.finish_and_clear();
        let finished = self.recording.take().map(Recording::finish)?;
        finished.err().map(|error| error.to_string())
    }

    /// Writes to the recording; the first failure ends it with one line in the log.
    fn record(
        &mut self,
        now: Timestamp,
        write: impl FnOnce(&mut Recording) -> Result<(), crate::io::recording::RecordingError>,
    ) {
        let Some(recording) = &mut self.recording else { return };
        if let Err(error) = write(recording) {
            self.recording = None;
            let text = format!("recording ended: {error}");
            self.log.push(LogRow { seconds: now.as_secs_f64(), level: "warn", text });
        }
    }

    fn picture(&mut self, now: Timestamp, image: &Image, detections: &[crate::vision::detect::Detection]) {
        if self.look_over {
            self.look.clear();
            self.look_over = false;
        }
        let mut drawn = image.clone();
        draw_detections(&mut drawn, detections);
        // Encoding takes tens of milliseconds, in which the robot would not hear from us.
        let _ = self.to_encode.send((now, drawn.clone()));
        self.look.push(drawn);
    }

    fn observed(&mut self, now: Timestamp, observation: &Observation) {
        self.looks += 1;
        self.look_over = true;
        if self.first_seen.is_none() {
            self.first_seen = Some(observation.clone());
            self.first_look = self.look.clone();
        }
        self.last_seen = Some(observation.clone());
        let objects: Vec<RecordedObject> = observation
            .objects
            .iter()
            .map(|o| RecordedObject {
                id: o.id.clone(),
                x: o.pose.x,
                y: o.pose.y,
                theta: o.pose.theta,
                std_xy_m: o.std_xy_m,
                std_theta_rad: o.std_theta_rad,
            })
            .collect();
        self.record(now, |recording| recording.arrangement(now, "camera", &objects));
    }

    /// A shorter route is a move done; any other change is a new plan.
    fn routed(&mut self, now: Timestamp, route: &[RouteStep]) {
        // Where an object is picked up is measured anew before every move; the plan is the objects and places.
        let places = |steps: &[RouteStep]| steps.iter().map(|s| (s.0.clone(), s.2)).collect::<Vec<_>>();
        let (before, after) = (places(&self.route), places(route));
        if before.get(1..) == Some(&after[..]) {
            self.done.push((self.route[0].clone(), now));
        } else if before != after && !after.is_empty() {
            self.plans += 1;
            if self.plan.is_empty() {
                self.plan = route.to_vec();
            }
            let steps: Vec<_> =
                route.iter().map(|s| json!({"object": s.0, "from": s.1, "to": s.2, "goal": s.3})).collect();
            self.record(now, |recording| recording.plan(now, &json!({ "actions": steps })));
        }
        self.route = route.to_vec();
        self.bar.set_length((self.done.len() + route.len()) as u64);
        self.bar.set_position(self.done.len() as u64);
    }
}

/// A thread that turns pictures into PNG; it ends when the sender is dropped.
fn encoder() -> (Sender<Picture>, Receiver<EncodedPicture>) {
    let (pictures_in, pictures) = channel::<Picture>();
    let (encoded_in, encoded) = channel();
    std::thread::spawn(move || {
        priority::lower();
        for (taken, picture) in pictures {
            // A picture that cannot be encoded is a fault of this program, and no reason to stop an arm.
            let Ok(png) = picture.encode_png() else { continue };
            if encoded_in.send((taken, png)).is_err() {
                return;
            }
        }
    });
    (pictures_in, encoded)
}

impl Observer for Watch {
    fn on(&mut self, now: Timestamp, event: Event) {
        while let Ok((taken, png)) = self.encoded.try_recv() {
            self.record(now, |recording| recording.picture(taken, PictureFormat::Png, &png));
        }
        match event {
            Event::Status(status) => {
                self.bar.set_message(status.phase.clone());
                self.bar.tick();
            }
            Event::Notice(notice) => {
                let level = if notice.alarm { "warn" } else { "info" };
                self.bar.println(format!("{:8.1} s  {}", now.as_secs_f64(), notice.text));
                self.log.push(LogRow { seconds: now.as_secs_f64(), level, text: notice.text.clone() });
                let severity = if notice.alarm { Severity::Warning } else { Severity::Info };
                self.record(now, |recording| recording.log(now, severity, "cell", &notice.text));
            }
            Event::Picture { image, views } => {
                let detections = views.last().map_or(&[][..], |view| &view.detections);
                self.picture(now, image, detections);
            }
            Event::Observed(observation) => self.observed(now, observation),
            Event::Route(route) => self.routed(now, route),
            Event::Robot(state) => {
                if now.since(self.last_recorded) >= RECORD_EVERY {
                    self.last_recorded = now;
                    self.record(now, |recording| recording.joints(now, &state.q, &state.qd));
                }
            }
            Event::Finished(report) => self.report = Some(report.clone()),
        }
    }
}
