//! The Robot API of PolyScope X over HTTP, on the controller's own port 80.
//!
//! In: requests below `/universal-robots/robot-api` ([`crate::robot_api`] decides), in JSON or as a form.
//! Out: JSON. A request that waits for the arm looks at it every few milliseconds; it ends with its client,
//! after a minute, or with the server. Connections, and the size of what is sent, are bounded as at the
//! other HTTP servers; faults act on it under the dashboard's name.

use crate::faults::link::LinkName;
use crate::robot_api::reply::{Outcome, Reply, Request};
use crate::robot_api::{self, BASE};
use crate::robot_server::shared::RobotShared;
use crate::serve::seats::Seats;
use crate::serve::stream::LinkListener;
use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::extract::{DefaultBodyLimit, State};
use axum::http::{HeaderMap, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::{Json, Router};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::time::Instant;

/// Largest body, bytes; programs have about 100 kB.
const BODY_LIMIT: usize = 2 << 20;

/// How often a waiting request looks at the arm, and how long it does at most, wall time.
const LOOK_EVERY: Duration = Duration::from_millis(2);
const WAIT_LIMIT: Duration = Duration::from_secs(60);

/// How long a request under way may take when the server ends: who sends it may have stopped on the way.
const LAST_WORDS: Duration = Duration::from_secs(1);

#[derive(Clone)]
struct Api {
    robot: Arc<RobotShared>,
    stopped: watch::Receiver<bool>,
}

/// Serves clients until `stopped` becomes true, so many at once.
///
/// # Errors
/// The listener failed.
pub async fn serve(
    listener: TcpListener,
    robot: Arc<RobotShared>,
    connections: usize,
    stopped: watch::Receiver<bool>,
) -> std::io::Result<()> {
    let link = robot.links.get(LinkName::Dashboard).clone();
    let router = Router::new()
        .fallback(handle)
        .layer(DefaultBodyLimit::max(BODY_LIMIT))
        .with_state(Api { robot, stopped: stopped.clone() });
    let listener = LinkListener { listener, link, seats: Seats::new(connections) };
    let serving = axum::serve(listener, router).with_graceful_shutdown(until(stopped.clone()));
    tokio::select! {
        served = async { serving.await } => served,
        () = async { until(stopped).await; tokio::time::sleep(LAST_WORDS).await } => Ok(()),
    }
}

/// An error means that the sender is gone, which is an end too.
async fn until(mut stopped: watch::Receiver<bool>) {
    let _ = stopped.wait_for(|stop| *stop).await;
}

async fn handle(
    State(api): State<Api>,
    method: Method,
    uri: Uri,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Response {
    let body = match body {
        Ok(body) => body,
        Err(error) => {
            return respond(Reply::refused(error.status().as_u16(), "Bad body", &error.body_text()));
        }
    };
    let Some(path) = uri.path().strip_prefix(BASE) else {
        return respond(Reply::refused(404, "Not Found", "the Robot API is below /universal-robots"));
    };
    let content_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok());
    let (method, content_type) = (method.as_str(), content_type.unwrap_or_default());
    let request = Request { method, path, content_type, body: &body };
    match robot_api::answer(&api.robot, &request) {
        Outcome::Reply(reply) => respond(reply),
        Outcome::Until(goal) => {
            let begun = Instant::now();
            loop {
                if let Some(reply) = robot_api::reached(&api.robot, goal) {
                    return respond(reply);
                }
                if begun.elapsed() > WAIT_LIMIT || *api.stopped.borrow() {
                    return respond(Reply::refused(504, "Gateway Timeout", "the arm takes too long"));
                }
                tokio::time::sleep(LOOK_EVERY).await;
            }
        }
    }
}

fn respond(reply: Reply) -> Response {
    let status = StatusCode::from_u16(reply.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    let mut response = match reply.file {
        Some((kind, bytes)) => (status, [(header::CONTENT_TYPE, kind)], bytes).into_response(),
        None if status == StatusCode::NO_CONTENT => status.into_response(),
        None => (status, Json(reply.body)).into_response(),
    };
    if let Some(place) = reply.location
        && let Ok(place) = format!("{BASE}{place}").parse()
    {
        response.headers_mut().insert(header::LOCATION, place);
    }
    response
}

#[cfg(test)]
mod tests;
