//! Texts of the page in languages that are not built in, from files.
//!
//! In: one JSON file a language, named by its code (`fr.json`): `language`, how its speakers call it, and
//! the texts by their English. Out: what browsers are given. A text that is missing is shown in English; a
//! key that is no text of the page is a fault of the file, because it would never be seen.

use crate::page::assets::known_texts;
use axum::body::Bytes;
use cell_edge::files::read_named;
use rearrange::document::chain::chain;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Largest file.
const BYTES_MAX: u64 = 256 * 1024;

/// Codes of the languages that are built in, with their own names.
const BUILT_IN: [(&str, &str); 2] = [("en", "English"), ("de", "Deutsch")];

/// The key of the language's own name.
const LANGUAGE: &str = "language";

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Texts {
    files: BTreeMap<String, Bytes>,
    names: BTreeMap<String, String>,
}

impl Texts {
    /// Reads the files of the configuration.
    ///
    /// # Errors
    /// Which file, and what is wrong with it.
    pub fn read(paths: &[PathBuf]) -> Result<Texts, (String, String)> {
        let mut texts = Texts::default();
        for path in paths {
            let fault = |reason: String| (path.display().to_string(), reason);
            let code = code_of(path).map_err(fault)?;
            let text = read_named(path, BYTES_MAX).map_err(|error| fault(chain(&error)))?;
            let name = name_of(&text).map_err(fault)?;
            texts.names.insert(code.clone(), name);
            texts.files.insert(code, text.into());
        }
        Ok(texts)
    }

    /// The file `text-CODE.json`, or `texts.json`: all languages by their codes.
    pub fn file(&self, path: &str) -> Option<Bytes> {
        if path == "texts.json" {
            let built_in = BUILT_IN.map(|(code, name)| (code.to_string(), name.to_string()));
            let all: BTreeMap<String, String> = self.names.clone().into_iter().chain(built_in).collect();
            return Some(json!(all).to_string().into());
        }
        self.files.get(path.strip_prefix("text-")?.strip_suffix(".json")?).cloned()
    }
}

fn code_of(path: &Path) -> Result<String, String> {
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let letters = (2..=3).contains(&stem.len()) && stem.chars().all(|c| c.is_ascii_lowercase());
    if !letters || path.extension().is_none_or(|end| end != "json") {
        return Err("the file is called by the code of its language, such as fr.json".to_string());
    }
    match BUILT_IN.iter().any(|(code, _)| *code == stem) {
        true => Err(format!("{stem} is built in")),
        false => Ok(stem),
    }
}

/// The language's own name, of a file that is sound.
fn name_of(text: &str) -> Result<String, String> {
    let table: BTreeMap<String, String> =
        serde_json::from_str(text).map_err(|error| format!("it is no table of texts: {error}"))?;
    let known = known_texts();
    let holes = |text: &str| {
        let mut names: Vec<&str> =
            text.split('{').skip(1).filter_map(|rest| rest.split_once('}')).map(|(name, _)| name).collect();
        names.sort_unstable();
        names.join(", ")
    };
    for (english, translated) in table.iter().filter(|(english, _)| *english != LANGUAGE) {
        if !known.contains(english) {
            return Err(format!("{english:?} is no text of the page"));
        }
        if holes(english) != holes(translated) {
            return Err(format!("{english:?}: what is filled in differs: {{{}}}", holes(translated)));
        }
    }
    let name = table.get(LANGUAGE).filter(|name| !name.trim().is_empty());
    name.cloned().ok_or_else(|| format!("{LANGUAGE:?} is missing: how its speakers call it"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_a_language_and_its_faults_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let read = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            Texts::read(&[path]).map_err(|(_, reason)| reason)
        };
        let french = r#"{"language": "Français", "Stop": "Arrêt", "Job {job}": "Tâche {job}"}"#;
        let texts = read("fr.json", french).unwrap();
        assert_eq!(texts.file("text-fr.json").as_deref(), Some(french.as_bytes()));
        let all = String::from_utf8(texts.file("texts.json").unwrap().to_vec()).unwrap();
        assert_eq!(all, r#"{"de":"Deutsch","en":"English","fr":"Français"}"#);
        assert!(texts.file("text-de.json").is_none() && texts.file("fr.json").is_none());
        for (name, text, wanted) in [
            ("fr.json", r#"{"language": "x", "Stopp": "y"}"#, "no text of the page"),
            ("fr.json", r#"{"language": "x", "Job {job}": "y {id}"}"#, "filled in differs"),
            ("fr.json", r#"{"Stop": "Arrêt"}"#, "is missing"),
            ("fr.json", "[]", "no table"),
            ("de.json", french, "built in"),
            ("French.json", french, "code of its language"),
        ] {
            let reason = read(name, text).unwrap_err();
            assert!(reason.contains(wanted), "{text}: {reason}");
        }
    }
}
