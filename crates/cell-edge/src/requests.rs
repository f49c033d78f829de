//! A program that another one starts for its requests: they come on standard input, replies go to standard
//! output.
//!
//! In: lines of standard input. Out: [`requests`], which ends the process with its input, whatever it waits
//! for; [`replies`], where nothing but replies is written. What is left behind by a program that has gone
//! would keep a camera from the next one.

use rustix::process::{Signal, getpid, kill_process};
use std::fs::File;
use std::io::{BufRead, BufWriter};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

/// Time to answer what was requested before the input ended, and to let a device go.
const END_LIMIT: Duration = Duration::from_secs(10);

/// Standard output for the replies alone: what a library prints goes to standard error.
///
/// # Errors
/// What the system says; there is no standard output then.
pub fn replies() -> std::io::Result<BufWriter<File>> {
    let own = rustix::io::dup(std::io::stdout())?;
    rustix::stdio::dup2_stdout(std::io::stderr())?;
    Ok(BufWriter::new(own.into()))
}

/// The lines of standard input. The process ends with them, whatever it waits for.
pub fn requests() -> Receiver<String> {
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
