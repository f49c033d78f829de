//! What the loop has to do next, in which order, and what has to wait for the disk.
//!
//! In: inputs for the supervisor, the actions it answers with, word that something is on disk. Out: one [`Next`] at a
//! time. All actions of one input come before the next input, and after an entry of the journal or a result nothing
//! comes before it is written: that nothing moves which the journal does not know is decided here and nowhere else.
//! Meanwhile inputs collect; whoever keeps the heartbeats does not have to wait. An order to stand that comes meanwhile takes
//! back what has not begun: nobody is told "disarmed" and then sees the arm start. Pure.

use crate::device::gripper::GripperCommand;
use crate::device::robot_types::RobotCommand;
use crate::supervisor::input::{Action, Input, OperatorCommand};
use std::collections::VecDeque;

/// Inputs and actions that are not done yet.
#[derive(Debug, Default)]
pub struct Agenda {
    actions: VecDeque<Action>,
    inputs: VecDeque<Input>,
    writing: bool,
}

/// What is to be done now.
#[derive(Debug)]
pub enum Next {
    /// Carry this out.
    Act(Action),
    /// Ask the supervisor about this.
    Feed(Input),
}

impl Agenda {
    /// Something happened; its turn comes after what happened before. While something is written an order to stand comes
    /// first instead: what is in line before it might begin a motion. True if the arm is to be stopped without waiting for
    /// that turn.
    pub fn add(&mut self, input: Input) -> bool {
        let stops = matches!(input, Input::Shutdown | Input::Operator(OperatorCommand::Abort));
        let disarms = matches!(input, Input::Operator(OperatorCommand::Disarm));
        if !self.writing || !(stops || disarms) {
            self.inputs.push_back(input);
            return false;
        }
        // Whoever armed or parked before disarming wants it disarmed.
        self.inputs.retain(|earlier| {
            !matches!(earlier, Input::Operator(OperatorCommand::Arm | OperatorCommand::Park))
        });
        // Disarming lets a motion under way end; of one taken back nothing has begun, and nothing will.
        let instead = self.take_motion_back() && disarms;
        self.inputs.push_front(if instead { Input::Operator(OperatorCommand::Abort) } else { input });
        stops
    }

    /// Drops what would begin to move or grip once the entry is written; true if there was anything.
    fn take_motion_back(&mut self) -> bool {
        let before = self.actions.len();
        self.actions.retain(|action| {
            !matches!(
                action,
                Action::Robot(RobotCommand::Stream(_)) | Action::Gripper(GripperCommand::Grip { .. })
            )
        });
        self.actions.len() < before
    }

    /// Something came of an action at once; it is looked at before everything else that happened.
    pub fn add_first(&mut self, input: Input) {
        self.inputs.push_front(input);
    }

    /// What the supervisor answered, in this order.
    pub fn extend(&mut self, actions: Vec<Action>) {
        self.actions.extend(actions);
    }

    /// The entry handed out last is on disk.
    pub fn written(&mut self) {
        self.writing = false;
    }

    /// Something handed out has to be on disk before anything else is done.
    pub fn is_writing(&self) -> bool {
        self.writing
    }

    /// There is nothing left to do, nor to wait for.
    pub fn is_empty(&self) -> bool {
        !self.writing && self.actions.is_empty() && self.inputs.is_empty()
    }

    /// What to do now; None when there is nothing, or while something is being written.
    pub fn due(&mut self) -> Option<Next> {
        if self.writing {
            return None;
        }
        let Some(action) = self.actions.pop_front() else { return self.inputs.pop_front().map(Next::Feed) };
        self.writing = matches!(action, Action::Journal(_) | Action::Finish(_));
        Some(Next::Act(action))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::gripper::Channels;
    use crate::supervisor::input::{JournalEntry, Notice};

    fn step(number: usize) -> Action {
        Action::Journal(JournalEntry::Done { step: number })
    }

    #[test]
    fn nothing_is_done_before_the_journal_knows_of_it() {
        let mut agenda = Agenda::default();
        agenda.extend(vec![step(1), Action::Robot(RobotCommand::Stop)]);
        assert!(matches!(agenda.due(), Some(Next::Act(Action::Journal(_)))));
        agenda.add(Input::Tick);
        assert!(agenda.due().is_none() && agenda.is_writing() && !agenda.is_empty());
        agenda.written();
        assert!(matches!(agenda.due(), Some(Next::Act(Action::Robot(_)))));
        assert!(matches!(agenda.due(), Some(Next::Feed(Input::Tick))));
        assert!(agenda.due().is_none() && agenda.is_empty());
    }

    #[test]
    fn two_entries_wait_one_after_the_other() {
        let mut agenda = Agenda::default();
        agenda.extend(vec![step(1), step(2)]);
        for number in 1..=2 {
            let Some(Next::Act(Action::Journal(JournalEntry::Done { step }))) = agenda.due() else {
                panic!("entry {number} is due")
            };
            assert_eq!(step, number);
            assert!(agenda.due().is_none());
            agenda.written();
        }
        assert!(agenda.is_empty());
    }

    #[test]
    fn what_comes_of_an_action_is_looked_at_first_but_after_the_other_actions() {
        let mut agenda = Agenda::default();
        agenda.add(Input::Tick);
        agenda.extend(vec![
            Action::Robot(RobotCommand::Stop),
            Action::Gripper(GripperCommand::Release { channels: Channels::A }),
        ]);
        assert!(matches!(agenda.due(), Some(Next::Act(Action::Robot(_)))));
        agenda.add_first(Input::Operator(OperatorCommand::Abort));
        assert!(matches!(agenda.due(), Some(Next::Act(Action::Gripper(_)))));
        assert!(matches!(agenda.due(), Some(Next::Feed(Input::Operator(_)))));
        assert!(matches!(agenda.due(), Some(Next::Feed(Input::Tick))));
    }

    /// An agenda that writes, with a grip to follow and a sentence after it.
    fn writing() -> Agenda {
        let mut agenda = Agenda::default();
        let grip = GripperCommand::Grip { channels: Channels::A, target: 0.6 };
        let said = Notice { alarm: false, text: "so far".to_string() };
        agenda.extend(vec![step(1), Action::Gripper(grip), Action::Say(said)]);
        assert!(agenda.due().is_some());
        agenda
    }

    #[test]
    fn an_order_to_stand_takes_back_what_waits_for_the_disk() {
        let orders = [
            (Input::Operator(OperatorCommand::Disarm), false),
            (Input::Operator(OperatorCommand::Abort), true),
            (Input::Shutdown, true),
        ];
        for (order, at_once) in orders {
            let mut agenda = writing();
            assert_eq!(agenda.add(order.clone()), at_once, "{order:?}");
            agenda.written();
            assert!(matches!(agenda.due(), Some(Next::Act(Action::Say(_)))), "{order:?}");
            let fed = agenda.due();
            let stands = match order {
                Input::Shutdown => matches!(fed, Some(Next::Feed(Input::Shutdown))),
                _ => matches!(fed, Some(Next::Feed(Input::Operator(OperatorCommand::Abort)))),
            };
            assert!(stands, "{order:?}: {fed:?}");
        }
    }

    #[test]
    fn other_orders_and_calm_hours_take_nothing_back() {
        let mut agenda = writing();
        assert!(!agenda.add(Input::Operator(OperatorCommand::Pause)));
        agenda.written();
        assert!(matches!(agenda.due(), Some(Next::Act(Action::Gripper(_)))));
        // Nothing is written: the order has its turn at once.
        assert!(!Agenda::default().add(Input::Operator(OperatorCommand::Abort)));
        // Nothing would move: disarming is disarming.
        let mut agenda = Agenda::default();
        agenda.extend(vec![step(1)]);
        assert!(agenda.due().is_some());
        assert!(!agenda.add(Input::Operator(OperatorCommand::Disarm)));
        agenda.written();
        assert!(matches!(agenda.due(), Some(Next::Feed(Input::Operator(OperatorCommand::Disarm)))));
    }

    #[test]
    fn an_order_to_stand_overtakes_what_could_begin_a_motion() {
        let orders = [
            Input::Operator(OperatorCommand::Disarm),
            Input::Operator(OperatorCommand::Abort),
            Input::Shutdown,
        ];
        for order in orders {
            let mut agenda = Agenda::default();
            agenda.extend(vec![step(1)]);
            assert!(agenda.due().is_some());
            for earlier in [OperatorCommand::Arm, OperatorCommand::Park, OperatorCommand::Approve] {
                agenda.add(Input::Operator(earlier));
            }
            agenda.add(order.clone());
            agenda.written();
            let Some(Next::Feed(first)) = agenda.due() else { panic!("{order:?} was not heard") };
            assert_eq!(format!("{first:?}"), format!("{order:?}"));
            assert!(matches!(agenda.due(), Some(Next::Feed(Input::Operator(OperatorCommand::Approve)))));
            assert!(agenda.due().is_none(), "armed and parked before {order:?}");
        }
    }
}
