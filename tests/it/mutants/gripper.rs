//! Mutants of the gripper: registers that are written too early or too late, readings that are old.

use crate::mutants::drill::{Case, until_found, usual, wait, work_until};
use crate::mutants::plant::{Meddler, Plant, shared};
use cell_machine::device::gripper_types::ModbusRequest;
use cell_machine::event::{Effect, Event, News};
use cell_machine::orders::Order;
use cell_machine::supervisor::input::Record;
use cell_machine::supervisor::status::WorkStep;
use celld::pair::Pair;
use celld::pair::disk::Mood;
use celld::pair::rules::Rule;
use celld::pair::stage::Stage;
use std::cell::RefCell;
use std::rc::Rc;
use ur_sim::world::lock;

pub const CASES: &[Case] = &[
    Case {
        name: "the vacuum does not wait for the disk",
        rule: Rule::GripBeforeCommit,
        cell: usual,
        plant: grips_early,
        drill: a_job_on_a_slow_disk,
    },
    Case {
        name: "the vacuum is opened as the arm begins to lift",
        rule: Rule::VacuumOffInMotion,
        cell: usual,
        plant: vents_as_it_lifts,
        drill: lifted,
    },
    Case {
        name: "a stop opens the vacuum",
        rule: Rule::VacuumOffAway,
        cell: usual,
        plant: vents_after_a_stop,
        drill: aborted_while_carrying,
    },
    Case {
        name: "what is held is not read any more",
        rule: Rule::HeldUnwatched,
        cell: usual,
        plant: reading_kept,
        drill: aborted_while_carrying,
    },
    Case {
        name: "the status forgets what is held",
        rule: Rule::HeldNotTrue,
        cell: usual,
        plant: holds_nothing,
        drill: aborted_while_carrying,
    },
];

/// Control words: channel A pumps up to 60 %, and both channels let the air in.
const GRIP: [u16; 2] = [0x013c, 0];
const VENT: [u16; 2] = [0, 0];

fn meddling(meddler: &Meddler) -> Plant {
    let (events_of, effects_of) = (meddler.clone(), meddler.clone());
    Plant::none()
        .event(move |event, events| events.push(events_of.event(event)))
        .effect(move |effect, effects, _| effects.push(effects_of.effect(effect)))
}

fn grips_early() -> Plant {
    let meddler = Meddler::default();
    let inner = meddler.clone();
    meddling(&meddler).effect(move |effect, effects, _| {
        if let Effect::Commit { record: Record::Intent { .. }, .. } = &effect {
            inner.write(GRIP);
        }
        effects.push(inner.effect(effect));
    })
}

fn a_job_on_a_slow_disk(pair: &mut Pair, stage: &Stage) {
    pair.disk().mood = Mood::Slow(0.4);
    work_until(pair, stage, WorkStep::Approaching);
    until_found(pair, 5.0);
}

fn vents_as_it_lifts() -> Plant {
    let meddler = Meddler::default();
    let inner = meddler.clone();
    let vented = shared(false);
    meddling(&meddler).truth(move |simulator| {
        let moves = !simulator.core().robot.controller().core.mover.stands();
        let height = lock(&simulator.core().world).held_over_place();
        if moves && height.is_some_and(|height| height < 5e-4) && !vented.get() {
            vented.set(true);
            inner.write(VENT);
        }
    })
}

fn lifted(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Carrying);
    until_found(pair, 3.0);
}

/// One and a half seconds after the stop, when the arm rests.
fn vents_after_a_stop() -> Plant {
    let meddler = Meddler::default();
    let (stopped, frames) = (shared(None), shared(0_u64));
    let (noted, now, inner) = (Rc::clone(&stopped), Rc::clone(&frames), meddler.clone());
    let effects_of = meddler.clone();
    meddling(&meddler)
        .effect(move |effect, effects, _| {
            if let Effect::Notify(News::Notice(notice)) = &effect
                && notice.text.starts_with("disarmed, a stop is ordered")
            {
                noted.set(Some(now.get()));
            }
            effects.push(effects_of.effect(effect));
        })
        .frame(move |_, _, _| {
            frames.set(frames.get() + 1);
            if stopped.get().is_some_and(|at| frames.get() == at + 750) {
                inner.write(VENT);
            }
        })
}

fn aborted_while_carrying(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Carrying);
    wait(pair, 0.4);
    pair.order(Order::Abort);
    until_found(pair, 6.0);
}

/// Once something is held, the last reading counts for ever.
fn reading_kept() -> Plant {
    let (held, kept) = (shared(false), Rc::new(RefCell::new(Vec::new())));
    let (holds, last) = (Rc::clone(&held), Rc::clone(&kept));
    Plant::none()
        .truth(move |simulator| held.set(lock(&simulator.core().world).glance().holds))
        .event(move |event, events| {
            if let Event::Registers(Ok(words)) = &event
                && words.len() == 2
            {
                last.borrow_mut().clone_from(words);
            }
            events.push(event);
        })
        .effect(move |effect, effects, made_up| match effect {
            Effect::Registers(ModbusRequest::Read { .. }) if holds.get() => {
                made_up.push(Event::Registers(Ok(kept.borrow().clone())));
            }
            other => effects.push(other),
        })
}

fn holds_nothing() -> Plant {
    Plant::none().effect(|effect, effects, _| {
        effects.push(match effect {
            Effect::Notify(News::Status(mut status)) => {
                status.held = None;
                Effect::Notify(News::Status(status))
            }
            other => other,
        });
    })
}
