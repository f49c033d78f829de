//! `celld watch`: what the cell does, a line at every change, until Ctrl-C.
//!
//! In: the state folder. Out: dated lines on stdout, or a screen (`--full`). A daemon that is not there is
//! waited for, and one that ends is reported: whoever watches sees both.

mod screen;

use crate::cli::client::{ClientError, StateArg, complain, exit_2};
use crate::cli::watch::screen::Screen;
use crate::jobs::changes::changes;
use crate::jobs::journal::Journal;
use crate::jobs::record::JobResult;
use crate::jobs::state::StateFolder;
use crate::jobs::status::Status;
use crate::jobs::utc;
use cell_edge::clock::unix_now_s;
use clap::Args;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyModifiers};
use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How often the status is read.
const EVERY: Duration = Duration::from_millis(100);

/// How often the journal is read for how a job ended.
const OUTCOME_TRIES: usize = 10;

/// Arguments of `celld watch`.
#[derive(Args, Debug)]
pub struct WatchArgs {
    #[command(flatten)]
    state: StateArg,
    /// All of it on one screen: state, job, moves, devices, changes; q leaves
    #[arg(long)]
    full: bool,
}

/// Shows what happens until `stop`; exit code 0, or 1 where the state folder cannot be read.
pub fn run(args: &WatchArgs, stop: &Arc<AtomicBool>) -> u8 {
    let state = args.state.folder();
    if args.full {
        return full(&state, stop);
    }
    crate::cli::interrupt::watch(stop);
    lines(&state, stop)
}

/// The daemon's status; `None` where none runs.
fn read(state: &StateFolder) -> Result<Option<Status>, ClientError> {
    let runs = state.is_taken()?;
    Ok(Status::read(&state.status())?.filter(|_| runs))
}

/// The screen until q or Ctrl-C.
fn full(state: &StateFolder, stop: &Arc<AtomicBool>) -> u8 {
    if !std::io::stdout().is_terminal() {
        return exit_2("--full needs a terminal; without it, `celld watch` prints a line at every change");
    }
    crate::cli::interrupt::watch_every(stop);
    let mut terminal = match ratatui::try_init() {
        Ok(terminal) => terminal,
        Err(error) => return exit_2(&format!("this terminal cannot show a screen: {error}")),
    };
    let shown = show(&mut terminal, state, stop);
    ratatui::restore();
    match shown {
        Ok(()) => 0,
        Err(error) => complain(&error),
    }
}

fn show(
    terminal: &mut ratatui::DefaultTerminal,
    state: &StateFolder,
    stop: &Arc<AtomicBool>,
) -> Result<(), ClientError> {
    let mut screen = Screen::default();
    while !stop.load(Ordering::Relaxed) {
        let now = read(state)?;
        let unix_s = unix_now_s();
        match (screen.status(), &now) {
            (Some(before), Some(now)) => {
                let lines: Vec<_> = news(state, before, now).collect();
                lines.iter().for_each(|change| screen.note(unix_s, change));
            }
            (Some(before), None) => {
                let lines = ending(state, before);
                lines.iter().for_each(|change| screen.note(unix_s, change));
            }
            (None, Some(now)) => screen.note(unix_s, &format!("celld {} runs", now.daemon)),
            (None, None) => {}
        }
        screen.set(now);
        terminal.draw(|frame| screen.draw(frame, unix_s)).map_err(ClientError::Terminal)?;
        if left()? {
            break;
        }
    }
    Ok(())
}

/// Waits for a key as long as a status lasts; true for those that leave.
fn left() -> Result<bool, ClientError> {
    if !event::poll(EVERY).map_err(ClientError::Terminal)? {
        return Ok(false);
    }
    let Event::Key(key) = event::read().map_err(ClientError::Terminal)? else { return Ok(false) };
    let control = key.modifiers.contains(KeyModifiers::CONTROL);
    Ok(matches!(key.code, KeyCode::Char('q') | KeyCode::Esc) || (control && key.code == KeyCode::Char('c')))
}

fn lines(state: &StateFolder, stop: &Arc<AtomicBool>) -> u8 {
    let mut last: Option<Status> = None;
    let mut told_absent = false;
    while !stop.load(Ordering::Relaxed) {
        match (read(state), &last) {
            (Err(error), _) => return complain(&error),
            (Ok(None), Some(before)) => {
                if !ending(state, before).iter().all(|change| line(change)) {
                    return 0;
                }
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
                    Some(before) if !news(state, before, &now).all(|change| line(&change)) => return 0,
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

/// What has changed, and behind it how a job that is over has ended, which may have to be waited for.
fn news<'a>(state: &'a StateFolder, before: &'a Status, now: &'a Status) -> impl Iterator<Item = String> {
    let over = before.job.as_deref().filter(|_| before.job != now.job);
    let ended = std::iter::once_with(move || over.and_then(|job| outcome(state, job))).flatten();
    changes(before, now).into_iter().chain(ended)
}

/// What the daemon wrote last, and that it has ended.
fn ending(state: &StateFolder, before: &Status) -> Vec<String> {
    let written = Status::read(&state.status()).ok().flatten();
    let last = written.filter(|last| last.daemon == before.daemon).unwrap_or_else(|| before.clone());
    let mut lines: Vec<_> = news(state, before, &last).collect();
    lines.push(match last.rests() {
        true => "the daemon has ended; the arm was at rest".to_string(),
        false => format!("the daemon has ended; its last status says: {}, {}", last.state, last.mode()),
    });
    lines
}

/// How a job ended, as soon as the journal has it: the status may be a little ahead of it.
fn outcome(state: &StateFolder, job: &str) -> Option<String> {
    for _ in 0..OUTCOME_TRIES {
        let ended = Journal::open_to_read(&state.journal()).and_then(|journal| journal.job(job));
        if let Some(JobResult { status, message, moves, seconds, .. }) = ended.ok()??.result {
            return Some(format!("job {job}: {status}, {message} ({moves} moves, {seconds:.0} s)"));
        }
        std::thread::sleep(EVERY);
    }
    None
}

/// False when there is no reader any more.
fn line(text: &str) -> bool {
    cell_edge::terminal::prints(&format!("{}  {text}\n", utc::text(unix_now_s())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::status::STARTING;

    #[test]
    fn what_a_daemon_wrote_last_is_read_although_it_has_ended() {
        let folder = tempfile::tempdir().expect("a folder");
        let state = StateFolder::new(folder.path());
        let idle = Status { daemon: "celld-1".into(), state: "idle".into(), ..Status::default() };
        let starting = Status { state: STARTING.into(), ..idle.clone() };
        let unknown = "the daemon has ended; its last status says: starting, disarmed";
        assert_eq!(ending(&state, &starting), [unknown], "nothing is known of the arm yet");
        let stopping = Status { moving: true, ..idle };
        let cut_off = ending(&state, &stopping);
        let moves = "the daemon has ended; its last status says: idle, disarmed, THE ARM MAY STILL MOVE";
        assert_eq!(cut_off, [moves]);
        let rests = Status { moving: false, ..stopping.clone() };
        rests.write(&state.status()).expect("written");
        assert_eq!(
            ending(&state, &stopping),
            ["the arm is at rest", "the daemon has ended; the arm was at rest"],
            "the last status came with the end"
        );
        Status { daemon: "celld-2".into(), ..rests }.write(&state.status()).expect("written");
        assert_eq!(ending(&state, &stopping), cut_off, "another daemon's says nothing of this one");
    }
}
