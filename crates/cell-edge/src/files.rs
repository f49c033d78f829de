//! Files that survive a power cut, and files of strangers that are opened with care.
//!
//! In: paths and bytes. Out: files written whole or not at all (temporary file, fsync, rename, fsync of the
//! folder), renames that never overwrite, text of regular files of bounded size, an exclusive lock. A rename
//! is atomic but not durable until the folder is synced; without the first fsync a crash may leave an empty
//! file.

use crate::reserve::with_spare;
use rustix::fs::{CWD, OFlags, RenameFlags};
use std::fs::{File, OpenOptions, Permissions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tempfile::NamedTempFile;

/// How the name of a file ends that is still being written.
const DRAFT_SUFFIX: &str = ".tmp";

/// Mode of a file that is written for its folder's group.
const FOR_THE_GROUP: u32 = 0o640;

/// Mode of a file that one user reads alone.
const FOR_ONE: u32 = 0o600;

/// What a folder passes its group on with.
const SETGID: u32 = 0o2000;

/// Mode of a folder into which a group writes.
const GROUP_FOLDER: u32 = 0o2770;

/// Mode of every other file, from which the umask takes.
const BEFORE_UMASK: u32 = 0o666;

/// Why a file was not read, written or moved.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The operating system refused.
    #[error("{action} {path}")]
    Io {
        /// What was tried: "write", "rename to", ...
        action: &'static str,
        /// On what.
        path: PathBuf,
        /// The system's answer.
        #[source]
        source: io::Error,
    },
    /// Something other than a plain file of reasonable size and encoding.
    #[error("{path}: {problem}")]
    Unfit {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: Unfit,
    },
}

/// What makes a stranger's file unfit to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unfit {
    /// A symbolic link, FIFO, socket, device or folder.
    #[error("not a regular file")]
    NotRegular,
    /// A file with a second name: its content may change under another name.
    #[error("has {0} hard links, one is allowed")]
    HardLinked(u64),
    /// Larger than the caller reads.
    #[error("larger than {0} bytes")]
    TooLarge(u64),
    /// Not text.
    #[error("not UTF-8 text")]
    NotText,
}

impl FileError {
    pub(crate) fn io(action: &'static str, path: &Path, source: io::Error) -> FileError {
        FileError::Io { action, path: path.to_owned(), source }
    }

    /// Why, in words, without the path: for callers that name the file themselves.
    pub fn reason(&self) -> String {
        match self {
            FileError::Io { source, .. } => source.to_string(),
            FileError::Unfit { problem, .. } => problem.to_string(),
        }
    }

    /// True when the file or folder was not there.
    pub fn is_absent(&self) -> bool {
        matches!(self, FileError::Io { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }

    /// True when the target of a rename was there already.
    pub fn is_present(&self) -> bool {
        matches!(self, FileError::Io { source, .. } if source.kind() == io::ErrorKind::AlreadyExists)
    }
}

/// What distinguishes files of the same name, and a finished one from one still being written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileIdentity {
    /// Device number.
    pub device: u64,
    /// Inode number.
    pub inode: u64,
    /// Bytes.
    pub size: u64,
    /// Last change of the content, ns since 1970.
    pub modified_ns: i128,
}

/// Identity of `path` itself (links are not followed) and whether it is a regular file.
///
/// # Errors
/// There is nothing at `path`, or the system refuses to look at it ([`FileError::Io`]).
pub fn identify(path: &Path) -> Result<(FileIdentity, bool), FileError> {
    let metadata = path.symlink_metadata().map_err(|e| FileError::io("look at", path, e))?;
    Ok((identity_of(&metadata), metadata.is_file()))
}

fn identity_of(metadata: &std::fs::Metadata) -> FileIdentity {
    FileIdentity {
        device: metadata.dev(),
        inode: metadata.ino(),
        size: metadata.size(),
        modified_ns: i128::from(metadata.mtime()) * 1_000_000_000 + i128::from(metadata.mtime_nsec()),
    }
}

/// Text of a regular file with one name and at most `max_bytes`; never follows a link, never blocks on a
/// FIFO.
///
/// # Errors
/// [`FileError::Unfit`] for anything that is not such a file, [`FileError::Io`] when the system refuses.
pub fn read_regular(path: &Path, max_bytes: u64) -> Result<(String, FileIdentity), FileError> {
    for _ in 0..TIMES_REPLACED_MAX {
        let (_, regular) = identify(path)?;
        if !regular {
            return Err(unfit(path, Unfit::NotRegular));
        }
        let (file, metadata) = open_regular(path, OFlags::NOFOLLOW)?;
        match metadata.nlink() {
            // Replaced or removed since it was opened: the next look shows which.
            0 => {}
            1 => return Ok((text(path, bounded(path, file, max_bytes)?)?, identity_of(&metadata))),
            names => return Err(unfit(path, Unfit::HardLinked(names))),
        }
    }
    Err(FileError::io("open", path, io::ErrorKind::ResourceBusy.into()))
}

/// A file that is replaced while it is opened is opened again, so many times at most.
const TIMES_REPLACED_MAX: u32 = 100;

/// Text of a regular file of at most `max_bytes` that a person named: links are followed, and nothing else
/// than a plain file at their end is opened (a device or a FIFO has no end, and states a size of 0).
///
/// # Errors
/// As [`read_regular`].
pub fn read_named(path: &Path, max_bytes: u64) -> Result<String, FileError> {
    text(path, read_bytes(path, max_bytes)?)
}

/// The same for any bytes: pictures.
///
/// # Errors
/// As [`read_regular`].
pub fn read_bytes(path: &Path, max_bytes: u64) -> Result<Vec<u8>, FileError> {
    let metadata = path.metadata().map_err(|e| FileError::io("look at", path, e))?;
    if !metadata.is_file() {
        return Err(unfit(path, Unfit::NotRegular));
    }
    let (file, _) = open_regular(path, OFlags::empty())?;
    bounded(path, file, max_bytes)
}

fn unfit(path: &Path, problem: Unfit) -> FileError {
    FileError::Unfit { path: path.to_owned(), problem }
}

/// Opens without ever waiting, and looks again at what was opened: the name may have changed hands.
fn open_regular(path: &Path, further: OFlags) -> Result<(File, std::fs::Metadata), FileError> {
    let flags = OFlags::NONBLOCK | OFlags::CLOEXEC | further;
    let open = || OpenOptions::new().read(true).custom_flags(flags.bits().cast_signed()).open(path);
    let file = with_spare(open).map_err(|e| FileError::io("open", path, e))?;
    let metadata = file.metadata().map_err(|e| FileError::io("look at", path, e))?;
    if metadata.is_file() { Ok((file, metadata)) } else { Err(unfit(path, Unfit::NotRegular)) }
}

fn bounded(path: &Path, file: File, max_bytes: u64) -> Result<Vec<u8>, FileError> {
    let mut bytes = Vec::new();
    file.take(max_bytes.saturating_add(1))
        .read_to_end(&mut bytes)
        .map_err(|e| FileError::io("read", path, e))?;
    if bytes.len() as u64 > max_bytes {
        return Err(unfit(path, Unfit::TooLarge(max_bytes)));
    }
    Ok(bytes)
}

fn text(path: &Path, bytes: Vec<u8>) -> Result<String, FileError> {
    String::from_utf8(bytes).map_err(|_| unfit(path, Unfit::NotText))
}

/// Writes `bytes` to `path` whole or not at all, and on return durably. Replaces what was there.
///
/// # Errors
/// The system refuses to create, write, rename or sync the file ([`FileError::Io`]). Until the rename has
/// succeeded, the old file stays as it was.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    let draft = draft(path, bytes)?;
    draft.as_file().sync_all().map_err(|e| FileError::io("sync", path, e))?;
    replace(path, draft)?;
    sync_folder(parent(path))
}

/// The same for what not everyone may read, whatever the umask: this user alone, or its group as well.
///
/// # Errors
/// As [`write_atomic`].
pub fn write_secret(path: &Path, bytes: &[u8], for_the_group: bool) -> Result<(), FileError> {
    let draft = secret_draft(path, bytes, for_the_group)?;
    draft.as_file().sync_all().map_err(|e| FileError::io("write", path, e))?;
    replace(path, draft)?;
    sync_folder(parent(path))
}

fn secret_draft(path: &Path, bytes: &[u8], for_the_group: bool) -> Result<NamedTempFile, FileError> {
    let draft = draft(path, &[])?;
    let mut file = draft.as_file();
    let mode = if for_the_group { FOR_THE_GROUP } else { FOR_ONE };
    let fail = |e| FileError::io("write", path, e);
    file.set_permissions(Permissions::from_mode(mode)).map_err(fail)?;
    file.write_all(bytes).map_err(fail)?;
    Ok(draft)
}

/// The same for what not everyone may read, without a sync: an answer that one process waits for.
///
/// # Errors
/// As [`write_whole`].
pub fn write_answer(path: &Path, bytes: &[u8], for_the_group: bool) -> Result<(), FileError> {
    replace(path, secret_draft(path, bytes, for_the_group)?)
}

/// The same without a sync: whole at any time, and after a power cut perhaps an old one or none. For what is
/// written so often that a sync each time would wear the disk and hold others up.
///
/// # Errors
/// The system refuses to write or to rename ([`FileError::Io`]).
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    replace(path, draft(path, bytes)?)
}

/// What `write` writes takes the place of `path` once it is on disk; as long as it fails, nothing changes.
///
/// # Errors
/// `write` fails, or the system refuses to create, sync or rename the file ([`FileError::Io`]).
pub fn rewrite<T>(path: &Path, write: impl FnOnce(&mut File) -> io::Result<T>) -> Result<T, FileError> {
    let mut draft = draft(path, &[])?;
    let written = write(draft.as_file_mut()).and_then(|done| draft.as_file().sync_all().map(|()| done));
    let written = written.map_err(|e| FileError::io("write", path, e))?;
    replace(path, draft).map(|()| written)
}

/// Writes `bytes` durably under the first of `names` in `folder` that is free, and returns that name. In
/// a folder that is shared with a group, what is written is readable by it, whatever the umask: it is for a
/// daemon of another user.
///
/// # Errors
/// None of `names` is free, or the system refuses to create, write, rename or sync the file
/// ([`FileError::Io`]).
pub fn write_new(
    folder: &Path,
    names: impl Iterator<Item = String>,
    bytes: &[u8],
) -> Result<String, FileError> {
    let draft = draft(&folder.join("new"), bytes)?;
    share_with_group(folder, draft.as_file(), draft.path())?;
    draft.as_file().sync_all().map_err(|e| FileError::io("write", draft.path(), e))?;
    let mut refused = None;
    for name in names {
        match rename_new(draft.path(), &folder.join(&name)) {
            Ok(()) => return Ok(name),
            Err(error) if error.is_present() => refused = Some(error),
            Err(error) => return Err(error),
        }
    }
    let none = || FileError::io("name", folder, io::ErrorKind::InvalidInput.into());
    Err(refused.unwrap_or_else(none))
}

/// In a folder that is shared with a group, what is written is readable by it, whatever the umask.
pub(crate) fn share_with_group(folder: &Path, file: &File, path: &Path) -> Result<(), FileError> {
    let fail = |e| FileError::io("write", path, e);
    if folder.metadata().map_err(fail)?.mode() & SETGID != 0 {
        file.set_permissions(Permissions::from_mode(FOR_THE_GROUP)).map_err(fail)?;
    }
    Ok(())
}

/// A hidden file beside `path` with `bytes` in it, removed when it is dropped. Its name cannot be foreseen
/// and it is created exclusively: who may write in the same folder cannot lay a link in its way.
pub(crate) fn draft(path: &Path, bytes: &[u8]) -> Result<NamedTempFile, FileError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    // Opened here and not by the library, whose error does not show whether handles are left.
    let mut create = OpenOptions::new();
    create.read(true).write(true).create_new(true).mode(BEFORE_UMASK);
    let mut draft = tempfile::Builder::new()
        .prefix(&format!(".{name}."))
        .suffix(DRAFT_SUFFIX)
        .make_in(parent(path), |draft| with_spare(|| create.open(draft)))
        .map_err(|e| FileError::io("create", path, e))?;
    draft.write_all(bytes).map_err(|e| FileError::io("write", path, e))?;
    Ok(draft)
}

/// Puts a draft in the place of `path`; nothing is left of one that cannot be.
pub(crate) fn replace(path: &Path, draft: NamedTempFile) -> Result<(), FileError> {
    draft.persist(path).map(drop).map_err(|e| FileError::io("rename to", path, e.error))
}

/// Removes drafts that processes left in `folder` when they were killed: those that are older than this, so
/// that none goes which is being written. One that cannot be removed stays: it harms nothing.
///
/// # Errors
/// The folder cannot be listed ([`FileError::Io`]).
pub fn remove_drafts(folder: &Path, older_than: Duration) -> Result<(), FileError> {
    let fail = |e| FileError::io("list", folder, e);
    for entry in std::fs::read_dir(folder).map_err(fail)? {
        let entry = entry.map_err(fail)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let written = entry.metadata().and_then(|meta| meta.modified()).ok();
        let age = written.and_then(|written| written.elapsed().ok()).unwrap_or_default();
        let is_draft = name.starts_with('.') && name.ends_with(DRAFT_SUFFIX) && age >= older_than;
        if is_draft && !entry.path().is_dir() {
            let _ = std::fs::remove_file(entry.path());
        }
    }
    Ok(())
}

/// Renames `from` to `to` durably; fails if `to` exists. Both must be on one file system.
///
/// # Errors
/// `from` is absent, `to` is present, or the system refuses the rename or a sync ([`FileError::Io`]).
pub fn rename_new(from: &Path, to: &Path) -> Result<(), FileError> {
    rustix::fs::renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE)
        .map_err(|e| FileError::io("rename to", to, e.into()))?;
    sync_folder(parent(to))?;
    if parent(from) != parent(to) {
        sync_folder(parent(from))?;
    }
    Ok(())
}

/// Removes a file durably; false where it was gone: whoever removed it has it.
///
/// # Errors
/// The system refuses to remove it, or to sync its folder ([`FileError::Io`]).
pub fn take_away(path: &Path) -> Result<bool, FileError> {
    match std::fs::remove_file(path) {
        Ok(()) => sync_folder(parent(path)).map(|()| true),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(FileError::io("remove", path, error)),
    }
}

/// Removes a file durably; a file that is not there is fine.
///
/// # Errors
/// The system refuses to remove the file or to sync its folder ([`FileError::Io`]); a folder that is absent
/// cannot be synced.
pub fn remove(path: &Path) -> Result<(), FileError> {
    if take_away(path)? { Ok(()) } else { sync_folder(parent(path)) }
}

/// Creates a folder into which the group of `root` may write, where `root` is shared with a group (has the
/// setgid bit, as the packaged state folder has); elsewhere as [`create_folder`]. A folder that is there
/// with another mode gets this one, where it is this user's.
///
/// # Errors
/// As [`create_folder`]; the mode cannot be set ([`FileError::Io`]).
pub fn create_group_folder(root: &Path, path: &Path) -> Result<(), FileError> {
    create_folder(path)?;
    let look = |path: &Path| path.metadata().map_err(|e| FileError::io("look at", path, e));
    let (root, folder) = (look(root)?, look(path)?);
    let own = folder.uid() == rustix::process::geteuid().as_raw();
    if root.mode() & SETGID == 0 || !own || folder.mode() & 0o7777 == GROUP_FOLDER {
        return Ok(());
    }
    std::fs::set_permissions(path, Permissions::from_mode(GROUP_FOLDER))
        .map_err(|e| FileError::io("set the mode of", path, e))
}

/// Creates a folder with its parents, durably as far as its own entry goes.
///
/// # Errors
/// The system refuses to create the folder or a parent, or to sync the parent ([`FileError::Io`]).
pub fn create_folder(path: &Path) -> Result<(), FileError> {
    std::fs::create_dir_all(path).map_err(|e| FileError::io("create folder", path, e))?;
    sync_folder(parent(path))
}

/// Makes the entries of a folder durable.
///
/// # Errors
/// The folder is absent, or the system refuses to open or sync it ([`FileError::Io`]).
pub fn sync_folder(path: &Path) -> Result<(), FileError> {
    File::open(path).and_then(|folder| folder.sync_all()).map_err(|e| FileError::io("sync folder", path, e))
}

/// What a file of this user may still take on the disk of `path`, bytes.
///
/// # Errors
/// The system does not say ([`FileError::Io`]).
pub fn free_bytes(path: &Path) -> Result<u64, FileError> {
    let disk = rustix::fs::statvfs(path).map_err(|e| FileError::io("look at the disk of", path, e.into()))?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

pub(crate) fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests;
