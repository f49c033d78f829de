//! The folder of commands, as the daemon reads it.
//!
//! In: a folder, through the calls of [`Folder`] alone, so that the closed loop has one without files. Out:
//! commands, each once, stops before everything else; files that are no commands, with their answers; why
//! the folder cannot be read. To list the folder or remove a file takes the kernel's lock of the folder,
//! which senders also take. So two other threads read the files that the kernel reports (`jobs::reported`),
//! and a file is removed when it is answered.

mod unanswered;
mod unreported;

pub use unreported::Unreported;

use crate::jobs::command::{Command, Envelope, MAX_BYTES, STOP_MARK, SUFFIX, sender_of};
use crate::jobs::inbox::unanswered::{HandedOn, Unanswered};
use cell_edge::files::{FileError, create_folder, write_answer};
use cell_edge::mailbox::{FileNumber, Letter, Mailbox, SenderLock};
use cell_machine::intake::Unreachable;
use cell_machine::orders::Reply;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// New files read per look, to find stops without the mark in their names.
const LOOKED_INTO_AT_ONCE: usize = 32;

/// Commands other than stops that are taken at a time.
const TAKEN_AT_ONCE: usize = 32;

/// Looks of the listing after which a command counts as not reported: 0.2 s.
const REPORTED_WITHIN_LOOKS: u64 = 40;

/// Most commands, other than stops, that wait for an answer; later ones stay in the folder. Each holds a
/// file handle.
pub const UNANSWERED_MAX: usize = 256;

/// The same for one sender, so that a script does not take the places of all others while answers are slow.
const UNANSWERED_OF_A_SENDER: usize = 16;

/// The answer to a command that was left for an earlier daemon.
pub const FOR_ANOTHER: &str = "this command was meant for a daemon that has ended";

const NO_COMMAND: &str = "this file is not a command of this version of celld";

/// The calls by which commands are read.
pub trait Folder {
    /// Held while the sender of a command waits.
    type Lock: Clone;

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

    /// Takes the file of this lock, so that its sender can no longer take it back. False if the sender
    /// already has.
    ///
    /// # Errors
    /// The system refuses.
    fn claim(&self, lock: &Self::Lock) -> Result<bool, FileError>;

    /// Removes a file that is no command; false if it is not there any more.
    ///
    /// # Errors
    /// The system refuses.
    fn remove(&self, name: &str) -> Result<bool, FileError>;

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

    fn claim(&self, lock: &SenderLock) -> Result<bool, FileError> {
        lock.claim().map_err(|source| FileError::Io {
            action: "lock a file in",
            path: self.path().into(),
            source,
        })
    }

    fn remove(&self, name: &str) -> Result<bool, FileError> {
        Mailbox::remove(self, name)
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
    number: FileNumber,
    /// The file, open; its sender holds a lock on it while it waits for the answer.
    pub lock: L,
    /// Where it lies.
    pub path: PathBuf,
    unanswered: Unanswered<L>,
}

impl<L> Taken<L> {
    /// To be called after the attempt to answer. `lies_there`: the file could not be removed.
    pub fn settle(&self, lies_there: bool) {
        match lies_there {
            true => self.unanswered.keep(self.number),
            false => self.unanswered.forget(self.number),
        }
    }
}

impl Taken {
    /// Removes the file, and leaves the answer.
    ///
    /// # Errors
    /// The file cannot be removed, or the answer cannot be written.
    pub fn answer(&self, reply: &Reply) -> Result<(), FileError> {
        // Its sender may have left another one under the same name.
        let same = std::fs::symlink_metadata(&self.path).is_ok_and(|now| now.ino() == self.number);
        let removed = if same { std::fs::remove_file(&self.path) } else { Ok(()) };
        let lies_there = self.lock.lies_there();
        let answered = answer(&self.path, self.uid, reply);
        self.settle(lies_there);
        removed.map_err(|source| FileError::Io { action: "remove", path: self.path.clone(), source })?;
        answered
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

/// The daemon's end.
#[derive(Debug)]
pub struct Inbox<F: Folder = Mailbox> {
    folder: F,
    daemon: String,
    /// Files that were read, with the look in which they were read last. By name and number: a sender may
    /// use a name again.
    seen: BTreeMap<(String, FileNumber), u64>,
    looks: u64,
    /// Set if other threads read the reported files. Orders that were not reported are passed to them here.
    others: Option<Unreported>,
    unanswered: Unanswered<F::Lock>,
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
                mailbox.remove(&name)?;
            }
        }
        Ok(Inbox::of(mailbox, daemon))
    }

    /// Another reader of the same folder. Each command is handed on by one of them only.
    ///
    /// # Errors
    /// The folder cannot be opened.
    pub fn second_reader(&self) -> Result<Inbox, FileError> {
        let folder = Mailbox::open(self.folder.path())?;
        Ok(Inbox { unanswered: self.unanswered.clone(), ..Inbox::of(folder, self.daemon.clone()) })
    }
}

impl<F: Folder> Inbox<F> {
    /// Reads this folder for the daemon called `daemon`.
    pub fn of(folder: F, daemon: impl Into<String>) -> Inbox<F> {
        Inbox {
            folder,
            daemon: daemon.into(),
            seen: BTreeMap::new(),
            looks: 0,
            others: None,
            unanswered: Unanswered::default(),
        }
    }

    /// From now on another reader takes all orders except stops. This one passes it the names of those that
    /// were not reported.
    pub fn leave_to(&mut self, others: Unreported) {
        self.others = Some(others);
    }

    /// The folder.
    pub fn folder(&self) -> &F {
        &self.folder
    }

    /// Orders that wait for an answer, of all readers of this folder; without stops.
    pub fn unanswered(&self) -> usize {
        self.unanswered.count()
    }

    /// Takes the stops among these files and removes the names from `waiting`. Other files are left to
    /// [`Inbox::take`].
    pub fn take_reported_stops(&self, waiting: &mut BTreeSet<String>) -> Vec<Taken<F::Lock>> {
        let names: Vec<String> = waiting.iter().take(LOOKED_INTO_AT_ONCE).cloned().collect();
        names.iter().for_each(|name| _ = waiting.remove(name));
        let read = names.iter().filter_map(|name| self.read(name).ok()?.ok());
        read.filter(|read| read.command.only_stops()).filter_map(|stop| self.first(stop).ok()?).collect()
    }

    /// Like [`Inbox::take_while`], but only for these files; the names that were read are removed from
    /// `waiting`. Files that are no command or cannot be read are left to [`Inbox::take`].
    pub fn take_reported(
        &self,
        waiting: &mut BTreeSet<String>,
        room: usize,
        in_time: impl Fn() -> bool,
    ) -> Vec<Taken<F::Lock>> {
        // If the folder was moved, its clients would not see the answers.
        if room == 0 || waiting.is_empty() || !self.folder.is_in_place() {
            return Vec::new();
        }
        let turns: Vec<String> = self.turns(waiting.iter(), String::as_str, room).cloned().collect();
        let mut taken = Vec::new();
        for (count, name) in turns.into_iter().enumerate() {
            if count > 0 && !in_time() {
                break;
            }
            let read = self.read(&name).ok().and_then(Result::ok);
            taken.extend(read.and_then(|read| self.first(read).ok().flatten()));
            waiting.remove(&name);
        }
        taken
    }

    /// A command that no reader has handed on, and that its sender has not taken back.
    fn first(&self, taken: Taken<F::Lock>) -> Result<Option<Taken<F::Lock>>, FileError> {
        let stops = taken.command.only_stops();
        match self.folder.claim(&taken.lock) {
            // A stop counts whatever becomes of the lock.
            _ if stops => {}
            Ok(true) => {}
            Ok(false) => return Ok(None),
            Err(error) => return Err(error),
        }
        let sender = taken.path.file_name().and_then(|name| name.to_str()).map_or("", sender_of).to_string();
        let file = HandedOn { sender, stops, lock: taken.lock.clone(), stays: false };
        if !self.unanswered.note(taken.number, file) {
            return Ok(None);
        }
        if !self.folder.lies_there(&taken.lock) {
            // After it was read here, another reader handed it on and it was answered.
            self.unanswered.forget(taken.number);
            return Ok(None);
        }
        Ok(Some(taken))
    }

    /// Takes every stop, and up to `room` other commands, in turn by sender and by time within a sender: a
    /// script with a thousand commands delays only its own. With stops come no others: what was given before
    /// a stop does not count after it. Whatever happens to one file, what was taken besides is returned.
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
        self.looks += 1;
        self.unanswered.forget_gone(|lock| self.folder.lies_there(lock));
        self.seen.retain(|file, _| files.binary_search(file).is_ok());
        if self.take_stops(&files, &mut mail) {
            return mail;
        }
        let handed_on = self.unanswered.numbers();
        let waiting: Vec<_> = files.iter().filter(|file| !handed_on.contains(&file.1)).collect();
        // If a waiting file cannot be read, orders do not reach the cell. So one is tried in each look.
        let first = waiting.iter().find(|file| self.seen.contains_key(**file));
        if let Some(Err(fault)) = first.map(|file| self.read(&file.0)) {
            mail.fault = fault.or(mail.fault.take());
        }
        for (count, file) in self.due(&waiting, room).into_iter().enumerate() {
            if count > 0 && !in_time() {
                break;
            }
            self.take_one(&file.0, &mut mail);
            self.seen.insert(file, self.looks);
        }
        mail
    }

    /// The files that this reader takes or passes on now.
    fn due(&self, waiting: &[&(String, FileNumber)], room: usize) -> Vec<(String, FileNumber)> {
        let after = if self.others.is_some() { REPORTED_WITHIN_LOOKS } else { 0 };
        let is_due = |file: &&(String, FileNumber)| {
            self.seen.get(*file).is_some_and(|look| look + after <= self.looks)
        };
        let waiting = waiting.iter().copied().filter(is_due);
        // The other reader counts the room for the files that it gets.
        let room = if self.others.is_some() { TAKEN_AT_ONCE } else { room };
        self.turns(waiting, |file| &file.0, room).cloned().collect()
    }

    /// The files whose turn it is, without those of senders that have too many orders without an answer.
    fn turns<'a, T: 'a>(
        &self,
        waiting: impl Iterator<Item = &'a T>,
        name: impl Fn(&'a T) -> &'a str,
        room: usize,
    ) -> impl Iterator<Item = &'a T> {
        let unanswered = self.unanswered.of_senders();
        let may = move |(turn, sender): (usize, &str)| {
            turn + unanswered.get(sender).unwrap_or(&0) <= UNANSWERED_OF_A_SENDER
        };
        let turns = in_turn(waiting.map(|file| (sender_of(name(file)), file)));
        let allowed = turns.into_iter().filter(move |(turn, sender, _)| may((*turn, sender)));
        allowed.map(|(_, _, file)| file).take(room.min(TAKEN_AT_ONCE))
    }

    /// Looks into new files and takes the stops among them that were not reported; true if there are any,
    /// reported or not.
    fn take_stops(&mut self, files: &[(String, FileNumber)], mail: &mut Mail<F::Lock>) -> bool {
        let new = files.iter().filter(|file| !self.seen.contains_key(*file));
        let (stops, others): (Vec<_>, Vec<_>) = new.partition(|(name, _)| name.contains(STOP_MARK));
        let others = in_turn(others.into_iter().map(|file| (sender_of(&file.0), file)));
        let others = others.into_iter().map(|(_, _, file)| file);
        let (mut found, marked) = (false, stops.len());
        for (count, file) in stops.into_iter().chain(others).take(LOOKED_INTO_AT_ONCE).enumerate() {
            if found && count >= marked {
                // Opening other files may wait, and the stop must not.
                break;
            }
            match self.read(&file.0) {
                Ok(Ok(taken)) if taken.command.only_stops() => {
                    found = true;
                    self.seen.insert((file.0.clone(), taken.number), self.looks);
                    mail.taken.extend(self.first(taken).ok().flatten());
                }
                Ok(_) => _ = self.seen.insert(file.clone(), self.looks),
                Err(fault) => mail.fault = fault.or(mail.fault.take()),
            }
        }
        found
    }

    /// Takes a command or passes it to the other reader. Removes a file that is no command.
    fn take_one(&self, name: &str, mail: &mut Mail<F::Lock>) {
        match (self.read(name), &self.others) {
            (Ok(Ok(taken)), Some(others)) if !taken.command.only_stops() => others.leave(name.to_string()),
            (Ok(Ok(taken)), _) => match self.first(taken) {
                Ok(first) => mail.taken.extend(first),
                Err(error) => mail.fault = Some(self.unreadable(&error)),
            },
            (Ok(Err(refused)), _) => match self.folder.remove(name) {
                Ok(true) => mail.refused.push(refused),
                // Its sender has taken it back.
                Ok(false) => {}
                Err(error) => mail.fault = Some(self.unreadable(&error)),
            },
            (Err(fault), _) => mail.fault = fault.or(mail.fault.take()),
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
                let unanswered = self.unanswered.clone();
                Ok(Ok(Taken { command, uid, boot_s, number, lock, path, unanswered }))
            }
        }
    }

    fn unreadable(&self, error: &FileError) -> Unreachable {
        Unreachable::Unreadable(self.folder.path().display().to_string(), error.reason())
    }
}

/// The first of each sender's files, then the second of each, and so on, each with its turn from 1; `files`
/// are in order.
fn in_turn<'a, T>(files: impl Iterator<Item = (&'a str, &'a T)>) -> Vec<(usize, &'a str, &'a T)> {
    let mut before: HashMap<&str, usize> = HashMap::new();
    let mut turns: Vec<(usize, &str, &T)> = files
        .map(|(sender, file)| {
            let turn = before.entry(sender).or_default();
            *turn += 1;
            (*turn, sender, file)
        })
        .collect();
    // Stable: within a turn they stay in order.
    turns.sort_by_key(|(turn, _, _)| *turn);
    turns
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
