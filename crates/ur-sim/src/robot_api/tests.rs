//! The Robot API against a controller whose frames the test makes.

use super::*;
use crate::controller::ControllerConfig;
use crate::controller::modes::Control;
use crate::controller::program_files::ProgramSource;
use proptest::prelude::*;
use std::sync::Arc;

/// One call of a client.
fn call(shared: &RobotShared, method: &str, path: &str, body: &str) -> Outcome {
    let request = Request { method, path, content_type: "application/json", body: body.as_bytes() };
    answer(shared, &request)
}

/// Status and body of a reply; frames are made while the arm is waited for.
fn reply(shared: &RobotShared, method: &str, path: &str, body: &str) -> (u16, Value) {
    let reply = match call(shared, method, path, body) {
        Outcome::Reply(reply) => reply,
        Outcome::Until(goal) => (0..5000)
            .find_map(|_| {
                let reply = reached(shared, goal);
                shared.frame(None);
                reply
            })
            .expect("an action comes to an end"),
    };
    (reply.status, reply.body)
}

fn act(shared: &RobotShared, path: &str, action: &str) -> u16 {
    reply(shared, "PUT", path, &format!(r#"{{"action": "{action}"}}"#)).0
}

fn word(shared: &RobotShared, path: &str, key: &str) -> String {
    let (status, body) = reply(shared, "GET", path, "");
    assert_eq!(status, 200, "{path}: {body}");
    body[key].as_str().unwrap_or_default().to_owned()
}

fn config(minor: u32) -> ControllerConfig {
    let mut config = ControllerConfig { version: [10, minor, 0, 1], ..ControllerConfig::ur5e(1) };
    let script = "def waits():\n while True:\n  sync()\n end\nend\n";
    config.programs.add("wait_program.urp", ProgramSource::Script(script.to_owned()));
    config.programs.add("wrong.urp", ProgramSource::Script("def wrong(:\nend\n".to_owned()));
    config
}

fn robot(minor: u32) -> Arc<RobotShared> {
    RobotShared::new(Controller::new(config(minor)))
}

const STATE: &str = "/robotstate/v1/state";
const MODE: &str = "/robotstate/v1/robotmode";
const SAFETY: &str = "/robotstate/v1/safetymode";
const PROGRAM: &str = "/program/v1/state";

#[test]
fn power_and_brakes_are_answered_when_the_arm_is_so_far() {
    let robot = robot(12);
    assert_eq!(word(&robot, MODE, "mode"), "POWER_OFF");
    assert_eq!(act(&robot, STATE, "POWER_ON"), 200);
    assert_eq!(word(&robot, MODE, "mode"), "IDLE");
    assert_eq!(act(&robot, STATE, "POWER_ON"), 200, "it is on");
    assert_eq!(act(&robot, STATE, "BRAKE_RELEASE"), 200);
    assert_eq!(word(&robot, MODE, "mode"), "RUNNING");
    assert_eq!(act(&robot, STATE, "POWER_OFF"), 200);
    assert_eq!(word(&robot, MODE, "mode"), "POWER_OFF");
    robot.controller().emergency_stop(true);
    assert_eq!(word(&robot, SAFETY, "mode"), "EMERGENCY_STOP");
    assert_eq!(act(&robot, STATE, "POWER_ON"), 409);
    robot.controller().emergency_stop(false);
    robot.controller().safety_fault();
    assert_eq!(word(&robot, SAFETY, "mode"), "FAULT");
    assert_eq!(act(&robot, STATE, "RESTART_SAFETY"), 200);
    assert_eq!(word(&robot, SAFETY, "mode"), "NORMAL");
    for nonsense in [r#"{"action": "DANCE"}"#, r#"{"action": 1}"#, "{", "", "[]"] {
        assert_eq!(reply(&robot, "PUT", STATE, nonsense).0, 422, "{nonsense}");
    }
}

#[test]
fn a_protective_stop_is_unlocked_at_once_and_only_there_is_one() {
    let robot = robot(12);
    assert_eq!(act(&robot, STATE, "BRAKE_RELEASE"), 200, "powers on first");
    assert_eq!(act(&robot, STATE, "UNLOCK_PROTECTIVE_STOP"), 409);
    robot.controller().protective_stop("test");
    assert_eq!(word(&robot, SAFETY, "mode"), "PROTECTIVE_STOP");
    assert_eq!(act(&robot, STATE, "UNLOCK_PROTECTIVE_STOP"), 200);
    assert_eq!(word(&robot, SAFETY, "mode"), "NORMAL");
}

#[test]
fn a_program_is_loaded_played_paused_resumed_and_stopped() {
    let robot = robot(12);
    let loaded = || word(&robot, "/program/v1/loaded", "name");
    let state = || word(&robot, PROGRAM, "state");
    let load = |name: &str| reply(&robot, "PUT", "/program/v1/loaded", &json!({"name": name}).to_string()).0;
    assert_eq!(loaded(), "Default program");
    assert_eq!(load("wait_program"), 200);
    assert_eq!(loaded(), "wait_program");
    assert_eq!(act(&robot, PROGRAM, "play"), 409, "without power");
    assert_eq!(act(&robot, STATE, "BRAKE_RELEASE"), 200);
    for (action, status, after) in [
        ("pause", 409, "STOPPED"),
        ("play", 200, "PLAYING"),
        ("play", 409, "PLAYING"),
        ("pause", 200, "PAUSED"),
        ("resume", 200, "PLAYING"),
        ("resume", 409, "PLAYING"),
        ("stop", 200, "STOPPED"),
        ("stop", 200, "STOPPED"),
        ("rewind", 422, "STOPPED"),
    ] {
        assert_eq!((act(&robot, PROGRAM, action), state().as_str()), (status, after), "{action}");
        robot.frame(None);
    }
    assert_eq!((load("nothing"), load("wrong"), load("")), (404, 500, 404));
    assert_eq!(loaded(), "wait_program");
    assert_eq!((load("Default program"), act(&robot, PROGRAM, "play")), (200, 200));
    (0..5).for_each(|_| robot.frame(None));
    assert_eq!(state(), "STOPPED", "it is empty");
}

#[test]
fn in_local_control_actions_are_refused_and_questions_answered() {
    let local = ControllerConfig { control: Control::Local, ..config(12) };
    let robot = RobotShared::new(Controller::new(local));
    assert_eq!(word(&robot, "/system/v1/controlmode", "mode"), "LOCAL");
    assert_eq!(word(&robot, "/system/v1/operationalmode", "mode"), "MANUAL");
    let (status, body) = reply(&robot, "PUT", STATE, r#"{"action": "POWER_ON"}"#);
    assert_eq!(status, 403);
    assert!(body["message"].as_str().unwrap().contains("Not Allowed") && body["details"].is_string());
    assert_eq!(act(&robot, PROGRAM, "stop"), 403);
    assert_eq!(reply(&robot, "PUT", "/program/v1/loaded", r#"{"name": "wait_program"}"#).0, 403);
    robot.controller().core.modes.set_remote(true);
    assert_eq!(word(&robot, "/system/v1/controlmode", "mode"), "REMOTE");
    assert_eq!(word(&robot, "/system/v1/operationalmode", "mode"), "AUTOMATIC");
    assert_eq!(act(&robot, STATE, "POWER_ON"), 200);
}

/// A program as PolyScope X writes it.
fn urpx(name: &str, script: &str) -> String {
    let file = json!({
        "application": {"urscript": {"script": "def helper():\n  return 7\nend"}},
        "program": {
            "programInformation": {"name": name, "description": "mine", "createdDate": 1771239851763u64,
                "lastModifiedDate": null},
            "urscript": {"script": format!("$ 1 \"ur-program\"\n$ 2 \"ur-code\"\n{script}")},
        },
    });
    file.to_string()
}

fn send(shared: &RobotShared, method: &str, file: &str) -> (u16, Value) {
    let form = format!(
        "--b-1\r\nContent-Disposition: form-data; name=\"file\"; filename=\"filename\"\r\nContent-Type: \
         text/plain\r\n\r\n{file}\r\n--b-1--\r\n"
    );
    let content_type = "multipart/form-data; boundary=b-1";
    let request = Request { method, path: "/programs/v1/", content_type, body: form.as_bytes() };
    match answer(shared, &request) {
        Outcome::Reply(reply) => (reply.status, reply.body),
        other => panic!("{other:?}"),
    }
}

#[test]
fn programs_are_uploaded_listed_replaced_downloaded_and_played() {
    let robot = robot(12);
    let outputs = || robot.controller().core.registers.digital_outputs;
    let first = urpx("test upload", "set_digital_out(1, helper() == 7)");
    assert_eq!(send(&robot, "PUT", &first).0, 404, "nothing to replace");
    let (status, body) = send(&robot, "POST", &first);
    assert_eq!((status, body["programName"].as_str()), (200, Some("test upload")));
    assert_eq!(send(&robot, "POST", &first).0, 400, "the name exists");
    let (_, list) = reply(&robot, "GET", "/programs/v1/", "");
    let names: Vec<_> = list["programs"].as_array().unwrap().iter().map(|it| it["name"].as_str()).collect();
    assert_eq!(names, [Some("Default program"), Some("test upload"), Some("wait_program"), Some("wrong")]);
    let uploaded = &list["programs"][1];
    assert_eq!(
        (uploaded["createdDate"].as_u64(), uploaded["lastModifiedDate"].as_u64()),
        (Some(1771239851763), Some(0))
    );
    let (status, file) = reply(&robot, "GET", "/programs/v1/test%20upload", "");
    assert_eq!((status, &file), (200, &serde_json::from_str::<Value>(&first).unwrap()));
    assert_eq!(reply(&robot, "GET", "/programs/v1/test", "").0, 404);
    assert_eq!(act(&robot, STATE, "BRAKE_RELEASE"), 200);
    assert_eq!(reply(&robot, "PUT", "/program/v1/loaded", r#"{"name": "test upload"}"#).0, 200);
    assert_eq!(act(&robot, PROGRAM, "play"), 200);
    (0..5).for_each(|_| robot.frame(None));
    assert_eq!(outputs(), 1 << 1);
    let second = urpx("test upload", "set_digital_out(2, True)\nwhile True:\n  sync()\nend");
    assert_eq!(send(&robot, "PUT", &second).0, 200);
    assert_eq!(act(&robot, PROGRAM, "play"), 200, "the one that is loaded is replaced");
    (0..5).for_each(|_| robot.frame(None));
    assert_eq!(outputs(), 0b110);
    assert_eq!(send(&robot, "PUT", &first).0, 409, "it runs");
}

#[test]
fn a_program_of_the_configuration_can_be_downloaded_and_uploaded_under_another_name() {
    let robot = robot(12);
    let (status, mut file) = reply(&robot, "GET", "/programs/v1/wait_program", "");
    assert_eq!(status, 200);
    file["program"]["programInformation"]["name"] = "twin".into();
    assert_eq!(send(&robot, "POST", &file.to_string()).0, 200);
    assert_eq!(act(&robot, STATE, "BRAKE_RELEASE"), 200);
    assert_eq!(reply(&robot, "PUT", "/program/v1/loaded", r#"{"name": "twin"}"#).0, 200);
    assert_eq!(act(&robot, PROGRAM, "play"), 200);
    (0..5).for_each(|_| robot.frame(None));
    assert_eq!(word(&robot, PROGRAM, "state"), "PLAYING");
}

#[test]
fn files_that_are_no_programs_are_refused_and_uploads_are_bounded() {
    let robot = robot(12);
    let without_script = r#"{"program": {"programInformation": {"name": "a"}}}"#;
    for file in
        ["", "{", "[]", without_script, &urpx("", "x = 1"), &urpx("a/b", ""), &urpx(&"n".repeat(300), "")]
    {
        assert_eq!(send(&robot, "POST", file).0, 422, "{file}");
    }
    let plain = reply(&robot, "POST", "/programs/v1/", &urpx("a", ""));
    assert_eq!(plain.0, 422, "it is no form");
    let refused = (0..1000).find(|number| send(&robot, "POST", &urpx(&number.to_string(), "")).0 == 507);
    assert_eq!(refused, Some(200));
}

#[test]
fn each_version_has_its_requests() {
    let before = robot(11);
    assert_eq!(reply(&before, "GET", "/openapi.json", "").1["info"]["version"], "1.0.0");
    assert_eq!(reply(&before, "GET", MODE, "").0, 404);
    assert_eq!(reply(&before, "PUT", "/program/v1/loaded", r#"{"name": "wait_program"}"#).0, 404);
    assert_eq!(reply(&before, "PUT", "/program/v1/load", r#"{"programName": "wait_program"}"#).0, 200);
    let robot12 = robot(12);
    assert_eq!(reply(&robot12, "GET", "/openapi.json", "").1["info"]["version"], "3.1.4");
    let Outcome::Reply(moved) =
        call(&robot12, "PUT", "/program/v1/load", r#"{"programName": "wait_program"}"#)
    else {
        panic!("it waits")
    };
    assert_eq!((moved.status, moved.location), (307, Some("/program/v1/loaded")));
    assert_eq!(reply(&robot12, "PUT", "/program/v1/loaded", r#"{"programName": "wait_program"}"#).0, 200);
    assert_eq!(reply(&robot12, "POST", "/popup/v1", r#"{"title": "t", "message": "m"}"#).0, 404);
    let robot14 = robot(14);
    assert_eq!(reply(&robot14, "GET", "/openapi.json", "").1["info"]["version"], "5.0.107");
    assert_eq!(reply(&robot14, "POST", "/popup/v1", r#"{"title": "t", "message": "m"}"#).0, 200);
    assert_eq!(robot14.controller().core.popup.as_deref(), Some("m"));
    assert_eq!(reply(&robot14, "DELETE", "/popup/v1", "").0, 200);
    assert_eq!(robot14.controller().core.popup, None);
    assert_eq!(word(&robot14, "/versions/v1", "marketingVersion"), "10.14.0");
    assert_eq!(word(&robot14, "/system/v1/information", "robotType"), "UR5e");
    assert_eq!(
        reply(&robot14, "POST", "/system/v1/log", r#"{"message": "m"}"#).1["message"],
        "Log entry added"
    );
    assert_eq!(reply(&robot14, "PUT", "/system/v1/shutdown", ""), (202, json!({"message": null})));
    assert!(reply(&robot12, "GET", "/system/v1/system-time", "").1["systemTime"].as_f64() > Some(1.7e12));
    assert_eq!(version([10, 8, 0, 0]), None);
    assert_eq!(version([5, 26, 0, 0]), None);
    assert_eq!(version([10, 20, 0, 0]), Some("5.0.107"));
}

#[test]
fn flight_reports_are_generated_and_downloaded_as_an_archive() {
    let robot = robot(14);
    let download = || match call(&robot, "GET", "/supportfiles/v1", "") {
        Outcome::Reply(reply) => (reply.status, reply.file),
        Outcome::Until(goal) => panic!("{goal:?}"),
    };
    assert_eq!(download(), (204, None), "there is none yet");
    (0..50).for_each(|_| robot.frame(None));
    for _ in 0..7 {
        let (status, body) = reply(&robot, "POST", "/supportfiles/v1", "");
        assert_eq!((status, &body["message"]), (200, &"Flight report generated successfully.".into()));
    }
    let (status, file) = download();
    let (kind, bytes) = file.unwrap();
    assert_eq!((status, kind, &bytes[..4]), (200, "application/zip", &b"PK\x03\x04"[..]));
    let text = String::from_utf8_lossy(&bytes);
    let names: Vec<_> = (1..=7).filter(|n| text.contains(&format!("flightreport_{n:04}.txt"))).collect();
    assert_eq!(names, [3, 4, 5, 6, 7], "the oldest have gone");
    assert!(text.contains("model UR5e") && text.contains("robot mode POWER_OFF"));
    assert!(text.contains("\n0.002 0.000000 -1.570000"), "where the arm was: {text}");
    robot.controller().core.modes.set_remote(false);
    assert_eq!(reply(&robot, "POST", "/supportfiles/v1", "").0, 403);
    assert_eq!(download().0, 200);
}

#[test]
fn the_operational_mode_is_set_and_left_to_the_pendant_again() {
    let robot = robot(14);
    let mode = || word(&robot, "/system/v1/operationalmode", "mode");
    let set = |body: &str| reply(&robot, "PUT", "/operational-mode/v1", body).0;
    assert_eq!(mode(), "AUTOMATIC");
    assert_eq!((set(r#"{"mode": "MANUAL"}"#), mode().as_str()), (200, "MANUAL"));
    assert_eq!((set(r#"{"mode": "NONE"}"#), set("{}"), mode().as_str()), (422, 422, "MANUAL"));
    assert_eq!(reply(&robot, "DELETE", "/operational-mode/v1", "").0, 200);
    assert_eq!(mode(), "AUTOMATIC");
}

#[test]
fn every_request_that_is_listed_is_served() {
    let robot = robot(14);
    for (method, path, _) in ROUTES {
        let path = path.replace("{name}", "wait_program");
        let status = match call(&robot, method, &path, "{}") {
            Outcome::Reply(reply) => reply.status,
            Outcome::Until(_) => 200,
        };
        assert!(status != 404, "{method} {path}");
    }
    assert_eq!(reply(&robot, "DELETE", "/programs/v1", "").0, 404);
}

proptest! {
    #[test]
    fn no_request_breaks_it(
        route in 0..ROUTES.len(),
        tail in "[%a-z0-9/]{0,6}",
        content_type in "(application/json|multipart/form-data; boundary=x)?",
        body in r#"(\{"(action|name|message)": ?("play"|"POWER_ON"|1|null|\[\])\}|--x[\r\n-]{0,9}|[ -~]{0,30})"#,
    ) {
        let robot = robot(14);
        let (method, path, _) = ROUTES[route];
        let path = format!("{path}{tail}");
        let request = Request { method, path: &path, content_type: &content_type, body: body.as_bytes() };
        let _ = answer(&robot, &request);
        robot.frame(None);
    }
}
