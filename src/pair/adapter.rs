//! What a test may put between machine and world.
//!
//! In: what passes. Out: what is made of it. Nothing of the kind is in the daemon: it shows whether the
//! rules of the closed loop notice.

use cell_machine::event::{Effect, Event};
use cell_machine::machine::Machine;
use ur_sim::simulator::Simulator;

/// Something between machine and world that a test puts there to see whether the rules notice: it may
/// change, drop and add what passes. Nothing of the kind is in the daemon.
pub trait Adapter {
    /// What becomes of an event on its way to the machine.
    fn event(&mut self, event: Event, events: &mut Vec<Event>) {
        events.push(event);
    }

    /// What becomes of an effect on its way to the world; events may be made up.
    fn effect(&mut self, effect: Effect, effects: &mut Vec<Effect>, made_up: &mut Vec<Event>);

    /// Between two frames, first: the truth, for what is to happen at a certain moment.
    fn watch(&mut self, _simulator: &Simulator) {}

    /// Between two frames: what may be made up without a cause.
    fn frame(&mut self, _machine: &Machine, _effects: &mut Vec<Effect>, _made_up: &mut Vec<Event>) {}

    /// What the recording keeps of an event that the machine takes in.
    fn recorded(&mut self, event: Event) -> Event {
        event
    }
}
