//! A run of the machine as pieces of a recording, and the same run again.
//!
//! In: a machine at some time, then every event that it takes and every effect that it gives, in the
//! postcard format. Out: [`Replay`] carries the events out again in a machine that is restored from the
//! first piece, and compares what comes of them byte for byte; the first [`Difference`] says when, what was
//! decided then and what is decided now. Events are what was observed (answers of devices, markers found,
//! plans made), not pictures: a replay needs no camera, no robot and no planner. Pure.

use cell_machine::event::{Effect, Event};
use cell_machine::machine::Machine;
use cell_values::time::Timestamp;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// What a piece holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// All of the machine, between two turns: the beginning of a recording, or a stitch in it.
    Machine,
    /// What the machine took in.
    Event,
    /// What it gave out.
    Effect,
}

/// One entry of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece {
    /// What it holds.
    pub kind: Kind,
    /// The cell's time.
    pub at: Timestamp,
    /// In the postcard format.
    pub bytes: Vec<u8>,
}

/// A machine as it is recorded.
#[derive(Serialize)]
struct MachineThen<'a> {
    at: Timestamp,
    after_gap: bool,
    machine: &'a Machine,
}

#[derive(Deserialize)]
struct MachineAgain {
    at: Timestamp,
    /// Pieces before this one were lost: it takes the place of what was replayed so far.
    after_gap: bool,
    machine: Box<Machine>,
}

#[derive(Serialize)]
struct EventThen<'a> {
    at: Timestamp,
    event: &'a Event,
}

#[derive(Deserialize)]
struct EventAgain {
    at: Timestamp,
    event: Event,
}

impl Piece {
    /// The machine between two turns. `after_gap`: what happened just before is not in the recording.
    ///
    /// # Errors
    /// [`Unreadable`]: a fault of this program.
    pub fn machine(at: Timestamp, machine: &Machine, after_gap: bool) -> Result<Piece, Unreadable> {
        let bytes = written(&MachineThen { at, after_gap, machine })?;
        Ok(Piece { kind: Kind::Machine, at, bytes })
    }

    /// An event, before it is handed over.
    ///
    /// # Errors
    /// As [`Piece::machine`].
    pub fn event(at: Timestamp, event: &Event) -> Result<Piece, Unreadable> {
        Ok(Piece { kind: Kind::Event, at, bytes: written(&EventThen { at, event })? })
    }

    /// An effect, before it is carried out.
    ///
    /// # Errors
    /// As [`Piece::machine`].
    pub fn effect(at: Timestamp, effect: &Effect) -> Result<Piece, Unreadable> {
        Ok(Piece { kind: Kind::Effect, at, bytes: written(effect)? })
    }
}

/// An event with its time; `None` for bytes that are none.
pub fn event_of(bytes: &[u8]) -> Option<(Timestamp, Event)> {
    let again: EventAgain = postcard::from_bytes(bytes).ok()?;
    Some((again.at, again.event))
}

/// An effect; `None` for bytes that are none.
pub fn effect_of(bytes: &[u8]) -> Option<Effect> {
    postcard::from_bytes(bytes).ok()
}

/// Bytes that are no piece of a recording of this version of celld.
#[derive(Clone, Debug, thiserror::Error)]
#[error("piece {number} of the recording ({what}) does not fit this version of celld: {cause}")]
pub struct Unreadable {
    /// Counted from 1; 0 where it was to be written.
    pub number: u64,
    /// Machine, event or effect.
    pub what: &'static str,
    /// Of the decoder.
    pub cause: String,
}

fn written<T: Serialize>(value: &T) -> Result<Vec<u8>, Unreadable> {
    let fail = |error: postcard::Error| Unreadable { number: 0, what: "written", cause: error.to_string() };
    postcard::to_stdvec(value).map_err(fail)
}

/// The first decision that is not the recorded one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// When, in the cell's time.
    pub at: Timestamp,
    /// Which decision, counted from 1.
    pub decision: u64,
    /// What was decided then; `None`: nothing more.
    pub then: Option<String>,
    /// What is decided now; `None`: nothing more.
    pub now: Option<String>,
}

/// What was replayed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Replayed {
    /// Events handed over.
    pub events: u64,
    /// Decisions compared.
    pub decisions: u64,
    /// Places where the recording has a gap.
    pub gaps: u64,
    /// When it begins.
    pub from: Option<Timestamp>,
    /// When it ends.
    pub until: Timestamp,
}

/// An effect of the replay that the recording has not shown yet.
struct Pending {
    /// When the event came that it is of.
    at: Timestamp,
    effect: Effect,
    bytes: Vec<u8>,
}

/// A run again. See the module.
#[derive(Default)]
pub struct Replay {
    machine: Option<Box<Machine>>,
    pending: VecDeque<Pending>,
    pieces: u64,
    so_far: Replayed,
}

impl Replay {
    /// What was replayed so far.
    pub fn so_far(&self) -> Replayed {
        self.so_far
    }

    /// The machine as it is now; `None` before the first piece.
    pub fn machine(&self) -> Option<&Machine> {
        self.machine.as_deref()
    }

    /// Takes the next piece; the first difference, or what comes of this one.
    ///
    /// # Errors
    /// The piece is of another version of celld, or damaged.
    pub fn take(&mut self, kind: Kind, bytes: &[u8]) -> Result<Option<Difference>, Unreadable> {
        self.pieces += 1;
        match kind {
            Kind::Machine => {
                let again: MachineAgain = self.read("machine", bytes)?;
                Ok(self.stitch(again, bytes))
            }
            Kind::Event => {
                let again: EventAgain = self.read("event", bytes)?;
                self.event(again)
            }
            Kind::Effect => Ok(self.effect(bytes)),
        }
    }

    fn read<T: DeserializeOwned>(&self, what: &'static str, bytes: &[u8]) -> Result<T, Unreadable> {
        let fail =
            |error: postcard::Error| Unreadable { number: self.pieces, what, cause: error.to_string() };
        postcard::from_bytes(bytes).map_err(fail)
    }

    /// The first machine is where the run begins; a later one has to be what came of it.
    fn stitch(&mut self, again: MachineAgain, bytes: &[u8]) -> Option<Difference> {
        let MachineAgain { at, after_gap, machine } = again;
        self.so_far.from.get_or_insert(at);
        self.so_far.until = at;
        if let (Some(before), false) = (&self.machine, after_gap) {
            if let Some(missing) = self.missing(|_| true) {
                return Some(missing);
            }
            let same = Piece::machine(at, before, after_gap).is_ok_and(|piece| piece.bytes == bytes);
            self.so_far.decisions += 1;
            return (!same).then(|| Difference {
                at,
                decision: self.so_far.decisions,
                then: Some("the state of the cell between two turns".to_string()),
                now: Some("another state".to_string()),
            });
        }
        self.so_far.gaps += u64::from(self.machine.is_some());
        self.pending.clear();
        self.machine = Some(machine);
        None
    }

    fn event(&mut self, again: EventAgain) -> Result<Option<Difference>, Unreadable> {
        let EventAgain { at, event } = again;
        if self.machine.is_none() {
            return Ok(None);
        }
        self.so_far.until = at;
        // By the next time, all effects of the last one were there; those of events of the same moment come
        // after it.
        if matches!(event, Event::Time)
            && let Some(missing) = self.missing(|made| made < at)
        {
            return Ok(Some(missing));
        }
        let Some(machine) = &mut self.machine else { return Ok(None) };
        machine.handle(at, event);
        while let Some(effect) = machine.poll() {
            let bytes = written(&effect)?;
            self.pending.push_back(Pending { at, effect, bytes });
        }
        self.so_far.events += 1;
        Ok(None)
    }

    /// The first effect that the recording should have by now.
    fn missing(&self, is_due: impl Fn(Timestamp) -> bool) -> Option<Difference> {
        let Pending { at, effect, .. } = self.pending.front().filter(|pending| is_due(pending.at))?;
        let now = Some(format!("{effect:?}"));
        Some(Difference { at: *at, decision: self.so_far.decisions + 1, then: None, now })
    }

    fn effect(&mut self, bytes: &[u8]) -> Option<Difference> {
        self.machine.as_ref()?;
        self.so_far.decisions += 1;
        let now = self.pending.pop_front();
        if now.as_ref().is_some_and(|now| now.bytes == bytes) {
            return None;
        }
        let then = self.read::<Effect>("effect", bytes);
        Some(Difference {
            at: self.so_far.until,
            decision: self.so_far.decisions,
            then: Some(then.map_or_else(|error| error.to_string(), |effect| format!("{effect:?}"))),
            now: now.map(|now| format!("{:?}", now.effect)),
        })
    }
}

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
