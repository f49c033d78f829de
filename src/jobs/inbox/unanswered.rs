//! The commands that were handed on, by whichever reader of the folder: each counts once.
//!
//! In: the file of a command that a reader is about to hand on, and what became of it with its answer. Out:
//! whether no reader has handed it on before; how many are without an answer. A file is kept open until it
//! is gone from the folder, so that no other file gets its number.

use cell_edge::mailbox::FileNumber;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// See the module. `L` keeps a file open.
#[derive(Debug)]
pub struct Unanswered<L>(Arc<Mutex<BTreeMap<FileNumber, HandedOn<L>>>>);

/// A command that was handed on.
#[derive(Debug)]
pub struct HandedOn<L> {
    /// Who gave it.
    pub sender: String,
    /// It only stops.
    pub stops: bool,
    /// Keeps its file open.
    pub lock: L,
    /// Its answer was tried, and its file could not be removed.
    pub stays: bool,
}

impl<L> Clone for Unanswered<L> {
    fn clone(&self) -> Unanswered<L> {
        Unanswered(self.0.clone())
    }
}

impl<L> Default for Unanswered<L> {
    fn default() -> Unanswered<L> {
        Unanswered(Arc::default())
    }
}

impl<L> Unanswered<L> {
    fn files(&self) -> MutexGuard<'_, BTreeMap<FileNumber, HandedOn<L>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes a command; false if it is noted already.
    pub fn note(&self, number: FileNumber, file: HandedOn<L>) -> bool {
        let mut files = self.files();
        let is_new = !files.contains_key(&number);
        files.entry(number).or_insert(file);
        is_new
    }

    /// Its file is gone.
    pub fn forget(&self, number: FileNumber) {
        // Closed when the others may go on: with its last handle the system frees the file's place.
        let gone = self.files().remove(&number);
        drop(gone);
    }

    /// It has its answer, and its file cannot be removed: it takes no place from others and never counts
    /// again.
    pub fn keep(&self, number: FileNumber) {
        if let Some(file) = self.files().get_mut(&number) {
            file.stays = true;
        }
    }

    /// Forgets those that were kept and are gone by now.
    pub fn forget_gone(&self, lies_there: impl Fn(&L) -> bool) {
        let mut files = self.files();
        let is_gone = |file: &HandedOn<L>| file.stays && !lies_there(&file.lock);
        let numbers: Vec<FileNumber> =
            files.iter().filter(|(_, file)| is_gone(file)).map(|(number, _)| *number).collect();
        let gone: Vec<_> = numbers.iter().filter_map(|number| files.remove(number)).collect();
        drop(files);
        drop(gone);
    }

    /// The numbers of all that lie in the folder.
    pub fn numbers(&self) -> BTreeSet<FileNumber> {
        self.files().keys().copied().collect()
    }

    /// How many orders wait for an answer; stops are not counted.
    pub fn count(&self) -> usize {
        self.files().values().filter(|file| file.waits()).count()
    }

    /// The same, by sender.
    pub fn of_senders(&self) -> HashMap<String, usize> {
        let mut counts = HashMap::new();
        for file in self.files().values().filter(|file| file.waits()) {
            *counts.entry(file.sender.clone()).or_default() += 1;
        }
        counts
    }
}

impl<L> HandedOn<L> {
    fn waits(&self) -> bool {
        !self.stops && !self.stays
    }
}
