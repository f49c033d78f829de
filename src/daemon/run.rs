//! The daemon's loop: inputs to the supervisor, its actions to the devices, workers, journal and people.
//!
//! In: the cell's model, open devices, an [`Office`] (jobs, commands, journal) and an [`Observer`] (whoever
//! shows or records what happens). Out: nothing but effects; it returns when it was told to stop and the arm
//! stands. One loop, in this order: devices first, then workers, then the office, then time.

use crate::daemon::hardware::{Happening, Hardware};
use crate::daemon::workers::{Answer, EyeRequest, spawn_plan};
use crate::device::robot_types::RobotState;
use crate::geometry::pose::Pose2;
use crate::supervisor::cell::{Cell, Status};
use crate::supervisor::input::{Action, Input, JournalEntry, Notice, PlanAnswer};
use crate::supervisor::order::JobReport;
use crate::time::{Duration, Timestamp};
use crate::vision::image::Image;
use crate::vision::observe::{Observation, View};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::sync::mpsc;

/// Where jobs and operators' commands come from, and where what is done is written down.
pub trait Office {
    /// What came in since the last call: a job if one is wanted, commands in any case.
    fn poll(&mut self, now: Timestamp, wants_job: bool) -> Vec<Input>;

    /// Writes a line of the active job's journal; it is on disk when this returns.
    ///
    /// # Errors
    /// The cause; nothing moves on after it.
    fn journal(&mut self, entry: &JournalEntry) -> Result<(), String>;

    /// Writes the result of the active job.
    ///
    /// # Errors
    /// The cause.
    fn finished(&mut self, report: &JobReport) -> Result<(), String>;

    /// Publishes the cell's status.
    fn status(&mut self, status: &Status);
}

/// What happens, for people and records.
#[derive(Debug)]
pub enum Event<'a> {
    /// The status changed.
    Status(&'a Status),
    /// A sentence.
    Notice(&'a Notice),
    /// A picture with what was found in it.
    Picture {
        /// The picture.
        image: &'a Image,
        /// Its view: camera pose and markers.
        views: &'a [View],
    },
    /// The table as measured.
    Observed(&'a Observation),
    /// A new route: object, from, to, whether that is its goal.
    Route(&'a [(String, Pose2, Pose2, bool)]),
    /// The robot's state, as often as it comes.
    Robot(&'a RobotState),
    /// A job ended.
    Finished(&'a JobReport),
}

/// Hears of everything; must not block.
pub trait Observer {
    /// One event at the cell's time `now`.
    fn on(&mut self, now: Timestamp, event: Event);
}

/// The eye and the planner.
pub struct Workers {
    /// Requests to the eye.
    pub eye: mpsc::Sender<EyeRequest>,
    /// Answers of both.
    pub answers: mpsc::Receiver<Answer>,
    /// For planning runs to answer with.
    pub answers_in: mpsc::Sender<Answer>,
}

/// How often the office is asked, in the cell's time.
const OFFICE_EVERY: Duration = Duration::from_millis(200);

/// How long the arm may take to stand still after the order to end.
const STOP_LIMIT: Duration = Duration::from_secs(3);

/// Why the daemon ended by itself.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The journal could not be written: without it no motion may be ordered.
    #[error("the journal cannot be written: {0}; the arm was stopped")]
    Journal(String),
}

/// Everything the loop works with.
pub struct Shell<'a> {
    /// The state machine.
    pub cell: Cell,
    /// Robot and gripper.
    pub hardware: Hardware,
    /// Eye and planner.
    pub workers: Workers,
    /// Jobs, commands, journal.
    pub office: &'a mut dyn Office,
    /// Whoever watches.
    pub observer: &'a mut dyn Observer,
}

/// Runs until `shutdown` is raised and the arm stands.
///
/// # Errors
/// [`RunError::Journal`]; the arm has been told to stop.
pub async fn run(mut shell: Shell<'_>, shutdown: &AtomicBool) -> Result<(), RunError> {
    let mut last_office = Timestamp::ZERO;
    let mut last_status = None;
    let mut last_route = Vec::new();
    let plan_stop = Arc::new(AtomicBool::new(false));
    let mut ending: Option<Timestamp> = None;
    loop {
        let happenings = shell.hardware.next().await;
        for happening in happenings {
            let input = match happening {
                Happening::Robot(event) => Input::Robot(event),
                Happening::Gripper(event) => Input::Gripper(event),
            };
            shell.feed(input, &plan_stop)?;
        }
        while let Ok(answer) = shell.workers.answers.try_recv() {
            if let Some(input) = shell.worker_answer(answer) {
                shell.feed(input, &plan_stop)?;
            }
        }
        let now = shell.hardware.now();
        if let Some(state) = shell.hardware.robot().state() {
            shell.observer.on(now, Event::Robot(state));
        }
        if now.since(last_office) >= OFFICE_EVERY {
            last_office = now;
            for input in shell.office.poll(now, shell.cell.wants_job()) {
                shell.feed(input, &plan_stop)?;
            }
        }
        shell.feed(Input::Tick, &plan_stop)?;
        shell.publish(now, &mut last_status, &mut last_route);
        if shutdown.load(Ordering::Relaxed) && ending.is_none() {
            ending = Some(now);
            plan_stop.store(true, Ordering::Relaxed);
            shell.feed(Input::Shutdown, &plan_stop)?;
        }
        if ending.is_some_and(|since| shell.stands() || now.since(since) > STOP_LIMIT) {
            return Ok(());
        }
    }
}

impl Shell<'_> {
    /// One input through the supervisor; its actions are carried out in order.
    fn feed(&mut self, input: Input, plan_stop: &Arc<AtomicBool>) -> Result<(), RunError> {
        let mut inputs = vec![input];
        while let Some(input) = inputs.pop() {
            let now = self.hardware.now();
            let outside = self.hardware.outside(now);
            for action in self.cell.step(now, &outside, input) {
                if let Some(next) = self.carry_out(now, action, plan_stop)? {
                    inputs.push(next);
                }
            }
        }
        Ok(())
    }

    /// Carries out one action; what comes of it at once is the next input.
    fn carry_out(
        &mut self,
        now: Timestamp,
        action: Action,
        plan_stop: &Arc<AtomicBool>,
    ) -> Result<Option<Input>, RunError> {
        match action {
            Action::Robot(command) => return Ok(self.hardware.command_robot(command).map(Input::Robot)),
            Action::Gripper(command) => self.hardware.command_gripper(command),
            Action::Capture { frames, table_from_camera } => {
                if self.workers.eye.try_send(EyeRequest::Capture { frames, table_from_camera }).is_err() {
                    return Ok(Some(Input::Captured(Err("the camera thread does not answer".to_string()))));
                }
            }
            Action::Observe(views) => {
                if self.workers.eye.try_send(EyeRequest::Observe(views)).is_err() {
                    tracing::error!("the camera thread does not answer");
                }
            }
            Action::Plan(request) => {
                spawn_plan(*request, plan_stop.clone(), self.workers.answers_in.clone());
            }
            Action::Journal(entry) => {
                if let Err(cause) = self.office.journal(&entry) {
                    let outside = self.hardware.outside(now);
                    for stop in self.cell.step(now, &outside, Input::Shutdown) {
                        if let Action::Robot(command) = stop {
                            self.hardware.command_robot(command);
                        }
                    }
                    return Err(RunError::Journal(cause));
                }
            }
            Action::Finish(report) => {
                self.observer.on(now, Event::Finished(&report));
                self.office.finished(&report).map_err(RunError::Journal)?;
            }
            Action::Say(notice) => {
                if notice.alarm {
                    tracing::warn!("{}", notice.text);
                } else {
                    tracing::info!("{}", notice.text);
                }
                self.observer.on(now, Event::Notice(&notice));
            }
        }
        Ok(None)
    }

    fn worker_answer(&mut self, answer: Answer) -> Option<Input> {
        let now = self.hardware.now();
        match answer {
            Answer::Captured(Ok((views, image))) => {
                self.observer.on(now, Event::Picture { image: &image, views: &views });
                Some(Input::Captured(Ok(views)))
            }
            Answer::Captured(Err(reason)) => Some(Input::Captured(Err(reason))),
            Answer::Observed(result) => {
                if let Ok(observation) = &result {
                    self.observer.on(now, Event::Observed(observation));
                }
                Some(Input::Observed(result))
            }
            Answer::Planned(answer) => {
                if let PlanAnswer::Refused(reason) = &*answer {
                    tracing::warn!(reason, "plan refused");
                }
                Some(Input::Planned(answer))
            }
        }
    }

    fn publish(
        &mut self,
        now: Timestamp,
        last_status: &mut Option<Status>,
        last_route: &mut Vec<(String, Pose2, Pose2, bool)>,
    ) {
        let status = self.cell.status();
        if last_status.as_ref() != Some(&status) {
            self.office.status(&status);
            self.observer.on(now, Event::Status(&status));
            *last_status = Some(status);
            let route = self.cell.route();
            if *last_route != route {
                self.observer.on(now, Event::Route(&route));
                *last_route = route;
            }
        }
    }

    /// True when the arm stands, or nobody can say.
    fn stands(&self) -> bool {
        let now = self.hardware.now();
        !self.hardware.robot().fresh(now)
            || self
                .hardware
                .robot()
                .state()
                .is_none_or(|state| state.qd.iter().all(|speed| speed.abs() < 1e-3))
    }
}
