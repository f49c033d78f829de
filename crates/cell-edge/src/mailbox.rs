//! A folder in which other processes leave small files for this one.
//!
//! In: a folder, held open from the start. Out: the names in it, a file with its text, its owner and the
//! sender's lock, whether the folder is still the one under its name. A sender holds an exclusive lock on
//! its file until it has its answer; the kernel frees the lock with the process, however that ends, so the
//! receiver sees whether a client still waits. Nothing here waits for a disk: a file is for the process that
//! runs now and not for the one after a power cut, so none is synced. Listing needs no new handle, but takes
//! the lock of the folder that every sender takes too; [`Arrivals`] name new files without it.

use crate::files::{FileError, Unfit, draft, share_with_group};
use crate::reserve;
use rustix::fs::inotify::{self, CreateFlags, WatchFlags};
use rustix::fs::{AtFlags, CWD, Mode, OFlags, RawDir, RenameFlags, SeekFrom};
use rustix::io::Errno;
use std::ffi::OsStr;
use std::fs::{File, TryLockError};
use std::io::{self, Read};
use std::mem::MaybeUninit;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The sender's lock on a file that was received.
#[derive(Clone, Debug)]
pub struct SenderLock(Arc<File>);

impl SenderLock {
    /// The sender still holds its lock.
    pub fn is_held(&self) -> bool {
        match self.0.try_lock_shared() {
            Err(TryLockError::WouldBlock) => true,
            Err(TryLockError::Error(_)) => false,
            Ok(()) => {
                // It is not ours to keep.
                let _ = self.0.unlock();
                false
            }
        }
    }

    /// The file is still in its folder.
    pub fn lies_there(&self) -> bool {
        self.0.metadata().is_ok_and(|metadata| metadata.nlink() > 0)
    }
}

/// The system's number of a file (inode). As long as the file is open it has no other one.
pub type FileNumber = u64;

/// A file that was left.
#[derive(Debug)]
pub struct Letter<L = SenderLock> {
    /// Which file it is.
    pub number: FileNumber,
    /// Its text.
    pub text: String,
    /// The system's number of its owner.
    pub uid: u32,
    /// The sender's lock, if the sender took one.
    pub lock: L,
}

/// The receiver's end of the folder.
#[derive(Debug)]
pub struct Mailbox {
    path: PathBuf,
    folder: File,
}

impl Mailbox {
    /// Opens the folder, which must be there.
    ///
    /// # Errors
    /// The system refuses to open it.
    pub fn open(path: &Path) -> Result<Mailbox, FileError> {
        let folder = File::open(path).map_err(|e| FileError::io("open", path, e))?;
        Ok(Mailbox { path: path.to_owned(), folder })
    }

    /// The folder's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// True while the folder's name leads to the folder that was opened.
    pub fn is_in_place(&self) -> bool {
        let same = |now: std::fs::Metadata, opened: std::fs::Metadata| {
            (now.dev(), now.ino()) == (opened.dev(), opened.ino()) && opened.nlink() > 0
        };
        match (self.path.metadata(), self.folder.metadata()) {
            (Ok(now), Ok(opened)) => same(now, opened),
            _ => false,
        }
    }

    /// The names that end in `suffix` and are not hidden, in order, each with its file's number.
    ///
    /// # Errors
    /// The folder cannot be listed.
    pub fn names(&self, suffix: &str) -> Result<Vec<(String, FileNumber)>, FileError> {
        let fail = |e: Errno| FileError::io("list", &self.path, e.into());
        rustix::fs::seek(&self.folder, SeekFrom::Start(0)).map_err(fail)?;
        let mut buffer = [MaybeUninit::uninit(); 32 * 1024];
        let mut entries = RawDir::new(&self.folder, &mut buffer);
        let mut names = Vec::new();
        while let Some(entry) = entries.next() {
            let entry = entry.map_err(fail)?;
            // A name that is no text is none that a sender of ours gives.
            let Ok(name) = entry.file_name().to_str() else { continue };
            if is_left(name, suffix) {
                names.push((name.to_owned(), entry.ino()));
            }
        }
        names.sort_unstable();
        Ok(names)
    }

    /// The file of this name, if it is a plain file of at most `max_bytes`; links are not followed.
    ///
    /// # Errors
    /// It is no such file, or the system refuses ([`FileError::is_absent`]: its sender has taken it back).
    pub fn read(&self, name: &str, max_bytes: u64) -> Result<Letter, FileError> {
        let path = self.path.join(name);
        let fail = |e: io::Error| FileError::io("open", &path, e);
        let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let opened = reserve::with_spare(|| {
            Ok(rustix::fs::openat(&self.folder, OsStr::from_bytes(name.as_bytes()), flags, Mode::empty())?)
        });
        let unfit = |problem| FileError::Unfit { path: path.clone(), problem };
        let mut file = match opened {
            Ok(file) => File::from(file),
            // What a link leads to is not looked at.
            Err(error) if error.raw_os_error() == Some(Errno::LOOP.raw_os_error()) => {
                return Err(unfit(Unfit::NotRegular));
            }
            Err(error) => return Err(fail(error)),
        };
        let metadata = file.metadata().map_err(fail)?;
        if !metadata.is_file() {
            return Err(unfit(Unfit::NotRegular));
        }
        if metadata.nlink() > 1 {
            return Err(unfit(Unfit::HardLinked(metadata.nlink())));
        }
        let mut bytes = Vec::new();
        let read = (&mut file).take(max_bytes.saturating_add(1)).read_to_end(&mut bytes);
        read.map_err(|e| FileError::io("read", &path, e))?;
        if bytes.len() as u64 > max_bytes {
            return Err(unfit(Unfit::TooLarge(max_bytes)));
        }
        let text = String::from_utf8(bytes).map_err(|_| unfit(Unfit::NotText))?;
        let (number, uid) = (metadata.ino(), metadata.uid());
        Ok(Letter { number, text, uid, lock: SenderLock(Arc::new(file)) })
    }

    /// Files that come into the folder from now on.
    ///
    /// # Errors
    /// The system has no watch to give.
    pub fn arrivals(&self) -> Result<Arrivals, FileError> {
        let fail = |e: Errno| FileError::io("watch", &self.path, e.into());
        let events = inotify::init(CreateFlags::CLOEXEC | CreateFlags::NONBLOCK).map_err(fail)?;
        // The folder that is open, whatever its name leads to by now.
        let open = format!("/proc/self/fd/{}", self.folder.as_raw_fd());
        inotify::add_watch(&events, open, WatchFlags::MOVED_TO | WatchFlags::CLOSE_WRITE).map_err(fail)?;
        Ok(Arrivals(events))
    }

    /// Removes a file; false where its sender has taken it back.
    ///
    /// # Errors
    /// The system refuses.
    pub fn claim(&self, name: &str) -> Result<bool, FileError> {
        match rustix::fs::unlinkat(&self.folder, OsStr::from_bytes(name.as_bytes()), AtFlags::empty()) {
            Ok(()) => Ok(true),
            Err(Errno::NOENT) => Ok(false),
            Err(errno) => Err(FileError::io("remove", &self.path.join(name), errno.into())),
        }
    }
}

/// New files of a folder by name, as the kernel reports them. It may lose some (a full queue, a file system
/// that reports nothing, a hard link), so the folder has to be listed as well.
#[derive(Debug)]
pub struct Arrivals(OwnedFd);

impl Arrivals {
    /// The names that have come since the last call, in order, at most as many as fit into 32 KiB; those
    /// that end in `suffix` and are not hidden.
    pub fn names(&self, suffix: &str) -> Vec<String> {
        let mut buffer = [MaybeUninit::uninit(); 32 * 1024];
        let mut reader = inotify::Reader::new(&self.0, &mut buffer);
        let mut names = Vec::new();
        while let Ok(event) = reader.next() {
            let name = event.file_name().and_then(|name| name.to_str().ok());
            names.extend(name.filter(|name| is_left(name, suffix)).map(str::to_string));
            if reader.is_buffer_empty() {
                break;
            }
        }
        names
    }
}

fn is_left(name: &str, suffix: &str) -> bool {
    name.ends_with(suffix) && !name.starts_with('.')
}

/// A file that was left for another process, with the sender's lock on it.
#[derive(Debug)]
pub struct Left {
    /// Where.
    pub path: PathBuf,
    _lock: File,
}

/// Leaves `bytes` under the first of `names` in `folder` that is free, locked until the result is dropped.
///
/// # Errors
/// None of `names` is free, or the system refuses to create, lock, write or rename the file.
pub fn leave(folder: &Path, names: impl Iterator<Item = String>, bytes: &[u8]) -> Result<Left, FileError> {
    let draft = draft(&folder.join("new"), bytes)?;
    share_with_group(folder, draft.as_file(), draft.path())?;
    let (file, hidden) = draft.into_parts();
    file.try_lock().map_err(|e| FileError::io("lock", &hidden, e.into()))?;
    for name in names {
        let path = folder.join(name);
        match rustix::fs::renameat_with(CWD, &*hidden, CWD, &path, RenameFlags::NOREPLACE) {
            Ok(()) => return Ok(Left { path, _lock: file }),
            Err(Errno::EXIST) => {}
            Err(errno) => return Err(FileError::io("rename to", &path, errno.into())),
        }
    }
    Err(FileError::io("name", folder, io::ErrorKind::AlreadyExists.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names() -> impl Iterator<Item = String> {
        (0..9).map(|number| format!("{number}.command"))
    }

    #[test]
    fn the_lock_shows_whether_the_sender_still_waits() {
        let folder = tempfile::tempdir().unwrap();
        let mailbox = Mailbox::open(folder.path()).unwrap();
        let left = leave(folder.path(), names(), b"stop").unwrap();
        let letter = mailbox.read("0.command", 100).unwrap();
        assert_eq!(letter.text, "stop");
        assert!(letter.lock.is_held() && letter.lock.is_held());
        assert!(mailbox.claim("0.command").unwrap() && !mailbox.claim("0.command").unwrap());
        assert!(letter.lock.is_held(), "also of a file that was removed");
        drop(left);
        assert!(!letter.lock.is_held());
        std::fs::write(folder.path().join("1.command"), "arm").unwrap();
        assert!(!mailbox.read("1.command", 100).unwrap().lock.is_held(), "nobody locked it");
    }

    #[test]
    fn a_folder_that_is_removed_renamed_or_replaced_is_not_in_place() {
        let root = tempfile::tempdir().unwrap();
        let (path, aside) = (root.path().join("commands"), root.path().join("aside"));
        std::fs::create_dir(&path).unwrap();
        let mailbox = Mailbox::open(&path).unwrap();
        assert!(mailbox.is_in_place());
        std::fs::rename(&path, &aside).unwrap();
        assert!(!mailbox.is_in_place());
        std::fs::create_dir(&path).unwrap();
        assert!(!mailbox.is_in_place());
        std::fs::remove_dir(&path).unwrap();
        std::fs::rename(&aside, &path).unwrap();
        assert!(mailbox.is_in_place(), "put back");
        std::fs::remove_dir(&path).unwrap();
        assert!(!mailbox.is_in_place());
        assert!(mailbox.names(".command").is_err() && mailbox.claim("0.command").is_ok_and(|had| !had));
    }

    #[test]
    fn each_new_file_is_reported_once_and_shows_whether_it_still_lies_there() {
        let folder = tempfile::tempdir().unwrap();
        let mailbox = Mailbox::open(folder.path()).unwrap();
        let arrivals = mailbox.arrivals().unwrap();
        assert!(arrivals.names(".command").is_empty());
        let left = leave(folder.path(), names(), b"1").unwrap();
        std::fs::write(folder.path().join("0.reply"), "another kind").unwrap();
        assert_eq!(arrivals.names(".command"), ["0.command"]);
        assert!(arrivals.names(".command").is_empty(), "once");
        let first = mailbox.read("0.command", 100).unwrap();
        assert_eq!(mailbox.names(".command").unwrap(), [("0.command".to_string(), first.number)]);
        assert!(first.lock.lies_there());
        std::fs::remove_file(&left.path).unwrap();
        assert!(!first.lock.lies_there());
        let _again = leave(folder.path(), names(), b"1").unwrap();
        assert_ne!(mailbox.read("0.command", 100).unwrap().number, first.number, "the first one is open");
        assert_eq!(arrivals.names(".command"), ["0.command"]);
    }

    #[test]
    fn names_come_in_order_each_time_and_strange_files_are_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let mailbox = Mailbox::open(folder.path()).unwrap();
        let first = leave(folder.path(), names(), b"1").unwrap();
        let second = leave(folder.path(), names(), b"2").unwrap();
        assert!(second.path.ends_with("1.command"), "{second:?} {first:?}");
        std::fs::write(folder.path().join(".2.command"), "hidden").unwrap();
        std::os::unix::fs::symlink("/etc/passwd", folder.path().join("3.command")).unwrap();
        std::fs::hard_link(&first.path, folder.path().join("4.reply")).unwrap();
        for _ in 0..2 {
            let names: Vec<String> =
                mailbox.names(".command").unwrap().into_iter().map(|(name, _)| name).collect();
            assert_eq!(names, ["0.command", "1.command", "3.command"]);
        }
        for strange in ["3.command", "0.command"] {
            assert!(mailbox.read(strange, 100).is_err_and(|error| !error.is_absent()), "{strange}");
        }
        assert!(mailbox.read("5.command", 100).is_err_and(|error| error.is_absent()));
        assert!(mailbox.read("1.command", 0).is_err());
    }
}
