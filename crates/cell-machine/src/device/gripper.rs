//! VGC10 vacuum gripper over Modbus: grip and verify, hold and watch, release and verify.
//!
//! In: [`GripperCommand`]s, answers to Modbus requests, the time. Out: [`ModbusRequest`]s (one at a time),
//! [`GripperEvent`]s. Vacuum is relative, as a fraction (0 ambient, 0.6 = 60 %). The device has no "part
//! detected": vacuum over a threshold within a time is all there is. It has no watchdog either: without us
//! it goes on as last commanded, which is what a held object needs. Only the registers of the channels in
//! question are written, so that nothing is released by the way.

use crate::device::gripper_identity::Identification;
use crate::device::gripper_types::{
    Channels, GripperCommand, GripperEvent, GripperFault, GripperParameters, GripperRefused, Identity,
    MAX_TARGET, ModbusFailure, ModbusRequest, VACUUM,
};
use crate::device::outbox::{Outbox, earlier};
use cell_values::time::{Duration, Timestamp};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Reading while an object is or may be held: 50 Hz.
const READ_BUSY: Duration = Duration::from_millis(20);
/// Reading otherwise: 10 Hz.
const READ_IDLE: Duration = Duration::from_millis(100);
/// An answer may take this long; each such span without one counts as a failure.
const ANSWER_WITHIN: Duration = Duration::from_millis(200);
/// And while an object is held: three of them, and the arm is ordered to stop within 300 ms.
const ANSWER_WITHIN_HELD: Duration = Duration::from_millis(80);
/// Failures in a row before the gripper counts as unreachable, and tries of a command.
const MAX_FAILURES: u32 = 3;
/// Below the threshold for longer than this and the object counts as lost: readings are noisy.
const LOST_AFTER: Duration = Duration::from_millis(50);
/// A vacuum that has fallen by so much, for so long, goes on falling: something leaks more than the pump
/// makes good. A faster fall ends in a lost object before that. A pump that regulates lets the vacuum fall
/// by a tenth before it runs again (a guess: no figure is published), and readings are noisy by 0.01.
const WEAKER_BY: f64 = 0.15;
const WEAK_AFTER: Duration = Duration::from_millis(200);
/// Readings in a row over the threshold that make a grip.
const GOOD_READINGS: u32 = 2;
/// Below this a channel counts as released.
const RELEASED_BELOW: f64 = 0.05;
/// A reading beyond the possible, overshoot and noise included, is no reading.
const MAX_PER_MILLE: u16 = 1050;
/// Commands that may wait.
const MAX_WAITING: usize = 4;

#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
enum Hold {
    /// Nothing that we know of.
    Empty,
    Gripping {
        channels: Channels,
        deadline: Timestamp,
        good: u32,
    },
    Holding {
        channels: Channels,
        low_since: Option<Timestamp>,
        /// Highest vacuum so far, up to the one that was commanded, and since when it is well below that.
        best: f64,
        falls: Falls,
    },
    /// Gripped or tried to, without success; the pump may be on.
    Failed,
    Releasing {
        channels: Channels,
        deadline: Timestamp,
        /// What the other channel goes on to hold.
        still: Option<Channels>,
    },
}

/// The vacuum of what is held, against what it was.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
enum Falls {
    No,
    Since(Timestamp),
    Reported,
}

impl Hold {
    fn holding(channels: Channels) -> Hold {
        Hold::Holding { channels, low_since: None, best: 0.0, falls: Falls::No }
    }
}

#[derive(Deserialize, Serialize)]
struct Outstanding {
    request: ModbusRequest,
    /// When the next failure counts.
    deadline: Timestamp,
    tries: u32,
}

/// A write to try again.
#[derive(Deserialize, Serialize)]
struct Retry {
    /// Not before this.
    due: Timestamp,
    request: ModbusRequest,
    /// Which try it will be, from 2.
    tries: u32,
}

/// The session. See the module.
#[derive(Deserialize, Serialize)]
pub struct Gripper {
    parameters: GripperParameters,
    hold: Hold,
    /// The vacuum that was commanded last; 1 where none was since the start. A pump may overshoot it.
    target: f64,
    waiting: VecDeque<(Vec<u16>, u16)>,
    outstanding: Option<Outstanding>,
    again: Option<Retry>,
    /// The last command got through.
    written: bool,
    next_read: Timestamp,
    failures: u32,
    answering: bool,
    /// Why it does not answer.
    fault: GripperFault,
    identification: Identification,
    /// The vacuum was read since the last part of the identity.
    identity_due: bool,
    unreachable_reported: bool,
    reading: Option<(Timestamp, [f64; 2])>,
    outbox: Outbox<GripperEvent>,
}

impl Gripper {
    /// A session that starts by reading.
    pub fn new(parameters: GripperParameters) -> Gripper {
        Gripper {
            parameters,
            hold: Hold::Empty,
            target: 1.0,
            waiting: VecDeque::new(),
            outstanding: None,
            again: None,
            written: false,
            next_read: Timestamp::ZERO,
            failures: 0,
            answering: false,
            fault: GripperFault::Silent,
            identification: Identification::default(),
            identity_due: false,
            unreachable_reported: false,
            reading: None,
            outbox: Outbox::default(),
        }
    }

    /// Requests something. The event that it leads to comes in any case: done, or failed after its deadline.
    ///
    /// # Errors
    /// Why it is not done; then nothing has changed.
    pub fn command(&mut self, now: Timestamp, command: GripperCommand) -> Result<(), GripperRefused> {
        if self.waiting.len() >= MAX_WAITING {
            return Err(GripperRefused::QueueFull(self.waiting.len()));
        }
        match command {
            GripperCommand::Grip { channels, target } => {
                if !(0.05..=MAX_TARGET).contains(&target) {
                    return Err(GripperRefused::Target(target));
                }
                match self.hold {
                    Hold::Empty | Hold::Failed => {}
                    Hold::Gripping { .. } | Hold::Holding { .. } | Hold::Releasing { .. } => {
                        return Err(GripperRefused::Holding);
                    }
                }
                let deadline = now + self.parameters.grip_within;
                self.hold = Hold::Gripping { channels, deadline, good: 0 };
                self.target = target;
                self.write(channels, grip_word(target));
            }
            GripperCommand::Release { channels } => {
                let deadline = now + self.parameters.release_within;
                let (channels, still) = match self.hold {
                    Hold::Holding { channels: held, .. } | Hold::Gripping { channels: held, .. } => {
                        (channels, held.without(channels))
                    }
                    // Two releases in haste: neither takes the place of the other.
                    Hold::Releasing { channels: earlier, still, .. } => {
                        (channels.and(earlier), still.and_then(|held| held.without(channels)))
                    }
                    Hold::Empty | Hold::Failed => (channels, None),
                };
                self.hold = Hold::Releasing { channels, deadline, still };
                // A grip that has not gone out yet must not follow the release.
                self.waiting.clear();
                self.again = None;
                self.write(channels, RELEASE);
            }
            GripperCommand::Idle => {
                if !matches!(self.hold, Hold::Empty) {
                    return Err(GripperRefused::Holding);
                }
                self.write(Channels::Both, IDLE);
            }
        }
        self.next_read = now;
        Ok(())
    }

    /// The next request; `None` while one is under way or nothing is due.
    pub fn poll_request(&mut self, now: Timestamp) -> Option<ModbusRequest> {
        if self.outstanding.is_some() {
            return None;
        }
        let (request, tries) = self.next_request(now)?;
        let deadline = now + self.answer_within();
        self.outstanding = Some(Outstanding { request: request.clone(), deadline, tries });
        Some(request)
    }

    fn next_request(&mut self, now: Timestamp) -> Option<(ModbusRequest, u32)> {
        if let Some(Retry { request, tries, .. }) = self.again.take_if(|retry| retry.due <= now) {
            return Some((request, tries));
        }
        if self.again.is_none()
            && let Some((values, address)) = self.waiting.pop_front()
        {
            return Some((ModbusRequest::Write { address, values }, 1));
        }
        if now < self.next_read {
            return self.identity_request().map(|read| (read, 1));
        }
        self.next_read = now + self.read_interval();
        Some((ModbusRequest::Read { address: VACUUM, count: 2 }, 1))
    }

    /// Between two readings of the vacuum there is time for one part of the identity, unless something is
    /// under way that must be noticed at once.
    fn identity_request(&self) -> Option<ModbusRequest> {
        let at_rest = matches!(self.hold, Hold::Empty | Hold::Holding { .. } | Hold::Failed);
        self.identification.request().filter(|_| self.answering && at_rest && self.identity_due)
    }

    /// The answer to the request that is under way; an answer without a request is ignored.
    pub fn response(&mut self, now: Timestamp, answer: Result<Vec<u16>, ModbusFailure>) {
        let Some(outstanding) = self.outstanding.take() else { return };
        if self.identification.concerns(&outstanding.request) {
            return self.identified(answer);
        }
        match (&outstanding.request, answer) {
            (ModbusRequest::Write { .. }, Ok(_)) => {
                self.answered();
                self.written = self.waiting.is_empty();
            }
            (ModbusRequest::Read { .. }, Ok(words)) => match vacuum_of(&words) {
                Ok(vacuum) => {
                    self.answered();
                    self.reading = Some((now, vacuum));
                    self.identity_due = true;
                    self.take_reading(now, vacuum);
                }
                Err(failure) => self.failed(failure),
            },
            (ModbusRequest::Read { .. }, Err(failure)) => self.failed(failure),
            (ModbusRequest::Write { .. }, Err(failure)) => {
                self.failed(failure);
                self.write_failed(now, outstanding);
            }
        }
    }

    fn identified(&mut self, answer: Result<Vec<u16>, ModbusFailure>) {
        self.identity_due = false;
        match &answer {
            Ok(_) | Err(ModbusFailure::Exception(_)) => self.answered(),
            Err(failure) => self.failed(failure.clone()),
        }
        self.identification.response(answer);
    }

    /// Time went by, and the answer that has arrived by now, if any, was handed over.
    pub fn tick(&mut self, now: Timestamp) {
        self.check_deadlines(now);
    }

    fn check_deadlines(&mut self, now: Timestamp) {
        let within = self.answer_within();
        if let Some(outstanding) = &mut self.outstanding
            && now >= outstanding.deadline
        {
            // It stays under way: an answer that comes late must not be taken for that of another request.
            outstanding.deadline = now + within;
            // Keep the last known cause: a timeout alone is less specific.
            self.count_failure(ModbusFailure::Timeout);
        }
        let vacuum = self.reading.map_or([0.0; 2], |(_, vacuum)| vacuum);
        match self.hold {
            Hold::Gripping { channels, deadline, .. } if now >= deadline => {
                self.hold = Hold::Failed;
                self.forget_writes();
                self.outbox.report(GripperEvent::GripFailed { vacuum: channels.lowest(vacuum) });
            }
            Hold::Releasing { channels, deadline, still } if now >= deadline => {
                self.hold = still.map_or(Hold::Failed, Hold::holding);
                self.forget_writes();
                self.outbox.report(GripperEvent::ReleaseFailed { vacuum: channels.highest(vacuum) });
            }
            Hold::Gripping { .. }
            | Hold::Releasing { .. }
            | Hold::Empty
            | Hold::Holding { .. }
            | Hold::Failed => {}
        }
    }

    /// What happened.
    pub fn poll_event(&mut self) -> Option<GripperEvent> {
        self.outbox.poll_event()
    }

    /// When to call [`Gripper::tick`] and [`Gripper::poll_request`] next, and why.
    pub fn poll_timeout(&self) -> Option<(Timestamp, &'static str)> {
        let request = match &self.outstanding {
            Some(outstanding) => (outstanding.deadline, "gripper answer"),
            None if !self.waiting.is_empty() && self.again.is_none() => (Timestamp::ZERO, "gripper command"),
            None => match &self.again {
                Some(retry) => (retry.due, "gripper command again"),
                None if self.identity_request().is_some() => (Timestamp::ZERO, "gripper identity"),
                None => (self.next_read, "gripper reading"),
            },
        };
        let action = match self.hold {
            Hold::Gripping { deadline, .. } => Some((deadline, "grip")),
            Hold::Releasing { deadline, .. } => Some((deadline, "release")),
            Hold::Empty | Hold::Holding { .. } | Hold::Failed => None,
        };
        earlier(Some(request), action)
    }

    /// The last reading and its time.
    pub fn reading(&self) -> Option<(Timestamp, [f64; 2])> {
        self.reading
    }

    /// True if the last request was answered.
    pub fn answering(&self) -> bool {
        self.answering
    }

    /// Why it does not answer, while it does not.
    pub fn fault(&self) -> Option<GripperFault> {
        (!self.answering).then_some(self.fault)
    }

    /// Which gripper it is, once it has said so; read again whenever it was unreachable.
    pub fn identity(&self) -> Option<Identity> {
        self.identification.identity()
    }

    /// True while an object is held as far as the vacuum shows.
    pub fn holding(&self) -> bool {
        matches!(self.hold, Hold::Holding { .. })
    }

    fn answer_within(&self) -> Duration {
        if self.holding() { ANSWER_WITHIN_HELD } else { ANSWER_WITHIN }
    }

    fn read_interval(&self) -> Duration {
        match self.hold {
            Hold::Empty => READ_IDLE,
            Hold::Gripping { .. } | Hold::Holding { .. } | Hold::Failed | Hold::Releasing { .. } => READ_BUSY,
        }
    }

    fn write(&mut self, channels: Channels, word: u16) {
        self.written = false;
        self.waiting.push_back((vec![word; channels.count()], channels.first_register()));
    }

    /// A command whose time is over must not be carried out later, when the arm is elsewhere.
    fn forget_writes(&mut self) {
        self.waiting.clear();
        self.again = None;
    }

    fn write_failed(&mut self, now: Timestamp, outstanding: Outstanding) {
        // A command that came meanwhile (a release after a grip) makes this one void.
        let overtaken = !self.waiting.is_empty();
        if outstanding.tries < MAX_FAILURES && !overtaken && !matches!(self.hold, Hold::Failed) {
            let Outstanding { request, tries, .. } = outstanding;
            self.again = Some(Retry { due: now + READ_BUSY, request, tries: tries + 1 });
        }
    }

    fn answered(&mut self) {
        (self.failures, self.fault) = (0, GripperFault::Silent);
        self.unreachable_reported = false;
        if !self.answering {
            self.answering = true;
            self.identification.begin();
            self.outbox.report(GripperEvent::Answering);
        } else {
            self.identification.spoke();
        }
    }

    fn failed(&mut self, cause: ModbusFailure) {
        self.fault = GripperFault::from(&cause);
        self.count_failure(cause);
    }

    fn count_failure(&mut self, cause: ModbusFailure) {
        self.failures = self.failures.saturating_add(1);
        if self.failures >= MAX_FAILURES && !self.unreachable_reported {
            self.unreachable_reported = true;
            self.answering = false;
            self.outbox.report(GripperEvent::Unreachable { failures: self.failures, cause });
        }
    }

    /// What hangs there although nothing was gripped since the start, as after a restart, or after a grip or
    /// a release that failed, is watched as well.
    fn adopt(&mut self, vacuum: [f64; 2]) {
        let held = vacuum.map(|share| share >= self.parameters.vacuum_hold);
        let channels = match held {
            [true, true] => Channels::Both,
            [true, false] => Channels::A,
            [false, true] => Channels::B,
            [false, false] => return,
        };
        self.hold = Hold::holding(channels);
    }

    fn take_reading(&mut self, now: Timestamp, vacuum: [f64; 2]) {
        self.outbox.report(GripperEvent::Reading { vacuum });
        match &mut self.hold {
            Hold::Empty | Hold::Failed => self.adopt(vacuum),
            Hold::Gripping { channels, good, .. } => {
                let (channels, lowest) = (*channels, channels.lowest(vacuum));
                *good = if lowest >= self.parameters.vacuum_min { *good + 1 } else { 0 };
                if *good >= GOOD_READINGS && self.written {
                    self.hold = Hold::holding(channels);
                    self.outbox.report(GripperEvent::Gripped { vacuum: lowest });
                }
            }
            Hold::Holding { channels, low_since, best, falls } => {
                let lowest = channels.lowest(vacuum);
                *best = best.max(lowest.min(self.target));
                let weak = lowest < *best - WEAKER_BY;
                match *falls {
                    Falls::Since(since) if weak && now.since(since) > WEAK_AFTER => {
                        *falls = Falls::Reported;
                        self.outbox.report(GripperEvent::VacuumWeak { vacuum: lowest, best: *best });
                    }
                    Falls::No if weak => *falls = Falls::Since(now),
                    Falls::Since(_) if !weak => *falls = Falls::No,
                    Falls::No | Falls::Since(_) | Falls::Reported => {}
                }
                if lowest >= self.parameters.vacuum_hold {
                    *low_since = None;
                } else if now.since(*low_since.get_or_insert(now)) > LOST_AFTER {
                    self.hold = Hold::Failed;
                    self.outbox.report(GripperEvent::VacuumLost { vacuum: lowest });
                }
            }
            Hold::Releasing { channels, still, .. } => {
                // Before the command got through a low vacuum proves nothing: the pump may be on.
                if self.written && channels.highest(vacuum) < RELEASED_BELOW {
                    self.hold = match *still {
                        Some(channels) => Hold::holding(channels),
                        None => Hold::Empty,
                    };
                    self.outbox.report(GripperEvent::Released);
                }
            }
        }
    }
}

const RELEASE: u16 = 0x0000;
const IDLE: u16 = 0x0200;

/// High byte 1 = grip, low byte target in per cent.
fn grip_word(target: f64) -> u16 {
    0x0100 | (target * 100.0).round().clamp(0.0, 80.0) as u16
}

/// Relative vacuum of both channels from its two registers.
///
/// # Errors
/// They are no two plausible readings.
pub fn vacuum_of(words: &[u16]) -> Result<[f64; 2], ModbusFailure> {
    match *words {
        [a, b] if a <= MAX_PER_MILLE && b <= MAX_PER_MILLE => Ok([f64::from(a) / 1e3, f64::from(b) / 1e3]),
        [_, _] => Err(ModbusFailure::Malformed(format!("vacuum readings {words:?} per mille"))),
        _ => Err(ModbusFailure::Malformed(format!("{} registers instead of 2", words.len()))),
    }
}

#[cfg(test)]
mod tests;
