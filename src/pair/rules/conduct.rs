//! The rules about what the cell does: how the arm moves, the vacuum, the disk, answers, the sight that a
//! pick rests on.
//!
//! In: what passes between machine and world (here), the state of both (`frame`), objects that hands move
//! (`picked`). Out: breaches.

use crate::pair::rules::conduct::states::States;
use crate::pair::rules::found::Found;
use crate::pair::rules::rule::Rule;
use crate::pair::rules::truth::KNOWN_FRAMES;
use cell_machine::device::gripper_types::{Channels, ModbusRequest};
use cell_machine::device::robot_types::Link;
use cell_machine::event::{Effect, Event, News};
use cell_machine::machine::Machine;
use cell_machine::orders::{Order, Reply, WayBack};
use cell_machine::supervisor::input::Record;
use cell_machine::supervisor::mode::Mode;
use cell_machine::supervisor::reason::STOP_ORDERED;
use cell_machine::supervisor::status::Doing;
use cell_values::units::Joints;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use ur_sim::faults::{Fault, Order as FaultOrder, RobotFault, WorldFault};
use ur_sim::world::vacuum::VacuumMode;

/// A control word that switches a channel's pump on.
pub(super) fn is_grip(word: &u16) -> bool {
    word >> 8 == 1
}

/// Arrivals of states that are kept, 2 s.
const ARRIVALS: usize = 1000;

/// A link that brings no state for so long is gone, 90 ms: celld stops the arm after 100 ms.
const SILENT_FRAMES: u64 = 45;

/// An acknowledgement comes before so many further records are written.
const LATE_RECORDS: u64 = 1000;

/// What the cell has done. See the module.
#[derive(Debug, Default)]
pub(super) struct Conduct {
    /// What is not reported yet.
    pub found: Found,
    moved: bool,
    /// A hand moves the arm, or has moved it and the arm has not come to rest since.
    by_hand: bool,
    /// When it moved last, not by hand and with a link that brought states.
    moved_at: u64,
    /// When the slider last held its program up, with a link that brought states.
    held_up_at: u64,
    /// What went on without a link may last until then.
    unreached_until: u64,
    stopped_at: Option<u64>,
    /// Frames for which the arm has not moved, and when it last began to, from standstill.
    still: u64,
    began_at: u64,
    /// The program was paused in the last frame, and when it was played again with no stop in reach.
    paused: bool,
    played_at: Option<u64>,
    /// A pick-n-place is under way, by the journal.
    picking: bool,
    /// One is written down, and neither over nor given up.
    meant: bool,
    /// Its object was gripped.
    gripped: bool,
    /// The status says that one is under way.
    works: bool,
    last_state: u64,
    /// The RTDE connection is gone since the last state; when states came again after that, and the last one
    /// before.
    rtde_gone: bool,
    back_at: Option<u64>,
    silent_since: u64,
    /// States as they arrived and as the machine was given them, and when each arrived, by its own time.
    arriving: States,
    given: States,
    arrivals: VecDeque<(u64, u64)>,
    /// When the newest state that the machine was given had arrived.
    given_state: u64,
    last_read: u64,
    /// Until then the gripper's answers may come late.
    held_up_until: u64,
    frame: u64,
    /// Records on their way to the disk, with whether a grip waits for them.
    open: BTreeMap<u64, bool>,
    written: BTreeSet<u64>,
    /// Without an answer yet, with the frame in which they were given.
    orders: BTreeMap<u64, (u64, Order)>,
    /// Of these, those after which another order has changed what their answer speaks of.
    superseded: BTreeSet<u64>,
    /// Releases that a person ordered and that are not answered yet, and when the last one was, or was
    /// forgotten with its daemon.
    releases: u32,
    released_at: Option<u64>,
    /// A person has chosen a way back from the safety stop in force.
    way_chosen: bool,
    vacuum: [Option<VacuumMode>; 2],
    held_since: Option<u64>,
    sight: u64,
    disturbed: u64,
    /// Frames of a picture have been exposed since the last controller frame; when the last ones were, and
    /// the arm's joints then, oldest first; when hands moved which objects.
    exposed: bool,
    pictures: VecDeque<(u64, Joints)>,
    moved_by_hand: BTreeMap<String, u64>,
    /// An object is being gripped.
    gripping: bool,
    /// Height from which the tool goes down, or up to which it has gone, m over the table.
    height: f64,
    /// Another client's program may move the arm.
    stranger: bool,
    /// Since when a gate that a person cannot see past is closed, and which.
    closed: Option<(u64, &'static str)>,
    local_since: Option<u64>,
    /// When the daemon was started anew.
    restarted_at: Option<u64>,
    /// When the cell was armed last, and the last command that the program had taken then or right after.
    armed_at: Option<u64>,
    accepted: Option<i32>,
    /// Frames for which the arm has moved with a status that says that it rests.
    unshown: u64,
    /// A connection that was lost while the cell was armed.
    lost: Option<(u64, Link)>,
}

/// The order may change whether the cell is armed or paused.
fn changes_leave(order: &Order) -> bool {
    order.only_stops() || order.needs_sight() && *order != Order::ConfirmGripper
}

impl Conduct {
    fn breach(&mut self, rule: Rule, detail: String) {
        self.found.push(rule, detail);
    }

    /// A pick-n-place is written down, and neither over nor given up.
    pub fn intends(&self) -> bool {
        self.meant
    }

    /// The order with this number, where it has no answer yet.
    pub fn order(&self, number: u64) -> Option<&Order> {
        self.orders.get(&number).map(|(_, order)| order)
    }

    /// Nobody but a hand knows where this object is.
    pub fn is_astray(&self, object: &str) -> bool {
        self.moved_by_hand.contains_key(object)
    }

    /// A fault is brought about.
    pub fn disturbed(&mut self, order: &FaultOrder) {
        self.stranger |= matches!(order.fault, Fault::Robot(RobotFault::ForeignScript(_)));
        if let Fault::World(WorldFault::Nudge { object, .. } | WorldFault::Place { object, .. }) =
            &order.fault
        {
            self.moved_by_hand.insert(object.clone(), self.frame);
        }
    }

    /// An order was given.
    pub fn ordered(&mut self, number: u64, order: &Order) {
        if changes_leave(order) {
            self.superseded.extend(self.orders.keys());
        }
        self.orders.insert(number, (self.frame, order.clone()));
        self.releases += u32::from(matches!(order, Order::Release(_) | Order::Recover(WayBack::Release)));
        self.way_chosen |= matches!(order, Order::Recover(way) if *way != WayBack::Show);
    }

    /// Celld's process stands still in the frame that comes: it reads nothing.
    pub fn stands_still(&mut self) {
        self.last_read = self.frame + 1;
        // Nor does it answer. Whether it then still carries out what it was given is for `Intake` to judge.
        self.orders.values_mut().for_each(|(given, _)| *given += 1);
    }

    /// The daemon is gone and comes back: nothing that it knew counts.
    pub fn restarted(&mut self) {
        self.open.clear();
        self.written.clear();
        self.orders.clear();
        (self.stopped_at, self.lost) = (None, None);
        self.released_at = Some(self.frame).filter(|_| self.releases > 0).or(self.released_at);
        (self.releases, self.picking, self.meant) = (0, false, false);
        self.restarted_at = Some(self.frame);
        self.disturbed = self.frame;
        self.last_read = self.frame;
    }

    /// A record has truly reached the disk.
    pub fn written(&mut self, number: u64) {
        self.open.remove(&number);
        self.written.insert(number);
    }

    /// Drops what was written long ago: no acknowledgement comes so late.
    pub fn forget(&mut self) {
        let last = self.written.last().copied().unwrap_or(0);
        self.written.retain(|number| number + LATE_RECORDS > last);
    }

    /// Something has truly happened, whatever is reported of it to the machine.
    pub fn arrived(&mut self, event: &Event) {
        match event {
            Event::Received(Link::Rtde, bytes) => self.rtde_arrived(bytes),
            Event::Connected(Link::Rtde) => self.arriving.clear(),
            Event::Disconnected(link, _) => {
                self.lost = self.lost.or(Some((self.frame, *link)));
                self.rtde_gone |= *link == Link::Rtde;
            }
            Event::Observed(_, Ok(_)) => self.sight = self.frame,
            Event::Exposed(_) => self.exposed = true,
            Event::Time
            | Event::Connected(_)
            | Event::Received(..)
            | Event::Registers(_)
            | Event::Looked(..)
            | Event::Observed(..)
            | Event::Pictured(..)
            | Event::Planned(..)
            | Event::Committed(..)
            | Event::StoreLost(_)
            | Event::Commission { .. }
            | Event::Job(_)
            | Event::Round(_)
            | Event::Order(..)
            | Event::OrdersReach(_)
            | Event::HeldUp(_)
            | Event::Shutdown => {}
        }
    }

    fn rtde_arrived(&mut self, bytes: &[u8]) {
        for time in self.arriving.take(bytes) {
            if self.silent() {
                (self.back_at, self.silent_since) = (Some(self.frame), self.last_state);
            }
            (self.last_state, self.rtde_gone) = (self.frame, false);
            self.arrivals.push_back((time, self.frame));
        }
        let over = self.arrivals.len().saturating_sub(ARRIVALS);
        self.arrivals.drain(..over);
    }

    /// Something goes into the machine.
    pub fn event(&mut self, event: &Event) {
        match event {
            Event::Committed(number, Ok(())) if !self.written.contains(number) => {
                self.breach(Rule::AcknowledgedNotWritten, format!("record {number}"));
            }
            Event::Connected(Link::Rtde) => self.given.clear(),
            Event::Received(Link::Rtde, bytes) => {
                for time in self.given.take(bytes) {
                    let arrived = self.arrivals.iter().rev().find(|(of, _)| *of == time);
                    self.given_state = arrived.map_or(self.given_state, |(_, at)| *at);
                }
            }
            _ => {}
        }
    }

    /// Something comes out of it.
    pub fn effect(&mut self, frame: u64, effect: &Effect, machine: &Machine) {
        self.frame = frame;
        match effect {
            Effect::Commit { number, record } => {
                self.open.insert(*number, matches!(record, Record::Intent { .. }));
                self.gripped |= matches!(record, Record::Gripped { .. });
                match record {
                    Record::Intent { .. } => (self.meant, self.gripped) = (true, false),
                    Record::Withdrawn { .. } => (self.picking, self.meant) = (false, false),
                    Record::Gripped { .. } | Record::Released { .. } | Record::LetGo { .. } => {
                        self.disturbed = frame
                    }
                    // The way from the place is still to be finished.
                    Record::Done { .. } => (self.meant, self.disturbed) = (false, frame),
                    Record::Found { .. } | Record::Planned(_) | Record::Approved | Record::Ended(_) => {}
                }
            }
            Effect::Send(Link::Dashboard, bytes) => self.check_line(bytes, machine),
            Effect::Send(Link::Primary, _) => self.check_started("a program", machine),
            Effect::Registers(ModbusRequest::Read { .. }) => self.last_read = frame,
            Effect::Registers(ModbusRequest::Write { values, .. }) if values.iter().any(is_grip) => {
                self.check_grip();
            }
            Effect::Reply { number, reply } => self.check_reply(*number, reply, machine),
            Effect::End(_) => self.check_end(),
            Effect::Notify(News::Notice(notice)) if notice.text.starts_with(STOP_ORDERED) => {
                (self.stopped_at, self.picking, self.meant) = (Some(frame), false, false);
                self.disturbed = frame;
            }
            Effect::Connect(_)
            | Effect::Close(_)
            | Effect::Send(..)
            | Effect::Registers(_)
            | Effect::Look { .. }
            | Effect::Observe { .. }
            | Effect::Picture { .. }
            | Effect::Plan { .. }
            | Effect::CancelPlan
            | Effect::WantJob
            | Effect::Notify(_)
            | Effect::RoundOver(_) => {}
        }
    }

    /// Safety stops are acknowledged by a person.
    fn check_line(&mut self, bytes: &[u8], machine: &Machine) {
        let line = String::from_utf8_lossy(bytes).to_lowercase();
        let unlocks = line.contains("unlock protective stop") && !self.way_chosen;
        if unlocks || line.contains("restart safety") {
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
        let superseded = self.superseded.remove(&number);
        let Some((_, order)) = self.orders.remove(&number) else {
            return self.breach(Rule::AnswerWithoutOrder, format!("order {number}"));
        };
        let Some(mode) = machine.supervisor().map(|supervisor| supervisor.mode()) else { return };
        let armed_before = self.armed_at.is_some_and(|at| self.frame <= at + 1);
        if order == Order::Arm && accepted && !armed_before {
            self.lost = None;
            if let Some((_, gate)) = self.closed.filter(|(since, _)| self.frame > since + KNOWN_FRAMES) {
                self.breach(Rule::ArmedWithGateClosed, gate.to_string());
            }
        }
        let stands = !reply.message.starts_with("stopped") || !self.moved;
        let fine = match order {
            // A way back arms the cell for itself alone, and another person's order may have armed it since.
            Order::Arm => {
                let other = || armed_before || self.others_arm() || self.recovers(mode, machine);
                accepted == mode.armed() || !accepted && other()
            }
            Order::Disarm => {
                // Plainly disarmed: no pick-n-place is finished first.
                self.picking &= reply.message != "disarmed";
                !mode.armed() && (!accepted || stands)
            }
            Order::Abort => !mode.armed() && (!accepted || !self.moved),
            Order::Pause => !accepted || mode.paused(),
            Order::Resume => !accepted || !(mode.paused() || mode.pauses_after_this_move()),
            Order::Park | Order::Step => !accepted || mode.armed(),
            Order::Release(_) | Order::Recover(WayBack::Release) => {
                let channels = if let Order::Release(channels) = order { channels } else { Channels::Both };
                if accepted || matches!(order, Order::Release(_)) {
                    self.disturbed = self.frame;
                }
                self.releases = self.releases.saturating_sub(1);
                !accepted || (!mode.armed() && self.is_off(channels))
            }
            // Only a way that moves the arm may arm the cell for it.
            Order::Recover(way) => !accepted || matches!(way, WayBack::Show) || self.recovers(mode, machine),
            Order::Calibrate => !accepted || mode.armed(),
            Order::Approve { .. } | Order::Reject(_) | Order::Cancel(_) | Order::ConfirmGripper => true,
        };
        if !fine && !superseded {
            self.breach(Rule::AnswerNotTrue, format!("{order:?}: {reply:?}, {mode:?}"));
        }
    }

    /// An order that arms the cell is decided in the same turn as the one that is judged.
    fn others_arm(&self) -> bool {
        let arms = |order: &Order| matches!(order, Order::Arm | Order::Recover(_) | Order::Calibrate);
        self.orders.values().any(|(_, order)| arms(order))
    }

    /// The machine is on a way back, or has come to its end.
    fn recovers(&self, mode: &Mode, machine: &Machine) -> bool {
        let doing = machine.supervisor().map(|supervisor| supervisor.status().doing);
        !mode.armed()
            || matches!(doing, Some(Doing::Recovering(_) | Doing::StartingRobot | Doing::Looking(..)))
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

    fn silent(&self) -> bool {
        self.rtde_gone || self.frame > self.last_state + SILENT_FRAMES
    }
}

mod frame;
mod picked;
mod states;
