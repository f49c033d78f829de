//! What has happened to jobs: `celld jobs`, `celld why`, `celld report`.
//!
//! In: the state folder; for a report also the configuration, which has the shapes of the objects. Out: a
//! table, a story, an HTML page. No daemon is needed, and a running one is not disturbed.

use crate::cli::client::{ClientError, Format, StateArg, complain};
use crate::cli::task::outln;
use crate::config::load::load_cell;
use crate::daemon::job_report::job_report;
use crate::daemon::recordings_folder::recordings_of;
use crate::jobs::history::{JobFilter, planned_moves, since, story};
use crate::jobs::journal::Journal;
use crate::jobs::record::{JobRecord, StepRecord, quoted};
use crate::jobs::state::StateFolder;
use crate::jobs::status::Status;
use crate::jobs::utc;
use crate::report::html::html;
use crate::report::text::{columns, or_dash};
use cell_edge::clock::unix_now_s;
use cell_edge::files::write_whole;
use cell_edge::terminal::in_shell;
use clap::Args;
use std::path::{Path, PathBuf};

/// Arguments of `celld jobs`.
#[derive(Args, Debug)]
pub struct JobsArgs {
    #[command(flatten)]
    state: StateArg,
    /// How many.
    #[arg(long, default_value_t = 20)]
    last: u32,
    /// Only those that failed or were interrupted.
    #[arg(long)]
    failed: bool,
    /// Only those since then: 90s, 30m, 12h, 2d, 1w ago, or a date (2026-11-21, 2026-11-21T08:00:00Z; UTC).
    #[arg(long, value_name = "WHEN")]
    since: Option<String>,
    /// Only those that had to do with this object.
    #[arg(long, value_name = "ID")]
    object: Option<String>,
    /// Table or JSON.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Arguments of `celld why`.
#[derive(Args, Debug)]
pub struct WhyArgs {
    /// The job, or the file in which it came.
    job: String,
    #[command(flatten)]
    state: StateArg,
}

/// Arguments of `celld report`.
#[derive(Args, Debug)]
pub struct ReportArgs {
    /// The job.
    job: String,
    #[command(flatten)]
    state: StateArg,
    /// The cell's configuration, for the shapes of the objects; default: that of the daemon that ran last.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Where the page is written; default: JOB.html.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// `celld jobs`
pub(super) fn jobs(args: &JobsArgs) -> Result<u8, ClientError> {
    let since_unix_s = match args.since.as_deref().map(|text| (text, since(text, unix_now_s()))) {
        Some((text, None)) => {
            eprintln!("--since {text}: write 90s, 30m, 12h, 2d or 1w, or a date such as 2026-11-21");
            return Ok(2);
        }
        Some((_, time)) => time,
        None => None,
    };
    let filter = JobFilter { failed: args.failed, since_unix_s, object: args.object.clone() };
    let records = match journal(&args.state.folder())? {
        Some(journal) => journal.search(&filter, args.last)?,
        None => Vec::new(),
    };
    match args.format {
        Format::Json => outln!("[{}]", records.iter().map(job_json).collect::<Vec<_>>().join(",\n ")),
        Format::Text if records.is_empty() && filter == JobFilter::default() => {
            outln!("no jobs in {}", args.state.folder().root().display());
        }
        Format::Text if records.is_empty() => outln!("no such jobs"),
        Format::Text => {
            let rows = table_rows(&args.state.folder(), &records)?;
            outln!("{}", columns(&["job", "state", "claimed", "moves", "code"], &rows));
        }
    }
    Ok(0)
}

/// The journal to read; `None` before the first daemon has run.
fn journal(state: &StateFolder) -> Result<Option<Journal>, ClientError> {
    let path = state.journal();
    Ok(if path.exists() { Some(Journal::open_to_read(&path)?) } else { None })
}

fn table_rows(state: &StateFolder, records: &[JobRecord]) -> Result<Vec<Vec<String>>, ClientError> {
    let Some(journal) = journal(state)? else { return Ok(Vec::new()) };
    records.iter().map(|job| Ok(job_row(job, &journal.steps(&job.id)?))).collect()
}

fn job_row(job: &JobRecord, steps: &[StepRecord]) -> Vec<String> {
    let result = job.result.as_ref();
    // What a plan had left says more of a job that did not end well than what it made.
    let moves = |made: usize| match planned_moves(job, steps).filter(|planned| *planned > made) {
        Some(planned) => format!("{made} of {planned}"),
        None => made.to_string(),
    };
    vec![
        job.id.clone(),
        job.state.to_string(),
        utc::text(job.claimed_unix_s),
        or_dash(result, |result| moves(result.moves as usize)),
        or_dash(result, |result| result.code.clone()),
    ]
}

fn job_json(job: &JobRecord) -> String {
    let json = |value: Result<String, serde_json::Error>| value.unwrap_or_else(|_| "null".to_owned());
    format!(
        "{{\"id\": {}, \"state\": {}, \"claimed_unix_s\": {}, \"plan\": {}, \"result\": {}}}",
        quoted(&job.id),
        quoted(job.state.as_str()),
        job.claimed_unix_s,
        json(serde_json::to_string(&job.plan)),
        json(serde_json::to_string(&job.result))
    )
}

/// `celld why`
pub(super) fn why(args: &WhyArgs) -> Result<u8, ClientError> {
    let state = args.state.folder();
    let Some(journal) = journal(&state)? else { return Ok(unknown(&args.job)) };
    let job = match journal.job(&args.job)? {
        Some(job) => Some(job),
        None => journal.job_of_file(&args.job)?,
    };
    if let Some(job) = job {
        let is_last = journal.begun_last()?.as_deref() == Some(&job.id);
        cell_edge::terminal::print(&story(&job, &journal.steps(&job.id)?, is_last));
        cell_edge::terminal::print(&more(&state, &job.id)?);
        return Ok(0);
    }
    let stem = |name: &str| format!("{name}.yaml");
    let rejected = match journal.rejection_of_name(&args.job)? {
        Some(rejection) => Some(rejection),
        None => journal.rejection_of_name(&stem(&args.job))?,
    };
    let Some(rejection) = rejected else { return Ok(unknown(&args.job)) };
    outln!("{} was refused ({})\n\n{}", rejection.name, rejection.code, rejection.reason.trim_end());
    Ok(0)
}

/// What hangs on the gripper, whatever job put it there, and what shows more of this one.
fn more(state: &StateFolder, job: &str) -> Result<String, ClientError> {
    let mut lines = Vec::new();
    let status = Status::read(&state.status())?;
    if let Some(Status { holding: Some(held), written_unix_s, .. }) = &status {
        lines.push(match state.is_taken()? {
            true => format!("the gripper now: {held}"),
            false => format!("the gripper when celld was there last, {}: {held}", utc::text(*written_unix_s)),
        });
    }
    let option = format!("--state {}", in_shell(state.root()));
    lines.push(format!("`celld report {job} {option}` makes a page of it with plan and pictures"));
    // Without a readable configuration there is nothing to add: the story is complete.
    let cell = status.and_then(|status| load_cell(Path::new(&status.config)).ok());
    let recorded = cell.and_then(|cell| cell.recording).map(|to| recordings_of(&to.folder, job));
    lines.extend(recorded.iter().flatten().map(|file| {
        format!("`celld replay {} --page {job}-run.html` shows the run moment by moment", in_shell(file))
    }));
    Ok(format!("\n{}\n", lines.join("\n")))
}

fn unknown(job: &str) -> u8 {
    eprintln!("no job and no refused file {job:?} is known; `celld jobs` lists the jobs");
    1
}

/// `celld report`
pub(super) fn report(args: &ReportArgs) -> Result<u8, ClientError> {
    let state = args.state.folder();
    let Some(journal) = journal(&state)? else { return Ok(unknown(&args.job)) };
    let Some(job) = journal.job(&args.job)? else { return Ok(unknown(&args.job)) };
    let last = Status::read(&state.status())?.map(|status| status.config).filter(|path| !path.is_empty());
    let config = args.config.clone().or(last.map(PathBuf::from));
    let Some(config) = config else {
        eprintln!("name the cell's configuration with --config: it has the shapes of the objects");
        return Ok(2);
    };
    let cell = match load_cell(&config) {
        Ok(cell) => cell,
        Err(error) => {
            outln!("{error}");
            return Ok(2);
        }
    };
    let folder = journal.folder_of(&job.id)?.map(|folder| state.root().join("jobs").join(folder));
    let page = html(&job_report(&job, &journal.steps(&job.id)?, &cell, folder.as_deref()));
    let out = args.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}.html", job.id)));
    write_whole(&out, page.as_bytes())?;
    outln!("{}", out.display());
    Ok(0)
}

/// A command of this file, and its exit code.
pub(super) fn code(result: Result<u8, ClientError>) -> u8 {
    result.unwrap_or_else(|error| complain(&error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::journal::NewJob;
    use crate::jobs::record::{GoalPose, JobResult, JobSpec, ObjectResult, PlanRecord, PlanStep, StepKind};
    use cell_edge::files::FileIdentity;
    use cell_machine::code::JobStatus;
    use rearrange::geometry::pose::Pose2;

    fn state_of(folder: &Path) -> StateArg {
        StateArg { state: Some(folder.to_path_buf()) }
    }

    /// A journal with one job that was carried out in the example's cell.
    fn with_a_job(folder: &Path) -> StateArg {
        let state = state_of(folder);
        let mut journal = Journal::open(&state.folder().journal()).unwrap();
        let goal = GoalPose { id: "plank-1".into(), pose: Pose2::new(0.25, 0.4, 0.0) };
        let spec = JobSpec { goal: vec![goal.clone()], ..JobSpec::default() };
        let source = FileIdentity { device: 1, inode: 2, size: 3, modified_ns: 4 };
        let job = NewJob { id: "tidy", name: "tidy.yaml", sha256: "00", text: "", spec: &spec, source };
        journal.claim(&job, 1.7e9).unwrap();
        journal.start("tidy", 1.7e9).unwrap();
        let at = GoalPose { pose: Pose2::new(0.1, 0.1, 0.0), ..goal.clone() };
        journal.found("tidy", std::slice::from_ref(&at), std::slice::from_ref(&goal), 1.7e9).unwrap();
        let step = PlanStep { object: "plank-1".into(), from: at.pose, to: goal.pose, kind: StepKind::Goal };
        let plan = PlanRecord {
            number: 1,
            steps: vec![step],
            lower_bound: Some(1.0),
            seconds: Some(8.0),
            table: vec![at],
            preview: false,
            made: 0,
            sight_age_s: 0.0,
            unix_s: 1.7e9,
        };
        journal.planned("tidy", &plan).unwrap();
        let result = JobResult {
            id: "tidy".into(),
            status: JobStatus::Failed,
            code: "vacuum_lost".into(),
            message: "plank-1 was lost".into(),
            hint: "see where it lies".into(),
            moves: 0,
            lower_bound: Some(1.0),
            seconds: 9.0,
            times: Default::default(),
            links_off_mm: None,
            objects: vec![ObjectResult::new("plank-1", Some(goal.pose), None)],
        };
        journal.finish("tidy", &result, 1.7e9 + 9.0).unwrap();
        state
    }

    #[test]
    fn a_job_s_page_has_its_reason_its_plan_and_its_table() {
        let folder = tempfile::tempdir().unwrap();
        let state = with_a_job(folder.path());
        let out = folder.path().join("page.html");
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml");
        let args = |job: &str, config: Option<PathBuf>| ReportArgs {
            job: job.into(),
            state: state.clone(),
            config,
            out: Some(out.clone()),
        };
        assert_eq!(report(&args("tidy", Some(config.clone()))).unwrap(), 0);
        let page = std::fs::read_to_string(&out).unwrap();
        for wanted in
            ["plank-1 was lost (vacuum_lost)", "see where it lies", "marker-end", "goal not reached"]
        {
            assert!(page.contains(wanted), "{wanted}");
        }
        assert_eq!(report(&args("other", Some(config))).unwrap(), 1);
        assert_eq!(report(&args("tidy", None)).unwrap(), 2, "no daemon has said where its configuration is");
    }

    #[test]
    fn a_job_s_row_has_the_moves_made_and_planned() {
        let folder = tempfile::tempdir().unwrap();
        let state = with_a_job(folder.path()).folder();
        let records = journal(&state).unwrap().unwrap().search(&JobFilter::default(), 5).unwrap();
        let rows = table_rows(&state, &records).unwrap();
        assert_eq!(rows.first().map(|row| row[3].as_str()), Some("0 of 1"), "{rows:?}");
    }

    #[test]
    fn after_the_story_comes_what_hangs_on_the_gripper_and_where_more_is_shown() {
        let folder = tempfile::tempdir().unwrap();
        let state = with_a_job(folder.path()).folder();
        assert!(!more(&state, "tidy").unwrap().contains("gripper"), "nothing is known of it");
        let status = Status { holding: Some("holds lid".into()), written_unix_s: 1.7e9, ..Status::default() };
        status.write(&state.status()).unwrap();
        let text = more(&state, "tidy").unwrap();
        assert!(text.contains("when celld was there last, 2023-11-14T22:13:20Z: holds lid"), "{text}");
        assert!(text.contains("`celld report tidy --state "), "{text}");
        let _lock = state.take(&status).unwrap();
        assert!(more(&state, "tidy").unwrap().contains("the gripper now: holds lid"));
    }

    #[test]
    fn a_job_is_found_by_its_id_and_by_its_file_and_what_is_unknown_is_exit_1() {
        let folder = tempfile::tempdir().unwrap();
        let state = with_a_job(folder.path());
        let request = |job: &str| why(&WhyArgs { job: job.into(), state: state.clone() }).unwrap();
        assert_eq!((request("tidy"), request("tidy.yaml"), request("other")), (0, 0, 1));
        let empty = tempfile::tempdir().unwrap();
        let nothing = WhyArgs { job: "tidy".into(), state: state_of(empty.path()) };
        assert_eq!(why(&nothing).unwrap(), 1);
    }
}
