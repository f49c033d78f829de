//! The rules that hold at all times (design, section 7), held against the truth of the simulated cell after
//! every frame.
//!
//! In: what passes between machine and world, the state of both. Out: [`Breach`]es, each with its rule's
//! name. The rules know nothing of how the machine decides: they look at the arm, the vacuum, the disk, the
//! answers and the sight that a pick rests on. A rule that the machine's own word could satisfy would prove
//! nothing.

use crate::cell::device::gripper::{Channels, ModbusRequest};
use crate::cell::device::robot_types::Link;
use crate::cell::event::{Effect, Event, News};
use crate::cell::machine::Machine;
use crate::cell::orders::{Order, Reply};
use crate::cell::supervisor::input::Record;
use crate::cell::supervisor::status::{Doing, Status};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use ur_sim::faults::link::LinkName;
use ur_sim::faults::{Fault, Order as FaultOrder, RobotFault};
use ur_sim::simulator::Simulator;
use ur_sim::world::lock;
use ur_sim::world::vacuum::{Channel, VacuumMode};

/// A rule, by a name that stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rule {
    /// The arm begins to move although the cell is disarmed and no pick-n-place is under way.
    MotionWhileDisarmed,
    /// The arm begins to move while a record that it depends on is not on disk.
    MotionBeforeCommit,
    /// The arm begins to move on a state older than 100 ms.
    MotionOnStaleState,
    /// The arm moves for a program that is not the one uploaded last.
    MotionOfOldProgram,
    /// The arm moves two and a half seconds after a stop was reported, or has been at rest since and
    /// moves again.
    MotionAfterStop,
    /// The vacuum is switched off while the tool moves.
    VacuumOffInMotion,
    /// The vacuum is switched off although what is held is not at its place, and no person ordered it.
    VacuumOffAway,
    /// Something is held and the vacuum is not read.
    HeldUnwatched,
    /// A pick is meant on a sight older than the last pick, place, stop or release.
    PickOnOldSight,
    /// A record is reported to the machine as on disk, and it is not.
    AcknowledgedNotWritten,
    /// An answer says what is not so.
    AnswerNotTrue,
    /// An order was answered twice, or an answer came for none.
    AnswerWithoutOrder,
    /// An order has no answer.
    OrderUnanswered,
    /// The status says armed and the cell is not, or the other way round.
    StatusNotTrue,
    /// Arming was accepted although no state of the robot comes, safety forbids motion, or something is held.
    ArmedWithGateClosed,
    /// A connection was lost and the cell is armed all the same.
    ArmedThroughLinkLoss,
    /// A safety stop was acknowledged by celld.
    SafetyAcknowledged,
    /// A motion begins although the pendant was switched to local control a while ago.
    MotionInLocalControl,
    /// Power, brakes or a program are ordered of the robot although the cell is disarmed.
    StartedWhileDisarmed,
}

impl Rule {
    /// All of them.
    pub const ALL: [Rule; 19] = [
        Rule::MotionWhileDisarmed,
        Rule::MotionBeforeCommit,
        Rule::MotionOnStaleState,
        Rule::MotionOfOldProgram,
        Rule::MotionAfterStop,
        Rule::VacuumOffInMotion,
        Rule::VacuumOffAway,
        Rule::HeldUnwatched,
        Rule::PickOnOldSight,
        Rule::AcknowledgedNotWritten,
        Rule::AnswerNotTrue,
        Rule::AnswerWithoutOrder,
        Rule::OrderUnanswered,
        Rule::StatusNotTrue,
        Rule::ArmedWithGateClosed,
        Rule::ArmedThroughLinkLoss,
        Rule::SafetyAcknowledged,
        Rule::MotionInLocalControl,
        Rule::StartedWhileDisarmed,
    ];
}

/// A rule that was broken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Breach {
    /// When, in controller frames.
    pub frame: u64,
    /// Which.
    pub rule: Rule,
    /// What was seen.
    pub detail: String,
}

/// The arm counts as moving above this joint speed, rad/s.
const MOVES_RAD_S: f64 = 0.005;

/// A state may be this old when a motion begins: 100 ms at the order, then network and program.
const STATE_AGE_FRAMES: u64 = 75;

/// A link that brings no state for so long is gone, 90 ms: celld stops the arm after 100 ms.
const SILENT_FRAMES: u64 = 45;

/// A gripper that answers later than this counts as silent.
const ANSWER_WITHIN: Duration = Duration::from_millis(200);

/// A stop may take this long.
const STOP_FRAMES: u64 = 1250;

/// An arm that has not moved for so long has been at rest.
const STOOD_FRAMES: u64 = 10;

/// What began while its stop was on the way may last this long.
const OVERTAKEN_FRAMES: u64 = 500;

/// The on-robot program's watchdog and the stop after it.
const WATCHDOG_FRAMES: u64 = 350;

/// Something held is read at least this often; a lost gripper is noticed first.
const WATCH_FRAMES: u64 = 500;

/// What was sent has arrived after this long: network and one frame of the program, 100 ms.
const ON_ITS_WAY_FRAMES: u64 = 50;

/// An order is answered within this, the slowest being the release of a gripper that does not answer.
const ANSWER_FRAMES: u64 = 5000;

/// After this long celld has to know that a gate is closed.
const KNOWN_FRAMES: u64 = 250;

/// After this long celld has to know of local control: it polls the dashboard once a second.
const LOCAL_FRAMES: u64 = 1000;

/// Height over its place at which an object may be let go, m: press and noise.
const PLACED_WITHIN_M: f64 = 0.004;

/// Breaches kept.
const MOST_BREACHES: usize = 64;

/// The rules at work. See the module.
#[derive(Debug, Default)]
pub struct Rules {
    breaches: Vec<Breach>,
    moved: bool,
    stopped_at: Option<u64>,
    /// Frames for which the arm has not moved, and when it last began to, from standstill.
    still: u64,
    began_at: u64,
    /// The program was paused in the last frame, and when it was played again with no stop in reach.
    paused: bool,
    played_at: Option<u64>,
    /// A pick-n-place is under way, by the journal.
    picking: bool,
    last_state: u64,
    /// The RTDE connection is gone since the last state; when states came again after that, and the last one
    /// before.
    rtde_gone: bool,
    back_at: Option<u64>,
    silent_since: u64,
    /// Bytes of a package that is not complete.
    package: Vec<u8>,
    last_read: u64,
    frame: u64,
    /// Records on their way to the disk, with whether motion waits for them.
    open: BTreeMap<u64, bool>,
    written: BTreeSet<u64>,
    /// Without an answer yet, with the frame in which they were given.
    orders: BTreeMap<u64, (u64, Order)>,
    /// Releases that a person ordered and that are not answered yet, and when the last one was, or was
    /// forgotten with its daemon.
    releases: u32,
    released_at: Option<u64>,
    vacuum: [Option<VacuumMode>; 2],
    held_since: Option<u64>,
    sight: u64,
    disturbed: u64,
    /// Another client's program may move the arm.
    stranger: bool,
    /// Since when a gate that a person cannot see past is closed, and which.
    closed: Option<(u64, &'static str)>,
    local_since: Option<u64>,
    /// When the daemon was started anew.
    restarted_at: Option<u64>,
    /// When the cell was armed last.
    armed_at: Option<u64>,
    /// A connection that was lost while the cell was armed.
    lost: Option<(u64, Link)>,
}

impl Rules {
    /// Breaches so far, oldest first.
    pub fn breaches(&self) -> &[Breach] {
        &self.breaches
    }

    fn breach(&mut self, rule: Rule, detail: String) {
        if self.breaches.len() < MOST_BREACHES {
            self.breaches.push(Breach { frame: self.frame, rule, detail });
        }
    }

    /// A fault is brought about.
    pub fn disturbed(&mut self, order: &FaultOrder) {
        self.stranger |= matches!(order.fault, Fault::Robot(RobotFault::ForeignScript(_)));
    }

    /// An order was given.
    pub fn ordered(&mut self, number: u64, order: &Order) {
        self.orders.insert(number, (self.frame, order.clone()));
        self.releases += u32::from(matches!(order, Order::Release(_)));
    }

    /// The daemon is gone and comes back: nothing that it knew counts.
    pub fn restarted(&mut self) {
        self.open.clear();
        self.written.clear();
        self.orders.clear();
        (self.stopped_at, self.lost) = (None, None);
        self.released_at = Some(self.frame).filter(|_| self.releases > 0).or(self.released_at);
        (self.releases, self.picking) = (0, false);
        self.restarted_at = Some(self.frame);
        self.disturbed = self.frame;
        self.last_read = self.frame;
    }

    /// A record has truly reached the disk.
    pub fn written(&mut self, number: u64) {
        self.open.remove(&number);
        self.written.insert(number);
    }

    /// Something has truly happened, whatever is reported of it to the machine.
    pub fn arrived(&mut self, event: &Event) {
        match event {
            Event::Received(Link::Rtde, bytes) => self.rtde_arrived(bytes),
            Event::Connected(Link::Rtde) => self.package.clear(),
            Event::Disconnected(link, _) => {
                self.lost = self.lost.or(Some((self.frame, *link)));
                self.rtde_gone |= *link == Link::Rtde;
            }
            Event::Observed(_, Ok(_)) => self.sight = self.frame,
            _ => {}
        }
    }

    /// States of the robot, out of everything else that comes over RTDE: a length of two bytes, then `U`.
    fn rtde_arrived(&mut self, bytes: &[u8]) {
        self.package.extend(bytes);
        while let [high, low, kind, ..] = *self.package {
            let length = usize::from(u16::from_be_bytes([high, low])).max(3);
            if self.package.len() < length {
                return;
            }
            self.package.drain(..length);
            if kind == b'U' {
                if self.silent() {
                    (self.back_at, self.silent_since) = (Some(self.frame), self.last_state);
                }
                (self.last_state, self.rtde_gone) = (self.frame, false);
            }
        }
    }

    /// Something goes into the machine.
    pub fn event(&mut self, event: &Event) {
        if let Event::Committed(number, Ok(())) = event
            && !self.written.contains(number)
        {
            self.breach(Rule::AcknowledgedNotWritten, format!("record {number}"));
        }
    }

    /// Something comes out of it.
    pub fn effect(&mut self, frame: u64, effect: &Effect, machine: &Machine) {
        self.frame = frame;
        match effect {
            Effect::Commit { number, record } => {
                self.open.insert(*number, !matches!(record, Record::Ended(_)));
                match record {
                    Record::Intent { .. } => self.picking = true,
                    Record::Done { .. } => self.picking = false,
                    Record::Gripped { .. } | Record::Released { .. } | Record::Ended(_) => {}
                }
                match record {
                    Record::Intent { object, .. } if self.sight <= self.disturbed => {
                        self.breach(Rule::PickOnOldSight, object.clone());
                    }
                    Record::Gripped { .. } | Record::Released { .. } | Record::Done { .. } => {
                        self.disturbed = frame;
                    }
                    Record::Intent { .. } | Record::Ended(_) => {}
                }
            }
            Effect::Send(Link::Dashboard, bytes) => self.check_line(bytes, machine),
            Effect::Send(Link::Primary, _) => self.check_started("a program", machine),
            Effect::Registers(ModbusRequest::Read { .. }) => self.last_read = frame,
            Effect::Reply { number, reply } => self.check_reply(*number, reply, machine),
            Effect::End(_) => self.check_end(),
            Effect::Notify(News::Notice(notice)) if notice.text.starts_with("stopped and disarmed") => {
                (self.stopped_at, self.picking) = (Some(frame), false);
                self.disturbed = frame;
            }
            _ => {}
        }
    }

    /// Safety stops are acknowledged by a person.
    fn check_line(&mut self, bytes: &[u8], machine: &Machine) {
        let line = String::from_utf8_lossy(bytes).to_lowercase();
        if ["unlock protective stop", "restart safety"].iter().any(|word| line.contains(word)) {
            self.breach(Rule::SafetyAcknowledged, line.trim().to_string());
        }
        if ["power on", "brake release"].iter().any(|word| line.contains(word)) {
            self.check_started(line.trim(), machine);
        }
    }

    fn check_started(&mut self, what: &str, machine: &Machine) {
        if !machine.supervisor().is_some_and(|supervisor| supervisor.mode().armed()) {
            self.breach(Rule::StartedWhileDisarmed, what.to_string());
        }
    }

    /// The sender of an order that has arrived is answered before the daemon ends.
    fn check_end(&mut self) {
        let given = |at: u64| at + 1 < self.frame;
        let open = self.orders.values().find(|(at, _)| given(*at)).map(|(_, order)| format!("{order:?}"));
        if let Some(order) = open {
            self.breach(Rule::OrderUnanswered, order);
        }
    }

    fn check_reply(&mut self, number: u64, reply: &Reply, machine: &Machine) {
        let accepted = reply.accepted;
        let Some((_, order)) = self.orders.remove(&number) else {
            return self.breach(Rule::AnswerWithoutOrder, format!("order {number}"));
        };
        let Some(mode) = machine.supervisor().map(|supervisor| supervisor.mode()) else { return };
        if order == Order::Arm && accepted {
            self.lost = None;
            if let Some((_, gate)) = self.closed.filter(|(since, _)| self.frame > since + KNOWN_FRAMES) {
                self.breach(Rule::ArmedWithGateClosed, gate.to_string());
            }
        }
        let stands = !reply.message.starts_with("stopped") || !self.moved;
        let fine = match order {
            Order::Arm => accepted == mode.armed(),
            Order::Disarm => {
                // Plainly disarmed: no pick-n-place is finished first.
                self.picking &= reply.message != "disarmed";
                !mode.armed() && (!accepted || stands)
            }
            Order::Abort => !mode.armed() && (!accepted || !self.moved),
            Order::Pause => !accepted || mode.paused(),
            Order::Resume => !accepted || !mode.paused(),
            Order::Park | Order::Step => !accepted || mode.armed(),
            Order::Release(channels) => {
                self.disturbed = self.frame;
                self.releases = self.releases.saturating_sub(1);
                !accepted || (!mode.armed() && self.is_off(channels))
            }
            Order::Approve(_) | Order::Reject(_) | Order::Cancel(_) | Order::Recover => true,
        };
        if !fine {
            self.breach(Rule::AnswerNotTrue, format!("{order:?}: {reply:?}, {mode:?}"));
        }
    }

    /// These channels do not grip, in truth.
    fn is_off(&self, channels: Channels) -> bool {
        let [a, b] = self.vacuum.map(|mode| mode != Some(VacuumMode::Grip));
        match channels {
            Channels::A => a,
            Channels::B => b,
            Channels::Both => a && b,
        }
    }

    /// One controller frame is over.
    pub fn check(&mut self, frame: u64, machine: &Machine, simulator: &Simulator, status: Option<&Status>) {
        self.frame = frame;
        let core = simulator.core();
        let (moves, nonce, stranger, safe, local, paused) = {
            let controller = core.robot.controller();
            let qd = controller.core.mover.qd();
            let moves = qd.iter().any(|speed| speed.abs() > MOVES_RAD_S);
            let ours = controller.programs.name().is_none_or(|name| name.starts_with("celld_"));
            let (safe, local) = (controller.core.modes.motion_allowed(), !controller.core.modes.remote());
            let nonce = controller.core.registers.output_ints[24];
            (moves, nonce, !ours, safe, local, controller.programs.paused())
        };
        if std::mem::replace(&mut self.paused, paused) && !paused {
            self.played_at = Some(frame).filter(|_| self.unreached());
        }
        if moves && self.still >= STOOD_FRAMES {
            self.began_at = frame;
        }
        self.still = if moves { 0 } else { self.still + 1 };
        let works = status.is_some_and(|status| matches!(status.doing, Doing::Working(..)));
        self.picking &= moves || works;
        self.local_since = if local { self.local_since.or(Some(frame)) } else { None };
        self.watch_gates(simulator, safe);
        self.check_lost(machine);
        self.check_answers(machine);
        let began = moves && !self.moved;
        self.moved = moves;
        if began && !stranger && !self.stranger {
            self.check_begin(machine, nonce);
        }
        if machine.supervisor().is_some_and(|supervisor| supervisor.mode().armed()) {
            self.stopped_at = None;
            self.armed_at = Some(frame);
        }
        self.check_stopped(moves);
        self.check_vacuum(frame, simulator, machine.supervisor().is_none_or(|cell| !cell.mode().ending()));
        self.check_status(machine, status);
    }

    /// After a stop nothing moves before the cell is armed.
    fn check_stopped(&mut self, moves: bool) {
        let Some(at) = self.stopped_at else { return };
        let detail = if self.began_at > at + ON_ITS_WAY_FRAMES {
            "it began after its stop"
        } else if self.frame > at + STOP_FRAMES {
            "it never stood"
        } else if self.began_at > at && self.frame > self.began_at + OVERTAKEN_FRAMES {
            "it began while the stop was on its way, and went on"
        } else {
            return;
        };
        if moves && !self.stranger && !self.played_unreached() {
            self.breach(Rule::MotionAfterStop, detail.to_string());
            self.stopped_at = None;
        }
    }

    fn silent(&self) -> bool {
        self.rtde_gone || self.frame > self.last_state + SILENT_FRAMES
    }

    /// No stop has reached the program: celld or its link was gone before there was a reason for one.
    fn unreached(&self) -> bool {
        // A link that has just come back has not brought the stop yet.
        let just_back = self.back_at.is_some_and(|back| self.frame <= back + ON_ITS_WAY_FRAMES);
        let last = if just_back { self.silent_since } else { self.last_state };
        let reachable = self.stopped_at.is_some_and(|at| at < last);
        ((self.silent() || just_back) && !reachable)
            || self.restarted_at.is_some_and(|at| self.armed_at.is_none_or(|armed| armed <= at))
    }

    /// A person has pressed play on a program that no stop could reach: it moves until its own watchdog stops
    /// it, or the link is back and the stop arrives.
    fn played_unreached(&self) -> bool {
        self.played_at.is_some_and(|at| {
            let back = self.back_at.is_some_and(|back| back >= at && self.frame > back + ON_ITS_WAY_FRAMES);
            self.frame <= at + WATCHDOG_FRAMES && !back
        })
    }

    fn watch_gates(&mut self, simulator: &Simulator, safe: bool) {
        let holds = lock(&simulator.core().world).glance().holds;
        let gate = if self.frame > self.last_state + STATE_AGE_FRAMES {
            Some("no state of the robot comes")
        } else if !safe {
            Some("the safety system forbids motion")
        } else if holds {
            Some("something is held")
        } else {
            None
        };
        self.closed = gate.map(|gate| (self.closed.map_or(self.frame, |(since, _)| since), gate));
    }

    fn check_answers(&mut self, machine: &Machine) {
        if machine.supervisor().is_some_and(|cell| cell.mode().ending()) {
            return;
        }
        let late = self.orders.iter().find(|(_, (at, _))| self.frame > at + ANSWER_FRAMES);
        if let Some((number, (_, order))) = late.map(|(number, given)| (*number, given.clone())) {
            self.orders.remove(&number);
            self.breach(Rule::OrderUnanswered, format!("{order:?}"));
        }
    }

    fn check_lost(&mut self, machine: &Machine) {
        let Some((since, link)) = self.lost else { return };
        if !machine.supervisor().is_some_and(|supervisor| supervisor.mode().armed()) {
            self.lost = None;
        } else if self.frame > since + KNOWN_FRAMES {
            self.breach(Rule::ArmedThroughLinkLoss, link.to_string());
            self.lost = None;
        }
    }

    /// The arm begins to move.
    fn check_begin(&mut self, machine: &Machine, nonce: i32) {
        let restarted = self.restarted_at.is_some_and(|at| self.frame <= at + WATCHDOG_FRAMES);
        // What was streamed before celld was gone goes on until the program's watchdog ends it.
        if self.played_unreached() || restarted {
            return;
        }
        let Some(supervisor) = machine.supervisor() else {
            return self.breach(Rule::MotionWhileDisarmed, "before the cell was commissioned".into());
        };
        // An order that was on its way when the cell was disarmed is overtaken by the stop.
        let just_now = self.armed_at.is_some_and(|at| self.frame <= at + ON_ITS_WAY_FRAMES);
        if !supervisor.mode().armed() && !self.picking && !just_now {
            self.breach(Rule::MotionWhileDisarmed, String::new());
        }
        if let Some((number, _)) = self.open.iter().find(|(_, waits)| **waits) {
            self.breach(Rule::MotionBeforeCommit, format!("record {number}"));
        }
        if self.frame > self.last_state + STATE_AGE_FRAMES {
            self.breach(Rule::MotionOnStaleState, format!("{} frames", self.frame - self.last_state));
        }
        if self.local_since.is_some_and(|since| self.frame > since + LOCAL_FRAMES) {
            self.breach(Rule::MotionInLocalControl, String::new());
        }
        let ours = supervisor.nonce().is_some_and(|ours| ours.number() == nonce);
        if !ours && supervisor.mode().armed() {
            self.breach(Rule::MotionOfOldProgram, format!("nonce {nonce}"));
        }
    }

    fn check_vacuum(&mut self, frame: u64, simulator: &Simulator, machine_lives: bool) {
        let core = simulator.core();
        let world = lock(&core.world);
        let glance = world.glance();
        let mut off = Vec::new();
        for channel in Channel::ALL {
            let (mode, _) = world.vacuum_command(channel);
            let before = self.vacuum[channel.index()].replace(mode);
            if before == Some(VacuumMode::Grip) && mode != VacuumMode::Grip {
                off.push(channel);
            }
        }
        let over = world.held_over_place();
        let held = glance.holds;
        drop(world);
        if !off.is_empty() && self.moved {
            self.breach(Rule::VacuumOffInMotion, format!("{off:?}"));
        }
        let ordered = self.releases > 0 || self.released_at.is_some_and(|at| frame <= at + ON_ITS_WAY_FRAMES);
        if !off.is_empty() && !ordered && over.is_some_and(|height| height > PLACED_WITHIN_M) {
            self.breach(Rule::VacuumOffAway, format!("{:.0} mm over its place", over.unwrap_or(0.0) * 1e3));
        }
        self.held_since = if held { self.held_since.or(Some(frame)) } else { None };
        let link = simulator.link(LinkName::Gripper);
        let prompt = link.latency < ANSWER_WITHIN;
        let sound =
            prompt && !link.silent && !link.down && link.exception.is_none() && !link.wrong_transaction;
        if !sound {
            self.last_read = self.last_read.max(frame);
        }
        let since = self.held_since.map_or(frame, |since| since.max(self.last_read));
        if frame > since + WATCH_FRAMES && machine_lives {
            self.breach(Rule::HeldUnwatched, format!("{} frames", frame - since));
            self.last_read = frame;
        }
    }

    fn check_status(&mut self, machine: &Machine, status: Option<&Status>) {
        let (Some(status), Some(supervisor)) = (status, machine.supervisor()) else { return };
        if status.armed != supervisor.mode().armed() {
            self.breach(Rule::StatusNotTrue, format!("the status says armed: {}", status.armed));
        }
    }
}
