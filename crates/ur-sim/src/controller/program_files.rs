//! The files of programs that `load` finds, as the controller names them, and what is in each.
//!
//! In: paths and sources from the configuration, read before the start. Out: the file that a name means. A
//! bare name is one in the controller's folder of programs, a path from the root is itself, as on the
//! controller. A file holds a script, or is a program whose only node is the External Control URCap's: its
//! script comes from a PC whenever it is played. Pure.

use std::collections::BTreeMap;

/// Where a controller keeps its programs unless the configuration names another place.
const USUAL_FOLDER: &str = "/programs/";

/// Port at which a PC hands out its script (the URCap's default).
pub const SCRIPT_PORT: u16 = 50_002;

/// What plays when a program does.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ProgramSource {
    /// URScript.
    Script(String),
    /// Whatever the PC at this address hands out.
    ExternalControl {
        /// Name or address of the PC.
        host: String,
        /// Its port.
        port: u16,
    },
}

/// All files of programs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProgramFiles {
    folder: String,
    files: BTreeMap<String, ProgramSource>,
}

impl Default for ProgramFiles {
    fn default() -> ProgramFiles {
        ProgramFiles { folder: USUAL_FOLDER.to_owned(), files: BTreeMap::new() }
    }
}

impl ProgramFiles {
    /// No files in this folder, which is a path from the root.
    pub fn in_folder(folder: &str) -> ProgramFiles {
        let folder = format!("{}/", folder.trim_end_matches('/'));
        ProgramFiles { folder, files: BTreeMap::new() }
    }

    /// The folder of programs, with a `/` at its end.
    pub fn folder(&self) -> &str {
        &self.folder
    }

    /// Adds a file; false if it is there already.
    pub fn add(&mut self, name: &str, source: ProgramSource) -> bool {
        self.files.insert(self.path(name), source).is_none()
    }

    /// Path and content of the file that `name` means.
    pub fn find(&self, name: &str) -> Option<(&str, &ProgramSource)> {
        self.files.get_key_value(&self.path(name)).map(|(path, source)| (&**path, source))
    }

    /// All paths with their content.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &ProgramSource)> {
        self.files.iter().map(|(path, source)| (&**path, source))
    }

    fn path(&self, name: &str) -> String {
        if name.starts_with('/') { name.to_owned() } else { format!("{}{name}", self.folder) }
    }
}

/// A path without its folders.
pub fn bare_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bare_names_are_in_the_folder_and_paths_are_themselves() {
        let script = |text: &str| ProgramSource::Script(text.to_owned());
        let mut files = ProgramFiles::in_folder("/ursim/programs");
        assert!(files.add("a.urp", script("a")) && files.add("/usb/a.urp", script("b")));
        assert!(!files.add("/ursim/programs/a.urp", script("c")), "the same file");
        assert_eq!(files.find("a.urp"), Some(("/ursim/programs/a.urp", &script("c"))));
        assert_eq!(files.find("/usb/a.urp"), Some(("/usb/a.urp", &script("b"))));
        assert_eq!(files.find("/programs/a.urp"), None);
        assert_eq!((bare_name("/usb/a.urp"), bare_name("a.urp")), ("a.urp", "a.urp"));
    }
}
