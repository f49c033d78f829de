//! The state folder on threads of its own, so that a slow disk keeps no heartbeat and no abort waiting.
//!
//! In: what the machine wants written, answered or claimed. Out: [`Event`]s: commits in the order of the
//! requests, orders, jobs. One thread writes the journal and looks after job files; each source of orders
//! has one that takes them in and hands the answers back (`intake`). A commit takes milliseconds at best and
//! half a second on a busy disk; the robot stops when no message reaches it for a fraction of that, and a
//! person who aborts does not wait for a disk.

use crate::daemon::intake::{Answers, Heard, OrderChannels, Sources, UNASKED, take_orders};
use crate::daemon::messages::Message;
use crate::daemon::watchdog::{Beat, Beats};
use crate::jobs::sources::Given;
use cell_edge::clock::{Clock, boot_now_s};
use cell_machine::event::Event;
use cell_machine::intake::{Origin, Unreachable, refusal};
use cell_machine::orders::{Order, Reply};
use cell_machine::supervisor::input::Record;
use cell_machine::supervisor::mode::EndFault;
use cell_machine::supervisor::order::JobOrder;
use cell_machine::supervisor::status::Status;
use cell_values::time::{Duration, Timestamp};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Instant;
use tokio::sync::mpsc;

/// The journal and the job folders.
pub trait Keeper: Send + 'static {
    /// Writes a record of the active job; it is on disk when this returns.
    ///
    /// # Errors
    /// The cause; nothing moves on after it.
    fn commit(&mut self, record: &Record) -> Result<(), String>;

    /// Takes in job files, a few at a time; the ids of active jobs that are to be cancelled.
    fn look_after(&mut self, now: Timestamp) -> Vec<String>;

    /// There are more job files: the next look after them need not wait.
    fn has_more(&self) -> bool {
        false
    }

    /// Why nothing that is written counts any more, once that is so.
    fn fault(&mut self) -> Option<EndFault> {
        None
    }

    /// Claims the next job, if one is ready.
    fn claim(&mut self) -> Option<JobOrder>;

    /// Ends a job that has not begun; `None` when it is not waiting.
    fn cancel_waiting(&mut self, id: &str) -> Option<Reply>;

    /// Publishes the cell's status; called when nothing else is to be done.
    fn status(&mut self, status: &Status);

    /// Everything is written; celld ends.
    fn close(&mut self) {}
}

/// How often job files are looked after, in the cell's time.
const EVERY: Duration = Duration::from_millis(200);

/// A status that does not change is published again after so long, by the wall's clock: its age shows that
/// the daemon lives, and job files come and go meanwhile.
const STATUS_EVERY: std::time::Duration = std::time::Duration::from_secs(1);

/// A thread that has not come round for so long is taken for stuck in the disk, by the wall's clock.
const SILENT_AFTER: std::time::Duration = std::time::Duration::from_secs(15);

enum Request {
    Commit(u64, Record),
    Want,
    Cancel(u64, String, Given),
    Status(Box<Status>),
}

/// The shell's end of the state folder.
pub struct Store {
    requests: Option<Sender<Request>>,
    replies: Answers,
    threads: Vec<(Arc<Beat>, JoinHandle<()>)>,
    heard: Vec<(&'static str, Heard)>,
    ending: Arc<AtomicBool>,
    lost: bool,
}

impl Store {
    /// Starts the threads; what happens comes through `events`.
    pub fn open(
        keeper: Box<dyn Keeper>,
        sources: Sources,
        clock: Clock,
        events: mpsc::Sender<Message>,
        beats: &Beats,
    ) -> Store {
        let Sources { orders: sources, stops } = sources;
        let (requests, requested) = channel();
        let (replies, answers) = Answers::of(sources.len());
        let ending = Arc::new(AtomicBool::new(false));
        let (mut threads, mut heard) = (Vec::new(), Vec::new());
        for (index, (orders, answers)) in sources.into_iter().zip(answers).enumerate() {
            let beat = Arc::new(beats.task(orders.task(), SILENT_AFTER));
            let (events, cancels, stops) = (events.clone(), requests.clone(), stops.clone());
            let cancel = move |number, id, given| cancels.send(Request::Cancel(number, id, given)).is_ok();
            let reported = Heard::new();
            heard.push((orders.task(), reported.clone()));
            let channels =
                OrderChannels { events, cancel: Box::new(cancel), answers, stops, heard: reported };
            let (taking, ending) = (beat.clone(), ending.clone());
            let take = move || take_orders(orders, index, &channels, &taking, &ending);
            threads.push((beat, std::thread::spawn(take)));
        }
        let beat = Arc::new(beats.task("the journal", SILENT_AFTER));
        let keeping = Keeping { keeper, clock, events, answers: replies.clone(), beat: beat.clone() };
        threads.push((beat, std::thread::spawn(move || keeping.run(&requested))));
        Store { requests: Some(requests), replies, threads, heard, ending, lost: false }
    }

    /// Has a record written; answered by [`Event::Committed`].
    pub fn commit(&self, number: u64, record: Record) {
        self.send(Request::Commit(number, record));
    }

    /// A job is wanted as soon as one is ready.
    pub fn want_job(&self) {
        self.send(Request::Want);
    }

    /// Has the status published, some time; of several the last.
    pub fn status(&self, status: Box<Status>) {
        self.send(Request::Status(status));
    }

    /// Answers an order.
    pub fn reply(&self, number: u64, reply: Reply) {
        self.replies.send(number, reply);
    }

    /// For how long no orders could be taken in from the source that is worst off, and why.
    pub fn silent(&self) -> Option<(std::time::Duration, Unreachable)> {
        let silent = self.heard.iter().map(|(task, heard)| heard.silent(task));
        silent.max_by_key(|(since, _)| *since)
    }

    /// Counts from now on for how long threads have been silent: celld itself was held up.
    pub fn start_again(&self) {
        self.heard.iter().for_each(|(_, heard)| heard.start_again());
        self.threads.iter().for_each(|(beat, _)| beat.start_again());
    }

    /// Once: a thread that is stuck or has panicked.
    pub fn fault(&mut self) -> Option<EndFault> {
        let panicked = self.threads.iter().any(|(_, thread)| thread.is_finished());
        let silent = self.threads.iter().any(|(beat, _)| beat.is_late());
        if self.lost || !(panicked || silent) {
            return None;
        }
        self.lost = true;
        Some(if panicked { EndFault::Failed } else { EndFault::Silent(SILENT_AFTER.as_secs()) })
    }

    /// Waits until everything is written and answered, but not longer than `limit`; false if it is not.
    pub async fn close(mut self, limit: std::time::Duration) -> bool {
        self.requests = None;
        // The threads of the orders write the answers that are left, and let go of the other one.
        self.ending.store(true, Ordering::Relaxed);
        let since = Instant::now();
        while !self.threads.iter().all(|(_, thread)| thread.is_finished()) {
            if since.elapsed() > limit {
                return false;
            }
            tokio::time::sleep(std::time::Duration::from_millis(5)).await;
        }
        true
    }

    fn send(&self, request: Request) {
        if let Some(requests) = &self.requests {
            // A thread that has ended is reported by `fault`.
            let _ = requests.send(request);
        }
    }
}

/// The thread of the journal.
struct Keeping {
    keeper: Box<dyn Keeper>,
    clock: Clock,
    events: mpsc::Sender<Message>,
    answers: Answers,
    beat: Arc<Beat>,
}

impl Keeping {
    /// Until no requester is left; what is left is written first.
    fn run(mut self, requested: &Receiver<Request>) {
        let (mut wanted, mut status, mut last) = (false, None, None::<Box<Status>>);
        let (mut looked, mut published) = (Instant::now(), Instant::now());
        loop {
            self.beat.now();
            let every = self.clock.wall(EVERY);
            // The status comes last: no caller waits for it.
            let more = self.keeper.has_more();
            let at_once = status.is_some() || more;
            let patience = if at_once { std::time::Duration::ZERO } else { every };
            match requested.recv_timeout(patience) {
                Ok(Request::Commit(number, record)) => {
                    let result = self.keeper.commit(&record);
                    self.report_fault();
                    self.send_event(Event::Committed(number, result));
                }
                Ok(Request::Want) => wanted = true,
                Ok(Request::Cancel(number, id, given)) => self.cancel(number, id, given),
                Ok(Request::Status(new)) => status = Some(new),
                Err(RecvTimeoutError::Timeout) => {
                    if status.is_some() || published.elapsed() >= STATUS_EVERY {
                        last = status.take().or(last);
                        last.iter().for_each(|status| self.keeper.status(status));
                        published = Instant::now();
                    }
                }
                Err(RecvTimeoutError::Disconnected) => {
                    status.iter().for_each(|status| self.keeper.status(status));
                    self.keeper.close();
                    self.beat.rests();
                    return;
                }
            }
            if looked.elapsed() >= every || wanted || more {
                looked = Instant::now();
                self.report_fault();
                for id in self.keeper.look_after(self.clock.now()) {
                    self.send_event(Event::Order(UNASKED, Order::Cancel(id), Origin::OWN));
                }
                if let Some(job) = wanted.then(|| self.keeper.claim()).flatten() {
                    wanted = false;
                    self.send_event(Event::Job(Box::new(job)));
                }
            }
        }
    }

    /// The journal's file is gone or damaged: before what follows from that.
    fn report_fault(&mut self) {
        if let Some(fault) = self.keeper.fault() {
            self.send_event(Event::StoreLost(fault));
        }
    }

    /// A job that waits is ended here; of the active one the machine decides.
    fn cancel(&mut self, number: u64, id: String, given: Given) {
        let refused = refusal(&given.order, given.origin(boot_now_s()));
        match refused.or_else(|| self.keeper.cancel_waiting(&id)) {
            Some(reply) => self.answers.send(number, reply),
            None => _ = self.events.blocking_send(Message::Order(number, given)),
        }
    }

    /// The loop has ended if there is no receiver; what is left is written all the same.
    fn send_event(&self, event: Event) {
        let _ = self.events.blocking_send(Message::Event(event));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::intake::Orders;
    use crate::jobs::sources::Batch;
    use cell_edge::clock::boot_now_s;
    use std::sync::Mutex;

    /// Writes into a list; its first record waits for a sign, and `taken` shows that it does.
    struct Slow {
        lines: Arc<Mutex<Vec<String>>>,
        sign: Option<Receiver<()>>,
        taken: Arc<AtomicBool>,
    }

    impl Keeper for Slow {
        fn commit(&mut self, record: &Record) -> Result<(), String> {
            if let Some(sign) = self.sign.take() {
                self.taken.store(true, Ordering::Relaxed);
                sign.recv().unwrap();
            }
            self.lines.lock().unwrap().push(format!("{record:?}"));
            Err("full".to_string())
        }

        fn look_after(&mut self, _now: Timestamp) -> Vec<String> {
            Vec::new()
        }

        fn claim(&mut self) -> Option<JobOrder> {
            None
        }

        fn cancel_waiting(&mut self, id: &str) -> Option<Reply> {
            (id == "waits").then(|| Reply::accept("cancelled before it began"))
        }

        fn status(&mut self, status: &Status) {
            self.lines.lock().unwrap().push(status.job.clone().unwrap_or_default());
        }
    }

    /// Three orders at once, when the record is being written; their answers are kept.
    struct Three {
        given: bool,
        taken: Arc<AtomicBool>,
        answers: Arc<Mutex<Vec<(u32, Reply)>>>,
    }

    impl Orders for Three {
        fn task(&self) -> &'static str {
            "orders of a test"
        }

        fn take(&mut self) -> Batch {
            if !self.taken.load(Ordering::Relaxed) || std::mem::replace(&mut self.given, true) {
                return Batch::default();
            }
            let orders = [Order::Cancel("waits".into()), Order::Cancel("active".into()), Order::Abort];
            let given = |(number, order)| Given {
                number,
                order,
                boot_s: boot_now_s(),
                client_waits: Arc::new(|| true),
            };
            Batch { orders: (1..).zip(orders).map(given).collect(), fault: None }
        }

        fn reply(&mut self, number: u32, reply: &Reply) {
            self.answers.lock().unwrap().push((number, reply.clone()));
        }
    }

    fn open(keeper: impl Keeper, sources: Vec<Box<dyn Orders>>, events: mpsc::Sender<Message>) -> Store {
        Store::open(Box::new(keeper), Sources::of(sources), Clock::new(1.0), events, &Beats::default())
    }

    fn runtime() -> tokio::runtime::Runtime {
        tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap()
    }

    fn status(job: &str) -> Status {
        Status { job: Some(job.to_string()), ..Status::idle() }
    }

    #[test]
    fn an_abort_is_received_while_a_record_is_written_and_answers_come_in_order() {
        let (lines, answers) = (Arc::default(), Arc::default());
        let (sign, waiting) = channel();
        let (sender, mut events) = mpsc::channel(64);
        let taken = Arc::new(AtomicBool::new(false));
        let keeper = Slow { lines: Arc::clone(&lines), sign: Some(waiting), taken: Arc::clone(&taken) };
        let orders = Three { given: false, taken, answers: Arc::clone(&answers) };
        let store = open(keeper, vec![Box::new(orders)], sender);
        store.commit(7, Record::Done { step: 4 });
        for job in ["one", "two", "three"] {
            store.status(Box::new(status(job)));
        }
        let Some(Message::Order(3, Given { order: Order::Abort, .. })) = events.blocking_recv() else {
            panic!("the abort comes")
        };
        assert!(lines.lock().unwrap().is_empty(), "nothing is written yet");
        sign.send(()).unwrap();
        let Some(Message::Event(Event::Committed(7, Err(why)))) = events.blocking_recv() else {
            panic!("then the record")
        };
        assert_eq!(why, "full");
        let Some(Message::Order(2, Given { order: Order::Cancel(id), .. })) = events.blocking_recv() else {
            panic!("not waiting")
        };
        assert_eq!(id, "active");
        store.reply(2, Reply::refuse("no"));
        assert!(runtime().block_on(store.close(std::time::Duration::from_secs(30))));
        let numbers: Vec<u32> = answers.lock().unwrap().iter().map(|(number, _)| *number).collect();
        assert_eq!(numbers, [1, 2]);
        // Of the three, the last is written, after the record that the arm waits for.
        assert_eq!(*lines.lock().unwrap(), ["Done { step: 4 }", "three"]);
    }

    #[test]
    fn a_store_that_hangs_does_not_keep_the_daemon_from_ending() {
        let (_sign, waiting) = channel();
        let (sender, _events) = mpsc::channel(64);
        let keeper = Slow { lines: Arc::default(), sign: Some(waiting), taken: Arc::default() };
        let store = open(keeper, Vec::new(), sender);
        store.commit(1, Record::Done { step: 7 });
        assert!(!runtime().block_on(store.close(std::time::Duration::ZERO)));
    }

    #[test]
    fn a_thread_that_panics_is_reported_once() {
        struct Broken;
        impl Keeper for Broken {
            fn commit(&mut self, _record: &Record) -> Result<(), String> {
                panic!("as ordered")
            }
            fn look_after(&mut self, _now: Timestamp) -> Vec<String> {
                Vec::new()
            }
            fn claim(&mut self) -> Option<JobOrder> {
                None
            }
            fn cancel_waiting(&mut self, _id: &str) -> Option<Reply> {
                None
            }
            fn status(&mut self, _status: &Status) {}
        }
        let (sender, _events) = mpsc::channel(64);
        let mut store = open(Broken, Vec::new(), sender);
        store.commit(1, Record::Done { step: 1 });
        let since = Instant::now();
        let fault = loop {
            match store.fault() {
                Some(fault) => break fault,
                None => assert!(since.elapsed().as_secs() < 60, "never reported"),
            }
            std::thread::yield_now();
        };
        assert_eq!((fault, store.fault()), (EndFault::Failed, None));
        assert!(runtime().block_on(store.close(std::time::Duration::from_secs(30))));
    }
}
