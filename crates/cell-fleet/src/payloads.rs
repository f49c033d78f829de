//! What goes over the fleet: jobs, claims, refusals, what persons want, the cells' states, events.
//!
//! In: values. Out: JSON with a version, and values again from bytes, checked: size, version, form, and that
//! the content is what its hash says. Times are s since 1970, lengths m, angles rad. Fields may be added
//! within a version, and what a reader does not know it leaves out; whatever changes the meaning of one that
//! is there is another version, which is refused with both numbers. Pure.

pub use crate::requests::{Answer, Request};
use crate::subjects::{Lane, is_job_id};
pub use crate::words::{sentence, sha256};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The version of these payloads.
pub const VERSION: u32 = 1;

/// Longest text of a job: that of a job file.
pub const JOB_TEXT_MAX: usize = 256 * 1024;

/// Largest payload that is taken at all: a text of control characters alone would grow sixfold in JSON, and
/// what people write by a few percent.
pub const PAYLOAD_MAX: usize = 512 * 1024;

/// Why a payload is not taken.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PayloadFault {
    /// Too many bytes.
    #[error(
        "the payload has {bytes} bytes, at most {PAYLOAD_MAX} are taken; name fewer objects, or split the job"
    )]
    TooLarge {
        /// How many.
        bytes: usize,
    },
    /// Of another version of celld.
    #[error(
        "the payload is of version {found}, this celld reads version {VERSION}; update the older of the two"
    )]
    Version {
        /// Its version.
        found: u64,
    },
    /// Not what it should be.
    #[error("the payload is not readable: {0}")]
    Form(String),
    /// Changed on its way.
    #[error("the text of job {id} is not the one that was submitted: its hash is another")]
    Hash {
        /// The job.
        id: String,
    },
}

#[derive(Deserialize)]
struct Versioned {
    version: u64,
}

/// Reads a payload; its size and version first, so that the sentence says what is the matter.
///
/// # Errors
/// See [`PayloadFault`].
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, PayloadFault> {
    if bytes.len() > PAYLOAD_MAX {
        return Err(PayloadFault::TooLarge { bytes: bytes.len() });
    }
    let form = |error: serde_json::Error| PayloadFault::Form(error.to_string());
    let Versioned { version } = serde_json::from_slice(bytes).map_err(form)?;
    if version != u64::from(VERSION) {
        return Err(PayloadFault::Version { found: version });
    }
    serde_json::from_slice(bytes).map_err(form)
}

/// The bytes of a payload.
///
/// # Errors
/// It is too large ([`PayloadFault::TooLarge`]), or a number in it is none ([`PayloadFault::Form`]).
pub fn encode<T: Serialize>(payload: &T) -> Result<Vec<u8>, PayloadFault> {
    let bytes = serde_json::to_vec(payload).map_err(|error| PayloadFault::Form(error.to_string()))?;
    if bytes.len() > PAYLOAD_MAX {
        return Err(PayloadFault::TooLarge { bytes: bytes.len() });
    }
    Ok(bytes)
}

/// A job on its way to a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// [`VERSION`].
    pub version: u32,
    /// Unique in the fleet; the text states the same.
    pub id: String,
    /// Of the text, lower-case hex: with the id it makes a second delivery harmless.
    pub sha256: String,
    /// The job file, whole: it names no other file.
    pub text: String,
    /// How often it was given to a cell: 1 at first.
    pub epoch: u32,
    /// When it was submitted.
    pub submitted_unix_s: f64,
    /// Not begun before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_before_unix_s: Option<f64>,
    /// The campaign it belongs to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub campaign: Option<String>,
}

impl Job {
    /// A job that is given for the first time.
    pub fn new(id: &str, text: &str, submitted_unix_s: f64) -> Job {
        Job {
            version: VERSION,
            id: id.to_string(),
            sha256: sha256(text),
            text: text.to_string(),
            epoch: 1,
            submitted_unix_s,
            not_before_unix_s: None,
            campaign: None,
        }
    }

    /// Reads a job.
    ///
    /// # Errors
    /// As [`decode`]; its id cannot be one, its text is too long ([`PayloadFault::Form`]) or is not that of
    /// its hash ([`PayloadFault::Hash`]).
    pub fn read(bytes: &[u8]) -> Result<Job, PayloadFault> {
        let job: Job = decode(bytes)?;
        job.check()?;
        Ok(job)
    }

    /// What [`Job::read`] requires of a job, for who submits one.
    ///
    /// # Errors
    /// As [`Job::read`].
    pub fn check(&self) -> Result<(), PayloadFault> {
        if !is_job_id(&self.id) {
            return Err(PayloadFault::Form(format!("{:?} cannot be the id of a job", self.id)));
        }
        if self.text.len() > JOB_TEXT_MAX {
            return Err(PayloadFault::TooLarge { bytes: self.text.len() });
        }
        if sha256(&self.text) != self.sha256 {
            return Err(PayloadFault::Hash { id: self.id.clone() });
        }
        Ok(())
    }

    /// The id of its message, by which the server drops a second one.
    pub fn message_id(&self) -> String {
        format!("{}/{}/{}", self.id, self.sha256.get(..16).unwrap_or_default(), self.epoch)
    }
}

/// What has become of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ClaimState {
    /// Back in the queue, with another epoch.
    Offered,
    /// A cell has taken it, and moved nothing for it.
    Claimed,
    /// The cell may carry it out: from here on no other cell does, but by a person's word.
    Begun,
    /// Ended, see [`Claim::outcome`].
    Ended,
    /// All cells have refused it.
    Aside,
    /// A person did not want it any more before it was begun.
    Cancelled,
}

impl ClaimState {
    /// The word.
    pub fn as_str(self) -> &'static str {
        match self {
            ClaimState::Offered => "offered",
            ClaimState::Claimed => "claimed",
            ClaimState::Begun => "begun",
            ClaimState::Ended => "ended",
            ClaimState::Aside => "aside",
            ClaimState::Cancelled => "cancelled",
        }
    }
}

/// How a job ended, as the cell's journal has it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// `done`, `failed`, `cancelled`, `interrupted`, or `rejected` by the cell's own reader.
    pub status: String,
    /// For programs.
    pub code: String,
    /// One sentence.
    pub message: String,
    /// Pick-n-places made.
    pub moves: u32,
    /// No plan could have had fewer.
    #[serde(default)]
    pub lower_bound: Option<f64>,
    /// From its beginning to its end.
    pub seconds: f64,
}

/// The one record of a job in the fleet: each change of it is a compare-and-set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Claim {
    /// [`VERSION`].
    pub version: u32,
    /// The job as it was submitted; without its text once it has ended well.
    pub job: Job,
    /// Its queue: kind and name of the target, and the priority.
    pub target: String,
    /// `urgent`, `normal` or `later`.
    pub priority: String,
    /// Who submitted it.
    pub by: String,
    /// What has become of it.
    pub state: ClaimState,
    /// Who has it, or had it last; empty where no cell had.
    pub cell: String,
    /// When this was written.
    pub unix_s: f64,
    /// The message of this epoch is in the queue: counts while offered.
    #[serde(default)]
    pub queued: bool,
    /// How it ended.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outcome: Option<Outcome>,
    /// Of a job that was set aside: each cell's reason. Otherwise who decided, if a person did.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub reasons: BTreeMap<String, String>,
}

impl Claim {
    /// A claim by a cell on a job of this lane.
    pub fn new(job: Job, lane: &Lane, by: &str, state: ClaimState, cell: &str, unix_s: f64) -> Claim {
        Claim {
            version: VERSION,
            job,
            target: lane.target.to_string(),
            priority: lane.priority.as_str().to_string(),
            by: by.to_string(),
            state,
            cell: cell.to_string(),
            unix_s,
            queued: false,
            outcome: None,
            reasons: BTreeMap::new(),
        }
    }

    /// The lane it came from; `None` where its words are unknown.
    pub fn lane(&self) -> Option<Lane> {
        let target = crate::subjects::Target::parse(&self.target)?;
        Some(Lane { priority: crate::subjects::Priority::of(&self.priority)?, target })
    }

    /// It is this cell's, in this epoch, and not over.
    pub fn is_held_by(&self, cell: &str, epoch: u32) -> bool {
        let held = matches!(self.state, ClaimState::Claimed | ClaimState::Begun);
        held && self.cell == cell && self.job.epoch == epoch
    }
}

/// Why a cell does not take a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refusal {
    /// [`VERSION`].
    pub version: u32,
    /// Of which epoch.
    pub epoch: u32,
    /// One sentence.
    pub reason: String,
    /// When.
    pub unix_s: f64,
}

/// What a person wants of a job: that it is not done, or done elsewhere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Wish {
    /// [`VERSION`].
    pub version: u32,
    /// To be given: the epoch that the person saw. Another one is not given away. 0: cancelled in any.
    pub epoch: u32,
    /// For whom it is from now on; absent: as before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<String>,
    /// To be given: the person knows that a cell had begun it, and has looked at that table. Without, a job
    /// that is begun by the time of the decision stays where it is.
    #[serde(default)]
    pub begun: bool,
    /// When.
    pub unix_s: f64,
}

/// The state of a cell, in the bucket of cells under its name. When it was written says the server.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CellState {
    /// [`VERSION`].
    pub version: u32,
    /// Its labels, `any` left out.
    pub labels: Vec<String>,
    /// Version of celld.
    pub celld: String,
    /// By the cell's own clock.
    pub unix_s: f64,
    /// How far that clock is ahead of the server's, s.
    #[serde(default)]
    pub clock_ahead_s: f64,
    /// One word: the supervisor's state.
    pub state: String,
    /// One sentence.
    pub message: String,
    /// What to do; may be empty.
    #[serde(default)]
    pub hint: String,
    /// Motion is allowed.
    pub armed: bool,
    /// The arm is on its way, or is not known to be at rest, whatever `armed` says.
    #[serde(default)]
    pub moving: bool,
    /// Nothing is worked on and nothing waits.
    pub idle: bool,
    /// The active job, of the fleet or not.
    #[serde(default)]
    pub job: Option<String>,
    /// Jobs whose plan waits for a person.
    #[serde(default)]
    pub awaiting_approval: Vec<String>,
    /// Number of the present job's plan.
    #[serde(default)]
    pub plan: Option<u64>,
    /// Jobs of the fleet that this cell has in hand.
    #[serde(default)]
    pub holds: Vec<String>,
    /// Pick-n-places made of the present job, and how many its plan has.
    #[serde(default)]
    pub step: Option<(u32, u32)>,
    /// Since the cell's fleet database was made.
    #[serde(default)]
    pub totals: Totals,
    /// Events that were not delivered yet.
    #[serde(default)]
    pub undelivered: u64,
    /// The most relative vacuum of the last grip, %.
    #[serde(default)]
    pub vacuum_percent: Option<f64>,
    /// How far the reference markers seemed to be off in the last look, mm.
    #[serde(default)]
    pub drift_mm: Option<f64>,
    /// Number of the configuration fragment that it runs with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fragment: Option<u64>,
    /// Number of the one that it is to run with, as soon as it is idle and disarmed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fragment_waits: Option<u64>,
    /// What is wrong with its part in the fleet, a sentence each.
    #[serde(default)]
    pub complaints: Vec<String>,
}

/// What a cell has done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Totals {
    /// Jobs of the fleet that ended as done.
    pub done: u64,
    /// All others that ended.
    pub failed: u64,
    /// Pick-n-places of them.
    pub moves: u64,
    /// The least that they could have needed.
    pub bound: f64,
    /// Working time, s.
    pub seconds: f64,
}

impl Totals {
    /// One more job.
    pub fn add(&mut self, outcome: &Outcome) {
        let good = outcome.status == "done";
        self.done += u64::from(good);
        self.failed += u64::from(!good);
        self.moves += u64::from(outcome.moves);
        self.bound += outcome.lower_bound.unwrap_or(f64::from(outcome.moves));
        self.seconds += outcome.seconds;
    }
}

/// What has happened in a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum What {
    /// The table was looked at.
    Looked {
        /// Objects that were found.
        objects: u32,
        /// How far the reference markers seemed to be off, mm.
        #[serde(default)]
        residual_mm: Option<f64>,
    },
    /// There is a plan.
    Planned {
        /// Its pick-n-places.
        moves: u32,
        /// No plan has fewer.
        #[serde(default)]
        lower_bound: Option<f64>,
        /// It waits for a person.
        waits: bool,
    },
    /// A person agreed, or did not.
    Approved {
        /// Who.
        by: String,
        /// Agreed.
        agreed: bool,
    },
    /// A pick-n-place was made.
    Step {
        /// Which, from 1.
        step: u32,
        /// How many the plan has.
        of: u32,
    },
    /// A job has ended: of the fleet, or of the cell's own folder.
    Done {
        /// How.
        outcome: Outcome,
    },
    /// Something is wrong.
    Fault {
        /// For programs.
        code: String,
        /// One sentence.
        message: String,
    },
    /// Events were given up: too old, or too many while the network was away.
    Gap {
        /// Number of the first that is missing. The last is the number of this event.
        first: u64,
        /// How many.
        lost: u64,
    },
}

impl What {
    /// The last token of its subject.
    pub fn kind(&self) -> &'static str {
        match self {
            What::Looked { .. } => "looked",
            What::Planned { .. } => "planned",
            What::Approved { .. } => "approved",
            What::Step { .. } => "step",
            What::Done { .. } => "done",
            What::Fault { .. } => "fault",
            What::Gap { .. } => "gap",
        }
    }

    /// All kinds.
    pub const KINDS: [&'static str; 7] = ["looked", "planned", "approved", "step", "done", "fault", "gap"];
}

/// An event with its place in the cell's sequence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// [`VERSION`].
    pub version: u32,
    /// The cell.
    pub cell: String,
    /// Which of the cell's sequences: another one begins with another database.
    pub series: String,
    /// Its number in the series, without holes: what is missing has a gap event.
    pub number: u64,
    /// By the cell's clock.
    pub unix_s: f64,
    /// The job it is about, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub job: Option<String>,
    /// What happened.
    #[serde(flatten)]
    pub what: What,
}

impl Event {
    /// The id of its message, by which the server drops a second one.
    pub fn message_id(&self) -> String {
        format!("{}/{}/{}", self.cell, self.series, self.number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::subjects::{Priority, Target};

    fn job() -> Job {
        Job::new("tidy.2", "version: 1\nid: tidy.2\ngoal: {look: true}\n", 1_795_248_000.0)
    }

    #[test]
    fn a_job_reads_back_and_is_what_its_hash_says() {
        let bytes = encode(&job()).unwrap();
        assert_eq!(Job::read(&bytes), Ok(job()));
        let changed = Job { text: job().text + "\n", ..job() };
        assert_eq!(Job::read(&encode(&changed).unwrap()), Err(PayloadFault::Hash { id: "tidy.2".into() }));
        let named = Job { id: "../x".into(), ..job() };
        assert!(matches!(Job::read(&encode(&named).unwrap()), Err(PayloadFault::Form(_))));
    }

    #[test]
    fn a_payload_of_another_version_is_refused_with_both_numbers() {
        let bytes = encode(&Job { version: 7, ..job() }).unwrap();
        let fault = Job::read(&bytes).unwrap_err();
        assert_eq!(fault, PayloadFault::Version { found: 7 });
        assert!(fault.to_string().contains("version 7") && fault.to_string().contains("version 1"));
        let other = br#"{"version": 2, "anything": [1]}"#;
        assert_eq!(decode::<CellState>(other), Err(PayloadFault::Version { found: 2 }));
    }

    #[test]
    fn ten_megabytes_are_refused_unread() {
        let fault = Job::read(&vec![b'['; 10_000_000]).unwrap_err();
        assert_eq!(fault, PayloadFault::TooLarge { bytes: 10_000_000 });
        let text = "a".repeat(JOB_TEXT_MAX + 1);
        let long = Job { sha256: sha256(&text), text, ..job() };
        assert!(matches!(long.check(), Err(PayloadFault::TooLarge { .. })));
        assert!(encode(&Job { text: "a".repeat(10_000_000), ..job() }).is_err());
    }

    #[test]
    fn bytes_of_any_kind_are_an_error_and_never_a_panic() {
        for bytes in
            [&b""[..], b"{}", b"null", b"\xff\xfe", b"{\"version\": -1}", b"[1,2]", b"{\"version\":1}"]
        {
            assert!(Job::read(bytes).is_err() && decode::<Claim>(bytes).is_err());
        }
    }

    #[test]
    fn a_field_of_later_days_is_left_out() {
        let mut value = serde_json::to_value(job()).unwrap();
        value["of_later"] = 1.into();
        assert_eq!(Job::read(value.to_string().as_bytes()), Ok(job()));
    }

    #[test]
    fn an_event_carries_its_kind_beside_its_number() {
        let event = Event {
            version: VERSION,
            cell: "c1".into(),
            series: "s".into(),
            number: 12,
            unix_s: 1.0,
            job: None,
            what: What::Gap { first: 3, lost: 10 },
        };
        let text = String::from_utf8(encode(&event).unwrap()).unwrap();
        assert!(text.contains(r#""kind":"gap""#) && text.contains(r#""number":12"#), "{text}");
        assert_eq!(decode::<Event>(text.as_bytes()), Ok(event));
    }

    #[test]
    fn a_claim_names_its_lane_and_its_holder() {
        let lane = Lane { priority: Priority::Later, target: Target::Cell("c1".into()) };
        let claim = Claim::new(job(), &lane, "anna", ClaimState::Begun, "c1", 2.0);
        assert_eq!(claim.lane(), Some(lane));
        assert!(claim.is_held_by("c1", 1) && !claim.is_held_by("c1", 2) && !claim.is_held_by("c2", 1));
        let ended = Claim { state: ClaimState::Ended, ..claim };
        assert!(!ended.is_held_by("c1", 1));
    }
}
