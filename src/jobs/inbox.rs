//! The folder of commands, as the daemon reads it.
//!
//! In: a folder, through the calls of [`Folder`] alone, so that the closed loop has one without files. Out:
//! commands, each once, stops before everything else; files that are no commands, with their answers; why
//! the folder cannot be read. Listing the folder may wait for its senders, who take the same lock of the
//! system; so stops are also read by the names that the kernel reports, on a thread of their own
//! ([`ReportedStops`]).

use crate::jobs::command::{Command, Envelope, MAX_BYTES, STOP_MARK, SUFFIX, sender_of};
use cell_edge::files::{FileError, create_folder, write_answer};
use cell_edge::mailbox::{Arrivals, FileId, Letter, Mailbox, SenderLock};
use cell_machine::intake::Unreachable;
use cell_machine::orders::Reply;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// New files read per look, to find stops without the mark in their names.
const LOOKED_INTO_AT_ONCE: usize = 32;

/// Commands other than stops that are taken at a time.
const TAKEN_AT_ONCE: usize = 32;

/// Stops that are remembered as handed on; their files are removed with the answer, a moment later.
const HANDED_ON_MAX: usize = 1024;

/// The answer to a command that was left for an earlier daemon.
pub const FOR_ANOTHER: &str = "this command was meant for a daemon that has ended";

const NO_COMMAND: &str = "this file is not a command of this version of celld";

/// The calls by which commands are read.
pub trait Folder {
    /// Held while the sender of a command waits.
    type Lock;

    /// The folder's path, for answers and faults.
    fn path(&self) -> &Path;

    /// Its name still leads to it.
    fn is_in_place(&self) -> bool;

    /// The names that end in `suffix`, in order.
    ///
    /// # Errors
    /// The folder cannot be listed.
    fn names(&self, suffix: &str) -> Result<Vec<String>, FileError>;

    /// The plain file of this name.
    ///
    /// # Errors
    /// It is none of at most `max_bytes`, or cannot be read ([`FileError::is_absent`]: it is gone).
    fn read(&self, name: &str, max_bytes: u64) -> Result<Letter<Self::Lock>, FileError>;

    /// Removes a file; false where its sender has taken it back.
    ///
    /// # Errors
    /// The system refuses.
    fn claim(&self, name: &str) -> Result<bool, FileError>;
}

impl Folder for Mailbox {
    type Lock = SenderLock;

    fn path(&self) -> &Path {
        Mailbox::path(self)
    }

    fn is_in_place(&self) -> bool {
        Mailbox::is_in_place(self)
    }

    fn names(&self, suffix: &str) -> Result<Vec<String>, FileError> {
        Mailbox::names(self, suffix)
    }

    fn read(&self, name: &str, max_bytes: u64) -> Result<Letter, FileError> {
        Mailbox::read(self, name, max_bytes)
    }

    fn claim(&self, name: &str) -> Result<bool, FileError> {
        Mailbox::claim(self, name)
    }
}

/// A command that the daemon took, to be answered.
#[derive(Clone, Debug)]
pub struct Taken<L = SenderLock> {
    /// Which file it was.
    pub id: FileId,
    /// What is requested.
    pub command: Command,
    /// Who gave it: the system's number of the owner of its file.
    pub uid: u32,
    /// When it was given, s since the machine started, as its sender says.
    pub boot_s: f64,
    /// Held while its sender waits for the answer.
    pub lock: L,
    /// Where its file lay.
    pub path: PathBuf,
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
#[derive(Debug)]
pub struct Mail<L = SenderLock> {
    /// Commands, stops first, then the senders in turn.
    pub taken: Vec<Taken<L>>,
    /// Files that are no command for this daemon, with their answers.
    pub refused: Vec<Refused>,
    /// Why not everything could be taken.
    pub fault: Option<Unreachable>,
}

impl<L> Default for Mail<L> {
    fn default() -> Mail<L> {
        Mail { taken: Vec::new(), refused: Vec::new(), fault: None }
    }
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

/// Stops that were handed on, by listing or by report: each counts once.
#[derive(Clone, Debug, Default)]
struct HandedOn(Arc<Mutex<VecDeque<FileId>>>);

impl HandedOn {
    /// Notes a stop; false if it is noted already.
    fn note(&self, id: FileId) -> bool {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if all.contains(&id) {
            return false;
        }
        if all.len() >= HANDED_ON_MAX {
            all.pop_front();
        }
        all.push_back(id);
        true
    }
}

/// The daemon's end.
#[derive(Debug)]
pub struct Inbox<F = Mailbox> {
    folder: F,
    daemon: String,
    known: BTreeMap<String, Known>,
    handed_on: HandedOn,
}

impl Inbox {
    /// Opens the folder and removes every file in it. `daemon` is the name of this run, which no other run
    /// has.
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
        Ok(Inbox::of(mailbox, daemon))
    }

    /// A second reader of the same folder, for another thread: a stop is handed on by one of the two.
    ///
    /// # Errors
    /// The folder cannot be opened or watched.
    pub fn reported_stops(&self) -> Result<ReportedStops, FileError> {
        let folder = Mailbox::open(self.folder.path())?;
        let arrivals = folder.arrivals()?;
        let (daemon, handed_on) = (self.daemon.clone(), self.handed_on.clone());
        Ok(ReportedStops { inbox: Inbox { folder, daemon, known: BTreeMap::new(), handed_on }, arrivals })
    }
}

/// The stops whose files the kernel reports as they come.
#[derive(Debug)]
pub struct ReportedStops {
    inbox: Inbox,
    arrivals: Arrivals,
}

impl ReportedStops {
    /// The reader beneath.
    pub fn inbox(&self) -> &Inbox {
        &self.inbox
    }

    /// Those since the last call that nobody has handed on.
    pub fn take(&self) -> Vec<Taken> {
        self.inbox.take_reported_stops(&self.arrivals.names(SUFFIX))
    }
}

impl<F: Folder> Inbox<F> {
    /// Reads this folder for the daemon called `daemon`.
    pub fn of(folder: F, daemon: impl Into<String>) -> Inbox<F> {
        Inbox { folder, daemon: daemon.into(), known: BTreeMap::new(), handed_on: HandedOn::default() }
    }

    /// The folder.
    pub fn folder(&self) -> &F {
        &self.folder
    }

    /// Takes the stops among the files of these names, which have just come. Only names with the mark of a
    /// stop are looked up: to look for a file that is gone again the system waits for the folder's lock.
    pub fn take_reported_stops(&self, names: &[String]) -> Vec<Taken<F::Lock>> {
        let marked = names.iter().filter(|name| name.contains(STOP_MARK));
        let stops = marked.filter_map(|name| self.read(name).ok()?.ok());
        stops.filter(|taken| taken.command.only_stops() && self.handed_on.note(taken.id)).collect()
    }

    /// Takes every stop, and up to `room` other commands, in turn by sender and by time within a sender: a
    /// script with a thousand commands delays only its own. Whatever happens to one file, what was taken
    /// besides is returned.
    pub fn take(&mut self, room: usize) -> Mail<F::Lock> {
        self.take_while(room, || true)
    }

    /// The same, but after `in_time` has become false only stops: each of the others may wait for the
    /// folder's lock.
    pub fn take_while(&mut self, room: usize, in_time: impl Fn() -> bool) -> Mail<F::Lock> {
        let mut mail = Mail::default();
        let folder = || self.folder.path().display().to_string();
        if !self.folder.is_in_place() {
            mail.fault = Some(Unreachable::FolderGone(folder()));
            return mail;
        }
        let names = match self.folder.names(SUFFIX) {
            Ok(names) => names,
            Err(error) => {
                mail.fault = Some(Unreachable::Unreadable(folder(), error.reason()));
                return mail;
            }
        };
        self.known.retain(|name, _| names.binary_search(name).is_ok());
        self.take_stops(&names, &mut mail);
        let waiting = names.iter().filter(|name| self.known.get(*name) == Some(&Known::Waits));
        for name in in_turn(waiting).into_iter().take(room.min(TAKEN_AT_ONCE)).take_while(|_| in_time()) {
            self.take_one(name, &mut mail);
        }
        mail
    }

    /// Looks into new files and takes the stops among them.
    fn take_stops(&mut self, names: &[String], mail: &mut Mail<F::Lock>) {
        let (stops, others): (Vec<&String>, Vec<&String>) = names
            .iter()
            .filter(|name| !self.known.contains_key(*name))
            .partition(|name| name.contains(STOP_MARK));
        let others = in_turn(others.into_iter());
        for name in stops.into_iter().chain(others).take(LOOKED_INTO_AT_ONCE) {
            match self.read(name) {
                Ok(Ok(taken)) if taken.command.only_stops() => {
                    self.known.insert(name.clone(), Known::Obeyed);
                    if self.handed_on.note(taken.id) {
                        mail.taken.push(taken);
                    }
                }
                Ok(_) => _ = self.known.insert(name.clone(), Known::Waits),
                Err(fault) => mail.fault = fault.or(mail.fault.take()),
            }
        }
    }

    /// Takes a command that is no stop: removed first, so that its sender cannot take it back any more.
    fn take_one(&self, name: &str, mail: &mut Mail<F::Lock>) {
        let read = match self.read(name) {
            Ok(read) => read,
            Err(fault) => return mail.fault = fault.or(mail.fault.take()),
        };
        match self.folder.claim(name) {
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
    fn read(&self, name: &str) -> Result<Result<Taken<F::Lock>, Refused>, Option<Unreachable>> {
        let path = self.folder.path().join(name);
        let refused = |uid, why| Ok(Err(Refused { path: path.clone(), uid, why }));
        let letter = match self.folder.read(name, MAX_BYTES) {
            Ok(letter) => letter,
            Err(error) if error.is_absent() => return Err(None),
            Err(FileError::Unfit { .. }) => return refused(u32::MAX, NO_COMMAND),
            Err(error) => return Err(Some(self.unreadable(&error))),
        };
        match serde_json::from_str::<Envelope>(&letter.text) {
            Err(_) => refused(letter.uid, NO_COMMAND),
            Ok(Envelope { daemon, .. }) if daemon != self.daemon => refused(letter.uid, FOR_ANOTHER),
            Ok(Envelope { boot_s, command, .. }) => {
                let Letter { id, uid, lock, .. } = letter;
                Ok(Ok(Taken { id, command, uid, boot_s, lock, path }))
            }
        }
    }

    fn unreadable(&self, error: &FileError) -> Unreachable {
        Unreachable::Unreadable(self.folder.path().display().to_string(), error.reason())
    }
}

/// The first of each sender's files, then the second of each, and so on; `names` are in order.
fn in_turn<'a>(names: impl Iterator<Item = &'a String>) -> Vec<&'a String> {
    let mut before: HashMap<&str, usize> = HashMap::new();
    let mut turns: Vec<(usize, &String)> = names
        .map(|name| {
            let turn = before.entry(sender_of(name)).or_default();
            *turn += 1;
            (*turn, name)
        })
        .collect();
    // Stable: within a turn they stay in order.
    turns.sort_by_key(|(turn, _)| *turn);
    turns.into_iter().map(|(_, name)| name).collect()
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
        assert_eq!(commands(&mail), [&Command::Abort, &Command::Resume, &Command::Resume, &Command::Resume]);
        assert!(abort.lies_there() && !commands(&inbox.take(3)).contains(&&Command::Abort), "obeyed once");
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
        let stops = inbox.reported_stops().unwrap();
        let reported = || stops.take().into_iter().map(|one| one.command).collect::<Vec<_>>();
        let send = |command| Sent::send(folder.path(), "d1", &command, given(10.0)).unwrap();
        let (_first, _arm) = (send(Command::Abort), send(Command::Arm));
        assert_eq!(reported(), [Command::Abort], "and nothing else");
        assert_eq!(commands(&inbox.take(9)), [&Command::Arm]);
        let _second = send(Command::Abort);
        assert_eq!(commands(&inbox.take(9)), [&Command::Abort]);
        assert!(reported().is_empty(), "listed before");
        // The same name once more, as a script may choose it.
        for name in inbox.folder.names(SUFFIX).unwrap() {
            let (path, hidden) = (folder.path().join(name), folder.path().join(".again"));
            std::fs::copy(&path, &hidden).unwrap();
            std::fs::rename(&hidden, &path).unwrap();
            assert_eq!(reported(), [Command::Abort]);
        }
        assert!(inbox.take(9).taken.is_empty());
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
}
