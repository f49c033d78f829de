//! Operators' commands in the state folder as the machine's orders, and the answers back.
//!
//! In: command files of the daemon's own name, answers. Out: numbered orders, each once; answers in the log
//! with the user who ordered. What a person has confirmed is remembered before it is answered. Who wants to
//! be signed in at the page is answered at once: that is no order to the machine.

use crate::daemon::gripper_memory::GripperMemory;
use crate::daemon::intake::{Given, Orders};
use crate::daemon::keeper::KeeperError;
use crate::jobs::command::{Command, Inbox, SignIn, Taken};
use crate::jobs::state::StateFolder;
use cell_edge::clock::boot_now_s;
use cell_machine::orders::Reply;
use std::collections::VecDeque;

/// Most orders whose answers are still to come; older ones are forgotten.
const UNANSWERED_MAX: usize = 64;

/// Who signs people in at the page.
pub trait SignInHandler: Send {
    /// A link or a token for a person whom the system knows by this number. Its message is a secret.
    fn sign_in(&self, wanted: &SignIn, uid: Option<u32>) -> Reply;

    /// Ends every session, token and unused link of this name.
    fn sign_out(&self, name: &str) -> Reply;
}

/// Operators' commands in the state folder.
pub struct StateOrders {
    inbox: Inbox,
    memory: GripperMemory,
    last: u32,
    unanswered: VecDeque<(u32, Taken)>,
    sign_ins: Option<Box<dyn SignInHandler>>,
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
        let inbox = Inbox::open(&state.commands(), daemon)?;
        Ok(StateOrders { inbox, memory, last: 0, unanswered: VecDeque::new(), sign_ins: None })
    }

    /// With a page at which people can be signed in.
    pub fn with_sign_ins(self, sign_ins: Option<Box<dyn SignInHandler>>) -> StateOrders {
        StateOrders { sign_ins, ..self }
    }

    /// Answers who wants to sign in or out, if that is what is wanted; the answer may be a secret and is not
    /// logged.
    fn answer_sign_in(&self, taken: &Taken) -> bool {
        let uid = taken.uid;
        let reply = match (&self.sign_ins, &taken.command) {
            (None, Command::SignIn(_) | Command::SignOut { .. }) => {
                Reply::refuse("this celld serves no page: its configuration has no `page:`")
            }
            (Some(sign_ins), Command::SignIn(wanted)) => {
                let (reply, role) = (sign_ins.sign_in(wanted, uid), wanted.role);
                tracing::info!(accepted = reply.accepted, uid, %role, "sign-in at the page requested");
                reply
            }
            (Some(sign_ins), Command::SignOut { name }) => {
                let reply = sign_ins.sign_out(name);
                tracing::info!(accepted = reply.accepted, uid, name, "sign-out at the page requested");
                reply
            }
            _ => return false,
        };
        self.answered(taken, &reply);
        true
    }

    fn answered(&self, taken: &Taken, reply: &Reply) {
        if let Err(error) = self.inbox.reply(taken, reply) {
            tracing::warn!(%error, "a command could not be answered");
        }
    }
}

impl Orders for StateOrders {
    fn task(&self) -> &'static str {
        "the intake of orders"
    }

    fn take(&mut self) -> Vec<Given> {
        let taken = self.inbox.take(boot_now_s).unwrap_or_else(|error| {
            tracing::error!(%error, "command folder");
            Vec::new()
        });
        let mut orders = Vec::with_capacity(taken.len());
        for taken in taken {
            if self.answer_sign_in(&taken) {
                continue;
            }
            let Some(order) = taken.command.order() else { continue };
            self.last += 1;
            orders.push(Given { number: self.last, order, boot_s: taken.boot_s });
            self.unanswered.push_back((self.last, taken));
            if self.unanswered.len() > UNANSWERED_MAX {
                self.unanswered.pop_front();
            }
        }
        orders
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
        let order = taken.command.order();
        let reply = order.map_or_else(|| reply.clone(), |order| self.memory.remember(&order, reply));
        if let Err(error) = self.inbox.reply(&taken, &reply) {
            tracing::warn!(%error, "a command could not be answered");
        }
    }
}
