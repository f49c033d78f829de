//! What was done since a time: counts, throughput, how long a move took.
//!
//! In: the journal, read as any other process reads it. Out: JSON. An hour counts from the first job on,
//! and a move takes no time in which a person or a gate was waited for: both would say more of the people
//! than of the cell. A job that a restart has ended counts with its moves, not with its time.

use crate::jobs::history::JobFilter;
use crate::jobs::record::{JobRecord, JobResult, JobState};
use crate::page::guard::Refused;
use crate::page::shared::App;
use crate::page::work::{Wanted, beside, journal};
use axum::extract::{Json, Query, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use cell_edge::clock::unix_now_s;
use cell_machine::code::JobStatus;
use cell_machine::times::Use;
use rearrange::document::chain::chain;
use serde_json::{Value, json};

/// Jobs of longer ago are not counted, s: the records of all of them are read.
const COUNTED_S: f64 = 31.0 * 24.0 * 3600.0;

/// `GET /api/v1/shift`
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn shift(State(app): State<App>, Query(wanted): Query<Wanted>) -> Result<Response, Refused> {
    let begun = wanted.filter()?.since_unix_s.unwrap_or_else(|| unix_now_s() - 8.0 * 3600.0);
    if begun < unix_now_s() - COUNTED_S {
        return Err(Refused::new(StatusCode::BAD_REQUEST, "`since` goes back 31 days at most"));
    }
    let body = beside(move || -> Result<Value, Refused> {
        let filter = JobFilter { since_unix_s: Some(begun), ..JobFilter::default() };
        let jobs = match journal(&app)? {
            Some(journal) => {
                journal.search(&filter, u32::MAX).map_err(|error| Refused::fault(chain(&error)))?
            }
            None => Vec::new(),
        };
        Ok(counts(&jobs, begun, unix_now_s()))
    });
    Ok(Json(body.await??).into_response())
}

/// The work since `begun` (s since 1970). Hours and shares count from the first job on; what is taken off a
/// move is [`Use::Waiting`]: for a person, a gate, a command on its way.
fn counts(jobs: &[JobRecord], begun: f64, now: f64) -> Value {
    let of = |status| jobs.iter().filter(|job| job.state == JobState::Ended(status)).count();
    let results = || jobs.iter().filter_map(|job| job.result.as_ref());
    let moves: u64 = results().map(|result| u64::from(result.moves)).sum();
    let waited = |result: &JobResult| result.times.get(Use::Waiting.as_str()).copied().unwrap_or(0.0);
    // A job that a restart has ended has the time since it began, and no account of it.
    let accounted = || results().filter(|result| !result.times.is_empty());
    let busy_s: f64 = accounted().map(|result| (result.seconds - waited(result)).max(0.0)).sum();
    let timed: u64 = accounted().map(|result| u64::from(result.moves)).sum();
    let first = jobs.iter().map(|job| job.claimed_unix_s).fold(now, f64::min).max(begun);
    let hours = ((now - first) / 3600.0).max(1e-3);
    json!({
        "since_unix_s": begun, "hours": hours, "done": of(JobStatus::Done), "failed": of(JobStatus::Failed),
        "cancelled": of(JobStatus::Cancelled), "interrupted": of(JobStatus::Interrupted), "moves": moves,
        "moves_per_hour": moves as f64 / hours, "busy_share": (busy_s / (now - first).max(1.0)).min(1.0),
        "seconds_per_move": (timed > 0).then(|| busy_s / timed as f64),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(claimed_unix_s: f64, seconds: f64, waited: f64, moves: u32) -> JobRecord {
        let result = JobResult {
            id: "tidy".into(),
            status: JobStatus::Done,
            code: "done".into(),
            message: String::new(),
            hint: String::new(),
            moves,
            lower_bound: None,
            seconds,
            times: [(Use::Waiting.as_str().to_string(), waited)].into(),
            links_off_mm: None,
            objects: Vec::new(),
        };
        JobRecord { claimed_unix_s, result: Some(result), ..JobRecord::sample("tidy") }
    }

    #[test]
    fn an_hour_counts_from_the_first_job_and_a_move_without_waiting() {
        let begun = 1_000_000.0;
        let jobs = [job(begun + 3600.0, 400.0, 380.0, 2), job(begun + 5000.0, 40.0, 0.0, 4)];
        let shift = counts(&jobs, begun, begun + 2.0 * 3600.0);
        assert_eq!((shift["moves"].as_u64(), shift["moves_per_hour"].as_f64()), (Some(6), Some(6.0)));
        assert_eq!(shift["seconds_per_move"].as_f64(), Some(10.0));
        assert_eq!(shift["busy_share"].as_f64(), Some(60.0 / 3600.0));
        let mut ended_by_a_restart = job(begun + 6000.0, 3000.0, 0.0, 3);
        ended_by_a_restart.result.iter_mut().for_each(|result| result.times.clear());
        let shift = counts(&[jobs[1].clone(), ended_by_a_restart], begun, begun + 2.0 * 3600.0);
        assert_eq!((shift["moves"].as_u64(), shift["seconds_per_move"].as_f64()), (Some(7), Some(10.0)));
        let none = counts(&[], begun, begun + 3600.0);
        assert_eq!((none["moves_per_hour"].as_f64(), &none["seconds_per_move"]), (Some(0.0), &Value::Null));
    }
}
