//! `celld-video`: reads videos and USB cameras for celld, with OpenCV.
//!
//! In: requests, a line each, on standard input. Out: replies on standard output, both as in [`wire`]. It
//! ends with its input: celld is gone then, and the camera is free for the next one, also while a driver
//! blocks.

mod capture;
#[path = "../../io/camera/wire.rs"]
mod wire;

use capture::Capture;
use cell_edge::requests::{replies, requests};
use serde::de::DeserializeOwned;
use std::io::Write;
use std::process::ExitCode;
use std::sync::mpsc::Receiver;
use wire::{Reply, Request, Source, WIRE};

fn main() -> ExitCode {
    if std::env::args_os().len() > 1 {
        eprintln!(
            "celld-video reads videos and USB cameras for celld, which starts it: requests on standard input, \
             pictures on standard output"
        );
        return ExitCode::from(2);
    }
    // The daemon may run at a high priority, which this process would inherit.
    cell_edge::priority::lower();
    match replies().and_then(|mut replies| serve(&requests(), &mut replies)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("celld-video: {error}");
            ExitCode::FAILURE
        }
    }
}

fn serve(requests: &Receiver<String>, replies: &mut impl Write) -> std::io::Result<()> {
    let Ok(line) = requests.recv() else { return Ok(()) };
    let mut capture = match parsed::<Source>(&line).and_then(|source| Capture::open(&source)) {
        Ok(capture) => capture,
        Err(failed) => return reply(replies, &failed, &[]),
    };
    reply(replies, &Reply::Open { wire: WIRE }, &[])?;
    while let Ok(line) = requests.recv() {
        let (answer, pixels) = match parsed::<Request>(&line) {
            Ok(Request::Grab) => (capture.grab(), Vec::new()),
            Ok(Request::Picture) => capture.picture().unwrap_or_else(|failed| (failed, Vec::new())),
            Err(failed) => (failed, Vec::new()),
        };
        reply(replies, &answer, &pixels)?;
    }
    Ok(())
}

fn parsed<T: DeserializeOwned>(line: &str) -> Result<T, Reply> {
    serde_json::from_str(line).map_err(|error| Reply::Failed {
        what: "celld-video does not know this request: it is of another version than celld".into(),
        setting: true,
        cause: Some(error.to_string()),
    })
}

fn reply(to: &mut impl Write, answer: &Reply, pixels: &[u8]) -> std::io::Result<()> {
    serde_json::to_writer(&mut *to, answer)?;
    to.write_all(b"\n")?;
    to.write_all(pixels)?;
    to.flush()
}
