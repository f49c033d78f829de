//! `celld submit JOB.yaml`: hands a job to the daemon, running or not, and with `--wait` follows it to its
//! end.
//!
//! In: a job file. Out: the job's id on stdout; the file in `incoming`, written whole and renamed. A goal
//! file is read here and its poses go into what is handed in, so that it need not be where the daemon looks.
//! While a daemon runs its verdict is waited for. Exit code 0 when handed in and not refused (with `--wait`:
//! when done), 1 when the job did not succeed, 2 when it is wrong or refused.

use crate::cli::check::folder_of;
use crate::cli::client::{StateArg, complain};
use crate::cli::task::outln;
use crate::config::load::load_cell;
use crate::jobs::goal::find_goal_file;
use crate::jobs::record::{JobRecord, JobState};
use crate::jobs::state::StateFolder;
use crate::jobs::status::{STARTING, Status};
use crate::jobs::submit::{Found, Handed, hand_in, look, prepare};
use cell_edge::clock::unix_now_s;
use cell_machine::code::JobStatus;
use cell_parts::file::read_text;
use clap::Args;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How often the journal is read for the state of the job.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// So long a running daemon is given to read the file: it watches it for half a second, and reads one
/// after the other.
const VERDICT_WITHIN: Duration = Duration::from_secs(10);

/// Arguments of `celld submit`.
#[derive(Args, Debug)]
pub struct SubmitArgs {
    /// The job file.
    job: PathBuf,
    /// Wait until the job has ended, and exit with 1 unless it is done.
    #[arg(long)]
    wait: bool,
    /// The cell whose goal folder `goal: {file: ...}` may name [default: that of the daemon's configuration]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    state: StateArg,
}

/// Hands in a job and returns the exit code.
pub fn submit(args: &SubmitArgs) -> u8 {
    let source = args.job.display().to_string();
    let read = read_text(&args.job).map_err(|reason| format!("{source}: {reason}"));
    let state = args.state.folder();
    let goals = match goal_folder(args.config.as_deref(), &state) {
        Ok(goals) => goals,
        Err(message) => {
            cell_edge::terminal::complain(&message);
            return 2;
        }
    };
    let read_goal = |name: &str| find_goal_file(&folder_of(&args.job), goals.as_deref(), name);
    let prepared = read.and_then(|text| prepare(&text, &source, &read_goal));
    let (job, text) = match prepared {
        Ok(prepared) => prepared,
        Err(message) => {
            cell_edge::terminal::complain(&message);
            return 2;
        }
    };
    match hand_in(&state, &args.job, &job, &text, unix_now_s()) {
        Err(error) => complain(&error.into()),
        Ok(handed) => {
            outln!("{}", handed.id);
            if args.wait { follow(&state, &handed) } else { verdict(&state, &handed) }
        }
    }
}

/// The goal folder of the cell: of the configuration that was named, else of the one that the daemon on this
/// state folder had last; `None` where no cell is known.
fn goal_folder(config: Option<&Path>, state: &StateFolder) -> Result<Option<PathBuf>, String> {
    if let Some(config) = config {
        return load_cell(config).map(|cell| Some(cell.goal_folder)).map_err(|error| error.to_string());
    }
    let status = Status::read(&state.status()).ok().flatten();
    let config = status.map(|status| status.config).filter(|config| !config.is_empty());
    Ok(config.and_then(|config| load_cell(Path::new(&config)).ok()).map(|cell| cell.goal_folder))
}

/// Waits until a daemon that runs has taken the job up or refused it; one that does not run finds it later.
fn verdict(state: &StateFolder, handed: &Handed) -> u8 {
    let begun = Instant::now();
    loop {
        let takes = state.is_taken().map(|taken| taken && !is_starting(state));
        match takes {
            Ok(true) => {}
            Ok(false) => {
                eprintln!("{}: no daemon takes jobs yet; it is read by the first that does", handed.id);
                return 0;
            }
            Err(error) => return complain(&error.into()),
        }
        match look(state, handed) {
            Err(error) => return complain(&error.into()),
            Ok(Found::Rejected(reason)) => return refused(&reason),
            Ok(Found::Job(job)) => {
                eprintln!("{}: {}", job.id, job.state);
                return 0;
            }
            Ok(Found::Nothing) if begun.elapsed() > VERDICT_WITHIN => {
                let seconds = VERDICT_WITHIN.as_secs();
                eprintln!(
                    "{}: not read within {seconds} s: others are before it, or the queue is full; see `celld \
                     status`",
                    handed.id
                );
                return 0;
            }
            Ok(Found::Nothing) => std::thread::sleep(LOOK_EVERY),
        }
    }
}

/// The daemon still waits for the robot, and reads no jobs.
fn is_starting(state: &StateFolder) -> bool {
    Status::read(&state.status()).ok().flatten().is_none_or(|status| status.state == STARTING)
}

fn refused(reason: &str) -> u8 {
    outln!("rejected: {reason}");
    2
}

/// Waits for the job's end.
fn follow(state: &StateFolder, handed: &Handed) -> u8 {
    match state.is_taken() {
        Ok(true) => {}
        Ok(false) => eprintln!("no daemon runs on {}; the job waits for one", state.root().display()),
        Err(error) => return complain(&error.into()),
    }
    let mut last = None;
    loop {
        match look(state, handed) {
            Err(error) => return complain(&error.into()),
            Ok(Found::Nothing) => {}
            Ok(Found::Rejected(reason)) => return refused(&reason),
            Ok(Found::Job(job)) => {
                if let JobState::Ended(status) = job.state {
                    return report_end(&job, status);
                }
                if last != Some(job.state) {
                    eprintln!("{}: {}", job.id, job.state);
                    last = Some(job.state);
                }
            }
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

fn report_end(job: &JobRecord, status: JobStatus) -> u8 {
    match &job.result {
        Some(result) => cell_edge::terminal::print(&result.to_yaml()),
        None => outln!("{}: {status}", job.id),
    }
    if status == JobStatus::Done { 0 } else { 1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::job_file::{JobContext, read_for_spool};
    use crate::jobs::journal::Journal;
    use crate::jobs::spool::{Spool, SpoolSettings};
    use cell_edge::files::create_folder;
    use cell_machine::orders::Approval;
    use cell_values::time::Timestamp;

    const NOW: f64 = 1_795_248_000.0;

    fn no_goal(_: &str) -> Result<String, String> {
        Err("none".into())
    }

    #[test]
    fn a_wrong_job_is_not_handed_in() {
        let folder = tempfile::tempdir().unwrap();
        let job = folder.path().join("job.yaml");
        std::fs::write(&job, "version: 1\n").unwrap();
        let state = StateArg { state: Some(folder.path().join("state")) };
        assert_eq!(
            submit(&SubmitArgs { job: job.clone(), wait: false, config: None, state: state.clone() }),
            2
        );
        assert!(!state.folder().incoming().exists());
        std::fs::write(&job, "version: 1\ngoal: {file: goal.yaml}\n").unwrap();
        assert_eq!(
            submit(&SubmitArgs { job: job.clone(), wait: false, config: None, state: state.clone() }),
            2
        );
        std::fs::write(folder.path().join("goal.yaml"), "objects:\n  - {id: a, pose: [0, 0, 0]}\n").unwrap();
        assert_eq!(submit(&SubmitArgs { job, wait: false, config: None, state: state.clone() }), 0);
        assert_eq!(std::fs::read_dir(state.folder().incoming()).unwrap().count(), 1);
    }

    #[test]
    fn a_rejection_reaches_whoever_waits() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        create_folder(&state.incoming()).unwrap();
        std::fs::write(state.incoming().join("bad.yaml"), "version: 1\n").unwrap();
        let mut spool = Spool::open(state.root(), SpoolSettings::STANDARD).unwrap();
        let mut journal = Journal::open(&state.journal()).unwrap();
        let context = JobContext { goal: None, approval: Approval::Never, read_goal: &no_goal, found: None };
        let read = |text: &str, name: &str| read_for_spool(text, name, &context);
        spool.scan(&mut journal, &read, Timestamp::ZERO, NOW).unwrap();
        spool.scan(&mut journal, &read, Timestamp::from_secs_f64(1.0), NOW).unwrap();
        let handed = Handed { id: "x".into(), name: "bad.yaml".into() };
        assert_eq!(follow(&state, &handed), 2);
    }
}
