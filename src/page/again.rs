//! A job once more: what it was to reach, under an id of its own.
//!
//! In: a job that the journal knows. Out: a job file in `incoming`, and the daemon's verdict on it. A job
//! that failed usually wants only its cause mended, and its goal need not be set by hand again.

use crate::jobs::job_file::job_yaml;
use crate::jobs::record::{JobRecord, JobSpec, JobState};
use crate::jobs::submit::hand_in;
use crate::page::access::Person;
use crate::page::guard::Refused;
use crate::page::shared::App;
use crate::page::work::{beside, known, verdict};
use axum::extract::{Extension, Path, State};
use axum::http::StatusCode;
use axum::response::Response;
use cell_edge::clock::unix_now_s;
use cell_machine::orders::Approval;
use std::path::PathBuf;

/// `POST /api/v1/jobs/{id}/again`
///
/// # Errors
/// The refusal, as the API answers it: the job is not known or has not ended, or the cell of now does not
/// take it any more.
pub async fn again(
    State(app): State<App>,
    Extension(person): Extension<Person>,
    Path(id): Path<String>,
) -> Result<Response, Refused> {
    let by = person.grant.name;
    let answer = beside(move || -> Result<Response, Refused> {
        let (_, job, _) = known(&app, &id)?;
        match job.state {
            JobState::Ended(_) => {}
            JobState::Waiting | JobState::Active => {
                return Err(Refused::new(StatusCode::CONFLICT, "the job has not ended yet"));
            }
        }
        let spec = once_more(&job, app.cell.approval);
        let name = PathBuf::from(spec.id.clone().unwrap_or_default());
        let handed =
            hand_in(&app.state, &name, &spec, &job_yaml(&spec), unix_now_s()).map_err(Refused::fault)?;
        tracing::info!(job = handed.id, of = id, by, "submitted again at the page");
        verdict(&app, &handed)
    });
    answer.await?
}

/// The same goal as the journal has it, whatever became of the file that it came from; without what counted
/// for the first time alone: its number, when it was to begin, an approval below that of the cell now.
fn once_more(job: &JobRecord, least: Approval) -> JobSpec {
    let spec = job.spec.clone();
    let numbered = job.id.rsplit_once('.').filter(|(_, number)| number.parse::<u32>().is_ok());
    let stem = numbered.map_or(job.id.as_str(), |(stem, _)| stem).to_string();
    let approval = spec.approval.filter(|stated| *stated >= least);
    JobSpec { id: Some(spec.id.unwrap_or(stem)), rerun: true, not_before_unix_s: None, approval, ..spec }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::record::GoalPose;
    use rearrange::geometry::pose::Pose2;

    #[test]
    fn a_job_gets_a_number_of_its_own_and_begins_at_once() {
        let goal = vec![GoalPose { id: "mug".into(), pose: Pose2::new(0.1, 0.2, 0.3) }];
        let spec = JobSpec {
            not_before_unix_s: Some(1e9),
            priority: 3,
            approval: Some(Approval::Never),
            goal,
            ..JobSpec::default()
        };
        for (id, named, expected) in
            [("tidy", None, "tidy"), ("tidy.4", None, "tidy"), ("a.b", None, "a.b"), ("a.2", Some("a"), "a")]
        {
            let named = JobSpec { id: named.map(str::to_string), ..spec.clone() };
            let job =
                JobRecord { spec: named, text: "goal: {file: changed.yaml}".into(), ..JobRecord::sample(id) };
            let next = once_more(&job, Approval::Job);
            assert_eq!((next.id.as_deref(), next.rerun), (Some(expected), true), "{id}");
            assert_eq!((next.not_before_unix_s, next.priority), (None, 3));
            assert_eq!((&next.goal, next.approval), (&job.spec.goal, None));
            assert_eq!(once_more(&job, Approval::Never).approval, Some(Approval::Never));
        }
    }
}
