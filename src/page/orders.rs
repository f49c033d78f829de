//! Orders from the page on their way to the machine, beside those of the state folder.
//!
//! In: orders with who gives them. Out: the same to the thread that takes orders in, numbered; the machine's
//! answers back to who waits for them. An order that was not taken in time does not count any more, as with
//! command files (`jobs/command`), unless it only stops.

use crate::daemon::store::Orders;
use crate::jobs::command::COUNTS_FOR_S;
use cell_machine::orders::{Order, Reply};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// Orders that wait to be taken in; they are taken twenty times a second.
const QUEUE: usize = 32;

/// Numbers of the page's orders begin here: those of the state folder count from 1.
const FIRST: u64 = 1 << 32;

/// How long the machine may take to answer: the arm may have to stop first.
const ANSWER_WITHIN: Duration = Duration::from_secs(15);

/// An order on its way.
struct Given {
    order: Order,
    by: String,
    at: Instant,
    answer: oneshot::Sender<Reply>,
}

/// The page's end.
#[derive(Clone)]
pub struct Desk(SyncSender<Given>);

impl Desk {
    /// Gives an order and waits for the answer.
    pub async fn order(&self, order: Order, by: String) -> Reply {
        let (answer, answered) = oneshot::channel();
        match self.0.try_send(Given { order, by, at: Instant::now(), answer }) {
            Ok(()) => {}
            Err(TrySendError::Full(_)) => return Reply::refuse("too many orders wait to be taken in"),
            Err(TrySendError::Disconnected(_)) => return Reply::refuse("celld is ending"),
        }
        match tokio::time::timeout(ANSWER_WITHIN, answered).await {
            Ok(Ok(reply)) => reply,
            Ok(Err(_)) => Reply::refuse("celld takes no orders yet, or is ending; nothing was done"),
            Err(_) => Reply::refuse(format!(
                "no answer within {} s; it is not known whether the order was carried out, see the status",
                ANSWER_WITHIN.as_secs()
            )),
        }
    }
}

/// Orders of the state folder and of the page.
pub struct WithPage<O> {
    state: O,
    page: Receiver<Given>,
    last: u64,
    unanswered: Vec<(u64, Given)>,
}

/// The page's desk, and the end at which its orders arrive together with those of the state folder.
pub fn desk<O: Orders>() -> (Desk, impl FnOnce(O) -> WithPage<O>) {
    let (sender, page) = sync_channel(QUEUE);
    let join = move |state| WithPage { state, page, last: FIRST, unanswered: Vec::new() };
    (Desk(sender), join)
}

impl<O: Orders> Orders for WithPage<O> {
    fn take(&mut self) -> Vec<(u64, Order)> {
        // The disk first, which may take its time: the age of the page's orders counts after it.
        let mut orders = self.state.take();
        self.unanswered.retain(|(_, given)| !given.answer.is_closed());
        while let Ok(given) = self.page.try_recv() {
            if given.at.elapsed().as_secs_f64() > COUNTS_FOR_S && !given.order.only_stops() {
                let why = "nothing was done: the order was not taken in in time; look at the cell, then give it again";
                let _ = given.answer.send(Reply::refuse(why));
                continue;
            }
            self.last += 1;
            orders.push((self.last, given.order.clone()));
            self.unanswered.push((self.last, given));
        }
        // Of what came together, what stops is decided last: an order to arm that lay in the folder does not
        // undo a disarming that a person was told of.
        orders.sort_by_key(|(_, order)| order.only_stops());
        orders
    }

    fn reply(&mut self, number: u64, reply: &Reply) {
        let Some(index) = self.unanswered.iter().position(|(open, _)| *open == number) else {
            return self.state.reply(number, reply);
        };
        let (_, Given { order, by, answer, .. }) = self.unanswered.swap_remove(index);
        if reply.accepted {
            tracing::info!(?order, by, "ordered: {}", reply.message);
        } else {
            tracing::warn!(?order, by, "order refused: {}", reply.message);
        }
        // Who gave it may have gone.
        let _ = answer.send(self.state.remember(&order, reply));
    }

    fn remember(&self, order: &Order, reply: &Reply) -> Reply {
        self.state.remember(order, reply)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A state folder with one order.
    struct Folder(Vec<(u64, Order)>, Vec<(u64, Reply)>);

    impl Orders for Folder {
        fn take(&mut self) -> Vec<(u64, Order)> {
            std::mem::take(&mut self.0)
        }

        fn reply(&mut self, number: u64, reply: &Reply) {
            self.1.push((number, reply.clone()));
        }

        fn remember(&self, order: &Order, reply: &Reply) -> Reply {
            Reply { message: format!("{order:?}: {}", reply.message), ..reply.clone() }
        }
    }

    #[tokio::test]
    async fn each_answer_goes_where_its_order_came_from() {
        let (desk, join) = desk();
        let mut orders = join(Folder(vec![(1, Order::Arm)], Vec::new()));
        let asked = tokio::spawn(async move { desk.order(Order::Pause, "anna".into()).await });
        let mut taken = Vec::new();
        while taken.len() < 2 {
            taken.extend(orders.take());
            tokio::task::yield_now().await;
        }
        let of_page = taken.iter().find(|(_, order)| *order == Order::Pause).expect("the page's").0;
        orders.reply(of_page, &Reply::accept("paused"));
        orders.reply(1, &Reply::refuse("not armed"));
        assert_eq!(asked.await.unwrap(), Reply::accept("Pause: paused"), "what is confirmed is remembered");
        assert_eq!(orders.state.1, [(1, Reply::refuse("not armed"))]);
    }

    #[tokio::test]
    async fn what_stops_is_decided_after_what_came_with_it() {
        let (desk, join) = desk();
        let mut orders = join(Folder(vec![(1, Order::Arm), (2, Order::Abort)], Vec::new()));
        for order in [Order::Disarm, Order::Resume] {
            let (answer, answered) = oneshot::channel();
            desk.0.try_send(Given { order, by: "anna".into(), at: Instant::now(), answer }).unwrap();
            std::mem::forget(answered);
        }
        let taken: Vec<Order> = orders.take().into_iter().map(|(_, order)| order).collect();
        assert_eq!(taken, [Order::Arm, Order::Resume, Order::Abort, Order::Disarm]);
    }

    #[tokio::test]
    async fn an_order_that_lay_too_long_moves_nothing_and_a_stop_stops() {
        let (desk, join) = desk();
        let mut orders = join(Folder(Vec::new(), Vec::new()));
        let old = Instant::now().checked_sub(Duration::from_secs(60)).expect("an uptime of a minute");
        let mut answers = Vec::new();
        for order in [Order::Arm, Order::Abort] {
            let (answer, answered) = oneshot::channel();
            desk.0.try_send(Given { order, by: "anna".into(), at: old, answer }).unwrap();
            answers.push(answered);
        }
        assert_eq!(orders.take().into_iter().map(|(_, order)| order).collect::<Vec<_>>(), [Order::Abort]);
        let reply = answers.remove(0).await.unwrap();
        assert!(!reply.accepted && reply.message.contains("nothing was done"), "{reply:?}");
        drop(orders);
        let ended = desk.order(Order::Abort, "anna".into()).await;
        assert!(!ended.accepted && ended.message.contains("ending"), "{ended:?}");
    }
}
