//! A folder in which other processes leave small files for this one.
//!
//! In: a folder, held open from the start. Out: the names in it, a file with its text, its owner and the
//! sender's lock, whether the folder is still the one under its name. A sender holds an exclusive lock on
//! its file until it has its answer; the kernel frees the lock with the process, however that ends, so the
//! receiver sees whether a client still waits. A second lock, on the file's first byte, decides between the
//! receiver, which takes the file, and its sender, which takes it back. Nothing here waits for a disk: a
//! file is for the process that runs now and not for the one after a power cut, so none is synced. Listing
//! and removing take the kernel's lock of the folder, which every sender takes too. Learning of a file
//! ([`Arrivals`]), reading and claiming it do not, as long as the file exists.

use crate::files::{FileError, Unfit, draft, share_with_group};
use crate::reserve;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc::{self, c_int, c_short, flock};
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

/// A received file, kept open, with its two locks: the sender's, and the one by which the receiver takes it.
#[derive(Clone, Debug)]
pub struct SenderLock(Arc<File>);

/// A lock of this kind on a file's first byte. It belongs to the open file, not to the process, and ends
/// when that is closed.
fn first_byte(kind: c_int) -> flock {
    flock { l_type: kind as c_short, l_whence: libc::SEEK_SET as c_short, l_start: 0, l_len: 1, l_pid: 0 }
}

/// Takes that lock; false where the other side has it.
fn take_first_byte(file: &File, kind: c_int) -> io::Result<bool> {
    use nix::errno::Errno;
    match fcntl(file, FcntlArg::F_OFD_SETLK(&first_byte(kind))) {
        Ok(_) => Ok(true),
        Err(Errno::EAGAIN | Errno::EACCES) => Ok(false),
        Err(errno) => Err(errno.into()),
    }
}

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

    /// Takes the file for the receiver, until it is closed here. False if its sender has taken it back.
    /// Several threads of the receiver may take the same file.
    ///
    /// # Errors
    /// The file system has no such locks.
    pub fn claim(&self) -> io::Result<bool> {
        // In this sequence: a sender that takes its file back holds the lock until it has removed the file.
        Ok(take_first_byte(&self.0, libc::F_RDLCK)? && self.lies_there())
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

    /// Watches for files that are renamed into the folder. Not for files that are written there: the kernel
    /// reports the end of writing also when a sender closes a file that was already removed.
    ///
    /// # Errors
    /// The system has no watch to give.
    pub fn arrivals(&self) -> Result<Arrivals, FileError> {
        let fail = |e: Errno| FileError::io("watch", &self.path, e.into());
        let events = inotify::init(CreateFlags::CLOEXEC | CreateFlags::NONBLOCK).map_err(fail)?;
        // The folder that is open, whatever its name leads to by now.
        let open = format!("/proc/self/fd/{}", self.folder.as_raw_fd());
        inotify::add_watch(&events, open, WatchFlags::MOVED_TO).map_err(fail)?;
        Ok(Arrivals(events))
    }

    /// Removes a file; false if it is not there any more.
    ///
    /// # Errors
    /// The system refuses.
    pub fn remove(&self, name: &str) -> Result<bool, FileError> {
        match rustix::fs::unlinkat(&self.folder, OsStr::from_bytes(name.as_bytes()), AtFlags::empty()) {
            Ok(()) => Ok(true),
            Err(Errno::NOENT) => Ok(false),
            Err(errno) => Err(FileError::io("remove", &self.path.join(name), errno.into())),
        }
    }
}

/// Names of files that were renamed into a folder, as the kernel reports them. It may lose some (a full
/// queue, a file system that reports nothing), so the folder has to be listed as well.
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
    file: File,
}

impl Left {
    /// The file lies there, and the receiver has not taken it.
    ///
    /// # Errors
    /// The file system has no such locks.
    pub fn waits(&self) -> Result<bool, FileError> {
        let fail = |e| FileError::io("look at the lock of", &self.path, e);
        let mut found = first_byte(libc::F_WRLCK);
        fcntl(&self.file, FcntlArg::F_OFD_GETLK(&mut found)).map_err(|errno| fail(errno.into()))?;
        // The receiver removes the file and then closes it, which ends its lock.
        let is_free = found.l_type == libc::F_UNLCK as c_short;
        Ok(is_free && self.file.metadata().map_err(fail)?.nlink() > 0)
    }

    /// Takes the file back and removes it. False if the receiver has taken or removed it. If the file cannot
    /// be removed it is still taken back: the receiver cannot take it while this exists, and refuses it
    /// afterwards, because nobody waits.
    ///
    /// # Errors
    /// The file system has no such locks.
    pub fn take_back(&self) -> Result<bool, FileError> {
        let fail = |e| FileError::io("take back", &self.path, e);
        if !take_first_byte(&self.file, libc::F_WRLCK).map_err(fail)? {
            return Ok(false);
        }
        if self.file.metadata().map_err(fail)?.nlink() == 0 {
            // A new receiver has cleared the folder.
            return Ok(false);
        }
        Ok(std::fs::remove_file(&self.path).is_ok() || self.file.metadata().map_err(fail)?.nlink() > 0)
    }
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
            Ok(()) => return Ok(Left { path, file }),
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
        assert!(mailbox.remove("0.command").unwrap() && !mailbox.remove("0.command").unwrap());
        assert!(letter.lock.is_held(), "also of a file that was removed");
        drop(left);
        assert!(!letter.lock.is_held());
        std::fs::write(folder.path().join("1.command"), "arm").unwrap();
        assert!(!mailbox.read("1.command", 100).unwrap().lock.is_held(), "nobody locked it");
    }

    #[test]
    fn a_file_is_taken_by_its_receiver_or_taken_back_by_its_sender_and_never_both() {
        let folder = tempfile::tempdir().unwrap();
        let mailbox = Mailbox::open(folder.path()).unwrap();
        let read = |left: &Left| mailbox.read(left.path.file_name().unwrap().to_str().unwrap(), 100).unwrap();
        let left = leave(folder.path(), names(), b"arm").unwrap();
        let (first, second) = (read(&left).lock, read(&left).lock);
        assert!(left.waits().unwrap());
        assert!(first.claim().unwrap() && second.claim().unwrap(), "both readers are the receiver's");
        assert!(!left.waits().unwrap() && !left.take_back().unwrap());
        assert!(left.path.exists());
        drop((first, second));
        // The receiver has ended.
        let late = read(&left).lock;
        assert!(left.take_back().unwrap() && !left.path.exists());
        assert!(!late.claim().unwrap());
        drop(left);
        assert!(!late.claim().unwrap(), "gone, though nobody has its lock any more");
        let cleared = leave(folder.path(), names(), b"arm").unwrap();
        std::fs::remove_file(&cleared.path).unwrap();
        assert!(!cleared.waits().unwrap());
        assert!(!cleared.take_back().unwrap(), "by the receiver that started after the one that had it");
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
        assert!(mailbox.names(".command").is_err() && mailbox.remove("0.command").is_ok_and(|had| !had));
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
        drop(left);
        assert!(arrivals.names(".command").is_empty(), "its sender has ended");
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
