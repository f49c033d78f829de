//! Mutants of arming: what should end it or keep it from beginning is not noticed, or nobody ordered it.

use crate::mutants::drill::{Case, arm, bring_about, until_found, usual, wait, work_until};
use crate::mutants::plant::{Plant, commissioned, is_armed, shared};
use crate::mutants::rtde;
use cell_machine::device::robot_types::Link;
use cell_machine::event::{Effect, Event, News};
use cell_machine::intake::Origin;
use cell_machine::orders::Order;
use cell_machine::supervisor::status::WorkStep;
use cell_values::time::Duration;
use celld::pair::Pair;
use celld::pair::rules::Rule;
use celld::pair::stage::Stage;
use std::cell::RefCell;
use std::rc::Rc;
use ur_wire::enumerations::RobotMode;

pub const CASES: &[Case] = &[
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
        name: "a switch of the arm's power is not noticed while the joints boot",
        rule: Rule::ArmedThroughPower,
        cell: usual,
        plant: boots_for_ever,
        drill: powered_off_while_it_boots,
    },
    Case {
        name: "the cell arms itself",
        rule: Rule::ArmedWithoutOrder,
        cell: usual,
        plant: arms_itself,
        drill: left_alone,
    },
];

fn left_alone(pair: &mut Pair, _: &Stage) {
    until_found(pair, 3.0);
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

fn lapses_soon(stage: &mut Stage) {
    stage.model.tolerances.arm_lapse = Duration::from_secs(10);
}

fn armed_and_left(pair: &mut Pair, _: &Stage) {
    arm(pair);
    until_found(pair, 45.0);
}

/// From when a person switches or guides the arm, the state reads as before; program and time go on.
fn states_frozen() -> Plant {
    const FROZEN: std::ops::Range<usize> = rtde::TIME.end..rtde::NONCE.start;
    const RUNNING: i32 = 7;
    const TEACH_BUTTON: i32 = 4;
    let mut before = Vec::new();
    Plant::none().event(move |event, events| {
        let Event::Received(Link::Rtde, bytes) = event else { return events.push(event) };
        let bytes = rtde::states(&bytes, |state| {
            let running = rtde::integer(state, rtde::ROBOT_MODE) == RUNNING;
            let guided = rtde::integer(state, rtde::STATUS_BITS) & TEACH_BUTTON != 0;
            if running && !guided {
                before = state.to_vec();
            } else if !before.is_empty() {
                state[FROZEN].copy_from_slice(&before[FROZEN]);
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

/// Once the joints boot, every state says that they do.
fn boots_for_ever() -> Plant {
    const BOOTING: i32 = 2;
    let mut boots = false;
    Plant::none().event(move |event, events| {
        let Event::Received(Link::Rtde, bytes) = event else { return events.push(event) };
        let bytes = rtde::states(&bytes, |state| {
            boots |= rtde::integer(state, rtde::ROBOT_MODE) == BOOTING;
            if boots {
                state[rtde::ROBOT_MODE].copy_from_slice(&BOOTING.to_be_bytes());
            }
            true
        });
        events.push(Event::Received(Link::Rtde, bytes));
    })
}

fn powered_off_while_it_boots(pair: &mut Pair, _: &Stage) {
    bring_about(pair, r#"{"do": "ur.power_off"}"#);
    wait(pair, 1.0);
    pair.order(Order::Arm);
    let boots = pair.run_until(5.0, |pair| {
        pair.simulator().core().robot.controller().core.modes.robot_mode() == RobotMode::Booting
    });
    assert!(boots, "the joints do not boot");
    wait(pair, 0.1);
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
                made_up.push(Event::Order(FORGED, Order::Arm, Origin::OWN));
            }
        })
        .effect(|effect, effects, _| {
            if !matches!(effect, Effect::Reply { number: FORGED, .. }) {
                effects.push(effect);
            }
        })
}
