//! Programs whose script a PC hands out, over real sockets.

use super::*;
use crate::controller::program_files::{ProgramFiles, ProgramSource};
use crate::robot_server::dashboard::answer;
use std::io::{BufRead, BufReader};
use ur_wire::dashboard::Command;
use ur_wire::primary_message::PROGRAM_STARTED;

/// A controller with one such program, loaded.
fn loaded(port: u16) -> Controller {
    let mut controller = controller();
    let mut files = ProgramFiles::in_folder("/ursim/programs");
    let source = ProgramSource::ExternalControl { host: "127.0.0.1".to_owned(), port };
    files.add("external_control.urp", source);
    controller.core.config.programs = files;
    assert_eq!(
        dashboard(&mut controller, "load external_control.urp"),
        "Loading program: /ursim/programs/external_control.urp"
    );
    assert_eq!(dashboard(&mut controller, "programState"), "STOPPED external_control.urp");
    controller
}

fn dashboard(controller: &mut Controller, line: &str) -> String {
    let command = Command::parse(line);
    answer(controller, &command, line, 0).line(&command).trim_end().to_owned()
}

/// A PC that takes requests until the controller hangs up, and answers none.
fn silent(stream: TcpStream) {
    let mut lines = BufReader::new(stream);
    while lines.read_line(&mut String::new()).is_ok_and(|count| count > 0) {}
}

fn texts(controller: &mut Controller) -> Vec<String> {
    let text = |message| match message {
        MessageBody::Text(text) => Some(text),
        MessageBody::Key { title, text, .. } => Some(format!("{title}:{text}")),
        MessageBody::RuntimeException { text, .. } => Some(format!("exception {text}")),
        _ => None,
    };
    controller.core.take_messages().into_iter().filter_map(text).collect()
}

#[test]
fn a_program_of_external_control_runs_what_the_pc_hands_out() {
    // Like the client library's script sender: it answers a request and leaves the connection open.
    let port = server(|stream| {
        let mut lines = BufReader::new(stream.try_clone().unwrap());
        let mut line = String::new();
        lines.read_line(&mut line).unwrap();
        assert_eq!(line, "request_program\n");
        let script = "# before\n# HEADER_BEGIN\ndef say(what):\n  textmsg(what)\nend\n# HEADER_END\n\
                      say(\"on\")\nwhile True:\n  sync()\nend\n";
        (&stream).write_all(script.as_bytes()).unwrap();
        // Until the controller hangs up.
        let _ = lines.read_line(&mut line);
    });
    let mut controller = loaded(port);
    assert_eq!(dashboard(&mut controller, "play"), "Starting program");
    assert_eq!(dashboard(&mut controller, "programState"), "STOPPED external_control.urp");
    assert_eq!(dashboard(&mut controller, "play"), "Failed to execute: play", "it is on its way");
    step_until(&mut controller, |c| c.programs.playing());
    step_until(&mut controller, |c| c.programs.line() > 5);
    assert_eq!(dashboard(&mut controller, "programState"), "PLAYING external_control.urp");
    assert_eq!(texts(&mut controller), [format!("{PROGRAM_STARTED}:external_control"), "on".to_owned()]);
    assert_eq!(dashboard(&mut controller, "stop"), "Stopped");
    assert_eq!(dashboard(&mut controller, "programState"), "STOPPED external_control.urp");
}

#[test]
fn a_pc_that_is_not_there_or_hangs_up_makes_a_popup() {
    let nowhere = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mute = server(drop);
    for (port, reason) in [(nowhere, "refused"), (mute, "without an answer")] {
        let mut controller = loaded(port);
        dashboard(&mut controller, "play");
        step_until(&mut controller, |c| c.core.popup.is_some());
        let popup = controller.core.popup.clone().unwrap();
        let begins = format!("The connection to the remote PC at 127.0.0.1:{port} could not be established.");
        assert!(popup.starts_with(&begins) && popup.contains(reason), "{popup}");
        assert!(controller.programs.playing(), "the popup waits to be closed");
        dashboard(&mut controller, "close popup");
        step_until(&mut controller, stopped);
    }
}

#[test]
fn a_pc_that_says_nothing_is_given_up_and_stop_gives_up_at_once() {
    let mut controller = loaded(server(silent));
    dashboard(&mut controller, "play");
    step_until(&mut controller, |c| c.core.popup.is_some());
    assert!(controller.core.popup.as_ref().is_some_and(|popup| popup.contains("Read timed out")));
    for end in ["stop", "power off", "load external_control.urp"] {
        let mut controller = loaded(server(silent));
        dashboard(&mut controller, "play");
        (0..10).for_each(|_| controller.frame());
        dashboard(&mut controller, end);
        (0..3000).for_each(|_| controller.frame());
        assert!(controller.core.popup.is_none() && stopped(&controller), "{end}");
    }
}

#[test]
fn a_script_that_is_none_is_complained_about_and_an_upload_goes_before() {
    let port = server(|mut stream| stream.write_all(b"x = = 2\n").unwrap());
    let mut controller = loaded(port);
    dashboard(&mut controller, "play");
    let began = Instant::now();
    let complaint = loop {
        let frame = controller.core.step + 1;
        step_until(&mut controller, |c| c.core.step >= frame);
        if let Some(text) = texts(&mut controller).pop() {
            break text;
        }
        assert!(began.elapsed() < PATIENCE);
    };
    assert!(complaint.contains("syntax_error_on_line:2"), "{complaint}");
    let mut controller = loaded(server(silent));
    dashboard(&mut controller, "play");
    start(&mut controller, "def other():\n while True:\n  sync()\n end\nend\n");
    assert_eq!(dashboard(&mut controller, "programState"), "PLAYING other");
}
