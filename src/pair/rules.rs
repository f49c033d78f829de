//! The rules that hold at all times, held against the truth of the simulated cell after every frame.
//!
//! In: what passes between machine and world, the state of both. Out: [`Breach`]es, each with its rule's
//! name. The rules know nothing of how the machine decides: they look at the arm, the vacuum, the disk, the
//! answers and the sight that a pick rests on. A rule that the machine's own word could satisfy would prove
//! nothing. Each file below is a few rules with what they have to remember.

mod approvals;
mod arming;
mod bodies;
mod calibration;
mod conduct;
mod contacts;
mod found;
mod holding;
mod intake;
mod limits;
mod rule;
mod solid;
mod texts;
mod truth;
mod waits;

pub use crate::pair::rules::rule::{Breach, Rule};

use crate::pair::rules::approvals::Approvals;
use crate::pair::rules::arming::Arming;
use crate::pair::rules::bodies::Bodies;
use crate::pair::rules::calibration::Calibration;
use crate::pair::rules::conduct::{Conduct, is_grip};
use crate::pair::rules::contacts::Contacts;
use crate::pair::rules::found::Found;
use crate::pair::rules::holding::Holding;
use crate::pair::rules::intake::Intake;
pub use crate::pair::rules::intake::ShellNow;
use crate::pair::rules::limits::Limits;
use crate::pair::rules::truth::Truth;
use crate::pair::rules::waits::Waits;
use crate::pair::shell::folder::Fate;
use crate::pair::shell::{Client, Happened};
use crate::pair::stage::Stage;
use cell_machine::device::gripper_types::ModbusRequest;
use cell_machine::device::robot_types::Link;
use cell_machine::event::{Effect, Event};
use cell_machine::machine::Machine;
use cell_machine::orders::{Order, Reply};
use cell_machine::supervisor::input::Record;
use cell_machine::supervisor::status::{Doing, Status};
use ur_sim::faults::Order as FaultOrder;
use ur_sim::simulator::Simulator;
use ur_sim::world::lock;

/// Breaches kept.
const MOST_BREACHES: usize = 64;

/// A rule that is broken in every frame is reported once in this time, 2 s.
const REPORTED_FRAMES: u64 = 1000;

/// The rules at work. See the module.
#[derive(Debug)]
pub struct Rules {
    frame: u64,
    breaches: Vec<Breach>,
    found: Found,
    conduct: Conduct,
    approvals: Approvals,
    calibration: Calibration,
    bodies: Bodies,
    contacts: Contacts,
    limits: Limits,
    arming: Arming,
    holding: Holding,
    intake: Intake,
    waits: Waits,
    shell: ShellNow,
}

impl Rules {
    /// For this cell, as its configuration and the simulation have it.
    pub fn new(stage: &Stage) -> Rules {
        let (model, gripper) = (&stage.model, &stage.world.gripper);
        Rules {
            frame: 0,
            breaches: Vec::new(),
            found: Found::default(),
            conduct: Conduct::default(),
            approvals: Approvals::default(),
            calibration: Calibration::new(&model.tolerances.reference),
            bodies: Bodies::new(stage),
            contacts: Contacts::default(),
            limits: Limits::new(model.arm.limits.clone(), gripper.flange_from_tool, model.round.clone()),
            arming: Arming::new(model.tolerances.arm_lapse.as_secs_f64()),
            holding: Holding::default(),
            intake: Intake::default(),
            waits: Waits::new(model.tolerances.retries),
            shell: ShellNow { runs: true, folder: Fate::Sound, cut_off: false },
        }
    }

    /// Breaches so far, oldest first.
    pub fn breaches(&self) -> &[Breach] {
        &self.breaches
    }

    /// Keeps what was found.
    fn report(&mut self) {
        for (rule, detail) in self.conduct.found.take().into_iter().chain(self.found.take()) {
            let last = self.breaches.iter().rev().find(|breach| breach.rule == rule);
            let known = last.is_some_and(|last| self.frame <= last.frame + REPORTED_FRAMES);
            if !known && self.breaches.len() < MOST_BREACHES {
                self.breaches.push(Breach { frame: self.frame, rule, detail });
            }
        }
    }

    /// The recorded run, carried out again, differs: once.
    pub fn replay_differs(&mut self, detail: &str) {
        if self.breaches.iter().all(|breach| breach.rule != Rule::ReplayDiffers) {
            self.found.push(Rule::ReplayDiffers, detail);
        }
    }

    /// A fault is brought about.
    pub fn disturbed(&mut self, order: &FaultOrder) {
        self.conduct.disturbed(order);
        self.waits.acted_on();
    }

    /// An order was given.
    pub fn ordered(&mut self, number: u64, order: &Order) {
        self.conduct.ordered(number, order);
        self.approvals.ordered(number, order);
        self.arming.ordered(self.frame, number, order);
        self.waits.acted_on();
    }

    /// Something happened to orders on their way to the machine.
    pub fn on_the_way(&mut self, frame: u64, happened: &Happened, clients: &[Client]) {
        self.intake.happened(frame, happened, clients);
    }

    /// The shell at the end of a frame.
    pub fn shell(&mut self, shell: ShellNow) {
        self.shell = shell;
        if !shell.runs {
            self.conduct.stands_still();
            self.arming.stands_still();
        }
    }

    /// The daemon is gone and comes back: nothing that it knew counts.
    pub fn restarted(&mut self) {
        self.conduct.restarted();
        self.approvals.restarted();
        self.arming.restarted();
        self.holding.restarted();
        self.contacts.ends();
        self.intake.restarted();
        self.limits.round_over();
        self.waits.acted_on();
    }

    /// A record has truly reached the disk.
    pub fn written(&mut self, number: u64) {
        self.conduct.written(number);
    }

    /// Drops what was written long ago: no acknowledgement comes so late.
    pub fn forget(&mut self) {
        self.conduct.forget();
    }

    /// Something has truly happened, whatever is reported of it to the machine.
    pub fn arrived(&mut self, event: &Event) {
        self.conduct.arrived(event);
        match event {
            Event::Job(job) => self.approvals.handed_out(job),
            Event::Round(order) => {
                self.limits.round_begins(Some(order));
                self.arming.given(true);
            }
            Event::Shutdown => self.intake.told_to_end(self.frame),
            Event::Commission { arm: true, .. } => self.arming.given(true),
            Event::Observed(number, Ok(_)) => self.calibration.observed(*number),
            _ => {}
        }
    }

    /// Something goes into the machine.
    pub fn event(&mut self, event: &Event) {
        self.conduct.event(event);
    }

    /// Something comes out of it.
    pub fn effect(&mut self, frame: u64, effect: &Effect, machine: &Machine) {
        self.frame = frame;
        if let Effect::Reply { number, reply } = effect {
            self.answered(*number, reply);
        }
        self.conduct.effect(frame, effect, machine);
        match effect {
            Effect::Commit { record, .. } => self.noted(record),
            Effect::Send(Link::Primary, bytes) => texts::check_program(bytes, &mut self.found),
            Effect::Send(Link::Dashboard, bytes) => texts::check_line(bytes, &mut self.found),
            Effect::Registers(ModbusRequest::Write { values, .. }) if values.iter().any(is_grip) => {
                self.grips();
            }
            Effect::Look { .. } => self.calibration.pictured(),
            Effect::Observe { number, partial, .. } => {
                self.calibration.put_together(*number, partial.is_none());
            }
            Effect::RoundOver(_) => {
                self.limits.round_over();
                self.arming.given(false);
            }
            _ => {}
        }
        self.report();
    }

    fn answered(&mut self, number: u64, reply: &Reply) {
        if reply.accepted && self.conduct.order(number) == Some(&Order::Calibrate) {
            self.limits.round_begins(None);
        }
        let decided = (self.conduct.order(number), reply);
        self.intake.answered(self.frame, number, decided, &mut self.found);
        self.approvals.answered(number, reply.accepted);
        self.arming.answered(self.frame, number, reply);
    }

    fn noted(&mut self, record: &Record) {
        match record {
            Record::Planned(note) => self.approvals.planned(note),
            Record::Intent { step, object, from, to, .. } => {
                self.approvals.intends(object, *from, *to);
                self.contacts.intends(object, *to);
                self.waits.intends(*step, &mut self.found);
            }
            Record::Ended(_) => {
                self.contacts.ends();
                self.waits.succeeded();
            }
            Record::Gripped { .. } => self.waits.succeeded(),
            Record::Found { .. }
            | Record::Approved
            | Record::Released { .. }
            | Record::Done { .. }
            | Record::Withdrawn { .. }
            | Record::LetGo { .. } => {}
        }
    }

    /// The vacuum is switched on: for a pick, where one is written down.
    fn grips(&mut self) {
        if !self.conduct.intends() {
            return;
        }
        if let Some(detail) = self.approvals.missing() {
            self.found.push(Rule::PickWithoutApproval, detail);
        }
        if let Some(detail) = self.calibration.invalid() {
            self.found.push(Rule::PickUncalibrated, detail);
        }
    }

    /// One controller frame is over.
    pub fn check(&mut self, frame: u64, machine: &Machine, simulator: &Simulator, status: Option<&Status>) {
        self.frame = frame;
        let truth = Truth::of(frame, simulator, machine, status);
        self.conduct.frame(&truth, machine, simulator);
        self.limits.frame(&truth, &mut self.found);
        self.arming.frame(&truth, &mut self.found);
        self.intake.frame(&truth, self.shell, &mut self.found);
        let world = lock(&simulator.core().world);
        self.calibration.frame(&truth, &world);
        self.waits.frame(&truth, &world, &mut self.found);
        self.holding.frame(&truth, &world, truth::gripper_answers(simulator), &mut self.found);
        let conduct = &self.conduct;
        let recovers = status.is_some_and(|status| matches!(status.doing, Doing::Recovering(_)));
        let astray = |object: &str| conduct.is_astray(object);
        self.contacts.frame(&truth, &world, astray, recovers, &mut self.found);
        self.bodies.frame(&truth, &world, astray, &mut self.found);
        drop(world);
        self.report();
    }
}
