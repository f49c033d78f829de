//! Mutants of the shell around the machine: what it notices and does not report.

use crate::mutants::drill::{Case, arm, until_found, usual, wait, work_until};
use crate::mutants::plant::Plant;
use cell_machine::event::Event;
use cell_machine::intake::Origin;
use cell_machine::supervisor::status::WorkStep;
use celld::jobs::command::Command;
use celld::pair::Pair;
use celld::pair::rules::Rule;
use celld::pair::shell::folder::Fate;
use celld::pair::shell::{Client, Leaves, Way};
use celld::pair::stage::Stage;
use std::cell::Cell;
use std::rc::Rc;

pub const CASES: &[Case] = &[
    Case {
        name: "an order counts although its client has ended",
        rule: Rule::OrderOutOfTime,
        cell: usual,
        plant: || origins(|origin| Origin { client_waits: true, ..origin }),
        drill: armed_by_a_client_that_ends,
    },
    Case {
        name: "an order counts however old it is",
        rule: Rule::OrderOutOfTime,
        cell: usual,
        plant: || origins(|origin| Origin { age_s: 0.0, ..origin }),
        drill: armed_after_a_quarter_of_a_minute,
    },
    Case {
        name: "an order is taken for six seconds older than it is",
        rule: Rule::RefusedInTime,
        cell: usual,
        plant: || origins(|origin| Origin { age_s: origin.age_s + 6.0, ..origin }),
        drill: armed_after_five_seconds,
    },
    Case {
        name: "the order to end celld reaches the cell late",
        rule: Rule::StopLate,
        cell: usual,
        plant: ends_late,
        drill: ended_at_work,
    },
    Case {
        name: "nobody notices that the folder of commands is gone",
        rule: Rule::ArmedCutOff,
        cell: usual,
        plant: || without(|event| matches!(event, Event::OrdersReach(_))),
        drill: cut_off,
    },
    Case {
        name: "nobody notices that celld stood still",
        rule: Rule::ArmedAfterHoldUp,
        cell: usual,
        plant: || without(|event| matches!(event, Event::HeldUp(_))),
        drill: held_up,
    },
    Case {
        name: "a release that waited for the arm goes out after a pause of celld",
        rule: Rule::OrderOutOfTime,
        cell: usual,
        plant: || without(|event| matches!(event, Event::HeldUp(_))),
        drill: held_up_before_it_lets_go,
    },
];

/// Orders with what `change` makes of where they come from.
fn origins(change: fn(Origin) -> Origin) -> Plant {
    Plant::none().event(move |event, events| {
        events.push(match event {
            Event::Order(number, order, origin) => Event::Order(number, order, change(origin)),
            other => other,
        });
    })
}

fn without(dropped: fn(&Event) -> bool) -> Plant {
    Plant::none().event(move |event, events| {
        if !dropped(&event) {
            events.push(event);
        }
    })
}

fn arms(pair: &mut Pair, leaves: Leaves) {
    pair.shell().add(Client::new(Command::Arm, Way::File, 0, leaves));
}

fn armed_by_a_client_that_ends(pair: &mut Pair, _: &Stage) {
    pair.stand_still(2.0);
    arms(pair, Leaves::Killed(1.0));
    until_found(pair, 5.0);
}

fn armed_after_a_quarter_of_a_minute(pair: &mut Pair, _: &Stage) {
    pair.stand_still(15.0);
    arms(pair, Leaves::GivesUp(60.0));
    until_found(pair, 20.0);
}

fn armed_after_five_seconds(pair: &mut Pair, _: &Stage) {
    pair.stand_still(5.0);
    arms(pair, Leaves::GivesUp(60.0));
    until_found(pair, 10.0);
}

/// The end comes half a second after it was ordered.
fn ends_late() -> Plant {
    let (ordered, mut since) = (Rc::new(Cell::new(false)), 0);
    let held_back = Rc::clone(&ordered);
    Plant::none()
        .event(move |event, events| match event {
            Event::Shutdown => ordered.set(true),
            other => events.push(other),
        })
        .frame(move |_, _, events| {
            since += u32::from(held_back.get());
            if since == 250 {
                events.push(Event::Shutdown);
            }
        })
}

fn ended_at_work(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Approaching);
    pair.terminate();
    until_found(pair, 3.0);
}

fn cut_off(pair: &mut Pair, _: &Stage) {
    arm(pair);
    pair.shell().folder_is(Fate::Gone);
    until_found(pair, 2.0);
}

fn held_up(pair: &mut Pair, _: &Stage) {
    arm(pair);
    pair.stand_still(1.5);
    until_found(pair, 3.0);
}

fn held_up_before_it_lets_go(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Carrying);
    wait(pair, 0.6);
    pair.shell().add(Client::new(Command::Release { channel: None }, Way::File, 0, Leaves::GivesUp(10.0)));
    // The arm is fast, and brakes.
    wait(pair, 0.02);
    pair.stand_still(12.0);
    until_found(pair, 14.0);
}
