//! What a person has confirmed at the gripper, kept for the next start.
//!
//! In: the answer to an order. Out: the answer that is given, after the confirmation is on disk; it says
//! where that could not be. Orders of every source come by here, so that a gripper that was confirmed at the
//! page is not in doubt after a restart.

use crate::jobs::state::StateFolder;
use cell_edge::clock::unix_now_s;
use cell_machine::orders::Reply;
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

    /// Remembers what an order has confirmed, if anything; the answer to give.
    pub fn remember(&self, reply: Reply) -> Reply {
        let Some(gripper) = &reply.confirmed else { return reply };
        match self.state.confirm_gripper(&self.address, gripper, unix_now_s()) {
            Ok(()) => reply,
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
    use cell_machine::orders::ConfirmedGripper;

    fn confirmed(gripper: ConfirmedGripper) -> Reply {
        Reply { confirmed: Some(gripper), ..Reply::accept("confirmed") }
    }

    #[test]
    fn an_accepted_confirmation_is_kept_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path());
        let memory = GripperMemory::new(&state, "gripper:502".into());
        memory.remember(Reply::refuse("no"));
        memory.remember(Reply::accept("armed"));
        assert_eq!(state.confirmed_gripper("gripper:502"), ConfirmedGripper::None);
        let serial = ConfirmedGripper::Serial("VG-0815".into());
        for gripper in [ConfirmedGripper::AtAddress, serial] {
            let reply = confirmed(gripper.clone());
            assert_eq!(memory.remember(reply.clone()), reply);
            assert_eq!(state.confirmed_gripper("gripper:502"), gripper);
        }

        let nowhere = StateFolder::new(folder.path().join("gripper.json"));
        let memory = GripperMemory::new(&nowhere, "gripper:502".into());
        let answer = memory.remember(confirmed(ConfirmedGripper::AtAddress));
        assert!(answer.accepted && answer.message.contains("not remembered"), "{answer:?}");
    }
}
