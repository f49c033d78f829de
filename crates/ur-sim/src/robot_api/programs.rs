//! The programs on the controller: `/programs/v1` of the Robot API.
//!
//! In: `.urpx` files, which are JSON with the program's name and script. Out: the list, a program as such a
//! file, what became of an upload. A program that is played is the application's script and then its own,
//! which lie in the file as PolyScope X has made them. Bounded: so many uploads of so many bytes.

use crate::controller::Controller;
use crate::controller::builtins::compile_program;
use crate::controller::external_control::identifier;
use crate::controller::program_files::{ProgramSource, Urpx, program_name};
use crate::robot_api::form::{decoded, file_of};
use crate::robot_api::program::{load_named, loaded_name};
use crate::robot_api::reply::{Reply, Request};
use crate::robot_server::shared::RobotShared;
use serde_json::{Value, json};
use ur_wire::enumerations::RuntimeState;

/// Uploads that are kept, and bytes of all of them.
const MAX_UPLOADS: usize = 200;
const MAX_BYTES: usize = 32 << 20;

/// Longest name of a program, bytes.
const MAX_NAME: usize = 200;

/// GET `/programs/v1`.
pub fn list(controller: &Controller) -> Reply {
    let files = &controller.core.config.programs;
    let programs: Vec<Value> =
        files.iter().map(|(path, _)| information(program_name(path), files.uploaded(path))).collect();
    Reply::of(json!({"programs": programs, "message": ""}))
}

/// Older clients take no dates but numbers.
fn information(name: &str, uploaded: Option<&Urpx>) -> Value {
    let [created, modified, saved] = uploaded.map_or([0; 3], |urpx| urpx.dates);
    json!({
        "name": name,
        "description": uploaded.map_or("", |urpx| &urpx.description),
        "createdDate": created,
        "lastModifiedDate": modified,
        "lastSavedDate": saved,
        "programState": "FINAL",
    })
}

/// GET `/programs/v1/NAME`.
pub fn download(shared: &RobotShared, part: &str) -> Reply {
    let name = decoded(part).unwrap_or_default();
    let found = {
        let controller = shared.controller();
        let files = &controller.core.config.programs;
        let found = files.named(&name);
        found.map(|(path, source)| (source.clone(), files.uploaded(path).map(|urpx| urpx.document.clone())))
    };
    match found {
        None => Reply::refused(404, "Program not found", &format!("there is no program {name:?}")),
        Some((_, Some(document))) => Reply::of(serde_json::from_str(&document).unwrap_or_default()),
        Some((source, None)) => Reply::of(written(&name, &source)),
    }
}

/// A program of the configuration as a file that can be uploaded.
fn written(name: &str, source: &ProgramSource) -> Value {
    let script = match source {
        ProgramSource::Script(text) => match compile_program(text) {
            Ok(code) => format!("{text}\n{}()", code.name),
            Err(_) => text.clone(),
        },
        ProgramSource::ExternalControl { .. } => String::new(),
    };
    json!({
        "application": {"id": "0", "applicationInfo": {"name": "application"}},
        "program": {
            "id": "0",
            "programInformation": information(name, None),
            "urscript": {"script": script, "nodeIDList": []},
        },
    })
}

/// POST `/programs/v1`, which refuses a name that is there, and PUT, which replaces.
pub fn upload(shared: &RobotShared, request: &Request<'_>, replaces: bool) -> Reply {
    let read = file_of(request.content_type, request.body).and_then(urpx_of);
    let Some(Upload { name, script, urpx }) = read else {
        return Reply::refused(
            422,
            "Invalid .urpx file format",
            "a form with the file of a program is needed",
        );
    };
    let is_loaded = {
        let mut controller = shared.controller();
        if let Some(refusal) = refusal(&controller, &name, &urpx, replaces) {
            return refusal;
        }
        controller.core.config.programs.upload(&name, ProgramSource::Script(script), urpx);
        loaded_name(&controller) == Some(&*name)
    };
    if is_loaded {
        // What does not compile stays as it was until it is loaded again, which then fails.
        let _ = load_named(shared, &name);
    }
    Reply::of(json!({"programName": name, "message": "Program uploaded"}))
}

fn refusal(controller: &Controller, name: &str, urpx: &Urpx, replaces: bool) -> Option<Reply> {
    let files = &controller.core.config.programs;
    let exists = files.named(name).is_some();
    let active = controller.programs.runtime_state() != RuntimeState::Stopped;
    let (count, bytes) = files.uploads();
    match replaces {
        false if exists => {
            Some(Reply::refused(400, "Program with this name already exists", &format!("{name:?}")))
        }
        true if !exists => Some(Reply::refused(404, "Program not found", &format!("{name:?}"))),
        true if active && loaded_name(controller) == Some(name) => {
            Some(Reply::refused(409, "Program is loaded and active", &format!("{name:?}")))
        }
        _ if (!exists && count >= MAX_UPLOADS) || bytes + urpx.document.len() > MAX_BYTES => {
            Some(Reply::refused(507, "Insufficient storage", "the simulator keeps no more programs"))
        }
        _ => None,
    }
}

/// An uploaded program.
struct Upload {
    name: String,
    script: String,
    urpx: Urpx,
}

fn urpx_of(bytes: &[u8]) -> Option<Upload> {
    let file: Value = serde_json::from_slice(bytes).ok()?;
    let text = |pointer: &str| file.pointer(pointer).and_then(Value::as_str);
    let name = text("/program/programInformation/name")?;
    let own = text("/program/urscript/script")?;
    let common = text("/application/urscript/script").unwrap_or_default();
    if name.trim().is_empty() || name.len() > MAX_NAME || name.contains(['/', '\0']) {
        return None;
    }
    let date = |key: &str| {
        file.pointer(&format!("/program/programInformation/{key}")).and_then(Value::as_u64).unwrap_or(0)
    };
    let urpx = Urpx {
        document: std::str::from_utf8(bytes).ok()?.to_owned(),
        description: text("/program/programInformation/description").unwrap_or_default().to_owned(),
        dates: [date("createdDate"), date("lastModifiedDate"), date("lastSavedDate")],
    };
    let script = format!("def {}():\n{common}\n{own}\nend\n", identifier(name));
    Some(Upload { name: name.to_owned(), script, urpx })
}
