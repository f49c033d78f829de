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

/// A program of PolyScope X as a client has uploaded it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Urpx {
    /// The file.
    pub document: String,
    /// What its author says of it.
    pub description: String,
    /// When it was made, changed and saved: ms since 1970, 0 where the file does not say.
    pub dates: [u64; 3],
}

/// All files of programs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProgramFiles {
    folder: String,
    files: BTreeMap<String, ProgramSource>,
    uploaded: BTreeMap<String, Urpx>,
}

impl Default for ProgramFiles {
    fn default() -> ProgramFiles {
        ProgramFiles { folder: USUAL_FOLDER.to_owned(), files: BTreeMap::new(), uploaded: BTreeMap::new() }
    }
}

impl ProgramFiles {
    /// No files in this folder, which is a path from the root.
    pub fn in_folder(folder: &str) -> ProgramFiles {
        let folder = format!("{}/", folder.trim_end_matches('/'));
        ProgramFiles { folder, files: BTreeMap::new(), uploaded: BTreeMap::new() }
    }

    /// The folder of programs, with a `/` at its end.
    pub fn folder(&self) -> &str {
        &self.folder
    }

    /// Adds a file; false if it is there already.
    pub fn add(&mut self, name: &str, source: ProgramSource) -> bool {
        self.files.insert(self.path(name), source).is_none()
    }

    /// Adds a file unless one is there.
    pub fn add_if_absent(&mut self, name: &str, source: ProgramSource) {
        self.files.entry(self.path(name)).or_insert(source);
    }

    /// Path and content of the file that `name` means.
    pub fn find(&self, name: &str) -> Option<(&str, &ProgramSource)> {
        self.files.get_key_value(&self.path(name)).map(|(path, source)| (&**path, source))
    }

    /// All paths with their content.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &ProgramSource)> {
        self.files.iter().map(|(path, source)| (&**path, source))
    }

    /// Path and content of the program that PolyScope X calls `name`: without folders and ending.
    pub fn named(&self, name: &str) -> Option<(&str, &ProgramSource)> {
        self.iter().find(|(path, _)| program_name(path) == name)
    }

    /// Keeps an upload, in place of a program of that name.
    pub fn upload(&mut self, name: &str, source: ProgramSource, urpx: Urpx) {
        let there = self.named(name).map(|(path, _)| path.to_owned());
        let path = there.unwrap_or_else(|| format!("{}{name}.urpx", self.folder));
        self.files.insert(path.clone(), source);
        self.uploaded.insert(path, urpx);
    }

    /// The upload with this path, if it is one.
    pub fn uploaded(&self, path: &str) -> Option<&Urpx> {
        self.uploaded.get(path)
    }

    /// How many uploads are kept, and the bytes of all.
    pub fn uploads(&self) -> (usize, usize) {
        (self.uploaded.len(), self.uploaded.values().map(|urpx| urpx.document.len()).sum())
    }

    fn path(&self, name: &str) -> String {
        if name.starts_with('/') { name.to_owned() } else { format!("{}{name}", self.folder) }
    }
}

/// A path without its folders.
pub fn bare_name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// What PolyScope X calls the program of a file.
pub fn program_name(path: &str) -> &str {
    let file = bare_name(path);
    file.strip_suffix(".urpx").or_else(|| file.strip_suffix(".urp")).unwrap_or(file)
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

    #[test]
    fn an_upload_takes_the_place_of_the_program_with_its_name() {
        let script = |text: &str| ProgramSource::Script(text.to_owned());
        let urpx = |text: &str| Urpx { document: text.to_owned(), description: String::new(), dates: [0; 3] };
        let mut files = ProgramFiles::default();
        files.add("a.urp", script("a"));
        files.upload("a", script("b"), urpx("{}"));
        files.upload("c", script("c"), urpx("{ }"));
        assert_eq!(files.named("a"), Some(("/programs/a.urp", &script("b"))));
        assert_eq!(files.named("c"), Some(("/programs/c.urpx", &script("c"))));
        assert_eq!((files.named("a.urp"), files.uploads()), (None, (2, 5)));
    }
}
