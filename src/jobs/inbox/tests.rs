//! The folder of commands, with real files and with senders that reuse names, end, and leave rubbish.

use super::*;
use crate::jobs::command::{Given, Sent};
use crate::jobs::reported::{Kind, Reported};
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
    let reply = Reply::refuse("the robot is in local mode");
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
    assert!(!abort.waits().unwrap());
    mail.taken[0].answer(&Reply::accept("stopped")).unwrap();
    assert!(abort.poll().unwrap().is_some_and(|reply| reply.accepted));
    // One that nothing in its name marks is found within a few looks.
    std::fs::write(folder.path().join("9999.command"), text.replace("resume", "abort")).unwrap();
    let found = (0..40).any(|_| commands(&inbox.take(0)).contains(&&Command::Abort));
    assert!(found, "among a thousand others");
}

#[test]
fn a_command_is_handed_on_by_one_of_the_readers() {
    let folder = folder();
    let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
    let mut reports = Reported::both(&mut inbox).unwrap();
    let mut reported = |kind: Kind| reports[kind as usize].take_while(9, || true);
    let send = |command| Sent::send(folder.path(), "d1", &command, given(10.0)).unwrap();
    let all = |taken: &[Taken]| taken.iter().map(|one| one.command.clone()).collect::<Vec<_>>();
    let (_first, _arm) = (send(Command::Abort), send(Command::Arm));
    let stop = reported(Kind::Stops);
    assert_eq!(all(&stop), [Command::Abort], "and nothing else");
    assert!(inbox.take(9).taken.is_empty(), "nothing follows in the look that finds the stop");
    let arm = reported(Kind::Others);
    assert_eq!(all(&arm), [Command::Arm]);
    let later =
        |inbox: &mut Inbox| (0..=REPORTED_WITHIN_LOOKS).flat_map(|_| inbox.take(9).taken).collect::<Vec<_>>();
    assert!(later(&mut inbox).is_empty(), "reported before");
    let (_second, _park) = (send(Command::Abort), send(Command::Park));
    let listed = inbox.take(9).taken;
    assert_eq!(all(&listed), [Command::Abort]);
    assert!(inbox.take(9).taken.is_empty(), "left to the report");
    let park = reported(Kind::Others);
    assert_eq!(all(&park), [Command::Park]);
    assert!(later(&mut inbox).is_empty() && reported(Kind::Stops).is_empty(), "listed before");
    for one in stop.iter().chain(&arm).chain(&listed).chain(&park) {
        one.answer(&Reply::accept("done")).unwrap();
    }
    assert!(inbox.take(9).taken.is_empty() && inbox.folder.names(SUFFIX).unwrap().is_empty());
    assert_eq!(inbox.unanswered(), 0);
    assert!(inbox.unanswered.numbers().is_empty());
}

#[test]
fn a_stop_under_the_name_of_an_earlier_one_counts_whoever_finds_it() {
    for listed in [true, false] {
        let folder = folder();
        let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
        let [mut stops, _others] = Reported::both(&mut inbox).unwrap();
        let leave = |order: &str| {
            let text = r#"{"daemon": "d1", "boot_s": 100.0, "command": {"do": "pause"}}"#;
            std::fs::write(folder.path().join(".new"), text.replace("pause", order)).unwrap();
            std::fs::rename(folder.path().join(".new"), folder.path().join("x-stop.command")).unwrap();
        };
        leave("pause");
        let mut look = || if listed { inbox.take(9).taken } else { stops.take_while(9, || true) };
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
    let first = inbox.first(read()).unwrap().expect("it is new");
    assert!(inbox.first(read()).unwrap().is_none(), "noted");
    first.answer(&Reply::accept("stopped")).unwrap();
    drop(first);
    assert!(inbox.first(late).unwrap().is_none(), "gone from the folder");
    drop(sent);
}

#[test]
fn a_command_whose_file_cannot_be_removed_does_not_count_again_and_takes_no_room() {
    let root = folder();
    let (path, aside) = (root.path().join("commands"), root.path().join("aside"));
    let mut inbox = Inbox::open(&path, "d1").unwrap();
    let [_stops, mut others] = Reported::both(&mut inbox).unwrap();
    let sent = Sent::send(&path, "d1", &Command::Arm, given(10.0)).unwrap();
    let taken = others.take_while(9, || true);
    assert!(matches!(taken.as_slice(), [Taken { command: Command::Arm, .. }]), "{taken:?}");
    assert_eq!(inbox.unanswered(), 1);
    std::fs::rename(&path, &aside).unwrap();
    taken[0].answer(&Reply::accept("armed")).expect_err("there is no folder");
    std::fs::rename(&aside, &path).unwrap();
    drop(taken);
    assert_eq!(inbox.unanswered(), 0);
    for _ in 0..3 * REPORTED_WITHIN_LOOKS {
        assert!(inbox.take(9).taken.is_empty() && others.take_while(9, || true).is_empty());
    }
    assert!(!sent.waits().unwrap(), "the daemon still has it");
}

#[test]
fn files_that_are_gone_again_take_no_more_than_the_time_of_a_look() {
    let folder = folder();
    let inbox = Inbox::open(folder.path(), "d1").unwrap();
    let mut waiting: BTreeSet<String> = (0..9).map(|n| format!("1-7-{n:03}.command")).collect();
    assert!(inbox.take_reported(&mut waiting, 9, || false).is_empty());
    assert_eq!(waiting.len(), 8, "one was looked into");
}

#[test]
fn an_order_in_a_file_that_is_marked_as_a_stop_is_found_by_the_listing() {
    let folder = folder();
    let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
    let [mut stops, mut others] = Reported::both(&mut inbox).unwrap();
    let text = r#"{"daemon": "d1", "boot_s": 100.0, "command": {"do": "arm"}}"#;
    std::fs::write(folder.path().join("new"), text).unwrap();
    std::fs::rename(folder.path().join("new"), folder.path().join("x-stop.command")).unwrap();
    let mut taken = stops.take_while(9, || true);
    assert!(taken.is_empty());
    for _ in 0..=REPORTED_WITHIN_LOOKS + 1 {
        taken.extend(inbox.take(9).taken.into_iter().chain(others.take_while(9, || true)));
    }
    assert!(matches!(taken.as_slice(), [Taken { command: Command::Arm, .. }]), "{taken:?}");
}

#[test]
fn what_was_not_reported_is_taken_after_a_while_and_what_is_no_command_is_refused() {
    let folder = folder();
    let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
    let [_stops, mut others] = Reported::both(&mut inbox).unwrap();
    let text = r#"{"daemon": "d1", "boot_s": 100.0, "command": {"do": "resume"}}"#;
    (0..40).for_each(|n| std::fs::write(folder.path().join(format!("1-7-{n:04}.command")), text).unwrap());
    std::fs::write(folder.path().join("1-8-0.command"), "up").unwrap();
    let (mut taken, mut refused) = (Vec::new(), 0);
    for _ in 0..4 * REPORTED_WITHIN_LOOKS {
        let mail = inbox.take(9);
        assert!(mail.taken.is_empty() && mail.fault.is_none(), "{mail:?}");
        refused += mail.refused.len();
        for one in others.take_while(9, || true) {
            one.answer(&Reply::refuse("too late")).unwrap();
            taken.push(one.path);
        }
    }
    assert!(taken.len() == 40 && taken.is_sorted() && refused == 1, "{} {refused}", taken.len());
}

#[test]
fn a_script_s_commands_without_an_answer_leave_room_for_others() {
    for listed in [true, false] {
        let folder = folder();
        let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
        let [_stops, mut reports] = Reported::both(&mut inbox).unwrap();
        if listed {
            inbox.others = None;
        }
        let text = r#"{"daemon": "d1", "boot_s": 100.0, "command": {"do": "resume"}}"#;
        for n in 0..50 {
            let name = |suffix| folder.path().join(format!("{n:04}.{suffix}"));
            std::fs::write(name("new"), text)
                .and_then(|()| std::fs::rename(name("new"), name("command")))
                .unwrap();
        }
        let look = |inbox: &mut Inbox, reports: &mut Reported| match listed {
            true => inbox.take(100).taken,
            false => reports.take_while(100, || true),
        };
        let mut taken: Vec<Taken> = (0..4).flat_map(|_| look(&mut inbox, &mut reports)).collect();
        assert_eq!(taken.len(), UNANSWERED_OF_A_SENDER);
        let arm = Sent::send(folder.path(), "d1", &Command::Arm, given(1e9)).unwrap();
        let next: Vec<Taken> = (0..2).flat_map(|_| look(&mut inbox, &mut reports)).collect();
        assert!(matches!(next.as_slice(), [Taken { command: Command::Arm, .. }]), "{next:?}");
        taken.drain(..3).for_each(|one| one.answer(&Reply::refuse("too late")).unwrap());
        let more: Vec<Taken> = (0..2).flat_map(|_| look(&mut inbox, &mut reports)).collect();
        assert_eq!(more.len(), 3, "as many as were answered");
        drop(arm);
    }
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
    assert!(inbox.take(0).taken.is_empty() && sent.waits().unwrap());
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

#[test]
fn three_readers_at_once_hand_each_command_on_once() {
    const SENDERS: u32 = 4;
    const EACH: u32 = 50;
    let folder = folder();
    let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
    let [mut stops, mut others] = Reported::both(&mut inbox).unwrap();
    // It lists as a reader of a folder does whose reports are all lost.
    inbox.others = None;
    let (taken, over) = (std::sync::Mutex::new(Vec::new()), std::sync::atomic::AtomicBool::new(false));
    let read = |mut look: Box<dyn FnMut() -> Vec<Taken> + Send>| {
        while !over.load(std::sync::atomic::Ordering::Relaxed) {
            for one in look() {
                taken.lock().unwrap().push((one.path.clone(), one.number));
                one.answer(&Reply::accept("done")).unwrap();
            }
        }
    };
    std::thread::scope(|scope| {
        scope.spawn(|| read(Box::new(move || inbox.take(9).taken)));
        scope.spawn(|| read(Box::new(move || stops.take_while(9, || true))));
        scope.spawn(|| read(Box::new(move || others.take_while(9, || true))));
        let senders: Vec<_> = (0..SENDERS)
            .map(|sender| {
                let path = folder.path();
                scope.spawn(move || {
                    for number in 0..EACH {
                        let command = if number % 4 == sender { Command::Pause } else { Command::Arm };
                        let at = given(f64::from(sender * EACH + number));
                        let sent = Sent::send(path, "d1", &command, at).unwrap();
                        while sent.poll().unwrap().is_none() {
                            std::thread::yield_now();
                        }
                    }
                })
            })
            .collect();
        let ended: Vec<_> = senders.into_iter().map(std::thread::ScopedJoinHandle::join).collect();
        over.store(true, std::sync::atomic::Ordering::Relaxed);
        assert!(ended.iter().all(Result::is_ok));
    });
    let taken = taken.into_inner().unwrap();
    let once: BTreeSet<_> = taken.iter().collect();
    assert_eq!((taken.len(), once.len()), ((SENDERS * EACH) as usize, (SENDERS * EACH) as usize));
}
