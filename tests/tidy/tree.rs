//! The repository's files as the tidy test reads them.
//!
//! In: the package folder. Out: paths (relative, `/` between parts) and texts, sorted, without build output.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// One text file, path relative to the package folder.
#[derive(Debug, Clone)]
pub struct File {
    pub path: String,
    pub text: String,
}

impl File {
    /// A file of a test's own making.
    pub fn planted(path: &str, text: &str) -> File {
        File { path: path.to_string(), text: text.to_string() }
    }
}

const TEXT_ENDINGS: &[&str] = &[
    "rs", "md", "toml", "yaml", "yml", "json", "script", "sh", "service", "txt", "html", "css", "js", "sql",
    "hex",
];
const TEXT_NAMES: &[&str] = &["Makefile", "run", "tree", ".gitignore"];
/// Build output, run output, and what other tools keep in the folder.
const SKIPPED: &[&str] = &["target", ".git", "state", "out", "proptest-regressions"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The text of one file that has to be there.
pub fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Every text file of the repository.
pub fn text_files() -> Vec<File> {
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> = vec![root().to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("readable folder").map(|entry| entry.expect("entry")) {
            let name = entry.file_name().to_string_lossy().into_owned();
            let path = entry.path();
            // Only the folders at the top are build output; a `src/out` would be ours.
            if path.is_dir() {
                if !(folder == root() && SKIPPED.contains(&name.as_str())) {
                    folders.push(path);
                }
            } else if is_text(&name) {
                let relative =
                    path.strip_prefix(root()).expect("below the root").to_string_lossy().replace('\\', "/");
                let text =
                    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{relative}: {error}"));
                found.push(File { path: relative, text });
            }
        }
    }
    found.sort_by(|a, b| a.path.cmp(&b.path));
    assert!(found.len() > 20, "the walk of {} found only {} files", root().display(), found.len());
    found
}

fn is_text(name: &str) -> bool {
    TEXT_NAMES.contains(&name)
        || name.rsplit_once('.').is_some_and(|(_, ending)| TEXT_ENDINGS.contains(&ending))
}

/// Every Rust file: sources, tests, benches.
pub fn rust_files() -> Vec<File> {
    text_files().into_iter().filter(|file| file.path.ends_with(".rs")).collect()
}

/// The Rust files below `src`, and below the `src` of each crate.
pub fn sources() -> Vec<File> {
    rust_files().into_iter().filter(|file| crate_folder(&file.path).is_some()).collect()
}

/// The same files crate by crate, with paths from the crate's own folder.
pub fn by_crate(sources: &[File]) -> Vec<Vec<File>> {
    let mut crates: BTreeMap<&str, Vec<File>> = BTreeMap::new();
    for file in sources {
        if let Some(folder) = crate_folder(&file.path) {
            let inside = File { path: file.path[folder.len()..].to_string(), text: file.text.clone() };
            crates.entry(folder).or_default().push(inside);
        }
    }
    crates.into_values().collect()
}

/// The folder of the crate whose source a file is, with a slash behind it; empty for celld itself.
fn crate_folder(path: &str) -> Option<&str> {
    if path.starts_with("src/") {
        return Some("");
    }
    let name = path.strip_prefix("crates/")?.split('/').next()?;
    let folder = &path[.."crates/".len() + name.len() + 1];
    path[folder.len()..].starts_with("src/").then_some(folder)
}

/// The manifests of the workspace and its crates.
pub fn manifests() -> Vec<File> {
    let of_workspace = |path: &str| path == "Cargo.toml" || path.starts_with("crates/");
    let files = text_files().into_iter();
    files.filter(|file| of_workspace(&file.path) && file.path.ends_with("Cargo.toml")).collect()
}
