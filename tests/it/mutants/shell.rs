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
