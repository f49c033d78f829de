//! The connection to the gripper's box: when to connect, which answer belongs to which request, when a
//! connection is given up.
//!
//! In: requests, one at a time; what becomes of connections; the time. Out: [`Action`]s for sockets, one
//! answer or failure for each request. Pure; the daemon and the simulated network drive the same code.
//!
//! The box serves one client (Connectivity Guide). What it does with a second one is not published: it may
//! refuse it, close its connection or evict the first. A client that loses power may hold the only place
//! for long. So a connection is kept as long as it may work:
//!
//! - A read without an answer for 1 s has failed, and the connection stays. An answer that comes later has
//!   the number of an earlier request, and is dropped.
//! - A write without an answer for 1 s has failed, and the connection is reset: TCP would deliver the
//!   command once the cable is back, when the arm is elsewhere.
//! - After 1 s of silence we connect a second time. If the box takes that connection, or refuses it, the
//!   network works and the old connection does not: it is reset, which frees its place if the
//!   box receives the reset.
//! - A command that was sent on a silent connection is sent on the next one too. It may arrive twice within
//!   its second, and does the same each time.
//! - On a new connection we read first, and send a command only after an answer. A box that queues clients
//!   would otherwise carry the command out whenever our turn comes.
//! - If the box never answers, we keep the connection for 30 s: a new one would lose our place in the queue.
//! - A connection that is given up is reset, never closed in order: what it has not delivered must not
//!   reach the gripper after what the next one says.
//! - A box that closes our connection twice within 10 s gives the place to another client. We wait 1 s
//!   before we take it again, so that two clients do not evict each other unseen.

use crate::device::gripper_types::{ModbusFailure, ModbusRequest, VACUUM};
use crate::device::modbus::{Answer, Answers, request_bytes};
use crate::device::outbox::earlier;
use cell_values::time::{Duration, Timestamp};
use std::collections::VecDeque;

/// A request without an answer for so long has failed.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);
/// After this much silence with a request under way a second connection is tried.
const SILENT_AFTER: Duration = Duration::from_secs(1);
/// A box that serves us answers the first request within this.
const UNSERVED_AFTER: Duration = Duration::from_millis(500);
/// A connection without any answer is replaced after this.
const KEPT_UNSERVED: Duration = Duration::from_secs(30);
/// An attempt to connect takes at most so long.
const CONNECT_WITHIN: Duration = Duration::from_secs(1);
/// Between two attempts.
const CONNECT_AGAIN: Duration = Duration::from_millis(250);
/// If the device ends two connections within this time, another client takes its place.
const EVICTED_WITHIN: Duration = Duration::from_secs(10);
/// Wait after that.
const EVICTED_WAIT: Duration = Duration::from_secs(1);

/// Sent before the first command on a connection.
const PROBE: ModbusRequest = ModbusRequest::Read { address: VACUUM, count: 2 };

/// What the sockets have to do. Connections have numbers that are not used again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Connect; [`Master::connected`] or [`Master::closed`] follows.
    Connect(u64),
    /// Send on a connection.
    Send(u64, Vec<u8>),
    /// Reset a connection, or give the attempt up; nothing more is said of it.
    Reset(u64),
}

/// How a connection ended, or why there is none.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The device refuses connections.
    Refused,
    /// The device closed or reset it.
    Closed,
    /// Anything else, with the system's words.
    Other(String),
}

/// A request whose answer is waited for.
struct UnderWay {
    request: ModbusRequest,
    deadline: Timestamp,
    /// A command that waits for the connection's first answer.
    unsent: bool,
}

/// A connection that was made.
struct Connection {
    number: u64,
    answers: Answers,
    /// Something was answered on it.
    answered: bool,
    /// Since when nothing has come although a request was sent.
    silent_since: Option<Timestamp>,
    /// A second attempt to connect has failed since: the network is down.
    out_of_reach: bool,
}

/// See the module.
pub struct Master {
    unit: u8,
    /// Of the last request.
    transaction: u16,
    request: Option<UnderWay>,
    connection: Option<Connection>,
    attempt: Option<(u64, Timestamp)>,
    last_number: u64,
    /// No attempt before this.
    not_before: Timestamp,
    /// When the device last ended a connection on which it had answered.
    ended: Option<Timestamp>,
    /// Why there is no connection.
    cause: ModbusFailure,
    actions: VecDeque<Action>,
    results: VecDeque<Result<Vec<u16>, ModbusFailure>>,
}

impl Master {
    /// Nothing is connected; the first request connects.
    pub fn new(unit: u8) -> Master {
        Master {
            unit,
            transaction: 0,
            request: None,
            connection: None,
            attempt: None,
            last_number: 0,
            not_before: Timestamp::ZERO,
            ended: None,
            cause: ModbusFailure::Timeout,
            actions: VecDeque::new(),
            results: VecDeque::new(),
        }
    }

    /// Begins a request; its result follows. One is under way at a time: an earlier one fails.
    pub fn request(&mut self, now: Timestamp, request: ModbusRequest) {
        self.expire(now);
        self.transaction = self.transaction.wrapping_add(1);
        let deadline = now + ANSWER_WITHIN;
        self.request = Some(UnderWay { request: request.clone(), deadline, unsent: false });
        if self.connection.is_some() {
            self.send(now);
        } else if self.attempt.is_none() && now < self.not_before {
            // A reading follows soon. A command has few tries, and waits.
            if matches!(request, ModbusRequest::Read { .. }) {
                self.fail(self.cause.clone());
            }
        } else {
            self.connect(now);
        }
    }

    /// The attempt with this number has led to a connection.
    pub fn connected(&mut self, now: Timestamp, number: u64) {
        if self.attempt.take_if(|(attempt, _)| *attempt == number).is_none() {
            return;
        }
        self.expire_if_due(now);
        self.give_up();
        self.connection = Some(Connection {
            number,
            answers: Answers::default(),
            answered: false,
            silent_since: None,
            out_of_reach: false,
        });
        self.send(now);
    }

    /// A connection has ended, or an attempt has led to none.
    pub fn closed(&mut self, now: Timestamp, number: u64, ending: Ending) {
        if self.attempt.take_if(|(attempt, _)| *attempt == number).is_some() {
            return self.attempt_failed(now, ending);
        }
        let Some(connection) = self.connection.take_if(|connection| connection.number == number) else {
            return;
        };
        let again = self.ended.is_some_and(|before| now.since(before) < EVICTED_WITHIN);
        let (cause, wait) = match (connection.answered, ending) {
            (false, Ending::Refused | Ending::Closed) => (ModbusFailure::Taken, CONNECT_AGAIN),
            (false, Ending::Other(words)) => (ModbusFailure::Connection(words), CONNECT_AGAIN),
            (true, Ending::Refused | Ending::Closed) if again => (ModbusFailure::Taken, EVICTED_WAIT),
            (true, Ending::Refused | Ending::Closed) => {
                (ModbusFailure::Connection("closed by the device".to_string()), Duration::ZERO)
            }
            (true, Ending::Other(words)) => (ModbusFailure::Connection(words), CONNECT_AGAIN),
        };
        if connection.answered {
            self.ended = Some(now);
        }
        self.cause = cause;
        self.not_before = now + wait;
        self.fail(self.cause.clone());
    }

    /// Bytes have arrived on a connection.
    pub fn received(&mut self, now: Timestamp, number: u64, bytes: &[u8]) {
        // A command must not go out after its time because we were held up.
        self.expire_if_due(now);
        let Some(connection) = self.connection.as_mut().filter(|it| it.number == number) else { return };
        connection.silent_since = self.request.is_some().then_some(now);
        connection.answers.push(bytes);
        // It works: no second one is needed.
        if let Some((attempt, _)) = self.attempt.take() {
            self.actions.push_back(Action::Reset(attempt));
        }
        while let Some(answer) = self.next_answer() {
            let unsent = self.request.as_ref().is_some_and(|under_way| under_way.unsent);
            let outcome = answer.and_then(|answer| match self.transaction.wrapping_sub(answer.transaction) {
                0 if !unsent => Ok(self.request.take().map(|under_way| answer.words(&under_way.request))),
                1..0x8000 => Ok(None),
                _ => Err(ModbusFailure::Malformed(format!(
                    "an answer to request {}, and the last one was {}",
                    answer.transaction, self.transaction
                ))),
            });
            match outcome {
                Ok(None) => self.is_served(now),
                Ok(Some(result)) => {
                    self.is_served(now);
                    self.take_result(result);
                }
                Err(failure) => return self.drop_connection(now, failure),
            }
        }
    }

    /// Time went by.
    pub fn tick(&mut self, now: Timestamp) {
        if self.attempt.is_some_and(|(_, since)| now >= since + CONNECT_WITHIN) {
            if let Some((attempt, _)) = self.attempt.take() {
                self.actions.push_back(Action::Reset(attempt));
            }
            match &mut self.connection {
                Some(connection) => connection.out_of_reach = true,
                None => self.cause = ModbusFailure::Timeout,
            }
        }
        self.expire_if_due(now);
        if self.attempt_due().is_some_and(|due| now >= due) {
            self.connect(now);
        }
    }

    fn expire_if_due(&mut self, now: Timestamp) {
        if self.request.as_ref().is_some_and(|under_way| now >= under_way.deadline) {
            self.expire(now);
        }
    }

    /// The request under way has failed, if there is one.
    fn expire(&mut self, now: Timestamp) {
        let unserved = |connection: &Connection| {
            let long = connection.silent_since.is_some_and(|since| now >= since + UNSERVED_AFTER);
            long && !connection.answered && !connection.out_of_reach
        };
        let failure = match &self.connection {
            Some(connection) if unserved(connection) => ModbusFailure::Unserved,
            Some(_) | None => ModbusFailure::Timeout,
        };
        match &self.request {
            Some(UnderWay { request: ModbusRequest::Write { .. }, unsent: false, .. }) => {
                self.drop_connection(now, failure);
            }
            Some(_) | None => self.fail(failure),
        }
    }

    /// When to call [`Master::tick`] next, at the latest.
    pub fn poll_timeout(&self) -> Option<Timestamp> {
        let request = self.request.as_ref().map(|under_way| (under_way.deadline, ()));
        let attempt = self.attempt.map(|(_, since)| (since + CONNECT_WITHIN, ()));
        let next = self.attempt_due().map(|due| (due, ()));
        earlier(earlier(request, attempt), next).map(|(due, ())| due)
    }

    /// What the sockets have to do next.
    pub fn poll_action(&mut self) -> Option<Action> {
        self.actions.pop_front()
    }

    /// The next result: the registers read, nothing for a write.
    pub fn poll_result(&mut self) -> Option<Result<Vec<u16>, ModbusFailure>> {
        self.results.pop_front()
    }

    /// When the next attempt begins: for a command that waits, or because the connection is silent.
    fn attempt_due(&self) -> Option<Timestamp> {
        let wanted = match &self.connection {
            Some(connection) => {
                let after = if connection.answered { SILENT_AFTER } else { KEPT_UNSERVED };
                connection.silent_since.map(|since| since + after)
            }
            None => self.request.as_ref().map(|_| Timestamp::ZERO),
        };
        wanted.filter(|_| self.attempt.is_none()).map(|due| due.max(self.not_before))
    }

    fn connect(&mut self, now: Timestamp) {
        if self.attempt.is_none() {
            self.last_number += 1;
            self.attempt = Some((self.last_number, now));
            self.actions.push_back(Action::Connect(self.last_number));
        }
    }

    fn send(&mut self, now: Timestamp) {
        let (Some(connection), Some(under_way)) = (&mut self.connection, &mut self.request) else { return };
        connection.silent_since.get_or_insert(now);
        under_way.unsent = !connection.answered && matches!(under_way.request, ModbusRequest::Write { .. });
        let request = if under_way.unsent { &PROBE } else { &under_way.request };
        let bytes = request_bytes(self.transaction, self.unit, request);
        self.actions.push_back(Action::Send(connection.number, bytes));
        if under_way.unsent {
            // The command gets the next number: the probe's answer is not taken for its own.
            self.transaction = self.transaction.wrapping_add(1);
        }
    }

    /// The box has answered on this connection, so a command may go out.
    fn is_served(&mut self, now: Timestamp) {
        let Some(connection) = &mut self.connection else { return };
        connection.answered = true;
        if self.request.as_ref().is_some_and(|under_way| under_way.unsent) {
            self.send(now);
        }
    }

    fn next_answer(&mut self) -> Option<Result<Answer, ModbusFailure>> {
        self.connection.as_mut()?.answers.next_answer().transpose()
    }

    fn take_result(&mut self, result: Result<Vec<u16>, ModbusFailure>) {
        if let Some(connection) = &mut self.connection {
            connection.silent_since = None;
        }
        self.results.push_back(result);
    }

    fn attempt_failed(&mut self, now: Timestamp, ending: Ending) {
        self.not_before = now + CONNECT_AGAIN;
        let cause = match ending {
            Ending::Refused => ModbusFailure::Refused,
            Ending::Closed => ModbusFailure::Taken,
            Ending::Other(words) => ModbusFailure::Connection(words),
        };
        match &mut self.connection {
            None => {
                self.cause = cause;
                self.fail(self.cause.clone());
            }
            // The box is there, and the only place may be held by the connection that is dead.
            Some(_) if cause == ModbusFailure::Refused => self.drop_connection(now, cause),
            Some(connection) => {
                connection.out_of_reach |= matches!(cause, ModbusFailure::Connection(_));
            }
        }
    }

    fn drop_connection(&mut self, now: Timestamp, cause: ModbusFailure) {
        self.give_up();
        // A device that cannot be understood is not understood better at once.
        let wait = if matches!(cause, ModbusFailure::Malformed(_)) { CONNECT_AGAIN } else { Duration::ZERO };
        self.cause = cause;
        self.not_before = self.not_before.max(now + wait);
        self.fail(self.cause.clone());
    }

    fn give_up(&mut self) {
        if let Some(connection) = self.connection.take() {
            self.actions.push_back(Action::Reset(connection.number));
        }
    }

    fn fail(&mut self, failure: ModbusFailure) {
        if self.request.take().is_some() {
            self.results.push_back(Err(failure));
        }
    }
}

#[cfg(test)]
mod tests;
