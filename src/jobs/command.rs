//! Commands of the operator to the running daemon, as files in the state folder.
//!
//! In: a [`Command`] from `celld arm` and its like. Out: the same in the daemon, once, and its answer back.
//! A command is a file, renamed into place whole, that carries the name of the daemon it was meant for: one
//! that was not taken (the daemon had just ended) is never obeyed by the next daemon, and one that is read
//! more than [`COUNTS_FOR_S`] after it was given is refused, so an old `arm` cannot move an arm. What only
//! stops is obeyed however old. The daemon removes the file before it obeys: a command is carried out at
//! most once.

use cell_edge::files::{FileError, create_folder, read_regular, remove, take_away, write_new, write_secret};
use cell_machine::orders::{Channels, Order, Reply, Role, WayBack};
use serde::{Deserialize, Serialize};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Longest file that is read as a command.
const MAX_BYTES: u64 = 64 * 1024;

/// Most commands taken in one turn; the rest waits for the next.
const MAX_AT_ONCE: usize = 4;

/// For so long an order counts, s: a daemon that was held up (a slow disk, a stopped process) must not move
/// the arm for a person who has gone on to something else.
pub const COUNTS_FOR_S: f64 = 10.0;

/// The answer to a command that was left for an earlier daemon.
pub const FOR_ANOTHER: &str = "this command was meant for a daemon that has ended";

/// Clocks of one machine agree; an order from further ahead was not stamped on this one.
const AHEAD_S: f64 = 1.0;

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
        /// Number of the plan, as in the status; absent: the one that waits.
        plan: Option<u64>,
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

impl Envelope {
    /// Why it does not count any more at `boot_s`, if so.
    fn outdated(&self, boot_s: f64) -> Option<String> {
        let age_s = boot_s - self.boot_s;
        // Written so that an age that is no number is outdated.
        let counts = self.command.counts_always() || (-AHEAD_S..=COUNTS_FOR_S).contains(&age_s);
        (!counts).then(|| {
            format!(
                "nothing was done: this order was given {age_s:.0} s ago and counts for {COUNTS_FOR_S:.0} s; \
                     look at the cell, then give it again"
            )
        })
    }
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

    /// It only stops: obeyed however old it is.
    fn counts_always(&self) -> bool {
        self.order().is_some_and(|order| order.only_stops())
    }
}

/// A command that the daemon took, to be answered.
#[derive(Clone, Debug, PartialEq)]
pub struct Taken {
    /// What is requested.
    pub command: Command,
    /// Who gave it: the system's number of the owner of its file.
    pub uid: Option<u32>,
    /// When it was given, s since the machine started, as its sender says.
    pub boot_s: f64,
    reply: PathBuf,
}

/// The daemon's end.
#[derive(Debug)]
pub struct Inbox {
    folder: PathBuf,
    daemon: String,
}

impl Inbox {
    /// Opens the folder for the daemon called `daemon` (a name no other run has) and clears what was left.
    ///
    /// # Errors
    /// The folder cannot be created or listed, or a file in it cannot be removed.
    pub fn open(folder: &Path, daemon: impl Into<String>) -> Result<Inbox, FileError> {
        create_folder(folder)?;
        for path in list(folder)? {
            remove(&path)?;
        }
        Ok(Inbox { folder: folder.to_owned(), daemon: daemon.into() })
    }

    /// Takes what is there, in the order of sending; `boot_now_s` gives the s since the machine started.
    /// Files that are no command for this daemon are removed, and so are orders that do not count any more.
    /// Their age counts when they were removed, which a slow disk may delay; what its sender has taken back
    /// meanwhile is not obeyed. Whatever happens to one file, the commands taken before it are returned: an
    /// abort must not be lost to a full disk.
    ///
    /// # Errors
    /// The folder cannot be listed. A single file that makes trouble is logged and is no error.
    pub fn take(&mut self, boot_now_s: impl Fn() -> f64) -> Result<Vec<Taken>, FileError> {
        let mut taken = Vec::new();
        for path in list(&self.folder)?.into_iter().filter(|path| is_command(path)).take(MAX_AT_ONCE) {
            let uid = std::fs::symlink_metadata(&path).ok().map(|file| file.uid());
            let envelope = read_regular(&path, MAX_BYTES)
                .ok()
                .and_then(|(text, _)| serde_json::from_str::<Envelope>(&text).ok());
            match take_away(&path) {
                Ok(true) => {}
                // Its sender has taken it back.
                Ok(false) => continue,
                Err(error) => {
                    tracing::warn!(%error, "a command could not be taken");
                    break;
                }
            }
            let reply = path.with_extension("reply");
            let refused = match envelope {
                Some(envelope) if envelope.daemon == self.daemon => match envelope.outdated(boot_now_s()) {
                    Some(why) => {
                        tracing::warn!(command = ?envelope.command, "refused: {why}");
                        why
                    }
                    None => {
                        let Envelope { command, boot_s, .. } = envelope;
                        taken.push(Taken { command, uid, boot_s, reply });
                        continue;
                    }
                },
                Some(_) => FOR_ANOTHER.to_string(),
                None => "this file is not a command of this version of celld".to_string(),
            };
            if let Err(error) = answer(&reply, uid, false, &refused) {
                tracing::warn!(%error, "a command could not be answered");
            }
        }
        Ok(taken)
    }

    /// Answers a command.
    ///
    /// # Errors
    /// The answer cannot be written.
    pub fn reply(&self, taken: &Taken, reply: &Reply) -> Result<(), FileError> {
        answer(&taken.reply, taken.uid, reply.accepted, &reply.message)
    }
}

/// A command on its way, seen from the sender.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sent {
    command: PathBuf,
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
        let names = (0..1000).map(|number| format!("{micros:020}-{pid}-{number:03}.command"));
        let path = folder.join(write_new(folder, names, text.as_bytes())?);
        Ok(Sent { reply: path.with_extension("reply"), command: path })
    }

    /// The answer, once it is there; it is removed.
    ///
    /// # Errors
    /// The answer is there, but it cannot be read or removed.
    pub fn poll(&self) -> Result<Option<Reply>, FileError> {
        let text = match read_regular(&self.reply, MAX_BYTES) {
            Err(error) if error.is_absent() => return Ok(None),
            other => other?.0,
        };
        remove(&self.reply)?;
        let unreadable =
            |_| Reply { accepted: false, message: "the daemon's answer is not readable".to_owned() };
        Ok(Some(serde_json::from_str(&text).unwrap_or_else(unreadable)))
    }

    /// Takes the command back; false when the daemon has it already.
    ///
    /// # Errors
    /// The command cannot be removed, or its folder cannot be synced.
    pub fn withdraw(&self) -> Result<bool, FileError> {
        let there = self.command.exists();
        remove(&self.command)?;
        Ok(there)
    }
}

/// An answer may be a secret (`celld open`): it is for whoever gave the command, and another user than the
/// daemon's reads it by the group that both are in.
fn answer(path: &Path, requested_by: Option<u32>, accepted: bool, message: &str) -> Result<(), FileError> {
    let reply = Reply { accepted, message: message.to_owned() };
    let text = serde_json::to_string(&reply).expect("replies have string keys only");
    let own = requested_by == Some(rustix::process::geteuid().as_raw());
    write_secret(path, text.as_bytes(), !own)
}

fn is_command(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "command")
}

/// Plain entries of the folder by name; what is hidden is still being written.
fn list(folder: &Path) -> Result<Vec<PathBuf>, FileError> {
    let fail = |source| FileError::Io { action: "list", path: folder.to_owned(), source };
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let entry = entry.map_err(fail)?;
        let hidden = entry.file_name().to_string_lossy().starts_with('.');
        if !hidden && entry.file_type().is_ok_and(|kind| !kind.is_dir()) {
            paths.push(entry.path());
        }
    }
    paths.sort();
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn given(unix_s: f64) -> Given {
        Given { unix_s, boot_s: 100.0 }
    }

    fn folder() -> tempfile::TempDir {
        tempfile::tempdir().unwrap()
    }

    #[test]
    fn commands_arrive_once_in_order_and_are_answered() {
        let folder = folder();
        let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
        let approve = Command::Approve { id: "tidy".into(), plan: Some(3) };
        let first = Sent::send(folder.path(), "d1", &Command::Arm, given(10.0)).unwrap();
        Sent::send(folder.path(), "d1", &approve, given(10.0)).unwrap();
        assert_eq!(first.poll().unwrap(), None);
        let taken = inbox.take(|| 100.0).unwrap();
        assert_eq!(taken.iter().map(|taken| &taken.command).collect::<Vec<_>>(), [&Command::Arm, &approve]);
        assert!(inbox.take(|| 100.0).unwrap().is_empty());
        let reply = Reply { accepted: false, message: "the robot is in local mode".into() };
        inbox.reply(&taken[0], &reply).unwrap();
        // The asker is the daemon's own user here: an answer may be a secret.
        let mode = std::fs::metadata(&first.reply).unwrap().mode() & 0o777;
        assert_eq!(mode, 0o600);
        assert_eq!(first.poll().unwrap(), Some(reply));
        assert_eq!(first.poll().unwrap(), None);
    }

    #[test]
    fn an_old_command_never_reaches_the_next_daemon() {
        let folder = folder();
        let late = Sent::send(folder.path(), "d1", &Command::Arm, given(10.0)).unwrap();
        let mut inbox = Inbox::open(folder.path(), "d2").unwrap();
        assert!(inbox.take(|| 100.0).unwrap().is_empty(), "cleared at start");
        let later = Sent::send(folder.path(), "d1", &Command::Arm, given(11.0)).unwrap();
        assert!(inbox.take(|| 100.0).unwrap().is_empty(), "meant for the daemon before");
        assert!(!later.poll().unwrap().unwrap().accepted);
        assert!(!late.withdraw().unwrap());
    }

    #[test]
    fn an_order_counts_for_ten_seconds_unless_it_only_stops() {
        let id = || "tidy".to_string();
        let commands = [
            (Command::Arm, false),
            (Command::Disarm, true),
            (Command::Approve { id: id(), plan: None }, false),
            (Command::Reject { id: id() }, false),
            (Command::Cancel { id: id() }, false),
            (Command::Pause, true),
            (Command::Resume, false),
            (Command::Step, false),
            (Command::Abort, true),
            (Command::Park, false),
            (Command::Release { channel: None }, false),
            (Command::Recover { how: WayBack::Show }, false),
            (Command::ConfirmGripper, false),
            (Command::Calibrate, false),
            (
                Command::SignIn(SignIn {
                    role: Role::View,
                    name: None,
                    token_days: None,
                    own_browser: false,
                }),
                false,
            ),
        ];
        for (command, always) in commands {
            // Read in time, late, stamped on another clock, and stamped with no number at all.
            for (boot_s, counts) in [(109.9, true), (110.1, always), (98.0, always), (f64::NAN, always)] {
                let folder = folder();
                let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
                let sent = Sent::send(folder.path(), "d1", &command, given(10.0)).unwrap();
                let taken = inbox.take(|| boot_s).unwrap();
                assert_eq!(taken.len(), usize::from(counts), "{command:?} at {boot_s}");
                let refused = sent.poll().unwrap();
                assert_eq!(refused.is_some(), !counts, "{command:?} at {boot_s}");
                assert!(refused.is_none_or(|reply| !reply.accepted && reply.message.contains("again")));
            }
        }
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
        ] {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        std::os::unix::fs::symlink("/dev/zero", folder.path().join("4.command")).unwrap();
        (0..2).for_each(|_| assert!(inbox.take(|| 100.0).unwrap().is_empty()));
        assert!(!list(folder.path()).unwrap().iter().any(|path| is_command(path)));
    }

    #[test]
    fn a_command_can_be_taken_back() {
        let folder = folder();
        let mut inbox = Inbox::open(folder.path(), "d1").unwrap();
        let sent = Sent::send(folder.path(), "d1", &Command::Park, given(10.0)).unwrap();
        assert!(sent.withdraw().unwrap());
        assert!(inbox.take(|| 100.0).unwrap().is_empty());
    }
}
