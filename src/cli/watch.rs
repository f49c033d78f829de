//! `celld watch`: what the cell does, a line at every change, until Ctrl-C.
//!
//! In: the state folder. Out: dated lines on stdout. A daemon that is not there is waited for, and one that
//! ends is reported: whoever watches sees both.

use crate::cli::client::{ClientError, StateArg, complain};
use crate::jobs::changes::changes;
use crate::jobs::status::Status;
use crate::jobs::utc;
use cell_edge::clock::unix_now_s;
use clap::Args;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How often the status is read.
const EVERY: Duration = Duration::from_millis(100);

/// Arguments of `celld watch`.
#[derive(Args, Debug)]
pub struct WatchArgs {
    #[command(flatten)]
    state: StateArg,
}

/// Prints changes until `stop`; exit code 0, or 1 where the state folder cannot be read.
pub fn run(args: &WatchArgs, stop: &Arc<AtomicBool>) -> u8 {
    crate::cli::interrupt::watch(stop);
    let state = args.state.folder();
    let mut last: Option<Status> = None;
    let mut told_absent = false;
    while !stop.load(Ordering::Relaxed) {
        let read = || -> Result<Option<Status>, ClientError> {
            let runs = state.is_taken()?;
            Ok(Status::read(&state.status())?.filter(|_| runs))
        };
        match (read(), &last) {
            (Err(error), _) => return complain(&error),
            (Ok(None), Some(_)) => {
                line("the daemon has ended");
                last = None;
                told_absent = true;
            }
            (Ok(None), None) if !told_absent => {
                line(&format!("no daemon runs on {}; waiting for one", state.root().display()));
                told_absent = true;
            }
            (Ok(None), None) => {}
            (Ok(Some(now)), before) => {
                match before {
                    Some(before) if !changes(before, &now).iter().all(|change| line(change)) => return 0,
                    Some(_) => {}
                    None => _ = line(&now.text()),
                }
                last = Some(now);
            }
        }
        std::thread::sleep(EVERY);
    }
    0
}

/// False when there is no reader any more.
fn line(text: &str) -> bool {
    cell_edge::terminal::prints(&format!("{}  {text}\n", utc::text(unix_now_s())))
}
