//! Rows of the journal database as records and back.
//!
//! In: rows, records. Out: records, JSON text. A job whose file is being moved is recognised by the file's
//! identity (device, inode, size, time), so a crash between commit and rename is not a duplicate.

use crate::jobs::record::{JobRecord, JobResult, ObjectResult, StepPhase, StepRecord, moves_made};
use cell_edge::files::FileIdentity;
use cell_machine::code::{Code, JobStatus};
use rusqlite::Row;
use std::collections::BTreeMap;

/// The columns of a job, text not decoded yet.
pub(super) struct JobRow {
    pub sequence: i64,
    pub id: String,
    pub name: String,
    pub sha256: String,
    pub text: String,
    pub spec: String,
    pub state: String,
    pub approved: Option<String>,
    pub claimed: f64,
    pub started: Option<f64>,
    pub ended: Option<f64>,
    pub result: Option<String>,
    pub found: Option<String>,
    pub resolved: Option<String>,
    pub plan: Option<String>,
    pub found_at: Option<f64>,
    pub approved_at: Option<f64>,
}

/// Columns in the order of [`JobRow`], of a database of this version; older ones lack some.
pub(super) fn job_columns(version: i64) -> String {
    let first = "sequence, id, name, sha256, text, spec, state, approved, claimed, started, ended, result";
    let second = if version < 2 { "NULL, NULL, NULL" } else { "found, resolved, plan" };
    let third = if version < 4 { "NULL, NULL" } else { "found_at, approved_at" };
    format!("{first}, {second}, {third}")
}

pub(super) fn job_row(row: &Row) -> Result<JobRow, rusqlite::Error> {
    Ok(JobRow {
        sequence: row.get(0)?,
        id: row.get(1)?,
        name: row.get(2)?,
        sha256: row.get(3)?,
        text: row.get(4)?,
        spec: row.get(5)?,
        state: row.get(6)?,
        approved: row.get(7)?,
        claimed: row.get(8)?,
        started: row.get(9)?,
        ended: row.get(10)?,
        result: row.get(11)?,
        found: row.get(12)?,
        resolved: row.get(13)?,
        plan: row.get(14)?,
        found_at: row.get(15)?,
        approved_at: row.get(16)?,
    })
}

/// A file's identity as the database keeps it.
pub(in crate::jobs) fn source_text(source: &FileIdentity) -> String {
    format!("{}:{}:{}:{}", source.device, source.inode, source.size, source.modified_ns)
}

/// JSON of a record of ours; these have string keys only, so it cannot fail.
pub(super) fn encode(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).expect("records have string keys only")
}

/// A result without numbers that JSON cannot hold.
pub(super) fn storable(result: &JobResult) -> JobResult {
    let finite = |value: Option<f64>| value.filter(|value| value.is_finite());
    let objects = result.objects.iter().map(|object| ObjectResult {
        id: object.id.clone(),
        goal: object.goal.filter(|pose| pose.is_finite()),
        measured: object.measured.filter(|pose| pose.is_finite()),
        measured_unix_s: finite(object.measured_unix_s),
        error_mm: finite(object.error_mm),
        error_deg: finite(object.error_deg),
    });
    JobResult {
        seconds: finite(Some(result.seconds)).unwrap_or(0.0),
        lower_bound: finite(result.lower_bound),
        times: result.times.iter().filter(|(_, s)| s.is_finite()).map(|(k, s)| (k.clone(), *s)).collect(),
        links_off_mm: finite(result.links_off_mm),
        objects: objects.collect(),
        ..result.clone()
    }
}

/// The result of a job with a step of which it is not known how far it got.
pub(super) fn interrupted(
    job: &JobRecord,
    steps: &[StepRecord],
    open: &StepRecord,
    unix_s: f64,
) -> JobResult {
    let object = &open.intent.object;
    let holding = open.phase == StepPhase::Gripped;
    let hint = if holding {
        format!(
            "the gripper may hold {object:?}: `celld recover` shows the ways back; then submit the job \
             again with `rerun: true`"
        )
    } else {
        "look at the cell, `celld recover`, then submit the job again with `rerun: true`; it looks and \
         plans anew"
            .to_owned()
    };
    JobResult {
        id: job.id.clone(),
        status: JobStatus::Interrupted,
        code: if holding { Code::InterruptedCarrying } else { Code::Interrupted }.to_string(),
        message: format!(
            "celld ended during step {} ({object:?}, {}); how far the motion got is not known",
            open.step, open.phase
        ),
        hint,
        moves: moves_made(steps),
        lower_bound: None,
        seconds: job.started_unix_s.map_or(0.0, |started| (unix_s - started).max(0.0)),
        times: BTreeMap::new(),
        links_off_mm: None,
        objects: Vec::new(),
    }
}
