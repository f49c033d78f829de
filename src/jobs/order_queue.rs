//! Orders that wait to be taken in, of people at the page.
//!
//! In: orders, each with its session and where the answer goes. Out: all that wait, stops first. Stops have
//! a queue of their own: repeated stops of one session and kind share a place and an answer, so there is
//! always room. Pure.

use cell_machine::orders::{Order, Reply};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Orders other than stops that may wait.
pub const QUEUE: usize = 32;

/// Who gives an order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OrderedBy {
    /// As the log names the person.
    pub name: String,
    /// The session; no secret.
    pub session: String,
}

/// An order that waits.
pub struct Waiting<A> {
    /// What is ordered.
    pub order: Order,
    /// By whom.
    pub by: OrderedBy,
    /// When, s since the machine started.
    pub boot_s: f64,
    /// Lowered with the request.
    pub open: Arc<AtomicBool>,
    /// Where the answer goes.
    pub answers: Vec<A>,
}

/// The queue. See the module.
pub struct OrderQueue<A> {
    stops: Vec<Waiting<A>>,
    others: VecDeque<Waiting<A>>,
    closed: bool,
}

impl<A> Default for OrderQueue<A> {
    fn default() -> OrderQueue<A> {
        OrderQueue { stops: Vec::new(), others: VecDeque::new(), closed: false }
    }
}

impl<A> OrderQueue<A> {
    /// Takes an order in.
    ///
    /// # Errors
    /// The answer, where there is no room for it, or the end has come.
    pub fn put(&mut self, mut waiting: Waiting<A>) -> Result<(), Reply> {
        if self.closed {
            return Err(Reply::refuse("celld is ending"));
        }
        let same =
            |waits: &&mut Waiting<A>| waits.order == waiting.order && waits.by.session == waiting.by.session;
        if let Some(waits) = self.stops.iter_mut().find(same) {
            waits.answers.append(&mut waiting.answers);
            return Ok(());
        }
        match waiting.order.only_stops() {
            true => self.stops.push(waiting),
            false if self.others.len() >= QUEUE => {
                return Err(Reply::refuse("too many orders wait to be taken in"));
            }
            false => self.others.push_back(waiting),
        }
        Ok(())
    }

    /// How many answers of stops, and how many other orders wait.
    pub fn waiting(&self) -> (usize, usize) {
        (self.stops.iter().map(|waits| waits.answers.len()).sum(), self.others.len())
    }

    /// Everything that waits, stops first.
    pub fn take(&mut self) -> Vec<Waiting<A>> {
        let stops = std::mem::take(&mut self.stops);
        stops.into_iter().chain(std::mem::take(&mut self.others)).collect()
    }

    /// Takes no orders from now on; everything that waits.
    pub fn close(&mut self) -> Vec<Waiting<A>> {
        self.closed = true;
        self.take()
    }
}
