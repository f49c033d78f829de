//! A job handed to the daemon through the state folder, and what has become of it since.
//!
//! In: the text of a job file, the state folder. Out: the job in `incoming`, written whole and renamed, with
//! the id that the daemon will give it; later, what the journal says of it. A goal file is read here and its
//! poses go into what is handed in, so that it need not be where the daemon looks.

use crate::jobs::job_file::{JobContext, ReadGoal, job_yaml, read_job};
use crate::jobs::journal::{Journal, JournalError};
use crate::jobs::record::{JobRecord, JobSpec};
use crate::jobs::spool::id_of_file;
use crate::jobs::state::StateFolder;
use crate::jobs::utc;
use cell_edge::files::{FileError, create_folder, write_new};
use cell_machine::orders::Approval;
use rearrange::document::parse;
use sha2::{Digest, Sha256};
use std::path::Path;

/// The job and the text to hand in: verbatim, unless a goal file has to be taken in.
///
/// # Errors
/// Every complaint about the job and its goal file.
pub fn prepare(text: &str, source: &str, read_goal: &ReadGoal) -> Result<(JobSpec, String), String> {
    let context = JobContext { goal: None, approval: Approval::Never, read_goal, found: None };
    let job = read_job(text, source, &context).map_err(|complaints| complaints.to_string())?;
    let names_a_file =
        parse(text, source).is_ok_and(|node| node.get("goal").is_some_and(|goal| goal.get("file").is_some()));
    let text = if names_a_file { job_yaml(&job) } else { text.to_owned() };
    Ok((job, text))
}

/// A job that was handed in.
#[derive(Debug)]
pub struct Handed {
    /// Its id.
    pub id: String,
    /// Its file in `incoming`.
    pub name: String,
}

/// Writes the job into `incoming` under a name of its own, from which the daemon makes the same id as here.
///
/// # Errors
/// What the system refused.
pub fn hand_in(
    state: &StateFolder,
    path: &Path,
    job: &JobSpec,
    text: &str,
    unix_s: f64,
) -> Result<Handed, FileError> {
    create_folder(&state.incoming())?;
    let hash = Sha256::digest(text.as_bytes());
    let hash: String = hash.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let base = format!("{}-{}-{hash}", utc::compact(unix_s), self::stem(&stem));
    let names = (1..1000).map(|number| match number {
        1 => format!("{base}.yaml"),
        _ => format!("{base}.{number}.yaml"),
    });
    let name = write_new(&state.incoming(), names, text.as_bytes())?;
    let id = job.id.clone().unwrap_or_else(|| id_of_file(&name, &hash, unix_s));
    Ok(Handed { id, name })
}

/// A name as it is in the name of a job's file in `incoming`.
pub fn stem(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
    name.chars().map(plain).take(30).collect()
}

/// What has become of a job that was handed in.
pub enum Found {
    /// The daemon has not taken it yet.
    Nothing,
    /// It was refused, for this reason.
    Rejected(String),
    /// The daemon knows it.
    Job(Box<JobRecord>),
}

/// Reads in the journal what has become of a job; the daemon need not run.
///
/// # Errors
/// A journal that cannot be read.
pub fn look(state: &StateFolder, handed: &Handed) -> Result<Found, JournalError> {
    if !state.journal().exists() {
        return Ok(Found::Nothing);
    }
    let journal = match Journal::open_to_read(&state.journal()) {
        // The daemon is creating it at this moment.
        Err(JournalError::Version { found: 0, .. }) => return Ok(Found::Nothing),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::job_file::read_for_spool;
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
        let goal = |name: &str| match name {
            "goal.yaml" => Ok("objects:\n  - {id: a, pose: [0, 0, 0]}\n".to_owned()),
            _ => Err("no such file".to_owned()),
        };
        let (job, text) = prepare(text, "tidy up.yaml", &goal).unwrap();
        let handed = hand_in(&state, Path::new("tidy up.yaml"), &job, &text, NOW).unwrap();
        let mut spool = Spool::open(state.root(), SpoolSettings::STANDARD).unwrap();
        let mut journal = Journal::open(&state.journal()).unwrap();
        let context = JobContext { goal: None, approval: Approval::Never, read_goal: &no_goal, found: None };
        let read = |text: &str, name: &str| read_for_spool(text, name, &context);
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
}
