//! The intake of orders: for each source a thread that takes them in and hands the answers back.
//!
//! In: sources of operators' orders (the state folder, the page). Out: orders for the loop, in which an
//! order's number names its source as well; the machine's answers, each to where its order came from. A
//! source that waits keeps no order of another one waiting. Stops go before everything that came with them,
//! and an order to do something that was given before a stop or a release does not count after it. That
//! is decided in `jobs::sources` and `cell_machine::intake`, which the closed loop calls too.

use crate::daemon::messages::Message;
use crate::daemon::watchdog::Beat;
use crate::jobs::sources::{Batch, Given, Stops, number_of, source_of};
use cell_edge::clock::boot_now_s;
use cell_machine::intake::Unreachable;
use cell_machine::orders::{Order, Reply};
use cell_values::time::Duration;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use tokio::sync::mpsc;

/// How often orders are taken in, by the wall's clock: a stop waits for no more.
const EVERY: Duration = Duration::from_millis(5);

/// Number of a cancellation that came as a file: its answer is the job's end.
pub const UNASKED: u64 = 0;

/// Where operators' orders come from.
pub trait Orders: Send + 'static {
    /// The task of its thread, as the watchdog names it.
    fn task(&self) -> &'static str;

    /// Orders since the last call. Must not wait for a disk that stalls.
    fn take(&mut self) -> Batch;

    /// Answers the order of this number. Must not wait either.
    fn reply(&mut self, number: u32, reply: &Reply);

    /// It does not wait for other processes, so its thread may have real-time priority.
    fn is_prompt(&self) -> bool {
        false
    }
}

/// The way back to each source.
#[derive(Clone)]
pub struct Answers(Vec<Sender<(u32, Reply)>>);

impl Answers {
    /// For so many sources, with the end of each.
    pub fn of(sources: usize) -> (Answers, Vec<Receiver<(u32, Reply)>>) {
        let (senders, receivers) = (0..sources).map(|_| channel()).unzip();
        (Answers(senders), receivers)
    }

    /// Answers the order that the machine knows by `number`. A thread that has ended is reported by
    /// `Store::fault`, and its orders have ended with it.
    pub fn send(&self, number: u64, reply: Reply) {
        if number == UNASKED {
            return;
        }
        let (index, own) = source_of(number);
        if let Some(source) = self.0.get(index) {
            let _ = source.send((own, reply));
        }
    }
}

/// When a source took orders in last, and what keeps it from that.
#[derive(Clone)]
pub struct Heard(Arc<Mutex<(Instant, Option<Unreachable>)>>);

impl Heard {
    /// Orders are taken in now.
    pub fn new() -> Heard {
        Heard(Arc::new(Mutex::new((Instant::now(), None))))
    }

    fn state(&self) -> MutexGuard<'_, (Instant, Option<Unreachable>)> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A look at the source is over.
    fn looked(&self, fault: Option<Unreachable>) {
        let mut state = self.state();
        if fault.is_none() {
            state.0 = Instant::now();
        }
        state.1 = fault;
    }

    /// Counts from now on: celld itself was held up.
    pub fn start_again(&self) {
        self.state().0 = Instant::now();
    }

    /// For how long no orders could be taken in, and why; `task` names the thread.
    pub fn silent(&self, task: &'static str) -> (Duration, Unreachable) {
        let (last, fault) = &*self.state();
        (last.elapsed(), fault.clone().unwrap_or_else(|| Unreachable::Silent(task.to_string())))
    }
}

impl Default for Heard {
    fn default() -> Heard {
        Heard::new()
    }
}

/// All sources, and the stops that they share from the start of celld on.
pub struct Sources {
    /// Each gets a thread of its own.
    pub orders: Vec<Box<dyn Orders>>,
    /// Of all of them.
    pub stops: Arc<Stops>,
}

impl Sources {
    /// With no stop so far.
    pub fn of(orders: Vec<Box<dyn Orders>>) -> Sources {
        Sources { orders, stops: Arc::default() }
    }
}

/// Where the thread of a source sends its orders, and where their answers come from.
pub struct OrderChannels {
    /// To the machine.
    pub events: mpsc::Sender<Message>,
    /// To the thread of the journal: a cancellation of a job by its id; false when it has ended.
    pub cancel: Box<dyn Fn(u64, String, Given) -> bool + Send>,
    /// Answers, each with the number of its order.
    pub answers: Receiver<(u32, Reply)>,
    /// Shared by all sources.
    pub stops: Arc<Stops>,
    /// Where the thread reports that orders reach it.
    pub heard: Heard,
}

impl OrderChannels {
    /// Everything that a look at the source brought; stops go first. False when the daemon is ending.
    fn send_all(&self, index: usize, orders: &mut dyn Orders, taken: Vec<Given>) -> bool {
        let send = |given: &Given| {
            let number = number_of(index, given.number);
            match &given.order {
                Order::Cancel(id) => (self.cancel)(number, id.clone(), given.clone()),
                _ => self.events.blocking_send(Message::Order(number, given.clone())).is_ok(),
            }
        };
        self.stops.hand_on(taken, boot_now_s, send, |number, reply| orders.reply(number, &reply))
    }
}

/// The thread of the source `index`: takes orders until `ending`, and hands on the answers that have come.
pub fn take_orders(
    mut orders: Box<dyn Orders>,
    index: usize,
    channels: &OrderChannels,
    beat: &Beat,
    ending: &AtomicBool,
) {
    if orders.is_prompt() {
        cell_edge::priority::real_time();
    }
    while !ending.load(Ordering::Relaxed) {
        beat.now();
        let Batch { orders: taken, fault } = orders.take();
        if !channels.send_all(index, &mut *orders, taken) {
            return beat.rests();
        }
        channels.heard.looked(fault);
        // An answer may have given its handle back.
        let _ = cell_edge::reserve::fill();
        let until = Instant::now() + EVERY;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match channels.answers.recv_timeout(left) {
                Ok((number, reply)) => orders.reply(number, &reply),
                Err(RecvTimeoutError::Timeout) => break,
                Err(RecvTimeoutError::Disconnected) => return beat.rests(),
            }
        }
    }
    channels.answers.try_iter().for_each(|(number, reply)| orders.reply(number, &reply));
    beat.rests();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::watchdog::Beats;
    use std::sync::mpsc::SyncSender;

    /// Gives what comes through its channel; each look waits for it as one at a slow disk does.
    struct Source(Receiver<Vec<Given>>, SyncSender<(u32, Reply)>);

    fn given(number: u32, order: Order, boot_s: f64) -> Given {
        Given { number, order, boot_s, client_waits: Arc::new(|| true) }
    }

    impl Orders for Source {
        fn task(&self) -> &'static str {
            "orders of a test"
        }

        fn take(&mut self) -> Batch {
            Batch { orders: self.0.recv().unwrap_or_default(), fault: None }
        }

        fn reply(&mut self, number: u32, reply: &Reply) {
            let _ = self.1.send((number, reply.clone()));
        }
    }

    /// Two sources, each with the end that gives it orders and the end that sees its answers.
    struct Two {
        give: Vec<Sender<Vec<Given>>>,
        answered: Vec<Receiver<(u32, Reply)>>,
        events: mpsc::Receiver<Message>,
        answers: Answers,
        threads: Vec<std::thread::JoinHandle<()>>,
        ending: Arc<AtomicBool>,
    }

    fn two() -> Two {
        let (sender, events) = mpsc::channel(64);
        let (answers, receivers) = Answers::of(2);
        let (stops, ending) = (Arc::new(Stops::default()), Arc::new(AtomicBool::new(false)));
        let (mut give, mut answered, mut threads) = (Vec::new(), Vec::new(), Vec::new());
        for (index, answers) in receivers.into_iter().enumerate() {
            let (to_source, taken) = channel();
            let (from_source, seen) = std::sync::mpsc::sync_channel(64);
            let channels = OrderChannels {
                events: sender.clone(),
                cancel: Box::new(|_, _, _| true),
                answers,
                stops: stops.clone(),
                heard: Heard::new(),
            };
            let (ending, beat) = (ending.clone(), Beats::default().task("test", std::time::Duration::MAX));
            threads.push(std::thread::spawn(move || {
                let source = Box::new(Source(taken, from_source));
                take_orders(source, index, &channels, &beat, &ending);
            }));
            give.push(to_source);
            answered.push(seen);
        }
        Two { give, answered, events, answers, threads, ending }
    }

    impl Two {
        fn give(&self, source: usize, orders: &[(Order, f64)]) {
            let orders =
                (1..).zip(orders).map(|(number, (order, boot_s))| given(number, order.clone(), *boot_s));
            self.give[source].send(orders.collect()).unwrap();
        }

        fn next(&mut self) -> (u64, Order) {
            match self.events.blocking_recv() {
                Some(Message::Order(number, given)) => (number, given.order),
                _ => panic!("an order comes"),
            }
        }

        fn end(self) {
            self.ending.store(true, Ordering::Relaxed);
            drop((self.give, self.answers));
            self.threads.into_iter().for_each(|thread| thread.join().unwrap());
        }
    }

    #[test]
    fn a_stop_does_not_wait_for_the_slow_source_and_what_is_older_moves_nothing_after_it() {
        let mut two = two();
        // The first source is held up; the stop of the second one comes through.
        two.give(1, &[(Order::Disarm, 20.0)]);
        let (number, order) = two.next();
        assert_eq!((number, &order), (1 << 32 | 1, &Order::Disarm));
        two.answers.send(number, Reply::accept("disarmed"));
        two.give(1, &[]);
        assert_eq!(two.answered[1].recv().unwrap(), (1, Reply::accept("disarmed")));
        // What was given before the stop comes to light after it.
        let orders = [(Order::Arm, 19.0), (Order::Reject("a".into()), 19.0), (Order::Park, 21.0)];
        two.give(0, &orders);
        let (number, reply) = two.answered[0].recv().unwrap();
        assert!(number == 1 && !reply.accepted && reply.message.contains("was ordered after"), "{reply:?}");
        assert_eq!(two.next(), (2, Order::Reject("a".into())));
        assert_eq!(two.next(), (3, Order::Park));
        two.end();
    }

    #[test]
    fn of_orders_that_come_together_stops_go_first_and_only_later_ones_follow() {
        let mut two = two();
        let orders = [
            (Order::Arm, 10.0),
            (Order::Abort, 10.0),
            (Order::Park, 9.0),
            (Order::Disarm, 9.0),
            (Order::Resume, 11.0),
        ];
        two.give(0, &orders);
        let order: Vec<Order> = (0..3).map(|_| two.next().1).collect();
        assert_eq!(order, [Order::Abort, Order::Disarm, Order::Resume]);
        two.give(0, &[]);
        for number in [1, 3] {
            let (answered, reply) = two.answered[0].recv().unwrap();
            assert!(answered == number && !reply.accepted, "{answered}: {reply:?}");
        }
        two.end();
    }

    #[test]
    fn a_source_that_cannot_be_read_is_silent_from_its_last_success_on() {
        let heard = Heard::new();
        heard.looked(Some(Unreachable::FolderGone("commands".into())));
        let since = heard.silent("orders").0;
        heard.looked(Some(Unreachable::FolderGone("commands".into())));
        assert!(heard.silent("orders").0 >= since, "a look that fails is no success");
        assert_eq!(heard.silent("orders").1, Unreachable::FolderGone("commands".into()));
        heard.looked(None);
        assert_eq!(heard.silent("orders").1, Unreachable::Silent("orders".into()));
    }

    #[test]
    fn an_answer_for_no_source_goes_nowhere() {
        let (answers, receivers) = Answers::of(1);
        for number in [UNASKED, 7 << 32 | 1, u64::MAX] {
            answers.send(number, Reply::accept("x"));
        }
        answers.send(5, Reply::accept("y"));
        assert_eq!(receivers[0].try_iter().collect::<Vec<_>>(), [(5, Reply::accept("y"))]);
    }
}
