//! Orders from the page on their way to the machine.
//!
//! In: orders with the person and the session that give them. Out: the same to a thread that takes them in
//! beside those of the state folder and waits for no disk; the machine's answers back. An order counts only
//! while its request is open. What a person has confirmed is remembered before it is answered.

use crate::daemon::gripper_memory::GripperMemory;
use crate::daemon::intake::Orders;
use crate::jobs::order_queue::{OrderQueue, OrderedBy, Waiting};
use crate::jobs::sources::{Batch, Given, OPEN_AT_THE_END};
use cell_edge::clock::boot_now_s;
use cell_machine::orders::{Order, Reply};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::oneshot;

/// How long the machine may take to answer: the arm may have to stop first.
const ANSWER_WITHIN: Duration = Duration::from_secs(15);

type Queue = OrderQueue<oneshot::Sender<Reply>>;

/// Lowers its flag when the request is over, however it ends.
struct OpenRequest(Arc<AtomicBool>);

impl Drop for OpenRequest {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

/// The page's end.
#[derive(Clone)]
pub struct OrderSender(Arc<Mutex<Queue>>);

fn queue(shared: &Mutex<Queue>) -> MutexGuard<'_, Queue> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl OrderSender {
    /// Gives an order and waits for the answer. Dropped before the order is decided, it withdraws the order,
    /// unless that only stops.
    pub async fn order(&self, order: Order, by: OrderedBy) -> Reply {
        let (answer, answered) = oneshot::channel();
        let open = OpenRequest(Arc::new(AtomicBool::new(true)));
        if let Err(refusal) = self.put(order, by, &open, answer) {
            return refusal;
        }
        match tokio::time::timeout(ANSWER_WITHIN, answered).await {
            Ok(Ok(reply)) => reply,
            Ok(Err(_)) => Reply::refuse("celld takes no orders yet, or is ending; nothing was done"),
            Err(_) => Reply::refuse(format!(
                "no answer within {} s; see the status for what was done, and give the order again if it is needed",
                ANSWER_WITHIN.as_secs()
            )),
        }
    }

    fn put(
        &self,
        order: Order,
        by: OrderedBy,
        open: &OpenRequest,
        answer: oneshot::Sender<Reply>,
    ) -> Result<(), Reply> {
        let (boot_s, open, answers) = (boot_now_s(), open.0.clone(), vec![answer]);
        queue(&self.0).put(Waiting { order, by, boot_s, open, answers })
    }
}

/// The end at which the page's orders arrive.
pub struct PageOrders {
    page: Arc<Mutex<Queue>>,
    memory: GripperMemory,
    last: u32,
    unanswered: Vec<(u32, Waiting<oneshot::Sender<Reply>>)>,
}

/// Where the page gives its orders, and the end at which its orders arrive; `memory`: where a confirmed
/// gripper is remembered.
pub fn order_channel(memory: GripperMemory) -> (OrderSender, PageOrders) {
    let page: Arc<Mutex<Queue>> = Arc::default();
    (OrderSender(page.clone()), PageOrders { page, memory, last: 0, unanswered: Vec::new() })
}

impl Orders for PageOrders {
    fn task(&self) -> &'static str {
        "the intake of the page's orders"
    }

    fn take(&mut self) -> Batch {
        let taken = queue(&self.page).take();
        let mut orders = Vec::with_capacity(taken.len());
        for waiting in taken {
            self.last += 1;
            let open = waiting.open.clone();
            orders.push(Given {
                number: self.last,
                order: waiting.order.clone(),
                boot_s: waiting.boot_s,
                client_waits: Arc::new(move || open.load(Ordering::Relaxed)),
            });
            self.unanswered.push((self.last, waiting));
        }
        Batch { orders, fault: None }
    }

    fn reply(&mut self, number: u32, reply: &Reply) {
        let Some(index) = self.unanswered.iter().position(|(open, _)| *open == number) else { return };
        let (_, Waiting { order, by, answers, .. }) = self.unanswered.swap_remove(index);
        let by = by.name;
        if reply.accepted {
            tracing::info!(?order, by, "ordered: {}", reply.message);
        } else {
            tracing::warn!(?order, by, "order refused: {}", reply.message);
        }
        let (memory, reply) = (self.memory.clone(), reply.clone());
        if reply.confirmed.is_some() {
            // The disk may take its time: the next order does not wait for it.
            std::thread::spawn(move || answer_all(answers, &memory.remember(reply)));
        } else {
            answer_all(answers, &reply);
        }
    }
}

/// Those who gave the order may have gone.
fn answer_all(answers: Vec<oneshot::Sender<Reply>>, reply: &Reply) {
    for answer in answers {
        let _ = answer.send(reply.clone());
    }
}

impl Drop for PageOrders {
    /// What is with the machine may still be carried out, or was.
    fn drop(&mut self) {
        let waiting = queue(&self.page).close();
        for waits in waiting {
            answer_all(waits.answers, &Reply::refuse("celld ends; nothing was done"));
        }
        for (_, waits) in self.unanswered.drain(..) {
            answer_all(waits.answers, &Reply::refuse(OPEN_AT_THE_END));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::order_queue::QUEUE;
    use crate::jobs::state::StateFolder;
    use cell_machine::orders::ConfirmedGripper;

    fn page() -> (tempfile::TempDir, OrderSender, PageOrders) {
        let folder = tempfile::tempdir().unwrap();
        let memory = GripperMemory::new(&StateFolder::new(folder.path()), "gripper:502".into());
        let (order_sender, orders) = order_channel(memory);
        (folder, order_sender, orders)
    }

    fn by(session: &str) -> OrderedBy {
        OrderedBy { name: "anna".into(), session: session.into() }
    }

    fn give(sender: &OrderSender, order: Order, session: &str) -> tokio::task::JoinHandle<Reply> {
        let (sender, by) = (sender.clone(), by(session));
        tokio::spawn(async move { sender.order(order, by).await })
    }

    async fn taken(orders: &mut PageOrders, count: usize) -> Vec<Given> {
        let mut taken = Vec::new();
        while taken.len() < count {
            taken.extend(orders.take().orders);
            tokio::task::yield_now().await;
        }
        taken
    }

    #[tokio::test]
    async fn an_answer_comes_back_and_a_confirmed_gripper_is_remembered_before() {
        let (folder, order_sender, mut orders) = page();
        let requested = give(&order_sender, Order::Pause, "1");
        let given = taken(&mut orders, 1).await.remove(0);
        assert_eq!((given.number, given.order), (1, Order::Pause));
        orders.reply(1, &Reply::accept("paused"));
        assert_eq!(requested.await.unwrap(), Reply::accept("paused"));

        let requested = give(&order_sender, Order::ConfirmGripper, "1");
        let given = taken(&mut orders, 1).await.remove(0);
        let gripper = ConfirmedGripper::Serial("VG-0815".into());
        let reply = Reply { confirmed: Some(gripper.clone()), ..Reply::accept("confirmed") };
        orders.reply(given.number, &reply);
        assert_eq!(requested.await.unwrap(), reply);
        let kept = StateFolder::new(folder.path()).confirmed_gripper("gripper:502");
        assert_eq!(kept, gripper, "read back from the disk");
    }

    #[tokio::test]
    async fn a_request_that_ends_takes_its_order_with_it() {
        let (_folder, order_sender, mut orders) = page();
        let requested = give(&order_sender, Order::Arm, "1");
        let given = taken(&mut orders, 1).await.remove(0);
        assert!((given.client_waits)());
        requested.abort();
        assert!(requested.await.is_err_and(|error| error.is_cancelled()));
        assert!(!(given.client_waits)());
    }

    #[tokio::test]
    async fn a_hundred_viewers_that_pause_leave_room_for_a_stop_and_share_places() {
        let (_folder, order_sender, mut orders) = page();
        let full: Vec<_> = (0..QUEUE + 1).map(|_| give(&order_sender, Order::Resume, "x")).collect();
        let viewers: Vec<_> =
            (0..200).map(|n| give(&order_sender, Order::Pause, &(n % 100).to_string())).collect();
        let abort = give(&order_sender, Order::Abort, "engineer");
        let all_wait = || queue(&order_sender.0).waiting() == (201, QUEUE);
        while !all_wait() {
            tokio::task::yield_now().await;
        }
        let given = taken(&mut orders, 100 + 1 + QUEUE).await;
        assert_eq!(given.len(), 100 + 1 + QUEUE, "two pauses of a session are one");
        assert!(given[..101].iter().all(|given| given.order.only_stops()), "stops come first");
        for given in &given {
            orders.reply(given.number, &Reply::accept(format!("{:?}", given.order)));
        }
        assert_eq!(abort.await.unwrap(), Reply::accept("Abort"));
        for viewer in viewers {
            assert_eq!(viewer.await.unwrap(), Reply::accept("Pause"));
        }
        let mut refused = 0;
        for other in full {
            refused += usize::from(!other.await.unwrap().accepted);
        }
        assert_eq!(refused, 1, "one more than the queue holds");
    }

    #[tokio::test]
    async fn when_celld_ends_every_order_is_answered() {
        let (_folder, order_sender, mut orders) = page();
        let with_the_machine = give(&order_sender, Order::Abort, "1");
        taken(&mut orders, 1).await;
        drop(orders);
        let open = with_the_machine.await.unwrap();
        assert_eq!(open, Reply::refuse(OPEN_AT_THE_END));
        let ended = order_sender.order(Order::Abort, by("1")).await;
        assert!(!ended.accepted && ended.message.contains("ending"), "{ended:?}");
    }
}
