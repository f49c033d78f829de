//! Claims, order, steps and recovery against a database on disk.

use super::*;
use crate::jobs::record::{GoalPose, JobSpec, PlanRecord, PlanStep, StepIntent, StepKind, StepPhase};
use cell_edge::files::FileIdentity;
use cell_machine::code::JobStatus;
use rearrange::geometry::pose::Pose2;

const NOW: f64 = 1_795_248_000.0;

fn spec(priority: i64, not_before_unix_s: Option<f64>, rerun: bool) -> JobSpec {
    JobSpec { priority, not_before_unix_s, rerun, ..JobSpec::default() }
}

fn claim(journal: &mut Journal, id: &str, sha256: &str, spec: &JobSpec) -> Claim {
    let source = FileIdentity { device: 1, inode: 2, size: 3, modified_ns: 4 };
    let job = NewJob { id, name: "job.yaml", sha256, text: "version: 1", spec, source };
    journal.claim(&job, NOW).unwrap()
}

fn intent() -> StepIntent {
    StepIntent {
        object: "mug".into(),
        from: Pose2::default(),
        to: Pose2::new(0.1, 0.2, 0.3),
        kind: StepKind::Goal,
        tool_from_object: Some(Pose2::new(0.01, 0.0, 0.2)),
        table: vec![("lid".into(), Pose2::new(0.4, 0.1, 0.0))],
    }
}

fn folder() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("history.sqlite");
    (folder, path)
}

#[test]
fn a_job_is_claimed_once() {
    let (_folder, path) = folder();
    let mut journal = Journal::open(&path).unwrap();
    let plain = JobSpec { id: Some("a".into()), ..spec(0, None, false) };
    let claimed = |id: &str| Claim::Claimed { id: id.into() };
    assert_eq!(claim(&mut journal, "a", "00", &plain), claimed("a"));
    assert_eq!(claim(&mut journal, "a", "00", &plain), Claim::Duplicate { of: "a".into() });
    assert_eq!(claim(&mut journal, "a", "11", &plain), Claim::Conflict { with: "a".into() });
    let rerun = JobSpec { rerun: true, ..plain.clone() };
    assert_eq!(claim(&mut journal, "a", "00", &rerun), claimed("a.2"));
    assert_eq!(claim(&mut journal, "a", "00", &rerun), claimed("a.3"));
    let nameless = spec(0, None, false);
    assert_eq!(claim(&mut journal, "made-up", "00", &nameless), claimed("made-up"));
    assert_eq!(claim(&mut journal, "made-up", "00", &nameless), claimed("made-up.2"));
    drop(journal);
    let mut journal = Journal::open(&path).unwrap();
    assert_eq!(claim(&mut journal, "a", "00", &plain), Claim::Duplicate { of: "a".into() });
}

#[test]
fn commits_reach_the_disk_before_they_return() {
    let (_folder, path) = folder();
    let journal = Journal::open(&path).unwrap();
    let mode: String = journal.database.query_row("PRAGMA journal_mode", [], |row| row.get(0)).unwrap();
    let synchronous: i64 = journal.database.query_row("PRAGMA synchronous", [], |row| row.get(0)).unwrap();
    assert_eq!((mode.as_str(), synchronous), ("wal", 2));
}

#[test]
fn order_is_priority_then_time_then_arrival() {
    let (_folder, path) = folder();
    let mut journal = Journal::open(&path).unwrap();
    claim(&mut journal, "first", "1", &spec(0, None, false));
    claim(&mut journal, "second", "2", &spec(0, None, false));
    claim(&mut journal, "later", "3", &spec(9, Some(NOW + 60.0), false));
    claim(&mut journal, "urgent", "4", &spec(5, None, false));
    let mut order = Vec::new();
    while let Some(job) = journal.next_ready(NOW).unwrap() {
        journal.start(&job.id, NOW).unwrap();
        journal.finish(&job.id, &result(&job.id, JobStatus::Done), NOW).unwrap();
        order.push(job.id);
    }
    assert_eq!(order, ["urgent", "first", "second"]);
    assert_eq!(journal.next_ready(NOW + 61.0).unwrap().unwrap().id, "later");
}

fn result(id: &str, status: JobStatus) -> JobResult {
    JobResult { lower_bound: Some(f64::NAN), seconds: f64::INFINITY, ..JobResult::sample(id, status) }
}

#[test]
fn one_job_is_active_and_ends_once() {
    let (_folder, path) = folder();
    let mut journal = Journal::open(&path).unwrap();
    for id in ["a", "b"] {
        claim(&mut journal, id, id, &spec(0, None, false));
    }
    journal.start("a", NOW).unwrap();
    assert!(matches!(journal.start("b", NOW), Err(JournalError::WrongState { .. })));
    assert!(matches!(journal.start("c", NOW), Err(JournalError::UnknownJob { .. })));
    journal.finish("a", &result("a", JobStatus::Done), NOW).unwrap();
    let again = journal.finish("a", &result("a", JobStatus::Failed), NOW);
    assert!(matches!(again, Err(JournalError::WrongState { state: "done", .. })));
    assert_eq!(journal.job("a").unwrap().unwrap().result.unwrap().seconds, 0.0);
}

#[test]
fn no_step_begins_while_one_is_open() {
    let (_folder, path) = folder();
    let mut journal = Journal::open(&path).unwrap();
    claim(&mut journal, "a", "1", &spec(0, None, false));
    assert!(journal.step_intent("a", &intent(), NOW).is_err(), "the job is not active yet");
    journal.start("a", NOW).unwrap();
    assert_eq!(journal.last_step().unwrap(), None);
    assert_eq!(journal.step_intent("a", &intent(), NOW).unwrap(), 1);
    assert!(matches!(journal.step_intent("a", &intent(), NOW), Err(JournalError::WrongState { .. })));
    journal.step_gripped("a", 1, NOW).unwrap();
    let last = |journal: &Journal| journal.last_step().unwrap().map(|step| (step.step, step.phase));
    assert_eq!(last(&journal), Some((1, StepPhase::Gripped)));
    assert_eq!(journal.last_step().unwrap().map(|step| step.intent), Some(intent()));
    journal.let_go("it fell", NOW).unwrap();
    assert_eq!(last(&journal), Some((1, StepPhase::Released)));
    assert!(matches!(journal.requeue("a"), Err(JournalError::WrongState { .. })));
    journal.step_done("a", 1, NOW).unwrap();
    assert!(matches!(journal.step_done("a", 1, NOW), Err(JournalError::WrongStep { step: 1, .. })));
    assert_eq!(journal.step_intent("a", &intent(), NOW).unwrap(), 2);
    journal.step_abandoned("a", 2, NOW).unwrap();
    journal.let_go("it fell", NOW).unwrap();
    assert_eq!(last(&journal), Some((2, StepPhase::Abandoned)), "nothing was gripped");
    assert_eq!(journal.step_intent("a", &intent(), NOW).unwrap(), 3);
}

#[track_caller]
fn check_recovery(steps: impl FnOnce(&mut Journal), expected: &str) {
    let (_folder, path) = folder();
    let mut journal = Journal::open(&path).unwrap();
    claim(&mut journal, "other", "0", &spec(9, None, false));
    claim(&mut journal, "a", "1", &spec(0, None, false));
    journal.start("a", NOW).unwrap();
    steps(&mut journal);
    drop(journal);
    let mut journal = Journal::open(&path).unwrap();
    journal.recover(NOW).unwrap();
    assert!(journal.recover(NOW).unwrap().is_empty(), "recovery is done once");
    let job = journal.job("a").unwrap().unwrap();
    let code = job.result.map(|result| result.code).unwrap_or_default();
    assert_eq!(format!("{} {code}", job.state).trim(), expected);
    let next = journal.next_ready(NOW).unwrap().unwrap().id;
    assert_eq!(next, if expected == "waiting" { "a" } else { "other" });
}

#[test]
fn after_a_crash_only_a_job_at_rest_goes_on() {
    let intend = |journal: &mut Journal| journal.step_intent("a", &intent(), NOW).unwrap();
    check_recovery(|_| {}, "waiting");
    check_recovery(
        |journal| {
            intend(journal);
        },
        "interrupted interrupted",
    );
    check_recovery(
        |journal| {
            intend(journal);
            journal.step_gripped("a", 1, NOW).unwrap();
        },
        "interrupted interrupted_carrying",
    );
    check_recovery(
        |journal| {
            intend(journal);
            journal.step_released("a", 1, NOW).unwrap();
        },
        "interrupted interrupted",
    );
    check_recovery(
        |journal| {
            intend(journal);
            journal.step_done("a", 1, NOW).unwrap();
        },
        "waiting",
    );
}

#[test]
fn what_is_found_planned_and_approved_is_there_after_a_restart() {
    let (_folder, path) = folder();
    let mut journal = Journal::open(&path).unwrap();
    claim(&mut journal, "a", "1", &spec(0, None, false));
    journal.start("a", NOW).unwrap();
    let pose = |x: f64| vec![GoalPose { id: "mug".into(), pose: Pose2::new(x, 0.2, 0.3) }];
    journal.found("a", &pose(0.1), &pose(0.4), NOW + 1.0).unwrap();
    journal.found("a", &pose(0.8), &pose(0.9), NOW + 2.0).unwrap();
    assert_eq!(journal.job("a").unwrap().unwrap().agreed(), [], "nothing is planned yet");
    let step = PlanStep {
        object: "mug".into(),
        from: Pose2::new(0.1, 0.2, 0.3),
        to: Pose2::new(0.4, 0.2, 0.3),
        kind: StepKind::Buffer,
    };
    let plan = PlanRecord {
        number: 1,
        steps: vec![step.clone()],
        lower_bound: None,
        seconds: Some(8.5),
        table: pose(0.1),
        preview: true,
        made: 0,
        sight_age_s: 40.0,
        unix_s: NOW,
    };
    assert_eq!(journal.highest_plan().unwrap(), 0);
    journal.planned("a", &plan).unwrap();
    journal.planned("a", &PlanRecord { number: 7, ..plan.clone() }).unwrap();
    assert_eq!(journal.highest_plan().unwrap(), 7);
    journal.planned("a", &plan).unwrap();
    journal.approve("a", NOW + 3.0).unwrap();
    journal.planned("a", &PlanRecord { steps: Vec::new(), ..plan.clone() }).unwrap();
    drop(journal);
    let job = Journal::open_to_read(&path).unwrap().job("a").unwrap().unwrap();
    assert_eq!(
        (job.found.clone(), job.resolved.clone()),
        (pose(0.1), Some(pose(0.4))),
        "the first look counts"
    );
    assert_eq!(job.agreed(), [step], "what was approved, not what was planned later");
    let times = (job.found_unix_s, job.approved_unix_s);
    assert_eq!(times, (Some(NOW + 1.0), Some(NOW + 3.0)), "of the first look, of the approval");
    assert_eq!(job.plan.map(|plan| plan.steps.len()), Some(0));
}

#[test]
fn jobs_are_found_by_their_end_their_time_and_their_objects() {
    let (_folder, path) = folder();
    let mut journal = Journal::open(&path).unwrap();
    let goal = vec![GoalPose { id: "cap".into(), pose: Pose2::default() }];
    let with_cap = JobSpec { goal, ..JobSpec::default() };
    for (id, spec) in [("a", &spec(0, None, false)), ("b", &with_cap), ("c", &spec(0, None, false))] {
        claim(&mut journal, id, id, spec);
        journal.start(id, NOW).unwrap();
        if id == "a" {
            journal.step_intent("a", &intent(), NOW).unwrap();
        }
        if id == "c" {
            journal.found("c", &[], &with_cap.goal, NOW).unwrap();
        }
        let end = if id == "b" { JobStatus::Failed } else { JobStatus::Done };
        journal.finish(id, &result(id, end), NOW).unwrap();
    }
    let found = |filter: JobFilter| -> Vec<String> {
        journal.search(&filter, 10).unwrap().into_iter().map(|job| job.id).collect()
    };
    assert_eq!(found(JobFilter::default()), ["c", "b", "a"]);
    assert_eq!(found(JobFilter { failed: true, ..JobFilter::default() }), ["b"]);
    assert_eq!(found(JobFilter { since_unix_s: Some(NOW), ..JobFilter::default() }).len(), 3);
    assert_eq!(found(JobFilter { since_unix_s: Some(NOW + 1.0), ..JobFilter::default() }).len(), 0);
    let of = |object: &str| found(JobFilter { object: Some(object.into()), ..JobFilter::default() });
    assert_eq!((of("mug"), of("cap")), (vec!["a".to_string()], vec!["c".to_string(), "b".to_string()]));
}

#[test]
fn a_database_of_version_1_is_read_as_it_is_and_brought_up_by_the_daemon() {
    let (_folder, path) = folder();
    let fixture = include_str!("version-1.sql");
    rusqlite::Connection::open(&path).unwrap().execute_batch(fixture).unwrap();
    let check = |journal: &Journal| {
        let jobs = journal.latest(10).unwrap();
        let ids: Vec<_> = jobs.iter().map(|job| (job.id.as_str(), job.state.as_str())).collect();
        assert_eq!(ids, [("waits", "waiting"), ("tidy", "done")]);
        assert_eq!(jobs[1].result.as_ref().map(|result| result.moves), Some(1));
        assert_eq!(jobs[1].agreed(), [], "version 1 has another word there");
        assert_eq!(journal.steps("tidy").unwrap().len(), 1);
        assert_eq!(
            journal
                .search(&JobFilter { object: Some("mug".into()), ..JobFilter::default() }, 9)
                .unwrap()
                .len(),
            2
        );
    };
    check(&Journal::open_to_read(&path).unwrap());
    let mut journal = Journal::open(&path).unwrap();
    check(&journal);
    journal.start("waits", NOW).unwrap();
    journal.found("waits", &[], &[], NOW).unwrap();
    drop(journal);
    let mut journal = Journal::open(&path).unwrap();
    assert_eq!(journal.read_version().unwrap(), SCHEMA_VERSION);
    // What an older celld found has no time, whatever a second look shows.
    journal.database.execute_batch("UPDATE jobs SET found_at = NULL").unwrap();
    journal.found("waits", &[], &[], NOW + 9.0).unwrap();
    assert_eq!(journal.job("waits").unwrap().unwrap().found_unix_s, None);
}

#[test]
fn a_database_of_any_version_is_read_as_it_is_and_brought_up() {
    for version in 2..SCHEMA_VERSION {
        let (_folder, path) = folder();
        let database = rusqlite::Connection::open(&path).unwrap();
        database.execute_batch(include_str!("version-1.sql")).unwrap();
        for older in 1..version {
            database.execute_batch(MIGRATIONS[older as usize - 1]).unwrap();
        }
        database.execute_batch(&format!("PRAGMA user_version={version}")).unwrap();
        drop(database);
        let check = |journal: &Journal| {
            let job = journal.job("tidy").unwrap().unwrap();
            assert_eq!((job.found_unix_s, job.approved_unix_s), (None, None));
            assert_eq!(journal.steps("tidy").unwrap().len(), 1);
        };
        check(&Journal::open_to_read(&path).unwrap());
        let journal = Journal::open(&path).unwrap();
        check(&journal);
        assert_eq!(journal.read_version().unwrap(), SCHEMA_VERSION, "from {version}");
    }
}

#[test]
fn another_schema_version_is_refused() {
    let (_folder, path) = folder();
    Journal::open(&path).unwrap().database.execute_batch("PRAGMA user_version=7").unwrap();
    assert!(matches!(Journal::open(&path), Err(JournalError::Version { found: 7, .. })));
    assert!(matches!(Journal::open_to_read(&path), Err(JournalError::Version { found: 7, .. })));
}

#[test]
fn a_reader_sees_jobs_beside_the_daemon_and_changes_nothing() {
    let (_folder, path) = folder();
    let mut journal = Journal::open(&path).unwrap();
    claim(&mut journal, "a", "1", &spec(0, None, false));
    let mut reader = Journal::open_to_read(&path).unwrap();
    assert_eq!(reader.latest(10).unwrap().len(), 1);
    assert!(reader.start("a", NOW).is_err());
}

#[test]
fn a_journal_at_rest_is_read_as_one_that_does_not_change() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a folder with % and ?.sqlite");
    let mut journal = Journal::open(&path).unwrap();
    claim(&mut journal, "a", "00", &spec(0, None, false));
    drop(journal);
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI;
    let reader = Journal::read_as(&path, &unchanging(&path), flags).unwrap();
    assert_eq!(reader.latest(10).unwrap().len(), 1);
    assert!(!beside(&path, "-shm").exists(), "nothing was created for it");
}
