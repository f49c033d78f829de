//! What every command does at the terminal: print, complain, read a file that was named, keep a log.
//!
//! In: text, paths. Out: text on standard output and standard error, or one line that says why a file cannot
//! be read or a value cannot be used.

use crate::files::read_named;
use std::borrow::Cow;
use std::io::{IsTerminal, Write};
use std::ops::RangeInclusive;
use std::path::Path;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

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

/// systemd's journal, with what a line is about as fields of their own (`JOB`, `STEP`, `UID`); `None` where
/// there is no journal.
fn journal() -> Option<tracing_journald::Layer> {
    tracing_journald::layer().ok().map(|layer| layer.with_field_prefix(None))
}

/// True where standard error goes into the journal: systemd names device and inode of the stream
/// (`systemd.exec(5)`, `JOURNAL_STREAM`).
fn stderr_is_journal() -> bool {
    let stream = std::env::var("JOURNAL_STREAM").unwrap_or_default();
    rustix::fs::fstat(std::io::stderr()).is_ok_and(|stat| names(&stream, stat.st_dev, stat.st_ino))
}

/// `stream` is this device and inode.
fn names(stream: &str, device: u64, inode: u64) -> bool {
    stream.split_once(':').is_some_and(|(d, i)| d.parse() == Ok(device) && i.parse() == Ok(inode))
}

/// Logs go to stderr, each line with its date, or into systemd's journal where stderr does; `CELLD_LOG`
/// chooses what (`warn`, `celld::daemon=debug`, ...)
/// in place of `usual`. A `CELLD_LOG` that cannot be read counts as none, and that is reported.
pub fn start_log(usual: &str) {
    let wanted = std::env::var("CELLD_LOG").ok().filter(|wanted| !wanted.is_empty());
    let read = wanted.as_deref().map(tracing_subscriber::EnvFilter::try_new);
    let (filter, fault) = match read {
        Some(Ok(filter)) => (filter, None),
        Some(Err(error)) => (tracing_subscriber::EnvFilter::new(usual), Some(error)),
        None => (tracing_subscriber::EnvFilter::new(usual), None),
    };
    let log = tracing_subscriber::registry().with(filter);
    match journal().filter(|_| stderr_is_journal()) {
        Some(journal) => log.with(journal).init(),
        None => {
            // A file gets no colours.
            let ansi = std::io::stderr().is_terminal();
            let lines = tracing_subscriber::fmt::layer().with_target(false).with_ansi(ansi);
            log.with(lines.with_writer(std::io::stderr)).init();
        }
    }
    if let Some(error) = fault {
        complain(&format!("CELLD_LOG cannot be read ({error}); logging {usual}"));
    }
}

#[cfg(test)]
mod tests {
    use super::{harmless, in_shell, names};
    use std::path::Path;

    #[test]
    fn the_journal_s_stream_is_known_by_device_and_inode() {
        assert!(names("9:4711", 9, 4711));
        for other in ["", "9", "9:4712", "8:4711", "9:4711:1", "x:y"] {
            assert!(!names(other, 9, 4711), "{other}");
        }
    }

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
