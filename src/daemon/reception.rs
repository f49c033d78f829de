//! Orders while celld starts: who wants to be signed in at the page is, everything else has to wait.
//!
//! In: the sources of orders, before there is a machine to carry any out. Out: the same sources again once
//! there is. Without it the page could not be opened while the robot is switched off, which is when people
//! want to see what is missing.

use crate::daemon::intake::{Orders, Sources};
use crate::jobs::sources::Stops;
use cell_edge::clock::boot_now_s;
use cell_machine::orders::Reply;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often orders are looked for.
const EVERY: Duration = Duration::from_millis(5);

/// See the module.
pub struct Reception {
    over: Arc<AtomicBool>,
    thread: JoinHandle<Sources>,
}

impl Reception {
    /// Takes orders in from now on: a source signs people in by itself, and every order is refused.
    pub fn open(mut sources: Sources) -> Reception {
        let over = Arc::new(AtomicBool::new(false));
        let ended = over.clone();
        let thread = std::thread::spawn(move || {
            while !ended.load(Ordering::Relaxed) {
                let stops = &sources.stops;
                sources.orders.iter_mut().for_each(|source| refuse(&mut **source, stops));
                std::thread::park_timeout(EVERY);
            }
            sources
        });
        Reception { over, thread }
    }

    /// The sources of orders.
    ///
    /// # Errors
    /// The thread has panicked.
    pub fn close(self) -> Result<Sources, String> {
        self.over.store(true, Ordering::Relaxed);
        self.thread.thread().unpark();
        self.thread.join().map_err(|_| "a defect of celld: the intake of orders has ended".to_string())
    }
}

/// A stop is noted all the same: an older order that comes to light after the start does not count.
fn refuse(source: &mut dyn Orders, stops: &Stops) {
    let taken = source.take().orders;
    stops.note(&taken, boot_now_s());
    for given in taken {
        let why = "celld is starting and takes no orders yet; `celld doctor` says what is missing";
        source.reply(given.number, &Reply::refuse(why));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::sources::{Batch, Given};
    use cell_machine::orders::Order;
    use std::sync::mpsc::{Sender, channel};

    /// One order, and where its answer goes.
    struct One(Option<Given>, Sender<(u32, Reply)>);

    impl Orders for One {
        fn task(&self) -> &'static str {
            "orders of a test"
        }

        fn take(&mut self) -> Batch {
            Batch { orders: self.0.take().into_iter().collect(), fault: None }
        }

        fn reply(&mut self, number: u32, reply: &Reply) {
            let _ = self.1.send((number, reply.clone()));
        }
    }

    #[test]
    fn an_order_of_the_start_is_refused_and_the_source_is_given_back() {
        let (sender, answers) = channel();
        let arm = Given { number: 7, order: Order::Arm, boot_s: 100.0, client_waits: Arc::new(|| true) };
        let reception = Reception::open(Sources::of(vec![Box::new(One(Some(arm), sender))]));
        let (number, reply) = answers.recv().unwrap();
        assert!(number == 7 && !reply.accepted && reply.message.contains("starting"), "{reply:?}");
        let mut orders = reception.close().unwrap();
        assert!(orders.orders[0].take().orders.is_empty());
    }
}
