//! The commands that the readers of the folder have handed on. Each counts once.
//!
//! In: the file of a command that a reader is about to hand on; whether the file was removed with the
//! answer. Out: whether another reader has handed it on before; how many commands wait for an answer. A file
//! is kept open until it is removed, so that no other file gets its number.

use cell_edge::mailbox::FileNumber;
use std::collections::btree_map::Entry;
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
    /// It was answered, but its file could not be removed.
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
        match self.files().entry(number) {
            Entry::Occupied(_) => false,
            Entry::Vacant(place) => {
                place.insert(file);
                true
            }
        }
    }

    /// Its file was removed.
    pub fn forget(&self, number: FileNumber) {
        // Dropped outside the lock: closing the last handle of a removed file may wait for the disk.
        let gone = self.files().remove(&number);
        drop(gone);
    }

    /// Its file could not be removed with its answer. It no longer counts as waiting, and is never handed on
    /// again.
    pub fn keep(&self, number: FileNumber) {
        if let Some(file) = self.files().get_mut(&number) {
            file.stays = true;
        }
    }

    /// Forgets the kept files that were removed since.
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
