//! A script's watches over inputs that clients have to keep writing (`rtde_set_watchdog`).
//!
//! In: the registers in each frame. Out: what to do when one has run out. Pure.

use crate::controller::registers::{Input, Registers};
use crate::motion::FRAMES_PER_SECOND;

/// What a watchdog does when its client falls silent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WatchdogAction {
    /// Pauses the program.
    Pause,
    /// Ends the program.
    Stop,
}

/// A script's watch over an input that a client has to keep writing.
#[derive(Clone, Debug)]
pub struct Watchdog {
    input: Input,
    limit: u64,
    silent: u64,
    last_package: u64,
    action: Option<WatchdogAction>,
}

impl Watchdog {
    /// A watch over an input that is to be written `frequency_hz` times a second; without an action it only
    /// takes the place of another.
    pub fn new(
        input: Input,
        frequency_hz: f64,
        action: Option<WatchdogAction>,
        registers: &Registers,
    ) -> Watchdog {
        let limit = (FRAMES_PER_SECOND as f64 / frequency_hz).ceil().min(1e9) as u64;
        Watchdog { input, limit, silent: 0, last_package: registers.last_written(input), action }
    }

    /// What is watched.
    pub fn input(&self) -> Input {
        self.input
    }

    /// Counts a frame; what to do if the client has been silent for too long.
    pub fn count(&mut self, registers: &Registers) -> Option<WatchdogAction> {
        let package = registers.last_written(self.input);
        self.silent = if package == self.last_package { self.silent + 1 } else { 0 };
        self.last_package = package;
        if self.silent <= self.limit {
            return None;
        }
        self.silent = 0;
        self.action
    }
}
