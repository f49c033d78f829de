//! Repairs of journals that were damaged on disk in several ways.

use super::*;
use crate::jobs::journal::NewJob;
use crate::jobs::record::{JobSpec, StepIntent, StepKind};
use cell_edge::files::FileIdentity;
use rearrange::geometry::pose::Pose2;
use std::fs::OpenOptions;
use std::os::unix::fs::{FileExt, MetadataExt};

const NOW: f64 = 1_795_248_000.0;
const PAGE: usize = 4096;
const JOBS: u64 = 60;

fn claim(journal: &mut Journal, number: u64) -> String {
    let id = format!("job-{number}");
    let source = FileIdentity { device: 1, inode: number, size: 3, modified_ns: 4 };
    let text = "x".repeat(1500);
    let spec = JobSpec::default();
    let job = NewJob { id: &id, name: "job.yaml", sha256: "00", text: &text, spec: &spec, source };
    journal.claim(&job, NOW).unwrap();
    id
}

/// A journal at rest: the last job is active with an open step, all others wait.
fn journal() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("history.sqlite");
    let mut journal = Journal::open(&path).unwrap();
    let last = (1..=JOBS).map(|number| claim(&mut journal, number)).last().unwrap();
    journal.start(&last, NOW).unwrap();
    let intent = StepIntent {
        object: "mug".into(),
        from: Pose2::default(),
        to: Pose2::new(0.1, 0.2, 0.3),
        kind: StepKind::Goal,
        tool_from_object: None,
        table: Vec::new(),
    };
    journal.step_intent(&last, &intent, NOW).unwrap();
    at_rest(journal).unwrap();
    (folder, path)
}

fn damage(path: &Path, change: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut bytes = std::fs::read(path).unwrap();
    change(&mut bytes);
    std::fs::write(path, &bytes).unwrap();
    bytes
}

/// A leaf of `jobs` in the middle, behind the roots of all tables and indices.
fn zero_a_leaf(bytes: &mut [u8]) {
    let leaf = (bytes.len() / PAGE / 2..).find(|page| bytes[page * PAGE] == 0x0d).unwrap();
    bytes[leaf * PAGE..(leaf + 1) * PAGE].fill(0);
}

fn replaced(path: &Path) -> (Vec<(u64, Option<u64>)>, PathBuf) {
    match repair(path, NOW).unwrap() {
        Repaired::Replaced { tables, damaged } => {
            let journal = Journal::open(path).expect("usable");
            assert_eq!(journal.search(&Default::default(), 1000).unwrap().len() as u64, tables[0].rows);
            (tables.iter().map(|kept| (kept.rows, kept.lost)).collect(), damaged)
        }
        Repaired::Sound => panic!("the damage was not found"),
    }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<_> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn a_sound_journal_is_left_as_it_is() {
    let (folder, path) = journal();
    let before = (std::fs::read(&path).unwrap(), path.metadata().unwrap().ino());
    assert_eq!(repair(&path, NOW).unwrap(), Repaired::Sound);
    assert_eq!((std::fs::read(&path).unwrap(), path.metadata().unwrap().ino()), before);
    assert_eq!(names(folder.path()), ["history.sqlite"]);
}

#[test]
fn a_journal_cut_to_half_keeps_its_first_jobs_and_the_damaged_file() {
    let (folder, path) = journal();
    let bytes = damage(&path, |bytes| bytes.truncate(bytes.len() / 2));
    let (tables, damaged) = replaced(&path);
    let (kept, lost) = tables[0];
    assert!(kept >= JOBS / 5 && lost == Some(JOBS - kept), "{tables:?}");
    assert_eq!(std::fs::read(&damaged).unwrap(), bytes);
    let name = damaged.file_name().unwrap().to_string_lossy().into_owned();
    assert_eq!(name, format!("history.sqlite.damaged-{}", utc::compact(NOW)));
    assert!(names(folder.path()).iter().all(|name| !name.contains("repairing")));
    assert_eq!(repair(&path, NOW).unwrap(), Repaired::Sound);
}

#[test]
fn a_zeroed_page_in_the_middle_costs_its_own_rows_only() {
    let (_folder, path) = journal();
    damage(&path, |bytes| zero_a_leaf(bytes));
    let (tables, _) = replaced(&path);
    let (kept, lost) = tables[0];
    assert!((JOBS - 3..JOBS).contains(&kept), "{tables:?}");
    assert_eq!(lost, Some(JOBS - kept), "an index knows how many there were");
    assert_eq!(tables[1], (1, Some(0)));
}

#[test]
fn several_damaged_pages_leave_the_rows_between_them() {
    let (_folder, path) = journal();
    let mut zeroed = 0;
    damage(&path, |bytes| {
        let leaves: Vec<_> = (12..bytes.len() / PAGE).filter(|page| bytes[page * PAGE] == 0x0d).collect();
        for leaf in leaves.iter().step_by(3) {
            bytes[leaf * PAGE..(leaf + 1) * PAGE].fill(0);
            zeroed += 1;
        }
    });
    let (tables, _) = replaced(&path);
    assert!(zeroed > 3 && tables[0].0 >= JOBS - 3 * zeroed, "{tables:?} of {zeroed} pages");
}

#[test]
fn a_journal_without_its_first_page_keeps_every_row() {
    for damaged_bytes in [16, 100, PAGE] {
        let (_folder, path) = journal();
        damage(&path, |bytes| bytes[..damaged_bytes].fill(0xa5));
        let (tables, _) = replaced(&path);
        assert_eq!(tables, [(JOBS, Some(0)), (1, Some(0)), (0, Some(0))], "{damaged_bytes} bytes");
    }
}

#[test]
fn what_is_no_database_becomes_an_empty_journal() {
    for content in [&b""[..], b"no database", &[0x5a; 3 * PAGE]] {
        let (_folder, path) = journal();
        std::fs::write(&path, content).unwrap();
        let (tables, damaged) = replaced(&path);
        assert_eq!(tables[0].0, 0);
        assert_eq!(std::fs::read(damaged).unwrap(), content);
    }
}

#[test]
fn commits_in_the_log_are_kept_and_its_uncommitted_tail_is_not() {
    let (folder, path) = journal();
    let mut open = Journal::open(&path).unwrap();
    claim(&mut open, JOBS + 1);
    let log = |folder: &Path| folder.join("history.sqlite-wal");
    let copy = tempfile::tempdir().unwrap();
    let copied = copy.path().join("history.sqlite");
    std::fs::copy(&path, &copied).unwrap();
    std::fs::copy(log(folder.path()), log(copy.path())).unwrap();
    let tail = OpenOptions::new().append(true).open(log(copy.path())).unwrap();
    tail.write_all_at(&[0x5a; 5000], tail.metadata().unwrap().len()).unwrap();
    damage(&copied, |bytes| zero_a_leaf(bytes));
    let (_, damaged) = replaced(&copied);
    let repaired = Journal::open(&copied).unwrap();
    assert!(repaired.job(&format!("job-{}", JOBS + 1)).unwrap().is_some());
    assert!(files::with_suffix(&damaged, "-wal").exists());
}

#[test]
fn rows_that_break_the_rules_of_the_tables_are_lost_and_counted() {
    let (_folder, path) = journal();
    let database = Connection::open(&path).unwrap();
    database
        .execute_batch(
            "PRAGMA foreign_keys=OFF; DROP INDEX one_active;
             UPDATE jobs SET state = 'active' WHERE sequence = 3;
             UPDATE jobs SET spec = '{' WHERE sequence = 5;
             INSERT INTO steps (job, step, intent, phase, changed) VALUES (99, 1, '{}', 'done', 1.0);",
        )
        .unwrap();
    drop(database);
    let (tables, _) = replaced(&path);
    assert_eq!(tables[0], (JOBS - 2, Some(2)), "the second active one, the unreadable one");
    assert_eq!(tables[1], (0, Some(2)), "the step of the lost job, the step of none");
}

#[test]
fn numbers_that_were_given_are_not_given_again() {
    let (_folder, path) = journal();
    let database = Connection::open(&path).unwrap();
    database.execute("UPDATE sqlite_sequence SET seq = 500 WHERE name = 'jobs'", []).unwrap();
    drop(database);
    damage(&path, |bytes| bytes[..100].fill(0));
    replaced(&path);
    let mut journal = Journal::open(&path).unwrap();
    let id = claim(&mut journal, 1000);
    assert_eq!(journal.job(&id).unwrap().unwrap().sequence, 501);
}

#[test]
fn a_journal_of_a_later_celld_is_refused_and_left_as_it_is() {
    let (folder, path) = journal();
    let database = Connection::open(&path).unwrap();
    database.execute_batch("PRAGMA user_version=9").unwrap();
    drop(database);
    let before = std::fs::read(&path).unwrap();
    let error = repair(&path, NOW).expect_err("later");
    assert!(matches!(error, RepairError::Journal(JournalError::Version { found: 9, .. })), "{error}");
    assert_eq!(std::fs::read(&path).unwrap(), before);
    assert_eq!(names(folder.path()), ["history.sqlite"]);
}

#[test]
fn a_repair_that_was_cut_off_before_the_exchange_is_repeated_with_its_log() {
    let (folder, path) = journal();
    let mut open = Journal::open(&path).unwrap();
    claim(&mut open, JOBS + 1);
    let copy = tempfile::tempdir().unwrap();
    let copied = copy.path().join("history.sqlite");
    std::fs::copy(&path, &copied).unwrap();
    std::fs::copy(folder.path().join("history.sqlite-wal"), copy.path().join("history.sqlite-wal")).unwrap();
    damage(&copied, |bytes| zero_a_leaf(bytes));
    let kept = keep_damaged(&copied, "then").unwrap();
    std::fs::remove_file(copy.path().join("history.sqlite-wal")).unwrap();
    let (_, damaged) = replaced(&copied);
    let repaired = Journal::open(&copied).unwrap();
    assert!(repaired.job(&format!("job-{}", JOBS + 1)).unwrap().is_some(), "it is in the log alone");
    assert_eq!(damaged, kept);
}
