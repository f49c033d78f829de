//! Whether the disk of the state folder has room for another job.
//!
//! In: the state folder. Out: how much is left where that is too little, in words. The journal, results and
//! plans of a job need a few hundred kilobytes; a job that is begun on a disk without them ends in the
//! middle, with the arm somewhere. Pictures in job folders stop earlier than jobs do.

use std::path::{Path, PathBuf};

/// Below this no job is begun.
const JOBS_NEED: u64 = 32 << 20;

/// Below this job folders get no pictures.
const PICTURES_NEED: u64 = 256 << 20;

/// The disk of a folder.
#[derive(Clone, Debug)]
pub struct Disk {
    folder: PathBuf,
    /// Below this no job is begun, bytes.
    pub(super) jobs_need: u64,
}

impl Disk {
    /// The disk of this folder.
    pub fn of(folder: &Path) -> Disk {
        Disk { folder: folder.to_path_buf(), jobs_need: JOBS_NEED }
    }

    /// What is left, where it is too little for a job; `None` also where the system does not say: a commit
    /// finds out.
    pub fn low(&self) -> Option<String> {
        let free = cell_edge::files::free_bytes(&self.folder).ok()?;
        too_little(free, self.jobs_need, &self.folder)
    }

    /// There is room for pictures too.
    pub fn takes_pictures(&self) -> bool {
        cell_edge::files::free_bytes(&self.folder).is_ok_and(|free| free >= PICTURES_NEED)
    }
}

fn too_little(free: u64, needed: u64, folder: &Path) -> Option<String> {
    (free < needed).then(|| {
        let (left, folder) = (free as f64 / f64::from(1 << 20), folder.display());
        format!("{left:.1} MB are left on the disk of {folder}, {} MB are needed", needed >> 20)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_nearly_full_disk_is_named_with_what_is_needed() {
        assert_eq!(too_little(JOBS_NEED, JOBS_NEED, Path::new("/var")), None);
        let low = too_little(1 << 19, JOBS_NEED, Path::new("/var/lib/celld")).expect("too little");
        assert_eq!(low, "0.5 MB are left on the disk of /var/lib/celld, 32 MB are needed");
        let folder = tempfile::tempdir().expect("a folder");
        assert_eq!(Disk::of(&folder.path().join("absent")).low(), None);
    }
}
