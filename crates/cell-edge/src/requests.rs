//! Standard input and output of a helper process.
//!
//! In: lines of standard input. Out: [`requests`], which ends the process soon after its input ends, even if
//! it hangs; [`replies`], for replies only. A helper that outlives a killed celld would keep the camera
//! busy.

use rustix::process::{Signal, getpid, kill_process};
use std::fs::File;
use std::io::{BufRead, BufWriter};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

/// Time to answer what was requested before the input ended, and to let a device go.
const END_LIMIT: Duration = Duration::from_secs(10);

/// Standard output, for replies only: from now on, prints of a library go to standard error.
///
/// # Errors
/// What the system says; there is no standard output then.
pub fn replies() -> std::io::Result<BufWriter<File>> {
    let own = rustix::io::dup(std::io::stdout())?;
    rustix::stdio::dup2_stdout(std::io::stderr())?;
    Ok(BufWriter::new(own.into()))
}

/// The lines of standard input. 10 s after their end the process kills itself.
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
        // An orderly exit could hang in a library whose driver blocks.
        let _ = kill_process(getpid(), Signal::KILL);
    });
    requests
}
