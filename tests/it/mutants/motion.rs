//! Mutants of motion: commands that are changed, made up or lost on their way to the robot, and states on
//! their way back.

use crate::mutants::drill::{Case, SEED, arm, bring_about, submit, until_found, usual, wait, work_until};
use crate::mutants::plant::{Plant, is_armed, shared};
use crate::mutants::rtde;
use cell_machine::device::robot_types::Link;
use cell_machine::event::{Effect, Event};
use cell_machine::orders::Order;
use cell_machine::supervisor::order::JobOrder;
use cell_machine::supervisor::round::RoundOrder;
use cell_machine::supervisor::status::WorkStep;
use cell_motion::slow::CalibrationBox;
use celld::pair::Pair;
use celld::pair::rules::Rule;
use celld::pair::run::true_poses;
use celld::pair::stage::Stage;
use celld::pair::work::job;
use rearrange::geometry::pose::Pose2;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::rc::Rc;
use ur_sim::motion::rounding::{BlendConfig, EntrySpeed};

/// Of every joint, as config/cell.yaml has it, rad/s.
const FULL_SPEED: f64 = 60.0 * TAU / 360.0;

/// A speed of joints at which the tool is faster than on any line, rad/s.
const WORK_SPEED: f64 = 0.7;

pub const CASES: &[Case] = &[
    Case {
        name: "a command is sent to a disarmed cell",
        rule: Rule::MotionWhileDisarmed,
        cell: usual,
        plant: commands_disarmed,
        drill: disarmed_with_a_program,
    },
    Case {
        name: "states 180 ms old are taken for fresh ones",
        rule: Rule::MotionOnStaleState,
        cell: usual,
        plant: states_late,
        drill: a_job_begins,
    },
    Case {
        name: "the number of an earlier program is taken for that of the present one",
        rule: Rule::MotionOfOldProgram,
        cell: usual,
        plant: old_nonce,
        drill: two_programs,
    },
    Case {
        name: "a stop is lost",
        rule: Rule::MotionAfterStop,
        cell: usual,
        plant: stop_lost,
        drill: aborted_on_a_slow_way,
    },
    Case {
        name: "a path is not checked against the arm itself",
        rule: Rule::ArmMeets,
        cell: usual,
        plant: folded,
        drill: a_job_begins,
    },
    Case {
        name: "what is picked is lifted a little and carried through what lies beside it",
        rule: Rule::MeetsObject,
        cell: usual,
        plant: lifted_a_little,
        drill: carried_past_a_neighbour,
    },
    Case {
        name: "a path is not checked against the range of a joint",
        rule: Rule::JointRange,
        cell: wrist_of_half_a_turn,
        plant: wrist_turned,
        drill: a_job_begins,
    },
    Case {
        name: "joints move at twice the configured speed",
        rule: Rule::JointSpeed,
        cell: slow,
        plant: || scaled(rtde::SPEED, 2.0),
        drill: a_job_begins,
    },
    Case {
        name: "joints accelerate at four times the configured rate",
        rule: Rule::JointAcceleration,
        cell: usual,
        plant: || scaled(rtde::ACCELERATION, 4.0),
        drill: a_job_begins,
    },
    Case {
        name: "a corner is cut at full speed by an arm that does not brake for it",
        rule: Rule::JointSpeed,
        cell: blends_kept,
        plant: || corners_at(FULL_SPEED),
        drill: until_the_first_breach,
    },
    Case {
        name: "a line is entered through a corner at the speed of the move before it",
        rule: Rule::ToolSpeed,
        cell: blends_kept,
        plant: || corners_at(WORK_SPEED),
        drill: until_the_first_breach,
    },
    Case {
        name: "the way down to an object ends below its top",
        rule: Rule::ContactTooFast,
        cell: usual,
        plant: down_too_deep,
        drill: until_the_first_breach,
    },
    Case {
        name: "a calibration round forgets its box",
        rule: Rule::RoundOutsideBox,
        cell: usual,
        plant: box_forgotten,
        drill: round_out_of_its_box,
    },
    Case {
        name: "a calibration round moves at work speed",
        rule: Rule::RoundTooFast,
        cell: usual,
        plant: || scaled(rtde::SPEED, 3.0),
        drill: round,
    },
];

/// Of celld's commands to the robot, each changed.
fn on_commands(mut change: impl FnMut(&mut [u8]) -> bool + 'static) -> Plant {
    Plant::none().effect(move |effect, effects, _| {
        effects.push(match effect {
            Effect::Send(Link::Rtde, bytes) => Effect::Send(Link::Rtde, rtde::commands(&bytes, &mut change)),
            other => other,
        });
    })
}

fn scaled(field: std::ops::Range<usize>, factor: f64) -> Plant {
    on_commands(move |command| {
        if rtde::integer(command, rtde::OPCODE) == rtde::MOVE_JOINT {
            let value = rtde::double(command, field.clone());
            rtde::set_double(command, field.clone(), factor * value);
        }
        true
    })
}

/// Joint moves that another move follows run at this speed, with a blend.
fn corners_at(speed: f64) -> Plant {
    on_commands(move |command| {
        let goes_on = rtde::integer(command, rtde::OPTIONS) == 0;
        if goes_on && rtde::integer(command, rtde::OPCODE) == rtde::MOVE_JOINT {
            rtde::set_double(command, rtde::SPEED, speed);
            rtde::set_double(command, rtde::BLEND, 0.03);
        }
        true
    })
}

/// Of each line that follows a move with this opcode, the arm goes this share, and `change` is made.
fn lines_after(first: i32, share: f64, change: fn(&mut [u8])) -> Plant {
    let mut last = None;
    on_commands(move |command| {
        let opcode = rtde::integer(command, rtde::OPCODE);
        if opcode != rtde::MOVE_JOINT && opcode != rtde::MOVE_LINEAR {
            return true;
        }
        let target: [f64; 6] = std::array::from_fn(|joint| rtde::double(command, rtde::argument(joint)));
        let before = last.replace((opcode, target));
        if let Some((_, from)) = before.filter(|(before, _)| *before == first)
            && opcode == rtde::MOVE_LINEAR
        {
            for (joint, from) in from.iter().enumerate() {
                let there = from + share * (target[joint] - from);
                rtde::set_double(command, rtde::argument(joint), there);
            }
            change(command);
        }
        true
    })
}

/// Lines down to an object or to its place go twice as far.
fn down_too_deep() -> Plant {
    lines_after(rtde::MOVE_JOINT, 2.0, |_| {})
}

/// Lines up from an object or its place are cut short, and the arm stops there.
fn lifted_a_little() -> Plant {
    lines_after(rtde::MOVE_LINEAR, 0.15, |command| rtde::set_double(command, rtde::BLEND, 0.0))
}

fn blends_kept(stage: &mut Stage) {
    stage.controller.blends = BlendConfig { entry_speed: EntrySpeed::Kept, seed: SEED };
}

/// The plank at one end of a row, wanted at the other end.
fn carried_past_a_neighbour(pair: &mut Pair, stage: &Stage) {
    arm(pair);
    let usual = job(&stage.model, &true_poses(pair, &stage.model), SEED, 0);
    let goals = vec![("plank-1".to_string(), Pose2::new(0.34, 0.08, 0.0))];
    pair.submit(JobOrder { goals, ..usual });
    until_found(pair, 20.0);
}

fn a_job_begins(pair: &mut Pair, stage: &Stage) {
    arm(pair);
    submit(pair, stage, 0);
    until_found(pair, 20.0);
}

fn until_the_first_breach(pair: &mut Pair, stage: &Stage) {
    arm(pair);
    submit(pair, stage, 0);
    pair.run_until(20.0, |pair| !pair.breaches().is_empty());
}

/// While the cell is disarmed and its program still runs: a turn of the wrist by half a millirad.
fn commands_disarmed() -> Plant {
    let (last, q) = (Rc::new(RefCell::new(Vec::new())), shared(None));
    let (seen, at) = (Rc::clone(&last), Rc::clone(&q));
    let (mut disarmed, mut still) = (0, 0);
    Plant::none()
        .truth(move |simulator| {
            let controller = simulator.core().robot.controller();
            let mover = &controller.core.mover;
            still = if mover.stands() { still + 1 } else { 0 };
            at.set(Some(mover.q().0).filter(|_| still > 100));
        })
        .effect(move |effect, effects, _| {
            if let Effect::Send(Link::Rtde, bytes) = &effect {
                rtde::commands(bytes, |command| {
                    *seen.borrow_mut() = command.to_vec();
                    true
                });
            }
            effects.push(effect);
        })
        .frame(move |machine, effects, _| {
            disarmed = if is_armed(machine) || last.borrow().is_empty() { 0 } else { disarmed + 1 };
            let Some(q) = q.get().filter(|_| disarmed > 500) else { return };
            let mut command = last.take();
            let sequence = rtde::integer(&command, rtde::SEQUENCE);
            rtde::set_integer(&mut command, rtde::SEQUENCE, sequence + 1);
            rtde::set_integer(&mut command, rtde::OPCODE, rtde::MOVE_JOINT);
            rtde::set_integer(&mut command, rtde::OPTIONS, 1);
            for (joint, value) in q.iter().enumerate() {
                let turn = if joint == 5 { 5e-4 } else { 0.0 };
                rtde::set_double(&mut command, rtde::argument(joint), value + turn);
            }
            rtde::set_double(&mut command, rtde::SPEED, 0.5);
            rtde::set_double(&mut command, rtde::ACCELERATION, 2.0);
            effects.push(Effect::Send(Link::Rtde, command));
        })
}

/// Disarmed in the middle of a pick-n-place, which is finished.
fn disarmed_with_a_program(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Approaching);
    pair.order(Order::Disarm);
    until_found(pair, 30.0);
}

fn states_late() -> Plant {
    const LATE_FRAMES: u64 = 90;
    let waiting = Rc::new(RefCell::new(VecDeque::new()));
    let (coming, now) = (Rc::clone(&waiting), shared(0));
    let at = Rc::clone(&now);
    Plant::none()
        .event(move |event, events| match event {
            Event::Received(Link::Rtde, bytes) => coming.borrow_mut().push_back((at.get(), bytes)),
            other => events.push(other),
        })
        .frame(move |_, _, made_up| {
            now.set(now.get() + 1);
            let mut waiting = waiting.borrow_mut();
            while waiting.front().is_some_and(|(at, _)| at + LATE_FRAMES <= now.get()) {
                let (_, bytes) = waiting.pop_front().expect("the drill runs");
                made_up.push(Event::Received(Link::Rtde, bytes));
            }
        })
}

/// Every upload after the first has the number of the first, and the register reads as celld expects.
fn old_nonce() -> Plant {
    let nonces = shared(None);
    let known = Rc::clone(&nonces);
    Plant::none()
        .effect(move |effect, effects, _| {
            let Effect::Send(Link::Primary, bytes) = effect else { return effects.push(effect) };
            let text = String::from_utf8(bytes).expect("the drill runs");
            let digits = text
                .strip_prefix("def celld_")
                .and_then(|rest| rest.split('(').next())
                .expect("the drill runs");
            let wanted: i32 = digits.parse().expect("the drill runs");
            let (first, _) = nonces.get().unwrap_or((wanted, wanted));
            nonces.set(Some((first, wanted)));
            let text = text.replace(&wanted.to_string(), &first.to_string());
            effects.push(Effect::Send(Link::Primary, text.into_bytes()));
        })
        .event(move |event, events| {
            let (Event::Received(Link::Rtde, bytes), Some((first, wanted))) = (&event, known.get()) else {
                return events.push(event);
            };
            let bytes = rtde::states(bytes, |state| {
                if rtde::integer(state, rtde::NONCE) == first {
                    rtde::set_integer(state, rtde::NONCE, wanted);
                }
                true
            });
            events.push(Event::Received(Link::Rtde, bytes));
        })
}

fn two_programs(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Approaching);
    pair.order(Order::Abort);
    wait(pair, 4.0);
    arm(pair);
    submit(pair, stage, 1);
    until_found(pair, 20.0);
}

/// Neither the register nor the dashboard stops the program, and it goes on hearing from celld.
fn stop_lost() -> Plant {
    let (stopping, beat) = (shared(false), Rc::new(RefCell::new(Vec::new())));
    let (stopped, heard) = (Rc::clone(&stopping), Rc::clone(&beat));
    let mut frames = 0;
    Plant::none()
        .effect(move |effect, effects, _| match effect {
            Effect::Send(Link::Dashboard, line) if line == b"stop\n" => {}
            Effect::Send(Link::Rtde, bytes) => {
                let bytes = rtde::commands(&bytes, |command| {
                    let stops = rtde::integer(command, rtde::OPCODE) == rtde::STOP;
                    stopped.set(stopped.get() || stops);
                    !stops
                });
                let bytes = rtde::heartbeats(&bytes, |package| {
                    *heard.borrow_mut() = package.to_vec();
                    true
                });
                effects.push(Effect::Send(Link::Rtde, bytes));
            }
            other => effects.push(other),
        })
        .frame(move |_, effects, _| {
            frames += 1;
            if stopping.get() && frames % 10 == 0 {
                let mut package = beat.borrow().clone();
                rtde::set_integer(&mut package, rtde::SEQUENCE, 100_000 + frames);
                effects.push(Effect::Send(Link::Rtde, package));
            }
        })
}

fn aborted_on_a_slow_way(pair: &mut Pair, stage: &Stage) {
    work_until(pair, stage, WorkStep::Approaching);
    bring_about(pair, r#"{"do": "ur.slider", "args": {"fraction": 0.15}}"#);
    wait(pair, 0.5);
    pair.order(Order::Abort);
    until_found(pair, 4.0);
}

/// The first way of a job ends with the wrist at the shoulder.
fn folded() -> Plant {
    const FOLDED: [f64; 6] = [-1.6, -1.6, 2.9, 0.3, -1.57, 0.0];
    on_commands(|command| {
        if rtde::integer(command, rtde::OPCODE) == rtde::MOVE_JOINT {
            for (joint, value) in FOLDED.iter().enumerate() {
                rtde::set_double(command, rtde::argument(joint), *value);
            }
            rtde::set_double(command, rtde::BLEND, 0.0);
        }
        true
    })
}

/// Speeds that every way reaches.
fn slow(stage: &mut Stage) {
    stage.model.arm.limits.joint_speed = 0.5;
    stage.model.cycle.joint_speed = 0.5;
}

fn wrist_of_half_a_turn(stage: &mut Stage) {
    stage.model.arm.limits.joint_range[5] = (-3.3, 3.3);
}

fn wrist_turned() -> Plant {
    on_commands(|command| {
        let opcode = rtde::integer(command, rtde::OPCODE);
        if opcode == rtde::MOVE_JOINT || opcode == rtde::MOVE_LINEAR {
            let turn = rtde::double(command, rtde::argument(5));
            let further = if turn > 0.0 { -TAU } else { TAU };
            rtde::set_double(command, rtde::argument(5), turn + further);
        }
        true
    })
}

fn look_round(stage: &Stage, room: Option<CalibrationBox>) -> RoundOrder {
    RoundOrder::pictures(stage.model.look_poses.clone(), room)
}

fn round(pair: &mut Pair, stage: &Stage) {
    pair.visit(look_round(stage, None));
    until_found(pair, 40.0);
}

fn box_forgotten() -> Plant {
    Plant::none().event(|event, events| {
        events.push(match event {
            Event::Round(mut order) => {
                order.room = None;
                Event::Round(order)
            }
            other => other,
        });
    })
}

/// The box ends where the arm is.
fn round_out_of_its_box(pair: &mut Pair, stage: &Stage) {
    let flange = pair.simulator().core().robot.controller().core.mover.flange().translation.vector;
    let room = CalibrationBox {
        low_m: [flange.x - 0.02, flange.y - 0.02, flange.z - 0.02],
        high_m: [flange.x + 0.02, flange.y + 0.02, flange.z + 0.02],
    };
    pair.visit(look_round(stage, Some(room)));
    until_found(pair, 30.0);
}
