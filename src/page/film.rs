//! The camera's film: ten pictures a second, encoded once for all who watch.
//!
//! In: pictures of the camera's thread, and those of a calibration round. Out: JPEG parts of one endless
//! answer to each viewer (`multipart/x-mixed-replace`, which every browser shows as a picture). A viewer
//! that is slow gets the newest picture next; one that does not read at all is dropped with its
//! connection. Without viewers no picture is taken; a recording as the camera has no film.

use crate::daemon::film::{Shown, Watching};
use crate::page::access::Person;
use crate::page::calibration::found::Finder;
use crate::page::connections::{IsStream, Seat};
use crate::page::guard::{refusal, secret};
use crate::page::screen::{BOUNDARY, Part};
use crate::page::shared::{App, Shared};
use axum::body::{Body, Bytes};
use axum::extract::{Extension, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use cell_edge::clock::boot_now_s;
use futures_util::stream;
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// How often it is checked whether a viewer is still signed in.
const SIGNED_IN_EVERY: Duration = Duration::from_millis(200);

/// Encodes what arrives, and looks at it for who calibrates, on a thread of its own; ends with the camera's
/// thread and the loop.
pub fn project(app: &Shared, pictures: &Receiver<Shown>) {
    cell_edge::priority::lower();
    let mut finder = Finder::default();
    while let Ok(shown) = pictures.recv() {
        match shown {
            Shown::Picture(image) => {
                let image = Arc::new(image);
                app.screen.show(&image);
                finder.look(app, &image);
                app.film.encoded();
            }
            Shown::Sample { pose, image, sample } => app.calibration().pictured(pose, image, sample),
            Shown::RoundOver(result) => app.calibration().round_over(result),
        }
    }
}

/// A viewer of the film.
struct Viewer {
    app: App,
    secret: String,
    parts: watch::Receiver<Part>,
    requested: Instant,
    _watching: Watching,
    begun: bool,
    _seat: Seat,
}

impl Viewer {
    async fn next(mut self) -> Option<(Result<Bytes, Infallible>, Viewer)> {
        if !std::mem::replace(&mut self.begun, true) {
            return Some((Ok(Bytes::from(format!("--{BOUNDARY}\r\n"))), self));
        }
        loop {
            // Who is not signed in any more watches no longer, also where no picture comes.
            if self.requested.elapsed() >= SIGNED_IN_EVERY {
                self.app.access().person(&self.secret, boot_now_s())?;
                self.requested = Instant::now();
            }
            match tokio::time::timeout(SIGNED_IN_EVERY, self.parts.changed()).await {
                Ok(Ok(())) => {}
                Ok(Err(_)) => return None,
                Err(_) => continue,
            }
            let part = self.parts.borrow_and_update().clone();
            if let Some(part) = part {
                return Some((Ok(part), self));
            }
        }
    }
}

/// `GET /api/v1/film`
pub async fn film(
    State(app): State<App>,
    Extension(person): Extension<Person>,
    headers: HeaderMap,
) -> Response {
    if app.cell.devices.camera.is_recording() {
        return refusal(StatusCode::NOT_FOUND, "the camera is a recording: it has no film");
    }
    let seat = match app.film_streams.open(&person.session) {
        Ok(seat) => seat,
        Err(why) => return refusal(StatusCode::SERVICE_UNAVAILABLE, why),
    };
    let secret = secret(&app, &headers).map(|(secret, _)| secret).unwrap_or_default();
    let (watching, parts) = (app.film.watch(), app.screen.parts());
    let requested = Instant::now();
    let viewer = Viewer { app, secret, parts, requested, _watching: watching, begun: false, _seat: seat };
    let body = Body::from_stream(stream::unfold(viewer, Viewer::next));
    let kind = format!("multipart/x-mixed-replace; boundary={BOUNDARY}");
    (Extension(IsStream), [(CONTENT_TYPE, kind)], body).into_response()
}
