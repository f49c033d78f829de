//! The life of job files, with a reader of its own and a clock turned by hand; crashes at every point.

use super::*;
use crate::jobs::journal::old::HistoryLimits;
use crate::jobs::journal::{Journal, Recovered};
use crate::jobs::record::{JobResult, JobState, StepIntent, StepKind};
use cell_machine::code::JobStatus;
use rearrange::geometry::pose::Pose2;
use std::fs;

const NOW: f64 = 1_795_248_000.0;

/// Accepts text that begins with `goal`; `id X` on a line of its own names the job, `open` at the end of the
/// text makes it incomplete.
fn read(text: &str, _name: &str) -> Result<JobSpec, Refusal> {
    if !text.starts_with("goal") {
        let mut refusal = Refusal::new(Code::Invalid, "1 complaint", "correct the file");
        refusal.incomplete = text.ends_with("open");
        refusal.complaints.push(RefusalDetail {
            path: "goal".into(),
            line: 1,
            column: 1,
            message: "missing".into(),
            help: String::new(),
        });
        return Err(refusal);
    }
    Ok(JobSpec {
        id: text.lines().find_map(|line| line.strip_prefix("id ")).map(str::to_owned),
        ..JobSpec::default()
    })
}

struct Bench {
    state: tempfile::TempDir,
    spool: Spool,
    journal: Journal,
}

impl Bench {
    fn new() -> Bench {
        // In memory where there is such a folder: the sweep below syncs some ten thousand times.
        let state = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
        let spool = Spool::open(state.path(), SpoolSettings::STANDARD).unwrap();
        let journal = Journal::open(&state.path().join("history.sqlite")).unwrap();
        Bench { state, spool, journal }
    }

    /// The process ends and another one starts.
    fn restart(self) -> Bench {
        let Bench { state, spool, journal } = self;
        drop((spool, journal));
        let mut spool = Spool::open(state.path(), SpoolSettings::STANDARD).unwrap();
        let mut journal = Journal::open(&state.path().join("history.sqlite")).unwrap();
        journal.recover(NOW).unwrap();
        spool.reconcile_at_start(&mut journal).unwrap();
        Bench { state, spool, journal }
    }

    fn drop_file(&self, name: &str, text: &str) {
        fs::write(self.spool.incoming().join(name), text).unwrap();
    }

    fn scan(&mut self, at_ms: u64) -> Vec<SpoolEvent> {
        let now = Timestamp::ZERO + Duration::from_millis(at_ms);
        self.spool.scan(&mut self.journal, &read, now, NOW).unwrap()
    }

    /// Paths below `jobs`, files only.
    fn files(&self) -> Vec<String> {
        let jobs = self.state.path().join("jobs");
        let mut open = vec![jobs.clone()];
        let mut files = Vec::new();
        while let Some(folder) = open.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.symlink_metadata().unwrap().is_dir() {
                    open.push(path);
                } else {
                    files.push(path.strip_prefix(&jobs).unwrap().to_string_lossy().into_owned());
                }
            }
        }
        files.sort();
        files
    }
}

#[track_caller]
fn check_rejected(events: &[SpoolEvent], expected_name: &str, expected_code: Code) {
    match events {
        [SpoolEvent::Rejected { name, code, reason, .. }] => {
            assert_eq!((name.as_str(), *code), (expected_name, expected_code));
            let text = fs::read_to_string(reason).unwrap();
            assert!(text.contains(&format!("code: \"{expected_code}\"")), "{text}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_file_is_taken_once_it_settled() {
    let mut bench = Bench::new();
    bench.drop_file("tidy.yaml", "goal");
    assert!(bench.scan(0).is_empty());
    assert!(bench.scan(400).is_empty());
    bench.drop_file("tidy.yaml", "goal, longer");
    assert!(bench.scan(600).is_empty(), "it changed: the settle time begins again");
    assert!(bench.scan(1000).is_empty());
    let events = bench.scan(1100);
    let [SpoolEvent::Claimed { id, name }] = events.as_slice() else { panic!("{events:?}") };
    assert_eq!(name, "tidy.yaml");
    assert!(id.starts_with("20261121T080000Z-tidy-"), "{id}");
    assert_eq!(bench.files(), [format!("hold/{id}/job.yaml")]);
    assert_eq!(bench.journal.job(id).unwrap().unwrap().text, "goal, longer");
    assert!(bench.scan(5000).is_empty());
}

#[test]
fn a_bad_file_lies_beside_its_reason() {
    let mut bench = Bench::new();
    for round in 0..2 {
        bench.drop_file("bad.yaml", "gaol");
        bench.scan(round * 10_000);
        check_rejected(&bench.scan(round * 10_000 + 500), "bad.yaml", Code::Invalid);
    }
    assert_eq!(
        bench.files(),
        [
            "rejected/bad.2.yaml",
            "rejected/bad.2.yaml.reason.yaml",
            "rejected/bad.yaml",
            "rejected/bad.yaml.reason.yaml"
        ]
    );
}

#[test]
fn a_file_that_ends_in_the_middle_is_given_time() {
    let mut bench = Bench::new();
    bench.drop_file("slow.yaml", "{open");
    bench.scan(0);
    assert!(bench.scan(600).is_empty());
    bench.drop_file("slow.yaml", "goal {open, closed}");
    bench.scan(1000);
    assert!(matches!(bench.scan(1500).as_slice(), [SpoolEvent::Claimed { .. }]));
    bench.drop_file("torn.yaml", "{open");
    bench.scan(10_000);
    assert!(bench.scan(11_900).is_empty());
    check_rejected(&bench.scan(12_000), "torn.yaml", Code::Incomplete);
}

#[test]
fn what_is_no_plain_file_stays_and_is_reported_once() {
    let mut bench = Bench::new();
    let incoming = bench.spool.incoming();
    bench.drop_file(".hidden.yaml", "goal");
    bench.drop_file("upload.yaml.part", "goal");
    fs::write(bench.state.path().join("secret"), "goal").unwrap();
    std::os::unix::fs::symlink(bench.state.path().join("secret"), incoming.join("link.yaml")).unwrap();
    check_rejected(&bench.scan(0), "link.yaml", Code::NotAPlainFile);
    assert!(bench.scan(10_000).is_empty());
    fs::create_dir(incoming.join("folder.yaml")).unwrap();
    check_rejected(&bench.scan(10_100), "folder.yaml", Code::NotAPlainFile);
    fs::write(incoming.join("folder.yaml/inside"), "goal").unwrap();
    assert!(bench.scan(20_000).is_empty(), "the same folder with other content");
    fs::hard_link(bench.state.path().join("secret"), incoming.join("hard.yaml")).unwrap();
    bench.scan(30_000);
    check_rejected(&bench.scan(31_000), "hard.yaml", Code::NotAPlainFile);
    let mut bench = bench.restart();
    bench.scan(0);
    assert!(bench.scan(10_000).is_empty(), "a restart does not report them again");
    let left: Vec<_> = bench.files().into_iter().filter(|file| file.starts_with("incoming")).collect();
    let expected = [".hidden.yaml", "folder.yaml/inside", "hard.yaml", "link.yaml", "upload.yaml.part"];
    assert_eq!(left, expected.map(|name| format!("incoming/{name}")));
}

#[test]
fn odd_names_and_contents_are_refused() {
    let mut bench = Bench::new();
    bench.drop_file("two words.yaml", "goal");
    bench.scan(0);
    check_rejected(&bench.scan(500), "two words.yaml", Code::BadName);
    fs::write(bench.spool.incoming().join("bytes.yaml"), [0xff_u8; 4]).unwrap();
    bench.scan(1000);
    check_rejected(&bench.scan(1500), "bytes.yaml", Code::NotText);
    fs::write(bench.spool.incoming().join("large.yaml"), vec![b'x'; 256 * 1024 + 1]).unwrap();
    bench.scan(2000);
    check_rejected(&bench.scan(2500), "large.yaml", Code::TooLarge);
    assert!(bench.files().iter().all(|file| file.starts_with("rejected/")));
    assert!(bench.files().contains(&"rejected/two_words.yaml".to_owned()));
}

#[test]
fn the_same_id_is_taken_once() {
    let mut bench = Bench::new();
    for (at, name, text, code) in [
        (0, "one.yaml", "goal\nid a", None),
        (10_000, "two.yaml", "goal\nid a", Some(Code::Duplicate)),
        (20_000, "three.yaml", "goal other\nid a", Some(Code::IdConflict)),
    ] {
        bench.drop_file(name, text);
        bench.scan(at);
        let events = bench.scan(at + 500);
        match code {
            None => assert!(matches!(events.as_slice(), [SpoolEvent::Claimed { .. }]), "{events:?}"),
            Some(code) => check_rejected(&events, name, code),
        }
    }
    assert_eq!(bench.journal.waiting().unwrap(), 1);
}

#[test]
fn a_full_queue_leaves_files_where_they_are() {
    let mut bench = Bench::new();
    bench.spool.settings.queue_limit = 1;
    bench.drop_file("a.yaml", "goal\nid a");
    bench.drop_file("b.yaml", "goal\nid b");
    bench.scan(0);
    let events = bench.scan(500);
    assert!(
        matches!(events.as_slice(), [SpoolEvent::Claimed { .. }, SpoolEvent::Full { name }] if name == "b.yaml")
    );
    assert!(bench.scan(600).is_empty(), "reported once");
    bench.journal.start("a", NOW).unwrap();
    assert!(matches!(bench.scan(700).as_slice(), [SpoolEvent::Claimed { .. }]));
}

#[test]
fn a_cancel_file_names_its_job() {
    let mut bench = Bench::new();
    bench.drop_file("tidy-42.cancel", "");
    bench.scan(0);
    assert_eq!(bench.scan(500), [SpoolEvent::Cancel { id: "tidy-42".into() }]);
    assert!(bench.files().is_empty());
}

#[test]
fn folders_follow_the_journal() {
    let mut bench = Bench::new();
    bench.drop_file("a.yaml", "goal\nid a");
    bench.scan(0);
    bench.scan(500);
    bench.journal.start("a", NOW).unwrap();
    bench.spool.reconcile(&mut bench.journal).unwrap();
    assert_eq!(bench.files(), ["active/a/job.yaml"]);
    fs::write(bench.state.path().join("jobs/active/a/plan.json"), "{}").unwrap();
    bench.journal.finish("a", &result("a", JobStatus::Cancelled), NOW).unwrap();
    bench.spool.reconcile(&mut bench.journal).unwrap();
    let folder = "failed/2026-11/a";
    assert_eq!(
        bench.files(),
        ["job.yaml", "plan.json", "result.yaml"].map(|name| format!("{folder}/{name}"))
    );
    let found = bench.spool.folder_of(&bench.journal, "a").unwrap();
    assert_eq!(found, Some(bench.state.path().join("jobs").join(folder)));
}

#[test]
fn a_folder_without_a_row_goes_back_to_incoming() {
    let bench = Bench::new();
    let stray = bench.state.path().join("jobs/active/stray");
    fs::create_dir(&stray).unwrap();
    fs::write(stray.join("job.yaml"), "goal").unwrap();
    assert_eq!(bench.restart().files(), ["incoming/stray.yaml"]);
}

#[test]
fn a_lost_folder_is_restored_from_the_journal() {
    let mut bench = Bench::new();
    bench.drop_file("a.yaml", "goal\nid a");
    bench.scan(0);
    bench.scan(500);
    fs::remove_dir_all(bench.state.path().join("jobs/hold/a")).unwrap();
    let bench = bench.restart();
    assert_eq!(fs::read_to_string(bench.state.path().join("jobs/hold/a/job.yaml")).unwrap(), "goal\nid a");
}

fn result(id: &str, status: JobStatus) -> JobResult {
    JobResult { moves: 1, lower_bound: Some(1.0), seconds: 1.0, ..JobResult::sample(id, status) }
}

/// The daemon's day: take what is there, carry out two steps for each job, end it. Counts intents per job
/// in `motions` only after the journal has them, as the daemon sends motion only then.
fn work(bench: &mut Bench, motions: &mut Vec<(String, u32)>) -> Result<(), SpoolError> {
    let Bench { spool, journal, .. } = bench;
    for at_ms in [0, 500] {
        let now = Timestamp::ZERO + Duration::from_millis(at_ms);
        spool.scan(journal, &read, now, NOW)?;
    }
    while let Some(job) = journal.next_ready(NOW)? {
        spool.point()?;
        journal.start(&job.id, NOW)?;
        spool.point()?;
        spool.reconcile(journal)?;
        for _ in 0..2 {
            let pose = Pose2::default();
            let intent = StepIntent {
                object: "mug".into(),
                from: pose,
                to: pose,
                kind: StepKind::Goal,
                tool_from_object: None,
                table: Vec::new(),
            };
            let step = journal.step_intent(&job.id, &intent, NOW)?;
            motions.push((job.id.clone(), step));
            spool.point()?;
            journal.step_gripped(&job.id, step, NOW)?;
            spool.point()?;
            journal.step_done(&job.id, step, NOW)?;
            spool.point()?;
        }
        journal.finish(&job.id, &result(&job.id, JobStatus::Done), NOW)?;
        spool.point()?;
        spool.reconcile(journal)?;
        spool.point()?;
    }
    Ok(())
}

/// Property: wherever celld dies, and dies again, each file ends in exactly one place, each job is claimed
/// once, each step's motion is ordered at most once, and whatever was refused has its reason.
#[test]
fn a_crash_at_any_point_loses_and_doubles_nothing() {
    let texts = ["goal A", "goal B\nid b", "gaol C", "goal B, other\nid b"];
    let mut survived = false;
    let mut crash = 0;
    while !survived {
        for second_crash in [None, Some(0), Some(3), Some(7)] {
            let mut bench = Bench::new();
            for (index, text) in texts.iter().enumerate() {
                bench.drop_file(&format!("job{index}.yaml"), text);
            }
            let mut motions = Vec::new();
            bench.spool.crash_after.set(Some(crash));
            match work(&mut bench, &mut motions) {
                Ok(()) => survived = true,
                Err(error) => assert!(matches!(error, SpoolError::Crash), "{error:?}"),
            }
            let mut bench = bench.restart();
            bench.spool.crash_after.set(second_crash);
            let _ = work(&mut bench, &mut motions);
            let mut bench = bench.restart();
            work(&mut bench, &mut motions).unwrap();
            check_nothing_lost(&bench, &texts, &motions, crash);
        }
        crash += 1;
    }
    assert!(crash > 40, "only {crash} points: the sweep does not reach the work");
}

fn check_nothing_lost(bench: &Bench, texts: &[&str], motions: &[(String, u32)], crash: u32) {
    let files = bench.files();
    let jobs = bench.state.path().join("jobs");
    for text in texts {
        let holders: Vec<_> = files
            .iter()
            .filter(|file| fs::read_to_string(jobs.join(file)).is_ok_and(|content| content == *text))
            .collect();
        assert_eq!(holders.len(), 1, "crash {crash}: {text:?} in {holders:?}");
    }
    for file in files.iter().filter(|file| file.starts_with("rejected/") && !file.ends_with(".reason.yaml")) {
        assert!(files.contains(&format!("{file}.reason.yaml")), "crash {crash}: {file} has no reason");
    }
    for file in files.iter().filter(|file| file.starts_with("done/") || file.starts_with("failed/")) {
        let folder = file.rsplit_once('/').unwrap().0;
        assert!(files.contains(&format!("{folder}/result.yaml")), "crash {crash}: {folder} has no result");
    }
    let records = bench.journal.latest(100).unwrap();
    assert_eq!(records.len(), 2, "crash {crash}: each good job is claimed once");
    assert!(records.iter().all(|job| matches!(job.state, JobState::Ended(_))), "crash {crash}");
    let mut unique = motions.to_vec();
    unique.sort();
    unique.dedup();
    assert_eq!(unique.len(), motions.len(), "crash {crash}: a motion was ordered twice");
    let left: Vec<_> = files.iter().filter(|file| file.starts_with("incoming")).collect();
    assert!(left.is_empty(), "crash {crash}: {left:?}");
}

#[test]
fn an_interrupted_step_ends_the_job_with_a_named_state() {
    let mut bench = Bench::new();
    bench.drop_file("a.yaml", "goal\nid a");
    bench.scan(0);
    bench.scan(500);
    bench.journal.start("a", NOW).unwrap();
    let pose = Pose2::default();
    let intent = StepIntent {
        object: "mug".into(),
        from: pose,
        to: pose,
        kind: StepKind::Buffer,
        tool_from_object: None,
        table: Vec::new(),
    };
    bench.journal.step_intent("a", &intent, NOW).unwrap();
    let recovered = bench.journal.recover(NOW).unwrap();
    assert!(matches!(recovered.as_slice(), [Recovered::Interrupted { id, .. }] if id == "a"));
    bench.spool.reconcile(&mut bench.journal).unwrap();
    let text = fs::read_to_string(bench.state.path().join("jobs/failed/2026-11/a/result.yaml")).unwrap();
    assert!(text.contains("status: interrupted"), "{text}");
}

/// Row 39 of the table of faults: the wall clock is set by a year, forwards and back.
#[test]
fn a_clock_that_jumps_changes_neither_that_ids_differ_nor_the_order_of_jobs() {
    const YEAR_S: f64 = 365.25 * 86_400.0;
    let mut bench = Bench::new();
    let mut ids = Vec::new();
    for (round, unix_s) in (0..).zip([NOW, NOW - YEAR_S, NOW, NOW + YEAR_S, NOW]) {
        bench.drop_file("tidy.yaml", &format!("goal {round}"));
        for at_ms in [round * 10_000, round * 10_000 + 500] {
            let now = Timestamp::ZERO + Duration::from_millis(at_ms);
            let events = bench.spool.scan(&mut bench.journal, &read, now, unix_s).unwrap();
            ids.extend(events.into_iter().map(|event| match event {
                SpoolEvent::Claimed { id, .. } => id,
                other => panic!("{other:?}"),
            }));
        }
    }
    assert_eq!(ids.iter().collect::<std::collections::BTreeSet<_>>().len(), 5, "{ids:?}");
    for id in &ids {
        let next = bench.journal.next_ready(NOW - YEAR_S).unwrap().expect("it waits");
        assert_eq!(next.id, *id);
        bench.journal.start(id, NOW).unwrap();
        bench.journal.finish(id, &result(id, JobStatus::Done), NOW - YEAR_S).unwrap();
    }
}

/// Very many files at once: those that are wrong are refused one by one, the others wait for room, and a
/// cancellation waits for none of them.
#[test]
fn many_files_are_all_accounted_for_a_few_at_a_time() {
    const FILES: usize = 2000;
    let mut bench = Bench::new();
    (bench.spool.settings.at_once, bench.spool.settings.entries_at_once) = (1, 200);
    let good = |k: usize| k.is_multiple_of(20);
    for k in 0..FILES {
        let text = if good(k) { format!("goal\nid job-{k:05}") } else { "gaol".to_string() };
        bench.drop_file(&format!("job-{k:05}.yaml"), &text);
    }
    let (mut claimed, mut refused, mut full, mut cancelled_after) = (Vec::new(), 0, 0, None);
    let mut ms = 0;
    while claimed.len() + refused < FILES {
        assert!(ms < 10_000_000, "{} claimed, {refused} refused", claimed.len());
        ms += if bench.spool.has_more() { 1 } else { 200 };
        let events = bench.scan(ms);
        assert!(events.len() <= 1, "{events:?}");
        for event in events {
            match event {
                SpoolEvent::Claimed { id, .. } => claimed.push(id),
                SpoolEvent::Rejected { .. } => refused += 1,
                SpoolEvent::Cancel { id } => cancelled_after = Some((id, refused)),
                SpoolEvent::Full { .. } => full += 1,
                SpoolEvent::Unreadable { .. } => panic!("{event:?}"),
            }
            if claimed.len() + refused == 100 {
                bench.drop_file("zz.cancel", "");
            }
        }
        // The cell works a job off whenever nothing more can be taken in.
        if bench.journal.waiting().unwrap() >= bench.spool.settings.queue_limit && !bench.spool.has_more() {
            let id = bench.journal.next_ready(NOW).unwrap().unwrap().id;
            bench.journal.start(&id, NOW).unwrap();
            bench.journal.finish(&id, &result(&id, JobStatus::Done), NOW).unwrap();
        }
    }
    let expected: Vec<_> = (0..FILES).filter(|k| good(*k)).map(|k| format!("job-{k:05}")).collect();
    assert_eq!(claimed, expected, "in the order of their names");
    assert_eq!(refused, FILES - expected.len());
    assert!(full >= 1, "that the queue is full is reported");
    let (id, after) = cancelled_after.expect("the cancellation was read");
    assert!(id == "zz" && after < 1900, "it waited for {after} files");
    let left: Vec<_> = bench.files().into_iter().filter(|file| file.starts_with("incoming")).collect();
    assert_eq!(left, Vec::<String>::new());
}

/// Ends a job with a step, `days` before now.
fn end_a_job(bench: &mut Bench, id: &str, days: f64, at_ms: u64) {
    let ended = NOW - days * 86_400.0;
    bench.drop_file(&format!("{id}.yaml"), &format!("goal {id}\nid {id}"));
    bench.scan(at_ms);
    bench.scan(at_ms + 500);
    bench.journal.start(id, ended).unwrap();
    let intent = StepIntent {
        object: "mug".into(),
        from: Pose2::default(),
        to: Pose2::default(),
        kind: StepKind::Goal,
        tool_from_object: None,
        table: Vec::new(),
    };
    let step = bench.journal.step_intent(id, &intent, ended).unwrap();
    bench.journal.step_gripped(id, step, ended).unwrap();
    bench.journal.step_released(id, step, ended).unwrap();
    bench.journal.step_done(id, step, ended).unwrap();
    bench.journal.finish(id, &result(id, JobStatus::Done), ended).unwrap();
    bench.spool.reconcile(&mut bench.journal).unwrap();
}

#[test]
fn the_history_is_kept_within_its_limits_with_its_files_and_a_crash_in_between_is_made_good() {
    let mut bench = Bench::new();
    for (id, days, at_ms) in [("a", 40.0, 0), ("b", 20.0, 10_000), ("c", 10.0, 20_000), ("d", 50.0, 30_000)] {
        end_a_job(&mut bench, id, days, at_ms);
    }
    bench.drop_file("wrong.yaml", "gaol");
    bench.scan(40_000);
    bench.scan(40_500);
    let ids = |bench: &Bench| -> Vec<String> {
        bench.journal.latest(10).unwrap().into_iter().map(|job| job.id).collect()
    };
    let mut limits = HistoryLimits { days: 365.0, jobs: 10, always: 0 };
    let remove = |bench: &mut Bench, limits: &HistoryLimits, unix_s: f64| {
        bench.spool.remove_old(&mut bench.journal, limits, unix_s)
    };
    assert_eq!(remove(&mut bench, &limits, NOW).unwrap(), 0, "everything is within them");
    // By age; the job of the last step stays, however old: it says what may hang on the gripper.
    limits.days = 30.0;
    limits.always = 4;
    assert_eq!(remove(&mut bench, &limits, NOW + 1e9).unwrap(), 0, "the calendar alone empties nothing");
    limits.always = 0;
    bench.spool.crash_after.set(Some(0));
    assert!(remove(&mut bench, &limits, NOW).is_err());
    bench.spool.crash_after.set(None);
    assert!(ids(&bench).contains(&"a".to_string()), "its files are gone, its row is found again");
    assert_eq!(remove(&mut bench, &limits, NOW).unwrap(), 1);
    assert_eq!(ids(&bench).len(), 3);
    // By number: the newest two, of which one is the last.
    limits = HistoryLimits { days: 365.0, jobs: 2, always: 0 };
    assert_eq!(remove(&mut bench, &limits, NOW).unwrap(), 1);
    assert!(ids(&bench).iter().all(|id| id == "c" || id == "d"), "{:?}", ids(&bench));
    let files = bench.files();
    assert!(files.iter().all(|file| !file.contains("/a/") && !file.contains("/b/")), "{files:?}");
    assert!(files.iter().any(|file| file.contains("/d/result.yaml")), "{files:?}");
    assert!(files.iter().any(|file| file.ends_with("wrong.yaml.reason.yaml")), "{files:?}");
    // Refusals too.
    assert!(remove(&mut bench, &limits, NOW + 366.0 * 86_400.0).unwrap() >= 1);
    assert!(bench.files().iter().all(|file| !file.contains("wrong.yaml")), "{:?}", bench.files());
    assert!(bench.journal.last_step().unwrap().is_some());
}
