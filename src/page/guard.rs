//! Before any handler: is the page called by its own name, does a page of its own call, who is it, how
//! often.
//!
//! In: requests. Out: requests with the [`Person`] who sends them, or refusals: 421 for a foreign name, 403
//! for a foreign page or a role that is too low, 401 without a session, 429 too often, 408 too slow. What is
//! refused is logged with its path and without its secrets.

use crate::page::access::Person;
use crate::page::connections::Place;
use crate::page::limits::{host_is_ours, origin_is_ours};
use crate::page::shared::App;
use axum::Json;
use axum::body::Body;
use axum::extract::{ConnectInfo, Request, State};
use axum::http::header::{
    AUTHORIZATION, CACHE_CONTROL, CONTENT_SECURITY_POLICY, COOKIE, HOST, HeaderValue, ORIGIN,
    REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use axum::http::{HeaderMap, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use cell_edge::clock::boot_now_s;
use cell_machine::orders::Role;
use serde_json::json;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::{Duration, Instant};

/// A request is answered within this time, or begins to be: a plan may take most of it.
const ANSWER_WITHIN: Duration = Duration::from_secs(60);

/// A body comes within this time.
const BODY_WITHIN: Duration = Duration::from_secs(10);

/// Largest body that is read: a goal of a thousand objects.
const BODY_MAX: usize = 512 * 1024;

/// Scripts and styles from here alone, pictures also as data, nothing in frames of others.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; \
                      connect-src 'self'; font-src 'self'; manifest-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";

/// The header with the secret of the page.
pub const PAGE_SECRET: &str = "x-celld-page";

/// The refusal of a request that has the cookie but not the secret of the page.
pub const COOKIE_ALONE: &str =
    "this browser is not signed in completely; `celld open` on the cell's computer signs it in again";

/// How a person came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Via {
    /// A browser, with its cookie and the secret of the page.
    Browser,
    /// A browser's cookie without the secret of the page. Browsers send cookies to every port of a computer,
    /// so another program there may have it.
    CookieAlone,
    /// A program, with its token.
    Token,
}

/// Where a request comes from.
#[derive(Clone, Copy, Debug)]
pub struct Peer(pub IpAddr);

/// Both ends of the connection that a request comes over, as the kernel has them.
#[derive(Clone, Copy, Debug)]
pub struct Ends {
    /// The browser's.
    pub far: SocketAddr,
    /// Ours.
    pub near: SocketAddr,
}

/// Why a request is not carried out, as the page answers it.
#[derive(Debug)]
pub struct Refused {
    status: StatusCode,
    /// One sentence.
    error: String,
    /// A word for programs and what to do, where there are.
    advice: Option<(String, String)>,
}

impl Refused {
    /// With a status and one sentence.
    pub fn new(status: StatusCode, error: impl Into<String>) -> Refused {
        Refused { status, error: error.into(), advice: None }
    }

    /// With a word for programs, and what a person can do.
    pub fn with(self, code: String, hint: String) -> Refused {
        Refused { advice: Some((code, hint)), ..self }
    }

    /// Something of celld's own does not work.
    pub fn fault(error: impl std::fmt::Display) -> Refused {
        Refused::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string())
    }
}

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        let body = match self.advice {
            Some((code, hint)) => json!({ "error": self.error, "code": code, "hint": hint }),
            None => json!({ "error": self.error }),
        };
        (self.status, Json(body)).into_response()
    }
}

/// A refusal: status and one sentence.
pub fn refusal(status: StatusCode, message: impl Into<String>) -> Response {
    Refused::new(status, message).into_response()
}

/// Logs a refusal and makes it.
fn refuse(request: &Request, status: StatusCode, message: &str) -> Response {
    let (method, path) = (request.method(), request.uri().path());
    tracing::warn!(peer = %peer(request), %method, path, "page refused: {message}");
    refusal(status, message)
}

fn peer(request: &Request) -> IpAddr {
    let info = request.extensions().get::<ConnectInfo<SocketAddr>>();
    info.map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |info| info.0.ip().to_canonical())
}

/// Every request passes here first.
pub async fn every_request(State(app): State<App>, mut request: Request, next: Next) -> Response {
    let from = peer(&request);
    request.extensions_mut().insert(Peer(from));
    let mut response = match unfit(&app, &request) {
        Some(response) => response,
        None => {
            let path = request.uri().path().to_string();
            match tokio::time::timeout(ANSWER_WITHIN, answered(request, next)).await {
                Ok(response) => response,
                Err(_) => {
                    tracing::warn!(peer = %from, path, "page refused: too slow");
                    refusal(StatusCode::REQUEST_TIMEOUT, "the request took too long")
                }
            }
        }
    };
    harden(response.headers_mut());
    response
}

/// What every answer says to the browser: scripts and frames of others have no place here.
pub fn harden(headers: &mut HeaderMap) {
    // A report brings its own styles.
    headers.entry(CONTENT_SECURITY_POLICY).or_insert(HeaderValue::from_static(POLICY));
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(X_FRAME_OPTIONS, HeaderValue::from_static("DENY"));
    headers.insert(REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.entry(CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
}

/// The answer once the body is there; one that does not come is not waited for.
async fn answered(request: Request, next: Next) -> Response {
    let (parts, body) = request.into_parts();
    match tokio::time::timeout(BODY_WITHIN, axum::body::to_bytes(body, BODY_MAX)).await {
        Ok(Ok(bytes)) => {
            if let Some(place) = parts.extensions.get::<Place>() {
                place.serves();
            }
            next.run(Request::from_parts(parts, Body::from(bytes))).await
        }
        Ok(Err(_)) => refusal(StatusCode::PAYLOAD_TOO_LARGE, "the body is too large, or ended early"),
        Err(_) => refusal(StatusCode::REQUEST_TIMEOUT, "the body did not come"),
    }
}

/// Why a request is not looked at.
fn unfit(app: &App, request: &Request) -> Option<Response> {
    let (headers, now) = (request.headers(), Instant::now());
    let host = text(headers.get(HOST)).unwrap_or_default();
    let person = person(app, headers);
    let source = match &person {
        Some((person, _)) => person.session.clone(),
        None => peer(request).to_string(),
    };
    let is_order = person.is_some() && request.uri().path() == "/api/v1/orders";
    let place = request.extensions().get::<Place>();
    let has_room =
        place.zip(person.as_ref()).is_none_or(|(place, (person, _))| place.signed_in(&person.session));
    if !is_order && !has_room {
        let why = "too many requests of this session at a time; wait a little";
        return Some(refusal(StatusCode::SERVICE_UNAVAILABLE, why));
    }
    if !is_order && !app.limits().request(&source, now) {
        // Not logged: there may be thousands.
        return Some(refusal(StatusCode::TOO_MANY_REQUESTS, "too many requests; wait a little"));
    }
    let refused = |status, message: &str| {
        if person.is_none() {
            app.limits().refused(&source, now);
        }
        Some(refuse(request, status, message))
    };
    if !host_is_ours(&app.config, host) {
        return refused(
            StatusCode::MISDIRECTED_REQUEST,
            "this is no name of this cell's page (`page.hosts`)",
        );
    }
    match text(headers.get(ORIGIN)) {
        Some(origin) if !origin_is_ours(&app.config, origin, host) => {
            return refused(StatusCode::FORBIDDEN, "the request comes from another page");
        }
        // Browsers name the origin of whatever changes something; programs have a token.
        None if !reads(request.method()) && text(headers.get(AUTHORIZATION)).is_none() => {
            return refused(StatusCode::FORBIDDEN, "the request does not say from which page it comes");
        }
        Some(_) | None => {}
    }
    None
}

fn reads(method: &Method) -> bool {
    *method == Method::GET || *method == Method::HEAD
}

fn text(value: Option<&HeaderValue>) -> Option<&str> {
    value.and_then(|value| value.to_str().ok())
}

/// The secret that comes with a request.
pub fn secret(app: &App, headers: &HeaderMap) -> Option<(String, Via)> {
    if let Some(token) = text(headers.get(AUTHORIZATION)).and_then(|value| value.strip_prefix("Bearer ")) {
        return Some((token.trim().to_string(), Via::Token));
    }
    let wanted = app.cookie_name();
    let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
    let mut pairs = cookies.flat_map(|line| line.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.find(|(name, _)| *name == wanted).map(|(_, value)| (value.to_string(), Via::Browser))
}

/// Who sends a request.
pub fn person(app: &App, headers: &HeaderMap) -> Option<(Person, Via)> {
    let (secret, via) = secret(app, headers)?;
    let access = app.access();
    let person = access.person(&secret, boot_now_s())?;
    let page = text(headers.get(PAGE_SECRET)).unwrap_or_default();
    // A browser's secret is no token, whatever header it comes in; a token in a cookie is no secret.
    let via = match access.is_of_page(&secret, page) {
        Some(true) => Via::Browser,
        None if via == Via::Token => Via::Token,
        Some(false) | None => Via::CookieAlone,
    };
    Some((person, via))
}

/// Lets people with at least this role through.
pub async fn with_role(
    State((app, least)): State<(App, Role)>,
    mut request: Request<Body>,
    next: Next,
) -> Response {
    let Some((person, via)) = person(&app, request.headers()) else {
        app.limits().refused(&peer(&request).to_string(), Instant::now());
        return refuse(
            &request,
            StatusCode::UNAUTHORIZED,
            "sign in first: `celld open` on the cell's computer",
        );
    };
    if person.grant.role < least {
        let (least, has) = (least.as_str(), person.grant.role.as_str());
        let message = format!("this takes the role {least}; yours is {has}");
        return refuse(&request, StatusCode::FORBIDDEN, &message);
    }
    // The handler of orders lets stops through.
    let may_stop = request.uri().path() == "/api/v1/orders";
    if via == Via::CookieAlone && !reads(request.method()) && !may_stop {
        return refuse(&request, StatusCode::FORBIDDEN, COOKIE_ALONE);
    }
    request.extensions_mut().insert(person);
    request.extensions_mut().insert(via);
    next.run(request).await
}
