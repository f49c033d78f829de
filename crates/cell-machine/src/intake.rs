//! Judgement of an order before it is decided: its age, its client, and stops that came before it; and
//! whether orders reach the cell at all.
//!
//! In: when an order was given and whether its client is still there, how long each source of orders has
//! been silent. Out: refusals, and what is new. Pure: times are arguments, s since this computer
//! started (sleep included), so that no clock setting makes an order young again. The daemon's shell and
//! the closed loop call the same functions.

use crate::orders::{Order, Reply, Stale};
use cell_values::time::Duration;
use serde::{Deserialize, Serialize};

/// Maximum age of an order, s: later, its sender no longer expects it to happen.
pub const COUNTS_FOR_S: f64 = 10.0;

/// Clocks of one computer agree; an order from further ahead was not stamped on this one, s.
const AHEAD_S: f64 = 1.0;

/// An armed cell stops when orders have not reached it for so long.
pub const REACH_WITHIN: Duration = Duration::from_secs(1);

/// A gap between two turns of the loop that is longer means that celld itself was held up.
pub const HELD_UP_AFTER: Duration = Duration::from_secs(1);

/// Where an order comes from, at the moment of its decision.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// Time since it was given, s; a number from outside may be any, or none.
    pub age_s: f64,
    /// The client that gave it still waits for the answer.
    pub client_waits: bool,
}

impl Origin {
    /// An order that is given now by celld itself.
    pub const OWN: Origin = Origin { age_s: 0.0, client_waits: true };
}

/// Why an order is not carried out whatever the cell is doing; `None`: the cell decides. Orders that only
/// stop always count.
pub fn refusal(order: &Order, origin: Origin) -> Option<Reply> {
    if order.only_stops() { None } else { stale(origin) }
}

/// Why something that does more than stop is not done: nobody waits for it, or it is too old.
pub fn stale(origin: Origin) -> Option<Reply> {
    if !origin.client_waits {
        let reply =
            Reply::refuse("nothing was done: the client that gave this order ended before it was decided");
        return Some(Reply { stale: Some(Stale::ClientEnded), ..reply });
    }
    // Written so that an age that is no number is too old.
    let counts = (-AHEAD_S..=COUNTS_FOR_S).contains(&origin.age_s);
    (!counts).then(|| {
        let age_s = origin.age_s;
        let reply = Reply::refuse(format!(
            "nothing was done: this order was given {age_s:.0} s ago and counts for {COUNTS_FOR_S:.0} s; look at \
             the cell, then give it again"
        ));
        Reply { stale: Some(Stale::TooOld), ..reply }
    })
}

/// The answer to an order that an earlier or simultaneous stop or release has overtaken.
pub fn overtaken() -> Reply {
    Reply::refuse(
        "nothing was done: a stop or a release was ordered after this order was given; look at the cell, then \
         give it again",
    )
}

/// When the last order was given that ends a person's leave to move, s since this computer started.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LastStop(Option<f64>);

impl LastStop {
    /// Notes an order given at `given_s`, if it is one that ends leave.
    pub fn note(&mut self, order: &Order, given_s: f64, now_s: f64) {
        if !order.ends_leave() {
            return;
        }
        // A stop from the future keeps no later order away; `min` gives `now_s` for no number.
        let at = given_s.min(now_s);
        if at > self.0.unwrap_or(f64::MIN) {
            self.0 = Some(at);
        }
    }

    /// True when an order given at `given_s` no longer counts: a stop was given after it.
    pub fn overtakes(&self, order: &Order, given_s: f64, now_s: f64) -> bool {
        !order.only_takes_away() && self.0.is_some_and(|stop| given_s.min(now_s) < stop)
    }

    /// The same for an order that comes together with the last stop: one of the same moment does not
    /// count either, for the stop is decided first.
    pub fn overtakes_together(&self, order: &Order, given_s: f64, now_s: f64) -> bool {
        let ends = order.only_takes_away() || order.ends_leave();
        !ends && self.0.is_some_and(|stop| given_s.min(now_s) <= stop)
    }
}

/// Why orders do not reach the cell.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Serialize, Deserialize)]
pub enum Unreachable {
    /// The folder that orders are left in was removed, renamed or replaced.
    #[error("the folder {0} was removed or replaced")]
    FolderGone(String),
    /// It cannot be read.
    #[error("orders in {0} cannot be read: {1}")]
    Unreadable(String, String),
    /// The thread that takes them in does not answer.
    #[error("{0} does not answer")]
    Silent(String),
}

/// Watches whether orders reach the cell.
#[derive(Clone, Debug, Default)]
pub struct Reach {
    cut_off: bool,
}

impl Reach {
    /// `silent`: for how long no orders could be taken in, and why, of the source that is worst off. What is
    /// new for the machine: that orders do not reach the cell, or do again.
    pub fn judge(&mut self, silent: Option<(Duration, Unreachable)>) -> Option<Option<Unreachable>> {
        let fault = silent.filter(|(since, _)| *since > REACH_WITHIN).map(|(_, fault)| fault);
        let changed = fault.is_some() != self.cut_off;
        self.cut_off = fault.is_some();
        changed.then_some(fault)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::gripper_types::Channels;
    use crate::orders::WayBack;

    const STOPS: [Order; 3] = [Order::Abort, Order::Disarm, Order::Pause];

    #[test]
    fn old_orders_and_orders_of_ended_clients_are_refused_and_stops_always_count() {
        let old = [COUNTS_FOR_S + 0.1, -AHEAD_S - 0.1, f64::NAN, f64::INFINITY, 1e308];
        let origins = old.map(|age_s| Origin { age_s, client_waits: true });
        let gone = Origin { age_s: 0.1, client_waits: false };
        for origin in origins.into_iter().chain([gone]) {
            let moves = [Order::Arm, Order::Release(Channels::Both), Order::Recover(WayBack::Show)];
            for order in moves.into_iter().chain([Order::Cancel("a".into())]) {
                let reply = refusal(&order, origin).expect("refused");
                assert!(!reply.accepted && reply.message.starts_with("nothing was done"), "{reply:?}");
            }
            assert!(STOPS.iter().all(|order| refusal(order, origin).is_none()), "{origin:?}");
        }
        let young = Origin { age_s: COUNTS_FOR_S, client_waits: true };
        assert_eq!(refusal(&Order::Arm, young), None);
    }

    #[test]
    fn a_stop_overtakes_what_was_given_before_it() {
        let mut last = LastStop::default();
        assert!(!last.overtakes(&Order::Arm, 1.0, 50.0));
        last.note(&Order::Pause, 20.0, 50.0);
        last.note(&Order::Arm, 30.0, 50.0);
        last.note(&Order::Abort, 10.0, 50.0);
        assert!(last.overtakes(&Order::Arm, 19.9, 50.0));
        assert!(!last.overtakes(&Order::Arm, 20.0, 50.0) && last.overtakes_together(&Order::Arm, 20.0, 50.0));
        assert!(!last.overtakes_together(&Order::Arm, 20.1, 50.0));
        for order in STOPS.into_iter().chain([Order::Reject("a".into()), Order::Cancel("a".into())]) {
            assert!(!last.overtakes(&order, 1.0, 50.0) && !last.overtakes_together(&order, 1.0, 50.0));
        }
    }

    #[test]
    fn a_stop_from_the_future_or_from_no_time_keeps_no_later_order_away() {
        for odd in [f64::INFINITY, f64::NAN, 1e9] {
            let mut last = LastStop::default();
            last.note(&Order::Abort, odd, 50.0);
            assert!(last.overtakes(&Order::Arm, 49.9, 50.0), "{odd}");
            assert!(!last.overtakes(&Order::Arm, 50.1, 50.2), "{odd}");
        }
    }

    #[test]
    fn every_order_that_ends_leave_overtakes_a_release() {
        for ending in [Order::Release(Channels::Both), Order::Recover(WayBack::Release), Order::Disarm] {
            let mut last = LastStop::default();
            last.note(&ending, 50.0, 61.0);
            for order in [Order::Arm, Order::Release(Channels::A), Order::Recover(WayBack::Place)] {
                assert!(last.overtakes(&order, 49.0, 61.0), "{order:?}");
            }
        }
    }

    #[test]
    fn reach_is_lost_after_a_second_and_reported_once() {
        let mut reach = Reach::default();
        let gone = |ms| Some((Duration::from_millis(ms), Unreachable::FolderGone("commands".into())));
        assert!(reach.judge(gone(1000)).is_none());
        assert!(matches!(reach.judge(gone(1001)), Some(Some(_))));
        assert!(reach.judge(gone(1100)).is_none());
        assert_eq!(reach.judge(None), Some(None));
        assert!(reach.judge(None).is_none());
    }
}
