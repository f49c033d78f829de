//! Orders of any source (the folder of commands, the page) on their way to the machine.
//!
//! In: the orders of one look at a source, when each was given. Out: those that count, stops first; an order
//! to do something that was given before a stop or a release does not count after it, whatever source either
//! has. Times are arguments: daemon and closed loop call the same.

use cell_machine::intake::{LastStop, Origin, Unreachable, overtaken};
use cell_machine::orders::{Order, Reply};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The lower bits of an order's number are its source's own, the upper ones name the source.
const SOURCE_BITS: u32 = 32;

/// The machine's number of an order that has the number `own` in the source `index`.
pub fn number_of(index: usize, own: u32) -> u64 {
    (index as u64) << SOURCE_BITS | u64::from(own)
}

/// Source and own number of an order.
pub fn source_of(number: u64) -> (usize, u32) {
    (usize::try_from(number >> SOURCE_BITS).unwrap_or(usize::MAX), number as u32)
}

/// The answer to an order that is still open when celld shuts down.
pub const OPEN_AT_THE_END: &str =
    "celld is shutting down; check the status to see whether the order was carried out";

/// Whether the client that gave an order still waits for its answer.
pub type ClientWaits = Arc<dyn Fn() -> bool + Send + Sync>;

/// An order that was given.
#[derive(Clone)]
pub struct Given {
    /// Of its source: from 1, without repetition.
    pub number: u32,
    /// What is ordered.
    pub order: Order,
    /// When it was given, s since the machine started. May come from outside: any number or none.
    pub boot_s: f64,
    /// Judged when the order is decided.
    pub client_waits: ClientWaits,
}

impl Given {
    /// The order's origin at `now_s` since the machine started.
    pub fn origin(&self, now_s: f64) -> Origin {
        Origin { age_s: now_s - self.boot_s, client_waits: (self.client_waits)() }
    }
}

/// What a look at a source brought.
#[derive(Default)]
pub struct Batch {
    /// Orders since the last look.
    pub orders: Vec<Given>,
    /// Why not every order could be taken.
    pub fault: Option<Unreachable>,
}

/// The last order that ended a person's leave to move; of all sources.
#[derive(Default)]
pub struct Stops(Mutex<LastStop>);

impl Stops {
    fn last(&self) -> MutexGuard<'_, LastStop> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes those of these orders that end leave, before any of them is sent on.
    pub fn note(&self, given: &[Given], now_s: f64) {
        let mut last = self.last();
        given.iter().for_each(|given| last.note(&given.order, given.boot_s, now_s));
    }

    /// Everything that a look at a source brought, stops first: `send` gets what counts and returns false
    /// when there is nobody to send to, `refuse` gets the answer to what does not count. False when not
    /// everything could be sent.
    pub fn hand_on(
        &self,
        mut taken: Vec<Given>,
        now_s: impl Fn() -> f64,
        mut send: impl FnMut(&Given) -> bool,
        mut refuse: impl FnMut(u32, Reply),
    ) -> bool {
        self.note(&taken, now_s());
        let together = taken.iter().any(|given| given.order.ends_leave());
        taken.sort_by_key(|given| !given.order.only_stops());
        taken.iter().all(|given| match self.pass(given, together, now_s(), || send(given)) {
            Some(sent) => sent,
            None => {
                refuse(given.number, overtaken());
                true
            }
        })
    }

    /// Sends an order on, unless a stop has overtaken it; it is decided and sent in one step, so that no
    /// stop comes between. `together`: a stop came in the same batch. `None`: it does not count.
    fn pass<T>(&self, given: &Given, together: bool, now_s: f64, send: impl FnOnce() -> T) -> Option<T> {
        let last = self.last();
        let overtaken = match together {
            true => last.overtakes_together(&given.order, given.boot_s, now_s),
            false => last.overtakes(&given.order, given.boot_s, now_s),
        };
        (!overtaken).then(send)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_names_its_source() {
        let number = number_of(3, 70_000);
        assert_eq!(source_of(number), (3, 70_000));
        assert_eq!(source_of(number_of(0, 1)), (0, 1));
    }

    #[test]
    fn stops_are_handed_on_first_and_what_was_given_before_them_is_refused() {
        let given = |number, order, boot_s| Given { number, order, boot_s, client_waits: Arc::new(|| true) };
        let taken = vec![
            given(1, Order::Arm, 1.0),
            given(2, Order::Abort, 2.0),
            given(3, Order::Resume, 3.0),
            given(4, Order::Step, 2.0),
        ];
        let (stops, mut sent, mut refused) = (Stops::default(), Vec::new(), Vec::new());
        let whole = stops.hand_on(
            taken,
            || 4.0,
            |given| {
                sent.push(given.number);
                true
            },
            |number, reply| refused.push((number, reply)),
        );
        assert!(whole);
        assert_eq!(sent, [2, 3]);
        assert_eq!(refused, [(1, overtaken()), (4, overtaken())]);
        assert!(!stops.hand_on(vec![given(5, Order::Arm, 5.0)], || 6.0, |_| false, |_, _| {}));
    }
}
