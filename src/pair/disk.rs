//! The disk under the journal in virtual time: what was acknowledged survives, the rest may or may not.
//!
//! In: commits, the time, moods (slow, full, broken, silent), a cut of power or a kill. Out:
//! acknowledgements in the order of the commits, and after a restart what is on disk. A seeded model of the
//! commit record: real SQLite is in the tests that kill real processes.

use cell_machine::supervisor::input::Record;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;

/// How the disk is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mood {
    /// 2 to 20 ms a commit.
    Fine,
    /// Every commit takes so many seconds.
    Slow(f64),
    /// Commits fail: no space.
    Full,
    /// Commits fail: input/output error.
    Broken,
    /// Commits never come back.
    Silent,
}

/// Frame in which a swallowed commit is due.
const NEVER: u64 = u64::MAX / 2;

/// A commit that is not acknowledged yet.
struct Commit {
    /// Frame in which it comes back.
    due: u64,
    /// For the acknowledgement.
    number: u64,
    /// What it writes.
    record: Record,
}

/// The disk. See the module.
pub struct Disk {
    rng: ChaCha8Rng,
    /// How it is from now on.
    pub mood: Mood,
    under_way: VecDeque<Commit>,
    durable: Vec<Record>,
}

impl Disk {
    /// An empty disk.
    pub fn new(seed: u64) -> Disk {
        let rng = ChaCha8Rng::seed_from_u64(seed ^ 0x6469_736b);
        Disk { rng, mood: Mood::Fine, under_way: VecDeque::new(), durable: Vec::new() }
    }

    /// A commit begins.
    pub fn commit(&mut self, frame: u64, number: u64, record: Record) {
        let frames = match self.mood {
            Mood::Fine | Mood::Full | Mood::Broken => self.rng.random_range(1..=10),
            Mood::Slow(seconds) => (seconds * 500.0) as u64,
            Mood::Silent => NEVER,
        };
        let after = self.under_way.back().map_or(0, |commit| commit.due);
        self.under_way.push_back(Commit { due: (frame + frames).max(after), number, record });
    }

    /// Commits that come back in this frame, with what they wrote.
    pub fn step(&mut self, frame: u64) -> Option<(u64, Result<Record, String>)> {
        self.under_way.front().filter(|commit| commit.due <= frame)?;
        let Commit { number, record, .. } = self.under_way.pop_front()?;
        Some(match self.mood {
            Mood::Full => (number, Err("database or disk is full".to_string())),
            Mood::Broken => (number, Err("disk I/O error".to_string())),
            Mood::Fine | Mood::Slow(_) | Mood::Silent => {
                self.durable.push(record.clone());
                (number, Ok(record))
            }
        })
    }

    /// The process or the power is gone: of what was not acknowledged, some of the first commits are on
    /// disk.
    pub fn cut(&mut self) {
        let survivors = self.rng.random_range(0..=self.under_way.len());
        let survivors = if self.mood == Mood::Fine { survivors } else { 0 };
        self.durable.extend(self.under_way.drain(..).take(survivors).map(|commit| commit.record));
    }

    /// A commit never comes back, or would not if one began.
    pub fn swallows(&self) -> bool {
        self.mood == Mood::Silent || self.under_way.back().is_some_and(|commit| commit.due >= NEVER)
    }

    /// Drops what is on disk.
    pub fn forget(&mut self) {
        self.durable.clear();
    }

    /// Everything on disk, in order.
    pub fn durable(&self) -> &[Record] {
        &self.durable
    }
}
