//! A log that no caller waits for.
//!
//! In: events of `tracing` from any thread. Out: lines on standard error, each with its date, or entries in
//! systemd's journal where standard error goes there, with fields of their own (`JOB`, `STEP`, `UID`). A
//! bounded queue takes them, and a thread of its own writes them: a terminal that is held (Ctrl-S), a pipe
//! that nobody reads or a journal that hangs loses lines, which are counted, and holds nothing else up.

use crate::terminal::complain;
use std::fmt::{self, Write as _};
use std::io::{self, IsTerminal, Write};
use std::os::unix::net::UnixDatagram;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_appender::non_blocking::{ErrorCounter, NonBlocking, NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt;

/// Lines that wait for the thread that writes them.
const LINES_MAX: usize = 4096;

/// Where systemd's journal takes entries (its native protocol).
const JOURNAL_SOCKET: &str = "/run/systemd/journal/socket";

/// Longest entry; a datagram of the system's default size takes it.
const ENTRY_MAX: usize = 64 * 1024;

static LOST: OnceLock<ErrorCounter> = OnceLock::new();

/// How long the end waits for the remaining lines.
const WRITTEN_WITHIN: Duration = Duration::from_millis(1500);

/// Keeps the log's thread alive; dropping it writes the remaining lines, within 1.5 s.
pub struct LogGuard(Option<WorkerGuard>);

impl Drop for LogGuard {
    /// The library's guard prints to standard output if its queue is full, and on a suspended terminal that
    /// call never returns.
    fn drop(&mut self) {
        let guard = Arc::new(Mutex::new(self.0.take()));
        let (taken, (over, is_over)) = (Arc::clone(&guard), channel());
        let take =
            |guard: &Mutex<Option<WorkerGuard>>| guard.lock().unwrap_or_else(PoisonError::into_inner).take();
        let thread = std::thread::Builder::new().name("log-end".to_string());
        let spawned = thread.spawn(move || {
            drop(take(&taken));
            let _ = over.send(());
        });
        match spawned {
            Ok(_) => _ = is_over.recv_timeout(WRITTEN_WITHIN),
            Err(_) => std::mem::forget(take(&guard)),
        }
    }
}

/// Lines that were lost so far because nothing took them.
pub fn lost_lines() -> usize {
    LOST.get().map_or(0, ErrorCounter::dropped_lines)
}

/// Starts the log; `CELLD_LOG` chooses what it takes (`warn`, `celld::daemon=debug`, ...) in place of
/// `usual`. A `CELLD_LOG` that cannot be read counts as none, and that is reported.
pub fn start(usual: &str) -> LogGuard {
    let wanted = std::env::var("CELLD_LOG").ok().filter(|wanted| !wanted.is_empty());
    let read = wanted.as_deref().map(tracing_subscriber::EnvFilter::try_new);
    let (filter, fault) = match read {
        Some(Ok(filter)) => (filter, None),
        Some(Err(error)) => (tracing_subscriber::EnvFilter::new(usual), Some(error)),
        None => (tracing_subscriber::EnvFilter::new(usual), None),
    };
    let log = tracing_subscriber::registry().with(filter);
    let guard = match Journal::open().filter(|_| stderr_is_journal()) {
        Some(journal) => {
            let (writer, guard) = unhurried(journal);
            let entries = tracing_subscriber::fmt::layer().with_ansi(false).event_format(JournalEntry);
            log.with(entries.with_writer(writer)).init();
            guard
        }
        None => {
            // A file gets no colours.
            let ansi = io::stderr().is_terminal();
            let (writer, guard) = unhurried(io::stderr());
            let lines = tracing_subscriber::fmt::layer().with_target(false).with_ansi(ansi);
            log.with(lines.with_writer(writer)).init();
            guard
        }
    };
    if let Some(error) = fault {
        complain(&format!("CELLD_LOG cannot be read ({error}); logging {usual}"));
    }
    LogGuard(Some(guard))
}

/// A panic is a line of the log too: what the standard library prints would wait for standard error.
pub fn log_panics() {
    std::panic::set_hook(Box::new(|panic| {
        let thread = std::thread::current();
        tracing::error!(thread = thread.name().unwrap_or("unnamed"), "a defect of celld: {panic}");
    }));
}

fn unhurried(to: impl Write + Send + 'static) -> (NonBlocking, WorkerGuard) {
    let builder = NonBlockingBuilder::default().lossy(true).buffered_lines_limit(LINES_MAX);
    let (writer, guard) = builder.finish(to);
    let _ = LOST.set(writer.error_counter());
    (writer, guard)
}

/// True where standard error goes into the journal: systemd names device and inode of the stream
/// (`systemd.exec(5)`, `JOURNAL_STREAM`).
fn stderr_is_journal() -> bool {
    let stream = std::env::var("JOURNAL_STREAM").unwrap_or_default();
    rustix::fs::fstat(io::stderr()).is_ok_and(|stat| names(&stream, stat.st_dev, stat.st_ino))
}

/// `stream` is this device and inode.
fn names(stream: &str, device: u64, inode: u64) -> bool {
    stream.split_once(':').is_some_and(|(d, i)| d.parse() == Ok(device) && i.parse() == Ok(inode))
}

/// The journal's socket: one datagram an entry.
struct Journal(UnixDatagram);

impl Journal {
    fn open() -> Option<Journal> {
        let socket = UnixDatagram::unbound().ok()?;
        socket.connect(JOURNAL_SOCKET).ok()?;
        Some(Journal(socket))
    }
}

impl Write for Journal {
    fn write(&mut self, entry: &[u8]) -> io::Result<usize> {
        self.0.send(&entry[..entry.len().min(ENTRY_MAX)]).map(|_| entry.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Formats an event as an entry of the journal: a field a line.
struct JournalEntry;

impl<S, N> FormatEvent<S, N> for JournalEntry
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        _context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let metadata = event.metadata();
        writeln!(writer, "PRIORITY={}", priority(*metadata.level()))?;
        writeln!(writer, "TARGET={}", metadata.target())?;
        writeln!(writer, "SYSLOG_IDENTIFIER=celld")?;
        let mut fields = Fields { writer, result: Ok(()) };
        event.record(&mut fields);
        fields.result
    }
}

/// `syslog(3)`'s number of a level.
fn priority(level: Level) -> u8 {
    match level {
        Level::ERROR => 3,
        Level::WARN => 4,
        Level::INFO => 6,
        Level::DEBUG | Level::TRACE => 7,
    }
}

struct Fields<'a> {
    writer: Writer<'a>,
    result: fmt::Result,
}

impl Fields<'_> {
    /// A field on a line; line ends within it would begin another field.
    fn write(&mut self, field: &Field, value: &str) {
        let name = field.name().to_ascii_uppercase();
        let name = name.trim_start_matches(|c: char| !c.is_ascii_alphabetic());
        let known = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if name.is_empty() || !name.chars().all(known) {
            return;
        }
        self.result =
            self.result.and_then(|()| writeln!(self.writer, "{name}={}", value.replace('\n', "; ")));
    }
}

impl Visit for Fields<'_> {
    fn record_str(&mut self, field: &Field, value: &str) {
        self.write(field, value);
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        let mut text = String::new();
        let _ = write!(text, "{value:?}");
        self.write(field, &text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{Receiver, Sender, channel};
    use std::sync::{Arc, Mutex};

    #[test]
    fn the_journal_s_stream_is_known_by_device_and_inode() {
        assert!(names("9:4711", 9, 4711));
        for other in ["", "9", "9:4712", "8:4711", "9:4711:1", "x:y"] {
            assert!(!names(other, 9, 4711), "{other}");
        }
    }

    /// A terminal that takes nothing before it is let go.
    struct Held {
        go: Receiver<()>,
        written: Arc<Mutex<Vec<u8>>>,
        done: Sender<()>,
    }

    impl Write for Held {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let _ = self.go.recv();
            self.written.lock().unwrap().extend(bytes);
            let _ = self.done.send(());
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_held_terminal_loses_counted_lines_and_holds_no_caller_up() {
        let ((let_go, go), (done, written_one)) = (channel(), channel());
        let written: Arc<Mutex<Vec<u8>>> = Arc::default();
        let builder = NonBlockingBuilder::default().lossy(true).buffered_lines_limit(8);
        let (mut writer, _guard) = builder.finish(Held { go, written: written.clone(), done });
        // Returns, although nothing is written.
        (0..100).for_each(|line| writer.write_all(format!("{line}\n").as_bytes()).unwrap());
        let lost = writer.error_counter().dropped_lines();
        assert!((90..=92).contains(&lost), "{lost} of 100, with 8 in the queue and one being written");
        let_go.send(()).unwrap();
        written_one.recv().unwrap();
        assert_eq!(*written.lock().unwrap(), b"0\n");
        drop(let_go);
    }

    #[test]
    fn an_entry_of_the_journal_has_its_fields_on_lines_of_their_own() {
        let written: Arc<Mutex<Vec<u8>>> = Arc::default();
        let (go_sender, go) = channel();
        drop(go_sender);
        let held = Mutex::new(Held { go, written: written.clone(), done: channel().0 });
        let layer = tracing_subscriber::fmt::layer().with_ansi(false).event_format(JournalEntry);
        let log = tracing_subscriber::registry().with(layer.with_writer(held));
        tracing::subscriber::with_default(log, || {
            tracing::warn!(job = "tidy\nUID=0", step = Some(3), "stopped: {}", "link lost");
        });
        let text = String::from_utf8(written.lock().unwrap().clone()).unwrap();
        for line in ["PRIORITY=4", "MESSAGE=stopped: link lost", "JOB=tidy; UID=0", "STEP=3"] {
            assert!(text.lines().any(|written| written == line), "{line} in {text}");
        }
    }
}
