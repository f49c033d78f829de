//! A run's recording, carried out again beside it.
//!
//! In: what the machine takes in and gives out. Out: the first difference of the same run again, by way of
//! the recording's bytes (`cell::replay`). At seeded times the recording is stitched: all of the machine is
//! written down and has to equal what was replayed, which then goes on from these bytes, so that a state
//! which is not wholly written shows in what it decides.

use cell_machine::event::{Effect, Event};
use cell_machine::machine::Machine;
use cell_replay::{Difference, Piece, Replay, Replayed, Unreadable};
use cell_values::time::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Turns between two stitches, from and to.
const STITCH: (u64, u64) = (50, 5_000);

/// The longest text of a difference: states are long.
const SHOWN: usize = 600;

/// See the module.
pub struct Mirror {
    replay: Replay,
    before: Replayed,
    rng: ChaCha8Rng,
    turns: u64,
    fault: Option<String>,
    /// The recording, where it is wanted.
    kept: Option<Vec<Piece>>,
}

impl Mirror {
    /// Begins with this machine.
    pub fn new(seed: u64, now: Timestamp, machine: &Machine) -> Mirror {
        let rng = ChaCha8Rng::seed_from_u64(seed ^ 0x6d69_7272);
        let (replay, before) = (Replay::default(), Replayed::default());
        let mut mirror = Mirror { replay, before, rng, turns: 0, fault: None, kept: None };
        mirror.take(Piece::machine(now, machine, false));
        mirror
    }

    /// From now on the pieces are kept, from this machine on.
    pub fn keep(&mut self, now: Timestamp, machine: &Machine) {
        self.kept = Some(Piece::machine(now, machine, false).into_iter().collect());
    }

    /// The pieces that were kept.
    pub fn kept(&mut self) -> Vec<Piece> {
        self.kept.take().unwrap_or_default()
    }

    /// The process is started anew with this machine.
    pub fn restarted(&mut self, now: Timestamp, machine: &Machine) {
        self.begin_again();
        self.take(Piece::machine(now, machine, false));
    }

    /// Before the machine takes it in.
    pub fn event(&mut self, now: Timestamp, event: &Event) {
        self.take(Piece::event(now, event));
    }

    /// What the machine gave out.
    pub fn effect(&mut self, now: Timestamp, effect: &Effect) {
        self.take(Piece::effect(now, effect));
    }

    /// After a turn.
    pub fn turned(&mut self, now: Timestamp, machine: &Machine) {
        self.turns = self.turns.saturating_sub(1);
        if self.turns > 0 || self.fault.is_some() {
            return;
        }
        self.turns = self.rng.random_range(STITCH.0..STITCH.1);
        let piece = Piece::machine(now, machine, false);
        // First what was replayed is compared with it, then the replay goes on from it.
        self.take(piece.clone());
        self.begin_again();
        self.replay(piece);
    }

    /// The first difference, in words.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// Events and decisions so far.
    pub fn so_far(&self) -> Replayed {
        let (before, now) = (self.before, self.replay.so_far());
        Replayed { events: before.events + now.events, decisions: before.decisions + now.decisions, ..now }
    }

    fn begin_again(&mut self) {
        self.before = self.so_far();
        self.replay = Replay::default();
    }

    fn take(&mut self, piece: Result<Piece, Unreadable>) {
        if let (Some(kept), Ok(piece)) = (&mut self.kept, &piece) {
            kept.push(piece.clone());
        }
        self.replay(piece);
    }

    fn replay(&mut self, piece: Result<Piece, Unreadable>) {
        if self.fault.is_some() {
            return;
        }
        let taken = piece.and_then(|piece| self.replay.take(piece.kind, &piece.bytes));
        self.fault = match taken {
            Ok(None) => None,
            Ok(Some(difference)) => Some(in_words(&difference)),
            Err(unreadable) => Some(unreadable.to_string()),
        };
    }
}

fn in_words(difference: &Difference) -> String {
    let short =
        |text: &Option<String>| text.as_deref().unwrap_or("nothing").chars().take(SHOWN).collect::<String>();
    format!(
        "at {:.3} s decision {} was {} and is {}",
        difference.at.as_secs_f64(),
        difference.decision,
        short(&difference.then),
        short(&difference.now)
    )
}
