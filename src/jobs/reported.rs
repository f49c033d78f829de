//! The readers of command files that the kernel reports: one of stops, one of all other commands.
//!
//! In: names that inotify reports, and those that only the listing found. Out: commands. Reading a file that
//! exists does not take the folder's lock. Only a file that its sender has just taken back makes a reader
//! wait.

use crate::jobs::command::{STOP_MARK, SUFFIX};
use crate::jobs::inbox::{Inbox, Taken, Unreported};
use cell_edge::files::FileError;
use cell_edge::mailbox::Arrivals;
use std::collections::BTreeSet;

/// Most reported names that wait for their turn. The listing finds the others.
const WAITING_MAX: usize = 4096;

/// Which files a reader takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Those that are marked as stops in their names.
    Stops,
    /// All others.
    Others,
}

impl Kind {
    /// A file of this name is of this kind.
    pub fn has(self, name: &str) -> bool {
        name.contains(STOP_MARK) == (self == Kind::Stops)
    }
}

/// A reader. See the module.
#[derive(Debug)]
pub struct Reported {
    inbox: Inbox,
    arrivals: Arrivals,
    kind: Kind,
    /// Not looked into yet.
    waiting: BTreeSet<String>,
    unreported: Unreported,
}

impl Reported {
    /// Creates the reader of stops and the reader of other commands for the folder of `inbox`. `inbox` still
    /// lists the folder, and passes orders that were not reported to the second reader.
    ///
    /// # Errors
    /// The folder cannot be opened or watched.
    pub fn both(inbox: &mut Inbox) -> Result<[Reported; 2], FileError> {
        let unreported = Unreported::default();
        let reader = |kind| {
            let inbox = inbox.second_reader()?;
            let (arrivals, unreported) = (inbox.folder().arrivals()?, unreported.clone());
            Ok::<Reported, FileError>(Reported {
                inbox,
                arrivals,
                kind,
                waiting: BTreeSet::new(),
                unreported,
            })
        };
        let both = [reader(Kind::Stops)?, reader(Kind::Others)?];
        inbox.leave_to(unreported);
        Ok(both)
    }

    /// The reader of the folder.
    pub fn inbox(&self) -> &Inbox {
        &self.inbox
    }

    /// Which files it takes.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Like [`Inbox::take_while`], but only for these files.
    pub fn take_while(&mut self, room: usize, in_time: impl Fn() -> bool) -> Vec<Taken> {
        let reported = self.arrivals.names(SUFFIX).into_iter().filter(|name| self.kind.has(name));
        let left = WAITING_MAX.saturating_sub(self.waiting.len());
        self.waiting.extend(reported.take(left));
        match self.kind {
            Kind::Stops => self.inbox.take_reported_stops(&mut self.waiting),
            Kind::Others => {
                self.waiting.extend(self.unreported.take());
                self.inbox.take_reported(&mut self.waiting, room, in_time)
            }
        }
    }
}
