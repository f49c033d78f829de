//! `celld-video`: reads videos and USB cameras for celld, with OpenCV.
//!
//! In: requests, a line each, on standard input. Out: replies on standard output, both as in [`wire`]. It
//! ends with its input: celld is gone then, and the camera is free for the next one, also while a driver
//! blocks.

mod capture;
#[path = "../../io/camera/wire.rs"]
mod wire;

use capture::Capture;
use rustix::process::{Signal, getpid, kill_process};
use serde::de::DeserializeOwned;
use std::fs::File;
use std::io::{BufRead, BufWriter, Write};
use std::process::ExitCode;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;
use wire::{Reply, Request, Source, WIRE};

/// Time to answer what was requested before the input ended.
const END_LIMIT: Duration = Duration::from_secs(10);

fn main() -> ExitCode {
    if std::env::args_os().len() > 1 {
        eprintln!(
            "celld-video reads videos and USB cameras for celld, which starts it: requests on standard input, \
             pictures on standard output"
        );
        return ExitCode::from(2);
    }
    // Whoever starts it may go before other threads, as the robot's loop does; pictures do not.
    cell_edge::priority::lower();
    match replies().and_then(|mut replies| serve(&requests(), &mut replies)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("celld-video: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Standard output for the replies alone: what a library prints goes to standard error.
fn replies() -> std::io::Result<BufWriter<File>> {
    let own = rustix::io::dup(std::io::stdout())?;
    rustix::stdio::dup2_stdout(std::io::stderr())?;
    Ok(BufWriter::new(own.into()))
}

/// The lines of standard input. The process ends with them, whatever it waits for.
fn requests() -> Receiver<String> {
    let (send, requests) = sync_channel(1);
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines() {
            let Ok(line) = line else { break };
            if send.send(line).is_err() {
                return;
            }
        }
        drop(send);
        std::thread::sleep(END_LIMIT);
        // Without what a library does at an orderly end: its driver blocks.
        let _ = kill_process(getpid(), Signal::KILL);
    });
    requests
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
