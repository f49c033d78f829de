//! Operators' commands in the state folder as the machine's orders, and the answers back.
//!
//! In: command files of the daemon's own name, answers. Out: numbered orders, each once; answers in the log
//! with the user who ordered. Answers are written on a thread of their own, so a slow disk keeps no order
//! waiting; that thread also remembers a confirmed gripper before it answers, and signs people in at the
//! page, which is no order to the machine.

use crate::daemon::gripper_memory::GripperMemory;
use crate::daemon::intake::Orders;
use crate::daemon::keeper::KeeperError;
use crate::jobs::command::{Command, SignIn};
use crate::jobs::inbox::{Inbox, Mail, Refused, ReportedStops, Taken};
use crate::jobs::sources::{Batch, Given};
use crate::jobs::state::StateFolder;
use cell_edge::clock::boot_now_s;
use cell_edge::files::FileError;
use cell_machine::intake::{Origin, stale};
use cell_machine::orders::{Order, Reply};
use rearrange::document::chain::chain;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Commands other than stops wait in the folder while so many are not answered.
const UNANSWERED_MAX: usize = 64;

/// Time limit of one look. With many clients each claim may wait 20 ms for the folder's lock, and the cell
/// stops after 1 s without a look.
const TAKES_FOR: Duration = Duration::from_millis(50);

/// Who signs people in at the page.
pub trait SignInHandler: Send {
    /// A link or a token for a person whom the system knows by this number. Its message is a secret.
    fn sign_in(&self, wanted: &SignIn, uid: Option<u32>) -> Reply;

    /// Ends every session, token and unused link of this name.
    fn sign_out(&self, name: &str) -> Reply;
}

/// Which commands are taken.
enum Reader {
    /// All, by listing the folder.
    Listing(Inbox),
    /// Stops only, by the names that inotify reports.
    Stops(ReportedStops),
}

/// Operators' commands in the state folder.
pub struct StateOrders {
    reader: Reader,
    last: u32,
    unanswered: VecDeque<(u32, Taken)>,
    clerk: Option<Clerk>,
    letters: Option<Sender<Letter>>,
    writes: Option<JoinHandle<()>>,
}

impl StateOrders {
    /// Opens the command folder and clears what was left for an earlier daemon; `memory`: where a confirmed
    /// gripper is remembered.
    ///
    /// # Errors
    /// The folder cannot be used.
    pub fn open(
        state: &StateFolder,
        daemon: String,
        memory: GripperMemory,
    ) -> Result<StateOrders, KeeperError> {
        let reader = Reader::Listing(Inbox::open(&state.commands(), daemon)?);
        Ok(StateOrders::reading(reader, Clerk { memory: Some(memory), sign_ins: None }))
    }

    fn reading(reader: Reader, clerk: Clerk) -> StateOrders {
        let (unanswered, clerk) = (VecDeque::new(), Some(clerk));
        StateOrders { reader, last: 0, unanswered, clerk, letters: None, writes: None }
    }

    /// A second source, for the stops in the same folder. It does not wait for the folder's lock.
    ///
    /// # Errors
    /// The system gives no watch on the folder; then stops are taken with all the others.
    pub fn stops(&self) -> Result<StateOrders, FileError> {
        let (Reader::Listing(inbox) | Reader::Stops(ReportedStops { inbox, .. })) = &self.reader;
        let stops = Reader::Stops(inbox.reported_stops()?);
        Ok(StateOrders::reading(stops, Clerk { memory: None, sign_ins: None }))
    }

    /// With a page at which people can be signed in; before the first order is taken.
    pub fn with_sign_ins(mut self, sign_ins: Option<Box<dyn SignInHandler>>) -> StateOrders {
        if let Some(clerk) = &mut self.clerk {
            clerk.sign_ins = sign_ins;
        }
        self
    }

    /// To the thread that writes; it is started with the first letter.
    fn write(&mut self, letter: Letter) {
        if let Some(clerk) = self.clerk.take() {
            let (sender, letters) = channel();
            self.letters = Some(sender);
            self.writes = Some(std::thread::spawn(move || clerk.run(&letters)));
        }
        if let Some(letters) = &self.letters {
            // Its end would be a defect; what it had to write is lost with it.
            let _ = letters.send(letter);
        }
    }
}

impl Orders for StateOrders {
    fn task(&self) -> &'static str {
        match self.reader {
            Reader::Listing(_) => "the intake of orders",
            Reader::Stops(_) => "the intake of stops",
        }
    }

    fn take(&mut self) -> Batch {
        let room = UNANSWERED_MAX.saturating_sub(self.unanswered.len());
        let mail = match &mut self.reader {
            Reader::Listing(inbox) => {
                let began = Instant::now();
                inbox.take_while(room, || began.elapsed() < TAKES_FOR)
            }
            Reader::Stops(stops) => Mail { taken: stops.take(), ..Mail::default() },
        };
        mail.refused.into_iter().for_each(|refused| self.write(Letter::Refused(refused)));
        let mut orders = Vec::with_capacity(mail.taken.len());
        for taken in mail.taken {
            let Some(order) = taken.command.order() else {
                self.write(Letter::SignIn(taken));
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
        self.write(Letter::Answer(taken, reply.clone()));
    }
}

impl Drop for StateOrders {
    /// Every answer is written before the daemon ends.
    fn drop(&mut self) {
        self.letters = None;
        if let Some(writes) = self.writes.take() {
            let _ = writes.join();
        }
    }
}

/// Something to write.
enum Letter {
    Answer(Taken, Reply),
    Refused(Refused),
    SignIn(Taken),
}

/// What the thread that writes works with.
struct Clerk {
    /// Where a confirmed gripper is remembered.
    memory: Option<GripperMemory>,
    sign_ins: Option<Box<dyn SignInHandler>>,
}

impl Clerk {
    fn run(self, letters: &Receiver<Letter>) {
        for letter in letters {
            let written = match letter {
                Letter::Refused(refused) => refused.answer(),
                Letter::SignIn(taken) => taken.answer(&self.sign_in(&taken)),
                Letter::Answer(taken, reply) => {
                    let remembered = taken.command.order().zip(self.memory.as_ref());
                    let remember = |(order, memory): (Order, &GripperMemory)| memory.remember(&order, &reply);
                    taken.answer(&remembered.map_or_else(|| reply.clone(), remember))
                }
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
