//! The whole cell in a closed loop in virtual time: machine, simulator, network, disk and camera on one
//! thread.
//!
//! In: a [`Stage`] and a seed, then jobs, orders and faults. Out: what became of the jobs, the answers, the
//! breaches of the rules, and a trace that is the same, byte for byte, for the same seed. There is no
//! socket, no file, no clock and no other thread; a turn is one controller frame (2 ms), and everything that
//! takes time (network, disk, planner, detector, exposure) takes it from a seed. The daemon drives the same
//! machine over real sockets (`daemon::shell`).

mod adapter;
pub mod camera_view;
mod carry_out;
mod choice;
pub mod cuts;
pub mod disk;
pub mod endurance;
pub mod hands;
pub mod mirror;
pub mod network;
pub mod operator;
pub mod orders;
pub mod orders_page;
pub mod outcome;
pub mod page;
pub mod reactions;
pub mod rules;
pub mod run;
pub mod shell;
pub mod shell_jobs;
pub mod stage;
pub mod store;
pub mod storm;
pub mod sweep;
pub mod table;
pub mod thin_arm;
pub mod trace;
pub mod work;
pub mod worst;

pub use adapter::Adapter;
pub use choice::Choice;

use crate::pair::camera_view::CameraView;
use crate::pair::disk::Disk;
use crate::pair::mirror::Mirror;
use crate::pair::network::Network;
use crate::pair::operator::Operator;
use crate::pair::rules::Rules;
use crate::pair::shell::Shell;
use crate::pair::stage::Stage;
use crate::pair::store::Store;
use crate::pair::trace::Trace;
use cell_machine::device::program::TemplateError;
use cell_machine::event::Event;
use cell_machine::intake::Origin;
use cell_machine::machine::Machine;
use cell_machine::orders::{Order, Reply};
use cell_machine::supervisor::input::Notice;
use cell_machine::supervisor::order::{JobOrder, JobReport};
use cell_machine::supervisor::round::{RoundFault, RoundOrder};
use cell_machine::supervisor::status::Status;
use cell_replay::{Piece, Replayed};
use cell_values::time::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use ur_sim::faults::{FaultError, Order as FaultOrder, Planned};
use ur_sim::motion::FRAME_SECONDS;
use ur_sim::simulator::{Simulator, SimulatorError};
use ur_sim::world::lock;

/// Why a closed loop cannot be set up.
#[derive(Debug, thiserror::Error)]
pub enum PairError {
    /// The simulator.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
    /// The machine.
    #[error(transparent)]
    Machine(#[from] TemplateError),
    /// Camera or detector.
    #[error("camera: {0}")]
    CameraView(String),
    /// A fault planned for the start is impossible.
    #[error(transparent)]
    Fault(#[from] FaultError),
}

/// How the daemon's process ends, for restarts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loss {
    /// SIGKILL: the process is gone, controller and gripper go on.
    Killed,
    /// Power of the PC: the same for the cell.
    PowerCut,
}

/// An answer that takes its time.
struct Later {
    due: u64,
    event: Event,
}

/// The closed loop. See the module.
pub struct Pair {
    stage: Stage,
    choice: Choice,
    frame: u64,
    simulator: Simulator,
    machine: Machine,
    network: Network,
    disk: Disk,
    camera_view: CameraView,
    store: Store,
    shell: Shell,
    rng: ChaCha8Rng,
    later: Vec<Later>,
    due: Vec<Event>,
    rules: Rules,
    /// What was done, for comparison.
    pub trace: Trace,
    adapter: Option<Box<dyn Adapter>>,
    mirror: Option<Mirror>,
    /// Events that the adapter made up: the rules do not take them for something that happened.
    made_up: Vec<Event>,
    orders: u64,
    replies: VecDeque<(u64, Reply)>,
    notices: Vec<Notice>,
    status: Option<Status>,
    /// Number of the last plan that people are shown, and who approves plans.
    plan_shown: Option<u64>,
    operator: Option<Operator>,
    /// Runs of the daemon so far.
    runs: u64,
    /// The daemon has ended by itself.
    ended: Option<Result<(), String>>,
    /// How the last calibration round ended.
    round_over: Option<Result<(), RoundFault>>,
}

impl Pair {
    /// A cell just switched on, with the daemon just started.
    ///
    /// # Errors
    /// [`PairError`].
    pub fn new(stage: Stage, choice: Choice) -> Result<Pair, PairError> {
        let Choice { seed, eye, weather, keep_trace, replay, .. } = choice;
        let simulator = Simulator::new(stage.controller.clone(), stage.world.clone(), seed, Vec::new())?;
        let camera_view = CameraView::new(eye, &stage, seed).map_err(PairError::CameraView)?;
        let machine = Machine::new(stage.parameters.clone())?;
        let mut pair = Pair {
            network: Network::new(&simulator, seed, weather.unwrap_or(stage.weather)),
            mirror: replay.then(|| Mirror::new(seed, Timestamp::ZERO, &machine)),
            machine,
            simulator,
            camera_view,
            rules: Rules::new(&stage),
            stage,
            choice,
            frame: 0,
            disk: Disk::new(seed),
            store: Store::default(),
            shell: Shell::default(),
            rng: ChaCha8Rng::seed_from_u64(seed ^ 0x7061_6972),
            later: Vec::new(),
            due: Vec::new(),
            trace: Trace::new(keep_trace),
            adapter: None,
            made_up: Vec::new(),
            orders: 0,
            replies: VecDeque::new(),
            notices: Vec::new(),
            status: None,
            plan_shown: None,
            operator: None,
            runs: 0,
            ended: None,
            round_over: None,
        };
        pair.stage.at_start.clone().into_iter().try_for_each(|planned| pair.fault(planned))?;
        Ok(pair)
    }

    /// Puts something between machine and world.
    pub fn adapt(&mut self, adapter: Box<dyn Adapter>) {
        self.adapter = Some(adapter);
    }

    /// From now on a person approves the plans that wait for it, after a while by seed.
    pub fn approve_plans(&mut self) {
        self.operator = Some(Operator::new(self.choice.seed));
    }

    /// The cell's time: zero when the cell was switched on.
    pub fn now(&self) -> Timestamp {
        Timestamp::from_nanos(self.frame * 2_000_000)
    }

    /// Simulated seconds so far.
    pub fn seconds(&self) -> f64 {
        self.frame as f64 * FRAME_SECONDS
    }

    /// The machine.
    pub fn machine(&self) -> &Machine {
        &self.machine
    }

    /// The simulator: truth, for rules and reports.
    pub fn simulator(&self) -> &Simulator {
        &self.simulator
    }

    /// The disk under the journal.
    pub fn disk(&mut self) -> &mut Disk {
        &mut self.disk
    }

    /// How the cell sees.
    pub fn camera_view(&mut self) -> &mut CameraView {
        &mut self.camera_view
    }

    /// Jobs that wait, and reports of those that ended.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// The daemon's status, once there is one.
    pub fn status(&self) -> Option<&Status> {
        self.status.as_ref()
    }

    /// Sentences so far, oldest first.
    pub fn notices(&self) -> &[Notice] {
        &self.notices
    }

    /// How the daemon ended, if it has ended by itself.
    pub fn ended(&self) -> Option<&Result<(), String>> {
        self.ended.as_ref()
    }

    /// Breaches of the rules so far.
    pub fn breaches(&self) -> &[rules::Breach] {
        self.rules.breaches()
    }

    /// How much of the run was carried out again, where [`Choice::replay`] is set.
    pub fn replayed(&self) -> Option<Replayed> {
        self.mirror.as_ref().map(Mirror::so_far)
    }

    /// Keeps the recording from now on, where [`Choice::replay`] is set.
    pub fn keep_pieces(&mut self) {
        let now = self.now();
        if let Some(mirror) = &mut self.mirror {
            mirror.keep(now, &self.machine);
        }
    }

    /// The recording since then.
    pub fn take_pieces(&mut self) -> Vec<Piece> {
        self.mirror.as_mut().map(Mirror::kept).unwrap_or_default()
    }

    /// Reports of jobs that have ended, oldest first.
    pub fn reports(&self) -> &[JobReport] {
        self.store.reports()
    }

    /// Hands in a job.
    pub fn submit(&mut self, order: JobOrder) {
        self.store.submit(order);
    }

    /// Has a calibration round carried out, as `celld calibrate` does; its pictures are with the camera.
    pub fn visit(&mut self, order: RoundOrder) {
        self.round_over = None;
        self.trace
            .line(self.frame, || format!("round of {} poses", order.poses.len() + order.crossings.len()));
        self.due.push(Event::Round(Box::new(order)));
    }

    /// How the last calibration round ended; `None` while it is under way.
    pub fn round_over(&self) -> Option<&Result<(), RoundFault>> {
        self.round_over.as_ref()
    }

    /// Gives an order; its number.
    pub fn order(&mut self, order: Order) -> u64 {
        self.orders += 1;
        self.rules.ordered(self.orders, &order);
        self.trace.line(self.frame, || format!("order {} {order:?}", self.orders));
        self.due.push(Event::Order(self.orders, order, Origin::OWN));
        self.orders
    }

    /// The shell around the machine.
    pub fn shell(&mut self) -> &mut Shell {
        &mut self.shell
    }

    /// celld is ordered to end, as by SIGTERM.
    pub fn terminate(&mut self) {
        self.trace.line(self.frame, || "celld is ordered to end".to_string());
        self.due.push(Event::Shutdown);
    }

    /// celld's process stands still for so many seconds, as after SIGSTOP.
    pub fn stand_still(&mut self, seconds: f64) {
        self.trace.line(self.frame, || format!("celld stands still for {seconds:.3} s"));
        self.shell.stop(self.frame + 1, (seconds / FRAME_SECONDS) as u64);
    }

    /// The answers that have come, oldest first.
    pub fn take_replies(&mut self) -> Vec<(u64, Reply)> {
        self.replies.drain(..).collect()
    }

    /// Brings a fault about now, or plans it.
    ///
    /// # Errors
    /// It names something that is not there, or is impossible now.
    pub fn fault(&mut self, planned: Planned) -> Result<(), FaultError> {
        self.trace.line(self.frame, || format!("fault {}", planned.order.name));
        self.rules.disturbed(&planned.order);
        self.simulator.core().injector.submit(vec![planned])
    }

    /// Brings a fault about now.
    ///
    /// # Errors
    /// As [`Pair::fault`].
    pub fn fault_now(&mut self, order: FaultOrder) -> Result<(), FaultError> {
        self.fault(Planned { at: None, order })
    }

    /// Bytes that are none of the protocol's come in on a link.
    pub fn garble(&mut self, link: cell_machine::device::robot_types::Link) {
        self.trace.line(self.frame, || format!("garbage on {link}"));
        let bytes = (0..64).map(|_| self.rng.random::<u8>()).chain(*b"\x00\x02\xff\n\n").collect();
        self.due.push(Event::Received(link, bytes));
    }

    /// The process that runs the machine is gone, and is started anew.
    ///
    /// # Errors
    /// The on-robot program is no template.
    pub fn restart(&mut self, loss: Loss) -> Result<(), TemplateError> {
        self.trace.line(self.frame, || format!("restart {loss:?}"));
        self.runs += 1;
        self.network.close_all(&mut self.simulator);
        self.disk.cut();
        self.store.recover(self.disk.durable());
        self.camera_view.forget();
        self.later.clear();
        self.due.clear();
        self.status = None;
        self.ended = None;
        self.rules.restarted();
        self.shell.restarted();
        let mut parameters = self.stage.parameters.clone();
        parameters.nonce_seed = parameters.nonce_seed.wrapping_add(1_000_003 * self.runs);
        self.machine = Machine::new(parameters)?;
        let now = self.now();
        if let Some(mirror) = &mut self.mirror {
            mirror.restarted(now, &self.machine);
        }
        Ok(())
    }

    /// One controller frame.
    pub fn step(&mut self) {
        self.frame += 1;
        self.simulator.advance();
        let mut events = std::mem::take(&mut self.due);
        self.network.step(self.frame, &mut self.simulator, &mut events);
        if !self.take_orders(&mut events) {
            // What has come lies in the kernel until the process goes on.
            self.due = events;
            return self.rules.check(self.frame, &self.machine, &self.simulator, None);
        }
        self.take_commits(&mut events);
        self.take_looks();
        self.take_later(&mut events);
        events.extend(self.store.hand_out().map(|job| Event::Job(Box::new(job))));
        events.iter().for_each(|event| self.rules.arrived(event));
        let events = self.pass(events);
        let now = self.now();
        if self.ended.is_none() && (!events.is_empty() || self.machine.next_wake() <= now) {
            self.turn(events);
        }
        self.rules.check(self.frame, &self.machine, &self.simulator, self.status.as_ref());
        self.take_approval();
    }

    /// Until `over`, but at most so many simulated seconds; false when it is not over then.
    pub fn run_until(&mut self, seconds: f64, mut over: impl FnMut(&Pair) -> bool) -> bool {
        let end = self.frame + (seconds / FRAME_SECONDS) as u64;
        while self.frame < end {
            self.step();
            if over(self) {
                return true;
            }
        }
        false
    }

    fn turn(&mut self, events: Vec<Event>) {
        let now = self.now();
        for event in events {
            self.trace.event(self.frame, &event);
            self.rules.event(&event);
            self.hand_over(now, event);
        }
        self.hand_over(now, Event::Time);
        while let Some(effect) = self.machine.poll() {
            if let Some(mirror) = &mut self.mirror {
                mirror.effect(now, &effect);
            }
            let mut passed = Vec::new();
            let mut made_up = Vec::new();
            match &mut self.adapter {
                None => passed.push(effect),
                Some(adapter) => adapter.effect(effect, &mut passed, &mut made_up),
            }
            self.made_up.extend(made_up);
            passed.into_iter().for_each(|effect| self.carry_out(effect));
        }
        if let Some(mirror) = &mut self.mirror {
            mirror.turned(now, &self.machine);
            if let Some(fault) = mirror.fault() {
                self.rules.replay_differs(fault);
            }
        }
    }

    fn hand_over(&mut self, now: Timestamp, event: Event) {
        if let Some(mirror) = &mut self.mirror {
            match &mut self.adapter {
                None => mirror.event(now, &event),
                Some(adapter) => mirror.event(now, &adapter.recorded(event.clone())),
            }
        }
        self.machine.handle(now, event);
    }

    /// What an adapter makes of these events; the events themselves where there is none.
    fn pass(&mut self, events: Vec<Event>) -> Vec<Event> {
        let Some(adapter) = &mut self.adapter else { return events };
        let (mut effects, mut passed) = (Vec::new(), std::mem::take(&mut self.made_up));
        adapter.watch(&self.simulator);
        adapter.frame(&self.machine, &mut effects, &mut passed);
        events.into_iter().for_each(|event| adapter.event(event, &mut passed));
        effects.into_iter().for_each(|effect| self.carry_out(effect));
        passed
    }

    fn take_commits(&mut self, events: &mut Vec<Event>) {
        while let Some((number, result)) = self.disk.step(self.frame) {
            if let Ok(record) = &result {
                self.store.written(record);
                self.rules.written(number);
            }
            events.push(Event::Committed(number, result.map(drop)));
        }
    }

    fn take_looks(&mut self) {
        let core = self.simulator.core();
        let world = lock(&core.world);
        let now_s = world.now_s();
        let Some(seen) = self.camera_view.step(&world, now_s) else { return };
        self.due.extend(seen.exposed);
        let due = self.frame + (seen.evaluation_s / FRAME_SECONDS) as u64 + 1;
        self.later.push(Later { due, event: seen.event });
    }

    fn take_later(&mut self, events: &mut Vec<Event>) {
        if self.later.is_empty() {
            return;
        }
        let frame = self.frame;
        events.extend(self.later.extract_if(.., |later| later.due <= frame).map(|later| later.event));
    }
}
