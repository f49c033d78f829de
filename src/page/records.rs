//! A job that is over, as one page: its report, and its recording played back.
//!
//! In: the journal, the job's folder, the recordings. Out: HTML that needs nothing else and gets no session.

use crate::daemon::job_report::job_report;
use crate::daemon::playback::page_of;
use crate::page::guard::Refused;
use crate::page::shared::App;
use crate::page::work::{beside, folder, known, recordings};
use crate::report::html::html;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_SECURITY_POLICY;
use axum::response::{Html, IntoResponse, Response};

/// `GET /api/v1/jobs/{id}/report`
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn report(State(app): State<App>, Path(id): Path<String>) -> Result<Response, Refused> {
    let page = beside(move || -> Result<String, Refused> {
        let (journal, job, steps) = known(&app, &id)?;
        let place = folder(&app, &journal, &id);
        Ok(html(&job_report(&job, &steps, &app.cell, place.as_deref())))
    });
    let page = page.await??;
    // The report brings its own styles and pictures, and no script.
    let policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'";
    Ok(([(CONTENT_SECURITY_POLICY, policy)], Html(page)).into_response())
}

/// `GET /api/v1/jobs/{id}/playback`
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn playback(State(app): State<App>, Path(id): Path<String>) -> Result<Response, Refused> {
    let Ok(place) = app.planning.clone().try_acquire_owned() else {
        let message = "another recording is being read, or a plan made; try again";
        return Err(Refused::new(StatusCode::TOO_MANY_REQUESTS, message));
    };
    let page = beside(move || -> Result<String, Refused> {
        let _place = place;
        let (_, job, _) = known(&app, &id)?;
        let files = recordings(&app, &job.id);
        if files.is_empty() {
            let message = "nothing is recorded of this job (any more): see `recording` in the configuration";
            return Err(Refused::new(StatusCode::NOT_FOUND, message));
        }
        page_of(format!("job {}", job.id), &files)
            .map_err(|message| Refused::new(StatusCode::UNPROCESSABLE_ENTITY, message))
    });
    let page = page.await??;
    // It brings its script with it, and gets no session: whatever is in it can send no request.
    let policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; \
                  frame-ancestors 'none'; sandbox allow-scripts";
    Ok(([(CONTENT_SECURITY_POLICY, policy)], Html(page)).into_response())
}
