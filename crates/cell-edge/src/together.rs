//! Files that belong together: all replaced or none.
//!
//! In: paths and what they are to hold. Out: the files on disk. A calibration is three files, of which a
//! part alone would send the arm beside the objects.

use crate::files::{FileError, draft, parent, remove, replace, sync_folder, write_atomic};
use std::path::Path;

/// Files that belong together: none is replaced before all are on disk beside their places, and where one
/// cannot be replaced those before it get back what they had. A power cut between two renames leaves a part
/// of them new.
///
/// # Errors
/// As [`write_atomic`]; all are as they were then, unless what they had cannot be written either.
pub fn write_together(files: &[(&Path, &[u8])]) -> Result<(), FileError> {
    let mut drafts = Vec::with_capacity(files.len());
    for (path, bytes) in files {
        let draft = draft(path, bytes)?;
        draft.as_file().sync_all().map_err(|e| FileError::io("sync", path, e))?;
        drafts.push((*path, std::fs::read(path).ok(), draft));
    }
    let mut replaced: Vec<(&Path, Option<Vec<u8>>)> = Vec::new();
    for (path, before, draft) in drafts {
        if let Err(refused) = replace(path, draft) {
            for (path, before) in replaced {
                before.map_or_else(|| remove(path), |bytes| write_atomic(path, &bytes))?;
            }
            return Err(refused);
        }
        replaced.push((path, before));
    }
    files.iter().try_for_each(|(path, _)| sync_folder(parent(path)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_files_that_belong_together_all_are_replaced_or_none() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let (one, two, closed) = (at("one"), at("two"), at("one").join("three"));
        std::fs::write(&one, "old").unwrap();
        write_together(&[(&one, b"new".as_slice()), (&two, b"new")]).unwrap();
        assert_eq!([&one, &two].map(|path| std::fs::read(path).unwrap()), [b"new", b"new"]);
        assert!(write_together(&[(&one, b"newer".as_slice()), (&closed, b"newer")]).is_err());
        assert_eq!(std::fs::read(&one).unwrap(), b"new");
        // The last one is a folder: it cannot be replaced, and the first two are there by then.
        let (fourth, occupied) = (at("four"), at("five"));
        std::fs::create_dir(&occupied).unwrap();
        let newest = [&one, &fourth, &occupied].map(|path| (path.as_path(), b"newest".as_slice()));
        assert!(write_together(&newest).is_err());
        assert_eq!(std::fs::read(&one).unwrap(), b"new");
        assert!(!fourth.exists() && two.exists());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "no draft is left");
    }
}
