//! The office on a thread of its own, so that a slow disk keeps no heartbeat waiting.
//!
//! In: what the loop wants written or asked. Out: [`Reply`]s, in the order of the requests. A commit to disk takes
//! milliseconds at best and half a second on a busy one; the robot stops when it hears nothing for a fraction of
//! that. The status, which nobody's safety hangs on, is written when no entry waits, and of several only the last.

use crate::daemon::run::{Office, RunError};
use crate::supervisor::cell::Status;
use crate::supervisor::input::{Input, JournalEntry};
use crate::supervisor::order::JobReport;
use crate::time::Timestamp;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// What the office is asked.
#[derive(Debug)]
enum Request {
    Poll { now: Timestamp, wants_job: bool },
    Journal(JournalEntry),
    Finished(Box<JobReport>),
    Status(Status),
}

/// What the office answers.
#[derive(Debug)]
pub enum Reply {
    /// Operators' commands, the first answer to [`Desk::poll`].
    Commands(Vec<Input>),
    /// What else came in, the second and last answer to [`Desk::poll`].
    Polled(Vec<Input>),
    /// It is on disk, or why not, to [`Desk::journal`] and [`Desk::finished`].
    Written(Result<(), String>),
}

/// The office's thread has panicked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BrokeDown;

/// The loop's end of the office.
pub struct Desk {
    requests: Sender<Request>,
    replies: Receiver<Reply>,
    thread: JoinHandle<()>,
}

impl Desk {
    /// Starts the office's thread.
    pub fn open(office: Box<dyn Office>) -> Desk {
        let (requests, asked) = channel();
        let (answers, replies) = channel();
        let thread = std::thread::spawn(move || work(office, &asked, &answers));
        Desk { requests, replies, thread }
    }

    /// Asks for what came in; see [`Office::commands`] and [`Office::jobs`].
    pub fn poll(&self, now: Timestamp, wants_job: bool) {
        self.send(Request::Poll { now, wants_job });
    }

    /// Has a line written; see [`Office::journal`].
    pub fn journal(&self, entry: JournalEntry) {
        self.send(Request::Journal(entry));
    }

    /// Has a result written; see [`Office::finished`].
    pub fn finished(&self, report: Box<JobReport>) {
        self.send(Request::Finished(report));
    }

    /// Has the status published, some time.
    pub fn status(&self, status: Status) {
        self.send(Request::Status(status));
    }

    /// What the office has answered by now.
    ///
    /// # Errors
    /// It broke down and will answer no more.
    pub fn reply(&self) -> Result<Option<Reply>, BrokeDown> {
        match self.replies.try_recv() {
            Ok(reply) => Ok(Some(reply)),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(BrokeDown),
        }
    }

    /// Waits until everything asked is done, but not longer than `limit`.
    ///
    /// # Errors
    /// It is not; the thread is left to itself.
    pub async fn close(self, limit: Duration) -> Result<(), RunError> {
        drop(self.requests);
        let since = Instant::now();
        while !self.thread.is_finished() {
            if since.elapsed() > limit {
                return Err(RunError::Disk);
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        Ok(())
    }

    /// That an office broke down is told by `reply`.
    fn send(&self, request: Request) {
        let _ = self.requests.send(request);
    }
}

/// Answers until nobody asks any more.
fn work(mut office: Box<dyn Office>, asked: &Receiver<Request>, answers: &Sender<Reply>) {
    let mut status = None;
    loop {
        let request = match asked.try_recv() {
            Ok(request) => request,
            Err(ended) => {
                if let Some(status) = status.take() {
                    office.status(&status);
                    continue;
                }
                let next = if ended == TryRecvError::Empty { asked.recv().ok() } else { None };
                let Some(request) = next else { return };
                request
            }
        };
        let reply = match request {
            Request::Poll { now, wants_job } => {
                // Which commands are refused hangs on the status.
                if let Some(status) = status.take() {
                    office.status(&status);
                }
                // An abort does not wait for job files.
                let _ = answers.send(Reply::Commands(office.commands()));
                Reply::Polled(office.jobs(now, wants_job))
            }
            Request::Journal(entry) => Reply::Written(office.journal(&entry)),
            Request::Finished(report) => Reply::Written(office.finished(&report)),
            Request::Status(new) => {
                status = Some(new);
                continue;
            }
        };
        // The loop has ended if nobody listens; what is left is written all the same.
        let _ = answers.send(reply);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::supervisor::input::OperatorCommand;
    use std::sync::{Arc, Mutex};

    /// Writes into a list; its first entry waits for a sign.
    struct Slow {
        lines: Arc<Mutex<Vec<String>>>,
        sign: Option<Receiver<()>>,
    }

    impl Office for Slow {
        fn commands(&mut self) -> Vec<Input> {
            vec![Input::Operator(OperatorCommand::Arm)]
        }

        fn jobs(&mut self, _now: Timestamp, wants_job: bool) -> Vec<Input> {
            self.lines.lock().unwrap().push(format!("jobs {wants_job}"));
            Vec::new()
        }

        fn journal(&mut self, entry: &JournalEntry) -> Result<(), String> {
            if let Some(sign) = self.sign.take() {
                sign.recv().unwrap();
            }
            self.lines.lock().unwrap().push(format!("{entry:?}"));
            Err("full".to_string())
        }

        fn finished(&mut self, report: &JobReport) -> Result<(), String> {
            self.lines.lock().unwrap().push(report.id.clone());
            Ok(())
        }

        fn status(&mut self, status: &Status) {
            self.lines.lock().unwrap().push(status.phase.clone());
        }
    }

    fn reply(desk: &Desk) -> Reply {
        let since = Instant::now();
        while since.elapsed() < Duration::from_secs(30) {
            if let Some(reply) = desk.reply().unwrap() {
                return reply;
            }
            std::thread::yield_now();
        }
        panic!("no reply in 30 s")
    }

    fn closed(desk: Desk, seconds: u64) -> Result<(), RunError> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        runtime.block_on(desk.close(Duration::from_secs(seconds)))
    }

    #[test]
    fn an_office_that_hangs_does_not_keep_the_daemon_from_ending() {
        let (_sign, waiting) = channel();
        let desk = Desk::open(Box::new(Slow { lines: Arc::default(), sign: Some(waiting) }));
        desk.journal(JournalEntry::Done { step: 7 });
        assert!(matches!(closed(desk, 0), Err(RunError::Disk)));
    }

    fn status(phase: &str) -> Status {
        let phase = phase.to_string();
        Status { armed: false, paused: false, phase, job: None, moves: 0, remaining_moves: 0 }
    }

    #[test]
    fn a_slow_office_keeps_nobody_waiting_and_answers_in_order() {
        let lines = Arc::new(Mutex::new(Vec::new()));
        let (sign, waiting) = channel();
        let desk = Desk::open(Box::new(Slow { lines: lines.clone(), sign: Some(waiting) }));
        desk.journal(JournalEntry::Done { step: 7 });
        for phase in ["one", "two", "three"] {
            desk.status(status(phase));
        }
        desk.poll(Timestamp::ZERO, true);
        assert!(desk.reply().unwrap().is_none());
        assert!(lines.lock().unwrap().is_empty());
        sign.send(()).unwrap();
        let Reply::Written(Err(why)) = reply(&desk) else { panic!("the entry comes first") };
        assert_eq!(why, "full");
        assert!(matches!(reply(&desk), Reply::Commands(inputs) if inputs.len() == 1));
        assert!(matches!(reply(&desk), Reply::Polled(inputs) if inputs.is_empty()));
        closed(desk, 30).unwrap();
        // Of the three, the last is written, after the entry that everybody waits for.
        assert_eq!(*lines.lock().unwrap(), ["Done { step: 7 }", "three", "jobs true"]);
    }

    #[test]
    fn an_office_that_breaks_down_is_told_and_takes_nobody_along() {
        struct Broken;
        impl Office for Broken {
            fn commands(&mut self) -> Vec<Input> {
                panic!("as asked")
            }
            fn jobs(&mut self, _now: Timestamp, _wants_job: bool) -> Vec<Input> {
                Vec::new()
            }
            fn journal(&mut self, _entry: &JournalEntry) -> Result<(), String> {
                Ok(())
            }
            fn finished(&mut self, _report: &JobReport) -> Result<(), String> {
                Ok(())
            }
            fn status(&mut self, _status: &Status) {}
        }
        let desk = Desk::open(Box::new(Broken));
        desk.poll(Timestamp::ZERO, false);
        let since = Instant::now();
        while !matches!(desk.reply(), Err(BrokeDown)) && since.elapsed() < Duration::from_secs(30) {
            std::thread::yield_now();
        }
        desk.journal(JournalEntry::Done { step: 1 });
        assert_eq!(desk.reply().unwrap_err(), BrokeDown);
        closed(desk, 30).unwrap();
    }
}
