//! `.ci/tree`: the checkout that outlives clones, so that a warm build directory builds what changed alone.

use std::path::Path;
use std::process::Command;

/// The output of a program that has to succeed.
fn said(command: &mut Command) -> String {
    let run = command.output().expect("it runs");
    assert!(run.status.success(), "{command:?}: {}", String::from_utf8_lossy(&run.stderr));
    String::from_utf8_lossy(&run.stdout).trim().to_string()
}

/// Git on the repository that is named, also when git runs the tests.
fn git_alone() -> Command {
    let mut git = Command::new("git");
    for (key, _) in std::env::vars_os().filter(|(key, _)| key.to_string_lossy().starts_with("GIT_")) {
        git.env_remove(key);
    }
    git
}

fn git(folder: &Path, words: &[&str]) {
    let who = ["-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false"];
    said(git_alone().arg("-C").arg(folder).args(who).args(words));
}

fn commit(folder: &Path, files: &[(&str, &str)]) {
    for (name, text) in files {
        std::fs::write(folder.join(name), text).expect("written");
    }
    git(folder, &["add", "--all"]);
    git(folder, &["commit", "--quiet", "--message", "a step"]);
}

fn tree(clone: &Path, tree: &Path) -> String {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join(".ci/tree");
    // As within a hook of another repository.
    said(Command::new(script).arg(clone).arg(tree).env("GIT_DIR", "/nowhere"))
}

#[test]
fn what_did_not_change_keeps_its_time_in_the_next_clone() {
    if Command::new("git").arg("--version").output().is_err() {
        return eprintln!("SKIPPED: no git here, `.ci/tree` is not tried");
    }
    let folder = tempfile::tempdir().expect("a folder");
    let [first, second, kept] = ["first", "second", "target/tree"].map(|name| folder.path().join(name));
    std::fs::create_dir(&first).expect("created");
    git(&first, &["init", "--quiet"]);
    commit(&first, &[("same", "1"), ("other", "1"), ("gone", "1")]);
    assert_eq!(tree(&first, &kept), kept.display().to_string());
    let time = |name: &str| kept.join(name).metadata().and_then(|meta| meta.modified()).expect("a time");
    let before = [time("same"), time("other")];
    std::fs::write(kept.join("left behind"), "by a run").expect("written");

    said(git_alone().args(["clone", "--quiet"]).args([&first, &second]));
    std::fs::remove_file(second.join("gone")).expect("removed");
    commit(&second, &[("other", "2")]);
    assert_eq!(tree(&second, &kept), kept.display().to_string());
    assert_eq!(time("same"), before[0]);
    assert!(time("other") > before[1]);
    assert_eq!(std::fs::read_to_string(kept.join("other")).expect("a file"), "2");
    assert!(!kept.join("gone").exists() && !kept.join("left behind").exists());

    // A run that was broken off has left a lock.
    std::fs::write(kept.join(".git/index.lock"), "").expect("written");
    assert_eq!(tree(&second, &kept), kept.display().to_string());
    assert_eq!(std::fs::read_to_string(kept.join("other")).expect("a file"), "2");

    // What is not committed is tried as it is.
    std::fs::write(second.join("other"), "3").expect("written");
    assert_eq!(tree(&second, &kept), second.display().to_string());
}
