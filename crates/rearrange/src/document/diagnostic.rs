//! What is wrong with a text, and where.
//!
//! In: places and words from the reader of the text. Out: complaints as one line each, `file:line:column`
//! first.

use std::fmt::{self, Write as _};

/// A place in a text; both count from 1, columns in characters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Location {
    /// Line.
    pub line: usize,
    /// Column.
    pub column: usize,
}

/// One thing that is wrong with a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// Name of the file (or whatever the caller named the text).
    pub source: String,
    /// Where in the text.
    pub at: Location,
    /// Where in the structure, `objects[2].start`; empty at the top.
    pub path: String,
    /// What is wrong.
    pub message: String,
    /// What to change; may be empty.
    pub help: String,
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}: ", OneLine(&self.source), self.at.line, self.at.column)?;
        if !self.path.is_empty() {
            write!(f, "{}: ", OneLine(&self.path))?;
        }
        OneLine(&self.message).fmt(f)?;
        if self.help.is_empty() { Ok(()) } else { write!(f, "; {}", OneLine(&self.help)) }
    }
}

/// A text from a file as one line that a terminal shows and does not obey: control characters, and those
/// that change the direction of what follows, are escaped.
struct OneLine<'a>(&'a str);

impl fmt::Display for OneLine<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let turns = |c: char| matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
        self.0.chars().try_for_each(|c| match c.is_control() || turns(c) {
            true => write!(f, "{}", c.escape_default()),
            false => f.write_char(c),
        })
    }
}

/// Everything that is wrong with a file, in the order of the text; one line each when displayed.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Diagnostics(pub Vec<Diagnostic>);

impl fmt::Display for Diagnostics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, complaint) in self.0.iter().enumerate() {
            let separator = if index > 0 { "\n" } else { "" };
            write!(f, "{separator}{complaint}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Diagnostics {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_file_holds_is_shown_and_not_obeyed() {
        let at = Location { line: 2, column: 1 };
        let text = |text: &str| text.to_string();
        let source = text("a\x1b[2J.yaml");
        let (path, message) = (text("b\x1b[31m\u{9b}"), text("\"x\ny\u{202e}\u{7}\" is unknown"));
        let complaint = Diagnostic { source, at, path, message, help: text("like ö") };
        assert_eq!(
            complaint.to_string(),
            r#"a\u{1b}[2J.yaml:2:1: b\u{1b}[31m\u{9b}: "x\ny\u{202e}\u{7}" is unknown; like ö"#
        );
    }
}
