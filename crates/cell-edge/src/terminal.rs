//! What every command does at the terminal: print, complain, read a file that was named.
//!
//! In: text, paths. Out: text on standard output and standard error, or one line that says why a file cannot
//! be read or a value cannot be used.

use crate::files::read_named;
use std::borrow::Cow;
use std::io::{IsTerminal, Write};
use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::mpsc::channel;
use std::time::Duration;

/// Larger files are nothing that a command reads; they would only fill the memory.
pub const LARGEST_FILE_BYTES: u64 = 32 << 20;

/// The text of a plain file of reasonable size.
///
/// # Errors
/// One line with the path and what to do.
pub fn read_text(path: &Path) -> Result<String, String> {
    read_named(path, LARGEST_FILE_BYTES)
        .map_err(|error| format!("{}: cannot be read: {}", path.display(), error.reason()))
}

/// Writes results to standard output, to a terminal without what it would obey. A reader that has gone
/// away is no error of ours.
pub fn print(text: &str) {
    let _ = prints(text);
}

/// The same; false when there is no reader any more, for whoever would go on for ever.
pub fn prints(text: &str) -> bool {
    let mut out = std::io::stdout().lock();
    let text = if out.is_terminal() { harmless(text) } else { Cow::Borrowed(text) };
    out.write_all(text.as_bytes()).and_then(|()| out.flush()).is_ok()
}

/// Writes complaints and progress to standard error, without what a terminal would obey.
pub fn complain(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{}", harmless(text));
}

/// The same for a process that must end whatever the terminal does: one that takes nothing is left alone
/// after `limit`.
pub fn complain_within(text: &str, limit: Duration) {
    let (done, written) = channel();
    let text = text.to_owned();
    // The thread ends with the process.
    std::thread::spawn(move || {
        complain(&text);
        let _ = done.send(());
    });
    let _ = written.recv_timeout(limit);
}

/// A path as a word of a command that a person may copy into a shell.
pub fn in_shell(path: &Path) -> String {
    let text = path.display().to_string();
    // Only a zero byte has no quotation, and no path has one.
    shlex::try_quote(&text).map_or(text.clone(), Cow::into_owned)
}

/// Characters that change in which direction a terminal writes (Unicode Standard Annex 9): with them a line
/// reads otherwise than it is.
const DIRECTIONS: [RangeInclusive<char>; 4] =
    ['\u{61c}'..='\u{61c}', '\u{200e}'..='\u{200f}', '\u{202a}'..='\u{202e}', '\u{2066}'..='\u{2069}'];

/// The text with its control characters escaped, line ends and tabs apart, and what changes the direction of
/// writing: names of files and words from them may hold any.
fn harmless(text: &str) -> Cow<'_, str> {
    let obeyed = |c: char| {
        let controls = c.is_control() && c != '\n' && c != '\t';
        controls || DIRECTIONS.iter().any(|range| range.contains(&c))
    };
    if !text.contains(obeyed) {
        return Cow::Borrowed(text);
    }
    let escaped = |c: char| if obeyed(c) { c.escape_default().to_string() } else { c.to_string() };
    Cow::Owned(text.chars().map(escaped).collect())
}

/// A number in a range; `unit` is for the message.
///
/// # Errors
/// One sentence that says what to give.
pub fn within(text: &str, range: RangeInclusive<f64>, unit: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if range.contains(&value) => Ok(value),
        _ => Err(format!("give a number between {} and {} {unit}", range.start(), range.end())),
    }
}

#[cfg(test)]
mod tests {
    use super::{harmless, in_shell};
    use std::path::Path;

    #[test]
    fn a_path_is_one_word_of_a_command() {
        let word = |path: &str| in_shell(Path::new(path));
        assert_eq!(word("/var/lib/celld"), "/var/lib/celld");
        for path in ["my cell/state", "it's", "$HOME", "a;b", "`id`", ""] {
            assert_eq!(shlex::split(&word(path)), Some(vec![path.to_string()]), "{path}");
        }
    }

    #[test]
    fn a_terminal_gets_nothing_to_obey() {
        assert_eq!(harmless("two\n\tlines, ö"), "two\n\tlines, ö");
        assert_eq!(harmless("a\x1b[2J\u{9b}b\r"), "a\\u{1b}[2J\\u{9b}b\\r");
        assert_eq!(harmless("lid\u{202e}gnp.1\u{2066}"), "lid\\u{202e}gnp.1\\u{2066}");
        assert_eq!(
            harmless("\u{5d0}\u{200d}\u{2013}"),
            "\u{5d0}\u{200d}\u{2013}",
            "letters of all scripts stay"
        );
    }
}
