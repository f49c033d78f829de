//! A folder of commands without files: what the system would do with each call.
//!
//! In: commands that clients leave, and what becomes of the folder (gone, unreadable). Out: the calls by
//! which the daemon's own intake reads it ([`Folder`]).

use crate::jobs::command::STOP_MARK;
use crate::jobs::inbox::Folder;
use cell_edge::files::FileError;
use cell_edge::mailbox::{FileNumber, Letter};
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// What has become of the folder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fate {
    /// It is there.
    #[default]
    Sound,
    /// Its name leads nowhere, or to another folder.
    Gone,
    /// It can be listed, and no file in it can be opened: no handles are left, say.
    Unreadable,
}

/// A file in it.
#[derive(Debug)]
struct Left {
    number: FileNumber,
    text: String,
    /// The sender waits.
    held: Arc<AtomicBool>,
    /// The daemon has it.
    claimed: Cell<bool>,
}

/// The folder. See the module.
#[derive(Debug)]
pub struct Files {
    path: PathBuf,
    fate: Cell<Fate>,
    files: RefCell<BTreeMap<String, Left>>,
    /// How many were left so far, and the names of the newest that the kernel reports.
    count: Cell<u64>,
    arrived: RefCell<Vec<String>>,
}

impl Default for Files {
    fn default() -> Files {
        Files {
            path: PathBuf::from("commands"),
            fate: Cell::default(),
            files: RefCell::default(),
            count: Cell::default(),
            arrived: RefCell::default(),
        }
    }
}

impl Files {
    /// From now on this is what has become of it.
    pub fn set_fate(&self, fate: Fate) {
        self.fate.set(fate);
    }

    /// What has become of it.
    pub fn fate(&self) -> Fate {
        self.fate.get()
    }

    /// Leaves a file; false if there is no folder to leave it in.
    pub fn leave(&self, name: String, text: String, held: Arc<AtomicBool>) -> bool {
        if self.fate.get() == Fate::Gone {
            return false;
        }
        let number = self.count.get();
        self.count.set(number + 1);
        // The kernel's queue may overflow: of every three reports the last is lost.
        if number % 3 != 2 {
            self.arrived.borrow_mut().push(name.clone());
        }
        self.files.borrow_mut().insert(name, Left { number, text, held, claimed: Cell::new(false) }).is_none()
    }

    /// The names that the kernel has reported since the last call.
    pub fn arrived(&self) -> Vec<String> {
        self.arrived.take()
    }

    /// The sender takes a file back; false if the daemon has it, or it is not there.
    pub fn take_back(&self, name: &str) -> bool {
        let mut files = self.files.borrow_mut();
        let waits = files.get(name).is_some_and(|left| !left.claimed.get());
        waits && files.remove(name).is_some()
    }

    /// An order lies there that is taken once it can be read.
    pub fn has_orders_to_read(&self) -> bool {
        self.files.borrow().iter().any(|(name, left)| !name.contains(STOP_MARK) && !left.claimed.get())
    }

    fn error(&self, action: &'static str, name: &str, kind: ErrorKind) -> FileError {
        FileError::Io { action, path: self.path.join(name), source: Error::from(kind) }
    }
}

impl Folder for Files {
    type Lock = Arc<AtomicBool>;

    fn path(&self) -> &Path {
        &self.path
    }

    fn is_in_place(&self) -> bool {
        self.fate.get() != Fate::Gone
    }

    fn names(&self, suffix: &str) -> Result<Vec<(String, FileNumber)>, FileError> {
        let files = self.files.borrow();
        let of_kind = files.iter().filter(|(name, _)| name.ends_with(suffix));
        Ok(of_kind.map(|(name, left)| (name.clone(), left.number)).collect())
    }

    fn read(&self, name: &str, _max_bytes: u64) -> Result<Letter<Arc<AtomicBool>>, FileError> {
        if self.fate.get() == Fate::Unreadable {
            return Err(self.error("open", name, ErrorKind::PermissionDenied));
        }
        let files = self.files.borrow();
        let left = files.get(name).ok_or_else(|| self.error("open", name, ErrorKind::NotFound))?;
        Ok(Letter { number: left.number, text: left.text.clone(), uid: 1000, lock: left.held.clone() })
    }

    fn claim(&self, lock: &Arc<AtomicBool>) -> Result<bool, FileError> {
        let files = self.files.borrow();
        let left = files.values().find(|left| Arc::ptr_eq(&left.held, lock));
        left.inspect(|left| left.claimed.set(true));
        Ok(left.is_some())
    }

    fn remove(&self, name: &str) -> Result<bool, FileError> {
        Ok(self.files.borrow_mut().remove(name).is_some())
    }

    fn lies_there(&self, lock: &Arc<AtomicBool>) -> bool {
        self.files.borrow().values().any(|left| Arc::ptr_eq(&left.held, lock))
    }
}
