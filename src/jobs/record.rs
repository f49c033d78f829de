//! What the database keeps of a job: the order, its state, its steps and its result.
//!
//! In and out: plain values; `result.yaml` as text. Pure. The words of [`JobState`] and [`JobStatus`] are
//! what people read in files and tables, so they do not change.

use crate::jobs::utc;
use cell_machine::code::JobStatus;
use cell_machine::orders::Approval;
use rearrange::document::word::{UnknownWord, named};
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::Objective;
use rearrange::tabletop::rule::GoalRule;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use std::str::FromStr;

/// One object's wanted pose, table frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GoalPose {
    /// Object of the catalogue.
    pub id: String,
    /// Wanted pose: m, m, rad.
    pub pose: Pose2,
}

/// A job after all checks: the goal resolved, everything else as the file said.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Default)]
pub struct JobSpec {
    /// The file's own id.
    pub id: Option<String>,
    /// Objects not named may end anywhere. Empty where a rule gives the poses, and where the table is only
    /// looked at.
    pub goal: Vec<GoalPose>,
    /// How the poses follow from what is seen first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rule: Option<GoalRule>,
    /// The job whose first sight is wanted back, in a file that has not been read by a daemon yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub restore: Option<String>,
    /// Absent: the cell's.
    pub objective: Option<Objective>,
    /// Absent: the cell's. A word, since a journal may come from a celld with other solvers.
    pub solver: Option<String>,
    /// Planning budget, s. Absent: the cell's.
    pub time_limit_s: Option<f64>,
    /// Absent: the cell's.
    pub seed: Option<u64>,
    /// Larger goes first.
    pub priority: i64,
    /// s since 1970; not started before.
    pub not_before_unix_s: Option<f64>,
    /// Absent: the cell's. Present: at least as strict as the cell's (the stricter one holds).
    pub approval: Option<Approval>,
    /// The same content may run again under a new id.
    pub rerun: bool,
}

/// State of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JobState {
    /// Accepted; waits for its turn, its time or an approval. Folder `hold`.
    Waiting,
    /// Being worked on; at most one. Folder `active`.
    Active,
    /// Ended, see [`JobStatus`].
    Ended(JobStatus),
}

impl JobState {
    /// All of them.
    pub const ALL: [JobState; 6] = [
        JobState::Waiting,
        JobState::Active,
        JobState::Ended(JobStatus::Done),
        JobState::Ended(JobStatus::Failed),
        JobState::Ended(JobStatus::Cancelled),
        JobState::Ended(JobStatus::Interrupted),
    ];

    /// The word in the database and in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            JobState::Waiting => "waiting",
            JobState::Active => "active",
            JobState::Ended(status) => status.as_str(),
        }
    }
}

impl fmt::Display for JobState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for JobState {
    type Err = UnknownWord;

    fn from_str(word: &str) -> Result<JobState, UnknownWord> {
        named(word, &JobState::ALL, JobState::as_str)
    }
}

/// A job as the database has it.
#[derive(Clone, Debug, PartialEq)]
pub struct JobRecord {
    /// Order of arrival.
    pub sequence: i64,
    /// Unique name.
    pub id: String,
    /// Name of the file it came in.
    pub name: String,
    /// Hash of the file, lower-case hex.
    pub sha256: String,
    /// The file, verbatim.
    pub text: String,
    /// What it requests.
    pub spec: JobSpec,
    /// Its state.
    pub state: JobState,
    /// What a person approved: the plan as JSON. Journals of earlier versions have other words there.
    pub approved: Option<String>,
    /// When, s since 1970; none where none did, and in what a celld before journal version 4 wrote.
    pub approved_unix_s: Option<f64>,
    /// Where the objects lay at its first look; empty before that.
    pub found: Vec<GoalPose>,
    /// When that was noted, s since 1970; none as for the approval.
    pub found_unix_s: Option<f64>,
    /// The goals that it has since then.
    pub resolved: Option<Vec<GoalPose>>,
    /// What was planned last.
    pub plan: Option<PlanRecord>,
    /// s since 1970.
    pub claimed_unix_s: f64,
    /// s since 1970; set while active and after.
    pub started_unix_s: Option<f64>,
    /// s since 1970; set when ended.
    pub ended_unix_s: Option<f64>,
    /// Set when ended.
    pub result: Option<JobResult>,
}

/// One pick-n-place, as written down before its first byte of motion leaves the PC.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepIntent {
    /// Object of the catalogue.
    pub object: String,
    /// Where it is gripped.
    pub from: Pose2,
    /// Where it is put.
    pub to: Pose2,
    /// What the place is.
    pub kind: StepKind,
    /// How the object hangs on the tool, seen from above. Journals of earlier versions do not have it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tool_from_object: Option<Pose2>,
    /// Where each object was seen last, by name.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub table: Vec<(String, Pose2)>,
}

/// What a pick-n-place leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StepKind {
    /// The object's goal. Journals of earlier versions call every step a move.
    #[serde(alias = "move")]
    Goal,
    /// A place where it waits.
    Buffer,
}

/// How far a step got.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StepPhase {
    /// Written down; motion may have begun.
    Intent,
    /// Vacuum verified: the object is on the cups.
    Gripped,
    /// Vacuum off at the place.
    Released,
    /// The arm has left the object.
    Done,
    /// Given up after a fault; the table has to be looked at again.
    Abandoned,
}

impl StepPhase {
    /// All of them, in their order.
    pub const ALL: [StepPhase; 5] =
        [StepPhase::Intent, StepPhase::Gripped, StepPhase::Released, StepPhase::Done, StepPhase::Abandoned];

    /// The word in the database.
    pub fn as_str(self) -> &'static str {
        match self {
            StepPhase::Intent => "intent",
            StepPhase::Gripped => "gripped",
            StepPhase::Released => "released",
            StepPhase::Done => "done",
            StepPhase::Abandoned => "abandoned",
        }
    }

    /// True while motion may be under way or unfinished.
    pub fn is_open(self) -> bool {
        match self {
            StepPhase::Intent | StepPhase::Gripped | StepPhase::Released => true,
            StepPhase::Done | StepPhase::Abandoned => false,
        }
    }
}

impl fmt::Display for StepPhase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for StepPhase {
    type Err = UnknownWord;

    fn from_str(word: &str) -> Result<StepPhase, UnknownWord> {
        named(word, &StepPhase::ALL, StepPhase::as_str)
    }
}

/// A step as the database has it.
#[derive(Clone, Debug, PartialEq)]
pub struct StepRecord {
    /// Counts from 1 within the job, across new plans.
    pub step: u32,
    /// What was meant.
    pub intent: StepIntent,
    /// How far it got.
    pub phase: StepPhase,
    /// When it got there, s since 1970.
    pub changed_unix_s: f64,
    /// When the object hung on the cups, s since 1970; none where it never did, or where the journal was
    /// written by a celld that kept the last change alone.
    pub gripped_unix_s: Option<f64>,
    /// What became of it where it left the cups otherwise than at its place, a sentence about "it".
    pub note: Option<String>,
}

/// The content of `result.yaml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobResult {
    /// The job.
    pub id: String,
    /// How it ended.
    pub status: JobStatus,
    /// For programs, see [`cell_machine::code::Code`].
    pub code: String,
    /// One sentence for people.
    pub message: String,
    /// What to do now; empty when there is nothing to do.
    pub hint: String,
    /// Pick-n-places carried out.
    pub moves: u32,
    /// Of the first plan.
    pub lower_bound: Option<f64>,
    /// From start to end of the job, s.
    pub seconds: f64,
    /// What they were used for, s, by the word of each use; empty where that is not known.
    #[serde(default)]
    pub times: BTreeMap<String, f64>,
    /// How far the arm's links are from those of a nominal arm at most, mm, by the calibration in its
    /// controller; `None` where celld did not end the job itself.
    #[serde(default)]
    pub links_off_mm: Option<f64>,
    /// Objects with a goal, as the camera last saw them.
    pub objects: Vec<ObjectResult>,
}

/// A plan as it was made.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlanRecord {
    /// Which plan of its cell it is, from 1, going on after a restart: a person agrees to this one. 0: a
    /// draft, or of an earlier version.
    #[serde(default)]
    pub number: u64,
    /// All of it, in order.
    pub steps: Vec<PlanStep>,
    /// Pick-n-places that the job had made before the first of them.
    #[serde(default)]
    pub made: usize,
    /// In the job's objective.
    pub lower_bound: Option<f64>,
    /// What it will take, s.
    pub seconds: Option<f64>,
    /// Where the objects lay that it starts from.
    pub table: Vec<GoalPose>,
    /// From an older sight, for people to look at; never carried out.
    pub preview: bool,
    /// Age of that sight when the plan was made, s.
    pub sight_age_s: f64,
    /// When it was made, s since 1970.
    pub unix_s: f64,
}

impl PlanRecord {
    /// Of its steps those that are carried out, where the job has made so many pick-n-places.
    pub fn carried_out(&self, made: usize) -> usize {
        made.saturating_sub(self.made).min(self.steps.len())
    }

    /// Pick-n-places to a place that is no goal.
    pub fn buffers(&self) -> usize {
        self.steps.iter().filter(|step| step.kind == StepKind::Buffer).count()
    }

    /// What it comes to, in one line.
    pub fn summary(&self) -> String {
        let mut text = format!("{} pick-n-places", self.steps.len());
        let buffers = self.buffers();
        if buffers > 0 {
            let _ = write!(text, ", {buffers} of them to a temporary place");
        }
        if let Some(bound) = self.lower_bound {
            let _ = write!(text, ", lower bound {bound}");
        }
        if let Some(seconds) = self.seconds {
            let _ = write!(text, ", about {seconds:.0} s");
        }
        if self.preview {
            let _ = write!(text, "; a preview, the table was seen {:.0} s before", self.sight_age_s);
        }
        text
    }

    /// Its moves, numbered, a line each: object, from, to; mm and degrees.
    pub fn moves(&self) -> Vec<String> {
        let place = |pose: &Pose2| {
            // Nought has no sign for people.
            let whole = |value: f64| value.round() + 0.0;
            let (x, y, degrees) = (whole(pose.x * 1e3), whole(pose.y * 1e3), whole(pose.theta.to_degrees()));
            format!("({x}, {y} mm, {degrees} deg)")
        };
        let line = |(k, step): (usize, &PlanStep)| {
            let what = if step.kind == StepKind::Goal { "its goal" } else { "a temporary place" };
            format!("{}. {} {} -> {} {what}", k + 1, step.object, place(&step.from), place(&step.to))
        };
        self.steps.iter().enumerate().map(line).collect()
    }
}

/// One pick-n-place of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanStep {
    /// Object of the catalogue.
    pub object: String,
    /// Where it is gripped, table frame.
    pub from: Pose2,
    /// Where it is put.
    pub to: Pose2,
    /// What the place is.
    pub kind: StepKind,
}

impl JobRecord {
    /// The plan that a person approved; empty where none was.
    pub fn agreed(&self) -> Vec<PlanStep> {
        self.approved.as_deref().and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default()
    }

    /// When the job came, began and ended, as lines of `result.yaml`.
    pub fn times_yaml(&self) -> String {
        let time = |at: Option<f64>| at.map_or("null".to_owned(), |at| quoted(&utc::text(at)));
        let JobRecord { claimed_unix_s, started_unix_s, ended_unix_s, .. } = self;
        let (claimed, started) = (time(Some(*claimed_unix_s)), time(*started_unix_s));
        format!("claimed: {claimed}\nstarted: {started}\nended: {}\n", time(*ended_unix_s))
    }
}

/// Pick-n-places that these steps carried out.
pub fn moves_made(steps: &[StepRecord]) -> u32 {
    steps.iter().filter(|step| step.phase == StepPhase::Done).count() as u32
}

/// One object of a result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObjectResult {
    /// Object of the catalogue.
    pub id: String,
    /// Wanted pose.
    pub goal: Option<Pose2>,
    /// Last measured pose; none where it was gripped since.
    pub measured: Option<Pose2>,
    /// When it was measured, s since 1970.
    #[serde(default)]
    pub measured_unix_s: Option<f64>,
    /// Distance between the two, mm.
    pub error_mm: Option<f64>,
    /// Angle between the two, degrees.
    pub error_deg: Option<f64>,
}

impl ObjectResult {
    /// Compares a wanted with a measured pose; with it, when it was measured, s since 1970.
    pub fn new(id: impl Into<String>, goal: Option<Pose2>, measured: Option<(Pose2, f64)>) -> ObjectResult {
        let (measured, measured_unix_s) = measured.unzip();
        let both = goal.zip(measured);
        ObjectResult {
            id: id.into(),
            goal,
            measured,
            measured_unix_s,
            error_mm: both.map(|(goal, measured)| goal.distance(&measured) * 1e3),
            error_deg: both.map(|(goal, measured)| goal.angle_difference(&measured).to_degrees()),
        }
    }
}

impl JobResult {
    /// The text of `result.yaml`. Strings are double-quoted as in JSON, which YAML reads alike.
    pub fn to_yaml(&self) -> String {
        let mut yaml = String::from("version: 1\n");
        let mut line = |key: &str, value: String| {
            let _ = writeln!(yaml, "{key}: {value}");
        };
        line("id", quoted(&self.id));
        line("status", self.status.to_string());
        line("code", quoted(&self.code));
        line("message", quoted(&self.message));
        line("remedy", quoted(&self.hint));
        line("moves", self.moves.to_string());
        line("lower_bound", number(self.lower_bound));
        line("seconds", number(Some(self.seconds)));
        let times = self.times.iter().map(|(what, seconds)| format!("{what}: {}", number(Some(*seconds))));
        line("times", format!("{{{}}}", times.collect::<Vec<_>>().join(", ")));
        line("links_off_mm", number(self.links_off_mm));
        if self.objects.is_empty() {
            line("objects", "[]".to_owned());
            return yaml;
        }
        yaml.push_str("objects:\n");
        for object in &self.objects {
            let _ = writeln!(
                yaml,
                "  - {{id: {}, goal: {}, measured: {}, at: {}, error_mm: {}, error_deg: {}}}",
                quoted(&object.id),
                pose(object.goal),
                pose(object.measured),
                object.measured_unix_s.map_or("null".to_owned(), |at| quoted(&utc::text(at))),
                number(object.error_mm.map(rounded)),
                number(object.error_deg.map(rounded))
            );
        }
        yaml
    }
}

/// A string as a double-quoted YAML (and JSON) scalar.
pub fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

fn number(value: Option<f64>) -> String {
    match value {
        Some(value) if value.is_finite() => format!("{value}"),
        _ => "null".to_owned(),
    }
}

/// To a tenth of a micrometre or of a millidegree: what is beyond is noise.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

fn pose(pose: Option<Pose2>) -> String {
    match pose {
        Some(Pose2 { x, y, theta }) => format!("[{x}, {y}, {theta}]"),
        None => "null".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn result_yaml_has_the_keys_of_the_design() {
        let goal = Pose2::new(0.1, 0.2, 0.0);
        let measured = Pose2::new(0.1, 0.2003, 0.01);
        let result = JobResult {
            id: "tidy-42".into(),
            status: JobStatus::Failed,
            code: "E_GRIP".into(),
            message: "no vacuum on \"mug\": cup \n worn?".into(),
            hint: String::new(),
            moves: 3,
            lower_bound: Some(2.0),
            seconds: 61.5,
            times: BTreeMap::from([("travel".to_string(), 40.25), ("vacuum".to_string(), 1.5)]),
            links_off_mm: Some(4.6),
            objects: vec![
                ObjectResult::new("mug", Some(goal), Some((measured, 1_795_248_000.0))),
                ObjectResult::new("cap", Some(goal), None),
            ],
        };
        insta::assert_snapshot!(result.to_yaml(), @r#"
        version: 1
        id: "tidy-42"
        status: failed
        code: "E_GRIP"
        message: "no vacuum on \"mug\": cup \n worn?"
        remedy: ""
        moves: 3
        lower_bound: 2
        seconds: 61.5
        times: {travel: 40.25, vacuum: 1.5}
        links_off_mm: 4.6
        objects:
          - {id: "mug", goal: [0.1, 0.2, 0], measured: [0.1, 0.2003, 0.01], at: "2026-11-21T08:00:00Z", error_mm: 0.3, error_deg: 0.573}
          - {id: "cap", goal: [0.1, 0.2, 0], measured: null, at: null, error_mm: null, error_deg: null}
        "#);
    }

    #[test]
    fn a_plan_is_legible_and_counts_its_buffers() {
        let step = |kind, theta| PlanStep {
            object: "mug".into(),
            from: Pose2::new(0.1, 0.2, theta),
            to: Pose2::new(0.3004, -1e-5, 0.0),
            kind,
        };
        let plan = PlanRecord {
            number: 1,
            steps: vec![step(StepKind::Buffer, -1e-4), step(StepKind::Goal, 1.57)],
            lower_bound: Some(2.0),
            seconds: Some(15.6),
            table: Vec::new(),
            preview: true,
            made: 0,
            sight_age_s: 40.4,
            unix_s: 0.0,
        };
        // Made before a job's first, or third, pick-n-place.
        assert_eq!([0, 1, 9].map(|made| plan.carried_out(made)), [0, 1, 2]);
        let later = PlanRecord { made: 2, ..plan.clone() };
        assert_eq!([0, 2, 3].map(|made| later.carried_out(made)), [0, 0, 1]);
        assert_eq!(
            plan.summary(),
            "2 pick-n-places, 1 of them to a temporary place, lower bound 2, about 16 s; a preview, the table \
             was seen 40 s before"
        );
        assert_eq!(
            plan.moves(),
            [
                "1. mug (100, 200 mm, 0 deg) -> (300, 0 mm, 0 deg) a temporary place",
                "2. mug (100, 200 mm, 90 deg) -> (300, 0 mm, 0 deg) its goal",
            ]
        );
    }

    #[test]
    fn states_and_phases_keep_their_words() {
        for word in ["waiting", "active", "done", "failed", "cancelled", "interrupted"] {
            assert_eq!(word.parse::<JobState>().map(JobState::as_str), Ok(word));
        }
        for word in ["intent", "gripped", "released", "done", "abandoned"] {
            assert_eq!(word.parse::<StepPhase>().map(StepPhase::as_str), Ok(word));
        }
    }
}
