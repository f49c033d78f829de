//! The files of a repair: copies to work on, the damaged files under a name that stays, the new journal in
//! their place.
//!
//! In: the path of a journal. Out: files and folders, each step durable before the next. The damaged files
//! get second names before anything is removed, so a repair that is cut off anywhere has lost nothing and is
//! repeated from them.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::{FileExt, MetadataExt, chown};
use std::path::{Path, PathBuf};

/// What an operation was about to do, where, and the system's answer.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} {path}")]
pub struct FileFault {
    /// What was attempted.
    pub action: &'static str,
    /// The file or folder.
    pub path: PathBuf,
    /// The cause.
    #[source]
    pub source: io::Error,
}

fn fault<'a>(action: &'static str, path: &'a Path) -> impl FnOnce(io::Error) -> FileFault + 'a {
    move |source| FileFault { action, path: path.to_owned(), source }
}

/// The file beside `path` whose name has this behind it.
pub(super) fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

/// SQLite's files beside a database.
const COMPANIONS: [&str; 2] = ["-wal", "-shm"];

/// What stands behind the names of damaged journals that were kept.
const DAMAGED: &str = ".damaged-";

/// A folder beside the journal that is removed with its content at the end.
pub(super) struct Workshop {
    folder: PathBuf,
}

impl Workshop {
    /// Makes the folder; one that an earlier repair left is removed first.
    pub(super) fn make(journal: &Path) -> Result<Workshop, FileFault> {
        let folder = with_suffix(journal, ".repairing");
        if folder.symlink_metadata().is_ok() {
            std::fs::remove_dir_all(&folder).map_err(fault("remove", &folder))?;
        }
        std::fs::create_dir(&folder).map_err(fault("create", &folder))?;
        Ok(Workshop { folder })
    }

    pub(super) fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }
}

impl Drop for Workshop {
    fn drop(&mut self) {
        // What stays is removed by the next repair.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Bytes that are read at once, and given up at once where the disk cannot read them.
const PIECE: u64 = 4096;

/// Copies the database with its write-ahead log; what the disk cannot read becomes zeros. True where the log
/// is one that a repair that was cut off has kept: the journal alone is less than the copy then.
pub(super) fn copy_database(journal: &Path, to: &Path) -> Result<bool, FileFault> {
    copy(journal, to)?;
    let present = |log: PathBuf| log.exists().then_some(log);
    let beside = present(with_suffix(journal, "-wal"));
    let kept = || kept_before(journal).and_then(|kept| present(with_suffix(&kept, "-wal")));
    let from_kept = beside.is_none();
    let Some(log) = beside.or_else(kept) else { return Ok(false) };
    copy(&log, &with_suffix(to, "-wal"))?;
    Ok(from_kept)
}

fn copy(from: &Path, to: &Path) -> Result<(), FileFault> {
    let source = File::open(from).map_err(fault("open", from))?;
    let metadata = source.metadata().map_err(fault("read", from))?;
    if !metadata.is_file() {
        return Err(fault("read", from)(io::Error::other("not a regular file")));
    }
    let target = File::create(to).map_err(fault("create", to))?;
    let read = |at: u64, piece: &mut [u8]| source.read_exact_at(piece, at);
    copy_pieces(metadata.len(), read, &target).map_err(fault("write", to))
}

fn copy_pieces(
    length: u64,
    mut read: impl FnMut(u64, &mut [u8]) -> io::Result<()>,
    target: &File,
) -> io::Result<()> {
    let mut buffer = [0; PIECE as usize];
    for at in (0..length).step_by(PIECE as usize) {
        let piece = &mut buffer[..usize::try_from(PIECE.min(length - at)).unwrap_or(0)];
        if read(at, piece).is_err() {
            piece.fill(0);
        }
        target.write_all_at(piece, at)?;
    }
    Ok(())
}

/// Replaces the first page of the database `to` by that of `from`: its header and the places of its tables.
pub(super) fn graft_first_page(from: &Path, to: &Path) -> Result<(), FileFault> {
    let mut page = [0; PIECE as usize];
    File::open(from).and_then(|file| file.read_exact_at(&mut page, 0)).map_err(fault("read", from))?;
    let target = OpenOptions::new().write(true).open(to).map_err(fault("open", to))?;
    let pages = target.metadata().map_err(fault("read", to))?.len() / PIECE;
    // Offsets 28, 32 and 36 (SQLite's file format, section 1.3): pages of the database, no free pages.
    page[28..32].copy_from_slice(&u32::try_from(pages).unwrap_or(0).to_be_bytes());
    page[32..40].fill(0);
    target.write_all_at(&page, 0).map_err(fault("write", to))
}

/// The name under which this very file was kept by a repair that was cut off.
fn kept_before(journal: &Path) -> Option<PathBuf> {
    let identity = |path: &Path| path.symlink_metadata().ok().map(|data| (data.dev(), data.ino()));
    let wanted = identity(journal)?;
    let prefix = with_suffix(Path::new(journal.file_name()?), DAMAGED);
    let entries = std::fs::read_dir(journal.parent()?).ok()?.flatten();
    let kept = |path: &PathBuf| {
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
        name.is_some_and(|name| name.starts_with(&*prefix.to_string_lossy()))
            && identity(path) == Some(wanted)
    };
    entries.map(|entry| entry.path()).find(kept)
}

/// Gives the damaged files names that stay, and returns that of the database.
pub(super) fn keep_damaged(journal: &Path, when: &str) -> Result<PathBuf, FileFault> {
    let kept = match kept_before(journal) {
        Some(kept) => kept,
        None => {
            let name = |number: u32| match number {
                1 => with_suffix(journal, &format!("{DAMAGED}{when}")),
                _ => with_suffix(journal, &format!("{DAMAGED}{when}.{number}")),
            };
            let kept =
                (1..).map(name).find(|name| name.symlink_metadata().is_err()).unwrap_or_else(|| name(0));
            std::fs::hard_link(journal, &kept).map_err(fault("keep the damaged journal as", &kept))?;
            kept
        }
    };
    for companion in COMPANIONS {
        let (old, new) = (with_suffix(journal, companion), with_suffix(&kept, companion));
        if old.exists() && !new.exists() {
            std::fs::hard_link(&old, &new).map_err(fault("keep the damaged journal's log as", &new))?;
        }
    }
    sync_folder(journal)?;
    Ok(kept)
}

/// Puts the new database in the place of the damaged one, whose files are kept by now; it gets the same
/// owner and mode.
pub(super) fn put_in_place(new: &Path, journal: &Path) -> Result<(), FileFault> {
    let old = journal.metadata().map_err(fault("read", journal))?;
    let file = File::open(new).map_err(fault("open", new))?;
    let own = file.metadata().map_err(fault("read", new))?;
    if (own.uid(), own.gid()) != (old.uid(), old.gid()) {
        chown(new, Some(old.uid()), Some(old.gid())).map_err(fault("give its owner to", new))?;
    }
    file.set_permissions(old.permissions()).map_err(fault("give its mode to", new))?;
    file.sync_all().map_err(fault("sync", new))?;
    // A log of the damaged database beside the new one would be played into it.
    for companion in COMPANIONS {
        let old = with_suffix(journal, companion);
        match std::fs::remove_file(&old) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(fault("remove", &old)(error));
            }
            _ => {}
        }
    }
    sync_folder(journal)?;
    std::fs::rename(new, journal).map_err(fault("replace", journal))?;
    sync_folder(journal)
}

fn sync_folder(journal: &Path) -> Result<(), FileFault> {
    let folder = journal.parent().unwrap_or(Path::new("/"));
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(fault("sync", folder))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_that_the_disk_cannot_read_become_zeros_and_the_rest_is_copied() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("copy");
        let read = |at: u64, piece: &mut [u8]| match at {
            4096 => Err(io::Error::other("medium error")),
            _ => {
                piece.fill(7);
                Ok(())
            }
        };
        copy_pieces(10_000, read, &File::create(&path).unwrap()).unwrap();
        let copied = std::fs::read(&path).unwrap();
        let expected = [vec![7; 4096], vec![0; 4096], vec![7; 10_000 - 8192]].concat();
        assert!(copied == expected);
    }
}
