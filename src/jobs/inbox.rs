//! The folder of commands, as the daemon reads it.
//!
//! In: a folder, through the calls of [`Folder`] alone, so that the closed loop has one without files. Out:
//! commands, each once, stops before everything else; files that are no commands, with their answers; why
//! the folder cannot be read. Listing the folder may wait for its senders, who take the same lock of the
//! system; so stops are also read by the names that the kernel reports, on a thread of their own
//! ([`ReportedStops`]).

use crate::jobs::command::{Command, Envelope, MAX_BYTES, STOP_MARK, SUFFIX, sender_of};
use cell_edge::files::{FileError, create_folder, write_answer};
use cell_edge::mailbox::{Arrivals, FileNumber, Letter, Mailbox, SenderLock};
use cell_machine::intake::Unreachable;
use cell_machine::orders::Reply;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// New files read per look, to find stops without the mark in their names.
const LOOKED_INTO_AT_ONCE: usize = 32;

/// Commands other than stops that are taken at a time.
const TAKEN_AT_ONCE: usize = 32;

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

    /// The names that end in `suffix`, in order, each with its file's number.
    ///
    /// # Errors
    /// The folder cannot be listed.
    fn names(&self, suffix: &str) -> Result<Vec<(String, FileNumber)>, FileError>;

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

    /// The file of this lock is still in the folder.
    fn lies_there(&self, lock: &Self::Lock) -> bool;
}

impl Folder for Mailbox {
    type Lock = SenderLock;

    fn path(&self) -> &Path {
        Mailbox::path(self)
    }

    fn is_in_place(&self) -> bool {
        Mailbox::is_in_place(self)
    }

    fn names(&self, suffix: &str) -> Result<Vec<(String, FileNumber)>, FileError> {
        Mailbox::names(self, suffix)
    }

    fn read(&self, name: &str, max_bytes: u64) -> Result<Letter, FileError> {
        Mailbox::read(self, name, max_bytes)
    }

    fn claim(&self, name: &str) -> Result<bool, FileError> {
        Mailbox::claim(self, name)
    }

    fn lies_there(&self, lock: &SenderLock) -> bool {
        lock.lies_there()
    }
}

/// A command that the daemon took, to be answered.
#[derive(Clone, Debug)]
pub struct Taken<L = SenderLock> {
    /// What is requested.
    pub command: Command,
    /// Who gave it: the system's number of the owner of its file.
    pub uid: u32,
    /// When it was given, s since the machine started, as its sender says.
    pub boot_s: f64,
    /// Which file it was.
    number: FileNumber,
    /// Of a stop; dropped before the lock, as long as which nothing else has the file's number.
    handed_on: Option<Arc<HandedOn>>,
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
        // Its sender may have left another one under the same name.
        let same = || std::fs::symlink_metadata(&self.path).is_ok_and(|now| now.ino() == self.number);
        if self.command.only_stops() && same() {
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

/// The files of stops that were handed on and are not answered yet, by whichever reader: each counts once.
#[derive(Clone, Debug, Default)]
struct Unanswered(Arc<Mutex<BTreeSet<FileNumber>>>);

impl Unanswered {
    fn numbers(&self) -> MutexGuard<'_, BTreeSet<FileNumber>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes a stop until the result is dropped; `None` if it is noted already.
    fn note(&self, number: FileNumber) -> Option<Arc<HandedOn>> {
        self.numbers().insert(number).then(|| Arc::new(HandedOn { number, among: self.clone() }))
    }
}

/// A stop that was handed on, until it is answered.
#[derive(Debug)]
struct HandedOn {
    number: FileNumber,
    among: Unanswered,
}

impl Drop for HandedOn {
    fn drop(&mut self) {
        self.among.numbers().remove(&self.number);
    }
}

/// The daemon's end.
#[derive(Debug)]
pub struct Inbox<F = Mailbox> {
    folder: F,
    daemon: String,
    /// By name and number: a sender may use a name again.
    known: BTreeMap<(String, FileNumber), Known>,
    unanswered: Unanswered,
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
        for (name, _) in mailbox.names("")? {
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
        let inbox = Inbox { unanswered: self.unanswered.clone(), ..Inbox::of(folder, self.daemon.clone()) };
        Ok(ReportedStops { inbox, arrivals, names: VecDeque::new() })
    }
}

/// The stops whose files the kernel reports as they come.
#[derive(Debug)]
pub struct ReportedStops {
    /// The reader of the folder.
    pub inbox: Inbox,
    arrivals: Arrivals,
    /// Reported, and not looked into yet.
    names: VecDeque<String>,
}

impl ReportedStops {
    /// Those since the last call that nobody has handed on; of many the rest comes with the next calls.
    pub fn take(&mut self) -> Vec<Taken> {
        self.names.extend(self.arrivals.names(SUFFIX).into_iter().filter(|name| name.contains(STOP_MARK)));
        let count = self.names.len().min(LOOKED_INTO_AT_ONCE);
        let names: Vec<String> = self.names.drain(..count).collect();
        self.inbox.take_reported_stops(&names)
    }
}

impl<F: Folder> Inbox<F> {
    /// Reads this folder for the daemon called `daemon`.
    pub fn of(folder: F, daemon: impl Into<String>) -> Inbox<F> {
        Inbox { folder, daemon: daemon.into(), known: BTreeMap::new(), unanswered: Unanswered::default() }
    }

    /// The folder.
    pub fn folder(&self) -> &F {
        &self.folder
    }

    /// Takes the stops among newly reported files. Only names with the mark of a stop are opened: to open a
    /// file that is gone again waits for the folder's lock.
    pub fn take_reported_stops(&self, names: &[String]) -> Vec<Taken<F::Lock>> {
        let marked = names.iter().filter(|name| name.contains(STOP_MARK));
        let read = marked.filter_map(|name| self.read(name).ok()?.ok());
        read.filter(|taken| taken.command.only_stops()).filter_map(|stop| self.first(stop)).collect()
    }

    /// A stop that neither reader has handed on.
    fn first(&self, mut stop: Taken<F::Lock>) -> Option<Taken<F::Lock>> {
        stop.handed_on = Some(self.unanswered.note(stop.number)?);
        // One that was answered since it was read is gone from the folder.
        self.folder.lies_there(&stop.lock).then_some(stop)
    }

    /// Takes every stop, and up to `room` other commands, in turn by sender and by time within a sender: a
    /// script with a thousand commands delays only its own. With stops come no others: those may wait for
    /// the folder's lock, and what was given before a stop does not count after it. Whatever happens to one
    /// file, what was taken besides is returned.
    pub fn take(&mut self, room: usize) -> Mail<F::Lock> {
        self.take_while(room, || true)
    }

    /// Like [`Inbox::take`], but after the first takes no further order once `in_time` is false.
    pub fn take_while(&mut self, room: usize, in_time: impl Fn() -> bool) -> Mail<F::Lock> {
        let mut mail = Mail::default();
        let folder = || self.folder.path().display().to_string();
        if !self.folder.is_in_place() {
            mail.fault = Some(Unreachable::FolderGone(folder()));
            return mail;
        }
        let files = match self.folder.names(SUFFIX) {
            Ok(files) => files,
            Err(error) => {
                mail.fault = Some(Unreachable::Unreadable(folder(), error.reason()));
                return mail;
            }
        };
        self.known.retain(|file, _| files.binary_search(file).is_ok());
        if self.take_stops(&files, &mut mail) {
            return mail;
        }
        let waiting = files.iter().filter(|file| self.known.get(*file) == Some(&Known::Waits));
        let turns = in_turn(waiting).into_iter().take(room.min(TAKEN_AT_ONCE));
        for (count, (name, _)) in turns.enumerate() {
            if count > 0 && !in_time() {
                break;
            }
            self.take_one(name, &mut mail);
        }
        mail
    }

    /// Looks into new files and takes the stops among them that were not reported; true if there are any,
    /// reported or not.
    fn take_stops(&mut self, files: &[(String, FileNumber)], mail: &mut Mail<F::Lock>) -> bool {
        let new = files.iter().filter(|file| !self.known.contains_key(*file));
        let (stops, others): (Vec<_>, Vec<_>) = new.partition(|(name, _)| name.contains(STOP_MARK));
        let others = in_turn(others.into_iter());
        let mut found = false;
        for file in stops.into_iter().chain(others).take(LOOKED_INTO_AT_ONCE) {
            match self.read(&file.0) {
                Ok(Ok(taken)) if taken.command.only_stops() => {
                    found = true;
                    self.known.insert((file.0.clone(), taken.number), Known::Obeyed);
                    mail.taken.extend(self.first(taken));
                }
                Ok(_) => _ = self.known.insert(file.clone(), Known::Waits),
                Err(fault) => mail.fault = fault.or(mail.fault.take()),
            }
        }
        found
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
                let Letter { number, uid, lock, .. } = letter;
                Ok(Ok(Taken { command, uid, boot_s, number, handed_on: None, lock, path }))
            }
        }
    }

    fn unreadable(&self, error: &FileError) -> Unreachable {
        Unreachable::Unreadable(self.folder.path().display().to_string(), error.reason())
    }
}

/// The first of each sender's files, then the second of each, and so on; `files` are in order.
fn in_turn<'a>(files: impl Iterator<Item = &'a (String, FileNumber)>) -> Vec<&'a (String, FileNumber)> {
    let mut before: HashMap<&str, usize> = HashMap::new();
    let mut turns: Vec<(usize, &(String, FileNumber))> = files
        .map(|file| {
            let turn = before.entry(sender_of(&file.0)).or_default();
            *turn += 1;
            (*turn, file)
        })
        .collect();
    // Stable: within a turn they stay in order.
    turns.sort_by_key(|(turn, _)| *turn);
    turns.into_iter().map(|(_, file)| file).collect()
}

/// An answer may be a secret (`celld open`): it is for the user who gave the command, and another user than
/// the daemon's reads it by the group that both are in.
fn answer(command: &Path, requested_by: u32, reply: &Reply) -> Result<(), FileError> {
    let text = serde_json::to_string(reply).expect("replies have string keys only");
    let own = requested_by == rustix::process::geteuid().as_raw();
    write_answer(&command.with_extension("reply"), text.as_bytes(), !own)
}

#[cfg(test)]
mod tests;
