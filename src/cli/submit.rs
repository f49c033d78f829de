//! `celld submit JOB.yaml`: hands a job to the daemon, running or not, and with `--wait` follows it to its
//! end.
//!
//! In: a job file. Out: the job's id on stdout; the file in `incoming`, written whole and renamed. A goal
//! file is read here and its poses go into what is handed in, so that it need not be where the daemon looks.
//! Exit code 0 when handed in (with `--wait`: when done), 1 when the job did not succeed, 2 when it is wrong.

use crate::cell::code::JobStatus;
use crate::cell::orders::Approval;
use crate::cli::check::beside;
use crate::cli::client::{ClientError, StateArg, complain};
use crate::cli::task::outln;
use crate::jobs::job_file::{JobContext, job_yaml, read_job};
use crate::jobs::journal::Journal;
use crate::jobs::record::{JobRecord, JobSpec, JobState};
use crate::jobs::spool::id_of_file;
use crate::jobs::state::StateFolder;
use crate::jobs::utc;
use cell_edge::clock::unix_now_s;
use cell_edge::files::{create_folder, remove, rename_new, temporary_name, write_atomic};
use cell_parts::file::read_text;
use clap::Args;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How often the journal is read for the state of the job.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Arguments of `celld submit`.
#[derive(Args, Debug)]
pub struct SubmitArgs {
    /// The job file.
    job: PathBuf,
    /// Wait until the job has ended, and exit with 1 unless it is done.
    #[arg(long)]
    wait: bool,
    #[command(flatten)]
    state: StateArg,
}

/// Hands in a job and returns the exit code.
pub fn submit(args: &SubmitArgs) -> u8 {
    let source = args.job.display().to_string();
    let read = read_text(&args.job).map_err(|reason| format!("{source}: {reason}"));
    let prepared = read.and_then(|text| prepare(&args.job, &text, &source));
    let (job, text) = match prepared {
        Ok(prepared) => prepared,
        Err(message) => {
            eprintln!("{message}");
            return 2;
        }
    };
    let state = args.state.folder();
    match hand_in(&state, &args.job, &job, &text, unix_now_s()) {
        Err(error) => complain(&error),
        Ok(handed) => {
            outln!("{}", handed.id);
            if args.wait { follow(&state, &handed) } else { 0 }
        }
    }
}

/// The job and the text to hand in: verbatim, unless a goal file has to be taken in.
fn prepare(path: &Path, text: &str, source: &str) -> Result<(JobSpec, String), String> {
    let read_goal = |name: &str| read_text(&beside(path, name));
    let context = JobContext { goal: None, approval: Approval::Never, read_goal: &read_goal };
    let job = read_job(text, source, &context).map_err(|complaints| complaints.to_string())?;
    let names_a_file = rearrange::document::parse(text, source)
        .is_ok_and(|node| node.get("goal").is_some_and(|goal| goal.get("file").is_some()));
    let text = if names_a_file { job_yaml(&job) } else { text.to_owned() };
    Ok((job, text))
}

/// A job that was handed in.
#[derive(Debug)]
struct Handed {
    id: String,
    name: String,
}

/// Writes the job into `incoming` under a name of its own, from which the daemon makes the same id as here.
fn hand_in(
    state: &StateFolder,
    path: &Path,
    job: &JobSpec,
    text: &str,
    unix_s: f64,
) -> Result<Handed, ClientError> {
    create_folder(&state.incoming())?;
    let hash = Sha256::digest(text.as_bytes());
    let hash: String = hash.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
    let stem: String = stem.chars().map(plain).take(30).collect();
    let base = format!("{}-{stem}-{hash}", utc::compact(unix_s));
    let hidden = temporary_name(&state.incoming().join(&base));
    write_atomic(&hidden, text.as_bytes())?;
    let mut number = 1_u32;
    loop {
        let name = if number == 1 { format!("{base}.yaml") } else { format!("{base}.{number}.yaml") };
        match rename_new(&hidden, &state.incoming().join(&name)) {
            Ok(()) => {
                let id = job.id.clone().unwrap_or_else(|| id_of_file(&name, &hash, unix_s));
                return Ok(Handed { id, name });
            }
            Err(error) if error.is_present() && number < 1000 => number += 1,
            Err(error) => {
                remove(&hidden)?;
                return Err(error.into());
            }
        }
    }
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
            Err(error) => return complain(&error),
            Ok(Found::Nothing) => {}
            Ok(Found::Rejected(reason)) => {
                outln!("rejected: {reason}");
                return 2;
            }
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

enum Found {
    Nothing,
    Rejected(String),
    Job(Box<JobRecord>),
}

fn look(state: &StateFolder, handed: &Handed) -> Result<Found, ClientError> {
    if !state.journal().exists() {
        return Ok(Found::Nothing);
    }
    let journal = match Journal::open_to_read(&state.journal()) {
        // The daemon is creating it at this moment.
        Err(crate::jobs::journal::JournalError::Version { found: 0, .. }) => return Ok(Found::Nothing),
        other => other?,
    };
    if let Some(job) = journal.job_of_file(&handed.name)? {
        return Ok(Found::Job(Box::new(job)));
    }
    Ok(match journal.rejection_of_name(&handed.name)? {
        Some(rejection) => Found::Rejected(rejection.reason),
        None => Found::Nothing,
    })
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
    use crate::jobs::spool::{Spool, SpoolEvent, SpoolSettings};
    use cell_values::time::Timestamp;

    const NOW: f64 = 1_795_248_000.0;

    fn no_goal(_: &str) -> Result<String, String> {
        Err("none".into())
    }

    /// Hands the job in, lets a daemon take it, and returns the id reported here and the one given there.
    fn ids(text: &str) -> (String, String) {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path().join("state"));
        let path = folder.path().join("tidy up.yaml");
        std::fs::write(&path, text).unwrap();
        std::fs::write(folder.path().join("goal.yaml"), "objects:\n  - {id: a, pose: [0, 0, 0]}\n").unwrap();
        let (job, text) = prepare(&path, text, "tidy up.yaml").unwrap();
        let handed = hand_in(&state, &path, &job, &text, NOW).unwrap();
        let mut spool = Spool::open(state.root(), SpoolSettings::STANDARD).unwrap();
        let mut journal = Journal::open(&state.journal()).unwrap();
        let context = JobContext { goal: None, approval: Approval::Never, read_goal: &no_goal };
        let read = |text: &str, name: &str| crate::jobs::job_file::read_for_spool(text, name, &context);
        spool.scan(&mut journal, &read, Timestamp::ZERO, NOW + 5.0).unwrap();
        let later = Timestamp::from_secs_f64(1.0);
        let events = spool.scan(&mut journal, &read, later, NOW + 5.0).unwrap();
        let [SpoolEvent::Claimed { id, .. }] = events.as_slice() else { panic!("{events:?}") };
        assert!(matches!(look(&state, &handed), Ok(Found::Job(job)) if job.id == *id));
        (handed.id, id.clone())
    }

    #[test]
    fn the_id_reported_is_the_id_given() {
        let (reported, given) = ids("version: 1\ngoal: {objects: [{id: a, pose: [0, 0, 0]}]}\n");
        assert_eq!(reported, given);
        assert!(reported.starts_with("20261121T080000Z-tidy_up-"), "{reported}");
        let (reported, given) = ids("version: 1\nid: mine\ngoal: {objects: [{id: a, pose: [0, 0, 0]}]}\n");
        assert_eq!((reported.as_str(), given.as_str()), ("mine", "mine"));
    }

    #[test]
    fn a_goal_file_goes_with_the_job() {
        let (reported, given) = ids("version: 1\ngoal: {file: goal.yaml}\n");
        assert_eq!(reported, given);
    }

    #[test]
    fn a_wrong_job_is_not_handed_in() {
        let folder = tempfile::tempdir().unwrap();
        let job = folder.path().join("job.yaml");
        std::fs::write(&job, "version: 1\n").unwrap();
        let state = StateArg { state: folder.path().join("state") };
        assert_eq!(submit(&SubmitArgs { job: job.clone(), wait: false, state: state.clone() }), 2);
        assert!(!state.folder().incoming().exists());
        std::fs::write(&job, "version: 1\ngoal: {objects: [{id: a, pose: [0, 0, 0]}]}\n").unwrap();
        assert_eq!(submit(&SubmitArgs { job, wait: false, state: state.clone() }), 0);
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
        let context = JobContext { goal: None, approval: Approval::Never, read_goal: &no_goal };
        let read = |text: &str, name: &str| crate::jobs::job_file::read_for_spool(text, name, &context);
        spool.scan(&mut journal, &read, Timestamp::ZERO, NOW).unwrap();
        spool.scan(&mut journal, &read, Timestamp::from_secs_f64(1.0), NOW).unwrap();
        let handed = Handed { id: "x".into(), name: "bad.yaml".into() };
        assert_eq!(follow(&state, &handed), 2);
    }
}
