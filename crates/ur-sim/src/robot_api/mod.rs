//! The Robot API, which PolyScope X has in place of the dashboard server, without its sockets.
//!
//! In: requests below `/universal-robots/robot-api`. Out: JSON, at once or when the arm is so far. Which
//! requests there are depends on the software: 10.11 has the first few, 10.12 what reads modes and takes
//! programs, 10.14 popups and versions. Source: the vendor's client library and its tests, and notes of
//! others who have used the vendor's simulator; statuses and texts that no client looks at are assumed.

pub mod form;

pub mod program;

pub mod programs;

pub mod reply;

pub mod state;

pub mod support;

use crate::controller::Controller;
use crate::robot_server::shared::RobotShared;
use reply::{Goal, Outcome, Reply, Request};
use serde_json::{Map, Value, json};

/// Where the API is on its server.
pub const BASE: &str = "/universal-robots/robot-api";

/// Versions of the API by the software that brings them, oldest first: minor version, the API's own (that of
/// 10.11 is assumed).
const VERSIONS: [(u32, &str); 4] = [(11, "1.0.0"), (12, "3.1.4"), (13, "3.1.6"), (14, "5.0.107")];

/// Minor versions of the software that have brought more requests.
const FIRST: u32 = 11;
const MODES: u32 = 12;
const POPUPS: u32 = 14;

/// Method, path and first minor version of every request.
const ROUTES: [(&str, &str, u32); 27] = [
    ("GET", "/openapi.json", FIRST),
    ("PUT", "/robotstate/v1/state", FIRST),
    ("GET", "/robotstate/v1/robotmode", MODES),
    ("GET", "/robotstate/v1/safetymode", MODES),
    ("GET", "/system/v1/controlmode", MODES),
    ("GET", "/system/v1/operationalmode", MODES),
    ("PUT", "/program/v1/load", FIRST),
    ("PUT", "/program/v1/loaded", MODES),
    ("GET", "/program/v1/loaded", MODES),
    ("PUT", "/program/v1/state", FIRST),
    ("GET", "/program/v1/state", FIRST),
    ("GET", "/programs/v1", MODES),
    ("POST", "/programs/v1", MODES),
    ("PUT", "/programs/v1", MODES),
    ("GET", "/programs/v1/{name}", MODES),
    ("POST", "/popup/v1", POPUPS),
    ("DELETE", "/popup/v1", POPUPS),
    ("DELETE", "/popup/v1/safety", POPUPS),
    ("GET", "/versions/v1", POPUPS),
    ("GET", "/system/v1/information", POPUPS),
    ("PUT", "/system/v1/shutdown", POPUPS),
    ("POST", "/system/v1/log", POPUPS),
    ("GET", "/system/v1/system-time", MODES),
    ("POST", "/supportfiles/v1", POPUPS),
    ("GET", "/supportfiles/v1", POPUPS),
    ("PUT", "/operational-mode/v1", POPUPS),
    ("DELETE", "/operational-mode/v1", POPUPS),
];

/// Before which path programs are named.
const NAMED: &str = "/programs/v1/";

/// The API's version of a controller; `None` before 10.11, which has no API.
pub fn version(software: [u32; 4]) -> Option<&'static str> {
    let [major, minor, ..] = software;
    let newest = VERSIONS.iter().rev().find(|(since, _)| minor >= *since);
    newest.filter(|_| major >= 10).map(|(_, version)| *version)
}

/// Carries out a request.
pub fn answer(shared: &RobotShared, request: &Request<'_>) -> Outcome {
    let (software, remote) = {
        let controller = shared.controller();
        (controller.core.version(), controller.core.modes.remote())
    };
    let Some(version) = version(software) else { return absent(request).into() };
    let path = request.path.trim_end_matches('/');
    let name = request.path.strip_prefix(NAMED).filter(|name| !name.is_empty());
    let route = if name.is_some() { "/programs/v1/{name}" } else { path };
    let there = |(method, path, since): &(&str, &str, u32)| {
        (*method, *path) == (request.method, route) && software[1] >= *since
    };
    if !ROUTES.iter().any(there) {
        return absent(request).into();
    }
    // The vendor's client uploads in local control too.
    if !remote && request.method != "GET" && path != "/programs/v1" {
        let details = "The robot must be in remote mode or the request originate from an internal URCap";
        return Reply::refused(403, "Forbidden - Operation Not Allowed", details).into();
    }
    match (request.method, path) {
        ("PUT", "/robotstate/v1/state") => state::act(&mut shared.controller(), request),
        (_, "/openapi.json") => openapi(version, software[1]).into(),
        ("PUT", "/program/v1/load") if software[1] >= MODES => Reply::elsewhere("/program/v1/loaded").into(),
        ("PUT", "/program/v1/load" | "/program/v1/loaded") => program::load(shared, request).into(),
        ("POST", "/programs/v1") => programs::upload(shared, request, false).into(),
        ("PUT", "/programs/v1") => programs::upload(shared, request, true).into(),
        ("GET", path) => match name {
            Some(name) => programs::download(shared, name).into(),
            None => query(&shared.controller(), path).into(),
        },
        (_, path) => command(&mut shared.controller(), path, request).into(),
    }
}

/// The reply to an action that has come to its end; `None` while it goes on.
pub fn reached(shared: &RobotShared, goal: Goal) -> Option<Reply> {
    state::reached(&shared.controller(), goal)
}

fn query(controller: &Controller, path: &str) -> Reply {
    match path {
        "/robotstate/v1/robotmode" => state::robot_mode(controller),
        "/robotstate/v1/safetymode" => state::safety_mode(controller),
        "/system/v1/controlmode" => state::control_mode(controller),
        "/system/v1/operationalmode" => state::operational_mode(controller),
        "/program/v1/loaded" => program::loaded(controller),
        "/program/v1/state" => program::state(controller),
        "/programs/v1" => programs::list(controller),
        "/versions/v1" => state::versions(controller),
        "/system/v1/system-time" => state::system_time(controller),
        "/supportfiles/v1" => support::download(controller),
        _ => state::information(controller),
    }
}

/// What changes something under the controller's lock.
fn command(controller: &mut Controller, path: &str, request: &Request<'_>) -> Reply {
    match (request.method, path) {
        ("PUT", "/program/v1/state") => return program::act(controller, request),
        ("PUT", "/system/v1/shutdown") => {
            controller.power_off();
            return Reply::accepted();
        }
        ("POST", "/supportfiles/v1") => return support::generate(controller),
        (_, "/operational-mode/v1") => return state::set_operational_mode(controller, request),
        ("POST", path) => match request.text(&["message"]) {
            Ok(text) if path == "/popup/v1" => controller.core.popup = Some(text),
            Ok(text) => {
                tracing::info!(text, "log message of a client of the Robot API");
                return Reply::done("Log entry added");
            }
            Err(refusal) => return refusal,
        },
        (_, "/popup/v1") => controller.core.popup = None,
        _ => controller.core.pendant.safety_popup = false,
    }
    Reply::done("OK")
}

fn absent(request: &Request<'_>) -> Reply {
    let Request { method, path, .. } = request;
    Reply::refused(404, "Not Found", &format!("there is no {method} {path} in this version"))
}

fn openapi(version: &str, minor: u32) -> Reply {
    let mut paths = Map::new();
    for (method, path, _) in ROUTES.iter().filter(|(_, _, since)| minor >= *since) {
        let methods = paths.entry(*path).or_insert_with(|| json!({}));
        methods[method.to_ascii_lowercase()] = json!({"responses": {"200": {"description": "OK"}}});
    }
    let info = json!({"title": "Robot API", "version": version});
    Reply::of(json!({"openapi": "3.1.0", "info": info, "paths": Value::Object(paths)}))
}

#[cfg(test)]
mod tests;
