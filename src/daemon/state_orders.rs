//! Operators' commands in the state folder as the machine's orders, and the answers back.
//!
//! In: command files of the daemon's own name, answers. Out: numbered orders, each once; answers in the log
//! with the user who ordered. Two threads write answers, one of them only those to stops, so a slow disk
//! keeps no order waiting. They also remember a confirmed gripper before they answer, and sign people in at
//! the page, which is no order to the machine.

use crate::daemon::gripper_memory::GripperMemory;
use crate::daemon::intake::Orders;
use crate::jobs::command::{Command, SignIn};
use crate::jobs::inbox::{Inbox, Mail, Refused, Taken, UNANSWERED_MAX};
use crate::jobs::reported::{Kind, Reported};
use crate::jobs::sources::{Batch, Given, OPEN_AT_THE_END};
use cell_edge::clock::boot_now_s;
use cell_edge::files::FileError;
use cell_machine::intake::{Origin, stale};
use cell_machine::orders::Reply;
use rearrange::document::chain::chain;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SendError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Commands use at most one of this many file handles.
const HANDLES_PER_COMMAND: usize = 8;

/// Time limit of one look. Opening a file that its sender has just taken back waits for the folder's lock,
/// and the cell stops after 1 s without a look.
const LOOK_TIME: Duration = Duration::from_millis(50);

/// Who signs people in at the page.
pub trait SignInHandler: Send {
    /// A link or a token for a person whom the system knows by this number. Its message is a secret.
    fn sign_in(&self, wanted: &SignIn, uid: Option<u32>) -> Reply;

    /// Ends every session, token and unused link of this name.
    fn sign_out(&self, name: &str) -> Reply;
}

/// How commands are found.
enum Reader {
    /// By listing the folder.
    Listing(Inbox),
    /// By the names that the kernel reports.
    Reports(Reported),
}

/// Operators' commands in the state folder.
pub struct StateOrders {
    reader: Reader,
    last: u32,
    unanswered: VecDeque<(u32, Taken)>,
    letters: Arc<Letters>,
}

impl StateOrders {
    /// The sources of commands in the folder of `inbox`: one lists the folder, one takes reported stops, one
    /// takes other reported orders. `memory`: where a confirmed gripper is remembered; `sign_ins`: of the
    /// page, if there is one. If the system gives no watch on the folder there is only the first source, and
    /// the error.
    pub fn of(
        mut inbox: Inbox,
        memory: GripperMemory,
        sign_ins: Option<Box<dyn SignInHandler>>,
    ) -> (Vec<StateOrders>, Option<FileError>) {
        let reported = Reported::both(&mut inbox);
        let for_stops = Clerk { memory: memory.clone(), sign_ins: None };
        let letters = Arc::new(Letters::to(for_stops, Clerk { memory, sign_ins }));
        let mut sources = vec![StateOrders::reading(Reader::Listing(inbox), letters.clone())];
        match reported {
            Ok([stops, others]) => {
                sources.push(StateOrders::reading(Reader::Reports(stops), letters.clone()));
                sources.push(StateOrders::reading(Reader::Reports(others), letters));
                (sources, None)
            }
            Err(error) => (sources, Some(error)),
        }
    }

    fn reading(reader: Reader, letters: Arc<Letters>) -> StateOrders {
        StateOrders { reader, last: 0, unanswered: VecDeque::new(), letters }
    }

    fn inbox(&self) -> &Inbox {
        match &self.reader {
            Reader::Listing(inbox) => inbox,
            Reader::Reports(reported) => reported.inbox(),
        }
    }
}

impl Drop for StateOrders {
    /// The machine may have carried out orders that are still open here.
    fn drop(&mut self) {
        for (_, taken) in self.unanswered.drain(..) {
            self.letters.write(Letter::Answer(taken, Reply::refuse(OPEN_AT_THE_END)));
        }
    }
}

impl Orders for StateOrders {
    fn task(&self) -> &'static str {
        match &self.reader {
            Reader::Listing(_) => "the intake of orders",
            Reader::Reports(one) if one.kind() == Kind::Stops => "the intake of stops",
            Reader::Reports(_) => "the intake of reported orders",
        }
    }

    fn is_prompt(&self) -> bool {
        matches!(self.reader, Reader::Reports(_))
    }

    fn take(&mut self) -> Batch {
        let most = UNANSWERED_MAX.min(cell_edge::reserve::limit() / HANDLES_PER_COMMAND).max(1);
        let room = most.saturating_sub(self.inbox().unanswered());
        let began = Instant::now();
        let in_time = || began.elapsed() < LOOK_TIME;
        let mail = match &mut self.reader {
            Reader::Listing(inbox) => inbox.take_while(room, in_time),
            Reader::Reports(reported) => {
                Mail { taken: reported.take_while(room, in_time), ..Mail::default() }
            }
        };
        mail.refused.into_iter().for_each(|refused| self.letters.write(Letter::Refused(refused)));
        let mut orders = Vec::with_capacity(mail.taken.len());
        for taken in mail.taken {
            let Some(order) = taken.command.order() else {
                self.letters.write(Letter::SignIn(taken));
                continue;
            };
            self.last += 1;
            let lock = taken.lock.clone();
            let client_waits = Arc::new(move || lock.is_held());
            orders.push(Given { number: self.last, order, boot_s: taken.boot_s, client_waits });
            self.unanswered.push_back((self.last, taken));
        }
        Batch { orders, fault: mail.fault }
    }

    fn reply(&mut self, number: u32, reply: &Reply) {
        let Some(index) = self.unanswered.iter().position(|(open, _)| *open == number) else { return };
        let Some((_, taken)) = self.unanswered.remove(index) else { return };
        let (command, uid) = (&taken.command, taken.uid);
        if reply.accepted {
            tracing::info!(?command, uid, "ordered: {}", reply.message);
        } else {
            tracing::warn!(?command, uid, "order refused: {}", reply.message);
        }
        self.letters.write(Letter::Answer(taken, reply.clone()));
    }
}

/// Something to write.
enum Letter {
    Answer(Taken, Reply),
    Refused(Refused),
    SignIn(Taken),
}

/// The two threads that write answers. Answers to stops do not wait for others.
struct Letters {
    stops: Letterbox,
    others: Letterbox,
}

impl Letters {
    fn to(for_stops: Clerk, for_others: Clerk) -> Letters {
        Letters { stops: Letterbox::to(for_stops), others: Letterbox::to(for_others) }
    }

    fn write(&self, letter: Letter) {
        match &letter {
            Letter::Answer(taken, _) if taken.command.only_stops() => self.stops.write(letter),
            Letter::Answer(..) | Letter::Refused(_) | Letter::SignIn(_) => self.others.write(letter),
        }
    }
}

/// A thread that writes answers.
struct Letterbox {
    sender: Option<Sender<Letter>>,
    thread: Option<JoinHandle<()>>,
}

impl Letterbox {
    fn to(clerk: Clerk) -> Letterbox {
        let (sender, letters) = channel();
        let thread = std::thread::spawn(move || clerk.run(&letters));
        Letterbox { sender: Some(sender), thread: Some(thread) }
    }

    fn write(&self, letter: Letter) {
        let Some(sender) = &self.sender else { return };
        // Only a defect ends the thread. Its letters are lost, but must not count as waiting.
        if let Err(SendError(Letter::Answer(taken, _) | Letter::SignIn(taken))) = sender.send(letter) {
            taken.settle(true);
        }
    }
}

impl Drop for Letterbox {
    /// Every answer is written before the daemon ends.
    fn drop(&mut self) {
        self.sender = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What the thread that writes works with.
struct Clerk {
    /// Where a confirmed gripper is remembered.
    memory: GripperMemory,
    sign_ins: Option<Box<dyn SignInHandler>>,
}

impl Clerk {
    fn run(self, letters: &Receiver<Letter>) {
        for letter in letters {
            let written = match letter {
                Letter::Refused(refused) => refused.answer(),
                Letter::SignIn(taken) => taken.answer(&self.sign_in(&taken)),
                Letter::Answer(taken, reply) => taken.answer(&self.memory.remember(reply)),
            };
            if let Err(error) = written {
                tracing::warn!(error = %chain(&error), "a command could not be answered");
            }
        }
    }

    /// The answer to a request to sign in or out; it may be a secret and is not logged.
    fn sign_in(&self, taken: &Taken) -> Reply {
        let uid = taken.uid;
        let origin = Origin { age_s: boot_now_s() - taken.boot_s, client_waits: taken.lock.is_held() };
        if let Some(reply) = stale(origin) {
            return reply;
        }
        match (&self.sign_ins, &taken.command) {
            (Some(sign_ins), Command::SignIn(wanted)) => {
                let (reply, role) = (sign_ins.sign_in(wanted, Some(uid)), wanted.role);
                tracing::info!(accepted = reply.accepted, uid, %role, "sign-in at the page requested");
                reply
            }
            (Some(sign_ins), Command::SignOut { name }) => {
                let reply = sign_ins.sign_out(name);
                tracing::info!(accepted = reply.accepted, uid, name, "sign-out at the page requested");
                reply
            }
            _ => Reply::refuse("this celld serves no page: its configuration has no `page:`"),
        }
    }
}
