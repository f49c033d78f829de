//! A plan is approved by its number, and an order that was decided goes on without its client.

use super::{Cell, JOB, ended, signal};
use crate::cell::{preloaded, wait_until};
use serde_json::json;

/// Before libc: while a file is there, the files of decided orders are not removed and so not answered,
/// except stops.
const HOLDS: &str = r#"
#define _GNU_SOURCE
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

int unlink(const char *name) {
    const char *end = strrchr(name, '.');
    int is_order = end && strcmp(end, ".command") == 0 && !strstr(name, "-stop");
    while (is_order && access(getenv("HOLDS_WHILE"), F_OK) == 0) usleep(1000);
    return syscall(SYS_unlink, name);
}
"#;

/// Off a terminal `celld approve` without a number approves nothing and exits with 2. With the number the
/// plan is approved; Ctrl-C before the answer ends the client, which says that the order goes on, and `lid`
/// is carried. A stop is answered all the same.
#[test]
fn cell_carries_out_the_plan_that_was_named_after_its_client_was_interrupted() {
    let folder = tempfile::tempdir().expect("a folder");
    let (library, held) = (preloaded(folder.path(), HOLDS), folder.path().join("held"));
    let environment = [("LD_PRELOAD", library.as_path()), ("HOLDS_WHILE", held.as_path())];
    let cell = Cell::start("127.7.9.21", &environment);
    cell.submit(&JOB.replace("goal:", "approval: job\ngoal:"));
    cell.arm();
    cell.works_until("the plan waits", || cell.status()["awaiting_approval"] == json!(["carry"]));
    let plan = cell.status()["plan"]["number"].as_u64().expect("its number").to_string();
    let is_approved = || cell.log().contains("ordered: approved");

    // A command whose output is taken has no terminal.
    let (code, said) = cell.celld(&["approve", "carry"]);
    assert_eq!(code, Some(2), "{said}");
    for part in ["nothing was approved", &format!("`celld approve carry --plan {plan}`")] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert!(!is_approved() && !cell.holds(), "{}", cell.log());

    std::fs::write(&held, "").expect("written");
    let client = cell.client(&["approve", "carry", "--plan", &plan]);
    wait_until("it is decided", is_approved);
    signal("INT", client.0.id());
    let (code, said) = ended(client);
    assert_eq!(code, Some(130), "{said}");
    assert!(said.contains("if it was decided before Ctrl-C, it goes on"), "{said}");
    cell.works_until("it goes on", || cell.carries());

    let (code, said) = cell.celld(&["abort"]);
    assert!(said.contains("disarmed"), "{code:?}: {said}");
    assert!(cell.rests());
    std::fs::remove_file(&held).expect("removed");
    wait_until("other orders are answered again", || cell.celld(&["recover"]).0 == Some(0));
}
