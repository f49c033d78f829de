//! What plants a mutant: an adapter made of closures, and what most of them need.

use cell_machine::device::gripper_types::ModbusRequest;
use cell_machine::event::{Effect, Event};
use cell_machine::machine::Machine;
use cell_machine::supervisor::model::CellModel;
use celld::pair::Adapter;
use std::cell::{Cell, RefCell};
use std::rc::Rc;
use ur_sim::simulator::Simulator;

type OnEvent = Box<dyn FnMut(Event, &mut Vec<Event>)>;
type OnEffect = Box<dyn FnMut(Effect, &mut Vec<Effect>, &mut Vec<Event>)>;
type OnFrame = Box<dyn FnMut(&Machine, &mut Vec<Effect>, &mut Vec<Event>)>;
type OnTruth = Box<dyn FnMut(&Simulator)>;
type OnRecorded = Box<dyn FnMut(Event) -> Event>;

/// Lets everything pass that no closure changes.
pub struct Plant {
    event: OnEvent,
    effect: OnEffect,
    frame: OnFrame,
    truth: OnTruth,
    recorded: OnRecorded,
}

impl Plant {
    /// Changes nothing.
    pub fn none() -> Plant {
        Plant {
            event: Box::new(|event, events| events.push(event)),
            effect: Box::new(|effect, effects, _| effects.push(effect)),
            frame: Box::new(|_, _, _| {}),
            truth: Box::new(|_| {}),
            recorded: Box::new(|event| event),
        }
    }

    pub fn event(self, event: impl FnMut(Event, &mut Vec<Event>) + 'static) -> Plant {
        Plant { event: Box::new(event), ..self }
    }

    pub fn effect(self, effect: impl FnMut(Effect, &mut Vec<Effect>, &mut Vec<Event>) + 'static) -> Plant {
        Plant { effect: Box::new(effect), ..self }
    }

    pub fn frame(self, frame: impl FnMut(&Machine, &mut Vec<Effect>, &mut Vec<Event>) + 'static) -> Plant {
        Plant { frame: Box::new(frame), ..self }
    }

    pub fn truth(self, truth: impl FnMut(&Simulator) + 'static) -> Plant {
        Plant { truth: Box::new(truth), ..self }
    }

    pub fn recorded(self, recorded: impl FnMut(Event) -> Event + 'static) -> Plant {
        Plant { recorded: Box::new(recorded), ..self }
    }
}

impl Adapter for Plant {
    fn event(&mut self, event: Event, events: &mut Vec<Event>) {
        (self.event)(event, events);
    }

    fn effect(&mut self, effect: Effect, effects: &mut Vec<Effect>, made_up: &mut Vec<Event>) {
        (self.effect)(effect, effects, made_up);
    }

    fn watch(&mut self, simulator: &Simulator) {
        (self.truth)(simulator);
    }

    fn frame(&mut self, machine: &Machine, effects: &mut Vec<Effect>, made_up: &mut Vec<Event>) {
        (self.frame)(machine, effects, made_up);
    }

    fn recorded(&mut self, event: Event) -> Event {
        (self.recorded)(event)
    }
}

/// A value that several closures share.
pub fn shared<T>(value: T) -> Rc<Cell<T>> {
    Rc::new(Cell::new(value))
}

/// True where the machine is armed.
pub fn is_armed(machine: &Machine) -> bool {
    machine.supervisor().is_some_and(|cell| cell.mode().armed())
}

/// The cell that celld is commissioned with, changed.
pub fn commissioned(change: fn(&mut CellModel)) -> Plant {
    Plant::none().event(move |event, events| {
        events.push(match event {
            Event::Commission { mut model, arm } => {
                change(&mut model);
                Event::Commission { model, arm }
            }
            other => other,
        });
    })
}

/// A register write in place of the machine's next reading, once requested; the machine gets the reading
/// before as its answer.
#[derive(Clone, Default)]
pub struct Meddler {
    wanted: Rc<RefCell<Option<Vec<u16>>>>,
    sent: Rc<Cell<bool>>,
    last: Rc<RefCell<Vec<u16>>>,
}

impl Meddler {
    /// Writes these words at the next reading.
    pub fn write(&self, words: [u16; 2]) {
        *self.wanted.borrow_mut() = Some(words.to_vec());
    }

    /// What becomes of an effect.
    pub fn effect(&self, effect: Effect) -> Effect {
        match effect {
            Effect::Registers(ModbusRequest::Read { address, count }) => {
                let Some(values) = self.wanted.borrow_mut().take() else {
                    return Effect::Registers(ModbusRequest::Read { address, count });
                };
                self.sent.set(true);
                Effect::Registers(ModbusRequest::Write { address: 0, values })
            }
            other => other,
        }
    }

    /// What becomes of an event.
    pub fn event(&self, event: Event) -> Event {
        match event {
            Event::Registers(Ok(words)) if words.is_empty() && self.sent.take() => {
                Event::Registers(Ok(self.last.borrow().clone()))
            }
            Event::Registers(Ok(words)) if words.len() == 2 => {
                self.last.borrow_mut().clone_from(&words);
                Event::Registers(Ok(words))
            }
            other => other,
        }
    }
}
