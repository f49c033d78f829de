//! A damaged journal through the built binary: the commands that read it name `celld journal repair`, which
//! makes it readable again.

use cell_edge::files::FileIdentity;
use celld::jobs::journal::{Journal, NewJob};
use celld::jobs::record::JobSpec;
use celld::jobs::state::StateFolder;
use celld::jobs::status::Status;
use std::path::Path;
use std::process::{Command, Output};

fn celld(state: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_celld"));
    command.args(arguments).arg("--state").arg(state).output().expect("celld runs")
}

fn text(output: &Output) -> String {
    let both = [&output.stdout[..], &output.stderr[..]].concat();
    String::from_utf8_lossy(&both).into_owned()
}

/// A state folder with twenty jobs, whose journal has lost its second half.
fn with_a_damaged_journal(folder: &Path) {
    let path = StateFolder::new(folder).journal();
    let mut journal = Journal::open(&path).expect("a journal");
    for number in 1..=20 {
        let source = FileIdentity { device: 1, inode: number, size: 3, modified_ns: 4 };
        let (id, text, spec) = (format!("job-{number}"), "x".repeat(3000), JobSpec::default());
        let job = NewJob { id: &id, name: "job.yaml", sha256: "00", text: &text, spec: &spec, source };
        journal.claim(&job, 1.7e9).expect("claimed");
    }
    drop(journal);
    let file = std::fs::OpenOptions::new().write(true).open(&path).expect("the journal");
    let length = file.metadata().expect("its length").len();
    file.set_len(length / 2).expect("cut");
}

#[test]
fn jobs_are_listed_again_after_the_repair_of_a_truncated_journal() {
    let folder = tempfile::tempdir().expect("a folder");
    with_a_damaged_journal(folder.path());
    let before = celld(folder.path(), &["jobs"]);
    assert_eq!(before.status.code(), Some(1));
    assert!(text(&before).contains("`celld journal repair`"), "{}", text(&before));

    let repair = celld(folder.path(), &["journal", "repair"]);
    assert_eq!(repair.status.code(), Some(0), "{}", text(&repair));
    for wanted in ["is repaired", "  jobs: ", "history.sqlite.damaged-", "cups are empty"] {
        assert!(text(&repair).contains(wanted), "{wanted}: {}", text(&repair));
    }
    let after = celld(folder.path(), &["jobs"]);
    assert_eq!(after.status.code(), Some(0), "{}", text(&after));
    assert!(text(&after).contains("job-1 "), "{}", text(&after));

    let again = celld(folder.path(), &["journal", "repair"]);
    assert!(again.status.success() && text(&again).contains("is sound"), "{}", text(&again));
}

#[test]
fn a_repair_beside_a_daemon_is_refused_and_a_missing_state_folder_is_bad_input() {
    let folder = tempfile::tempdir().expect("a folder");
    with_a_damaged_journal(folder.path());
    let damaged = std::fs::read(folder.path().join("history.sqlite")).expect("the journal");
    let lock = StateFolder::new(folder.path()).take(&Status::default()).expect("taken");
    let refused = celld(folder.path(), &["journal", "repair"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(text(&refused).contains("stop it"), "{}", text(&refused));
    assert!(std::fs::read(folder.path().join("history.sqlite")).expect("the journal") == damaged);
    drop(lock);
    let missing = celld(&folder.path().join("nowhere"), &["journal", "repair"]);
    assert_eq!(missing.status.code(), Some(2), "{}", text(&missing));
}
