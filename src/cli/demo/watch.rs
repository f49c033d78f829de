//! What the demo keeps of a run while it happens: pictures, log, plans, times; and what it shows the person
//! in front of the screen.
//!
//! In: the daemon's events. Out: [`Watch`], from which the report is made, a recording, and lines on stderr.

use crate::cell::supervisor::order::JobReport;
use crate::cli::recorder::Recorder;
use crate::daemon::messages::Displayed;
use crate::daemon::shell::{Observer, Scene};
use crate::report::run::LogRow;
use cell_values::image::Image;
use cell_values::time::Timestamp;
use cell_vision::annotate::draw_detections;
use cell_vision::observe::Observation;
use indicatif::{ProgressBar, ProgressStyle};
use rearrange::geometry::pose::Pose2;

/// One step of a route: object, from, to, whether `to` is its goal.
pub type RouteStep = (String, Pose2, Pose2, bool);

/// Everything kept of a run.
pub struct Watch {
    bar: ProgressBar,
    recorder: Recorder,
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
    /// Shows progress on stderr and records.
    pub fn new(recorder: Recorder) -> Watch {
        let bar = ProgressBar::new(0);
        let template = "{spinner} [{elapsed_precise}] {bar:24} {pos}/{len} moves  {msg}";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        Watch {
            bar,
            recorder,
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
        self.recorder.close()
    }

    fn picture(&mut self, image: &Image, detections: &[cell_vision::detect::Detection]) {
        if self.look_over {
            self.look.clear();
            self.look_over = false;
        }
        let mut drawn = image.clone();
        draw_detections(&mut drawn, detections);
        self.look.push(drawn);
    }

    fn observed(&mut self, observation: &Observation) {
        self.looks += 1;
        self.look_over = true;
        if self.first_seen.is_none() {
            self.first_seen = Some(observation.clone());
            self.first_look = self.look.clone();
        }
        self.last_seen = Some(observation.clone());
    }

    /// A shorter route is a move done; any other change is a new plan.
    fn routed(&mut self, now: Timestamp, route: &[RouteStep]) {
        // Where an object is picked up is measured anew before every move; the plan is the objects and
        // places.
        let places = |steps: &[RouteStep]| steps.iter().map(|s| (s.0.clone(), s.2)).collect::<Vec<_>>();
        let (before, after) = (places(&self.route), places(route));
        if before.get(1..) == Some(&after[..]) {
            self.done.push((self.route[0].clone(), now));
        } else if before != after && !after.is_empty() {
            self.plans += 1;
            if self.plan.is_empty() {
                self.plan = route.to_vec();
            }
        }
        self.route = route.to_vec();
        self.bar.set_length((self.done.len() + route.len()) as u64);
        self.bar.set_position(self.done.len() as u64);
    }
}

impl Observer for Watch {
    fn on(&mut self, now: Timestamp, scene: Scene) {
        self.recorder.on(now, &scene);
        match scene {
            Scene::Status(status) => {
                self.bar.set_message(status.text());
                self.bar.tick();
            }
            Scene::Notice(notice) => {
                let level = if notice.alarm { "warn" } else { "info" };
                self.bar.println(format!("{:8.1} s  {}", now.as_secs_f64(), notice.text));
                self.log.push(LogRow { seconds: now.as_secs_f64(), level, text: notice.text.clone() });
            }
            Scene::Displayed(Displayed::Picture { image, views }) => {
                let detections = views.last().map_or(&[][..], |view| &view.detections);
                self.picture(image, detections);
            }
            Scene::Displayed(Displayed::Observed(observation)) => self.observed(observation),
            Scene::Displayed(Displayed::Sample { .. }) | Scene::Robot(_) => {}
            Scene::Route(route) => self.routed(now, route),
            Scene::Ended(report) => self.report = Some(report.clone()),
        }
    }
}
