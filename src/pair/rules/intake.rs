//! The rules about the way of an order to the machine: it is decided in time or not at all, nothing else
//! keeps it from being decided, and a cell that no order reaches is not armed.
//!
//! In: what clients did, what was handed on to the machine, what became of the process and of the folder of
//! commands. Out: breaches. When an order was given and whether its client is there is known here by the
//! client, not by what celld made of it.

use crate::pair::rules::found::Found;
use crate::pair::rules::rule::Rule;
use crate::pair::rules::truth::{FRAMES_PER_S, Truth};
use crate::pair::shell::folder::Fate;
use crate::pair::shell::{Client, Happened, Way};
use cell_machine::intake::{COUNTS_FOR_S, HELD_UP_AFTER, REACH_WITHIN};
use cell_machine::orders::{Order, Reply};
use std::collections::{BTreeMap, BTreeSet};

/// A stop is handed on within this, 10 ms: with its decision it takes 20.
const HANDED_ON_FRAMES: u64 = 5;

/// Longest time from intake to the answer of a release, 8 s: 5.5 s for the arm to stop, the rest for the
/// gripper.
const RELEASED_WITHIN_FRAMES: u64 = 4000;

/// Margin below the age limit within which an order need not be accepted, 50 ms.
const SURELY_FRAMES: u64 = 25;

/// After this long the cell is disarmed, beyond what it may take: 50 ms.
const DISARMED_FRAMES: u64 = 25;

/// The rules. See the module.
#[derive(Debug, Default)]
pub(super) struct Intake {
    /// Stops on their way: since when nothing keeps them from being handed on.
    stops: BTreeMap<usize, Stop>,
    /// What must not be carried out, and why not.
    void: BTreeMap<u64, String>,
    /// Orders of clients that wait, given in time.
    in_time: BTreeSet<u64>,
    /// When celld was ordered to end, and the cell was armed.
    ends: Option<u64>,
    /// When each order reached the machine.
    handed_on: BTreeMap<u64, u64>,
    /// Since when no order can be taken.
    cut_off: Option<u64>,
    /// The process went on after it was held up, and no person has armed the cell since.
    held_up: Option<u64>,
}

/// The shell at the end of a frame.
#[derive(Clone, Copy, Debug)]
pub struct ShellNow {
    /// celld's process runs.
    pub runs: bool,
    /// The folder of commands.
    pub folder: Fate,
    /// It is gone, or an order lies in it that cannot be read.
    pub cut_off: bool,
}

/// An order that only stops, on its way.
#[derive(Debug)]
struct Stop {
    since: u64,
    order: Order,
    by_file: bool,
}

impl Intake {
    /// Something happened to orders in this frame.
    pub fn happened(&mut self, frame: u64, happened: &Happened, clients: &[Client]) {
        match happened {
            Happened::Given(client, order) if order.only_stops() => {
                let by_file = clients.get(*client).is_some_and(|client| client.way == Way::File);
                self.stops.insert(*client, Stop { since: frame, order: order.clone(), by_file });
            }
            Happened::Given(..) => {}
            Happened::Over(client) => _ = self.stops.remove(client),
            Happened::HandedOn(number, of) => {
                of.iter().for_each(|client| _ = self.stops.remove(client));
                if of.iter().any(|client| in_time(frame, clients.get(*client))) {
                    self.in_time.insert(*number);
                }
                let all_void: Option<Vec<String>> =
                    of.iter().map(|client| void(frame, clients.get(*client))).collect();
                self.void.extend(all_void.and_then(|mut why| why.pop()).map(|why| (*number, why)));
                self.handed_on.insert(*number, frame);
            }
            Happened::HeldUp(gap) if *gap > HELD_UP_AFTER => self.held_up = Some(frame),
            Happened::HeldUp(_) => {}
        }
    }

    /// An order is answered.
    pub fn answered(
        &mut self,
        frame: u64,
        number: u64,
        (order, reply): (Option<&Order>, &Reply),
        found: &mut Found,
    ) {
        let accepted = reply.accepted;
        let in_time = self.in_time.remove(&number);
        if let Some(why) = reply.stale.filter(|_| in_time) {
            found.push(Rule::RefusedInTime, format!("{order:?} as {why:?}"));
        }
        // A release waits for the arm to come to rest, and is carried out as it is answered.
        let since = self.handed_on.remove(&number).filter(|_| matches!(order, Some(Order::Release(_))));
        let took = since.map(|since| frame - since).filter(|took| *took > RELEASED_WITHIN_FRAMES);
        let late = took.map(late);
        let void = self.void.remove(&number).or(late);
        if let (Some(why), true, false) = (void, accepted, order.is_some_and(Order::only_stops)) {
            found.push(Rule::OrderOutOfTime, format!("{order:?} {why}"));
        }
        if accepted && matches!(order, Some(Order::Arm | Order::Recover(_) | Order::Calibrate)) {
            self.held_up = None;
        }
    }

    /// celld is ordered to end.
    pub fn told_to_end(&mut self, frame: u64) {
        self.ends = Some(frame);
    }

    /// The daemon is gone and comes back.
    pub fn restarted(&mut self) {
        *self = Intake::default();
    }

    /// One controller frame;
    pub fn frame(&mut self, truth: &Truth, shell: ShellNow, found: &mut Found) {
        let ShellNow { runs, folder, cut_off } = shell;
        for stop in self.stops.values_mut() {
            // It counts from when orders can be taken again.
            if !runs || stop.by_file && folder != Fate::Sound {
                stop.since = truth.frame;
            }
        }
        let late = self.stops.iter().find(|(_, stop)| truth.frame > stop.since + HANDED_ON_FRAMES);
        if let Some(client) = late.map(|(client, _)| *client)
            && let Some(Stop { order, .. }) = self.stops.remove(&client)
        {
            found.push(Rule::StopLate, format!("{order:?} on its way to the machine"));
        }
        if self.ends.take_if(|since| truth.frame > *since + HANDED_ON_FRAMES).is_some() && truth.armed() {
            found.push(Rule::StopLate, "the end of celld");
        }
        let cut_off = runs && cut_off;
        self.cut_off = if cut_off { self.cut_off.or(Some(truth.frame)) } else { None };
        let allowed = (REACH_WITHIN.as_secs_f64() * FRAMES_PER_S) as u64 + DISARMED_FRAMES;
        if self.cut_off.is_some_and(|since| truth.frame >= since + allowed) && truth.armed() {
            found.push(Rule::ArmedCutOff, "");
        }
        if truth.armed() && self.held_up.take_if(|at| truth.frame >= *at + DISARMED_FRAMES).is_some() {
            found.push(Rule::ArmedAfterHoldUp, "");
        }
    }
}

/// Why what this client ordered must not be carried out any more.
fn void(frame: u64, client: Option<&Client>) -> Option<String> {
    let Some(client) = client else { return Some("of nobody who waits".to_string()) };
    if let Some(left) = client.left_in().filter(|left| *left < frame) {
        return Some(format!("of a client that left {:.2} s before", (frame - left) as f64 / FRAMES_PER_S));
    }
    let age = frame - client.given_in().unwrap_or(frame);
    (age as f64 / FRAMES_PER_S > COUNTS_FOR_S + 0.01).then(|| late(age))
}

/// Its client waits, and its order is young enough by far.
fn in_time(frame: u64, client: Option<&Client>) -> bool {
    let young = |given: u64| {
        let age_s = (frame + SURELY_FRAMES - given) as f64 / FRAMES_PER_S;
        age_s < COUNTS_FOR_S
    };
    client.is_some_and(|client| client.left_in().is_none() && client.given_in().is_some_and(young))
}

fn late(frames: u64) -> String {
    format!("{:.2} s after it was given", frames as f64 / FRAMES_PER_S)
}
