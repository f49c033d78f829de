//! Orders from the page on their way to the machine.
//!
//! In: orders with who gives them. Out: the same to a thread that takes them in beside those of the state
//! folder and waits for no disk; the machine's answers back to who waits for them. An order that was not
//! taken in time does not count any more, as with command files (`jobs/command`), unless it only stops. What
//! a person has confirmed is remembered before it is answered.

use crate::daemon::gripper_memory::GripperMemory;
use crate::daemon::intake::{self, Orders};
use crate::jobs::command::COUNTS_FOR_S;
use cell_edge::clock::boot_now_s;
use cell_machine::orders::{Order, Reply};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::Duration;
use tokio::sync::oneshot;

/// Orders that wait to be taken in; they are taken twenty times a second.
const QUEUE: usize = 32;

/// How long the machine may take to answer: the arm may have to stop first.
const ANSWER_WITHIN: Duration = Duration::from_secs(15);

/// An order on its way.
struct Given {
    order: Order,
    by: String,
    boot_s: f64,
    answer: oneshot::Sender<Reply>,
}

/// The page's end.
#[derive(Clone)]
pub struct OrderSender(SyncSender<Given>);

impl OrderSender {
    /// Gives an order and waits for the answer.
    pub async fn order(&self, order: Order, by: String) -> Reply {
        let (answer, answered) = oneshot::channel();
        match self.0.try_send(Given { order, by, boot_s: boot_now_s(), answer }) {
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

/// The end at which the page's orders arrive.
pub struct PageOrders {
    page: Receiver<Given>,
    memory: GripperMemory,
    last: u32,
    unanswered: Vec<(u32, Given)>,
}

/// Where the page gives its orders, and the end at which its orders arrive; `memory`: where a confirmed
/// gripper is remembered.
pub fn order_channel(memory: GripperMemory) -> (OrderSender, PageOrders) {
    let (sender, page) = sync_channel(QUEUE);
    (OrderSender(sender), PageOrders { page, memory, last: 0, unanswered: Vec::new() })
}

impl Orders for PageOrders {
    fn task(&self) -> &'static str {
        "the intake of the page's orders"
    }

    fn take(&mut self) -> Vec<intake::Given> {
        let (mut orders, now_s) = (Vec::new(), boot_now_s());
        self.unanswered.retain(|(_, given)| !given.answer.is_closed());
        while let Ok(given) = self.page.try_recv() {
            if now_s - given.boot_s > COUNTS_FOR_S && !given.order.only_stops() {
                let why = "nothing was done: the order was not taken in in time; look at the cell, then give it again";
                let _ = given.answer.send(Reply::refuse(why));
                continue;
            }
            self.last += 1;
            orders.push(intake::Given {
                number: self.last,
                order: given.order.clone(),
                boot_s: given.boot_s,
            });
            self.unanswered.push((self.last, given));
        }
        orders
    }

    fn reply(&mut self, number: u32, reply: &Reply) {
        let Some(index) = self.unanswered.iter().position(|(open, _)| *open == number) else { return };
        let (_, Given { order, by, answer, .. }) = self.unanswered.swap_remove(index);
        if reply.accepted {
            tracing::info!(?order, by, "ordered: {}", reply.message);
        } else {
            tracing::warn!(?order, by, "order refused: {}", reply.message);
        }
        let (memory, reply) = (self.memory.clone(), reply.clone());
        if GripperMemory::concerns(&order, &reply) {
            // The disk may take its time: the next order does not wait for it.
            std::thread::spawn(move || answer.send(memory.remember(&order, &reply)));
        } else {
            // Who gave it may have gone.
            let _ = answer.send(reply);
        }
    }
}

impl Drop for PageOrders {
    /// What is with the machine may still be carried out, or was.
    fn drop(&mut self) {
        for (_, given) in self.unanswered.drain(..) {
            let why = "celld ends; it is not known whether the order was carried out, see the status";
            let _ = given.answer.send(Reply::refuse(why));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::state::StateFolder;

    fn page() -> (tempfile::TempDir, OrderSender, PageOrders) {
        let folder = tempfile::tempdir().unwrap();
        let memory = GripperMemory::new(&StateFolder::new(folder.path()), "gripper:502".into());
        let (order_sender, orders) = order_channel(memory);
        (folder, order_sender, orders)
    }

    async fn taken(orders: &mut PageOrders) -> intake::Given {
        loop {
            if let Some(given) = orders.take().pop() {
                return given;
            }
            tokio::task::yield_now().await;
        }
    }

    #[tokio::test]
    async fn an_answer_comes_back_and_a_confirmed_gripper_is_remembered_before() {
        let (folder, order_sender, mut orders) = page();
        let requested = {
            let order_sender = order_sender.clone();
            tokio::spawn(async move { order_sender.order(Order::Pause, "anna".into()).await })
        };
        let given = taken(&mut orders).await;
        assert_eq!((given.number, given.order), (1, Order::Pause));
        orders.reply(1, &Reply::accept("paused"));
        assert_eq!(requested.await.unwrap(), Reply::accept("paused"));

        let requested =
            tokio::spawn(async move { order_sender.order(Order::ConfirmGripper, "anna".into()).await });
        let given = taken(&mut orders).await;
        orders.reply(given.number, &Reply::accept("confirmed"));
        assert_eq!(requested.await.unwrap(), Reply::accept("confirmed"));
        assert!(StateFolder::new(folder.path()).gripper_confirmed("gripper:502"), "read back from the disk");
    }

    #[tokio::test]
    async fn an_order_that_lay_too_long_moves_nothing_and_a_stop_stops() {
        let (_folder, order_sender, mut orders) = page();
        let old = boot_now_s() - 60.0;
        let mut answers = Vec::new();
        for order in [Order::Arm, Order::Abort] {
            let (answer, answered) = oneshot::channel();
            order_sender.0.try_send(Given { order, by: "anna".into(), boot_s: old, answer }).unwrap();
            answers.push(answered);
        }
        assert_eq!(orders.take().into_iter().map(|given| given.order).collect::<Vec<_>>(), [Order::Abort]);
        let reply = answers.remove(0).await.unwrap();
        assert!(!reply.accepted && reply.message.contains("nothing was done"), "{reply:?}");
        drop(orders);
        let open = answers.remove(0).await.unwrap();
        assert!(!open.accepted && open.message.contains("not known"), "{open:?}");
        let ended = order_sender.order(Order::Abort, "anna".into()).await;
        assert!(!ended.accepted && ended.message.contains("ending"), "{ended:?}");
    }
}
