//! How far long work is, on stderr: a bar on a terminal, a line now and then in a log.
//!
//! In: how much there is, and each piece as it is done, from any thread. Out: progress that whoever waits
//! can see, also where stderr is a file.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How often a line is written where there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// See the module.
pub struct Progress {
    bar: ProgressBar,
    what: &'static str,
    began: Instant,
    /// When the last line was written; `None` on a terminal, where the bar is.
    written: Option<Mutex<Instant>>,
}

impl Progress {
    /// So many pieces of work, named in the plural.
    pub fn new(count: usize, what: &'static str) -> Progress {
        let style = ProgressStyle::with_template("{wide_bar} {pos}/{len} {msg}, {eta} left");
        let bar = ProgressBar::new(count as u64).with_message(what);
        let bar = style.map(|style| bar.clone().with_style(style)).unwrap_or(bar);
        let began = Instant::now();
        let written = (!std::io::stderr().is_terminal()).then(|| Mutex::new(began));
        Progress { bar, what, began, written }
    }

    /// One more is done.
    pub fn inc(&self) {
        self.bar.inc(1);
        let Some(written) = &self.written else { return };
        let mut written = written.lock().unwrap_or_else(PoisonError::into_inner);
        if written.elapsed() >= LINE_EVERY {
            *written = Instant::now();
            eprintln!("{}", line(self.bar.position(), self.bar.length(), self.what, self.began.elapsed()));
        }
    }

    /// Writes something without the bar in between.
    pub fn suspend(&self, write: impl FnOnce()) {
        self.bar.suspend(write);
    }

    /// The work is over.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

fn line(done: u64, all: Option<u64>, what: &str, passed: Duration) -> String {
    let of = all.map(|all| format!(" of {all}")).unwrap_or_default();
    format!("{done}{of} {what} after {} s", passed.as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_how_far_it_is() {
        let text = line(3, Some(10), "jobs", Duration::from_secs(61));
        assert_eq!(text, "3 of 10 jobs after 61 s");
    }
}
