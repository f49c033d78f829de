//! A person or a program that gives one order to the cell.
//!
//! In: when the order is given, by which way, and when who gave it leaves. Out: what it does in each frame.

use crate::jobs::command::Command;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use ur_sim::motion::FRAME_SECONDS;

/// How an order is given.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Way {
    /// As a file in the folder of commands, by `celld` and its like.
    File,
    /// At the page, in this session.
    Page(String),
}

/// How a client leaves that has no answer after so many seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Leaves {
    /// It takes back what nobody has taken yet: Ctrl-C, or its patience has ended.
    GivesUp(f64),
    /// It is killed, and takes nothing back.
    Killed(f64),
}

/// The client. See the module.
#[derive(Clone, Debug)]
pub struct Client {
    /// What it orders.
    pub command: Command,
    /// How.
    pub way: Way,
    /// The file that it has left.
    pub file: Option<String>,
    gives_at: u64,
    leaves: Leaves,
    given: Option<u64>,
    left: Option<u64>,
    done: bool,
    waits: Arc<AtomicBool>,
}

impl Client {
    /// Gives an order in this frame.
    pub fn new(command: Command, way: Way, gives_at: u64, leaves: Leaves) -> Client {
        let waits = Arc::new(AtomicBool::new(true));
        Client { command, way, file: None, gives_at, leaves, given: None, left: None, done: false, waits }
    }

    /// The frame in which it has given its order.
    pub fn given_in(&self) -> Option<u64> {
        self.given
    }

    /// The frame in which it has left without an answer.
    pub fn left_in(&self) -> Option<u64> {
        self.left
    }

    /// It has its answer, or its order has come to nothing.
    pub fn is_done(&self) -> bool {
        self.done
    }

    pub(super) fn gives_in(&self, frame: u64) -> bool {
        !self.done && self.given.is_none() && frame >= self.gives_at
    }

    pub(super) fn given(&mut self, frame: u64) -> Arc<AtomicBool> {
        self.given = Some(frame);
        self.waits.clone()
    }

    pub(super) fn waits(&self) -> &AtomicBool {
        &self.waits
    }

    pub(super) fn done(&mut self) {
        self.done = true;
    }

    /// It leaves in this frame: whether it was killed.
    pub(super) fn leaves_in(&mut self, frame: u64) -> Option<bool> {
        let (after_s, killed) = match self.leaves {
            Leaves::GivesUp(after_s) => (after_s, false),
            Leaves::Killed(after_s) => (after_s, true),
        };
        let given = self.given.filter(|_| !self.done && self.left.is_none())?;
        if frame < given + (after_s / FRAME_SECONDS) as u64 {
            return None;
        }
        self.left = Some(frame);
        Some(killed)
    }
}
