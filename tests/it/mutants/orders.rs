//! Mutants of orders, arming and answers: what is said is not what is done, or nobody ordered it.

use crate::mutants::drill::{Case, arm, bring_about, submit, until_found, usual, wait, work_until};
use crate::mutants::plant::{Plant, is_armed, shared};
use crate::mutants::rtde;
use cell_machine::device::gripper_types::{Channels, ModbusRequest};
use cell_machine::device::robot_types::Link;
use cell_machine::event::{Effect, Event, News};
use cell_machine::orders::{Order, Reply};
use cell_machine::supervisor::model::CellModel;
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
        name: "a robot that sends no state is taken for one that does",
        rule: Rule::ArmedWithGateClosed,
        cell: usual,
        plant: states_made_up,
        drill: armed_without_states,
    },
    Case {
        name: "the loss of a link is not noticed",
        rule: Rule::ArmedThroughLinkLoss,
        cell: usual,
        plant: dashboard_kept,
        drill: dashboard_lost,
    },
    Case {
        name: "a protective stop is unlocked by celld",
        rule: Rule::SafetyAcknowledged,
        cell: usual,
        plant: unlocks_itself,
        drill: protective_stop,
    },
    Case {
        name: "the switch to local control is not noticed",
        rule: Rule::MotionInLocalControl,
        cell: usual,
        plant: remote_for_ever,
        drill: armed_in_local_control,
    },
    Case {
        name: "the robot is powered on in a disarmed cell",
        rule: Rule::StartedWhileDisarmed,
        cell: usual,
        plant: starts_disarmed,
        drill: left_alone,
    },
    Case {
        name: "arming never lapses",
        rule: Rule::ArmedTooLong,
        cell: lapses_soon,
        plant: || commissioned(|model| model.tolerances.arm_lapse = Duration::from_secs(3600)),
        drill: armed_and_left,
    },
    Case {
        name: "hand-guiding is not noticed",
        rule: Rule::ArmedThroughGuiding,
        cell: usual,
        plant: states_frozen,
        drill: guided_while_paused,
    },
    Case {
        name: "a switch of the arm's power is not noticed",
        rule: Rule::ArmedThroughPower,
        cell: usual,
        plant: states_frozen,
        drill: powered_off,
    },
    Case {
        name: "the cell arms itself",
        rule: Rule::ArmedWithoutOrder,
        cell: usual,
        plant: arms_itself,
        drill: left_alone,
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

fn left_alone(pair: &mut Pair, _: &Stage) {
    until_found(pair, 3.0);
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
            Event::Order(number, Order::Disarm) => number_of.set(Some(number)),
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
            if let Event::Order(number, Order::Abort) = &event {
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

/// The last state comes again in every frame, with the controller's time going on.
fn states_made_up() -> Plant {
    let last = Rc::new(RefCell::new(Vec::new()));
    let (seen, mut silent) = (Rc::clone(&last), 0);
    let fresh = shared(0);
    let came = Rc::clone(&fresh);
    Plant::none()
        .event(move |event, events| {
            if let Event::Received(Link::Rtde, bytes) = &event {
                rtde::states(bytes, |state| {
                    *seen.borrow_mut() = state.to_vec();
                    came.set(came.get() + 1);
                    true
                });
            }
            events.push(event);
        })
        .frame(move |_, _, made_up| {
            silent = if fresh.take() > 0 { 0 } else { silent + 1 };
            if silent > 5 && !last.borrow().is_empty() {
                let mut state = last.borrow_mut();
                let time = rtde::double(&state, rtde::TIME) + 0.002;
                rtde::set_double(&mut state, rtde::TIME, time);
                made_up.push(Event::Received(Link::Rtde, state.clone()));
            }
        })
}

fn armed_without_states(pair: &mut Pair, _: &Stage) {
    bring_about(pair, r#"{"do": "net.timeout", "args": {"link": "rtde", "seconds": 20}}"#);
    wait(pair, 1.0);
    arm(pair);
    until_found(pair, 1.0);
}

fn dashboard_kept() -> Plant {
    Plant::none().event(|event, events| match event {
        Event::Disconnected(Link::Dashboard, _) => {}
        other => events.push(other),
    })
}

fn dashboard_lost(pair: &mut Pair, _: &Stage) {
    arm(pair);
    bring_about(pair, r#"{"do": "net.reset_peer", "args": {"link": "dashboard"}}"#);
    until_found(pair, 2.0);
}

fn unlocks_itself() -> Plant {
    Plant::none().effect(|effect, effects, _| {
        let stops = |news: &News| {
            matches!(news, News::Notice(notice) if notice.text.starts_with("disarmed, a stop is ordered"))
        };
        if matches!(&effect, Effect::Notify(news) if stops(news)) {
            effects.push(Effect::Send(Link::Dashboard, b"unlock protective stop\n".to_vec()));
        }
        effects.push(effect);
    })
}

fn protective_stop(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Approaching);
    bring_about(pair, r#"{"do": "ur.pstop"}"#);
    until_found(pair, 3.0);
}

/// Remote control counts as on, and the connection that a switch to local control closes as one that comes
/// back at once.
fn remote_for_ever() -> Plant {
    /// A robot state without sub-packages.
    const EMPTY_STATE: [u8; 5] = [0, 0, 0, 5, 16];
    let deaf = shared(false);
    let (lost, known) = (Rc::clone(&deaf), Rc::clone(&deaf));
    let mut frames = 0;
    Plant::none()
        .event(move |event, events| match event {
            Event::Received(Link::Dashboard, bytes) if bytes == b"false\n" => {
                events.push(Event::Received(Link::Dashboard, b"true\n".to_vec()));
            }
            Event::Disconnected(Link::Primary, why) => {
                lost.set(true);
                events.push(Event::Disconnected(Link::Primary, why));
            }
            other => events.push(other),
        })
        .effect(move |effect, effects, made_up| match effect {
            Effect::Connect(Link::Primary) if known.get() => made_up.push(Event::Connected(Link::Primary)),
            other => effects.push(other),
        })
        .frame(move |_, _, made_up| {
            frames += 1;
            if deaf.get() && frames % 50 == 0 {
                made_up.push(Event::Received(Link::Primary, EMPTY_STATE.to_vec()));
            }
        })
}

/// The program of the last job still runs.
fn armed_in_local_control(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Approaching);
    pair.order(Order::Disarm);
    pair.run_until(30.0, |pair| pair.status().is_some_and(|status| !status.moving));
    wait(pair, 1.0);
    bring_about(pair, r#"{"do": "ur.local", "args": {"seconds": 60}}"#);
    wait(pair, 4.0);
    arm(pair);
    until_found(pair, 20.0);
}

fn starts_disarmed() -> Plant {
    let mut frames = 0;
    Plant::none().frame(move |machine, effects, _| {
        frames = if is_armed(machine) || machine.supervisor().is_none() { 0 } else { frames + 1 };
        if frames == 500 {
            effects.push(Effect::Send(Link::Dashboard, b"power on\n".to_vec()));
        }
    })
}

/// The cell as celld is told it is, changed.
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

fn lapses_soon(stage: &mut Stage) {
    stage.model.tolerances.arm_lapse = Duration::from_secs(10);
}

fn armed_and_left(pair: &mut Pair, _: &Stage) {
    arm(pair);
    until_found(pair, 45.0);
}

/// From when a person switches or guides the arm, the state reads as before.
fn states_frozen() -> Plant {
    let frozen = Rc::new(RefCell::new(None::<Vec<u8>>));
    let mut before = Vec::new();
    Plant::none().event(move |event, events| {
        let Event::Received(Link::Rtde, bytes) = event else { return events.push(event) };
        let bytes = rtde::states(&bytes, |state| {
            let running = rtde::integer(state, rtde::ROBOT_MODE) == 7;
            let guided = rtde::integer(state, rtde::STATUS_BITS) & 4 != 0;
            let mut frozen = frozen.borrow_mut();
            if frozen.is_none() && !before.is_empty() && (guided || !running) {
                *frozen = Some(before.clone());
            }
            before = state.to_vec();
            if let Some(frozen) = frozen.as_ref().filter(|_| guided || !running) {
                state[rtde::TIME.end..268].copy_from_slice(&frozen[rtde::TIME.end..268]);
            }
            true
        });
        events.push(Event::Received(Link::Rtde, bytes));
    })
}

fn guided_while_paused(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Approaching);
    pair.order(Order::Pause);
    pair.run_until(30.0, |pair| pair.status().is_some_and(|status| !status.moving));
    wait(pair, 1.0);
    bring_about(pair, r#"{"do": "ur.freedrive", "args": {"seconds": 3}}"#);
    until_found(pair, 2.0);
}

fn powered_off(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Approaching);
    pair.order(Order::Abort);
    wait(pair, 4.0);
    arm(pair);
    pair.order(Order::Pause);
    wait(pair, 1.0);
    bring_about(pair, r#"{"do": "ur.power_off"}"#);
    until_found(pair, 2.0);
}

/// An order that no person gave, and that is answered to nobody.
fn arms_itself() -> Plant {
    const FORGED: u64 = 999_999;
    let mut frames = 0;
    Plant::none()
        .frame(move |machine, _, made_up| {
            frames = if is_armed(machine) || machine.supervisor().is_none() { 0 } else { frames + 1 };
            if frames == 500 {
                made_up.push(Event::Order(FORGED, Order::Arm));
            }
        })
        .effect(|effect, effects, _| {
            if !matches!(effect, Effect::Reply { number: FORGED, .. }) {
                effects.push(effect);
            }
        })
}

fn stops_late() -> Plant {
    let waiting = Rc::new(RefCell::new(Vec::new()));
    let held = Rc::clone(&waiting);
    Plant::none()
        .event(move |event, events| match event {
            Event::Order(_, Order::Abort) => held.borrow_mut().push((25, event)),
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
                let text = String::from_utf8(bytes).unwrap();
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
        Event::Order(number, Order::Resume) => Event::Order(number, Order::Pause),
        other => other,
    })
}
