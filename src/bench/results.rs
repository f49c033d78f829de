//! The file a benchmark writes its rows to, one line at a time, so that an interrupted run can go on.
//!
//! In: a path; rows. Out: the rows that were there, and a file that always begins with the head and grows by
//! whole lines. A last line without its end (the run was killed while writing, the disk was full) is cut off
//! and its case run again. One process at a time: the file itself is locked.

use crate::bench::table::{CSV_HEADER, Row, Table};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// A results file that is open for more rows.
#[derive(Debug)]
pub struct ResultsFile {
    path: PathBuf,
    file: File,
}

/// What was in the file.
#[derive(Debug, Default)]
pub struct Found {
    /// Rows of earlier runs.
    pub table: Table,
    /// A half-written last line was cut off.
    pub cut: bool,
}

impl ResultsFile {
    /// Opens or creates the file, with the folders above it, and reads what is there.
    ///
    /// # Errors
    /// What is wrong with the file, with path and line, and what to do.
    pub fn open(path: &Path) -> Result<(ResultsFile, Found), String> {
        let fault = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(|error| fault(&error))?;
        }
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(|error| fault(&error))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(fault(&"another run writes to it; give every run a file of its own"));
            }
            Err(TryLockError::Error(error)) => return Err(fault(&error)),
        }
        let mut text = String::new();
        file.read_to_string(&mut text).map_err(|error| fault(&error))?;
        let (whole, rest) = text.split_at(text.rfind('\n').map_or(0, |end| end + 1));
        if whole.is_empty() && !CSV_HEADER.starts_with(rest) {
            return Err(format!("{}:1: not a table of this benchmark; name another file", path.display()));
        }
        let mut found = Found { table: Table::default(), cut: !rest.is_empty() };
        if !whole.is_empty() {
            found.table.read(whole, &path.display().to_string())?;
        }
        let mut results = ResultsFile { path: path.to_path_buf(), file };
        let end = whole.len() as u64;
        results
            .file
            .set_len(end)
            .and_then(|()| results.file.seek(SeekFrom::End(0)))
            .map_err(|e| fault(&e))?;
        if whole.is_empty() {
            results.line(CSV_HEADER)?;
        }
        Ok((results, found))
    }

    /// Adds a row.
    ///
    /// # Errors
    /// Why it cannot be written.
    pub fn add(&mut self, row: &Row) -> Result<(), String> {
        self.line(&row.csv())
    }

    /// In one write: a kill leaves a whole line or a beginning of one.
    fn line(&mut self, text: &str) -> Result<(), String> {
        self.file
            .write_all(format!("{text}\n").as_bytes())
            .map_err(|error| format!("{}: cannot be written: {error}", self.path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::table::tests::row;

    fn text(path: &Path) -> String {
        std::fs::read_to_string(path).unwrap()
    }

    #[test]
    fn a_half_written_line_is_cut_off_and_the_rest_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/rows.csv");
        let (mut file, found) = ResultsFile::open(&path).unwrap();
        assert!(found.table.rows.is_empty() && !found.cut);
        file.add(&row("1", Some(24.0))).unwrap();
        drop(file);
        let one = text(&path);
        let second = row("2", None).csv();
        std::fs::write(&path, format!("{one}{}", &second[..second.len() / 2])).unwrap();
        let (mut file, found) = ResultsFile::open(&path).unwrap();
        assert!(found.cut && found.table.has(&row("1", None).key) && found.table.rows.len() == 1);
        assert_eq!(text(&path), one);
        file.add(&row("2", None)).unwrap();
        assert_eq!(text(&path), format!("{one}{second}\n"));
    }

    #[test]
    fn a_line_that_lacks_its_end_alone_is_run_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.csv");
        // Without its end it is unknown whether 1.000000 would have gone on.
        std::fs::write(&path, format!("{CSV_HEADER}\n{}", row("1", None).csv())).unwrap();
        let (_, found) = ResultsFile::open(&path).unwrap();
        assert!(found.cut && found.table.rows.is_empty());
    }

    #[test]
    fn a_half_written_head_is_written_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.csv");
        std::fs::write(&path, &CSV_HEADER[..20]).unwrap();
        let (_, found) = ResultsFile::open(&path).unwrap();
        assert!(found.cut);
        assert_eq!(text(&path), format!("{CSV_HEADER}\n"));
    }

    #[test]
    fn foreign_files_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("thesis.txt");
        for foreign in ["once upon a time", "once upon a time\nthere was\n"] {
            std::fs::write(&path, foreign).unwrap();
            let fault = ResultsFile::open(&path).unwrap_err();
            assert!(fault.contains("thesis.txt:1: not a table"), "{fault}");
            assert_eq!(text(&path), foreign);
        }
        std::fs::write(&path, format!("{CSV_HEADER}\nrand,?\n")).unwrap();
        assert!(ResultsFile::open(&path).unwrap_err().contains("thesis.txt:2:"));
    }

    #[test]
    fn two_runs_cannot_share_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("rows.csv");
        let first = ResultsFile::open(&path).unwrap();
        assert!(ResultsFile::open(&path).unwrap_err().contains("another run"));
        drop(first);
        assert!(ResultsFile::open(&path).is_ok());
    }
}
