//! The configuration of a simulated cell from files: the only place here that opens any.
//!
//! In: a path. Out: the checked configuration with the programs of the folder that it names, or a message
//! for the terminal.

use crate::config::SimFile;
use crate::config::read::read_sim;
use crate::controller::program_files::{ProgramFiles, ProgramSource};
use cell_parts::file::{ConfigError, open, read_text};
use std::path::Path;

/// Most files of a folder of programs that are looked at.
const MAX_PROGRAMS: usize = 1000;

/// Reads the configuration of a simulated cell.
///
/// # Errors
/// The file, its folder of programs or a script there cannot be read ([`ConfigError::Unreadable`]), or the
/// file's content is wrong ([`ConfigError::Wrong`]).
pub fn load_sim(path: &Path) -> Result<SimFile, ConfigError> {
    let (text, folder) = open(path)?;
    let mut file = read_sim(&text, &path.display().to_string()).map_err(ConfigError::Wrong)?;
    if let Some(programs) = &file.program_folder {
        add_scripts(&mut file.programs, &folder.join(programs))?;
    }
    Ok(file)
}

/// Adds the scripts in a folder, each as the `.urp` file that a controller has beside it. A file that the
/// configuration describes is that one.
fn add_scripts(files: &mut ProgramFiles, folder: &Path) -> Result<(), ConfigError> {
    let unreadable = |path: &Path, reason| ConfigError::Unreadable { path: path.to_owned(), reason };
    let entries = std::fs::read_dir(folder).map_err(|error| unreadable(folder, error.to_string()))?;
    for entry in entries.take(MAX_PROGRAMS) {
        let path = entry.map_err(|error| unreadable(folder, error.to_string()))?.path();
        let is_script = path.extension().is_some_and(|ending| ending == "script");
        if let Some(name) = path.file_stem().and_then(|name| name.to_str()).filter(|_| is_script) {
            let text = read_text(&path).map_err(|reason| unreadable(&path, reason))?;
            let file = format!("{name}.urp");
            if files.find(&file).is_none() {
                files.add(&file, ProgramSource::Script(text));
            }
        }
    }
    Ok(())
}
