//! Orders while celld starts: who wants to be signed in at the page is, everything else has to wait.
//!
//! In: the source of orders, before there is a machine to carry any out. Out: the same source again once
//! there is. Without it the page could not be opened while the robot is switched off, which is when people
//! want to see what is missing.

use crate::daemon::store::Orders;
use cell_machine::orders::Reply;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often orders are looked for.
const EVERY: Duration = Duration::from_millis(50);

/// See the module.
pub struct Reception<O> {
    over: Arc<AtomicBool>,
    thread: JoinHandle<O>,
}

impl<O: Orders> Reception<O> {
    /// Takes orders in from now on: the source signs people in by itself, and every order is refused.
    pub fn open(mut orders: O) -> Reception<O> {
        let over = Arc::new(AtomicBool::new(false));
        let ended = over.clone();
        let thread = std::thread::spawn(move || {
            while !ended.load(Ordering::Relaxed) {
                for (number, _) in orders.take() {
                    let why =
                        "celld is starting and takes no orders yet; `celld doctor` says what is missing";
                    orders.reply(number, &Reply::refuse(why));
                }
                std::thread::park_timeout(EVERY);
            }
            orders
        });
        Reception { over, thread }
    }

    /// The source of orders.
    ///
    /// # Errors
    /// The thread has panicked.
    pub fn close(self) -> Result<O, String> {
        self.over.store(true, Ordering::Relaxed);
        self.thread.thread().unpark();
        self.thread.join().map_err(|_| "a defect of celld: the intake of orders has ended".to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_machine::orders::Order;
    use std::sync::mpsc::{Sender, channel};

    /// One order, and where its answer goes.
    struct One(Option<(u64, Order)>, Sender<(u64, Reply)>);

    impl Orders for One {
        fn take(&mut self) -> Vec<(u64, Order)> {
            self.0.take().into_iter().collect()
        }

        fn reply(&mut self, number: u64, reply: &Reply) {
            let _ = self.1.send((number, reply.clone()));
        }
    }

    #[test]
    fn an_order_of_the_start_is_refused_and_the_source_is_given_back() {
        let (sender, answers) = channel();
        let reception = Reception::open(One(Some((7, Order::Arm)), sender));
        let (number, reply) = answers.recv().unwrap();
        assert!(number == 7 && !reply.accepted && reply.message.contains("starting"), "{reply:?}");
        let mut orders = reception.close().unwrap();
        assert!(orders.take().is_empty());
    }
}
