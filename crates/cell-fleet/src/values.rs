//! What the decisions of a cell in a fleet take in, and what they want done.
//!
//! In and out: plain values. Every effect that requests something is answered by an input, also when the
//! network or the disk failed: the answer is then [`Written::Unknown`] or its like, and the decision reads
//! again.

use crate::payloads::{CellState, Claim, Job, Outcome, What, Wish};
use crate::subjects::Key;
use cell_values::time::{Duration, Timestamp};
use serde::{Deserialize, Serialize};

/// Names a message that was pulled and is not settled yet.
pub type Token = u64;

/// A moment: on the cell's monotonic clock, and by the server's calendar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct At {
    /// Since the start.
    pub now: Timestamp,
    /// s since 1970, by the server's clock as far as it is known.
    pub unix_s: f64,
}

/// How far the own clock is ahead of the server's, s, when something that was sent and came back was stored
/// between the two: as it was known before, as far as that is possible. What was long on its way says little
/// then, and does not move it.
pub fn ahead_s(before_s: f64, sent_unix_s: f64, stored_unix_s: f64, received_unix_s: f64) -> f64 {
    let least = sent_unix_s - stored_unix_s;
    before_s.clamp(least, least.max(received_unix_s - stored_unix_s))
}

/// What comes of a message.
#[derive(Clone, Debug, PartialEq)]
pub enum Settle {
    /// It is done with: the server forgets it.
    Done,
    /// Back into the queue, for after so long.
    Back(Duration),
    /// Still at it.
    Progress,
}

/// Whose request to the network it was, to have the answer brought there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Who {
    /// The part that has jobs in hand.
    Hand,
    /// The part that looks after all jobs of the fleet.
    Steward,
}

/// What came of a write of a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Written {
    /// It is there, under this revision.
    Done(u64),
    /// There is another one.
    Conflict,
    /// Perhaps.
    Unknown,
}

/// How far the cell's own database says that a job of the fleet has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kept {
    /// It is about to be claimed.
    Wanted,
    /// It was claimed.
    Claimed,
    /// It may be carried out, whatever becomes of the network.
    Begun,
    /// The journal has its end; the report to the fleet is still to come.
    Ended,
    /// Over, and kept so that it is not taken again.
    Closed,
}

/// A job of the fleet in the cell's own database.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// The job.
    pub job: Job,
    /// Its queue, in words.
    pub target: String,
    /// Its priority, in words.
    pub priority: String,
    /// Who submitted it.
    pub by: String,
    /// How far it has come.
    pub kept: Kept,
    /// It was begun here, in this epoch or an earlier one.
    pub begun_here: bool,
    /// How it ended.
    pub outcome: Option<Outcome>,
}

/// What the cell's journal says of a job.
#[derive(Clone, Debug, PartialEq)]
pub enum Local {
    /// Nothing.
    Unknown,
    /// It waits or is worked on.
    Open,
    /// It has ended.
    Ended(Outcome),
}

/// Why a claim is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unread {
    /// No answer, or one without a claim.
    Unanswered,
    /// It is of another version of celld, or none.
    Foreign,
}

/// A claim with its revision; none where there is none.
pub type Found = Result<Option<(Box<Claim>, u64)>, Unread>;

/// Something that has happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Input {
    /// Time has passed.
    Time,
    /// The server answers, and what it needs to have is there.
    Connected,
    /// It does not any more.
    Disconnected,
    /// Whether the cell is armed and has nothing to do.
    Ready(bool),
    /// A message from a queue.
    Pulled {
        /// Its name from now on.
        token: Token,
        /// Its subject.
        subject: String,
        /// Its place in the stream.
        sequence: u64,
        /// How often it was delivered, this time included.
        delivered: u64,
        /// What is in it.
        payload: Vec<u8>,
    },
    /// What the claim of a job is, with its revision.
    Read {
        /// The job.
        job: String,
        /// The claim.
        found: Found,
    },
    /// Whether this cell can do a job; the reason when not.
    Judged {
        /// The job.
        job: String,
        /// The verdict.
        verdict: Result<(), String>,
    },
    /// A claim was written, or not.
    Written {
        /// Who wanted it.
        who: Who,
        /// The job.
        job: String,
        /// What came of it.
        outcome: Written,
    },
    /// The own database has an entry; `false` when the disk refused it.
    Kept {
        /// The job.
        job: String,
        /// It is on the disk.
        on_disk: bool,
    },
    /// A job is in the spool; the reason when not.
    HandedIn {
        /// The job.
        job: String,
        /// What the disk says.
        result: Result<(), String>,
    },
    /// What the journal says of a job.
    Local {
        /// The job.
        job: String,
        /// Its state.
        state: Local,
    },
    /// A message was put into a queue, or perhaps not.
    Published {
        /// The job.
        job: String,
        /// It is stored.
        stored: bool,
    },
    /// The state of a cell, written at this time of the server.
    Cell {
        /// Its name.
        name: String,
        /// Its state; `None` when it was taken out of the fleet.
        state: Option<Box<CellState>>,
        /// s since 1970.
        unix_s: f64,
    },
    /// The states of all cells, each with its name and when it was written; `None` when they could not be
    /// read.
    Cells(Option<Vec<(String, CellState, f64)>>),
    /// What a person wants, or does not any more.
    Wish {
        /// Where it is written.
        key: Key,
        /// What it says.
        wish: Option<Wish>,
    },
    /// A cell refuses a job; the epoch and the reason.
    Refused {
        /// The job.
        job: String,
        /// The cell.
        cell: String,
        /// `None` when the refusal was taken back.
        refusal: Option<(u32, String)>,
    },
    /// The claim of any job, for the steward.
    Claim {
        /// The claim.
        claim: Box<Claim>,
        /// Its revision.
        revision: u64,
        /// When it was written, by the server's clock.
        unix_s: f64,
    },
    /// All claims that there were have come.
    ClaimsKnown,
}

/// Something that is to be done.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Pull one message from the cell's lanes, as soon as there is one.
    Pull(bool),
    /// Settle a message.
    Settle(Token, Settle),
    /// Read the claim of a job.
    Read(String),
    /// Judge whether this cell can do a job.
    Judge(Box<Job>),
    /// Write a claim: over this revision, or only where there is none.
    Write {
        /// Who wants it.
        who: Who,
        /// The claim.
        claim: Box<Claim>,
        /// The revision that must be there.
        over: Option<u64>,
    },
    /// Write an entry into the own database.
    Keep(Box<Entry>),
    /// Put a job into the spool.
    HandIn(Box<Job>),
    /// Read what the journal has on a job.
    Look(String),
    /// Give a job of the own cell up, as a person at the cell would.
    Cancel {
        /// The job.
        job: String,
        /// Who wants it.
        by: String,
    },
    /// Put a job into a queue; the subject is made of the claim.
    Publish(Box<Claim>),
    /// Write a refusal; `None` takes it back.
    Refuse {
        /// The job.
        job: String,
        /// Epoch and reason.
        refusal: Option<(u32, String)>,
    },
    /// Remove a key that was dealt with.
    Remove(Key),
    /// Follow all claims and all cells from now on, or no longer.
    Follow(bool),
    /// Follow the state of this one cell, and no other one's.
    Watch(Option<String>),
    /// Read the states of all cells.
    List,
    /// Something that the fleet should see.
    Report {
        /// The job it is about.
        job: Option<String>,
        /// What happened.
        what: What,
    },
}

impl Effect {
    /// The answer that an effect which needs the network gets without one.
    pub fn unanswered(self) -> Option<Input> {
        match self {
            Effect::Read(job) => Some(Input::Read { job, found: Err(Unread::Unanswered) }),
            Effect::Write { who, claim, .. } => {
                Some(Input::Written { who, job: claim.job.id, outcome: Written::Unknown })
            }
            Effect::Publish(claim) => Some(Input::Published { job: claim.job.id, stored: false }),
            Effect::List => Some(Input::Cells(None)),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_long_on_its_way_does_not_move_the_clock() {
        assert_eq!(ahead_s(0.0, 100.0, 102.5, 102.6), 0.0);
        assert_eq!(ahead_s(0.0, 100.0, 160.0, 100.25), -59.75, "the server's is ahead");
        assert_eq!(ahead_s(-59.75, 200.0, 262.0, 203.0), -59.75, "late, and no other time");
        assert_eq!(ahead_s(0.0, 100.0, 40.0, 100.25), 60.0, "and behind");
        assert_eq!(ahead_s(0.0, 100.0, 90.0, 50.0), 10.0, "set back on the way");
    }
}
