//! What a person has confirmed at the gripper, kept for the next start.
//!
//! In: an order with its answer. Out: the answer that is given, after the confirmation is on disk; it says
//! where that could not be. Orders of every source come by here, so that a gripper that was confirmed at the
//! page is not in doubt after a restart.

use crate::jobs::state::StateFolder;
use cell_edge::clock::unix_now_s;
use cell_machine::orders::{Order, Reply};
use rearrange::document::chain::chain;

/// Where the confirmation of one gripper is kept.
#[derive(Clone, Debug)]
pub struct GripperMemory {
    state: StateFolder,
    address: String,
}

impl GripperMemory {
    /// For the gripper at `address`, in this state folder.
    pub fn new(state: &StateFolder, address: String) -> GripperMemory {
        GripperMemory { state: state.clone(), address }
    }

    /// There is something to remember.
    pub fn concerns(order: &Order, reply: &Reply) -> bool {
        reply.accepted && *order == Order::ConfirmGripper
    }

    /// Remembers what `order` has confirmed, if anything; the answer to give.
    pub fn remember(&self, order: &Order, reply: &Reply) -> Reply {
        if !GripperMemory::concerns(order, reply) {
            return reply.clone();
        }
        match self.state.confirm_gripper(&self.address, unix_now_s()) {
            Ok(()) => reply.clone(),
            Err(error) => {
                let fault = chain(&error);
                Reply::accept(format!("{}; not remembered for the next start: {fault}", reply.message))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_accepted_confirmation_is_kept_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        let memory = GripperMemory::new(&state, "gripper:502".into());
        let (accepted, refused) = (Reply::accept("confirmed"), Reply::refuse("no"));
        memory.remember(&Order::ConfirmGripper, &refused);
        memory.remember(&Order::Arm, &accepted);
        assert!(!state.gripper_confirmed("gripper:502"));
        assert_eq!(memory.remember(&Order::ConfirmGripper, &accepted), accepted);
        assert!(state.gripper_confirmed("gripper:502"));

        let nowhere = StateFolder::new(folder.path().join("gripper.json"));
        let answer =
            GripperMemory::new(&nowhere, "gripper:502".into()).remember(&Order::ConfirmGripper, &accepted);
        assert!(answer.accepted && answer.message.contains("not remembered"), "{answer:?}");
    }
}
