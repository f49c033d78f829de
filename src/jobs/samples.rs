//! Records of made-up jobs for the tests of other modules, which change what they are about.
//!
//! In: an id. Out: a [`JobRecord`], a [`JobResult`]; everything else in them is plain.

use crate::jobs::record::{JobRecord, JobResult, JobSpec, JobState};
use cell_machine::code::JobStatus;
use std::collections::BTreeMap;

impl JobRecord {
    /// A job that was done after a minute, for tests to change.
    pub(crate) fn sample(id: &str) -> JobRecord {
        JobRecord {
            sequence: 1,
            id: id.to_string(),
            name: format!("{id}.yaml"),
            sha256: String::new(),
            text: String::new(),
            spec: JobSpec::default(),
            state: JobState::Ended(JobStatus::Done),
            approved: None,
            approved_unix_s: None,
            found: Vec::new(),
            found_unix_s: None,
            resolved: None,
            plan: None,
            claimed_unix_s: 0.0,
            started_unix_s: None,
            ended_unix_s: Some(60.0),
            result: None,
        }
    }
}

impl JobResult {
    /// A job that ended like this, for tests to change.
    pub(crate) fn sample(id: &str, status: JobStatus) -> JobResult {
        JobResult {
            id: id.to_string(),
            status,
            code: status.as_str().to_string(),
            message: String::new(),
            hint: String::new(),
            moves: 0,
            lower_bound: None,
            seconds: 0.0,
            times: BTreeMap::new(),
            links_off_mm: None,
            objects: Vec::new(),
        }
    }
}
