//! A file of a job from the server's object store into a person's folder.
//!
//! In: the names that a cell answered with. Out: files of those names, whole or not at all. What comes over
//! the network names no path. The server's client checks the hash of what it reads.

use crate::client::{Client, text};
use crate::files::{CHUNK, FILE_BYTES_MAX, is_file_name, object_name};
use crate::subjects::is_job_id;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::io::AsyncReadExt;
use tokio::time::timeout;

/// A file that does not come on for so long is given up.
const SILENT: Duration = Duration::from_secs(20);

impl Client {
    /// Reads a file that a cell has put into the store, into a folder.
    ///
    /// # Errors
    /// A name that is a path, what the server says, what the disk says. Nothing half is left, nor where the
    /// call is dropped.
    pub async fn fetch(&self, cell: &str, job: &str, name: &str, folder: &Path) -> Result<PathBuf, String> {
        if !is_file_name(name) || !is_job_id(job) {
            return Err(format!("{name:?} is no name of a file; the answer is not of this version of celld"));
        }
        let store = self.server.context.get_object_store(self.fleet.files_bucket()).await.map_err(text)?;
        let mut object = store.get(object_name(cell, job, name)).await.map_err(text)?;
        let path = folder.join(name);
        let half = Half(folder.join(format!(".{name}.part")));
        let fault = |error: std::io::Error| format!("{}: {error}", path.display());
        let mut file = File::create(&half.0).map_err(fault)?;
        let read = async {
            let (mut bytes, mut left) = (vec![0; CHUNK], FILE_BYTES_MAX);
            loop {
                let count = timeout(SILENT, object.read(&mut bytes)).await;
                let count = count.map_err(|_| "the server does not go on".to_string())?.map_err(text)?;
                if count == 0 {
                    return file.sync_all().map_err(text);
                }
                left = left.checked_sub(count as u64).ok_or("it is larger than any file of a job")?;
                file.write_all(bytes.get(..count).unwrap_or_default()).map_err(text)?;
            }
        };
        let done = read.await.and_then(|()| std::fs::rename(&half.0, &path).map_err(text));
        done.map(|()| path).map_err(|message| format!("{name}: {message}"))
    }
}

/// A file that is not whole yet. What is left of it is of no use, also where the reading is given up.
struct Half(PathBuf);

impl Drop for Half {
    fn drop(&mut self) {
        // It has its own name by now, or never had this one.
        let _ = std::fs::remove_file(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_a_file_is_not_left_and_a_whole_one_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(".run.mcap.part");
        std::fs::write(&path, "half").unwrap();
        drop(Half(path.clone()));
        assert!(!path.exists());
        std::fs::write(&path, "whole").unwrap();
        let half = Half(path);
        std::fs::rename(&half.0, folder.path().join("run.mcap")).unwrap();
        drop(half);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
