//! A lock with one holder, for a folder that belongs to one process.
//!
//! In: a file's path. Out: the lock, or that another process holds it. The system frees it with its process,
//! however that ends, so that no file from a crash has to be removed by hand.

use crate::files::FileError;
use rustix::fs::OFlags;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

/// How long a process can be stopped while it looks whether the lock is held.
const INSTANT: Duration = Duration::from_secs(2);

/// An exclusive lock, held until it is dropped or the process ends in any way.
#[derive(Debug)]
pub struct FileLock {
    _file: File,
}

impl FileLock {
    /// Takes the lock and leaves `note` in the file; `None` when another process holds it.
    ///
    /// # Errors
    /// The system refuses to open, lock or write the file ([`FileError::Io`]).
    pub fn take(path: &Path, note: &str) -> Result<Option<FileLock>, FileError> {
        let mut file = open_lock(path)?;
        if !lock_from_watchers(&file, path, || std::thread::sleep(Duration::from_millis(1)))? {
            return Ok(None);
        }
        let write = file.set_len(0).and_then(|()| file.write_all(note.as_bytes()));
        write.map_err(|e| FileError::io("write", path, e))?;
        Ok(Some(FileLock { _file: file }))
    }

    /// True when some process holds the lock.
    ///
    /// # Errors
    /// The file is present, but the system refuses to open it or to try the lock ([`FileError::Io`]).
    pub fn is_held(path: &Path) -> Result<bool, FileError> {
        // Only to read: who may see the state need not be able to change it.
        let file = match File::open(path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(false),
            other => other.map_err(|e| FileError::io("open", path, e))?,
        };
        Ok(!lock_of(path, file.try_lock_shared())?)
    }
}

/// Takes the lock; false when another process keeps it. Who looks whether it is held
/// ([`FileLock::is_held`]) shares it for an instant: that is waited out, for [`INSTANT`] at most.
fn lock_from_watchers(file: &File, path: &Path, mut wait: impl FnMut()) -> Result<bool, FileError> {
    let started = Instant::now();
    while !lock_of(path, file.try_lock())? {
        if !lock_of(path, file.try_lock_shared())? || started.elapsed() > INSTANT {
            return Ok(false);
        }
        file.unlock().map_err(|e| FileError::io("unlock", path, e))?;
        wait();
    }
    Ok(true)
}

/// True when the lock was got, false when another process keeps it.
fn lock_of(path: &Path, tried: Result<(), TryLockError>) -> Result<bool, FileError> {
    match tried {
        Ok(()) => Ok(true),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(e)) => Err(FileError::io("lock", path, e)),
    }
}

fn open_lock(path: &Path) -> Result<File, FileError> {
    OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .custom_flags(OFlags::NOFOLLOW.bits().cast_signed())
        .open(path)
        .map_err(|e| FileError::io("open", path, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_has_one_holder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        assert!(!FileLock::is_held(&path).unwrap());
        let lock = FileLock::take(&path, "1").unwrap().unwrap();
        assert!(FileLock::is_held(&path).unwrap());
        assert!(FileLock::take(&path, "2").unwrap().is_none());
        drop(lock);
        assert!(!FileLock::is_held(&path).unwrap());
        assert!(FileLock::take(&path, "3").unwrap().is_some());
    }

    #[test]
    fn who_looks_whether_a_lock_is_held_turns_no_holder_away() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        drop(FileLock::take(&path, "1").unwrap().unwrap());
        let looks = File::open(&path).unwrap();
        looks.try_lock_shared().unwrap();
        let mut waits = 0;
        let wait = || {
            looks.unlock().unwrap();
            waits += 1;
        };
        assert!(lock_from_watchers(&open_lock(&path).unwrap(), &path, wait).unwrap());
        assert_eq!(waits, 1);
    }
}
