//! The demo while it runs: what is kept of it, its recording, and what it shows the person in front of the
//! screen.
//!
//! In: the daemon's events. Out: [`DemoObserver::kept`], from which the report is made, a recording, and
//! lines on stderr.

use crate::daemon::messages::Displayed;
use crate::daemon::recorder::Recorder;
use crate::daemon::shell::{Observer, Scene};
use crate::demo::kept::Kept;
use crate::report::run::LogRow;
use cell_machine::supervisor::order::RouteAction;
use cell_values::time::Timestamp;
use indicatif::{ProgressBar, ProgressStyle};

/// Shows, records and keeps a run.
pub struct DemoObserver {
    bar: ProgressBar,
    recorder: Recorder,
    /// Everything kept of it.
    pub kept: Kept,
}

impl DemoObserver {
    /// Shows progress on stderr and records.
    pub fn new(recorder: Recorder) -> DemoObserver {
        let bar = ProgressBar::new(0);
        let template = "{spinner} [{elapsed_precise}] {bar:24} {pos}/{len} moves  {msg}";
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        DemoObserver { bar, recorder, kept: Kept::default() }
    }

    /// Ends progress and recording; the recording's fault, if it had one.
    pub fn close(&mut self) -> Option<String> {
        self.bar.finish_and_clear();
        self.recorder.close()
    }

    fn routed(&mut self, now: Timestamp, route: &[RouteAction]) {
        self.kept.routed(now, route);
        let done = self.kept.done.len();
        self.bar.set_length((done + route.len()) as u64);
        self.bar.set_position(done as u64);
    }
}

impl Observer for DemoObserver {
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
                self.kept.log.push(LogRow {
                    seconds: Some(now.as_secs_f64()),
                    level,
                    text: notice.text.clone(),
                });
            }
            Scene::Displayed(Displayed::Picture { image, views }) => {
                let detections = views.last().map_or(&[][..], |view| &view.detections);
                self.kept.picture(image, detections);
            }
            Scene::Displayed(Displayed::Observed { seen, .. }) => self.kept.observed(seen),
            Scene::Displayed(Displayed::Sample { .. })
            | Scene::Robot(_)
            | Scene::Vacuum(_)
            | Scene::Turn
            | Scene::Machine(_)
            | Scene::Event(_)
            | Scene::Effect(_) => {}
            Scene::Route(route) => self.routed(now, route),
            Scene::Ended(report) => self.kept.report = Some(report.clone()),
        }
    }
}
