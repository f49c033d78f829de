//! The connections that have a place, as handlers and the listener see them.
//!
//! In: connections and their requests. Out: a [`Place`] each, which follows what its connection does
//! and ends a connection that is cut; a [`Seat`] for each stream. `places` decides.

use crate::page::places::{Arrival, Doing, Streams, Table, most_connections};
use axum::body::{Body, Bytes};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::Response;
use hyper::body::{Frame, SizeHint};
use std::collections::HashMap;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Instant;
use tokio::sync::Notify;

/// How many connections the page may have now: the limit of handles may change while the process runs.
pub fn most_now() -> usize {
    most_connections(cell_edge::reserve::limit())
}

#[derive(Default)]
struct Open {
    table: Table,
    cuts: HashMap<u64, Arc<Notify>>,
}

impl Open {
    fn end(&mut self, id: u64) {
        if let Some(cut) = self.cuts.remove(&id) {
            cut.notify_one();
        }
    }
}

/// All connections of a page.
#[derive(Clone, Default)]
pub struct Connections(Arc<Mutex<Open>>);

impl Connections {
    fn open(&self) -> MutexGuard<'_, Open> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A place for a connection from this computer; `None` if no place can be given up for it.
    pub fn arrive(&self, computer: IpAddr) -> Option<Place> {
        let mut open = self.open();
        let Arrival::Taken { id, cut } = open.table.arrive(computer, most_now(), Instant::now()) else {
            return None;
        };
        if let Some(cut) = cut {
            open.end(cut);
        }
        let cut = Arc::new(Notify::new());
        open.cuts.insert(id, cut.clone());
        Some(Place(Arc::new(Taken { id, cut, connections: self.clone() })))
    }

    /// Cuts one connection, for a process that is out of handles.
    pub fn cut_one(&self) {
        let mut open = self.open();
        if let Some(cut) = open.table.cut_one(most_now(), Instant::now()) {
            open.end(cut);
        }
    }
}

struct Taken {
    id: u64,
    cut: Arc<Notify>,
    connections: Connections,
}

impl Drop for Taken {
    fn drop(&mut self) {
        let mut open = self.connections.open();
        open.table.leave(self.id);
        open.cuts.remove(&self.id);
    }
}

/// The place of a connection, which ends with its last copy.
#[derive(Clone)]
pub struct Place(Arc<Taken>);

impl Place {
    /// Returns when another connection takes this place.
    pub async fn cut(&self) {
        self.0.cut.notified().await;
    }

    /// The request belongs to a session; false if the session has too many at a time.
    pub fn signed_in(&self, session: &str) -> bool {
        self.0.connections.open().table.signed_in(self.0.id, session, most_now())
    }

    /// The whole request is there.
    pub fn serves(&self) {
        self.turns_to(Doing::Serves);
    }

    fn turns_to(&self, doing: Doing) {
        self.0.connections.open().table.turns_to(self.0.id, doing, Instant::now());
    }
}

/// Marks an answer that is a stream.
#[derive(Clone, Copy)]
pub struct IsStream;

/// Follows each request of a connection.
pub async fn followed(State(place): State<Place>, mut request: Request, next: Next) -> Response {
    place.turns_to(Doing::AwaitsBody);
    request.extensions_mut().insert(place.clone());
    let response = next.run(request).await;
    let is_stream = response.extensions().get::<IsStream>().is_some();
    place.turns_to(if is_stream { Doing::Streams } else { Doing::Answers });
    response.map(|body| Body::new(Sent { body, place }))
}

/// The body of an answer; its connection awaits the next head once it is sent.
struct Sent {
    body: Body,
    place: Place,
}

impl Drop for Sent {
    fn drop(&mut self) {
        self.place.turns_to(Doing::AwaitsHead);
    }
}

impl hyper::body::Body for Sent {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// Places for one kind of stream.
pub struct StreamPlaces(Arc<Mutex<Streams>>);

/// The place of a stream, which ends with it.
pub struct Seat {
    places: Arc<Mutex<Streams>>,
    session: String,
}

impl StreamPlaces {
    /// At most so many percent of all connections, and so many of one session.
    pub fn new(percent: usize, of_session: usize) -> StreamPlaces {
        StreamPlaces(Arc::new(Mutex::new(Streams::new(percent, of_session))))
    }

    /// A place for a stream of this session.
    ///
    /// # Errors
    /// The sentence with which it is refused.
    pub fn open(&self, session: &str) -> Result<Seat, String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).open(session, most_now())?;
        Ok(Seat { places: self.0.clone(), session: session.to_string() })
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.places.lock().unwrap_or_else(PoisonError::into_inner).close(&self.session);
    }
}
