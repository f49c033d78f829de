//! Places for connections at a server: when all are taken, the one that has been silent longest goes.
//!
//! In: a connection, and a sign of life whenever its client has sent something or taken what it is sent.
//! Out: a [`Seat`], which is free again when it is dropped, and the order to leave it. Clients that open
//! connections and forget them thus shut out no other one, and memory and file handles have a bound. Who
//! only reads is not silent while data flows.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::task::{Context, Poll, Waker};
use std::time::Instant;

/// The places of a server.
#[derive(Debug)]
pub struct Seats {
    most: usize,
    opened: Instant,
    taken: Mutex<Vec<Weak<Seat>>>,
}

/// A connection's place. A sign of life takes no lock: who makes the frames gives one with each package.
#[derive(Debug)]
pub struct Seat {
    opened: Instant,
    /// Nanoseconds after `opened`.
    heard: AtomicU64,
    leaving: Mutex<Leaving>,
}

#[derive(Debug, Default)]
struct Leaving {
    leaves: bool,
    /// The task that reads.
    reader: Option<Waker>,
}

impl Seats {
    /// At most so many.
    pub fn new(most: usize) -> Seats {
        Seats { most, opened: Instant::now(), taken: Mutex::new(Vec::new()) }
    }

    /// A place for a connection just made.
    pub fn take(&self) -> Arc<Seat> {
        let seat =
            Seat { opened: self.opened, heard: AtomicU64::new(0), leaving: Mutex::new(Leaving::default()) };
        seat.heard();
        let seat = Arc::new(seat);
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        taken.retain(|seat| seat.strong_count() > 0);
        let mut here: Vec<Arc<Seat>> = taken.iter().filter_map(Weak::upgrade).collect();
        here.sort_by_key(|seat| seat.heard.load(Ordering::Relaxed));
        let too_many = (here.len() + 1).saturating_sub(self.most);
        here.drain(..too_many).for_each(|silent| silent.leave());
        *taken = here.iter().chain([&seat]).map(Arc::downgrade).collect();
        seat
    }
}

impl Seat {
    fn leaving(&self) -> MutexGuard<'_, Leaving> {
        self.leaving.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn leave(&self) {
        let mut leaving = self.leaving();
        leaving.leaves = true;
        if let Some(reader) = leaving.reader.take() {
            reader.wake();
        }
    }

    /// Something has passed, either way.
    pub fn heard(&self) {
        let after = u64::try_from(self.opened.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.heard.store(after, Ordering::Relaxed);
    }

    /// Ready once the connection has to end; the task that reads is woken then.
    pub fn poll_leave(&self, context: &mut Context<'_>) -> Poll<()> {
        let mut leaving = self.leaving();
        leaving.reader = Some(context.waker().clone());
        if leaving.leaves { Poll::Ready(()) } else { Poll::Pending }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn leaves(seat: &Seat) -> bool {
        seat.leaving().leaves
    }

    #[test]
    fn the_longest_silent_one_leaves_and_only_when_all_are_taken() {
        let seats = Seats::new(2);
        let (first, second) = (seats.take(), seats.take());
        first.heard();
        let third = seats.take();
        assert!(!leaves(&first) && leaves(&second) && !leaves(&third));
        drop(first);
        let fourth = seats.take();
        assert!(!leaves(&third) && !leaves(&fourth), "one was free");
        let fifth = seats.take();
        assert!(leaves(&third) && !leaves(&fourth) && !leaves(&fifth));
    }
}
