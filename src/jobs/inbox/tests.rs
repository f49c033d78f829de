//! The folder of commands, with real files and with senders that reuse names, end, and leave rubbish.

use super::*;
use crate::jobs::command::{Given, Sent};
use std::os::unix::fs::MetadataExt;

fn given(unix_s: f64) -> Given {
    Given { unix_s, boot_s: 100.0 }
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn commands(mail: &Mail) -> Vec<&Command> {
    mail.taken.iter().map(|taken| &taken.command).collect()
}

#[test]
fn commands_arrive_once_in_order_and_are_answered() {
    let folder = folder();
    let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
    let approve = Command::Approve { id: "tidy".into(), plan: 3 };
    let first = Sent::send(folder.path(), "d1", &Command::Arm, given(10.0)).unwrap();
    let _second = Sent::send(folder.path(), "d1", &approve, given(10.0)).unwrap();
    assert_eq!(first.poll().unwrap(), None);
    let mail = inbox.take(9);
    assert_eq!(commands(&mail), [&Command::Arm, &approve]);
    assert!(inbox.take(9).taken.is_empty());
    let reply = Reply { accepted: false, message: "the robot is in local mode".into() };
    mail.taken[0].answer(&reply).unwrap();
    // The client is the daemon's own user here: an answer may be a secret.
    let mode = std::fs::metadata(&first.reply).unwrap().mode() & 0o777;
    assert_eq!(mode, 0o600);
    assert_eq!(first.poll().unwrap(), Some(reply));
    assert_eq!(first.poll().unwrap(), None);
}

#[test]
fn a_command_waits_behind_one_of_each_other_sender_and_not_behind_all_of_a_script() {
    let folder = folder();
    let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
    let text = r#"{"daemon": "d1", "boot_s": 100.0, "command": {"do": "resume"}}"#;
    let write = |name: String| std::fs::write(folder.path().join(name), text).unwrap();
    (0..100).for_each(|n| write(format!("1-7-{n:05}.command")));
    (0..100).for_each(|n| write(format!("{n:04}.command")));
    let arm = Sent::send(folder.path(), "d1", &Command::Arm, given(1e9)).unwrap();
    let later = Sent::send(folder.path(), "d1", &Command::ConfirmGripper, given(1e9)).unwrap();
    // All are new in the first looks.
    let taken: Vec<Command> = (0..3).flat_map(|_| inbox.take(9).taken).map(|one| one.command).collect();
    let [first, second] = [Command::Arm, Command::ConfirmGripper]
        .map(|command| taken.iter().position(|one| *one == command).expect("taken"));
    assert!(first < 3 && first < second && second < 6, "{taken:?}");
    drop((arm, later));
}

#[test]
fn a_stop_is_taken_before_a_thousand_other_commands() {
    let folder = folder();
    let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
    let text = r#"{"daemon": "d1", "boot_s": 100.0, "command": {"do": "resume"}}"#;
    (0..1000).for_each(|n| std::fs::write(folder.path().join(format!("{n:04}.command")), text).unwrap());
    let abort = Sent::send(folder.path(), "d1", &Command::Abort, given(10.0)).unwrap();
    let mail = inbox.take(3);
    assert_eq!(commands(&mail), [&Command::Abort]);
    let after = inbox.take(3);
    assert_eq!(commands(&after), [&Command::Resume; 3], "obeyed once");
    assert_eq!(commands(&inbox.take_while(3, || false)), [&Command::Resume], "one at least");
    assert!(abort.lies_there());
    mail.taken[0].answer(&Reply::accept("stopped")).unwrap();
    assert!(!abort.lies_there() && abort.poll().unwrap().is_some_and(|reply| reply.accepted));
    // One that nothing in its name marks is found within a few looks.
    std::fs::write(folder.path().join("9999.command"), text.replace("resume", "abort")).unwrap();
    let found = (0..40).any(|_| commands(&inbox.take(0)).contains(&&Command::Abort));
    assert!(found, "among a thousand others");
}

#[test]
fn a_stop_is_handed_on_by_one_of_two_readers() {
    let folder = folder();
    let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
    let mut stops = inbox.reported_stops().unwrap();
    let send = |command| Sent::send(folder.path(), "d1", &command, given(10.0)).unwrap();
    let all = |taken: &[Taken]| taken.iter().map(|one| one.command.clone()).collect::<Vec<_>>();
    let (_first, _arm) = (send(Command::Abort), send(Command::Arm));
    let reported = stops.take();
    assert_eq!(all(&reported), [Command::Abort], "and nothing else");
    assert!(inbox.take(9).taken.is_empty(), "nothing follows in the look that finds the stop");
    assert_eq!(commands(&inbox.take(9)), [&Command::Arm]);
    let _second = send(Command::Abort);
    let listed = inbox.take(9);
    assert_eq!(commands(&listed), [&Command::Abort]);
    assert!(stops.take().is_empty(), "listed before");
    for one in reported.iter().chain(&listed.taken) {
        one.answer(&Reply::accept("stopped")).unwrap();
    }
    assert!(inbox.take(9).taken.is_empty() && inbox.folder.names(SUFFIX).unwrap().is_empty());
}

#[test]
fn a_stop_under_the_name_of_an_earlier_one_counts_whoever_finds_it() {
    for listed in [true, false] {
        let folder = folder();
        let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
        let mut stops = inbox.reported_stops().unwrap();
        let leave = |order: &str| {
            let text = r#"{"daemon": "d1", "boot_s": 100.0, "command": {"do": "pause"}}"#;
            std::fs::write(folder.path().join(".new"), text.replace("pause", order)).unwrap();
            std::fs::rename(folder.path().join(".new"), folder.path().join("x-stop.command")).unwrap();
        };
        leave("pause");
        let mut look = || if listed { inbox.take(9).taken } else { stops.take() };
        let pause = look();
        assert_eq!(pause.len(), 1);
        leave("abort");
        pause[0].answer(&Reply::accept("paused")).unwrap();
        drop(pause);
        let abort = look();
        assert!(matches!(abort.as_slice(), [Taken { command: Command::Abort, .. }]), "{abort:?}");
    }
}

#[test]
fn a_stop_that_was_read_before_its_answer_and_noted_after_it_does_not_count_again() {
    let folder = folder();
    let inbox = Inbox::open(folder.path(), "d1").unwrap();
    let sent = Sent::send(folder.path(), "d1", &Command::Abort, given(10.0)).unwrap();
    let (name, _) = inbox.folder.names(SUFFIX).unwrap().remove(0);
    let read = || inbox.read(&name).unwrap().unwrap();
    let late = read();
    let first = inbox.first(read()).expect("it is new");
    assert!(inbox.first(read()).is_none(), "noted");
    first.answer(&Reply::accept("stopped")).unwrap();
    drop(first);
    assert!(inbox.first(late).is_none(), "gone from the folder");
    drop(sent);
}

#[test]
fn the_daemon_sees_whether_the_sender_still_waits() {
    let folder = folder();
    let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
    let sent = Sent::send(folder.path(), "d1", &Command::Arm, given(10.0)).unwrap();
    let mail = inbox.take(1);
    assert!(mail.taken[0].lock.is_held());
    let last_word = sent.let_go();
    assert!(!mail.taken[0].lock.is_held());
    mail.taken[0].answer(&Reply::refuse("too late")).unwrap();
    assert_eq!(last_word.poll().unwrap(), Some(Reply::refuse("too late")));
}

#[test]
fn an_old_command_never_reaches_the_next_daemon() {
    let folder = folder();
    let late = Sent::send(folder.path(), "d1", &Command::Arm, given(10.0)).unwrap();
    let mut inbox = Inbox::open(folder.path(), "d2").unwrap();
    assert!(inbox.take(9).taken.is_empty(), "cleared at start");
    let later = Sent::send(folder.path(), "d1", &Command::Abort, given(11.0)).unwrap();
    let mail = inbox.take(9);
    assert!(mail.taken.is_empty(), "meant for the daemon before");
    mail.refused[0].answer().unwrap();
    assert!(!later.poll().unwrap().unwrap().accepted);
    assert!(!late.withdraw().unwrap());
}

#[test]
fn rubbish_is_removed_and_never_obeyed() {
    let folder = folder();
    let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
    for (name, text) in [
        ("1.command", "arm"),
        ("2.command", r#"{"daemon": "d1", "boot_s": 100.0, "command": {"do": "fly"}}"#),
        ("3.command", r#"{"daemon": "d1", "boot_s": 100.0, "command": {"do": "arm"}, "extra": 1}"#),
        ("5.command", r#"{"daemon": "d1", "command": {"do": "arm"}}"#),
        ("6.command", r#"{"daemon": "d1", "boot_s": 1.0, "command": {"do": "approve", "id": "a"}}"#),
    ] {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    std::os::unix::fs::symlink("/dev/zero", folder.path().join("4.command")).unwrap();
    let mail = inbox.take(9);
    assert!(mail.taken.is_empty() && mail.refused.len() == 6 && mail.fault.is_none(), "{mail:?}");
    assert!(inbox.folder.names(SUFFIX).unwrap().is_empty());
}

#[test]
fn a_command_can_be_taken_back_until_the_daemon_has_it() {
    let folder = folder();
    let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
    let sent = Sent::send(folder.path(), "d1", &Command::Park, given(10.0)).unwrap();
    assert!(inbox.take(0).taken.is_empty() && sent.lies_there());
    assert!(sent.withdraw().unwrap());
    assert!(inbox.take(9).taken.is_empty());
    let sent = Sent::send(folder.path(), "d1", &Command::Park, given(10.0)).unwrap();
    assert_eq!(commands(&inbox.take(9)), [&Command::Park]);
    assert!(!sent.withdraw().unwrap());
}

#[test]
fn a_folder_that_is_gone_is_a_fault_and_takes_nothing_back() {
    let root = folder();
    let path = root.path().join("commands");
    let mut inbox = Inbox::open(&path, "d1").unwrap();
    let _abort = Sent::send(&path, "d1", &Command::Abort, given(10.0)).unwrap();
    std::fs::rename(&path, root.path().join("aside")).unwrap();
    let mail = inbox.take(9);
    assert!(matches!(mail.fault, Some(Unreachable::FolderGone(_))) && mail.taken.is_empty());
    std::fs::rename(root.path().join("aside"), &path).unwrap();
    assert_eq!(commands(&inbox.take(9)), [&Command::Abort]);
}
