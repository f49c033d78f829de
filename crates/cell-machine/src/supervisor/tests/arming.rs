//! What arming needs, what its answer says, and that it is never made up for later.

use super::*;
use crate::code::Code;
use crate::device::gripper_types::{GripperFault, Identity};
use crate::device::robot_types::InputsTaken;
use crate::orders::{ConfirmedGripper, WayBack};
use crate::supervisor::back::{Held, LastStop};
use crate::supervisor::gates::GateClosed;
use crate::supervisor::mode::Mode;
use cell_motion::bodies::Load;
use cell_motion::put_down::Grasp;
use std::f64::consts::FRAC_PI_2;

/// What is missing, and a word of the answer that names it.
type Missing = (&'static str, fn(&mut Bench));

const MISSING: &[Missing] = &[
    ("RTDE", |bench| bench.link_down = Some(Link::Rtde)),
    ("dashboard", |bench| bench.link_down = Some(Link::Dashboard)),
    ("primary", |bench| bench.link_down = Some(Link::Primary)),
    ("sends no state", |bench| bench.silent = true),
    ("emergency stop is pressed", |bench| bench.robot.safety_mode = SafetyMode::RobotEmergencyStop),
    ("celld recover", |bench| bench.robot.safety_mode = SafetyMode::ProtectiveStop),
    ("a safeguard is open", |bench| bench.robot.safety_mode = SafetyMode::SafeguardStop),
    ("unknown value 99", |bench| bench.robot.safety_mode = SafetyMode::Unknown(99)),
    ("remote control", |bench| bench.robot.remote_control = Some(false)),
    ("remote control", |bench| bench.robot.remote_control = None),
    ("robot mode", |bench| bench.robot.robot_mode = RobotMode::Booting),
    ("robot mode", |bench| bench.robot.robot_mode = RobotMode::Disconnected),
    ("robot mode", |bench| bench.robot.robot_mode = RobotMode::Backdrive),
    ("robot mode", |bench| bench.robot.robot_mode = RobotMode::Unknown(42)),
    ("the gripper does not answer", |bench| bench.gripper_answers = false),
    ("another client holds the gripper's connection", |bench| {
        (bench.gripper_answers, bench.gripper_fault) = (false, GripperFault::Taken);
    }),
    ("another gripper", |bench| bench.cell.model.confirmed = ConfirmedGripper::Serial("other".into())),
    ("accepts the connection but does not answer", |bench| {
        (bench.gripper_answers, bench.gripper_fault) = (false, GripperFault::Unserved);
    }),
    ("never confirmed", |bench| bench.cell.model.confirmed = ConfirmedGripper::None),
    ("hang on the gripper", |bench| bench.vacuum = [0.0, 0.4]),
    ("hang on the gripper", |bench| bench.vacuum = [f64::NAN, 0.0]),
];

#[test]
fn a_disarmed_cell_takes_jobs_and_moves_nothing() {
    let mut bench = Bench::new();
    let mut all = bench.job(false);
    all.extend(bench.ticks(10_000));
    assert!(!all.iter().any(|action| matches!(action, Action::Robot(_) | Action::Gripper(_))), "{all:?}");
    assert_eq!(ended(&all), None, "waiting for a person is no failure");
}

#[test]
fn arming_names_what_is_missing_and_is_not_made_up_for_later() {
    for (word, remove) in MISSING {
        let mut bench = Bench::new();
        let there = (bench.robot.clone(), bench.vacuum);
        remove(&mut bench);
        bench.job(false);
        let mut all = bench.feed(order(Order::Arm));
        let reply = answer(&all).expect("an answer");
        assert!(!reply.accepted && reply.message.contains(word), "{word}: {}", reply.message);
        assert!(reply.message.contains("celld arm"), "what to do: {}", reply.message);
        // What was missing comes, as after a boot or when an emergency stop is let go.
        (bench.robot, bench.vacuum) = there;
        (bench.link_down, bench.silent, bench.gripper_answers) = (None, false, true);
        bench.cell.model.confirmed = ConfirmedGripper::NotNeeded;
        all.extend(bench.ticks(500));
        assert_eq!(streams(&all), 0, "{word}: nothing moves");
        assert!(!all.iter().any(|action| matches!(action, Action::Robot(_))), "{word}: {all:?}");
        assert!(!bench.cell.status().armed, "{word}");
        assert!(answer(&bench.feed(order(Order::Arm))).expect("an answer").accepted, "{word}: now");
    }
}

#[test]
fn a_way_back_that_is_refused_names_no_order_that_is_refused_too() {
    let mut refused = 0;
    for (word, remove) in MISSING {
        let mut bench = Bench::new();
        bench.vacuum = [0.5, 0.0];
        bench.ticks(3);
        remove(&mut bench);
        let reply = answer(&bench.feed(order(Order::Recover(WayBack::Retreat)))).expect("an answer");
        refused += usize::from(!reply.accepted);
        assert!(!reply.message.contains("celld arm"), "{word}: {}", reply.message);
    }
    assert!(refused > 10, "{refused}");
}

/// Who reads the status is not sent to arm a cell that refuses it, whether it was stopped before or not.
#[test]
fn what_an_arming_lacks_comes_before_it_in_the_hint() {
    let stop = |keeps_job: bool| LastStop {
        at: (!keeps_job).then_some(Timestamp::ZERO),
        reason: Code::VacuumLost.because("a was lost", "see where it lies"),
        job: (!keeps_job).then(|| "j".to_string()),
        keeps_job,
    };
    for last_stop in [None, Some(stop(true)), Some(stop(false))] {
        for (word, remove) in MISSING {
            let mut bench = Bench::new();
            bench.job(false);
            bench.cell.back.last_stop.clone_from(&last_stop);
            bench.ticks(1);
            let hint = |bench: &Bench| bench.cell.status_with(&bench.devices(&bench.robot)).hint;
            let before = hint(&bench);
            assert_eq!(before.contains("`celld arm`"), last_stop.as_ref().is_none_or(|stop| stop.keeps_job));
            remove(&mut bench);
            bench.ticks(1);
            let closed = bench.cell.may_arm(&bench.devices(&bench.robot)).expect_err(word);
            let expected = match closed {
                GateClosed::Holding => bench.cell.status().hint,
                _ if !before.contains("`celld arm`") => before,
                _ => format!("{}; {before}", closed.hint_before_arming()),
            };
            assert_eq!(hint(&bench), expected, "{word}");
        }
    }
    let mut bench = Bench::new();
    bench.job(false);
    bench.ticks(1);
    bench.vacuum = [0.0, 0.4];
    bench.ticks(1);
    assert!(bench.cell.status().hint.contains("`celld recover` shows"), "{}", bench.cell.status().hint);
}

/// The stop is of the job before, and it is the next one that an arming begins.
#[test]
fn after_a_stop_the_hint_says_what_an_arming_begins() {
    for (agreed, pause, words) in [
        (
            false,
            false,
            "`celld arm` begins job j: the arm moves to look at the table; the plan then waits for approval",
        ),
        (
            true,
            false,
            "`celld arm` begins job j: the arm moves to look at the table, then it carries out what is planned: \
             the job is approved",
        ),
        (true, true, "`celld arm` begins job j: a pause is in force, `celld resume` ends it"),
    ] {
        let mut bench = Bench::new();
        bench.job(false);
        bench.cell.job.as_mut().expect("a job").order.approval = Approval::Job;
        bench.cell.job.as_mut().expect("a job").approved = agreed;
        if pause {
            bench.feed(order(Order::Pause));
        }
        bench.cell.back.last_stop = Some(LastStop {
            at: Some(Timestamp::ZERO),
            reason: Code::Aborted
                .because("the operator stopped", "see that the cell is safe; then `celld arm`"),
            job: Some("before".into()),
            keeps_job: false,
        });
        bench.ticks(1);
        let hint = bench.cell.status().hint;
        assert!(hint.starts_with("see that the cell is safe") && hint.ends_with(words), "{hint}");
    }
}

/// Readings scatter, and whoever watches the status is sent what changes alone.
#[test]
fn a_reading_of_the_vacuum_makes_no_other_status() {
    let mut bench = Bench::new();
    let mut of = |vacuum: f64| {
        bench.vacuum = [0.0, vacuum];
        bench.ticks(1);
        bench.cell.status_with(&bench.devices(&bench.robot))
    };
    let (one, other) = (of(0.60), of(0.61));
    assert_eq!(one, other);
    assert!(one.arm_refused.is_some_and(|why| why.contains("may hang on the gripper")));
    let free = of(0.0);
    assert_eq!((free.armed, free.arm_refused), (false, None));
}

/// A client that holds the inputs is named; the controller answers a `ping`.
#[test]
fn a_client_that_holds_the_inputs_comes_before_arming_in_the_hint() {
    let mut bench = Bench::new();
    bench.job(false);
    let taken = InputsTaken { names: vec!["input_int_register_24".to_string()], celld: None };
    bench.feed(Input::Robot(RobotEvent::InputInUse { taken, attempt: 1 }));
    bench.silent = true;
    bench.ticks(1);
    let hint = bench.cell.status_with(&bench.devices(&bench.robot)).hint;
    assert!(hint.contains("take the registers from it") && !hint.contains("ping"), "{hint}");
}

/// An object that hangs as celld has gripped it.
fn held() -> Held {
    let footprint = Footprint::rectangle(0.06, 0.06).expect("valid");
    let load = Load { name: "a".into(), footprint, tool_from_object: Pose2::default(), height: 0.02 };
    let (object, to) = ("a".to_string(), Pose2::new(0.35, 0.3, 0.0));
    let grasp = Some(Grasp::remembered(load, 20.0));
    Held { object, grasp, height: 0.02, mass: 0.1, hold: 20.0, to, let_go: false, unsealed: false }
}

/// A page offers what the status names, and nothing else.
#[test]
fn the_ways_in_the_status_are_those_that_the_cell_takes() {
    let (mut offered, mut refused) = (Vec::new(), 0);
    let others: &[Missing] = &[
        ("nothing", |_| {}),
        ("a stop before this start", |bench| {
            let reason = Code::Aborted.because("the operator aborted", "");
            bench.cell.back.last_stop = Some(LastStop { at: None, reason, job: None, keeps_job: false });
        }),
        ("the arm moves", |bench| bench.robot.qd[0] = 0.4),
        ("locked", |bench| bench.cell.mode = Mode::Locked("another arm".to_string())),
    ];
    for (word, remove) in MISSING.iter().chain(others) {
        for vacuum in [[0.01, 0.0], [0.5, 0.0]] {
            let bench = || {
                let mut bench = Bench::new();
                // The tool points straight down: what hangs there can be put down.
                bench.robot.q = Joints([-1.6, -1.6, 1.9, -FRAC_PI_2 - 0.3, -FRAC_PI_2, 0.0]);
                (bench.vacuum, bench.cell.back.held) = (vacuum, Some(held()));
                bench.ticks(3);
                remove(&mut bench);
                bench
            };
            let named = bench();
            let ways = named.cell.status_with(&named.devices(&named.robot)).ways;
            for way in [WayBack::Place, WayBack::Hold, WayBack::Release, WayBack::Retreat] {
                let taken = answer(&bench().feed(order(Order::Recover(way)))).is_none_or(|one| one.accepted);
                assert_eq!(ways.contains(&way), taken, "{word}, {vacuum:?}: {way:?}");
                offered.extend(taken.then_some(way));
                refused += usize::from(!taken);
            }
        }
    }
    let all = [WayBack::Place, WayBack::Hold, WayBack::Release, WayBack::Retreat];
    assert!(all.iter().all(|way| offered.contains(way)) && refused > 50, "{offered:?} {refused}");
    let mut bench = Bench::new();
    bench.ticks(3);
    assert_eq!(bench.cell.status_with(&bench.devices(&bench.robot)).ways, [], "there is nothing to leave");
}

#[test]
fn a_gripper_is_confirmed_once_while_it_answers() {
    let mut bench = Bench::new();
    bench.cell.model.confirmed = ConfirmedGripper::None;
    bench.gripper_answers = false;
    let confirm = |bench: &mut Bench| answer(&bench.feed(order(Order::ConfirmGripper))).expect("an answer");
    let refused = confirm(&mut bench);
    assert!(!refused.accepted && refused.message.contains("10.0.0.3:502, unit 65"), "{refused:?}");
    bench.gripper_answers = true;
    assert!(!answer(&bench.feed(order(Order::Arm))).expect("an answer").accepted);
    let confirmed = confirm(&mut bench);
    assert_eq!(confirmed.message, "confirmed: the gripper is at 10.0.0.3:502, unit 65");
    assert_eq!(confirmed.confirmed, Some(ConfirmedGripper::AtAddress));
    let again = confirm(&mut bench);
    assert!(again.message.starts_with("confirmed already"));
    assert_eq!(again.confirmed, confirmed.confirmed, "the disk may have been full before");
    assert!(answer(&bench.feed(order(Order::Arm))).expect("an answer").accepted);
}

/// A serial number `s1` or `s2` in its registers.
fn with_serial(last: u8) -> Option<Identity> {
    let mut serial = [0; 16];
    serial[0] = u16::from_be_bytes([b's', last]);
    Some(Identity { serial: Some(serial), ..Identity::default() })
}

#[test]
fn a_gripper_is_confirmed_once_wherever_it_is_and_another_one_again() {
    let mut bench = Bench::new();
    bench.cell.model.confirmed = ConfirmedGripper::AtAddress;
    bench.identity = with_serial(b'1');
    let order = |bench: &mut Bench, wanted: Order| answer(&bench.feed(order(wanted))).expect("an answer");
    let reply = order(&mut bench, Order::Arm);
    assert!(reply.message.contains("by its address only"), "{reply:?}");
    let reply = order(&mut bench, Order::ConfirmGripper);
    assert_eq!(reply.confirmed, Some(ConfirmedGripper::Serial("s1".into())));
    assert!(reply.message.contains("serial number s1"), "{reply:?}");
    for (identity, words) in [
        (with_serial(b'2'), "another gripper"),
        (Some(Identity::default()), "another gripper"),
        (None, "was not read yet"),
    ] {
        bench.identity = identity;
        let reply = order(&mut bench, Order::Arm);
        assert!(!reply.accepted && reply.message.contains(words), "{identity:?}: {reply:?}");
    }
    bench.identity = with_serial(b'1');
    bench.cell.model.addresses.gripper = "10.0.0.9:502, unit 65".into();
    assert!(order(&mut bench, Order::Arm).accepted, "at another address it is still the same");
}

#[test]
fn an_arm_that_is_off_is_powered_at_the_order_and_the_answer_says_so() {
    for mode in [RobotMode::PowerOff, RobotMode::Idle] {
        let mut bench = Bench::new();
        bench.robot.robot_mode = mode;
        let all = bench.feed(order(Order::Arm));
        let reply = answer(&all).expect("an answer");
        assert!(reply.accepted && reply.message.contains("brakes"), "{}", reply.message);
        let ordered = |wanted: RobotCommand| {
            all.iter().any(|action| matches!(action, Action::Robot(command) if *command == wanted))
        };
        let command =
            if mode == RobotMode::Idle { RobotCommand::ReleaseBrakes } else { RobotCommand::PowerOn };
        assert!(ordered(command), "at once, without a job: {all:?}");
    }
}

#[test]
fn the_answer_says_what_the_arm_does_next() {
    let mut bench = Bench::new();
    let reply = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    assert_eq!(reply, Reply::accept("armed: the arm moves as soon as there is a job"));
    let mut bench = Bench::new();
    bench.job(false);
    let reply = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    let then =
        "then the arm moves to look at the table, then it carries out what is planned: no approval is needed";
    assert_eq!(reply.message, format!("armed: celld starts its program on the robot now, {then}"));
    let mut bench = Bench::new();
    bench.robot.robot_mode = RobotMode::PowerOff;
    bench.feed(order(Order::Pause));
    let reply = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    assert!(reply.message.contains("brakes now; then a pause is in force"), "no job moves it: {reply:?}");
}

/// What was put down may hang on the cups until a look, but it does not keep the cell from arming.
#[test]
fn only_what_may_hang_on_the_gripper_comes_before_arming() {
    for (let_go, hint) in [(true, "`celld arm` once the cell is clear"), (false, "`celld recover` shows")] {
        let mut bench = Bench::new();
        bench.job(true);
        let (object, to) = ("b".to_string(), Pose2::default());
        let held =
            Held { object, grasp: None, height: 0.02, mass: 0.1, hold: 1.0, to, let_go, unsealed: false };
        bench.cell.back.held = Some(held);
        bench.ticks(1);
        let status = bench.cell.status();
        assert!(status.hint.contains(hint), "{let_go}: {}", status.hint);
    }
}

#[test]
fn a_plan_that_waits_for_approval_still_waits_when_the_cell_is_armed() {
    let mut bench = Bench::new();
    bench.job(true);
    bench.until_planning();
    bench.plan();
    bench.feed(order(Order::Disarm));
    let all = bench.feed(order(Order::Arm));
    let reply = answer(&all).expect("an answer");
    assert_eq!(reply, Reply::accept("armed; the plan waits for `celld approve`"));
    assert_eq!(streams(&all) + streams(&bench.ticks(50)), 0, "and nothing moves");
}

#[test]
fn a_gate_that_keeps_an_armed_cell_still_is_named_in_the_answer() {
    let mut bench = Bench::new();
    bench.job(false);
    bench.until_planning();
    bench.feed(order(Order::Disarm));
    bench.plan();
    bench.robot.runtime_state = RuntimeState::Paused;
    let reply = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    assert_eq!(reply, Reply::accept("armed; nothing moves yet: the program is paused"));
}

#[test]
fn a_simulated_cell_is_armed_once_when_everything_is_there() {
    let mut bench = Bench::new();
    bench.cell.arm_at_start();
    bench.link_down = Some(Link::Primary);
    bench.ticks(10);
    assert!(!bench.cell.status().armed);
    bench.link_down = None;
    bench.ticks(1);
    assert!(bench.cell.status().armed);
    bench.feed(order(Order::Disarm));
    bench.ticks(10);
    assert!(!bench.cell.status().armed, "once");
    for ordered in [Order::Disarm, Order::Abort] {
        let mut bench = Bench::new();
        bench.cell.arm_at_start();
        bench.link_down = Some(Link::Primary);
        bench.feed(order(ordered.clone()));
        bench.link_down = None;
        bench.feed(Input::Robot(RobotEvent::Stopped));
        bench.ticks(10);
        assert!(!bench.cell.status().armed, "{ordered:?} takes it back");
    }
}

#[test]
fn a_plan_that_comes_after_a_disarming_is_shown_to_no_person() {
    let mut bench = Bench::new();
    bench.job(true);
    bench.until_planning();
    bench.feed(order(Order::Disarm));
    let all = bench.plan();
    let alarmed = |all: &[Action]| all.iter().any(|a| matches!(a, Action::Say(notice) if notice.alarm));
    assert!(!alarmed(&all), "the table may have been changed since: {all:?}");
    let reply = answer(&bench.feed(order(bench.approval()))).expect("an answer");
    assert!(!reply.accepted, "there is nothing to approve: {reply:?}");
    let reply = answer(&bench.feed(order(Order::Arm))).expect("an answer");
    assert_eq!(
        reply.message,
        "armed: the arm moves to look at the table now; the plan then waits for approval"
    );
    bench.look();
    assert!(alarmed(&bench.plan()), "the plan of the new look is");
}
