//! Mutants of orders and answers: what is said is not what is done, or it is late, lost or without end.

use crate::mutants::drill::{Case, arm, bring_about, submit, until_found, usual, wait, work_until};
use crate::mutants::plant::{Plant, commissioned, shared};
use cell_machine::device::gripper_types::{Channels, ModbusRequest};
use cell_machine::device::robot_types::Link;
use cell_machine::event::{Effect, Event, News};
use cell_machine::orders::{Order, Reply};
use cell_machine::supervisor::status::WorkStep;
use cell_values::time::Duration;
use celld::pair::Pair;
use celld::pair::rules::Rule;
use celld::pair::stage::Stage;
use std::cell::RefCell;
use std::rc::Rc;

pub const CASES: &[Case] = &[
    Case {
        name: "records are acknowledged that are not written",
        rule: Rule::AcknowledgedNotWritten,
        cell: usual,
        plant: commit_lost,
        drill: a_job_begins,
    },
    Case {
        name: "motion does not wait for the disk",
        rule: Rule::AcknowledgedNotWritten,
        cell: usual,
        plant: commit_not_awaited,
        drill: a_job_begins,
    },
    Case {
        name: "every order is answered with yes",
        rule: Rule::AnswerNotTrue,
        cell: usual,
        plant: always_yes,
        drill: parked_disarmed,
    },
    Case {
        name: "disarming is answered and does nothing",
        rule: Rule::AnswerNotTrue,
        cell: usual,
        plant: disarm_ignored,
        drill: armed_and_disarmed,
    },
    Case {
        name: "an abort is answered while the arm still brakes",
        rule: Rule::AnswerNotTrue,
        cell: usual,
        plant: answered_too_soon,
        drill: aborted_on_the_way,
    },
    Case {
        name: "a release is called done, and the vacuum stays",
        rule: Rule::AnswerNotTrue,
        cell: usual,
        plant: release_said,
        drill: released_while_held,
    },
    Case {
        name: "an order is answered twice",
        rule: Rule::AnswerWithoutOrder,
        cell: usual,
        plant: answered_twice,
        drill: armed,
    },
    Case {
        name: "an answer is lost",
        rule: Rule::OrderUnanswered,
        cell: usual,
        plant: || replies(|_, _| None),
        drill: resumed,
    },
    Case {
        name: "the status is an old one",
        rule: Rule::StatusNotTrue,
        cell: usual,
        plant: status_old,
        drill: armed,
    },
    Case {
        name: "a stop waits behind other work",
        rule: Rule::StopLate,
        cell: usual,
        plant: stops_late,
        drill: aborted_on_the_way,
    },
    Case {
        name: "the name of an object is put into the program",
        rule: Rule::TextInScript,
        cell: usual,
        plant: name_in_the_program,
        drill: a_job_begins,
    },
    Case {
        name: "a look that is not answered is waited for without end",
        rule: Rule::WaitWithoutEnd,
        cell: usual,
        plant: no_deadlines,
        drill: waited_for,
    },
    Case {
        name: "a grip is tried again without end",
        rule: Rule::RetriesWithoutEnd,
        cell: usual,
        plant: || commissioned(|model| model.tolerances.retries = 1000),
        drill: never_sealed,
    },
    Case {
        name: "the recording keeps another event than the one that came",
        rule: Rule::ReplayDiffers,
        cell: usual,
        plant: recorded_otherwise,
        drill: resumed,
    },
];

fn a_job_begins(pair: &mut Pair, stage: &Stage) {
    arm(pair);
    submit(pair, stage, 0);
    until_found(pair, 20.0);
}

fn armed(pair: &mut Pair, _: &Stage) {
    arm(pair);
    until_found(pair, 1.0);
}

fn commit_not_awaited() -> Plant {
    Plant::none().effect(|effect, effects, made_up| {
        if let Effect::Commit { number, .. } = &effect {
            made_up.push(Event::Committed(*number, Ok(())));
        }
        effects.push(effect);
    })
}

fn commit_lost() -> Plant {
    Plant::none().effect(|effect, effects, made_up| match effect {
        Effect::Commit { number, .. } => made_up.push(Event::Committed(number, Ok(()))),
        other => effects.push(other),
    })
}

/// Of every answer what `change` makes of it.
fn replies(change: fn(u64, Reply) -> Option<Reply>) -> Plant {
    Plant::none().effect(move |effect, effects, _| match effect {
        Effect::Reply { number, reply } => {
            effects.extend(change(number, reply).map(|reply| Effect::Reply { number, reply }));
        }
        other => effects.push(other),
    })
}

fn always_yes() -> Plant {
    replies(|_, _| Some(Reply::accept("done")))
}

fn parked_disarmed(pair: &mut Pair, _: &Stage) {
    pair.order(Order::Park);
    until_found(pair, 1.0);
}

/// The order never arrives, and is answered all the same.
fn disarm_ignored() -> Plant {
    let ignored = shared(None);
    let number_of = Rc::clone(&ignored);
    Plant::none()
        .event(move |event, events| match event {
            Event::Order(number, Order::Disarm, _) => number_of.set(Some(number)),
            other => events.push(other),
        })
        .frame(move |_, effects, _| {
            if let Some(number) = ignored.take() {
                effects.push(Effect::Reply { number, reply: Reply::accept("disarmed") });
            }
        })
}

fn armed_and_disarmed(pair: &mut Pair, _: &Stage) {
    arm(pair);
    pair.order(Order::Disarm);
    until_found(pair, 1.0);
}

fn answered_too_soon() -> Plant {
    let answered = shared(None);
    let (given, taken) = (shared(None), Rc::clone(&answered));
    let number_of = Rc::clone(&given);
    Plant::none()
        .event(move |event, events| {
            if let Event::Order(number, Order::Abort, _) = &event {
                number_of.set(Some(*number));
                taken.set(Some(*number));
            }
            events.push(event);
        })
        .effect(move |effect, effects, _| match effect {
            Effect::Reply { number, .. } if answered.get() == Some(number) => {}
            other => {
                effects.push(other);
                if let Some(number) = given.take() {
                    effects.push(Effect::Reply { number, reply: Reply::accept("stopped and disarmed") });
                }
            }
        })
}

fn aborted_on_the_way(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Approaching);
    wait(pair, 0.3);
    pair.order(Order::Abort);
    until_found(pair, 2.0);
}

fn release_said() -> Plant {
    const VENT: [u16; 2] = [0, 0];
    Plant::none().effect(|effect, effects, made_up| match effect {
        Effect::Registers(ModbusRequest::Write { values, .. }) if values[..] == VENT => {
            made_up.push(Event::Registers(Ok(Vec::new())));
        }
        Effect::Reply { number, reply } if reply.message.contains("not released") => {
            effects.push(Effect::Reply { number, reply: Reply::accept("vacuum off") });
        }
        other => effects.push(other),
    })
}

fn released_while_held(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Carrying);
    wait(pair, 0.3);
    pair.order(Order::Abort);
    wait(pair, 4.0);
    pair.order(Order::Release(Channels::Both));
    until_found(pair, 8.0);
}

fn answered_twice() -> Plant {
    Plant::none().effect(|effect, effects, _| {
        if let Effect::Reply { .. } = &effect {
            effects.push(effect.clone());
        }
        effects.push(effect);
    })
}

fn resumed(pair: &mut Pair, _: &Stage) {
    pair.order(Order::Resume);
    until_found(pair, 12.0);
}

fn status_old() -> Plant {
    Plant::none().effect(|effect, effects, _| {
        effects.push(match effect {
            Effect::Notify(News::Status(mut status)) => {
                status.armed = false;
                Effect::Notify(News::Status(status))
            }
            other => other,
        });
    })
}

fn stops_late() -> Plant {
    let waiting = Rc::new(RefCell::new(Vec::new()));
    let held = Rc::clone(&waiting);
    Plant::none()
        .event(move |event, events| match event {
            Event::Order(_, Order::Abort, _) => held.borrow_mut().push((25, event)),
            other => events.push(other),
        })
        .frame(move |_, _, made_up| {
            let mut waiting = waiting.borrow_mut();
            waiting.iter_mut().for_each(|(frames, _)| *frames -= 1);
            made_up.extend(waiting.extract_if(.., |(frames, _)| *frames == 0).map(|(_, event)| event));
        })
}

fn name_in_the_program() -> Plant {
    Plant::none().effect(|effect, effects, _| {
        effects.push(match effect {
            Effect::Send(Link::Primary, bytes) => {
                let text = String::from_utf8(bytes).expect("the drill runs");
                let at = "  global depth = 8\n";
                let text = text.replace(at, &format!("  textmsg(\"lid-1\")\n{at}"));
                Effect::Send(Link::Primary, text.into_bytes())
            }
            other => other,
        });
    })
}

fn no_deadlines() -> Plant {
    commissioned(|model| {
        model.tolerances.look_deadline = Duration::from_secs(100_000);
        model.tolerances.phase_deadline = Duration::from_secs(100_000);
    })
    .effect(|effect, effects, _| {
        if !matches!(effect, Effect::Look { .. }) {
            effects.push(effect);
        }
    })
}

fn waited_for(pair: &mut Pair, stage: &Stage) {
    arm(pair);
    submit(pair, stage, 0);
    until_found(pair, 140.0);
}

fn never_sealed(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Approaching);
    bring_about(pair, r#"{"do": "vacuum.leak", "args": {"vacuum": 0.1, "seconds": 600}}"#);
    until_found(pair, 200.0);
}

fn recorded_otherwise() -> Plant {
    Plant::none().recorded(|event| match event {
        Event::Order(number, Order::Resume, origin) => Event::Order(number, Order::Pause, origin),
        other => other,
    })
}
