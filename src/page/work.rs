//! Jobs, goals, drafts: what was done, what is wanted, what it would take.
//!
//! In: the journal, read as any other process reads it; jobs as text, as in job files. Out: JSON. A job is
//! handed in as `celld submit` does, and its verdict is the spool's: the page knows no other way in.

use crate::daemon::job_orders::{found_by, job_context, job_order};
use crate::daemon::plan_files;
use crate::daemon::recordings_folder::recordings_of;
use crate::jobs::goal::{GoalEntry, find_goal_file, parse_goal_file, read_goal_file};
use crate::jobs::history::{JobFilter, since, story, story_lines, unseen};
use crate::jobs::job_file::read_job;
use crate::jobs::journal::Journal;
use crate::jobs::record::{GoalPose, JobRecord, JobSpec, StepRecord, quoted};
use crate::jobs::spool::is_plain_name;
use crate::jobs::submit::{Found, Handed, hand_in, look, prepare};
use crate::page::access::Person;
use crate::page::drafts::{self, goal_faults, settled};
use crate::page::guard::Refused;
use crate::page::session::unreadable;
use crate::page::shared::{App, Shared};
use crate::page::views::poses;
use axum::extract::rejection::JsonRejection;
use axum::extract::{Extension, Json, Path, Query, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use cell_edge::clock::unix_now_s;
use cell_edge::files::{read_bytes, write_atomic, write_new};
use cell_machine::supervisor::draft::{Draft, Glimpse, NoDraft, draft};
use cell_values::time::Duration;
use rearrange::document::chain::chain;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Instant;

/// Most jobs that are listed at once.
const JOBS_MAX: u32 = 500;

/// So long the daemon is given to read a job file.
const VERDICT_WITHIN: std::time::Duration = std::time::Duration::from_secs(10);
const LOOK_EVERY: std::time::Duration = std::time::Duration::from_millis(50);

/// A draft is planned for so long at most, whatever the job allows.
const DRAFT_WITHIN: std::time::Duration = std::time::Duration::from_secs(20);

/// Largest picture that is read.
const PICTURE_MAX: u64 = 32 << 20;

/// Runs what waits for a disk or computes long beside the streams.
pub(super) async fn beside<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Refused> {
    tokio::task::spawn_blocking(work)
        .await
        .map_err(|_| Refused::fault("this is a fault of celld; see its log"))
}

pub(super) fn journal(app: &Shared) -> Result<Option<Journal>, Refused> {
    let path = app.state.journal();
    if !path.exists() {
        return Ok(None);
    }
    Journal::open_to_read(&path).map(Some).map_err(|error| Refused::fault(chain(&error)))
}

/// `GET /api/v1/jobs`
#[derive(Deserialize, Default)]
#[serde(default)]
pub struct Wanted {
    last: Option<u32>,
    failed: bool,
    since: Option<String>,
    object: Option<String>,
}

impl Wanted {
    pub(super) fn filter(&self) -> Result<JobFilter, Refused> {
        let since_unix_s = match self.since.as_deref().map(|text| since(text, unix_now_s())) {
            Some(None) => {
                let message = "since: write 90s, 30m, 12h, 2d or 1w, or a date such as 2026-11-21";
                return Err(Refused::new(StatusCode::BAD_REQUEST, message));
            }
            Some(time) => time,
            None => None,
        };
        Ok(JobFilter { failed: self.failed, since_unix_s, object: self.object.clone() })
    }
}

/// Jobs, the newest first.
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn jobs(State(app): State<App>, Query(wanted): Query<Wanted>) -> Result<Response, Refused> {
    let filter = wanted.filter()?;
    let last = wanted.last.unwrap_or(50).min(JOBS_MAX);
    let found = beside(move || -> Result<Vec<Value>, Refused> {
        let Some(journal) = journal(&app)? else { return Ok(Vec::new()) };
        let jobs = journal.search(&filter, last).map_err(|error| Refused::fault(chain(&error)))?;
        Ok(jobs.iter().map(summary).collect())
    });
    Ok(Json(found.await??).into_response())
}

/// What a list of jobs shows of one.
fn summary(job: &JobRecord) -> Value {
    json!({
        "id": job.id, "file": job.name, "state": job.state.as_str(), "claimed_unix_s": job.claimed_unix_s,
        "started_unix_s": job.started_unix_s, "ended_unix_s": job.ended_unix_s,
        "moves": job.result.as_ref().map(|result| result.moves),
        "lower_bound": job.result.as_ref().and_then(|result| result.lower_bound),
        "seconds": job.result.as_ref().map(|result| result.seconds),
        "code": job.result.as_ref().map(|result| &result.code),
        "message": job.result.as_ref().map(|result| &result.message),
        "hint": job.result.as_ref().map(|result| &result.hint),
    })
}

/// A job with its steps; none where it is not known.
pub(super) fn known(app: &Shared, id: &str) -> Result<(Journal, JobRecord, Vec<StepRecord>), Refused> {
    let unknown = || Refused::new(StatusCode::NOT_FOUND, "no such job is known");
    let journal = journal(app)?.ok_or_else(unknown)?;
    let job = journal.job(id).map_err(|error| Refused::fault(chain(&error)))?.ok_or_else(unknown)?;
    let steps = journal.steps(id).map_err(|error| Refused::fault(chain(&error)))?;
    Ok((journal, job, steps))
}

/// The folder that a job's files are in now.
pub(super) fn folder(app: &Shared, journal: &Journal, id: &str) -> Option<PathBuf> {
    let place = journal.folder_of(id).ok().flatten()?;
    Some(app.state.root().join("jobs").join(place))
}

/// Files of a job that are shown, with their types.
const FILES: [(&str, &str); 3] =
    [("plan.svg", "image/svg+xml"), ("plan.jpg", "image/jpeg"), ("end.jpg", "image/jpeg")];

/// `GET /api/v1/jobs/{id}`
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn job(State(app): State<App>, Path(id): Path<String>) -> Result<Response, Refused> {
    let body = beside(move || -> Result<Value, Refused> {
        let (journal, job, steps) = known(&app, &id)?;
        let place = folder(&app, &journal, &id);
        let has = |name: &str| place.as_ref().is_some_and(|place| place.join(name).is_file());
        let files: Vec<_> = FILES.iter().map(|(name, _)| *name).filter(|name| has(name)).collect();
        let mut body = summary(&job);
        let last = journal.begun_last().map_err(|error| Refused::fault(chain(&error)))?;
        let is_last = last.as_deref() == Some(&job.id);
        body["last"] = is_last.into();
        body["story"] = story(&job, &steps, is_last).into();
        let line = |(unix_s, text)| json!({ "unix_s": unix_s, "text": text });
        body["lines"] = story_lines(&job, &steps).into_iter().map(line).collect();
        body["text"] = job.text.clone().into();
        body["approval"] = json!(job.spec.approval);
        body["plan"] = json!(job.plan);
        body["found"] = json!(job.found);
        body["goals"] = json!(job.resolved.as_ref().unwrap_or(&job.spec.goal));
        body["result"] = json!(job.result);
        body["files"] = json!(files);
        body["recorded"] = (!recordings(&app, &id).is_empty()).into();
        let step = |step: &StepRecord| {
            json!({
                "step": step.step, "object": step.intent.object, "from": step.intent.from, "to": step.intent.to,
                "kind": step.intent.kind, "phase": step.phase.as_str(), "unix_s": step.changed_unix_s,
            })
        };
        body["steps"] = steps.iter().map(step).collect();
        let objects = job.result.iter().flat_map(|result| &result.objects);
        let unknown = objects.filter(|object| object.measured.is_none());
        let words: BTreeMap<_, _> = unknown.map(|object| (&object.id, unseen(&object.id, &steps))).collect();
        body["unseen"] = json!(words);
        Ok(body)
    });
    Ok(Json(body.await??).into_response())
}

/// What was recorded of a job.
pub(super) fn recordings(app: &Shared, id: &str) -> Vec<PathBuf> {
    app.cell.recording.as_ref().map(|to| recordings_of(&to.folder, id)).unwrap_or_default()
}

/// `GET /api/v1/jobs/{id}/files/{name}`
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn file(
    State(app): State<App>,
    Path((id, name)): Path<(String, String)>,
) -> Result<Response, Refused> {
    let absent = || Refused::new(StatusCode::NOT_FOUND, "the job has no such file");
    let (name, kind) = FILES.into_iter().find(|(known, _)| *known == name).ok_or_else(absent)?;
    let bytes = beside(move || -> Result<Option<Vec<u8>>, Refused> {
        let (journal, ..) = known(&app, &id)?;
        let place = folder(&app, &journal, &id);
        Ok(place.and_then(|place| read_bytes(&place.join(name), PICTURE_MAX).ok()))
    });
    let bytes = bytes.await??.ok_or_else(absent)?;
    Ok(([(CONTENT_TYPE, kind)], bytes).into_response())
}

/// A job as in a job file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobText {
    text: String,
    /// Part of the name of its file.
    #[serde(default)]
    name: Option<String>,
}

/// What a job is read against: the cell, its goal folder, what other jobs found.
fn read(app: &Shared, text: &str) -> Result<JobSpec, Refused> {
    let obstacles = app.cell.obstacles();
    let read_goal = |name: &str| match std::path::Path::new(name).file_name() {
        Some(last) if is_goal_name(&last.to_string_lossy()) => read_goal_file(&app.cell.goal_folder, name),
        Some(_) | None => Err("a goal file ends in .yaml".to_string()),
    };
    let journal = app.state.journal();
    let found = |id: &str| found_by(&journal, id);
    let context = job_context(&app.cell, &obstacles, &read_goal, &found);
    read_job(text, "job", &context)
        .map_err(|complaints| Refused::new(StatusCode::UNPROCESSABLE_ENTITY, complaints.to_string()))
}

/// Submits a job and waits for the verdict.
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn submit(
    State(app): State<App>,
    Extension(person): Extension<Person>,
    body: Result<Json<JobText>, JsonRejection>,
) -> Result<Response, Refused> {
    let Json(JobText { text, name }) = body.map_err(|error| unreadable(&error))?;
    let by = person.grant.name;
    let answer = beside(move || -> Result<Response, Refused> {
        read(&app, &text)?;
        // Read above, by the same name.
        let read_goal = |name: &str| find_goal_file(&app.cell.goal_folder, None, name);
        let prepared = prepare(&text, "job", &read_goal);
        let (job, text) =
            prepared.map_err(|message| Refused::new(StatusCode::UNPROCESSABLE_ENTITY, message))?;
        let name = PathBuf::from(name.unwrap_or_else(|| "page".to_string()));
        let handed = hand_in(&app.state, &name, &job, &text, unix_now_s()).map_err(Refused::fault)?;
        tracing::info!(job = handed.id, by, "submitted at the page");
        verdict(&app, &handed)
    });
    answer.await?
}

/// What the daemon says of a job file.
pub(super) fn verdict(app: &Shared, handed: &Handed) -> Result<Response, Refused> {
    let begun = Instant::now();
    loop {
        match look(&app.state, handed).map_err(|error| Refused::fault(chain(&error)))? {
            Found::Job(job) => {
                let body = json!({ "id": job.id, "state": job.state.as_str() });
                return Ok((StatusCode::CREATED, Json(body)).into_response());
            }
            Found::Rejected(reason) => return Err(Refused::new(StatusCode::UNPROCESSABLE_ENTITY, reason)),
            Found::Nothing if begun.elapsed() > VERDICT_WITHIN => {
                let message =
                    "handed in, and not read yet: others are before it, or celld waits for the robot";
                let body = json!({ "id": handed.id, "state": "unread", "message": message });
                return Ok((StatusCode::ACCEPTED, Json(body)).into_response());
            }
            Found::Nothing => std::thread::sleep(LOOK_EVERY),
        }
    }
}

/// Plans for a job that is not submitted.
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn preview(
    State(app): State<App>,
    body: Result<Json<JobText>, JsonRejection>,
) -> Result<Response, Refused> {
    let Json(JobText { text, .. }) = body.map_err(|error| unreadable(&error))?;
    let Ok(place) = app.planning.clone().try_acquire_owned() else {
        return Err(Refused::new(
            StatusCode::TOO_MANY_REQUESTS,
            "another preview is being planned; try again",
        ));
    };
    let answer = beside(move || {
        let _place = place;
        planned(&app, &text)
    });
    Ok(Json(answer.await??).into_response())
}

fn planned(app: &Shared, text: &str) -> Result<Value, Refused> {
    let conflict = |message: &str| Refused::new(StatusCode::CONFLICT, message);
    let known =
        app.feed.cell().ok_or_else(|| conflict("celld waits for the robot; there is no preview yet"))?;
    let sight = app
        .feed
        .last_sight()
        .ok_or_else(|| conflict("the table was not seen yet; press Look at the table, or submit the job"))?;
    let spec = read(app, text)?;
    let order = job_order(&app.cell, "draft", &spec, &spec.goal, &[])
        .map_err(|message| Refused::new(StatusCode::UNPROCESSABLE_ENTITY, message))?;
    if let Some(object) = app.feed.carried().first() {
        let message =
            format!("{} was carried since the table was seen: where it lies now is not measured", object.id);
        return Err(Refused::new(StatusCode::CONFLICT, message).with(
            "not_seen".to_string(),
            "press Look at the table, or submit: the cell looks first".into(),
        ));
    }
    let started = Instant::now();
    let limit = order.time_limit.min(DRAFT_WITHIN);
    let over = |attempt: u32| started.elapsed() >= limit * (attempt + 1);
    let age = Duration::from_secs_f64((unix_now_s() - sight.unix_s).max(0.0));
    let last = Glimpse { seen: &sight.seen, whole: sight.whole, age };
    let made = draft(known.model.clone(), &order, last, &over, &|| started.elapsed().as_secs_f64());
    let Draft { plan, goals, rejection } = made.map_err(|NoDraft { code, message, hint }| {
        Refused::new(StatusCode::CONFLICT, message).with(code.to_string(), hint)
    })?;
    let plan = plan_files::record_of(&plan, unix_now_s());
    let rejection = rejection.map(
        |rejection| json!({ "code": rejection.code, "message": rejection.message, "hint": rejection.hint }),
    );
    Ok(json!({
        "plan": plan, "buffers": plan.buffers(), "summary": plan.summary(), "goals": poses(&goals), "doubt": rejection,
    }))
}

/// `POST /api/v1/goals/check`
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drafted {
    objects: Vec<GoalPose>,
    /// The one that was dropped last: where would it lie free?
    #[serde(default)]
    moved: Option<String>,
}

/// What is wrong with goals.
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn check(
    State(app): State<App>,
    body: Result<Json<Drafted>, JsonRejection>,
) -> Result<Response, Refused> {
    let Json(Drafted { objects, moved }) = body.map_err(|error| unreadable(&error))?;
    let sound = |goal: &GoalPose| [goal.pose.x, goal.pose.y, goal.pose.theta].iter().all(|v| v.abs() < 1e3);
    if objects.len() > drafts::MOST || !objects.iter().all(sound) {
        return Err(Refused::new(
            StatusCode::UNPROCESSABLE_ENTITY,
            "too many objects, or one far off the table",
        ));
    }
    let body = beside(move || {
        let free = moved.and_then(|moved| settled(&app.cell, &objects, &moved));
        json!({ "troubles": goal_faults(&app.cell, &objects), "free": free })
    });
    Ok(Json(body.await?).into_response())
}

/// `GET /api/v1/goals`
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn goals(State(app): State<App>) -> Result<Response, Refused> {
    let names = beside(move || {
        let entries = std::fs::read_dir(&app.cell.goal_folder).into_iter().flatten().flatten();
        let name = |entry: std::fs::DirEntry| entry.file_name().into_string().ok();
        let is_goal = |name: &String| {
            let path = app.cell.goal_folder.join(name);
            path.is_file() && goal_of(&app, name).is_ok()
        };
        let mut names: Vec<String> = entries.filter_map(name).filter(is_goal).take(1000).collect();
        names.sort();
        names
    });
    Ok(Json(names.await?).into_response())
}

/// Whether a file may be read or written as a goal. The goal folder may be that of the configuration, where
/// keys and settings lie too; what is wrong with a file is said with its words, so others are not opened.
fn is_goal_name(name: &str) -> bool {
    is_plain_name(name) && name.ends_with(".yaml")
}

fn goal_of(app: &Shared, name: &str) -> Result<Vec<GoalPose>, String> {
    if !is_goal_name(name) {
        return Err("a goal file is called by letters, digits, - and _, and ends in .yaml".to_string());
    }
    let text = read_goal_file(&app.cell.goal_folder, name)?;
    let entries = parse_goal_file(&text, name, None).map_err(|_| format!("{name} is no goal file"))?;
    Ok(entries.into_iter().filter_map(GoalEntry::into_goal).collect())
}

/// `GET /api/v1/goals/{name}`
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn goal(State(app): State<App>, Path(name): Path<String>) -> Result<Response, Refused> {
    let found = beside(move || goal_of(&app, &name)).await?;
    let objects = found.map_err(|reason| Refused::new(StatusCode::NOT_FOUND, reason))?;
    Ok(Json(json!({ "objects": objects })).into_response())
}

/// `PUT /api/v1/goals/{name}`
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalFile {
    objects: Vec<GoalPose>,
    /// Also where there is one of that name.
    #[serde(default)]
    replace: bool,
}

/// Saves a goal file that a job can name.
///
/// # Errors
/// The refusal, as the API answers it.
pub async fn save_goal(
    State(app): State<App>,
    Extension(person): Extension<Person>,
    Path(name): Path<String>,
    body: Result<Json<GoalFile>, JsonRejection>,
) -> Result<Response, Refused> {
    let Json(GoalFile { objects, replace }) = body.map_err(|error| unreadable(&error))?;
    if !is_goal_name(&name) {
        let message = "a goal file is called by letters, digits, - and _, and ends in .yaml";
        return Err(Refused::new(StatusCode::UNPROCESSABLE_ENTITY, message));
    }
    let by = person.grant.name;
    let saved = beside(move || -> Result<Response, Refused> {
        let text = goal_yaml(&objects);
        let obstacles = app.cell.obstacles();
        if let Err(complaints) = parse_goal_file(&text, &name, Some(&app.cell.goal_context(&obstacles))) {
            return Err(Refused::new(StatusCode::UNPROCESSABLE_ENTITY, complaints.to_string()));
        }
        let path = app.cell.goal_folder.join(&name);
        if path.exists() && goal_of(&app, &name).is_err() {
            return Err(Refused::new(StatusCode::CONFLICT, format!("{name} is there, and no goal file")));
        }
        let written = match replace {
            true => write_atomic(&path, text.as_bytes()).map(|()| true),
            false if path.exists() => Ok(false),
            false => {
                let one = std::iter::once(name.clone());
                write_new(&app.cell.goal_folder, one, text.as_bytes()).map(|_| true)
            }
        };
        match written {
            Ok(true) => {
                tracing::info!(goal = name, by, "goal file saved at the page");
                Ok((StatusCode::CREATED, Json(json!({ "name": name }))).into_response())
            }
            Ok(false) => {
                Err(Refused::new(StatusCode::CONFLICT, format!("there is a goal file {name} already")))
            }
            Err(error) => Err(Refused::new(StatusCode::INSUFFICIENT_STORAGE, chain(&error))),
        }
    });
    saved.await?
}

/// The text of a goal file.
fn goal_yaml(objects: &[GoalPose]) -> String {
    let mut text = "version: 1\nobjects:\n".to_string();
    for GoalPose { id, pose } in objects {
        let _ = writeln!(
            text,
            "  - {{id: {}, pose: [{:.5}, {:.5}, {:.5}]}}",
            quoted(id),
            pose.x,
            pose.y,
            pose.theta
        );
    }
    text
}
