//! What the cell is and does now: single values, and all of them as they change.
//!
//! In: the feed. Out: JSON, pictures, a stream of events. A stream begins with the last of everything, so
//! that a viewer that comes late or comes back knows all; its beat says that it still does.

use crate::daemon::plan_files;
use crate::jobs::status::STARTING;
use crate::page::access::Person;
use crate::page::connections::{IsStream, Seat};
use crate::page::control::Holder;
use crate::page::feed::Message;
use crate::page::guard::{refusal, secret};
use crate::page::shared::{App, Shared};
use crate::page::views;
use axum::body::Bytes;
use axum::extract::{Extension, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{Event, Sse};
use axum::response::{IntoResponse, Json, Response};
use cell_edge::clock::boot_now_s;
use futures_util::stream::{self, Stream};
use serde::Serialize;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::broadcast;

/// How often a stream shows that it lives.
const BEAT_EVERY: Duration = Duration::from_millis(500);

/// Of JPEG, for pictures that are looked at.
const QUALITY: u8 = 80;

/// `GET /livez`
pub async fn alive() -> &'static str {
    "alive\n"
}

/// `GET /api/v1/openapi.json`
pub async fn document(State(app): State<App>) -> Response {
    Json(&app.document).into_response()
}

/// `GET /readyz`
pub async fn ready(State(app): State<App>) -> Response {
    let status = app.feed.last_status();
    let reason = match status.as_deref() {
        None => "celld is starting".to_string(),
        Some(status) if status.state == STARTING => status.message.clone(),
        Some(_) if !app.feed.is_of_now() => "the state is old: celld or its disk is slow".to_string(),
        Some(status) => match status.devices.iter().find(|device| !device.ready) {
            Some(device) => format!("{}: {}", device.name, device.message),
            None => return "ready\n".into_response(),
        },
    };
    (StatusCode::SERVICE_UNAVAILABLE, format!("{reason}\n")).into_response()
}

/// `GET /api/v1/cell`
pub async fn cell(State(app): State<App>) -> Response {
    let known = app.feed.cell();
    let bodies = known.as_ref().map(|cell| &cell.model.arm.bodies);
    Json(views::cell_view(&app.cell, &app.config_name, bodies)).into_response()
}

fn value<T: Serialize>(value: Option<T>, missing: &str) -> Response {
    match value {
        Some(value) => Json(value).into_response(),
        None => refusal(StatusCode::NOT_FOUND, missing),
    }
}

/// `GET /api/v1/status`
pub async fn status(State(app): State<App>) -> Response {
    value(app.feed.last_status().as_deref(), "celld is starting")
}

/// `GET /api/v1/arm`
pub async fn arm(State(app): State<App>) -> Response {
    value(app.feed.last_arm(), "the robot has not answered yet")
}

/// `GET /api/v1/sight`
pub async fn sight(State(app): State<App>) -> Response {
    value(app.feed.last_sight_view(), "the table was not seen since celld was started")
}

/// `GET /api/v1/sentences`
pub async fn sentences(State(app): State<App>) -> Response {
    Json(app.feed.sentences()).into_response()
}

/// `GET /api/v1/trends`
pub async fn trends(State(app): State<App>) -> Response {
    Json(app.feed.trends()).into_response()
}

/// `GET /api/v1/picture.jpg`
pub async fn picture(State(app): State<App>) -> Response {
    // The number first: a picture that comes in between is then encoded anew under its own.
    let number = app.feed.picture_number();
    let kept = app.feed.cell().and_then(|cell| cell.pictures.latest());
    let Some(kept) = kept else { return refusal(StatusCode::NOT_FOUND, "there is no picture yet") };
    if let Some(jpeg) = app.feed.encoded(number) {
        return jpeg_of(jpeg);
    }
    match tokio::task::spawn_blocking(move || kept.image.encode_jpeg(QUALITY)).await {
        Ok(Ok(jpeg)) => jpeg_of(app.feed.keep_encoded(number, jpeg.into())),
        Ok(Err(error)) => refusal(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()),
        Err(_) => refusal(StatusCode::INTERNAL_SERVER_ERROR, "the picture could not be encoded"),
    }
}

fn jpeg_of(bytes: Bytes) -> Response {
    ([(CONTENT_TYPE, "image/jpeg")], bytes).into_response()
}

/// `GET /api/v1/picture`
pub async fn picture_view(State(app): State<App>) -> Response {
    let Some(known) = app.feed.cell() else {
        return refusal(StatusCode::NOT_FOUND, "the robot is not known yet");
    };
    let Some(kept) = known.pictures.latest() else {
        return refusal(StatusCode::NOT_FOUND, "there is no picture yet");
    };
    let (seen, status) = (app.feed.last_sight(), app.feed.last_status());
    let plan = status.as_ref().and_then(|status| status.plan.as_ref());
    // What was measured before the picture was taken may lie elsewhere in it. A plan is as it was made.
    let seen = seen.as_ref().filter(|sight| sight.unix_s >= kept.unix_s).map(|sight| &*sight.seen);
    let number = app.feed.picture_number();
    Json(views::picture_view(number, &kept, &known.lens.model, &app.cell, seen, plan)).into_response()
}

/// `GET /api/v1/plan.svg`
pub async fn plan_svg(State(app): State<App>) -> Response {
    let status = app.feed.last_status();
    let plan = status.as_ref().and_then(|status| status.plan.as_ref());
    let drawn = plan.and_then(|plan| plan_files::drawing(plan, &app.cell, "the present plan"));
    match drawn {
        Some(svg) => ([(CONTENT_TYPE, "image/svg+xml")], svg).into_response(),
        None => refusal(StatusCode::NOT_FOUND, "there is no plan"),
    }
}

/// A viewer's stream.
struct Viewer {
    app: App,
    session: String,
    secret: String,
    messages: broadcast::Receiver<Arc<Message>>,
    first: VecDeque<Message>,
    /// Who has control, as it was shown last.
    holder: Option<Holder>,
    beat: tokio::time::Interval,
    _seat: Seat,
}

impl Viewer {
    /// The next event; `None` ends the stream of a viewer that fell behind.
    async fn next(mut self) -> Option<(Result<Event, Infallible>, Viewer)> {
        if let Some(message) = self.first.pop_front() {
            return Some((Ok(event(&message)), self));
        }
        tokio::select! {
            message = self.messages.recv() => match message {
                Ok(message) => Some((Ok(event(&message)), self)),
                Err(broadcast::error::RecvError::Lagged(count)) => {
                    tracing::info!(count, "page: a viewer that did not keep up was dropped");
                    None
                }
                Err(broadcast::error::RecvError::Closed) => None,
            },
            _ = self.beat.tick() => {
                // A session that has ended watches no longer.
                self.app.access().person(&self.secret, boot_now_s())?;
                if !self.app.feed.is_of_now() {
                    let silent = Event::default().event("silent").data("true");
                    return Some((Ok(silent), self));
                }
                let now = Instant::now();
                self.app.control().alive(&self.session, now);
                // Control also lapses, with no order that would show it.
                let holder = self.app.control().holder(now).cloned();
                if holder != self.holder {
                    self.first.extend(message("control", &holder));
                    self.holder = holder;
                }
                let beat = Event::default().event("beat").data(self.app.beat().to_string());
                Some((Ok(beat), self))
            }
        }
    }
}

fn event(message: &Message) -> Event {
    Event::default().event(message.kind).data(&message.json)
}

fn message(kind: &'static str, data: &impl Serialize) -> Option<Message> {
    serde_json::to_string(data).ok().map(|json| Message { kind, json })
}

/// The last of everything, for a viewer that comes: also what there is not, for who comes back may have that
/// of an earlier celld.
fn so_far(app: &Shared, holder: Option<&Holder>) -> VecDeque<Message> {
    let last = [
        message("status", &app.feed.last_status().as_deref()),
        message("arm", &app.feed.last_arm()),
        message("sight", &app.feed.last_sight_view()),
        message("vacuum", &None::<[f64; 2]>),
        message("sentences", &app.feed.sentences()),
        message("control", &holder),
        message("picture", &app.feed.picture_number()),
    ];
    last.into_iter().flatten().collect()
}

/// `GET /api/v1/events`
pub async fn events(
    State(app): State<App>,
    Extension(person): Extension<Person>,
    headers: HeaderMap,
) -> Response {
    let secret = secret(&app, &headers).map(|(secret, _)| secret).unwrap_or_default();
    let seat = match app.event_streams.open(&person.session) {
        Ok(seat) => seat,
        Err(why) => return refusal(StatusCode::SERVICE_UNAVAILABLE, why),
    };
    // Subscribed first: what happens meanwhile comes twice rather than not at all.
    let messages = app.feed.messages();
    let mut beat = tokio::time::interval(BEAT_EVERY);
    beat.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    let holder = app.control().holder(Instant::now()).cloned();
    let (first, session) = (so_far(&app, holder.as_ref()), person.session);
    let viewer = Viewer { app, session, secret, messages, first, holder, beat, _seat: seat };
    let stream: std::pin::Pin<Box<dyn Stream<Item = _> + Send>> =
        Box::pin(stream::unfold(viewer, Viewer::next));
    (Extension(IsStream), Sse::new(stream)).into_response()
}
