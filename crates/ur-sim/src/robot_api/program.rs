//! The loaded program: `/program/v1` of the Robot API.
//!
//! In: names and actions. Out: replies. A name is that of a program's file without folders and ending.
//! Statuses are assumed; that an action has taken effect when its reply comes is what the vendor's own
//! client relies on.

use crate::controller::Controller;
use crate::controller::program_files::program_name;
use crate::controller::programs::open_source;
use crate::robot_api::reply::{Reply, Request};
use crate::robot_server::shared::RobotShared;
use serde_json::json;

/// The name of the loaded program.
pub fn loaded_name(controller: &Controller) -> Option<&str> {
    controller.core.pendant.program.as_deref().map(program_name)
}

/// GET `/program/v1/loaded`.
pub fn loaded(controller: &Controller) -> Reply {
    match loaded_name(controller) {
        Some(name) => Reply::of(json!({"name": name, "message": ""})),
        None => Reply::refused(404, "No program loaded", ""),
    }
}

/// PUT `/program/v1/loaded`, `/program/v1/load` before 3.1.4. The script is compiled while the controller
/// goes on.
pub fn load(shared: &RobotShared, request: &Request<'_>) -> Reply {
    let name = match request.text(&["name", "programName"]) {
        Ok(name) => name,
        Err(refusal) => return refusal,
    };
    load_named(shared, &name)
}

/// Loads a program by its name.
pub fn load_named(shared: &RobotShared, name: &str) -> Reply {
    let found = {
        let controller = shared.controller();
        let found = controller.core.config.programs.named(name);
        found.map(|(path, source)| (path.to_owned(), source.clone()))
    };
    let Some((path, source)) = found else {
        return Reply::refused(404, "Program not found", &format!("there is no program {name:?}"));
    };
    let Ok(program) = open_source(&path, &source) else {
        return Reply::refused(500, "Error while loading program", &format!("{name:?} cannot be compiled"));
    };
    let mut controller = shared.controller();
    let Controller { core, programs } = &mut *controller;
    programs.load(program, core);
    core.pendant.program = Some(path);
    Reply::done("Program loaded")
}

/// GET `/program/v1/state`.
pub fn state(controller: &Controller) -> Reply {
    let word = controller.programs.program_state().as_str();
    Reply::of(json!({"state": word, "message": "", "details": ""}))
}

/// PUT `/program/v1/state`.
pub fn act(controller: &mut Controller, request: &Request<'_>) -> Reply {
    let action = match request.text(&["action"]) {
        Ok(action) => action,
        Err(refusal) => return refusal,
    };
    let Controller { core, programs } = controller;
    let done = match action.as_str() {
        "play" => programs.play(core),
        "pause" => programs.pause(),
        "resume" => programs.paused() && programs.play(core),
        "stop" => {
            // Without a program too, as on the dashboard.
            programs.cancel(core);
            true
        }
        _ => {
            let details = "action: play, pause, resume or stop";
            return Reply::refused(422, "Validation error", details);
        }
    };
    if done {
        return Reply::done("Program state changed");
    }
    let now = programs.runtime_state();
    let mode = core.modes.robot_mode();
    let details = format!("{action} is not possible: the program is {now}, the robot mode {mode}");
    Reply::refused(409, "Conflict - Invalid State Transition", &details)
}
