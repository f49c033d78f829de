//! The names of a fleet: subjects of messages, keys of its buckets, streams and consumers.
//!
//! In: a fleet's name, cells, labels, persons, jobs. Out: subjects and keys, and what a subject says, read
//! back. Every subject begins with [`ROOT`] and the fleet's name, so that what belongs to another fleet, or
//! to a later version of these names, is known by the subject alone. Who submits, approves, cancels or gives
//! a job away is the last token: the server's permissions let each person publish under their own name only.
//! Pure.

use std::fmt;

/// What every subject begins with: the program and the version of its names.
pub const ROOT: &str = "celld.v1";

/// The label that every cell has.
pub const ANY: &str = "any";

/// Longest name of a fleet, cell, label or person.
pub const NAME_MAX: usize = 40;

/// Longest id of a job: the rule of job files.
pub const JOB_ID_MAX: usize = 80;

/// A name that can be one token of a subject: 1 to 40 letters, digits, dashes and underscores.
pub fn is_name(text: &str) -> bool {
    (1..=NAME_MAX).contains(&text.len()) && text.bytes().all(plain)
}

fn plain(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_'
}

/// The id of a job, by the rule of job files: dots too, but not first.
pub fn is_job_id(text: &str) -> bool {
    (1..=JOB_ID_MAX).contains(&text.len())
        && !text.starts_with('.')
        && text.bytes().all(|byte| plain(byte) || byte == b'.')
}

/// A job's id as one token of a key: dots would divide it, and `=` is in no id.
fn id_token(id: &str) -> String {
    id.replace('.', "=")
}

fn id_of_token(token: &str) -> Option<String> {
    let id = token.replace('=', ".");
    (is_job_id(&id) && id_token(&id) == token).then_some(id)
}

/// What is done first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Priority {
    /// Before all others.
    Urgent,
    /// As it comes.
    Normal,
    /// When there is nothing else.
    Later,
}

impl Priority {
    /// All of them, the first to be done first.
    pub const ALL: [Priority; 3] = [Priority::Urgent, Priority::Normal, Priority::Later];

    /// The token.
    pub fn as_str(self) -> &'static str {
        match self {
            Priority::Urgent => "urgent",
            Priority::Normal => "normal",
            Priority::Later => "later",
        }
    }

    /// The priority that a token names.
    pub fn of(token: &str) -> Option<Priority> {
        Priority::ALL.into_iter().find(|priority| priority.as_str() == token)
    }

    /// From the number of a job file: above 0 urgent, below 0 later.
    pub fn of_number(number: i64) -> Priority {
        match number {
            1.. => Priority::Urgent,
            0 => Priority::Normal,
            _ => Priority::Later,
        }
    }
}

/// Whom a job is for.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Target {
    /// This cell.
    Cell(String),
    /// Any one cell with this label.
    Label(String),
}

impl Target {
    /// Any cell at all.
    pub fn any() -> Target {
        Target::Label(ANY.to_string())
    }

    /// Both tokens: what it is, and its name.
    fn tokens(&self) -> [&str; 2] {
        match self {
            Target::Cell(name) => ["cell", name],
            Target::Label(name) => ["label", name],
        }
    }

    /// `cell=NAME`, `label=NAME` or `any`, as people write it.
    pub fn parse(text: &str) -> Option<Target> {
        if text == ANY {
            return Some(Target::any());
        }
        let (kind, name) = text.split_once('=')?;
        if !is_name(name) {
            return None;
        }
        Target::of([kind, name])
    }

    fn of([kind, name]: [&str; 2]) -> Option<Target> {
        match kind {
            "cell" => Some(Target::Cell(name.to_string())),
            "label" => Some(Target::Label(name.to_string())),
            _ => None,
        }
    }

    /// The key of a fragment of this target, in the bucket of fragments: who publishes is its last token.
    pub fn config_key(&self, by: &str) -> String {
        let [kind, name] = self.tokens();
        format!("{kind}.{name}.{by}")
    }

    /// Target and person of a key of that bucket.
    pub fn of_config_key(key: &str) -> Option<(Target, String)> {
        let tokens: Vec<&str> = key.split('.').collect();
        let [kind, name, by] = tokens[..] else { return None };
        (is_name(name) && is_name(by)).then_some(())?;
        Some((Target::of([kind, name])?, by.to_string()))
    }

    /// Whether a cell of this name, with these labels, is meant.
    pub fn includes(&self, cell: &str, labels: &[String]) -> bool {
        match self {
            Target::Cell(name) => name == cell,
            Target::Label(label) => label == ANY || labels.contains(label),
        }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [kind, name] = self.tokens();
        f.pad(&format!("{kind}={name}"))
    }
}

/// One queue of jobs: what one consumer serves. No two overlap.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Lane {
    /// What is done first.
    pub priority: Priority,
    /// Whom its jobs are for.
    pub target: Target,
}

impl Lane {
    /// The lanes of a cell, in the order in which it looks into them: by priority, its own name before its
    /// labels.
    pub fn of_cell(cell: &str, labels: &[String]) -> Vec<Lane> {
        let own = std::iter::once(Target::Cell(cell.to_string()));
        let labelled = labels.iter().filter(|label| *label != ANY).map(|label| Target::Label(label.clone()));
        let targets: Vec<Target> = own.chain(labelled).chain([Target::any()]).collect();
        let lanes = Priority::ALL
            .into_iter()
            .flat_map(|priority| targets.iter().map(move |target| Lane { priority, target: target.clone() }));
        lanes.collect()
    }

    /// Name of its durable consumer, which all cells of the lane share.
    pub fn consumer(&self) -> String {
        let [kind, name] = self.target.tokens();
        format!("{kind}-{name}-{}", self.priority.as_str())
    }
}

/// What may be requested of a cell from afar; nothing that arms, resumes, recovers or releases is among it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum RequestKind {
    /// Agree to the plan that waits.
    Approve,
    /// Refuse it.
    Reject,
    /// Give a job up after the present pick-n-place.
    Cancel,
    /// Put files of a job into the object store.
    Send,
}

impl RequestKind {
    /// All of them.
    pub const ALL: [RequestKind; 4] =
        [RequestKind::Approve, RequestKind::Reject, RequestKind::Cancel, RequestKind::Send];

    /// The token.
    pub fn as_str(self) -> &'static str {
        match self {
            RequestKind::Approve => "approve",
            RequestKind::Reject => "reject",
            RequestKind::Cancel => "cancel",
            RequestKind::Send => "send",
        }
    }
}

/// Why a subject is not taken.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SubjectFault {
    /// It begins with another fleet's name.
    #[error("the subject {subject} is of another fleet, this is {fleet}")]
    OtherFleet {
        /// The subject.
        subject: String,
        /// The name of this fleet.
        fleet: String,
    },
    /// Another version of these names, or no name of celld's at all.
    #[error("the subject {0} is none of {ROOT}: another version of celld, or another program")]
    Foreign(String),
    /// The right beginning, and then something else.
    #[error("the subject {0} names nothing that this version of celld knows")]
    Unknown(String),
}

/// What the subject of a job says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JobSubject {
    /// Its queue.
    pub lane: Lane,
    /// Who submitted it, as the server let them.
    pub by: String,
}

/// The names of one fleet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fleet {
    name: String,
}

impl Fleet {
    /// A fleet; `None` where the name cannot be a token.
    pub fn new(name: &str) -> Option<Fleet> {
        is_name(name).then(|| Fleet { name: name.to_string() })
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The stream of jobs.
    pub fn jobs_stream(&self) -> String {
        format!("celld-{}-jobs", self.name)
    }

    /// The stream of events.
    pub fn events_stream(&self) -> String {
        format!("celld-{}-events", self.name)
    }

    /// The bucket of claims, refusals, cancellations and gifts.
    pub fn claims_bucket(&self) -> String {
        format!("celld-{}-claims", self.name)
    }

    /// The bucket of the cells' states.
    pub fn cells_bucket(&self) -> String {
        format!("celld-{}-cells", self.name)
    }

    /// The bucket of files that persons requested.
    pub fn files_bucket(&self) -> String {
        format!("celld-{}-files", self.name)
    }

    /// The bucket of configuration fragments.
    pub fn config_bucket(&self) -> String {
        format!("celld-{}-config", self.name)
    }

    /// All subjects of jobs.
    pub fn all_jobs(&self) -> String {
        format!("{ROOT}.{}.job.>", self.name)
    }

    /// All subjects of events.
    pub fn all_events(&self) -> String {
        format!("{ROOT}.{}.event.>", self.name)
    }

    /// Where a job is submitted.
    pub fn job(&self, lane: &Lane, by: &str) -> String {
        let [kind, name] = lane.target.tokens();
        format!("{ROOT}.{}.job.{kind}.{name}.{}.{by}", self.name, lane.priority.as_str())
    }

    /// What the consumer of a lane takes.
    pub fn lane_filter(&self, lane: &Lane) -> String {
        self.job(lane, "*")
    }

    /// Where an event of a cell goes.
    pub fn event(&self, cell: &str, kind: &str) -> String {
        format!("{ROOT}.{}.event.{cell}.{kind}", self.name)
    }

    /// Subject of requests to a cell.
    pub fn request(&self, cell: &str, requested: RequestKind, by: &str) -> String {
        format!("{ROOT}.{}.ask.{cell}.{}.{by}", self.name, requested.as_str())
    }

    /// What a cell listens to.
    pub fn requests_of(&self, cell: &str) -> String {
        format!("{ROOT}.{}.ask.{cell}.*.*", self.name)
    }

    /// What follows `celld.v1.FLEET.` in a subject, token by token.
    fn tokens<'s>(&self, subject: &'s str) -> Result<Vec<&'s str>, SubjectFault> {
        let foreign = || SubjectFault::Foreign(subject.to_string());
        let rest = subject.strip_prefix(ROOT).and_then(|rest| rest.strip_prefix('.')).ok_or_else(foreign)?;
        let mut tokens = rest.split('.');
        if tokens.next() != Some(self.name.as_str()) {
            let fleet = self.name.clone();
            return Err(SubjectFault::OtherFleet { subject: subject.to_string(), fleet });
        }
        Ok(tokens.collect())
    }

    /// What the subject of a job says.
    ///
    /// # Errors
    /// It is no subject of a job of this fleet.
    pub fn read_job(&self, subject: &str) -> Result<JobSubject, SubjectFault> {
        let tokens = self.tokens(subject)?;
        let unknown = || SubjectFault::Unknown(subject.to_string());
        let ["job", kind, name, priority, by] = tokens[..] else { return Err(unknown()) };
        if !is_name(name) || !is_name(by) {
            return Err(unknown());
        }
        let target = Target::of([kind, name]).ok_or_else(unknown)?;
        let priority = Priority::of(priority).ok_or_else(unknown)?;
        Ok(JobSubject { lane: Lane { priority, target }, by: by.to_string() })
    }

    /// What is requested of a cell, and by whom.
    ///
    /// # Errors
    /// It is no request to this cell of this fleet.
    pub fn read_request(&self, subject: &str, cell: &str) -> Result<(RequestKind, String), SubjectFault> {
        let tokens = self.tokens(subject)?;
        let unknown = || SubjectFault::Unknown(subject.to_string());
        let ["ask", to, requested, by] = tokens[..] else { return Err(unknown()) };
        let requested =
            RequestKind::ALL.into_iter().find(|known| known.as_str() == requested).ok_or_else(unknown)?;
        if to != cell || !is_name(by) {
            return Err(unknown());
        }
        Ok((requested, by.to_string()))
    }
}

/// A key of the bucket of claims.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Key {
    /// What has become of a job.
    Claim {
        /// The job.
        job: String,
    },
    /// Why a cell does not take it.
    Refusal {
        /// The job.
        job: String,
        /// The cell.
        cell: String,
    },
    /// A person does not want it any more.
    Cancel {
        /// The job.
        job: String,
        /// The person.
        by: String,
    },
    /// A person gives it to another cell.
    Give {
        /// The job.
        job: String,
        /// The person.
        by: String,
    },
}

impl Key {
    /// What a cell watches: all keys but claims.
    pub const WATCHED: [&'static str; 3] = ["refusal.>", "cancel.>", "give.>"];

    /// All claims.
    pub const CLAIMS: &'static str = "claim.>";

    /// The key of the claim of a job.
    pub fn claim(job: &str) -> Key {
        Key::Claim { job: job.to_string() }
    }

    /// The key that a text is.
    pub fn of(text: &str) -> Option<Key> {
        let tokens: Vec<&str> = text.split('.').collect();
        let named = |name: &str| is_name(name).then(|| name.to_string());
        Some(match tokens[..] {
            ["claim", job] => Key::Claim { job: id_of_token(job)? },
            ["refusal", job, cell] => Key::Refusal { job: id_of_token(job)?, cell: named(cell)? },
            ["cancel", job, by] => Key::Cancel { job: id_of_token(job)?, by: named(by)? },
            ["give", job, by] => Key::Give { job: id_of_token(job)?, by: named(by)? },
            _ => return None,
        })
    }
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Key::Claim { job } => write!(f, "claim.{}", id_token(job)),
            Key::Refusal { job, cell } => write!(f, "refusal.{}.{cell}", id_token(job)),
            Key::Cancel { job, by } => write!(f, "cancel.{}.{by}", id_token(job)),
            Key::Give { job, by } => write!(f, "give.{}.{by}", id_token(job)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fleet() -> Fleet {
        Fleet::new("plant").unwrap()
    }

    #[test]
    fn the_subject_of_a_job_says_for_whom_how_soon_and_by_whom() {
        let labels = ["line-a".to_string()];
        for lane in Lane::of_cell("c1", &labels) {
            let subject = fleet().job(&lane, "anna");
            assert_eq!(fleet().read_job(&subject), Ok(JobSubject { lane: lane.clone(), by: "anna".into() }));
        }
        let lane = Lane { priority: Priority::Urgent, target: Target::Label("line-a".into()) };
        assert_eq!(fleet().job(&lane, "anna"), "celld.v1.plant.job.label.line-a.urgent.anna");
        assert_eq!(lane.consumer(), "label-line-a-urgent");
    }

    #[test]
    fn what_belongs_to_others_is_recognised_by_its_subject() {
        let fault = |subject: &str| fleet().read_job(subject).unwrap_err();
        let other = fault("celld.v1.works.job.label.any.normal.anna");
        assert_eq!(
            other.to_string(),
            "the subject celld.v1.works.job.label.any.normal.anna is of another fleet, this is plant"
        );
        assert!(matches!(fault("celld.v2.plant.job.label.any.normal.anna"), SubjectFault::Foreign(_)));
        assert!(matches!(fault("orders.plant"), SubjectFault::Foreign(_)));
        for unknown in [
            "job.label.any.soon.anna",
            "job.rack.any.normal.anna",
            "job.label.any.normal",
            "job.label.any.normal.anna.b",
            "job.label.any.normal.",
            "event.c1.done",
        ] {
            let fault = fault(&format!("celld.v1.plant.{unknown}"));
            assert!(matches!(fault, SubjectFault::Unknown(_)), "{unknown}: {fault}");
        }
    }

    #[test]
    fn the_key_of_a_fragment_says_for_whom_and_by_whom() {
        for target in [Target::any(), Target::Cell("c1".into())] {
            let key = target.config_key("anna");
            assert_eq!(Target::of_config_key(&key), Some((target, "anna".to_string())), "{key}");
        }
        for key in ["", "cell.c1", "cell..anna", "rack.c1.anna", "cell.c1.anna.b"] {
            assert_eq!(Target::of_config_key(key), None, "{key}");
        }
    }

    /// Consumers of a work queue must not overlap: no subject is in two lanes.
    #[test]
    fn lanes_do_not_overlap() {
        let labels = ["line-a".to_string(), "any".to_string(), "vacuum".to_string()];
        let lanes = Lane::of_cell("c1", &labels);
        assert_eq!(lanes.len(), 4 * 3, "`any` once");
        for (index, lane) in lanes.iter().enumerate() {
            for other in &lanes[index + 1..] {
                assert_ne!(fleet().lane_filter(lane), fleet().lane_filter(other));
                assert_ne!(lane.consumer(), other.consumer());
            }
        }
        assert!(lanes.windows(2).all(|pair| pair[0].priority <= pair[1].priority), "urgent ones first");
    }

    #[test]
    fn nothing_that_moves_an_arm_by_itself_can_be_requested_from_afar() {
        let words: Vec<&str> = RequestKind::ALL.into_iter().map(RequestKind::as_str).collect();
        assert_eq!(words, ["approve", "reject", "cancel", "send"]);
        for word in ["arm", "resume", "recover", "release", "step", "park"] {
            assert!(fleet().read_request(&format!("celld.v1.plant.ask.c1.{word}.anna"), "c1").is_err());
        }
        let subject = fleet().request("c1", RequestKind::Approve, "anna");
        assert_eq!(fleet().read_request(&subject, "c1"), Ok((RequestKind::Approve, "anna".to_string())));
        assert!(fleet().read_request(&subject, "c2").is_err());
    }

    #[test]
    fn keys_read_back_and_dots_of_ids_do_not_divide_them() {
        let (job, cell, by) = ("tidy.2".to_string(), "c1".to_string(), "anna".to_string());
        let keys = [
            Key::claim(&job),
            Key::Refusal { job: job.clone(), cell },
            Key::Cancel { job: job.clone(), by: by.clone() },
            Key::Give { job, by },
        ];
        for key in keys {
            assert_eq!(Key::of(&key.to_string()), Some(key.clone()), "{key}");
        }
        assert_eq!(Key::claim("tidy.2").to_string(), "claim.tidy=2");
        for wrong in ["claim", "claim.a.b", "claim.=a", "cancel.a", "lock.a", "claim.a b", ""] {
            assert_eq!(Key::of(wrong), None, "{wrong}");
        }
    }
}
