//! The daemon's loop: inputs to the supervisor, its actions to the devices, workers, journal and people.
//!
//! In: the cell's model, open devices, an [`Office`] (jobs, commands, journal) and an [`Observer`] (whoever
//! shows or records what happens). Out: nothing but effects; it returns when it was told to stop and the arm
//! stands. One loop, in this order: devices first, then workers, then the office, then time. It waits for nothing but
//! the devices: the office has a thread of its own (`desk`), and what must not be done before it has written
//! something is kept back (`agenda`).

use crate::daemon::agenda::{Agenda, Next};
use crate::daemon::desk::{Desk, Reply};
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
use std::time::Instant;
use tokio::sync::mpsc;

/// Where jobs and operators' commands come from, and where what is done is written down.
pub trait Office: Send + 'static {
    /// Operators' commands since the last call. They are heard of before anything slow is done.
    fn commands(&mut self) -> Vec<Input>;

    /// Answers those commands and looks after the job files; a job if one is wanted.
    fn jobs(&mut self, now: Timestamp, wants_job: bool) -> Vec<Input>;

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

    /// Publishes the cell's status; called when nothing else is asked for.
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

/// How long the office may take for an answer, by the wall's clock: no motion begins before an entry is written, and
/// for so long no command is heard.
const OFFICE_LIMIT: std::time::Duration = std::time::Duration::from_secs(15);

/// An entry that takes longer than this is told: the arm waits for it, and who stands by should know why. A disk that did not
/// answer before has so long at the end.
const DISK_SLOW: std::time::Duration = std::time::Duration::from_secs(1);

/// How long the arm may take to stand still after the order to end.
const STOP_LIMIT: Duration = Duration::from_secs(3);

/// Why the daemon ended by itself.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The journal could not be written: without it no motion may be ordered.
    #[error("the journal cannot be written: {0}; the arm was stopped")]
    Journal(String),
    /// The state folder is not answered for: no entry is written, no command heard.
    #[error(
        "the state folder has not answered for {} s; the arm was stopped: see what ails its disk",
        OFFICE_LIMIT.as_secs()
    )]
    Disk,
    /// A defect of this program.
    #[error(
        "the thread of the state folder broke down; the arm was stopped: please report what was printed above"
    )]
    BrokeDown,
}

/// Everything the loop works with.
pub struct Shell<'a> {
    cell: Cell,
    hardware: Hardware,
    workers: Workers,
    desk: Desk,
    observer: &'a mut dyn Observer,
    requests: Requests,
    agenda: Agenda,
    /// When the office was asked last, in the cell's time, and since when an answer is due.
    polled: Timestamp,
    polling: Option<Instant>,
    /// Since when an entry or a result is being written, and whether it was told that it takes long.
    writing: Option<Instant>,
    told_slow: bool,
    /// The robot has said that it stopped, since it was last told to.
    stands: bool,
    last_status: Option<Status>,
    last_route: Vec<(String, Pose2, Pose2, bool)>,
}

/// Runs until `shutdown` is raised and the arm stands.
///
/// # Errors
/// [`RunError`]; the arm has been told to stop.
pub async fn run(mut shell: Shell<'_>, shutdown: &AtomicBool) -> Result<(), RunError> {
    let ended = turns(&mut shell, shutdown).await;
    shell.requests.stop_planning();
    if ended.is_err() {
        shell.command_robot(RobotCommand::Stop);
    }
    shell.await_stop().await;
    // A disk that does not answer must not keep this from ending; who has waited for it once does not wait as long again.
    let hangs = matches!(ended, Err(RunError::Disk));
    let limit = if hangs { DISK_SLOW } else { OFFICE_LIMIT };
    let Err(error) = shell.desk.close(limit).await else { return ended };
    tracing::error!(%error, "the last status may be missing");
    ended.and(Err(error))
}

/// Turn after turn, until the order to end or the journal's fault.
async fn turns(shell: &mut Shell<'_>, shutdown: &AtomicBool) -> Result<(), RunError> {
    let mut ending = false;
    loop {
        shell.take_in().await?;
        shell.observe_robot();
        // Commands that were accepted are heard before the end.
        if ending && shell.agenda.is_empty() && shell.polling.is_none() {
            return Ok(());
        }
        if !ending && shutdown.load(Ordering::Relaxed) {
            ending = true;
            shell.feed(Input::Shutdown);
        } else if !ending && shell.agenda.is_empty() {
            // While something is written, things wait in line; time would only make that line grow.
            shell.feed(Input::Tick);
        }
        shell.publish();
        if !ending {
            // After the status, on which it hangs what is refused.
            shell.poll();
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
        office: Box<dyn Office>,
        observer: &'a mut dyn Observer,
    ) -> Shell<'a> {
        Shell {
            cell,
            hardware,
            workers,
            desk: Desk::open(office),
            observer,
            requests: Requests::default(),
            agenda: Agenda::default(),
            polled: Timestamp::ZERO,
            polling: None,
            writing: None,
            told_slow: false,
            stands: false,
            last_status: None,
            last_route: Vec::new(),
        }
    }

    /// Everything that happened by now: devices, workers, office.
    async fn take_in(&mut self) -> Result<(), RunError> {
        for happening in self.hardware.next().await {
            self.stands |= matches!(happening, Happening::Robot(RobotEvent::Stopped));
            self.feed(match happening {
                Happening::Robot(event) => Input::Robot(event),
                Happening::Gripper(event) => Input::Gripper(event),
            });
        }
        while let Ok((number, answer)) = self.workers.answers.try_recv() {
            if let Some(input) = self.worker_answer(number, answer) {
                self.feed(input);
            }
        }
        while let Some(reply) = self.desk.reply().map_err(|_| RunError::BrokeDown)? {
            self.office_reply(reply)?;
        }
        let late = |since: Option<Instant>| since.is_some_and(|since| since.elapsed() > OFFICE_LIMIT);
        if late(self.polling) || late(self.writing) {
            return Err(RunError::Disk);
        }
        self.tell_slow();
        Ok(())
    }

    /// Says once that an entry takes long to be written.
    fn tell_slow(&mut self) {
        let slow = self.writing.is_some_and(|since| since.elapsed() > DISK_SLOW);
        if slow && !self.told_slow {
            let text = format!(
                "the state folder's disk has been writing an entry for {} s; no motion begins before it is written",
                DISK_SLOW.as_secs()
            );
            self.observer.on(self.hardware.now(), Event::Notice(&Notice { alarm: true, text }));
        }
        self.told_slow = slow;
    }

    /// Asks the office for what came in, from time to time.
    fn poll(&mut self) {
        let now = self.hardware.now();
        if self.polling.is_none() && now.since(self.polled) >= OFFICE_EVERY {
            (self.polled, self.polling) = (now, Some(Instant::now()));
            self.desk.poll(now, self.agenda.is_empty() && self.cell.wants_job());
        }
    }

    fn office_reply(&mut self, reply: Reply) -> Result<(), RunError> {
        match reply {
            Reply::Commands(inputs) => {
                self.polling = Some(Instant::now());
                inputs.into_iter().for_each(|input| self.feed(input));
            }
            Reply::Polled(inputs) => {
                self.polling = None;
                inputs.into_iter().for_each(|input| self.feed(input));
            }
            Reply::Written(written) => {
                written.map_err(RunError::Journal)?;
                self.writing = None;
                self.agenda.written();
                self.work_off();
            }
        }
        Ok(())
    }

    fn observe_robot(&mut self) {
        let now = self.hardware.now();
        if let Some(state) = self.hardware.robot().state() {
            self.observer.on(now, Event::Robot(state));
        }
    }

    /// Waits until the robot says that it has stopped, so that the order has left this computer; not for ever.
    async fn await_stop(&mut self) {
        let since = self.hardware.now();
        let waits = |hardware: &Hardware| {
            hardware.robot().state().is_some() && hardware.now().since(since) < STOP_LIMIT
        };
        while !self.stands && waits(&self.hardware) {
            let stopped = |h: &Happening| matches!(h, Happening::Robot(RobotEvent::Stopped));
            self.stands = self.hardware.next().await.iter().any(stopped);
        }
    }

    fn command_robot(&mut self, command: RobotCommand) -> Option<RobotEvent> {
        self.stands &= !matches!(command, RobotCommand::Stop);
        self.hardware.command_robot(command)
    }

    /// One input through the supervisor; its actions are carried out in order, as far as they may be by now.
    fn feed(&mut self, input: Input) {
        if self.agenda.add(input) {
            // Its turn comes when the disk is done; the arm does not move until then.
            self.command_robot(RobotCommand::Stop);
        }
        self.work_off();
    }

    /// Everything that is to be done, up to what has to be written first.
    fn work_off(&mut self) {
        while let Some(next) = self.agenda.due() {
            let now = self.hardware.now();
            match next {
                Next::Feed(input) => {
                    let outside = self.hardware.outside(now);
                    let actions = self.cell.step(now, &outside, input);
                    self.agenda.extend(actions);
                }
                Next::Act(action) => {
                    if let Some(input) = self.carry_out(now, action) {
                        self.agenda.add_first(input);
                    }
                }
            }
        }
    }

    /// Carries out one action; what comes of it at once is the next input.
    fn carry_out(&mut self, now: Timestamp, action: Action) -> Option<Input> {
        match action {
            Action::Robot(command) => return self.command_robot(command).map(Input::Robot),
            Action::Gripper(command) => self.hardware.command_gripper(command),
            Action::Capture { frames, table_from_camera } => {
                if !self.ask_eye(EyeRequest::Capture { frames, table_from_camera }) {
                    let trouble = CameraTrouble {
                        code: "camera_busy",
                        message: "the camera thread still works on an earlier request".to_string(),
                        remedy: "see what the camera says in the log",
                        lasting: false,
                    };
                    return Some(Input::Captured(Err(trouble)));
                }
            }
            Action::Observe(views) => {
                if !self.ask_eye(EyeRequest::Observe(views)) {
                    return Some(Input::Observed(Err("the camera thread does not answer".to_string())));
                }
            }
            Action::Plan(request) => {
                let stop = Arc::new(AtomicBool::new(false));
                let number = self.requests.next();
                self.requests.planning = Some(stop.clone());
                spawn_plan(number, *request, stop, self.workers.answers_in.clone());
            }
            Action::Journal(entry) => {
                self.writing = Some(Instant::now());
                self.desk.journal(entry);
            }
            Action::Finish(report) => {
                self.requests.stop_planning();
                self.observer.on(now, Event::Finished(&report));
                self.writing = Some(Instant::now());
                self.desk.finished(report);
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
        None
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

    fn publish(&mut self) {
        let now = self.hardware.now();
        let status = self.cell.status();
        if self.last_status.as_ref() == Some(&status) {
            return;
        }
        self.desk.status(status.clone());
        self.observer.on(now, Event::Status(&status));
        self.last_status = Some(status);
        let route = self.cell.route();
        if self.last_route != route {
            self.observer.on(now, Event::Route(&route));
            self.last_route = route;
        }
    }
}
