//! A job that is over, as one page: its report, and its recording played back.
//!
//! In: the journal, the job's folder, the recordings. Out: HTML that needs nothing else and gets no session.

use crate::daemon::job_report::job_report;
use crate::daemon::playback::page_of;
use crate::page::guard::Refused;
use crate::page::shared::App;
use crate::page::work::{beside, folder, known, recordings};
use crate::report::DARK_COMPUTER;
use crate::report::html::html;
use axum::extract::{Path, Query, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_SECURITY_POLICY;
use axum::response::{Html, IntoResponse, Response};
use serde::Deserialize;

/// In which light a page is wanted: `?theme=dark`, `?theme=light`, or as the computer has it.
#[derive(Deserialize)]
pub struct Light {
    theme: Option<Theme>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Theme {
    Light,
    Dark,
}

impl Light {
    /// The page, its styles for dark computers taken always or never.
    fn of(&self, page: &str) -> String {
        let media = match self.theme {
            Some(Theme::Dark) => "@media all",
            Some(Theme::Light) => "@media not all",
            None => return page.to_string(),
        };
        page.replace(DARK_COMPUTER, media)
    }
}

/// `GET /api/v1/jobs/{id}/report`
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn report(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(light): Query<Light>,
) -> Result<Response, Refused> {
    let page = beside(move || -> Result<String, Refused> {
        let (journal, job, steps) = known(&app, &id)?;
        let place = folder(&app, &journal, &id);
        Ok(light.of(&html(&job_report(&job, &steps, &app.cell, place.as_deref()))))
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
pub async fn playback(
    State(app): State<App>,
    Path(id): Path<String>,
    Query(light): Query<Light>,
) -> Result<Response, Refused> {
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
            .map(|page| light.of(&page))
            .map_err(|message| Refused::new(StatusCode::UNPROCESSABLE_ENTITY, message))
    });
    let page = page.await??;
    // It brings its script with it, and gets no session: whatever is in it can send no request.
    let policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; \
                  frame-ancestors 'none'; sandbox allow-scripts";
    Ok(([(CONTENT_SECURITY_POLICY, policy)], Html(page)).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::replay_page::{RecordedRun, replay_page};
    use crate::report::run::RunReport;

    #[test]
    fn report_and_played_back_run_are_dark_or_light_as_the_page_is() {
        for page in [html(&RunReport::default()), replay_page(&RecordedRun::default()).unwrap()] {
            assert!(page.contains("prefers-color-scheme"));
            let light = |theme| Light { theme }.of(&page);
            assert_eq!(light(None), page);
            let (dark, bright) = (light(Some(Theme::Dark)), light(Some(Theme::Light)));
            assert!(dark.contains("@media all") && !dark.contains("prefers-color-scheme"), "{dark}");
            assert!(
                bright.contains("@media not all") && !bright.contains("prefers-color-scheme"),
                "{bright}"
            );
        }
    }
}
