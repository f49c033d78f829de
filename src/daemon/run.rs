//! The daemon's loop: inputs to the supervisor, its actions to the devices, workers, journal and people.
//!
//! In: the cell's model, open devices, an [`Office`] (jobs, commands, journal) and an [`Observer`] (whoever
//! shows or records what happens). Out: nothing but effects; it returns when it was told to stop and the arm
//! stands. One loop, in this order: devices first, then workers, then the office, then time.

use crate::daemon::hardware::{Happening, Hardware};
use crate::daemon::workers::{Answer, EyeRequest, Numbered, spawn_plan};
use crate::device::robot_types::{RobotCommand, RobotEvent, RobotState};
use crate::geometry::pose::Pose2;
use crate::supervisor::cell::{Cell, Status};
use crate::supervisor::input::{Action, CameraTrouble, Input, JournalEntry, Notice, PlanAnswer};
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
    /// Requests to the eye, numbered.
    pub eye: mpsc::Sender<(u64, EyeRequest)>,
    /// Answers of both, with the numbers of their requests.
    pub answers: mpsc::Receiver<Numbered>,
    /// For planning runs to answer with.
    pub answers_in: mpsc::Sender<Numbered>,
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
    cell: Cell,
    hardware: Hardware,
    workers: Workers,
    office: &'a mut dyn Office,
    observer: &'a mut dyn Observer,
    requests: Requests,
}

/// Runs until `shutdown` is raised and the arm stands.
///
/// # Errors
/// [`RunError::Journal`]; the arm has been told to stop.
pub async fn run(mut shell: Shell<'_>, shutdown: &AtomicBool) -> Result<(), RunError> {
    let ended = turns(&mut shell, shutdown).await;
    shell.requests.stop_planning();
    if ended.is_err() {
        shell.hardware.command_robot(RobotCommand::Stop);
    }
    shell.await_stop().await;
    ended
}

/// Turn after turn, until the order to end or the journal's fault.
async fn turns(shell: &mut Shell<'_>, shutdown: &AtomicBool) -> Result<(), RunError> {
    let mut last_office = Timestamp::ZERO;
    let mut last_status = None;
    let mut last_route = Vec::new();
    loop {
        for happening in shell.hardware.next().await {
            shell.feed(match happening {
                Happening::Robot(event) => Input::Robot(event),
                Happening::Gripper(event) => Input::Gripper(event),
            })?;
        }
        while let Ok((number, answer)) = shell.workers.answers.try_recv() {
            if let Some(input) = shell.worker_answer(number, answer) {
                shell.feed(input)?;
            }
        }
        let now = shell.hardware.now();
        if let Some(state) = shell.hardware.robot().state() {
            shell.observer.on(now, Event::Robot(state));
        }
        if now.since(last_office) >= OFFICE_EVERY {
            last_office = now;
            for input in shell.office.poll(now, shell.cell.wants_job()) {
                shell.feed(input)?;
            }
        }
        shell.feed(Input::Tick)?;
        shell.publish(now, &mut last_status, &mut last_route);
        if shutdown.load(Ordering::Relaxed) {
            return shell.feed(Input::Shutdown);
        }
    }
}

/// Numbers of the requests to the workers: an answer to anything but the last one is too late to count.
#[derive(Debug, Default)]
struct Requests {
    last: u64,
    /// Ends the planning run under way.
    planning: Option<Arc<AtomicBool>>,
}

impl Requests {
    fn next(&mut self) -> u64 {
        self.stop_planning();
        self.last += 1;
        self.last
    }

    fn stop_planning(&mut self) {
        if let Some(stop) = self.planning.take() {
            stop.store(true, Ordering::Relaxed);
        }
    }
}

impl<'a> Shell<'a> {
    /// The loop's parts put together.
    pub fn new(
        cell: Cell,
        hardware: Hardware,
        workers: Workers,
        office: &'a mut dyn Office,
        observer: &'a mut dyn Observer,
    ) -> Shell<'a> {
        Shell { cell, hardware, workers, office, observer, requests: Requests::default() }
    }

    /// Waits until the robot says that it has stopped, so that the order has left this computer; not for ever.
    async fn await_stop(&mut self) {
        let since = self.hardware.now();
        while self.hardware.robot().state().is_some() && self.hardware.now().since(since) < STOP_LIMIT {
            let stopped = |h: &Happening| matches!(h, Happening::Robot(RobotEvent::Stopped));
            if self.hardware.next().await.iter().any(stopped) {
                return;
            }
        }
    }

    /// One input through the supervisor; its actions are carried out in order.
    fn feed(&mut self, input: Input) -> Result<(), RunError> {
        let mut inputs = vec![input];
        while let Some(input) = inputs.pop() {
            let now = self.hardware.now();
            let outside = self.hardware.outside(now);
            for action in self.cell.step(now, &outside, input) {
                if let Some(next) = self.carry_out(now, action)? {
                    inputs.push(next);
                }
            }
        }
        Ok(())
    }

    /// Carries out one action; what comes of it at once is the next input.
    fn carry_out(&mut self, now: Timestamp, action: Action) -> Result<Option<Input>, RunError> {
        match action {
            Action::Robot(command) => return Ok(self.hardware.command_robot(command).map(Input::Robot)),
            Action::Gripper(command) => self.hardware.command_gripper(command),
            Action::Capture { frames, table_from_camera } => {
                if !self.ask_eye(EyeRequest::Capture { frames, table_from_camera }) {
                    let trouble = CameraTrouble {
                        code: "camera_busy",
                        message: "the camera thread still works on an earlier request".to_string(),
                        remedy: "see what the camera says in the log",
                        lasting: false,
                    };
                    return Ok(Some(Input::Captured(Err(trouble))));
                }
            }
            Action::Observe(views) => {
                if !self.ask_eye(EyeRequest::Observe(views)) {
                    return Ok(Some(Input::Observed(Err("the camera thread does not answer".to_string()))));
                }
            }
            Action::Plan(request) => {
                let stop = Arc::new(AtomicBool::new(false));
                let number = self.requests.next();
                self.requests.planning = Some(stop.clone());
                spawn_plan(number, *request, stop, self.workers.answers_in.clone());
            }
            Action::Journal(entry) => self.office.journal(&entry).map_err(RunError::Journal)?,
            Action::Finish(report) => {
                self.requests.stop_planning();
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

    /// False when the eye has more to do than it can.
    fn ask_eye(&mut self, request: EyeRequest) -> bool {
        let number = self.requests.next();
        self.workers.eye.try_send((number, request)).is_ok()
    }

    fn worker_answer(&mut self, number: u64, answer: Answer) -> Option<Input> {
        let now = self.hardware.now();
        if number != self.requests.last {
            tracing::debug!(number, "an answer nobody waits for any more");
            return None;
        }
        match answer {
            Answer::Captured(Ok((views, image))) => {
                self.observer.on(now, Event::Picture { image: &image, views: &views });
                Some(Input::Captured(Ok(views)))
            }
            Answer::Captured(Err(trouble)) => Some(Input::Captured(Err(trouble))),
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
}
