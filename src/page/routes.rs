//! Every address of the page and its API, with the least role and what it is for: one table, from which both
//! the router and the OpenAPI document are made, so that neither knows what the other does not.

use crate::page::calibration::steps;
use crate::page::shared::App;
use crate::page::{again, assets, film, guard, live, markers, metrics, records, session, shift, work};
use axum::Router;
use axum::extract::{DefaultBodyLimit, Path, State};
use axum::handler::Handler;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{HeaderMap, StatusCode};
use axum::middleware::{from_fn_with_state, map_response};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodFilter, on};
use cell_machine::orders::Role;

/// One address of the API.
#[derive(Clone, Copy, Debug)]
pub struct Route {
    /// `GET`, `POST` or `PUT`.
    pub method: &'static str,
    /// With `{name}` for what varies.
    pub path: &'static str,
    /// Least role; `None`: without a session.
    pub least: Option<Role>,
    /// What it is for, one line.
    pub summary: &'static str,
    /// Schema of the body it takes, by name in the OpenAPI document.
    pub body: Option<&'static str>,
    /// What it answers with.
    pub answer: &'static str,
}

/// Routes while they are collected.
struct Routes {
    app: Option<App>,
    router: Router<App>,
    table: Vec<Route>,
}

impl Routes {
    fn add<H, T>(&mut self, route: Route, handler: H)
    where
        H: Handler<T, App>,
        T: 'static,
    {
        self.table.push(route);
        let Some(app) = &self.app else { return };
        let method = match route.method {
            "POST" => MethodFilter::POST,
            "PUT" => MethodFilter::PUT,
            _ => MethodFilter::GET,
        };
        let mut served = on(method, handler);
        if let Some(least) = route.least {
            served = served.route_layer(from_fn_with_state((app.clone(), least), guard::with_role));
        }
        let router = std::mem::take(&mut self.router);
        self.router = router.route(route.path, served);
    }
}

const JSON: &str = "application/json";

const fn get(path: &'static str, least: Role, summary: &'static str) -> Route {
    Route { method: "GET", path, least: Some(least), summary, body: None, answer: JSON }
}

const fn post(path: &'static str, least: Role, summary: &'static str, body: &'static str) -> Route {
    Route { method: "POST", path, least: Some(least), summary, body: Some(body), answer: JSON }
}

const fn answers(route: Route, answer: &'static str) -> Route {
    Route { answer, ..route }
}

const fn open(route: Route) -> Route {
    Route { least: None, ..route }
}

/// What answers where.
fn all(app: Option<App>) -> Routes {
    use Role::View;
    let mut r = Routes { app, router: Router::new(), table: Vec::new() };
    r.add(answers(open(get("/livez", View, "The process runs")), "text/plain"), live::alive);
    r.add(
        answers(open(get("/readyz", View, "The cell takes orders; else 503 with the reason")), "text/plain"),
        live::ready,
    );
    r.add(answers(get("/metrics", View, "Counts and states for Prometheus"), "text/plain"), metrics::metrics);
    r.add(open(get("/api/v1/openapi.json", View, "This document")), live::document);
    session_routes(&mut r);
    r.add(
        get("/api/v1/cell", View, "Table, catalogue, bodies: what does not change while celld runs"),
        live::cell,
    );
    r.add(get("/api/v1/status", View, "The status as in status.json (docs/files.md)"), live::status);
    r.add(get("/api/v1/arm", View, "The arm's last state"), live::arm);
    r.add(get("/api/v1/sight", View, "The table as it was seen last"), live::sight);
    r.add(get("/api/v1/sentences", View, "What was said lately, the newest last"), live::sentences);
    r.add(
        get("/api/v1/trends", View, "Reference residual and vacuum over the last looks and grips"),
        live::trends,
    );
    r.add(
        answers(get("/api/v1/events", View, "Everything above as it changes"), "text/event-stream"),
        live::events,
    );
    picture_routes(&mut r);
    calibration_routes(&mut r);
    job_routes(&mut r);
    goal_routes(&mut r);
    r
}

fn picture_routes(r: &mut Routes) {
    use Role::View;
    r.add(
        answers(get("/api/v1/picture.jpg", View, "The camera's last picture"), "image/jpeg"),
        live::picture,
    );
    r.add(
        answers(
            get("/api/v1/film", View, "The camera's pictures as they come, ten a second"),
            "multipart/x-mixed-replace",
        ),
        film::film,
    );
    r.add(get("/api/v1/picture", View, "What is drawn over the last picture, pixels"), live::picture_view);
    r.add(
        answers(get("/api/v1/plan.svg", View, "The present plan on the table"), "image/svg+xml"),
        live::plan_svg,
    );
    r.add(
        answers(
            get("/api/v1/markers.pdf", View, "Markers for the printer (ids, size_mm, paper)"),
            "application/pdf",
        ),
        markers::markers,
    );
}

fn calibration_routes(r: &mut Routes) {
    use Role::{Engineer, View};
    r.add(
        get("/api/v1/calibration", View, "What was measured of camera and table, and what it leaves open"),
        steps::state,
    );
    r.add(
        post(
            "/api/v1/calibration",
            Engineer,
            "A step of a calibration; none moves the arm (the order `calibrate` does)",
            "Calibration",
        ),
        steps::step,
    );
    r.add(
        answers(
            get("/api/v1/calibration/pictures/{name}", View, "lens-N or round-N: what was found in it"),
            "image/jpeg",
        ),
        steps::picture,
    );
}

fn job_routes(r: &mut Routes) {
    use Role::{Operate, View};
    r.add(get("/api/v1/jobs", View, "Jobs, the newest first (last, failed, since, object)"), work::jobs);
    r.add(
        post("/api/v1/jobs", Operate, "Submit a job; 422 with the reason where it is refused", "JobText"),
        work::submit,
    );
    r.add(
        Route {
            method: "POST",
            ..get("/api/v1/jobs/{id}/again", Operate, "Submit the goal of a job again, as a job of its own")
        },
        again::again,
    );
    r.add(get("/api/v1/jobs/{id}", View, "A job with its story, plan, steps and result"), work::job);
    r.add(
        answers(
            get("/api/v1/jobs/{id}/report", View, "The job as one page (theme: light or dark)"),
            "text/html",
        ),
        records::report,
    );
    r.add(
        answers(
            get(
                "/api/v1/jobs/{id}/playback",
                View,
                "What was recorded of the job, at any time of it (theme: light or dark)",
            ),
            "text/html",
        ),
        records::playback,
    );
    r.add(
        answers(
            get("/api/v1/jobs/{id}/files/{name}", View, "plan.svg, plan.jpg or end.jpg of a job"),
            "image/*",
        ),
        work::file,
    );
    r.add(get("/api/v1/shift", View, "Counts and throughput since a time (since)"), shift::shift);
}

fn goal_routes(r: &mut Routes) {
    use Role::{Operate, View};
    r.add(
        post(
            "/api/v1/preview",
            View,
            "A plan for a job that is not submitted, from the last sight",
            "JobText",
        ),
        work::preview,
    );
    r.add(
        post(
            "/api/v1/goals/check",
            View,
            "What is wrong with goals; where a dropped object would lie free",
            "Draft",
        ),
        work::check,
    );
    r.add(get("/api/v1/goals", View, "Goal files of the cell"), work::goals);
    r.add(get("/api/v1/goals/{name}", View, "Poses of a goal file"), work::goal);
    r.add(
        Route { method: "PUT", ..post("/api/v1/goals/{name}", Operate, "Save a goal file", "GoalFile") },
        work::save_goal,
    );
}

fn session_routes(r: &mut Routes) {
    use Role::{Operate, View};
    r.add(
        open(post("/api/v1/sign-in", View, "A session for a ticket of `celld open`", "Ticket")),
        session::sign_in,
    );
    r.add(post("/api/v1/sign-out", View, "Ends the session", "Nothing"), session::sign_out);
    r.add(get("/api/v1/me", View, "Who is signed in, with which role, and who has control"), session::me);
    r.add(
        post("/api/v1/control", Operate, "Take control of the cell, or give it back", "Control"),
        session::control,
    );
    r.add(
        post(
            "/api/v1/orders",
            View,
            "An order to the cell; `accepted` says whether it is carried out, `message` why not",
            "Order",
        ),
        session::order,
    );
}

/// The table of all addresses.
pub fn table() -> Vec<Route> {
    all(None).table
}

/// The page and its API.
pub fn router(app: App) -> Router {
    let file = |State(app): State<App>, Path(path): Path<String>, headers: HeaderMap| async move {
        match app.texts.file(&path) {
            Some(text) => ([(CONTENT_TYPE, JSON), (CACHE_CONTROL, "no-cache")], text).into_response(),
            None => assets::asset(&path, &headers),
        }
    };
    let first = |headers: HeaderMap| async move { assets::asset("", &headers) };
    let not_found = |response: Response| async move {
        match response.status() {
            StatusCode::METHOD_NOT_ALLOWED => guard::refusal(StatusCode::METHOD_NOT_ALLOWED, "not that way"),
            _ => response,
        }
    };
    all(Some(app.clone()))
        .router
        .route("/", axum::routing::get(first))
        .route("/{*path}", axum::routing::get(file))
        .layer(map_response(not_found))
        // The guard has read the body, and bounded it.
        .layer(DefaultBodyLimit::disable())
        .layer(from_fn_with_state(app.clone(), guard::every_request))
        .with_state(app)
}
