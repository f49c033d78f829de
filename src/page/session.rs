//! Signing in, control, and orders.
//!
//! In: tickets, wishes, orders with the beat that the page had seen last. Out: sessions; each order's
//! answer. What moves the arm takes the role, control, a computer from which people see the cell, and a
//! page that is of now; what stops takes a session alone.

use crate::jobs::command::Command;
use crate::jobs::order_queue::OrderedBy;
use crate::page::access::{Person, Redeemed, SESSION_S, Secrets};
use crate::page::guard::{COOKIE_ALONE, Ends, Peer, Refused, Via, refusal, secret};
use crate::page::shared::{App, Shared};
use axum::body::Bytes;
use axum::extract::rejection::{BytesRejection, JsonRejection};
use axum::extract::{Extension, Json, State};
use axum::http::header::SET_COOKIE;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use cell_edge::clock::{boot_now_s, unix_now_s};
use cell_edge::peer::user_of;
use cell_machine::orders::{Order, Reply, WayBack};
use rearrange::document::chain::chain;
use serde::Deserialize;
use serde_json::json;
use std::net::IpAddr;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// A page that has seen no beat for so long is out of date, ms.
const STALE_MS: u64 = 2500;

/// `POST /api/v1/sign-in`
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ticket {
    ticket: String,
}

fn cookie(app: &Shared, value: &str, seconds: f64) -> [(axum::http::HeaderName, String); 1] {
    let secure = if app.config.tls.is_some() { "; Secure" } else { "" };
    let name = app.cookie_name();
    [(SET_COOKIE, format!("{name}={value}; Path=/; HttpOnly; SameSite=Strict; Max-Age={seconds:.0}{secure}"))]
}

/// A body that is no such JSON.
pub fn unreadable(error: &JsonRejection) -> Refused {
    Refused::new(error.status(), error.body_text())
}

/// A session for a ticket.
pub async fn sign_in(
    State(app): State<App>,
    Extension(Peer(peer)): Extension<Peer>,
    ends: Option<Extension<Ends>>,
    body: Result<Json<Ticket>, JsonRejection>,
) -> Response {
    let Json(Ticket { ticket }) = match body {
        Ok(body) => body,
        Err(error) => return unreadable(&error).into_response(),
    };
    let user = ends.and_then(|Extension(Ends { far, near })| user_of(far, near));
    let redeemed = app.access().redeem(&ticket, user, boot_now_s());
    match redeemed {
        Ok(Redeemed::Session(Secrets { cookie: session, page })) => {
            keep_access(&app);
            tracing::info!(%peer, "page: signed in");
            (cookie(&app, &session, SESSION_S), Json(json!({ "signed_in": true, "page": page })))
                .into_response()
        }
        Ok(Redeemed::Void) => {
            let why = "this link was used already or is too old; `celld open` gives another one";
            no_sign_in(&app, peer, why)
        }
        Ok(Redeemed::OfAnotherUser) => {
            let why = "this link is for the browser of who ran `celld open`; `celld open --print` gives one for \
                       another browser";
            no_sign_in(&app, peer, why)
        }
        Err(error) => refusal(StatusCode::INTERNAL_SERVER_ERROR, format!("no random numbers: {error}")),
    }
}

/// A ticket that does not count.
fn no_sign_in(app: &App, peer: IpAddr, why: &str) -> Response {
    app.limits().refused(&peer.to_string(), Instant::now());
    tracing::warn!(%peer, "page refused: {why}");
    refusal(StatusCode::UNAUTHORIZED, why)
}

/// Ends the session.
pub async fn sign_out(
    State(app): State<App>,
    Extension(person): Extension<Person>,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Response {
    if let Err(error) = body {
        return refusal(error.status(), error.body_text());
    }
    if let Some((secret, _)) = secret(&app, &headers) {
        app.access().end(&secret);
    }
    app.control().give_back(&person.session);
    keep_access(&app);
    (cookie(&app, "", 0.0), Json(json!({ "signed_in": false }))).into_response()
}

/// Grants are kept beside the streams: a disk that stalls holds nothing up.
fn keep_access(app: &App) {
    let app = app.clone();
    tokio::task::spawn_blocking(move || {
        if let Err(error) = app.keep_access() {
            tracing::warn!(error = %chain(&error), "page: who is signed in could not be written down");
        }
    });
}

/// Who is signed in.
pub async fn me(
    State(app): State<App>,
    Extension(person): Extension<Person>,
    Extension(Peer(peer)): Extension<Peer>,
) -> Response {
    let holder = app.control().holder(Instant::now()).cloned();
    // For display: the calendar decides nothing.
    let until_unix_s = unix_now_s() + person.grant.until_boot_s - boot_now_s();
    Json(json!({
        "name": person.grant.name, "role": person.grant.role, "session": person.session,
        "until_unix_s": until_unix_s, "control": holder, "moves": app.config.moves_from(peer),
        "beat": app.beat(),
    }))
    .into_response()
}

/// `POST /api/v1/control`
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wish {
    take: bool,
    #[serde(default)]
    force: bool,
}

/// Takes control or gives it back.
pub async fn control(
    State(app): State<App>,
    Extension(person): Extension<Person>,
    body: Result<Json<Wish>, JsonRejection>,
) -> Response {
    let Json(wish) = match body {
        Ok(body) => body,
        Err(error) => return unreadable(&error).into_response(),
    };
    if !wish.take {
        app.control().give_back(&person.session);
    } else if let Err(held) =
        app.control().take(&person.session, &person.grant.name, wish.force, Instant::now())
    {
        return refusal(StatusCode::CONFLICT, held.to_string());
    }
    tracing::info!(by = person.grant.name, take = wish.take, force = wish.force, "page: control");
    Json(json!({ "control": app.control().holder(Instant::now()) })).into_response()
}

/// `POST /api/v1/orders`
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ordered {
    command: Command,
    /// The last beat that the page had received; programs with a token may leave it out.
    #[serde(default)]
    beat: Option<u64>,
}

/// Carries an order out, or says why not.
pub async fn order(
    State(app): State<App>,
    Extension(person): Extension<Person>,
    Extension(via): Extension<Via>,
    Extension(Peer(peer)): Extension<Peer>,
    body: Result<Json<Ordered>, JsonRejection>,
) -> Response {
    let Json(ordered) = match body {
        Ok(body) => body,
        Err(error) => return unreadable(&error).into_response(),
    };
    let Some(order) = ordered.command.order() else {
        return refusal(StatusCode::BAD_REQUEST, "this is no order to the cell");
    };
    let by = format!("{} ({}) at {peer}", person.grant.name, person.grant.role);
    let giver = Giver { person: &person, via, peer };
    if let Err((status, message)) = may_order(&app, &order, &ordered, &giver) {
        tracing::warn!(?order, by, "order refused by the page: {message}");
        app.orders[1].fetch_add(1, Ordering::Relaxed);
        return match status {
            // Of now, and not of the requester: an answer like the machine's own.
            StatusCode::CONFLICT => Json(Reply::refuse(message)).into_response(),
            status => refusal(status, message),
        };
    }
    let by = OrderedBy { name: by, session: person.session.clone() };
    let reply = app.order_sender.order(order, by).await;
    app.orders[usize::from(!reply.accepted)].fetch_add(1, Ordering::Relaxed);
    Json(reply).into_response()
}

type Reason = (StatusCode, String);

/// Who gives an order, how, and from which computer.
struct Giver<'a> {
    person: &'a Person,
    via: Via,
    peer: std::net::IpAddr,
}

fn may_order(app: &Shared, order: &Order, ordered: &Ordered, giver: &Giver) -> Result<(), Reason> {
    let Giver { person, via, peer } = *giver;
    let least = order.least_role();
    if person.grant.role < least {
        return Err((StatusCode::FORBIDDEN, format!("this order takes the role {}", least.as_str())));
    }
    if order.only_stops() {
        return Ok(());
    }
    if via == Via::CookieAlone {
        return Err((StatusCode::FORBIDDEN, COOKIE_ALONE.to_string()));
    }
    if order.needs_sight() && !app.config.moves_from(peer) {
        let why =
            "this order is given where the cell is seen: on its own computer or one of `page.control_from`";
        return Err((StatusCode::FORBIDDEN, why.to_string()));
    }
    let stale = match ordered.beat {
        Some(beat) => app.beat().saturating_sub(beat) > STALE_MS || beat > app.beat(),
        None => via == Via::Browser,
    };
    let stale = stale || !app.feed.is_of_now();
    if stale {
        return Err((
            StatusCode::CONFLICT,
            "nothing was done: the page shows an old state; load it again".into(),
        ));
    }
    match order {
        // The machine compares the plan's number with that of the plan that waits.
        Order::Approve { .. } | Order::Reject(_) => return Ok(()),
        // It shows how things are, and changes nothing: whoever may look may request it, as often as other
        // things are looked at.
        Order::Recover(WayBack::Show) if !app.limits().request(&person.session, Instant::now()) => {
            return Err((StatusCode::TOO_MANY_REQUESTS, "too many requests; wait a little".into()));
        }
        Order::Recover(WayBack::Show) => return Ok(()),
        Order::Arm
        | Order::Disarm
        | Order::Cancel(_)
        | Order::Pause
        | Order::Resume
        | Order::Step
        | Order::Abort
        | Order::Park
        | Order::Release(_)
        | Order::Recover(_)
        | Order::ConfirmGripper
        | Order::Calibrate => {}
    }
    let taken = app.control().take(&person.session, &person.grant.name, false, Instant::now());
    taken.map_err(|held| (StatusCode::CONFLICT, held.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::load::load_cell;
    use crate::daemon::film::Film;
    use crate::daemon::gripper_memory::GripperMemory;
    use crate::jobs::state::StateFolder;
    use crate::page::access::Grant;
    use crate::page::feed::Feed;
    use crate::page::orders::order_channel;
    use crate::page::shared::Setup;
    use crate::page::texts::Texts;
    use cell_machine::orders::{Channels, Role};
    use std::path::Path;

    /// A page that no loop feeds: of an old state.
    fn page(control_from: &str) -> (tempfile::TempDir, Shared) {
        let cell = load_cell(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml")).unwrap();
        let mut config = cell.page.clone().expect("the example has a page");
        config.control_from = vec![control_from.parse().unwrap()];
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        let (order_sender, _) = order_channel(GripperMemory::new(&state, String::new()));
        let (film, pictures) = Film::new();
        let setup = Setup {
            page: &config,
            cell: &cell,
            config_name: String::new(),
            state,
            feed: Feed::default(),
            order_sender,
            film,
            pictures,
            texts: Texts::read(&[]).unwrap(),
        };
        let (shared, _) = Shared::new(config.clone(), setup, json!({}));
        (folder, shared)
    }

    /// Whatever role, token and state of the page: where the cell is not seen, no order sets the arm in
    /// motion or lets something fall, and a stop stops.
    #[test]
    fn from_a_computer_that_does_not_see_the_cell_only_stops_and_plans_are_ordered() {
        let (_folder, app) = page("192.0.2.7");
        let grant = Grant { name: "anna".into(), role: Role::Engineer, until_boot_s: f64::MAX };
        let person = Person { grant, session: "1".into() };
        let id = || "a".to_string();
        let orders = [
            (Order::Arm, true),
            (Order::Resume, true),
            (Order::Step, true),
            (Order::Park, true),
            (Order::Release(Channels::Both), true),
            (Order::Recover(WayBack::Release), true),
            (Order::Recover(WayBack::Show), false),
            (Order::ConfirmGripper, true),
            (Order::Calibrate, true),
            (Order::Approve { id: id(), plan: 1 }, false),
            (Order::Reject(id()), false),
            (Order::Cancel(id()), false),
            (Order::Disarm, false),
            (Order::Pause, false),
            (Order::Abort, false),
        ];
        for (order, moves) in orders {
            for (from, sees) in [("192.0.2.9", false), ("192.0.2.7", true), ("127.0.0.1", true)] {
                for (via, beat) in [
                    (Via::Browser, Some(0)),
                    (Via::Browser, None),
                    (Via::CookieAlone, Some(0)),
                    (Via::Token, None),
                ] {
                    let ordered = Ordered { command: Command::Abort, beat };
                    let giver = Giver { person: &person, via, peer: from.parse().unwrap() };
                    let status = may_order(&app, &order, &ordered, &giver).map_err(|(status, _)| status);
                    let expected = match (order.only_stops(), moves && !sees, via) {
                        (true, ..) | (_, false, Via::Token) => Ok(()),
                        (false, true, _) => Err(StatusCode::FORBIDDEN),
                        // The state that the browser shows is old.
                        (false, false, Via::Browser) => Err(StatusCode::CONFLICT),
                        (false, false, Via::CookieAlone) => Err(StatusCode::FORBIDDEN),
                    };
                    assert_eq!(status, expected, "{order:?} from {from} via {via:?}");
                }
            }
        }
    }
}
