//! A job once more: what it was to reach, under an id of its own.
//!
//! In: a job that the journal knows. Out: a job file in `incoming`, and the daemon's verdict on it. A job
//! that failed usually wants only its cause mended, and its goal need not be set by hand again.

use crate::jobs::job_file::job_yaml;
use crate::jobs::record::{JobRecord, JobSpec};
use crate::jobs::submit::hand_in;
use crate::page::access::Person;
use crate::page::guard::Refused;
use crate::page::shared::App;
use crate::page::work::{beside, known, read, verdict};
use axum::extract::{Extension, Path, State};
use axum::response::Response;
use cell_edge::clock::unix_now_s;
use std::path::PathBuf;

/// `POST /api/v1/jobs/{id}/again`
///
/// # Errors
/// The refusal, as the API answers it: the job is not known, or the cell of now does not take it any more.
pub async fn again(
    State(app): State<App>,
    Extension(person): Extension<Person>,
    Path(id): Path<String>,
) -> Result<Response, Refused> {
    let by = person.grant.name;
    let answer = beside(move || -> Result<Response, Refused> {
        let (_, job, _) = known(&app, &id)?;
        let spec = once_more(&job, read(&app, &job.text)?);
        let name = PathBuf::from(spec.id.clone().unwrap_or_default());
        let handed =
            hand_in(&app.state, &name, &spec, &job_yaml(&spec), unix_now_s()).map_err(Refused::fault)?;
        tracing::info!(job = handed.id, of = id, by, "submitted again at the page");
        verdict(&app, &handed)
    });
    answer.await?
}

/// The same without what counted for the first time alone: its number, and when it was to begin.
fn once_more(job: &JobRecord, spec: JobSpec) -> JobSpec {
    let numbered = job.id.rsplit_once('.').filter(|(_, number)| number.parse::<u32>().is_ok());
    let stem = numbered.map_or(job.id.as_str(), |(stem, _)| stem).to_string();
    JobSpec { id: Some(spec.id.clone().unwrap_or(stem)), rerun: true, not_before_unix_s: None, ..spec }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_gets_a_number_of_its_own_and_begins_at_once() {
        let spec = JobSpec { not_before_unix_s: Some(1e9), priority: 3, ..JobSpec::default() };
        for (id, named, expected) in
            [("tidy", None, "tidy"), ("tidy.4", None, "tidy"), ("a.b", None, "a.b"), ("a.2", Some("a"), "a")]
        {
            let named = JobSpec { id: named.map(str::to_string), ..spec.clone() };
            let next = once_more(&JobRecord::sample(id), named);
            assert_eq!((next.id.as_deref(), next.rerun), (Some(expected), true), "{id}");
            assert_eq!((next.not_before_unix_s, next.priority), (None, 3));
        }
    }
}
