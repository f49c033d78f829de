//! Commands of the operator to the running daemon, as files in the state folder.
//!
//! In: a [`Command`] from `celld arm` and its like. Out: the same in the daemon, once, and its answer back.
//! A command is a file, renamed into place whole, that carries the name of the daemon it was meant for: one
//! that was not taken (the daemon had just ended) is never obeyed by the next daemon. Its sender keeps the
//! file locked until it has the answer, so the daemon sees when nobody waits any more
//! (`cell_edge::mailbox`). Stops are taken before everything else that lies there, and removed afterwards;
//! any other command is removed before it is obeyed, so it is either carried out or taken back by its
//! sender. How old a command may be is judged where it is decided (`cell_machine::intake`).

use cell_edge::files::{FileError, create_folder, read_regular, remove, write_answer};
use cell_edge::mailbox::{Left, Mailbox, SenderLock, leave};
use cell_machine::intake::Unreachable;
use cell_machine::orders::{Channels, Order, Reply, Role, WayBack};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Longest file that is read as a command.
const MAX_BYTES: u64 = 64 * 1024;

/// New files that are looked into at a time, to find the stops among them.
const LOOKED_INTO_AT_ONCE: usize = 256;

/// Commands other than stops that are taken at a time.
const TAKEN_AT_ONCE: usize = 8;

/// The answer to a command that was left for an earlier daemon.
pub const FOR_ANOTHER: &str = "this command was meant for a daemon that has ended";

/// How the file of a command is called.
const SUFFIX: &str = ".command";

/// What names the file of a stop besides, so that it is looked into first.
const STOP_MARK: &str = "-stop";

/// When an order was given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Given {
    /// Calendar time, s since 1970: orders the commands of several senders.
    pub unix_s: f64,
    /// Time since the machine started, s: how old the order is.
    pub boot_s: f64,
}

/// What an operator may request of the daemon.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "lowercase", deny_unknown_fields)]
pub enum Command {
    /// Allow motion.
    Arm,
    /// Forbid motion after the present step; a robot that is held or being started is stopped at once.
    Disarm,
    /// Agree to a job's plan.
    Approve {
        /// The job.
        id: String,
        /// Number of the plan that was shown, as in the status.
        plan: u64,
    },
    /// Refuse a job's plan: the job ends as cancelled.
    Reject {
        /// The job.
        id: String,
    },
    /// End a job, waiting or active.
    Cancel {
        /// The job.
        id: String,
    },
    /// Stop after the present step.
    Pause,
    /// Go on after a pause.
    Resume,
    /// One step, then pause.
    Step,
    /// Stop the arm now and end the active job.
    Abort,
    /// Move to the park pose, gripper empty.
    Park,
    /// Stop and disarm, then vacuum off, wherever the arm is.
    Release {
        /// Absent: both.
        channel: Option<ReleaseChannel>,
    },
    /// Leave a stop.
    Recover {
        /// How.
        how: WayBack,
    },
    /// What answers at the gripper's address is the gripper.
    #[serde(rename = "confirm-gripper")]
    ConfirmGripper,
    /// A calibration round to the taught poses.
    Calibrate,
    /// Sign a person in at the page. Not for the machine.
    #[serde(rename = "sign-in")]
    SignIn(SignIn),
    /// End sessions and tokens of the page, and links that were not used. Not for the machine.
    #[serde(rename = "sign-out")]
    SignOut {
        /// Of whom.
        name: String,
    },
}

/// Who is to be signed in at the page, and how.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignIn {
    /// What the person may do.
    pub role: Role,
    /// How the person is called; absent: as the system calls who gave the command.
    pub name: Option<String>,
    /// A token for a program, for so many days; absent: a link that signs a browser in once.
    pub token_days: Option<u32>,
    /// The link is for a browser of who gives the command, on this computer, and counts for no other.
    #[serde(default)]
    pub own_browser: bool,
}

/// A suction channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ReleaseChannel {
    /// Channel A.
    A,
    /// Channel B.
    B,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Envelope {
    daemon: String,
    /// When it was given, s since the machine started.
    boot_s: f64,
    command: Command,
}

impl Command {
    /// The order to the machine; `None` for what is not for the machine.
    pub fn order(&self) -> Option<Order> {
        Some(match self {
            Command::Arm => Order::Arm,
            Command::Disarm => Order::Disarm,
            Command::Approve { id, plan } => Order::Approve { id: id.clone(), plan: *plan },
            Command::Reject { id } => Order::Reject(id.clone()),
            Command::Cancel { id } => Order::Cancel(id.clone()),
            Command::Pause => Order::Pause,
            Command::Resume => Order::Resume,
            Command::Step => Order::Step,
            Command::Abort => Order::Abort,
            Command::Park => Order::Park,
            Command::Release { channel } => Order::Release(match channel {
                Some(ReleaseChannel::A) => Channels::A,
                Some(ReleaseChannel::B) => Channels::B,
                None => Channels::Both,
            }),
            Command::Recover { how } => Order::Recover(*how),
            Command::ConfirmGripper => Order::ConfirmGripper,
            Command::Calibrate => Order::Calibrate,
            Command::SignIn(_) | Command::SignOut { .. } => return None,
        })
    }

    /// It only stops: obeyed however old it is, and whoever waits for it.
    pub fn only_stops(&self) -> bool {
        self.order().is_some_and(|order| order.only_stops())
    }
}

/// A command that the daemon took, to be answered.
#[derive(Clone, Debug)]
pub struct Taken {
    /// What is requested.
    pub command: Command,
    /// Who gave it: the system's number of the owner of its file.
    pub uid: u32,
    /// When it was given, s since the machine started, as its sender says.
    pub boot_s: f64,
    /// Held while its sender waits for the answer.
    pub lock: SenderLock,
    path: PathBuf,
}

impl Taken {
    /// Removes the file of a stop, and leaves the answer.
    ///
    /// # Errors
    /// The answer cannot be written.
    pub fn answer(&self, reply: &Reply) -> Result<(), FileError> {
        if self.command.only_stops() {
            let _ = std::fs::remove_file(&self.path);
        }
        answer(&self.path, self.uid, reply)
    }
}

/// What a look into the folder brought.
#[derive(Debug, Default)]
pub struct Mail {
    /// Commands, stops first, then in the order of sending.
    pub taken: Vec<Taken>,
    /// Files that are no command for this daemon, with their answers.
    pub refused: Vec<Refused>,
    /// Why not everything could be taken.
    pub fault: Option<Unreachable>,
}

/// A file that is no command for this daemon.
#[derive(Debug)]
pub struct Refused {
    path: PathBuf,
    uid: u32,
    why: &'static str,
}

impl Refused {
    /// Leaves the answer.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn answer(&self) -> Result<(), FileError> {
        answer(&self.path, self.uid, &Reply::refuse(self.why))
    }
}

/// What is known of a file that lies in the folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Known {
    /// A stop that was handed on; its file is about to go.
    Obeyed,
    /// Anything else: its turn comes.
    Waits,
}

/// The daemon's end.
#[derive(Debug)]
pub struct Inbox {
    mailbox: Mailbox,
    daemon: String,
    known: BTreeMap<String, Known>,
}

impl Inbox {
    /// Opens the folder for the daemon called `daemon` (a name no other run has) and clears what was left.
    ///
    /// # Errors
    /// The folder cannot be created or listed, or a file in it cannot be removed.
    pub fn open(folder: &Path, daemon: impl Into<String>) -> Result<Inbox, FileError> {
        create_folder(folder)?;
        let mailbox = Mailbox::open(folder)?;
        for name in mailbox.names("")? {
            if !folder.join(&name).is_dir() {
                mailbox.claim(&name)?;
            }
        }
        Ok(Inbox { mailbox, daemon: daemon.into(), known: BTreeMap::new() })
    }

    /// Takes what is there: every stop, and up to `room` other commands in the order of sending. Whatever
    /// happens to one file, what was taken besides is returned.
    pub fn take(&mut self, room: usize) -> Mail {
        let mut mail = Mail::default();
        let folder = || self.mailbox.path().display().to_string();
        if !self.mailbox.is_in_place() {
            mail.fault = Some(Unreachable::FolderGone(folder()));
            return mail;
        }
        let names = match self.mailbox.names(SUFFIX) {
            Ok(names) => names,
            Err(error) => {
                mail.fault = Some(Unreachable::Unreadable(folder(), error.reason()));
                return mail;
            }
        };
        self.known.retain(|name, _| names.binary_search(name).is_ok());
        self.take_stops(&names, &mut mail);
        let mut room = room.min(TAKEN_AT_ONCE);
        for name in names.iter().filter(|name| self.known.get(*name) == Some(&Known::Waits)) {
            if room == 0 {
                break;
            }
            room -= 1;
            self.take_one(name, &mut mail);
        }
        mail
    }

    /// Looks into new files and takes the stops among them.
    fn take_stops(&mut self, names: &[String], mail: &mut Mail) {
        let (stops, others): (Vec<&String>, Vec<&String>) = names
            .iter()
            .filter(|name| !self.known.contains_key(*name))
            .partition(|name| name.contains(STOP_MARK));
        for name in stops.into_iter().chain(others).take(LOOKED_INTO_AT_ONCE) {
            match self.read(name) {
                Ok(Ok(taken)) if taken.command.only_stops() => {
                    self.known.insert(name.clone(), Known::Obeyed);
                    mail.taken.push(taken);
                }
                Ok(_) => _ = self.known.insert(name.clone(), Known::Waits),
                Err(fault) => mail.fault = fault.or(mail.fault.take()),
            }
        }
    }

    /// Takes a command that is no stop: removed first, so that its sender cannot take it back any more.
    fn take_one(&self, name: &str, mail: &mut Mail) {
        let read = match self.read(name) {
            Ok(read) => read,
            Err(fault) => return mail.fault = fault.or(mail.fault.take()),
        };
        match self.mailbox.claim(name) {
            // Its sender has taken it back.
            Ok(false) => {}
            Ok(true) => match read {
                Ok(taken) => mail.taken.push(taken),
                Err(refused) => mail.refused.push(refused),
            },
            Err(error) => mail.fault = Some(self.unreadable(&error)),
        }
    }

    /// A file as a command, or why it is none. The error is of the folder; `None`: the file is gone.
    fn read(&self, name: &str) -> Result<Result<Taken, Refused>, Option<Unreachable>> {
        let path = self.mailbox.path().join(name);
        let refused = |uid, why| Ok(Err(Refused { path: path.clone(), uid, why }));
        let letter = match self.mailbox.read(name, MAX_BYTES) {
            Ok(letter) => letter,
            Err(error) if error.is_absent() => return Err(None),
            Err(FileError::Unfit { .. }) => return refused(u32::MAX, NO_COMMAND),
            Err(error) => return Err(Some(self.unreadable(&error))),
        };
        match serde_json::from_str::<Envelope>(&letter.text) {
            Err(_) => refused(letter.uid, NO_COMMAND),
            Ok(Envelope { daemon, .. }) if daemon != self.daemon => refused(letter.uid, FOR_ANOTHER),
            Ok(Envelope { boot_s, command, .. }) => {
                Ok(Ok(Taken { command, uid: letter.uid, boot_s, lock: letter.lock, path }))
            }
        }
    }

    fn unreadable(&self, error: &FileError) -> Unreachable {
        Unreachable::Unreadable(self.mailbox.path().display().to_string(), error.reason())
    }
}

const NO_COMMAND: &str = "this file is not a command of this version of celld";

/// A command on its way, seen from the sender. As long as it is kept, the daemon sees that its sender waits.
#[derive(Debug)]
pub struct Sent {
    left: Left,
    reply: PathBuf,
}

impl Sent {
    /// Leaves `command` for the daemon called `daemon`.
    ///
    /// # Errors
    /// The command cannot be written, or 1000 commands of this process with the same time are still
    /// there.
    pub fn send(folder: &Path, daemon: &str, command: &Command, given: Given) -> Result<Sent, FileError> {
        let envelope = Envelope { daemon: daemon.to_owned(), boot_s: given.boot_s, command: command.clone() };
        let text = serde_json::to_string(&envelope).expect("commands have string keys only");
        let pid = std::process::id();
        let micros = (given.unix_s * 1e6) as u64;
        let mark = if command.only_stops() { STOP_MARK } else { "" };
        let names = (0..1000).map(|number| format!("{micros:020}-{pid}-{number:03}{mark}{SUFFIX}"));
        let left = leave(folder, names, text.as_bytes())?;
        Ok(Sent { reply: left.path.with_extension("reply"), left })
    }

    /// The answer, once it is there; it is removed.
    ///
    /// # Errors
    /// The answer is there, but it cannot be read or removed.
    pub fn poll(&self) -> Result<Option<Reply>, FileError> {
        poll(&self.reply)
    }

    /// Takes the command back; false when the daemon has it already.
    ///
    /// # Errors
    /// The command cannot be removed.
    pub fn withdraw(&self) -> Result<bool, FileError> {
        match std::fs::remove_file(&self.left.path) {
            Ok(()) => Ok(true),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(false),
            Err(source) => Err(FileError::Io { action: "take back", path: self.left.path.clone(), source }),
        }
    }

    /// The command still lies there: no daemon has taken it.
    pub fn lies_there(&self) -> bool {
        self.left.path.exists()
    }

    /// Waits no longer: the daemon carries the command out only if it was decided before. What is left is
    /// the place of the answer.
    pub fn let_go(self) -> LastWord {
        LastWord(self.reply)
    }
}

/// Where the answer to a command appears that nobody waits for any more.
#[derive(Debug)]
pub struct LastWord(PathBuf);

impl LastWord {
    /// As [`Sent::poll`].
    ///
    /// # Errors
    /// As [`Sent::poll`].
    pub fn poll(&self) -> Result<Option<Reply>, FileError> {
        poll(&self.0)
    }
}

fn poll(reply: &Path) -> Result<Option<Reply>, FileError> {
    let text = match read_regular(reply, MAX_BYTES) {
        Err(error) if error.is_absent() => return Ok(None),
        other => other?.0,
    };
    remove(reply)?;
    let unreadable = |_| Reply { accepted: false, message: "the daemon's answer is not readable".to_owned() };
    Ok(Some(serde_json::from_str(&text).unwrap_or_else(unreadable)))
}

/// An answer may be a secret (`celld open`): it is for the user who gave the command, and another user than
/// the daemon's reads it by the group that both are in.
fn answer(command: &Path, requested_by: u32, reply: &Reply) -> Result<(), FileError> {
    let text = serde_json::to_string(reply).expect("replies have string keys only");
    let own = requested_by == rustix::process::geteuid().as_raw();
    write_answer(&command.with_extension("reply"), text.as_bytes(), !own)
}

#[cfg(test)]
mod tests {
    use super::*;
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
    fn a_stop_is_taken_before_a_thousand_other_commands() {
        let folder = folder();
        let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
        let text = r#"{"daemon": "d1", "boot_s": 100.0, "command": {"do": "resume"}}"#;
        (0..1000).for_each(|n| std::fs::write(folder.path().join(format!("{n:04}.command")), text).unwrap());
        let abort = Sent::send(folder.path(), "d1", &Command::Abort, given(10.0)).unwrap();
        let mail = inbox.take(3);
        assert_eq!(commands(&mail), [&Command::Abort, &Command::Resume, &Command::Resume, &Command::Resume]);
        assert!(abort.lies_there() && !commands(&inbox.take(3)).contains(&&Command::Abort), "obeyed once");
        mail.taken[0].answer(&Reply::accept("stopped")).unwrap();
        assert!(!abort.lies_there() && abort.poll().unwrap().is_some_and(|reply| reply.accepted));
        // One that nothing in its name marks is found within a few looks.
        std::fs::write(folder.path().join("9999.command"), text.replace("resume", "abort")).unwrap();
        let found = (0..8).any(|_| commands(&inbox.take(0)).contains(&&Command::Abort));
        assert!(found, "among a thousand others");
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
        assert!(inbox.mailbox.names(SUFFIX).unwrap().is_empty());
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
}
