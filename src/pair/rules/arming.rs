//! The rules about arming: who arms the cell, what ends it without an order, and how soon a stop is decided.
//!
//! In: persons' orders and their answers, the truth of every frame. Out: breaches. That the cell is armed is
//! the machine's state; everything that speaks against it is the controller's or a person's.

use crate::pair::rules::found::Found;
use crate::pair::rules::rule::Rule;
use crate::pair::rules::truth::{FRAMES_PER_S, KNOWN_FRAMES, Truth};
use cell_machine::orders::{Order, Reply};
use std::collections::BTreeMap;
use ur_wire::enumerations::RobotMode;

/// Arming lapses so much later than the arm's last motion at most, 30 s: what ends a look or a plan, in
/// which the time does not count.
const LAPSES_WITHIN_FRAMES: u64 = 15_000;

/// A silent link disarms the cell within this, 3 s, also while the arm rests.
const SILENCE_FRAMES: u64 = 1500;

/// An order that only stops is decided within this after it was given, 20 ms, and a frame on its way in.
const DECIDED_FRAMES: u64 = 11;

/// Who armed the cell, and since when it should not be. See the module.
#[derive(Debug)]
pub(super) struct Arming {
    lapse_frames: u64,
    armed: bool,
    /// Orders that may arm the cell, without an answer.
    leave: BTreeMap<u64, Order>,
    /// The last frame in which an order allowed that the cell is armed.
    allowed: Option<u64>,
    /// The machine may arm itself: a calibration round, or a simulated cell at its start.
    given: bool,
    /// The last frame in which the arm moved, or the cell was disarmed.
    moved: u64,
    /// Since when a person guides the arm.
    guided: Option<u64>,
    /// The highest step of the arm's power while armed, and since when it is below that.
    power: u8,
    off: Option<u64>,
    /// The power has been off while armed.
    seen_off: bool,
    /// Since when no state of the arm comes although the cell is armed.
    unseen: Option<u64>,
    /// Orders that only stop, without a decision: when they were given, and which.
    stops: BTreeMap<u64, (u64, Order)>,
}

impl Arming {
    /// Arming lapses after so many seconds.
    pub fn new(lapse_s: f64) -> Arming {
        Arming {
            lapse_frames: (lapse_s * FRAMES_PER_S) as u64 + LAPSES_WITHIN_FRAMES,
            armed: false,
            leave: BTreeMap::new(),
            allowed: None,
            given: false,
            moved: 0,
            guided: None,
            power: 0,
            seen_off: false,
            off: None,
            unseen: None,
            stops: BTreeMap::new(),
        }
    }

    /// A person gives an order.
    pub fn ordered(&mut self, frame: u64, number: u64, order: &Order) {
        match order {
            Order::Arm | Order::Recover(_) | Order::Calibrate => {
                self.leave.insert(number, order.clone());
            }
            Order::Disarm | Order::Pause | Order::Abort => {
                self.stops.insert(number, (frame, order.clone()));
            }
            Order::Approve { .. }
            | Order::Reject(_)
            | Order::Cancel(_)
            | Order::Resume
            | Order::Step
            | Order::Park
            | Order::Release(_)
            | Order::ConfirmGripper => {}
        }
    }

    /// The machine may arm the cell without a further order; not any more.
    pub fn given(&mut self, given: bool) {
        self.given = given;
    }

    /// An order is answered.
    pub fn answered(&mut self, frame: u64, number: u64, reply: &Reply) {
        self.stops.remove(&number);
        match self.leave.remove(&number) {
            // A way back arms the cell when the arm is unlocked.
            Some(Order::Recover(_)) if reply.accepted => self.given = true,
            Some(_) => self.allowed = Some(frame),
            None => {}
        }
    }

    /// The daemon is gone and comes back.
    pub fn restarted(&mut self) {
        self.leave.clear();
        self.stops.clear();
        (self.allowed, self.given, self.armed) = (None, false, false);
    }

    /// Celld's process stands still in the frame that comes: it decides nothing.
    pub fn stands_still(&mut self) {
        [&mut self.off, &mut self.unseen].into_iter().flatten().for_each(|since| *since += 1);
    }

    /// One controller frame.
    pub fn frame(&mut self, truth: &Truth, found: &mut Found) {
        let armed = truth.armed();
        let ordered = self.given || !self.leave.is_empty();
        let allowed = ordered || self.allowed.is_some_and(|at| truth.frame <= at + 1);
        if armed && !self.armed && !allowed {
            found.push(Rule::ArmedWithoutOrder, "");
        }
        if self.armed && !armed {
            self.given = false;
        }
        self.armed = armed;
        if !armed || truth.moves {
            self.moved = truth.frame;
        }
        if truth.frame > self.moved + self.lapse_frames {
            let still_s = (truth.frame - self.moved) as f64 / FRAMES_PER_S;
            found.push(Rule::ArmedTooLong, format!("nothing has moved for {still_s:.0} s"));
            self.moved = truth.frame;
        }
        self.guiding(truth, found);
        self.power(truth, found);
        self.silence(truth, found);
        self.stops(truth, found);
    }

    fn guiding(&mut self, truth: &Truth, found: &mut Found) {
        self.guided = Some(truth.frame)
            .filter(|_| truth.guided && truth.armed())
            .and(self.guided.or(Some(truth.frame)));
        if self.guided.is_some_and(|since| truth.frame == since + KNOWN_FRAMES) {
            found.push(Rule::ArmedThroughGuiding, "");
        }
    }

    fn power(&mut self, truth: &Truth, found: &mut Found) {
        let step = match truth.mode {
            RobotMode::Running => 3,
            RobotMode::Idle => 2,
            RobotMode::PowerOn => 1,
            // The joints boot once the power is on, the controller while it is off.
            RobotMode::Booting => u8::from(self.seen_off),
            _ => 0,
        };
        self.seen_off = truth.armed() && (self.seen_off || truth.mode == RobotMode::PowerOff);
        self.power = if truth.armed() { self.power.max(step) } else { 0 };
        // Without states celld cannot know. `silence` judges that.
        self.off = if step < self.power && truth.shown { self.off.or(Some(truth.frame)) } else { None };
        if self.off.is_some_and(|since| truth.frame == since + KNOWN_FRAMES) {
            found.push(Rule::ArmedThroughPower, format!("{:?}", truth.mode));
        }
    }

    fn silence(&mut self, truth: &Truth, found: &mut Found) {
        let unseen = truth.armed() && !truth.shown;
        self.unseen = if unseen { self.unseen.or(Some(truth.frame)) } else { None };
        if self.unseen.is_some_and(|since| truth.frame == since + SILENCE_FRAMES) {
            found.push(Rule::ArmedThroughLinkLoss, "no state of the arm for 3 s");
        }
    }

    fn stops(&mut self, truth: &Truth, found: &mut Found) {
        let Some(cell) = truth.supervisor.filter(|cell| !cell.mode().ending()) else {
            return self.stops.clear();
        };
        let mode = cell.mode();
        self.stops.retain(|_, (_, order)| match order {
            Order::Pause => !mode.paused(),
            _ => mode.armed(),
        });
        let late = self.stops.iter().find(|(_, (at, _))| truth.frame > at + DECIDED_FRAMES);
        if let Some(number) = late.map(|(number, _)| *number)
            && let Some((_, order)) = self.stops.remove(&number)
        {
            found.push(Rule::StopLate, format!("{order:?}"));
        }
    }
}
