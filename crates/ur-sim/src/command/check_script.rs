//! `celld sim --check-script FILE...`: does a controller load these programs?
//!
//! In: URScript files, or `-` for standard input. Out: for each one a line with the program's name on
//! standard output, or on standard error what is wrong with it: place, sentence, the line itself and a
//! caret. Exit code 2 if any of them is wrong.

use crate::controller::builtins::compile_program;
use cell_edge::terminal::{LARGEST_FILE_BYTES, complain, print, read_text};
use std::io::Read;
use std::path::{Path, PathBuf};
use urscript::code::Code;
use urscript::fault::CompileError;

/// Checks all of them; the exit code.
pub fn check_scripts(paths: &[PathBuf]) -> u8 {
    let mut code = 0;
    for path in paths {
        let text = if path == Path::new("-") { standard_input() } else { read_text(path) };
        match text.and_then(|text| report(&path.display().to_string(), &text)) {
            Ok(line) => print(&line),
            Err(complaint) => {
                complain(&complaint);
                code = 2;
            }
        }
    }
    code
}

fn standard_input() -> Result<String, String> {
    let mut text = String::new();
    let read = std::io::stdin().lock().take(LARGEST_FILE_BYTES + 1).read_to_string(&mut text);
    read.map_err(|error| format!("-: cannot be read: {error}"))?;
    if text.len() as u64 > LARGEST_FILE_BYTES {
        return Err(format!("-: larger than {LARGEST_FILE_BYTES} bytes"));
    }
    Ok(text)
}

/// The line for a good program, the complaint about a bad one.
fn report(source: &str, text: &str) -> Result<String, String> {
    program_in(source, text).map(|code| format!("{source}: ok, program {}\n", code.name))
}

/// The program in a text that came from `source`.
///
/// # Errors
/// The complaint about a bad one: place, sentence, the line itself and a caret.
pub fn program_in(source: &str, text: &str) -> Result<Code, String> {
    compile_program(text).map_err(|error| complaint(source, text, &error))
}

fn complaint(source: &str, text: &str, error: &CompileError) -> String {
    let line = text.lines().nth(error.at.line.saturating_sub(1) as usize).unwrap_or_default();
    let before = line.chars().take(error.at.column.saturating_sub(1) as usize);
    // Tabs stay tabs, so that the caret is under its character whatever their width.
    let margin: String = before.map(|c| if c == '\t' { '\t' } else { ' ' }).collect();
    format!("{source}:{}:{}: {}\n  {line}\n  {margin}^", error.at.line, error.at.column, error.kind)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_good_program_is_named() {
        assert_eq!(
            report("a.script", "def tidy():\n sync()\nend\n").unwrap(),
            "a.script: ok, program tidy\n"
        );
    }

    #[test]
    fn a_bad_one_is_reported_with_its_place() {
        let text = "def tidy():\n\tx = nowhere(1)\nend\n";
        let expected = "a.script:2:6: name not found: nowhere\n  \tx = nowhere(1)\n  \t    ^";
        assert_eq!(report("a.script", text).unwrap_err(), expected);
        let unfinished = report("-", "def f():\n  if True:\n").unwrap_err();
        assert!(unfinished.starts_with("-:") && unfinished.ends_with('^'), "{unfinished}");
    }

    #[test]
    fn every_bad_file_counts() {
        let folder = tempfile::tempdir().unwrap();
        let [good, bad] = ["good.script", "bad.script"].map(|name| folder.path().join(name));
        std::fs::write(&good, "def a():\nend\n").unwrap();
        std::fs::write(&bad, "def a(:\n").unwrap();
        assert_eq!(check_scripts(std::slice::from_ref(&good)), 0);
        assert_eq!(check_scripts(&[bad, good]), 2);
        assert_eq!(check_scripts(&[folder.path().join("none.script")]), 2);
    }
}
