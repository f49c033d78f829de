//! What a link session has to hand out: bytes, events, and the wish to have its link dropped.
//!
//! In: pushes by the session. Out: polls by its driver. Shared so that all sessions hand out alike.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Results of a session that wait to be polled.
#[derive(Debug, Deserialize, Serialize)]
pub struct Outbox<E> {
    transmit: VecDeque<Vec<u8>>,
    events: VecDeque<E>,
    close: bool,
}

impl<E> Default for Outbox<E> {
    fn default() -> Outbox<E> {
        Outbox { transmit: VecDeque::new(), events: VecDeque::new(), close: false }
    }
}

impl<E> Outbox<E> {
    /// Bytes for the peer.
    pub fn send(&mut self, bytes: Vec<u8>) {
        self.transmit.push_back(bytes);
    }

    /// Takes back what was pushed last and is not polled yet; false if nothing is left to take back.
    #[must_use]
    pub fn take_back(&mut self) -> bool {
        self.transmit.pop_back().is_some()
    }

    /// Something happened.
    pub fn report(&mut self, event: E) {
        self.events.push_back(event);
    }

    /// The link should be dropped and made anew; nothing more is sent on it.
    pub fn close(&mut self) {
        self.transmit.clear();
        self.close = true;
    }

    /// A new link starts with nothing to send; events of the old one are still to be read.
    pub fn reset_link(&mut self) {
        self.transmit.clear();
        self.close = false;
    }

    /// The next bytes to send.
    pub fn poll_transmit(&mut self) -> Option<Vec<u8>> {
        self.transmit.pop_front()
    }

    /// The next event.
    pub fn poll_event(&mut self) -> Option<E> {
        self.events.pop_front()
    }

    /// True once if the link should be dropped.
    pub fn poll_close(&mut self) -> bool {
        std::mem::take(&mut self.close)
    }
}

/// The earlier of two times to wake up at.
pub fn earlier<T: Ord + Copy, R>(a: Option<(T, R)>, b: Option<(T, R)>) -> Option<(T, R)> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if b.0 < a.0 { b } else { a }),
        (a, b) => a.or(b),
    }
}
