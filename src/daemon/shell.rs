//! The daemon's loop: what happens goes into the machine, its effects go to sockets, workers, state folder
//! and people.
//!
//! In: a [`Machine`], sockets, and as they become known camera and perception, the state folder, an
//! [`Observer`]. Out: effects carried out; it decides nothing. One turn: wait for the first thing to happen,
//! take in everything that has happened, hand over the time, carry out what the machine wants. `celld run`,
//! `celld demo` and `celld calibrate` are composed from the same calls: [`Shell::open`],
//! [`Shell::identify`], [`Shell::commission`], [`Shell::round`], [`Shell::run`].

mod pace;
mod scene;
mod start;

pub use scene::{Observer, Scene};

use crate::daemon::intake::Sources;
use crate::daemon::last_answers::LastAnswers;
use crate::daemon::messages::{Displayed, Message};
use crate::daemon::shell::pace::{AtWork, LoopPace};
use crate::daemon::shell::scene::NoObserver;
use crate::daemon::sockets::{Addresses, Sockets};
use crate::daemon::store::{Keeper, Store};
use crate::daemon::watchdog::{Beat, Beats};
use crate::daemon::workers::{PerceptionSetup, SeeRequest, busy, spawn_perception, spawn_plan};
use crate::jobs::inbox::UNANSWERED_MAX;
use cell_edge::clock::{Clock, boot_now_s};
use cell_machine::device::robot_types::RobotState;
use cell_machine::event::{Arm, Effect, Event, News};
use cell_machine::intake::{HELD_UP_AFTER, Origin, Reach};
use cell_machine::machine::{Machine, MachineParameters};
use cell_machine::supervisor::cell::Supervisor;
use cell_machine::supervisor::mode::EndFault;
use cell_machine::supervisor::model::CellModel;
use cell_machine::supervisor::round::{RoundFault, RoundOrder};
use cell_machine::supervisor::status::Device;
use cell_values::time::Timestamp;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::time::Duration;
use tokio::sync::mpsc;

/// Why the arm did not become known, or a round did not begin.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// A device did not come up or stopped answering.
    #[error(
        "{what} within {seconds} s ({links}); see that `devices.robot` is its address, that it is powered \
         and in remote control, and try `ping`; for a simulated one start `celld sim`"
    )]
    Deadline {
        /// What was waited for.
        what: String,
        /// How long.
        seconds: u64,
        /// Which links are down, and why.
        links: String,
    },
    /// The operator stopped it.
    #[error("stopped by the operator")]
    Stopped,
    /// The round ended without all its pictures.
    #[error(transparent)]
    Round(#[from] RoundFault),
}

/// Things that may wait for the loop: at 50 readings a second, seconds' worth, and all orders besides
/// ([`UNANSWERED_MAX`]).
const QUEUE: usize = 256 + 2 * UNANSWERED_MAX;

/// For the program to end after a round.
const END_WITHIN: Duration = Duration::from_secs(10);

/// How long the state folder may take to write what is left at the end.
const CLOSE_WITHIN: Duration = Duration::from_secs(15);
const CLOSE_SILENT_WITHIN: Duration = Duration::from_secs(1);

/// A turn of the loop takes milliseconds.
const EVERY_TURN_WITHIN: std::time::Duration = std::time::Duration::from_secs(5);

/// The pictures of one request: each has its own limit below this, and the camera is started anew between
/// them.
const SEES_WITHIN: std::time::Duration = std::time::Duration::from_secs(180);

/// How many times its limit planning may take: each plan that the arm cannot carry out is followed by
/// another one; and what it may take beside that. The supervisor gives up waiting as late.
const PLANS_WITHIN: u32 = 4;
const PLANS_BESIDE: std::time::Duration = std::time::Duration::from_secs(600);

/// What the last turn brought that concerns the shell's caller.
#[derive(Default)]
struct Outcome {
    arm: Option<Arm>,
    round: Option<Result<(), RoundFault>>,
    end: Option<Result<(), EndFault>>,
}

/// Everything the loop works with.
pub struct Shell {
    machine: Machine,
    clock: Clock,
    sockets: Sockets,
    messages: mpsc::Receiver<Message>,
    messages_in: mpsc::Sender<Message>,
    perception: Option<SyncSender<(u64, SeeRequest)>>,
    /// Ends the planning run under way.
    planning: Option<Arc<AtomicBool>>,
    store: Option<Store>,
    outcome: Outcome,
    /// Events that were handed over between two turns, for the observer of the next one.
    unseen: Vec<(Timestamp, Event)>,
    at_work: AtWork,
    beats: Beats,
    beat: Beat,
    last_answers: LastAnswers,
    /// When robot and gripper last answered, in the cell's time.
    answered: [Option<Timestamp>; 2],
    pace: LoopPace,
    reach: Reach,
}

impl Shell {
    /// Opens the links; the devices need not be there yet.
    ///
    /// # Errors
    /// The on-robot program is no template.
    pub fn open(
        addresses: &Addresses,
        clock: Clock,
        parameters: MachineParameters,
    ) -> Result<Shell, cell_machine::device::program::TemplateError> {
        let (messages_in, messages) = mpsc::channel(QUEUE);
        let beats = Beats::default();
        let beat = beats.task("the loop", EVERY_TURN_WITHIN);
        Ok(Shell {
            machine: Machine::new(parameters)?,
            sockets: Sockets::new(addresses, clock.clone(), messages_in.clone()),
            last_answers: LastAnswers::timed_by(clock.clone()),
            clock,
            messages,
            messages_in,
            perception: None,
            planning: None,
            store: None,
            outcome: Outcome::default(),
            unseen: Vec::new(),
            at_work: AtWork::default(),
            beats,
            beat,
            answered: [None; 2],
            pace: LoopPace::default(),
            reach: Reach::default(),
        })
    }

    /// When each device answered last.
    pub fn last_answers(&self) -> LastAnswers {
        self.last_answers.clone()
    }

    /// Marks the devices that have answered since the last turn.
    fn mark_answers(&mut self) {
        let robot = self.machine.robot_state().map(|state| state.received);
        let gripper = self.machine.vacuum().map(|(at, _)| at);
        let devices = [Device::Robot, Device::Gripper];
        for ((device, at), before) in devices.into_iter().zip([robot, gripper]).zip(&mut self.answered) {
            if at.is_some() && at != *before {
                *before = at;
                self.last_answers.now(device);
            }
        }
    }

    /// The same, its tasks among `beats`.
    pub fn watched(self, beats: Beats) -> Shell {
        let beat = beats.task("the loop", EVERY_TURN_WITHIN);
        Shell { beats, beat, ..self }
    }

    /// The cell's time.
    pub fn now(&self) -> Timestamp {
        self.clock.now()
    }

    /// The robot as its last package showed it, unless that is too old to count on.
    pub fn robot_state(&self) -> Option<&RobotState> {
        self.machine.fresh_robot_state(self.now())
    }

    /// What of the robot is missing, one line each; empty when it is known and all links are up.
    pub fn missing(&self) -> Vec<String> {
        self.machine.missing()
    }

    /// One turn for a caller that only watches the robot.
    pub async fn listen(&mut self) {
        self.turn(&mut NoObserver).await;
    }

    /// Makes a cell of the machine; `arm` arms it without a person: simulated cells only.
    pub fn commission(&mut self, model: CellModel, arm: bool) {
        // Poses to look from take a part of a second to compute: now, and not while the arm's program waits
        // for a sign of life.
        model.views();
        self.pace = LoopPace::default();
        self.between_turns(Event::Commission { model: Box::new(model), arm });
    }

    /// From now on this is what the cell sees with.
    pub fn see_with(&mut self, perception: PerceptionSetup) {
        let beat = self.beats.task("the camera", SEES_WITHIN);
        self.perception =
            Some(spawn_perception(perception, self.clock.clone(), self.messages_in.clone(), beat));
    }

    /// From now on jobs and orders come from here, and what is done is written here.
    pub fn keep_in(&mut self, keeper: Box<dyn Keeper>, sources: Sources) {
        let (clock, events) = (self.clock.clone(), self.messages_in.clone());
        self.store = Some(Store::open(keeper, sources, clock, events, &self.beats));
    }

    /// Carries out a calibration round. The arm is at rest afterwards, and the program has ended, or was
    /// stopped and takes nothing but its end.
    ///
    /// # Errors
    /// What kept the robot from coming up or interrupted the round.
    pub async fn round(
        &mut self,
        order: RoundOrder,
        observer: &mut dyn Observer,
        stop: &dyn Fn() -> bool,
    ) -> Result<(), StartError> {
        self.pace = LoopPace::default();
        self.between_turns(Event::Round(Box::new(order)));
        let mut stopped = false;
        let ended = loop {
            self.turn(observer).await;
            if let Some(ended) = self.outcome.round.take() {
                break ended;
            }
            if stop() && !std::mem::replace(&mut stopped, true) {
                self.between_turns(Event::Order(0, cell_machine::orders::Order::Abort, Origin::OWN));
            }
        };
        let began = self.now();
        while self.machine.program_busy() {
            self.turn(observer).await;
            self.guard(began, END_WITHIN, "the on-robot program did not end", &|| false)?;
        }
        match ended {
            Err(_) if stopped => Err(StartError::Stopped),
            ended => Ok(ended?),
        }
    }

    /// Works until `shutdown` says so and the arm is at rest, or the state folder is lost. `shutdown` is
    /// called in every turn, with whether the cell is disarmed with nothing under way.
    ///
    /// # Errors
    /// [`EndFault`]; the arm was stopped.
    pub async fn run(
        mut self,
        observer: &mut dyn Observer,
        shutdown: &dyn Fn(bool) -> bool,
    ) -> Result<(), EndFault> {
        let mut ending = false;
        self.pace = LoopPace::default();
        let ended = loop {
            self.turn(observer).await;
            if let Some(ended) = self.outcome.end.take() {
                break ended;
            }
            let quiet = self.machine.supervisor().is_some_and(Supervisor::is_quiet);
            if !ending && shutdown(quiet) {
                ending = true;
                self.between_turns(Event::Shutdown);
            }
        };
        self.cancel_plan();
        // A disk that does not answer must not keep this from ending; what was waited for once is not waited
        // for as long again.
        let limit = if ended.is_err() { CLOSE_SILENT_WITHIN } else { CLOSE_WITHIN };
        let Some(store) = self.store.take() else { return ended };
        // Threads that still have something to send must find the channel open.
        let closed = store.close(limit);
        tokio::pin!(closed);
        loop {
            tokio::select! {
                closed = &mut closed => {
                    return if closed { ended } else { ended.and(Err(EndFault::Silent(limit.as_secs()))) };
                }
                _ = self.messages.recv() => {}
            }
        }
    }

    /// Waits for the first thing to happen, takes in everything that has, and carries out what comes of it.
    async fn turn(&mut self, observer: &mut dyn Observer) {
        self.beat.now();
        for (at, event) in std::mem::take(&mut self.unseen) {
            observer.on(at, Scene::Event(&event));
        }
        let due = self.machine.next_wake();
        let due = self.sockets.next_wake().map_or(due, |other| due.min(other));
        let wait = due.since(self.clock.now());
        let first = tokio::select! {
            first = self.messages.recv() => first,
            () = self.sockets.ready() => None,
            () = tokio::time::sleep(self.clock.nap(wait)) => None,
        };
        let mut events = Vec::new();
        events.extend(self.held_up());
        if let Some(message) = first {
            self.take(message, observer, &mut events);
        }
        while let Ok(message) = self.messages.try_recv() {
            self.take(message, observer, &mut events);
        }
        self.sockets.take(&mut events);
        if let Some(fault) = self.store.as_mut().and_then(Store::fault) {
            events.push(Event::StoreLost(fault));
        }
        let silent = self.store.as_ref().and_then(Store::silent);
        events.extend(self.reach.judge(silent).map(Event::OrdersReach));
        // The clock is read after the sockets: what lay in them is older than now.
        let now = self.clock.now();
        for event in events.into_iter().chain([Event::Time]) {
            self.hand_over(now, event, observer);
        }
        while let Some(effect) = self.machine.poll() {
            observer.on(now, Scene::Effect(&effect));
            self.carry_out(now, effect, observer);
        }
        self.sockets.taken_in();
        if let Some(state) = self.machine.robot_state() {
            observer.on(now, Scene::Robot(state));
        }
        if let Some((_, vacuum)) = self.machine.vacuum() {
            observer.on(now, Scene::Vacuum(vacuum));
        }
        observer.on(now, Scene::Machine(&self.machine));
        observer.on(now, Scene::Turn);
        self.mark_answers();
        self.last_answers.turned();
        self.beat.rests();
    }

    /// The loop has not come round for too long; what counts silence starts again then.
    fn held_up(&mut self) -> Option<Event> {
        let gap = self.pace.gap(self.clock.now());
        if gap <= HELD_UP_AFTER {
            return None;
        }
        self.beats.start_again(std::time::Instant::now());
        self.store.iter().for_each(Store::start_again);
        Some(Event::HeldUp(gap))
    }

    fn hand_over(&mut self, now: Timestamp, event: Event, observer: &mut dyn Observer) {
        observer.on(now, Scene::Event(&event));
        self.machine.handle(now, event);
    }

    /// Hands an event over while no observer is there.
    fn between_turns(&mut self, event: Event) {
        let now = self.clock.now();
        self.unseen.push((now, event.clone()));
        self.machine.handle(now, event);
    }

    fn take(&mut self, message: Message, observer: &mut dyn Observer, events: &mut Vec<Event>) {
        match message {
            Message::Event(event) => events.push(event),
            Message::Order(number, given) => {
                let origin = given.origin(boot_now_s());
                events.push(Event::Order(number, given.order, origin));
            }
            Message::Made(made) => events.extend(self.sockets.made(made)),
            Message::Displayed(displayed) => {
                if matches!(displayed, Displayed::Picture { .. } | Displayed::Sample { .. }) {
                    self.last_answers.now(Device::Camera);
                }
                observer.on(self.clock.now(), Scene::Displayed(&displayed));
            }
        }
    }

    fn carry_out(&mut self, now: Timestamp, effect: Effect, observer: &mut dyn Observer) {
        match effect {
            Effect::Connect(link) => self.sockets.connect(link),
            Effect::Close(link) => self.sockets.close(link),
            Effect::Send(link, bytes) => self.sockets.send(link, &bytes),
            Effect::Registers(request) => self.sockets.transact(request),
            Effect::Look { number, frames, table_from_camera } => {
                self.see(now, number, SeeRequest::Look { frames, table_from_camera }, observer);
            }
            Effect::Observe { number, views, partial, held } => {
                self.see(now, number, SeeRequest::Observe { views, partial, held }, observer);
            }
            Effect::Picture { number, pose, base_from_flange } => {
                self.see(now, number, SeeRequest::Picture { pose, base_from_flange }, observer);
            }
            Effect::Plan { number, request } => {
                let stop = Arc::new(AtomicBool::new(false));
                self.planning = Some(stop.clone());
                let beat = self.beats.task("the planner", request.time_limit * PLANS_WITHIN + PLANS_BESIDE);
                spawn_plan(number, *request, &self.clock, stop, self.messages_in.clone(), beat);
            }
            Effect::CancelPlan => self.cancel_plan(),
            Effect::Commit { number, record } => match &self.store {
                Some(store) => store.commit(number, record),
                None => self.hand_over(now, Event::Committed(number, Ok(())), observer),
            },
            Effect::Reply { number, reply } => {
                if let Some(store) = &self.store {
                    store.reply(number, reply);
                }
            }
            Effect::WantJob => {
                if let Some(store) = &self.store {
                    store.want_job();
                }
            }
            Effect::Notify(news) => self.notify(now, news, observer),
            Effect::RoundOver(result) => self.outcome.round = Some(result),
            Effect::End(result) => self.outcome.end = Some(result),
        }
    }

    fn notify(&mut self, now: Timestamp, news: News, observer: &mut dyn Observer) {
        match news {
            News::Identified(arm) => self.outcome.arm = Some(*arm),
            News::Notice(notice) => {
                let (job, step) = (self.at_work.job.as_deref(), self.at_work.step);
                if notice.alarm {
                    tracing::warn!(job, step, "{}", notice.text);
                } else {
                    tracing::info!(job, step, "{}", notice.text);
                }
                observer.on(now, Scene::Notice(&notice));
            }
            News::Status(status) => {
                observer.on(now, Scene::Status(&status));
                self.at_work = AtWork::of(&status);
                if let Some(store) = &self.store {
                    store.status(status);
                }
            }
            News::Route(route) => observer.on(now, Scene::Route(&route)),
            News::Ended(report) => observer.on(now, Scene::Ended(&report)),
        }
    }

    fn see(&mut self, now: Timestamp, number: u64, request: SeeRequest, observer: &mut dyn Observer) {
        let refused = match &self.perception {
            Some(perception) => perception.try_send((number, request)).err().map(|error| match error {
                TrySendError::Full((_, request)) | TrySendError::Disconnected((_, request)) => request,
            }),
            None => Some(request),
        };
        if let Some(request) = refused {
            self.hand_over(now, busy(number, &request), observer);
        }
    }

    fn cancel_plan(&mut self) {
        if let Some(stop) = self.planning.take() {
            stop.store(true, Ordering::Relaxed);
        }
    }
}
