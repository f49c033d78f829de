//! The connection to the gripper's box: carries out what [`Master`] decides.
//!
//! In: requests; what arrives. Out: the answer to each request, as an event. For a short time there are two
//! connections: the old one is silent, and the new one is being made.

use crate::daemon::messages::{Made, Message, Peer};
use crate::daemon::sockets::stream::{Over, Stream, attempt};
use cell_edge::clock::Clock;
use cell_machine::device::gripper_types::ModbusRequest;
use cell_machine::device::modbus::master::{Action, Ending, Master};
use cell_machine::event::Event;
use cell_values::time::Timestamp;
use std::io;
use std::net::SocketAddr;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

/// See the module.
pub struct GripperLine {
    master: Master,
    address: SocketAddr,
    connecting: Option<(u64, JoinHandle<()>)>,
    streams: Vec<(u64, Stream)>,
    /// Answers for the next [`GripperLine::take`].
    answers: Vec<Event>,
    clock: Clock,
    messages: mpsc::Sender<Message>,
}

impl GripperLine {
    /// Nothing is connected yet; the box at `address` has the gripper as `unit`.
    pub fn new(
        (address, unit): (SocketAddr, u8),
        clock: Clock,
        messages: mpsc::Sender<Message>,
    ) -> GripperLine {
        GripperLine {
            master: Master::new(unit),
            address,
            connecting: None,
            streams: Vec::new(),
            answers: Vec::new(),
            clock,
            messages,
        }
    }

    /// Begins a request.
    pub fn request(&mut self, request: ModbusRequest) {
        self.master.request(self.clock.now(), request);
        self.act();
    }

    /// A connection was made, or could not be.
    pub fn made(&mut self, Made { attempt, result, .. }: Made) {
        if self.connecting.take_if(|(number, _)| *number == attempt).is_none() {
            return;
        }
        let now = self.clock.now();
        match result.and_then(Stream::new) {
            Ok(stream) => {
                stream.repeats_soon();
                stream.ends_with_reset();
                self.streams.push((attempt, stream));
                self.master.connected(now, attempt);
            }
            Err(error) => self.master.closed(now, attempt, ending(&error)),
        }
        self.act();
    }

    /// The answers, and what has arrived.
    pub fn take(&mut self, buffer: &mut [u8], events: &mut Vec<Event>) {
        let now = self.clock.now();
        let mut over = Vec::new();
        for (number, stream) in &mut self.streams {
            stream.write(now);
            let master = &mut self.master;
            let ended = stream.read(now, buffer, |bytes| master.received(now, *number, &bytes));
            over.extend(ended.map(|ended| (*number, ended)));
        }
        for (number, ended) in over {
            self.streams.retain(|(other, _)| *other != number);
            self.master.closed(
                now,
                number,
                match ended {
                    Over::Closed => Ending::Closed,
                    Over::Broken(error) => ending(&error),
                    Over::Unread => Ending::Other("the gripper does not read".to_string()),
                },
            );
        }
        self.master.tick(now);
        self.act();
        events.append(&mut self.answers);
    }

    /// When to call [`GripperLine::take`] next, also if nothing arrives.
    pub fn next_wake(&self) -> Option<Timestamp> {
        if self.answers.is_empty() { self.master.poll_timeout() } else { Some(Timestamp::ZERO) }
    }

    /// The connections.
    pub fn streams(&self) -> impl Iterator<Item = &Stream> {
        self.streams.iter().map(|(_, stream)| stream)
    }

    fn act(&mut self) {
        while let Some(action) = self.master.poll_action() {
            match action {
                Action::Connect(number) => {
                    let task = attempt(Peer::Gripper, number, self.address, self.messages.clone());
                    self.connecting = Some((number, task));
                }
                Action::Send(number, bytes) => {
                    let now = self.clock.now();
                    if let Some((_, stream)) = self.streams.iter_mut().find(|(other, _)| *other == number) {
                        stream.send(now, &bytes);
                    }
                }
                Action::Reset(number) => self.reset(number),
            }
        }
        let results = std::iter::from_fn(|| self.master.poll_result());
        self.answers.extend(results.map(Event::Registers));
    }

    fn reset(&mut self, number: u64) {
        if let Some((_, task)) = self.connecting.take_if(|(other, _)| *other == number) {
            task.abort();
        }
        self.streams.retain(|(other, _)| *other != number);
    }
}

fn ending(error: &io::Error) -> Ending {
    match error.kind() {
        io::ErrorKind::ConnectionRefused => Ending::Refused,
        io::ErrorKind::ConnectionReset | io::ErrorKind::ConnectionAborted | io::ErrorKind::BrokenPipe => {
            Ending::Closed
        }
        _ => Ending::Other(error.to_string()),
    }
}
