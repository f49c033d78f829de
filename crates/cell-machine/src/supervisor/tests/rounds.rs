//! Calibration rounds: what begins them, and how their cell is left.

use super::faults::working;
use super::standing::moving_arm;
use super::*;
use crate::supervisor::gates::GateClosed;
use crate::supervisor::round::RoundFault;
use crate::supervisor::status::Doing;
use cell_motion::bodies::Room;
use cell_motion::crossing::Crossing;

/// A round of one pose, on its way there.
pub(super) fn round_under_way() -> Bench {
    let mut bench = Bench::new();
    let target = Joints([-1.5, -1.6, 1.9, -1.9, -1.57, 0.0]);
    bench.feed(Input::Round(Box::new(RoundOrder::pictures(vec![target], None))));
    assert_eq!(streams(&bench.ticks(20)), 1);
    bench
}

#[test]
fn a_calibration_round_ends_with_its_cell_disarmed_and_takes_no_pace() {
    let mut bench = round_under_way();
    for wanted in [Order::Pause, Order::Step, Order::Park] {
        let reply = answer(&bench.feed(order(wanted))).expect("an answer");
        assert!(!reply.accepted && reply.message.contains("`celld abort` ends it"), "{reply:?}");
    }
    let disarmed = bench.feed(order(Order::Disarm));
    assert!(disarmed.iter().any(|a| matches!(a, Action::RoundOver(Err(_)))), "{disarmed:?}");
    assert!(disarmed.iter().any(|a| matches!(a, Action::Robot(RobotCommand::Stop))), "{disarmed:?}");
    assert_eq!(answer(&disarmed), None);
}

/// A pose over the table at a height that the tallest object of the catalogue reaches.
#[test]
fn a_calibration_round_keeps_off_what_may_lie_on_the_table() {
    let target = Joints([-1.5, -1.6, 1.9, -1.9, -1.57, 0.0]);
    let height = model().arm.tool_at(&target).translation.vector.z;
    for (tallest, moves) in [(0.02, 1), (height + 0.05, 0)] {
        let mut bench = Bench::new();
        let mut model = model();
        model.cycle.tallest = tallest;
        bench.cell = Supervisor::new(model, 7);
        let round = RoundOrder::pictures(vec![target], None);
        let mut all = bench.feed(Input::Round(Box::new(round)));
        all.extend(bench.ticks(20));
        let refused = all.iter().any(|action| matches!(action, Action::RoundOver(Err(RoundFault::Move(_)))));
        assert_eq!((streams(&all), refused), (moves, moves == 0), "{tallest} m: {all:?}");
    }
}

/// It has not begun: the end of the round is not its own.
#[test]
fn a_job_that_comes_during_a_round_waits_when_the_round_is_stopped() {
    let target = Joints([-1.5, -1.6, 1.9, -1.9, -1.57, 0.0]);
    type End = fn(&mut Bench) -> Vec<Action>;
    let ends: [(&str, End); 3] = [
        ("local control", |bench| {
            bench.robot.remote_control = Some(false);
            bench.ticks(3)
        }),
        ("a disarming", |bench| bench.feed(order(Order::Disarm))),
        ("an arm guided by hand", |bench| {
            bench.robot.guided = true;
            bench.ticks(3)
        }),
    ];
    for (what, end) in ends {
        let mut bench = Bench::new();
        bench.feed(Input::Round(Box::new(RoundOrder::pictures(vec![target], None))));
        bench.ticks(20);
        bench.job(false);
        let ended = end(&mut bench);
        assert!(ended.iter().any(|action| matches!(action, Action::RoundOver(Err(_)))), "{what}: {ended:?}");
        assert!(!bench.cell.mode().armed() && bench.cell.round.is_none(), "{what}");
        assert!(bench.cell.job.as_ref().is_some_and(|job| job.order.id == "j" && job.stops == 0), "{what}");
        let said = format!("{ended:?}");
        assert!(!said.contains("submit again") && !said.contains("; ;"), "{what}: {said}");
    }
}

/// An abort ends it, and no text says that it waits.
#[test]
fn an_abort_in_a_round_ends_the_job_that_came_meanwhile() {
    let target = Joints([-1.5, -1.6, 1.9, -1.9, -1.57, 0.0]);
    let mut bench = Bench::new();
    bench.feed(Input::Round(Box::new(RoundOrder::pictures(vec![target], None))));
    bench.ticks(20);
    bench.job(false);
    let said = format!("{:?}", bench.feed(order(Order::Abort)));
    assert!(bench.cell.job.is_none() && bench.cell.round.is_none());
    assert!(said.contains("submit again") && !said.contains("the job waits"), "{said}");
}

#[test]
fn a_job_waits_also_when_the_round_never_got_under_way() {
    let target = Joints([-1.5, -1.6, 1.9, -1.9, -1.57, 0.0]);
    let mut bench = Bench::new();
    bench.feed(Input::Round(Box::new(RoundOrder::pictures(vec![target], None))));
    bench.robot.remote_control = Some(false);
    bench.ticks(3);
    bench.job(false);
    let mut turns = 0;
    while bench.cell.round.is_some() && turns < 20_000 {
        bench.ticks(1);
        turns += 1;
    }
    assert!(bench.cell.round.is_none() && !bench.cell.mode().armed(), "{turns} turns");
    assert!(bench.cell.job.is_some(), "after {turns} turns");
}

/// The arm sets out as soon as the gate opens, without another order.
#[test]
fn what_waits_for_a_gate_is_no_idleness() {
    let mut bench = Bench::new();
    bench.feed(order(Order::Arm));
    bench.ticks(20);
    assert_eq!(bench.cell.status().doing, Doing::Idle);
    bench.cell.waiting_for = Some(GateClosed::Paused);
    assert_eq!(bench.cell.status().doing, Doing::Idle, "nothing was ordered");
    bench.cell.mode.set_park(true);
    let status = bench.cell.status();
    assert!(status.armed && status.doing == Doing::Waiting(GateClosed::Paused), "{:?}", status.doing);
}

/// What a person orders at the page has the gates of any motion, and arms nothing.
#[test]
fn a_calibration_round_is_ordered_in_an_armed_cell_that_rests() {
    let target = Joints([-1.5, -1.6, 1.9, -1.9, -1.57, 0.0]);
    let with_round = || {
        let mut bench = Bench::new();
        let round = RoundOrder::pictures(vec![target], None);
        bench.cell = Supervisor::new(CellModel { round, ..model() }, 7);
        bench
    };
    let calibrate = |bench: &mut Bench| bench.feed(order(Order::Calibrate));
    let mut bench = Bench::new();
    bench.feed(order(Order::Arm));
    let none = answer(&calibrate(&mut bench)).expect("an answer");
    assert!(!none.accepted && none.message.contains("calibration_poses_deg"), "{none:?}");

    let mut bench = with_round();
    let refused = calibrate(&mut bench);
    assert!(answer(&refused).is_some_and(|reply| !reply.accepted && reply.message.contains("`celld arm`")));
    bench.ticks(20);
    assert!(bench.cell.round.is_none() && !bench.cell.mode().armed(), "it arms nothing");

    bench.feed(order(Order::Arm));
    bench.vacuum = [0.5, 0.0];
    let held = answer(&calibrate(&mut bench)).expect("an answer");
    assert!(!held.accepted && bench.cell.round.is_none(), "{held:?}");

    // Who has paused the cell counts on an arm that stays.
    let mut bench = with_round();
    bench.feed(order(Order::Arm));
    bench.ticks(20);
    bench.feed(order(Order::Pause));
    let paused = answer(&calibrate(&mut bench)).expect("an answer");
    assert!(!paused.accepted && paused.message.contains("`celld resume`"), "{paused:?}");
    assert_eq!(streams(&bench.ticks(20)), 0);

    let mut bench = with_round();
    bench.feed(order(Order::Arm));
    bench.ticks(20);
    let begun = calibrate(&mut bench);
    let reply = answer(&begun).expect("an answer");
    assert!(reply.accepted && reply.message.contains("1 poses"), "{reply:?}");
    let after = bench.ticks(20);
    assert_eq!(streams(&begun) + streams(&after), 1);
    let again = answer(&calibrate(&mut bench)).expect("an answer");
    assert!(again.message.contains("already"), "{again:?}");

    let mut bench = with_round();
    bench.job(false);
    bench.feed(order(Order::Arm));
    bench.ticks(20);
    let busy = answer(&calibrate(&mut bench)).expect("an answer");
    assert!(!busy.accepted && busy.message.contains("job j is under way"), "{busy:?}");
}

#[test]
fn no_calibration_round_begins_where_an_operator_could_not_arm() {
    let round = || Input::Round(Box::new(RoundOrder::pictures(vec![HOME], None)));
    let over = |actions: &[Action]| {
        let mut ends = actions.iter().filter_map(|action| match action {
            Action::RoundOver(result) => Some(result.clone()),
            _ => None,
        });
        ends.next()
    };
    let mut bench = working();
    moving_arm(&mut bench);
    bench.feed(order(Order::Abort));
    let refused = bench.feed(round());
    assert!(matches!(over(&refused), Some(Err(RoundFault::Robot(_)))), "{refused:?}");
    assert!(!bench.cell.mode().armed());
    bench.feed(Input::Shutdown);
    let ending = bench.feed(round());
    assert!(matches!(over(&ending), Some(Err(RoundFault::Robot(_)))), "{ending:?}");
}

/// One way over the table of the test's cell.
fn crossing() -> Crossing {
    let model = model();
    let room = Room::new(&model.arm.bodies, &model.cycle.tabletop(Vec::new()), None);
    Crossing::over_table(&model.arm, &HOME, [0.5, 0.5], &model.cycle, &room).expect("a way")
}

/// The arm has followed its path to here and rests.
fn arrived(bench: &mut Bench, q: Joints) -> Vec<Action> {
    bench.robot.q = q;
    let mut all = bench.feed(Input::Robot(RobotEvent::PathFinished { batch: 1 }));
    all.extend(bench.ticks(100));
    all
}

fn over(actions: &[Action]) -> Option<Result<(), RoundFault>> {
    actions.iter().find_map(|action| match action {
        Action::RoundOver(result) => Some(result.clone()),
        _ => None,
    })
}

#[test]
fn a_crossing_begins_at_its_start_and_each_is_crossed_once() {
    let there = crossing();
    let mut bench = Bench::new();
    bench.feed(Input::Round(Box::new(RoundOrder::crossings(vec![there, there.back()]))));
    let path = |actions: &[Action]| {
        let mut paths = actions.iter().filter_map(|action| match action {
            Action::Robot(RobotCommand::Stream(path)) => Some((path.segments().len(), path.end())),
            _ => None,
        });
        paths.next_back()
    };
    assert_eq!(path(&bench.ticks(20)), Some((1, there.start)), "slowly to the start");
    assert_eq!(path(&arrived(&mut bench, there.start)), Some((3, there.end)));
    assert_eq!(path(&arrived(&mut bench, there.end)), Some((3, there.start)), "back, without a way between");
    let ended = arrived(&mut bench, there.start);
    assert_eq!((path(&ended), over(&ended)), (None, Some(Ok(()))));
    assert!(!ended.iter().any(|action| matches!(action, Action::Picture { .. })));
    assert!(!bench.cell.mode().armed());
}

#[test]
fn an_arm_that_rests_elsewhere_is_not_sent_again() {
    let there = crossing();
    for at in [there.start, there.end] {
        let mut bench = Bench::new();
        bench.feed(Input::Round(Box::new(RoundOrder::crossings(vec![there]))));
        bench.ticks(20);
        if at == there.end {
            arrived(&mut bench, there.start);
        }
        let mut beside = at;
        beside.0[1] += 0.004;
        let ended = arrived(&mut bench, beside);
        assert!(matches!(over(&ended), Some(Err(RoundFault::Elsewhere { .. }))), "{ended:?}");
        assert_eq!(streams(&ended), 0);
        assert!(!bench.cell.mode().armed());
    }
}

/// Crossings are as fast as work; a round for pictures is slow, and only looks.
#[test]
fn with_something_on_the_cups_there_is_no_crossing() {
    let there = crossing();
    let mut bench = Bench::new();
    bench.vacuum = [0.5, 0.0];
    bench.ticks(3);
    let refused = bench.feed(Input::Round(Box::new(RoundOrder::crossings(vec![there]))));
    assert!(matches!(over(&refused), Some(Err(RoundFault::Robot(_)))), "{refused:?}");
    assert!(!bench.cell.mode().armed());
    // It is taken up on the way to the start.
    let mut bench = Bench::new();
    bench.feed(Input::Round(Box::new(RoundOrder::crossings(vec![there]))));
    assert_eq!(streams(&bench.ticks(20)), 1);
    bench.vacuum = [0.5, 0.0];
    let ended = arrived(&mut bench, there.start);
    assert!(matches!(over(&ended), Some(Err(RoundFault::Robot(_)))) && streams(&ended) == 0, "{ended:?}");
}
