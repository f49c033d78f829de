//! `celld fleet submit`: a job file into the queue of a fleet.
//!
//! In: a job file, for whom it is. Out: the job's id on stdout; with `--each label=NAME` one job for each
//! cell that has the label, a campaign. A goal file is read here, and its poses go with the job: it names no
//! file.

use crate::cli::check::folder_of;
use crate::cli::fleet::reach::{Failure, ReachArgs};
use crate::cli::task::outln;
use crate::jobs::goal::find_goal_file;
use crate::jobs::job_file::job_yaml;
use crate::jobs::record::JobSpec;
use crate::jobs::submit::prepare;
use crate::jobs::utc;
use cell_edge::clock::unix_now_s;
use cell_edge::files::read_regular;
use cell_fleet::client::{Client, Shown};
use cell_fleet::payloads::{JOB_TEXT_MAX, Job, sha256};
use cell_fleet::subjects::{Lane, Priority, Target};
use clap::Args;
use std::path::{Path, PathBuf};

/// Arguments of `celld fleet submit`.
#[derive(Args, Debug)]
pub struct SubmitArgs {
    /// The job file
    job: PathBuf,
    /// Which cell does it: cell=NAME, label=NAME, or any
    #[arg(long, value_name = "TARGET", default_value = "any", conflicts_with = "each")]
    to: String,
    /// Every cell with this label does it once: label=NAME, or any
    #[arg(long, value_name = "LABEL")]
    each: Option<String>,
    /// What is done first: urgent, normal or later [default: by the number in the job file]
    #[arg(long, value_name = "WORD")]
    priority: Option<String>,
    #[command(flatten)]
    reach: ReachArgs,
}

fn usage(message: impl Into<String>) -> Failure {
    Failure::Usage(message.into())
}

/// The job with the id that it states or one that is made of its name, the time and its content; its text
/// states that id and names no file.
fn whole_job(path: &Path) -> Result<(String, JobSpec), Failure> {
    let source = path.display().to_string();
    let most = JOB_TEXT_MAX as u64;
    let text = read_regular(path, most).map_err(|error| usage(format!("{source}: {error}")))?.0;
    let read_goal = |name: &str| find_goal_file(&folder_of(path), None, name);
    let (spec, text) = prepare(&text, &source, &read_goal).map_err(usage)?;
    if spec.restore.is_some() {
        return Err(usage(format!("{source}: `restore` names a job of one cell; name its poses instead")));
    }
    let now = unix_now_s();
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
    let stem: String = stem.chars().map(plain).take(30).collect();
    let hash: String = sha256(&text).chars().take(8).collect();
    let id = spec.id.clone().unwrap_or_else(|| format!("{stem}-{}-{hash}", utc::compact(now)));
    Ok((id, spec))
}

/// The payload of a job under an id.
fn payload(id: &str, spec: &JobSpec, campaign: Option<&str>) -> Result<Job, Failure> {
    let stated = JobSpec { id: Some(id.to_string()), rerun: false, ..spec.clone() };
    let job = Job {
        not_before_unix_s: spec.not_before_unix_s,
        campaign: campaign.map(str::to_string),
        ..Job::new(id, &job_yaml(&stated), unix_now_s())
    };
    job.check().map_err(|fault| usage(fault.to_string()))?;
    Ok(job)
}

/// # Errors
/// One sentence for the terminal: what is wrong with the arguments, the server or the answer.
pub async fn submit(args: &SubmitArgs) -> Result<(), Failure> {
    let (id, spec) = whole_job(&args.job)?;
    let priority = match &args.priority {
        Some(word) => Priority::of(word)
            .ok_or_else(|| usage(format!("{word:?} is no priority: urgent, normal or later")))?,
        None => Priority::of_number(spec.priority),
    };
    let text = args.each.as_deref().unwrap_or(&args.to);
    let target = Target::parse(text)
        .ok_or_else(|| usage(format!("{text:?} names no cells: write cell=NAME, label=NAME, or any")))?;
    // Before anything goes over the network.
    let job = payload(&id, &spec, None)?;
    let client = args.reach.client().await?;
    let cells = client.cells().await?;
    let meant: Vec<&Shown> =
        cells.iter().filter(|cell| target.includes(&cell.name, &cell.state.labels)).collect();
    if args.each.is_some() {
        return campaign(&client, &id, &spec, priority, &meant).await;
    }
    if meant.is_empty() {
        eprintln!("{id}: no cell of the fleet is {target} yet; the job waits for one");
    }
    put(&client, &job, &Lane { priority, target }).await
}

async fn campaign(
    client: &Client,
    id: &str,
    spec: &JobSpec,
    priority: Priority,
    cells: &[&Shown],
) -> Result<(), Failure> {
    if cells.is_empty() {
        return Err(Failure::Failed("no cell of the fleet has this label".to_string()));
    }
    let mut faults = Vec::new();
    for cell in cells {
        let job = payload(&format!("{id}.{}", cell.name), spec, Some(id))?;
        let target = Target::Cell(cell.name.clone());
        // One that does not get its job keeps none from the others.
        match put(client, &job, &Lane { priority, target }).await {
            Ok(()) => {}
            Err(Failure::Usage(fault) | Failure::Failed(fault)) => {
                faults.push(format!("{}: {fault}", cell.name));
            }
            Err(stopped @ Failure::Stopped) => return Err(stopped),
        }
    }
    if faults.is_empty() {
        return Ok(());
    }
    Err(Failure::Failed(faults.join("\n")))
}

async fn put(client: &Client, job: &Job, lane: &Lane) -> Result<(), Failure> {
    let new = client.submit(job, lane).await?;
    outln!("{}", job.id);
    if !new {
        eprintln!("{}: it was in the queue already; it is done once", job.id);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tidy up.yaml");
        std::fs::write(&path, text).unwrap();
        std::fs::write(folder.path().join("goal.yaml"), "objects:\n  - {id: a, pose: [0.1, 0.2, 0]}\n")
            .unwrap();
        (folder, path)
    }

    #[test]
    fn a_job_goes_with_its_goal_and_states_its_id() {
        let (_folder, path) = file("version: 1\ngoal: {file: goal.yaml}\npriority: 3\n");
        let (id, spec) = whole_job(&path).ok().unwrap();
        assert!(id.starts_with("tidy_up-"), "{id}");
        let job = payload(&id, &spec, Some("week")).ok().unwrap();
        assert!(job.text.contains(&format!("id: \"{id}\"")) && !job.text.contains("file:"), "{}", job.text);
        assert!(job.text.contains("{id: \"a\"") && job.campaign.as_deref() == Some("week"), "{}", job.text);
        let (again, spec) = whole_job(&path).ok().unwrap();
        assert_eq!(Priority::of_number(spec.priority), Priority::Urgent);
        assert_eq!(again.rsplit_once('-').unwrap().1, id.rsplit_once('-').unwrap().1, "the same content");
    }

    #[test]
    fn what_names_something_of_one_cell_or_is_too_large_is_refused_here() {
        let (_folder, path) = file("version: 1\ngoal: {restore: monday}\n");
        assert!(matches!(whole_job(&path), Err(Failure::Usage(message)) if message.contains("restore")));
        let (_folder, path) =
            file(&format!("version: 1\n# {}\ngoal: {{look: true}}\n", "a".repeat(10_000_000)));
        assert!(matches!(whole_job(&path), Err(Failure::Usage(_))));
    }
}
