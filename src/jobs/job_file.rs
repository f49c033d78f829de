//! Job files: text to [`JobSpec`], with every complaint at once.
//!
//! In: the text of a job file, the cell's catalogue and table, a reader for goal files. Out: the job with
//! its goal as poses or as a rule, so that nothing outside the journal is needed later; or all complaints
//! with line and column. A goal that overlaps itself, leaves the table or names an unknown object is a
//! complaint here: such a job is rejected, it does not fail later.

pub use crate::jobs::goal::{JobContext, ReadGoal};
use crate::jobs::goal_source::{UNUSED, WantedGoal, decode_goal_source};
use crate::jobs::record::{JobSpec, quoted};
use crate::jobs::spool::{Refusal, RefusalDetail, is_plain_name};
use crate::jobs::utc;
use cell_machine::code::Code;
use cell_machine::orders::Approval;
use rearrange::document::decode::{At, Decoder, Fields};
use rearrange::document::{Diagnostic, Diagnostics, Location, parse};
use rearrange::geometry::pose::Pose2;
use rearrange::planning::solver::SolverKind;
use rearrange::tabletop::rule::{GoalRule, Members};
use std::fmt::Write as _;

/// Keys of a job file.
const KEYS: [&str; 11] = [
    "version",
    "id",
    "goal",
    "objective",
    "solver",
    "time_limit_s",
    "seed",
    "priority",
    "not_before",
    "approval",
    "rerun",
];

/// Longest planning budget a job may request, s.
const MAX_TIME_LIMIT_S: f64 = 86_400.0;

/// Reads and checks a job file.
///
/// # Errors
/// Every complaint; those about the goal file name that file.
pub fn read_job(text: &str, source: &str, context: &JobContext) -> Result<JobSpec, Diagnostics> {
    let (node, mut decoder) = Decoder::open(text, source)?;
    let mut goal_complaints = Diagnostics::default();
    let job = decoder
        .map(&At::top(&node), &KEYS)
        .and_then(|fields| decode_job(&mut decoder, &fields, context, &mut goal_complaints));
    match decoder.finish(job) {
        Ok(job) if goal_complaints.0.is_empty() => Ok(job),
        Ok(_) => Err(goal_complaints),
        Err(mut complaints) => {
            complaints.0.retain(|complaint| complaint.message != UNUSED);
            complaints.0.extend(goal_complaints.0);
            Err(complaints)
        }
    }
}

fn decode_job(
    decoder: &mut Decoder,
    fields: &Fields,
    context: &JobContext,
    goal_complaints: &mut Diagnostics,
) -> Option<JobSpec> {
    if let Some(at) = fields.required("version", decoder) {
        decoder.integer(&at, 1..=1);
    }
    let goal = fields
        .required("goal", decoder)
        .and_then(|at| decode_goal_source(decoder, &at, context, goal_complaints));
    let id = fields.optional("id").and_then(|at| decode_id(decoder, &at));
    let objective = fields.optional("objective").and_then(|at| decoder.word(&at));
    let solver = fields.optional("solver").and_then(|at| decoder.word::<SolverKind>(&at));
    let time_limit_s =
        fields.optional("time_limit_s").and_then(|at| decoder.number_in(&at, 0.001..=MAX_TIME_LIMIT_S, "s"));
    let seed = fields.optional("seed").and_then(|at| decoder.integer(&at, 0..=i64::MAX));
    let priority = fields.optional("priority").and_then(|at| decoder.integer(&at, -1000..=1000));
    let not_before = fields.optional("not_before").and_then(|at| decode_time(decoder, &at));
    let approval = fields.optional("approval").and_then(|at| decode_approval(decoder, &at, context.approval));
    let rerun = fields.optional("rerun").and_then(|at| decoder.boolean(&at));
    let WantedGoal { poses, rule, restore } = goal?;
    Some(JobSpec {
        id,
        goal: poses,
        rule,
        restore,
        objective,
        solver: solver.map(|solver| solver.to_string()),
        time_limit_s,
        seed: seed.and_then(|seed| u64::try_from(seed).ok()),
        priority: priority.unwrap_or(0),
        not_before_unix_s: not_before,
        approval,
        rerun: rerun.unwrap_or(false),
    })
}

fn decode_id(decoder: &mut Decoder, at: &At) -> Option<String> {
    let id = decoder.text(at)?;
    if is_plain_name(&id) {
        return Some(id);
    }
    let help = "1 to 80 letters, digits, dots, dashes and underscores, not beginning with a dot";
    decoder.complain_at(at, format!("{id:?} cannot be the id of a job"), help);
    None
}

fn decode_time(decoder: &mut Decoder, at: &At) -> Option<f64> {
    let text = decoder.text(at)?;
    let time = utc::parse(&text);
    if time.is_none() {
        decoder.complain_at(at, format!("{text:?} is not a time"), "write it in UTC as 2026-11-21T08:00:00Z");
    }
    time
}

fn decode_approval(decoder: &mut Decoder, at: &At, floor: Approval) -> Option<Approval> {
    let approval = decoder.word::<Approval>(at)?;
    if approval < floor {
        let message = format!("the cell requires approval {:?}, a job may only be stricter", floor.as_str());
        decoder.complain_at(at, message, "remove the key");
        return None;
    }
    Some(approval)
}

/// [`read_job`] in the words of the spool.
///
/// # Errors
/// The job or its goal is faulty; the refusal holds every complaint of [`read_job`].
pub fn read_for_spool(text: &str, name: &str, context: &JobContext) -> Result<JobSpec, Refusal> {
    read_job(text, name, context).map_err(|complaints| refusal(text, name, &complaints))
}

fn refusal(text: &str, name: &str, complaints: &Diagnostics) -> Refusal {
    let syntax = parse(text, name).is_err();
    let incomplete = text.trim().is_empty() || (syntax && complaints.0.iter().any(|c| at_end(text, c)));
    let count = complaints.0.len();
    let message = match complaints.0.as_slice() {
        [only] => only.to_string(),
        _ => format!("{count} complaints, the first: {}", first(complaints)),
    };
    let hint = if incomplete {
        "the file ends in the middle; was it still being copied? copy it again, or use `celld submit`"
    } else {
        "correct what the complaints name and submit the file again; `celld check` reports the same beforehand"
    };
    let mut refusal = Refusal::new(if syntax { Code::Syntax } else { Code::Invalid }, message, hint);
    refusal.incomplete = incomplete;
    refusal.complaints = complaints.0.iter().map(detail).collect();
    refusal
}

fn first(complaints: &Diagnostics) -> String {
    complaints.0.first().map(ToString::to_string).unwrap_or_default()
}

fn detail(complaint: &Diagnostic) -> RefusalDetail {
    let number = |value: usize| u32::try_from(value).unwrap_or(u32::MAX);
    RefusalDetail {
        path: complaint.path.clone(),
        line: number(complaint.at.line),
        column: number(complaint.at.column),
        message: format!("{}: {}", complaint.source, complaint.message),
        help: complaint.help.clone(),
    }
}

/// True for a complaint at the very end of the text, or behind it.
fn at_end(text: &str, complaint: &Diagnostic) -> bool {
    let last = text.trim_end().lines().count();
    let width = text.trim_end().lines().last().map_or(0, |line| line.chars().count());
    complaint.at >= Location { line: last, column: width }
}

/// A job file with the same content and the goal inside: what `celld submit` leaves for the daemon.
pub fn job_yaml(job: &JobSpec) -> String {
    let mut yaml = String::from("version: 1\n");
    let mut line = |key: &str, value: Option<String>| {
        if let Some(value) = value {
            let _ = writeln!(yaml, "{key}: {value}");
        }
    };
    line("id", job.id.as_deref().map(quoted));
    line("objective", job.objective.map(|objective| objective.to_string()));
    line("solver", job.solver.clone());
    line("time_limit_s", job.time_limit_s.map(|limit| limit.to_string()));
    line("seed", job.seed.map(|seed| seed.to_string()));
    line("priority", (job.priority != 0).then(|| job.priority.to_string()));
    line("not_before", job.not_before_unix_s.map(|time| quoted(&utc::text(time))));
    line("approval", job.approval.map(|approval| approval.to_string()));
    line("rerun", job.rerun.then(|| "true".to_owned()));
    match (&job.rule, &job.restore) {
        (Some(rule), _) => line("goal", Some(rule_yaml(rule))),
        (None, Some(restore)) => line("goal", Some(format!("{{restore: {}}}", quoted(restore)))),
        (None, None) if job.goal.is_empty() => line("goal", Some("{look: true}".to_string())),
        (None, None) => {
            yaml.push_str("goal:\n");
            yaml.push_str(&goal_yaml(job.goal.iter().map(|goal| (goal.id.as_str(), goal.pose)), "  "));
        }
    }
    yaml
}

/// A rule in flow style; JSON's strings and numbers are YAML's.
fn rule_yaml(rule: &GoalRule) -> String {
    let json = |value: serde_json::Value| value.to_string();
    let members = |members: &Members| match members {
        Members::Objects(ids) => format!("objects: {}", json(ids.as_slice().into())),
        Members::Group(group) => format!("group: {}", quoted(group)),
    };
    match rule {
        GoalRule::Region { members: who, polygon } => {
            let points: Vec<_> = polygon.iter().map(|[x, y]| format!("[{x}, {y}]")).collect();
            format!("{{region: {{{}, polygon: [{}]}}}}", members(who), points.join(", "))
        }
        GoalRule::Grid { members: who, origin, pitch, columns, theta } => format!(
            "{{grid: {{{}, origin: [{}, {}], pitch: [{}, {}], columns: {columns}, theta: {theta}}}}}",
            members(who),
            origin[0],
            origin[1],
            pitch[0],
            pitch[1]
        ),
        GoalRule::Swap(a, b) => format!("{{swap: [{}, {}]}}", quoted(a), quoted(b)),
    }
}

/// `objects: [...]` of a goal, one line each; also the content of a goal file.
pub fn goal_yaml<'a>(goal: impl Iterator<Item = (&'a str, Pose2)>, indent: &str) -> String {
    let mut yaml = format!("{indent}objects:\n");
    for (id, Pose2 { x, y, theta }) in goal {
        let _ = writeln!(yaml, "{indent}  - {{id: {}, pose: [{x}, {y}, {theta}]}}", quoted(id));
    }
    yaml
}

#[cfg(test)]
mod tests;
