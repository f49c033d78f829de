//! The commit gate: entries that are on their way to the disk, and for how long.
//!
//! In: entries to commit, the word that one is on disk. Out: their numbers, whether any is open, whether the
//! disk is slow or silent. The machine's phases wait for the number of their entry; a stop leaves the phase,
//! and the entry it waited for is written all the same and counts for nothing but the journal.

use cell_values::time::{Duration, Timestamp};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// An entry that takes longer is reported: the arm waits for it, and people should know why.
const SLOW_AFTER: Duration = Duration::from_secs(1);

/// A disk that has not answered for so long is given up.
pub(crate) const SILENT_AFTER: Duration = Duration::from_secs(15);

/// Entries on their way to the disk.
#[derive(Debug, Default, Deserialize, Serialize)]
pub(crate) struct Ledger {
    last: u64,
    open: VecDeque<(u64, Timestamp)>,
    reported: bool,
    /// The journal cannot be used: what is still written counts for nothing.
    given_up: bool,
}

/// What is to be said of the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Disk {
    /// Nothing.
    Fine,
    /// An entry has been on its way for over a second; once.
    Slow,
    /// An entry has been on its way for too long.
    Silent,
}

impl Ledger {
    /// Number of a new entry.
    pub fn open(&mut self, now: Timestamp) -> u64 {
        self.last += 1;
        self.open.push_back((self.last, now));
        self.last
    }

    /// The entry has reached the disk, or has failed to.
    pub fn close(&mut self, number: u64) {
        self.open.retain(|(open, _)| *open != number);
    }

    /// Nothing is waited for any more.
    pub fn give_up(&mut self) {
        self.open.clear();
        self.given_up = true;
    }

    /// The journal was given up.
    pub fn is_given_up(&self) -> bool {
        self.given_up
    }

    /// True when everything is on disk, or nothing can be.
    pub fn is_clear(&self) -> bool {
        self.open.is_empty() || self.given_up
    }

    /// Counts from now on for how long entries are on their way: celld itself was held up until now.
    pub fn start_again(&mut self, now: Timestamp) {
        self.open.iter_mut().for_each(|(_, since)| *since = now);
    }

    /// How the disk does.
    pub fn judge(&mut self, now: Timestamp) -> Disk {
        if self.given_up {
            return Disk::Fine;
        }
        let waits = self.open.front().map_or(Duration::ZERO, |(_, since)| now.since(*since));
        if waits >= SILENT_AFTER {
            return Disk::Silent;
        }
        let slow = waits >= SLOW_AFTER;
        let news = slow && !self.reported;
        self.reported = slow;
        if news { Disk::Slow } else { Disk::Fine }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_disk_is_reported_once_and_a_silent_one_is_given_up() {
        let at = Timestamp::from_secs_f64;
        let mut ledger = Ledger::default();
        assert!(ledger.is_clear());
        let first = ledger.open(at(1.0));
        let second = ledger.open(at(1.5));
        assert_eq!((second - first, ledger.is_clear()), (1, false));
        assert_eq!(ledger.judge(at(1.9)), Disk::Fine);
        assert_eq!(ledger.judge(at(2.1)), Disk::Slow);
        assert_eq!(ledger.judge(at(2.2)), Disk::Fine);
        ledger.close(first);
        assert_eq!(ledger.judge(at(2.3)), Disk::Fine, "the second waits for 0.8 s");
        assert_eq!(ledger.judge(at(2.6)), Disk::Slow);
        assert_eq!(ledger.judge(at(16.5)), Disk::Silent);
        ledger.start_again(at(16.5));
        assert_eq!(ledger.judge(at(17.0)), Disk::Fine, "a pause of celld is none of the disk");
        ledger.close(second);
        assert_eq!((ledger.is_clear(), ledger.judge(at(99.0))), (true, Disk::Fine));
    }
}
