//! The intake of orders: for each source a thread that takes them in and hands the answers back.
//!
//! In: sources of operators' orders (the state folder, the page). Out: [`Event`]s for the machine, in which
//! an order's number names its source as well; the machine's answers, each to where its order came from. A
//! source that waits for a disk keeps no order of another one waiting. An order may thus be overtaken: one
//! to do something that was given before a stop or a release and comes to light after it does not count.

use crate::daemon::messages::Message;
use crate::daemon::watchdog::Beat;
use cell_edge::clock::{Clock, boot_now_s};
use cell_machine::event::Event;
use cell_machine::orders::{Order, Reply};
use cell_values::time::Duration;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;
use tokio::sync::mpsc;

/// How often orders are taken in, in the cell's time.
const EVERY: Duration = Duration::from_millis(50);

/// Number of a cancellation that came as a file: its answer is the job's end.
pub const UNASKED: u64 = 0;

/// The lower bits of an order's number are its source's own, the upper ones name the source.
const SOURCE_BITS: u32 = 32;

/// An order that was given.
#[derive(Clone, Debug, PartialEq)]
pub struct Given {
    /// Of its source: from 1, without repetition.
    pub number: u32,
    /// What is ordered.
    pub order: Order,
    /// When it was given, s since the machine started. May come from outside: any number or none.
    pub boot_s: f64,
}

/// Where operators' orders come from.
pub trait Orders: Send + 'static {
    /// The task of its thread, as the watchdog names it.
    fn task(&self) -> &'static str;

    /// Orders since the last call.
    fn take(&mut self) -> Vec<Given>;

    /// Answers the order of this number.
    fn reply(&mut self, number: u32, reply: &Reply);
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
        let source = usize::try_from(number >> SOURCE_BITS).ok().and_then(|index| self.0.get(index));
        if let Some(source) = source {
            let _ = source.send((number as u32, reply));
        }
    }
}

/// When the last order was given that ends a person's leave to move, s since the machine started; of all
/// sources.
#[derive(Default)]
pub struct Stops(Mutex<Option<f64>>);

impl Stops {
    /// Notes those of these orders that end leave, before any of them is sent on.
    pub fn note(&self, given: &[Given], now_s: f64) {
        let ends = given.iter().filter(|given| given.order.ends_leave());
        // `min` gives `now_s` for a time that is no number.
        let last = ends.map(|given| given.boot_s.min(now_s)).fold(f64::MIN, f64::max);
        let mut noted = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if last > noted.unwrap_or(f64::MIN) {
            *noted = Some(last);
        }
    }

    /// Sends an order on, unless it is one to do something that was given before one that ended leave; it is
    /// decided and sent in one step, so that no stop comes between. `None`: it does not count.
    fn pass<T>(&self, given: &Given, now_s: f64, send: impl FnOnce() -> T) -> Option<T> {
        let last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let older = last.is_some_and(|last| given.boot_s.min(now_s) < last);
        if older && !given.order.only_takes_away() {
            return None;
        }
        Some(send())
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
    pub cancel: Box<dyn Fn(u64, String) -> bool + Send>,
    /// Answers, each with the number of its order.
    pub answers: Receiver<(u32, Reply)>,
    /// Shared by all sources.
    pub stops: Arc<Stops>,
}

impl OrderChannels {
    /// Sends one on; what does not count is answered at once. False when the daemon is ending.
    fn send(&self, index: usize, orders: &mut dyn Orders, given: Given) -> bool {
        let number = (index as u64) << SOURCE_BITS | u64::from(given.number);
        let sent = self.stops.pass(&given, boot_now_s(), || match &given.order {
            Order::Cancel(id) => (self.cancel)(number, id.clone()),
            order => self.events.blocking_send(Message::Event(Event::Order(number, order.clone()))).is_ok(),
        });
        if sent.is_none() {
            let why = "nothing was done: a stop or a release was ordered after this order was given; look at the \
                       cell, then give it again";
            orders.reply(given.number, &Reply::refuse(why));
        }
        sent.unwrap_or(true)
    }
}

/// The thread of the source `index`: takes orders until `ending`, and writes the answers that have come.
pub fn take_orders(
    mut orders: Box<dyn Orders>,
    index: usize,
    clock: &Clock,
    channels: &OrderChannels,
    beat: &Beat,
    ending: &AtomicBool,
) {
    while !ending.load(Ordering::Relaxed) {
        beat.now();
        let mut taken = orders.take();
        channels.stops.note(&taken, boot_now_s());
        // Of what comes together, what stops is decided last.
        taken.sort_by_key(|given| given.order.only_stops());
        for given in taken {
            if !channels.send(index, &mut *orders, given) {
                return beat.rests();
            }
        }
        let until = Instant::now() + clock.wall(EVERY);
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
    use cell_machine::orders::WayBack;
    use std::sync::mpsc::SyncSender;

    /// Gives what comes through its channel; each look waits for it as one at a slow disk does.
    struct Source(Receiver<Vec<Given>>, SyncSender<(u32, Reply)>);

    impl Orders for Source {
        fn task(&self) -> &'static str {
            "orders of a test"
        }

        fn take(&mut self) -> Vec<Given> {
            self.0.recv().unwrap_or_default()
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
                cancel: Box::new(|_, _| true),
                answers,
                stops: stops.clone(),
            };
            let (ending, beat) = (ending.clone(), Beats::default().task("test", std::time::Duration::MAX));
            threads.push(std::thread::spawn(move || {
                let source = Box::new(Source(taken, from_source));
                take_orders(source, index, &Clock::new(1.0), &channels, &beat, &ending);
            }));
            give.push(to_source);
            answered.push(seen);
        }
        Two { give, answered, events, answers, threads, ending }
    }

    impl Two {
        fn give(&self, source: usize, orders: &[(Order, f64)]) {
            let given = (1..).zip(orders).map(|(number, (order, boot_s))| Given {
                number,
                order: order.clone(),
                boot_s: *boot_s,
            });
            self.give[source].send(given.collect()).unwrap();
        }

        fn next(&mut self) -> (u64, Order) {
            match self.events.blocking_recv() {
                Some(Message::Event(Event::Order(number, order))) => (number, order),
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
    fn of_what_comes_together_the_stop_is_decided_last() {
        let mut two = two();
        two.give(0, &[(Order::Abort, 10.0), (Order::Arm, 10.0), (Order::Park, 9.0), (Order::Disarm, 9.0)]);
        let order: Vec<Order> = (0..3).map(|_| two.next().1).collect();
        assert_eq!(order, [Order::Arm, Order::Abort, Order::Disarm]);
        two.give(0, &[]);
        let (number, reply) = two.answered[0].recv().unwrap();
        assert!(
            number == 3 && !reply.accepted,
            "the way to the park pose is older than the abort: {reply:?}"
        );
        two.end();
    }

    #[test]
    fn a_stop_from_the_future_or_from_no_time_keeps_no_later_order_away() {
        let stops = Stops::default();
        let given = |order, boot_s| Given { number: 1, order, boot_s };
        let passes = |order, boot_s, now_s| stops.pass(&given(order, boot_s), now_s, || ()).is_some();
        for odd in [f64::INFINITY, f64::NAN, 1e9] {
            stops.note(&[given(Order::Abort, odd)], 50.0);
            assert!(passes(Order::Abort, odd, 50.0));
        }
        assert!(!passes(Order::Arm, 49.9, 50.0));
        assert!(passes(Order::Arm, 50.1, 50.2));
        // An earlier stop that comes late takes nothing back.
        stops.note(&[given(Order::Pause, 1.0)], 51.0);
        assert!(!passes(Order::Step, 49.9, 51.0));
    }

    #[test]
    fn after_a_release_nothing_older_is_done_and_what_takes_away_counts_always() {
        let given = |order, boot_s| Given { number: 1, order, boot_s };
        for ending in [
            Order::Release(cell_machine::orders::Channels::Both),
            Order::Recover(WayBack::Release),
            Order::Disarm,
        ] {
            let stops = Stops::default();
            stops.note(&[given(ending, 50.0), given(Order::Park, 60.0)], 61.0);
            let passes = |order| stops.pass(&given(order, 49.0), 61.0, || ()).is_some();
            let id = || "a".to_string();
            let agreed = Order::Approve { id: id(), plan: Some(1) };
            for order in [
                Order::Arm,
                agreed,
                Order::Release(cell_machine::orders::Channels::A),
                Order::Recover(WayBack::Place),
            ] {
                assert!(!passes(order.clone()), "{order:?}");
            }
            for order in [Order::Abort, Order::Pause, Order::Reject(id()), Order::Cancel(id())] {
                assert!(passes(order.clone()), "{order:?}");
            }
        }
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
