//! Configuration from files: the only place here that opens any.
//!
//! In: a path. Out: the checked configuration, or a message for the terminal. Paths inside a file are
//! relative to its own folder, so that a configuration works from wherever celld is started.

use crate::config::cell::CellConfig;
use crate::config::read_cell::read_cell;
use crate::config::read_sim::read_sim;
use crate::config::simulated::SimFile;
use crate::document::Complaints;
use crate::io::files::read_named;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Largest file that is read, bytes.
const MAX_BYTES: u64 = 16 << 20;

/// Most files of a folder of programs that are looked at.
const MAX_PROGRAMS: usize = 1000;

/// Why there is no configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("{path}: {reason}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// The file is wrong; one line for each complaint.
    #[error("{0}")]
    Wrong(Complaints),
}

/// Reads the configuration of a cell.
pub fn load_cell(path: &Path) -> Result<CellConfig, ConfigError> {
    let (text, folder) = open(path)?;
    let source = path.display().to_string();
    read_cell(&text, &source, &folder, &|file| read_text(file)).map_err(ConfigError::Wrong)
}

/// Reads the configuration of a simulated cell.
pub fn load_sim(path: &Path) -> Result<SimFile, ConfigError> {
    let (text, folder) = open(path)?;
    let mut file = read_sim(&text, &path.display().to_string()).map_err(ConfigError::Wrong)?;
    if let Some(programs) = &file.program_folder {
        file.programs = read_programs(&folder.join(programs))?;
    }
    Ok(file)
}

/// The scripts in a folder, by name without `.script`.
fn read_programs(folder: &Path) -> Result<BTreeMap<String, String>, ConfigError> {
    let unreadable = |path: &Path, reason| ConfigError::Unreadable { path: path.to_owned(), reason };
    let entries = std::fs::read_dir(folder).map_err(|error| unreadable(folder, error.to_string()))?;
    let mut programs = BTreeMap::new();
    for entry in entries.take(MAX_PROGRAMS) {
        let path = entry.map_err(|error| unreadable(folder, error.to_string()))?.path();
        let is_script = path.extension().is_some_and(|ending| ending == "script");
        if let Some(name) = path.file_stem().and_then(|name| name.to_str()).filter(|_| is_script) {
            let text = read_text(&path).map_err(|reason| unreadable(&path, reason))?;
            programs.insert(name.to_owned(), text);
        }
    }
    Ok(programs)
}

fn open(path: &Path) -> Result<(String, PathBuf), ConfigError> {
    let unreadable = |reason| ConfigError::Unreadable { path: path.to_owned(), reason };
    let text = read_text(path).map_err(unreadable)?;
    let absolute = std::path::absolute(path).map_err(|error| unreadable(error.to_string()))?;
    Ok((text, absolute.parent().unwrap_or(Path::new("/")).to_owned()))
}

/// Text of a plain file of reasonable size (links are followed); why not, in words.
pub fn read_text(path: &Path) -> Result<String, String> {
    read_named(path, MAX_BYTES).map_err(|error| error.reason())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::edit::replace_once;

    #[test]
    fn programs_are_the_scripts_of_the_folder_beside_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("sim.yaml");
        let sim = include_str!("../../config/sim.yaml");
        let text = replace_once(sim, "\nprograms: {}", "\nprograms: {folder: mine}");
        std::fs::write(&config, text).unwrap();
        let told = load_sim(&config).unwrap_err().to_string();
        assert!(told.contains("mine") && told.contains("No such file"), "{told}");
        std::fs::create_dir(folder.path().join("mine")).unwrap();
        std::fs::write(folder.path().join("mine/pick.script"), "def pick():\nend\n").unwrap();
        std::fs::write(folder.path().join("mine/pick.urp"), [0x1f, 0x8b]).unwrap();
        let programs = load_sim(&config).unwrap().programs;
        assert_eq!(programs.into_iter().collect::<Vec<_>>(), [("pick".into(), "def pick():\nend\n".into())]);
    }
}
