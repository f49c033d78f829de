//! Ways back after a stop, in virtual time: what `celld recover` says, and what the arm and the vacuum truly
//! do.

use cell_machine::device::gripper_types::Channels;
use cell_machine::orders::{Order, Reply, WayBack};
use celld::pair::camera_view::SightKind;
use celld::pair::run::{bring_up, true_poses};
use celld::pair::stage::Stage;
use celld::pair::table::stage;
use celld::pair::work::job;
use celld::pair::{Choice, Loss, Pair};
use rearrange::geometry::collision::penetration;
use ur_sim::faults::read::read_posted;
use ur_sim::world::lock;

const PROTECTIVE_STOP: &str = r#"{"do": "ur.pstop"}"#;

fn fault(pair: &mut Pair, text: &str) {
    for planned in read_posted(text).expect("a fault of the catalogue") {
        pair.fault(planned).expect("a fault of the catalogue");
    }
}

/// The answer to an order.
fn answer(pair: &mut Pair, order: Order) -> Reply {
    pair.take_replies();
    let number = pair.order(order);
    let mut reply = None;
    let come = pair.run_until(10.0, |_| false);
    assert!(!come);
    reply = reply.or_else(|| pair.take_replies().into_iter().find(|(of, _)| *of == number));
    reply.expect("an answer within 10 s").1
}

/// A cell in which an object is carried.
fn carrying(seed: u64, eye: SightKind) -> (Pair, Stage) {
    let stage = stage(seed, eye).expect("a cell");
    let mut pair = Pair::new(stage.clone(), Choice { eye, ..Choice::of(seed) }).expect("a cell");
    assert!(bring_up(&mut pair));
    pair.order(Order::Arm);
    pair.submit(job(&stage.model, &true_poses(&pair, &stage.model), seed, 0));
    let carries = |pair: &Pair| pair.status().is_some_and(|now| now.text().starts_with("carrying"));
    assert!(pair.run_until(90.0, carries), "seed {seed}");
    pair.run_until(0.2 + 0.1 * (seed % 6) as f64, |_| false);
    (pair, stage)
}

fn holds(pair: &Pair) -> bool {
    lock(&pair.simulator().core().world).glance().holds
}

fn cups_m(pair: &Pair) -> f64 {
    lock(&pair.simulator().core().world).glance().tool[2]
}

fn safe(pair: &Pair) -> bool {
    pair.simulator().core().robot.controller().core.modes.motion_allowed()
}

fn at_rest_and_disarmed(pair: &Pair) -> bool {
    let idle = pair.status().is_some_and(|status| !status.armed && status.text() == "idle");
    idle && pair.simulator().core().robot.controller().core.mover.stands()
}

/// No two objects on the table overlap by more than what measuring and placing leave, in truth.
fn check_table(pair: &Pair, stage: &Stage, seed: u64) {
    let poses = true_poses(pair, &stage.model);
    assert_eq!(poses.len(), stage.model.objects.len(), "seed {seed}: everything is on the table");
    for (number, (a, at)) in poses.iter().enumerate() {
        for (b, there) in &poses[number + 1..] {
            let (one, other) = (
                stage.model.object(a).expect("in the catalogue"),
                stage.model.object(b).expect("in the catalogue"),
            );
            let overlap = penetration(&one.footprint, at, &other.footprint, there);
            assert!(overlap < 1e-3, "seed {seed}: {a} and {b} overlap by {overlap}");
        }
    }
}

/// What is said of the place at the end is what was announced, or another with its reason; true of another.
fn check_place(said: &[&String], announced: &str, seed: u64) -> bool {
    let place =
        |text: &str| text.split_once(" (").and_then(|(_, rest)| Some(rest.split_once(')')?.0.to_string()));
    let end = said.iter().find(|text| text.contains("was put down ")).expect("it was put down");
    let meant = place(announced).is_some() && place(end) == place(announced);
    let elsewhere = end.contains("at the nearest free place") && end.contains("): ");
    assert!(
        end.contains("where it was to go (") == meant && meant != elsewhere,
        "seed {seed}: {end}, {announced}"
    );
    elsewhere
}

/// A person puts another object where the held one was to go.
fn block_the_place(pair: &mut Pair, stage: &Stage) {
    let shown = answer(pair, Order::Recover(WayBack::Show)).message;
    let (_, rest) = shown.split_once("and puts ").expect("what `place` does");
    let (held, rest) = rest.split_once(" down where it was to go (x ").expect("its place");
    let mm: Vec<f64> = rest.split([' ', ',']).filter_map(|word| word.parse().ok()).take(2).collect();
    let other = true_poses(pair, &stage.model).into_iter().find(|(id, _)| id != held).expect("another").0;
    let [x, y] = [mm[0] / 1e3, mm[1] / 1e3];
    fault(
        pair,
        &format!(r#"{{"do": "world.place", "args": {{"object": "{other}", "pose": [{x}, {y}, 0]}}}}"#),
    );
}

fn placed_after_a_protective_stop(seed: u64, eye: SightKind, blocked: bool) -> bool {
    let (mut pair, stage) = carrying(seed, eye);
    fault(&mut pair, PROTECTIVE_STOP);
    pair.run_until(1.0, |_| false);
    assert!(holds(&pair) && !safe(&pair), "seed {seed}");
    if blocked {
        block_the_place(&mut pair, &stage);
    }
    let reply = answer(&mut pair, Order::Recover(WayBack::Place));
    assert!(reply.accepted, "seed {seed}: {reply:?}");
    let over = pair.run_until(90.0, |pair| at_rest_and_disarmed(pair) && safe(pair));
    let said: Vec<_> = pair.notices().iter().rev().take(4).map(|notice| &notice.text).collect();
    assert!(over && !holds(&pair), "seed {seed}: {said:?}");
    let elsewhere = check_place(&said, &reply.message, seed);
    check_table(&pair, &stage, seed);
    assert_eq!(pair.breaches(), [], "seed {seed}");
    // Work goes on.
    assert!(answer(&mut pair, Order::Arm).accepted, "seed {seed}");
    let ended = pair.reports().len();
    pair.submit(job(&stage.model, &true_poses(&pair, &stage.model), seed, 1));
    assert!(pair.run_until(300.0, |pair| pair.reports().len() > ended), "seed {seed}");
    assert_eq!(pair.reports().last().expect("a report").code.as_str(), "done", "seed {seed}");
    assert_eq!(pair.breaches(), [], "seed {seed}");
    elsewhere
}

#[test]
fn what_is_held_in_a_protective_stop_is_put_down_and_work_goes_on() {
    for seed in 0..12 {
        placed_after_a_protective_stop(seed, SightKind::Corners, false);
    }
    // Where the place is taken meanwhile, it is another, and said to be: of these two what is put there lies
    // flat.
    for seed in 12..14 {
        assert!(placed_after_a_protective_stop(seed, SightKind::Corners, true), "seed {seed}");
    }
}

#[test]
fn what_is_held_is_put_down_by_pictures_too() {
    placed_after_a_protective_stop(3, SightKind::Pictures, false);
}

fn placed_after_a_restart(seed: u64, eye: SightKind) {
    let (mut pair, stage) = carrying(seed, eye);
    pair.restart(Loss::Killed).expect("a template");
    let knows = |pair: &Pair| {
        let held = pair.status().and_then(|status| status.held.as_deref());
        held.is_some_and(|held| held.starts_with("holds "))
    };
    assert!(pair.run_until(10.0, |pair| knows(pair) && at_rest_and_disarmed(pair)), "seed {seed}");
    // The program of the killed daemon brakes, and ends.
    pair.run_until(2.0, |_| false);
    assert!(holds(&pair), "seed {seed}");
    let reply = answer(&mut pair, Order::Recover(WayBack::Place));
    assert!(reply.accepted, "seed {seed}: {reply:?}");
    let over = pair.run_until(90.0, |pair| at_rest_and_disarmed(pair) && !holds(pair));
    let said: Vec<_> = pair.notices().iter().rev().take(4).map(|notice| &notice.text).collect();
    assert!(over, "seed {seed}: {said:?}");
    assert!(said.iter().any(|text| text.contains("was put down ")), "seed {seed}: {said:?}");
    check_table(&pair, &stage, seed);
    assert_eq!(pair.breaches(), [], "seed {seed}");
}

#[test]
fn what_was_carried_when_the_daemon_was_killed_is_put_down_by_the_next_one() {
    for seed in 0..12 {
        placed_after_a_restart(seed, SightKind::Corners);
    }
}

#[test]
fn what_was_carried_when_the_daemon_was_killed_is_put_down_by_pictures_too() {
    placed_after_a_restart(3, SightKind::Pictures);
}

#[test]
fn a_choice_unlocks_after_the_controllers_five_seconds_and_not_without_it() {
    let (mut pair, _) = carrying(1, SightKind::Corners);
    fault(&mut pair, PROTECTIVE_STOP);
    pair.run_until(20.0, |_| false);
    assert!(!safe(&pair), "never by itself");
    let shown = answer(&mut pair, Order::Recover(WayBack::Show));
    for part in ["protective stop", "C204A0", "held: ", "--place", "--retreat"] {
        assert!(shown.accepted && shown.message.contains(part), "{part}: {}", shown.message);
    }
    assert!(!safe(&pair), "showing chooses nothing");
    let stood = cups_m(&pair);
    let kept = answer(&mut pair, Order::Recover(WayBack::Hold));
    assert!(kept.accepted && kept.message.contains("stays held"), "{kept:?}");
    assert!(safe(&pair) && holds(&pair) && (cups_m(&pair) - stood).abs() < 1e-4);
    let raised = answer(&mut pair, Order::Recover(WayBack::Retreat));
    assert!(raised.accepted && raised.message.contains("straight up"), "{raised:?}");
    assert!(pair.run_until(30.0, at_rest_and_disarmed));
    assert!(holds(&pair) && cups_m(&pair) >= stood - 1e-4);
    let released = answer(&mut pair, Order::Recover(WayBack::Release));
    assert!(released.accepted && !holds(&pair), "{released:?}");
    let nothing = answer(&mut pair, Order::Recover(WayBack::Release));
    assert!(!nothing.accepted && nothing.message.contains("no vacuum"), "{nothing:?}");
    assert_eq!(pair.breaches(), []);
}

#[test]
fn an_abort_and_a_stop_end_a_way_back_and_the_object_stays_held() {
    const CABLE: &str = r#"{"do": "net.reset_peer", "args": {"link": "rtde"}}"#;
    for seed in 0..6 {
        let (mut pair, _) = carrying(seed, SightKind::Corners);
        fault(&mut pair, PROTECTIVE_STOP);
        pair.run_until(1.0, |_| false);
        pair.order(Order::Recover(WayBack::Place));
        // As its program starts, round the look poses, and coming down.
        let words = ["starting the robot", "looking", "putting down"][seed as usize / 2];
        let there = |pair: &Pair| pair.status().is_some_and(|status| status.text().contains(words));
        assert!(pair.run_until(60.0, there), "seed {seed}: {words}");
        pair.run_until(0.1, |_| false);
        match seed % 4 {
            0 => drop(pair.order(Order::Abort)),
            1 => fault(&mut pair, PROTECTIVE_STOP),
            2 => fault(&mut pair, CABLE),
            _ => drop(pair.order(Order::Disarm)),
        }
        pair.run_until(20.0, |_| false);
        assert!(!pair.status().unwrap().armed, "seed {seed}");
        assert_eq!(pair.breaches(), [], "seed {seed}");
        // And a way back is still there.
        let again = answer(&mut pair, Order::Recover(WayBack::Place));
        assert!(again.accepted, "seed {seed}: {again:?}");
        assert!(pair.run_until(90.0, |pair| at_rest_and_disarmed(pair) && !holds(pair)), "seed {seed}");
        assert_eq!(pair.breaches(), [], "seed {seed}");
    }
}

#[test]
fn a_way_back_is_refused_where_it_is_none() {
    let (mut pair, _) = carrying(2, SightKind::Corners);
    let armed = answer(&mut pair, Order::Recover(WayBack::Retreat));
    assert!(!armed.accepted && armed.message.contains("armed"), "{armed:?}");
    let (mut pair, _) = carrying(2, SightKind::Corners);
    fault(&mut pair, r#"{"do": "ur.estop"}"#);
    pair.run_until(2.0, |_| false);
    for way in [WayBack::Place, WayBack::Hold, WayBack::Retreat, WayBack::Release] {
        let refused = answer(&mut pair, Order::Recover(way));
        assert!(!refused.accepted && refused.message.contains("emergency stop"), "{way:?}: {refused:?}");
    }
    assert!(
        answer(&mut pair, Order::Release(Channels::Both)).accepted,
        "a person can always take the object"
    );
    assert_eq!(pair.breaches(), []);
}

/// How far the tool (m) and any joint (rad) get from where the arm rested, within so many seconds.
fn travel(pair: &mut Pair, seconds: f64) -> (f64, f64) {
    let place = |pair: &Pair| {
        let q = pair.simulator().core().robot.controller().core.mover.q();
        (lock(&pair.simulator().core().world).glance().tool, q)
    };
    let (tool, q) = place(pair);
    let (mut way, mut turn) = (0.0_f64, 0.0_f64);
    pair.run_until(seconds, |pair| {
        let (now, joints) = place(pair);
        let moved = now.iter().zip(tool).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        (way, turn) = (way.max(moved), turn.max(joints.max_difference(&q)));
        false
    });
    (way, turn)
}

/// A program that is paused cannot be stopped by its registers until it plays again: then it has to see the
/// stop in its first frame, whatever else does not answer.
#[test]
fn a_program_that_is_resumed_on_the_pendant_does_not_go_on() {
    const HUNG: &str = r#"{"do": "net.timeout", "args": {"link": "dashboard", "seconds": 30}}"#;
    let cases: [(&str, &[&str], f64); 3] = [
        ("paused, then in local control", &[r#"{"do": "ur.local", "args": {"seconds": 30}}"#], 8.0),
        ("paused with the dashboard hung", &[HUNG, r#"{"do": "ur.local", "args": {"seconds": 30}}"#], 8.0),
        ("daemon killed in the pause", &[], 8.0),
    ];
    for (name, faults, seconds) in cases {
        for seed in 0..6 {
            let (mut pair, _) = carrying(seed, SightKind::Corners);
            fault(&mut pair, &format!(r#"{{"do": "ur.pause", "args": {{"seconds": {seconds}}}}}"#));
            pair.run_until(1.0, |_| false);
            faults.iter().for_each(|text| fault(&mut pair, text));
            if faults.is_empty() {
                pair.restart(celld::pair::Loss::Killed).unwrap();
            }
            let (way, turn) = travel(&mut pair, 20.0);
            assert!(way < 5e-4 && turn < 1e-3, "{name}, seed {seed}: {:.1} mm", way * 1e3);
            assert_eq!(pair.breaches(), [], "{name}, seed {seed}");
        }
    }
    for seed in 0..6 {
        let (mut pair, _) = carrying(seed, SightKind::Corners);
        fault(&mut pair, HUNG);
        fault(&mut pair, r#"{"do": "ur.safeguard", "args": {"seconds": 6}}"#);
        pair.run_until(2.0, |_| false);
        let (_, turn) = travel(&mut pair, 20.0);
        assert!(turn.to_degrees() < 0.1, "safeguard, seed {seed}: {:.2} degrees", turn.to_degrees());
        assert_eq!(pair.breaches(), [], "safeguard, seed {seed}");
    }
}

/// The fault that a second master of the registers makes at the very start: named with its likely owners,
/// and waited for, however long it takes.
#[test]
fn a_claimed_register_at_the_start_is_named_and_waited_for() {
    let stage = stage(1, SightKind::Corners).unwrap();
    let mut pair = Pair::new(stage, Choice::of(1)).unwrap();
    fault(&mut pair, r#"{"do": "ur.claim", "args": {"input": "input_int_register_24"}}"#);
    for _ in 0..4 {
        pair.run_until(20.0, |_| false);
        let missing = pair.machine().missing().join("; ");
        for part in ["input_int_register_24", "PROFINET", "URCap"] {
            assert!(missing.contains(part), "{part}: {missing}");
        }
        let refused = answer(&mut pair, Order::Arm);
        assert!(!refused.accepted && refused.message.contains("input_int_register_24"), "{refused:?}");
    }
    fault(&mut pair, r#"{"do": "clear"}"#);
    assert!(bring_up(&mut pair), "{:?}", pair.machine().missing());
    assert_eq!(pair.machine().missing(), [""; 0]);
    assert!(answer(&mut pair, Order::Arm).accepted);
}

/// What hangs on the gripper is watched whatever the cell does: also after a stop, and after a restart.
#[test]
fn what_falls_after_a_stop_is_in_the_status_within_half_a_second_with_where() {
    for restarted in [false, true] {
        let (mut pair, _) = carrying(4, SightKind::Corners);
        pair.order(Order::Abort);
        pair.run_until(4.0, |_| false);
        if restarted {
            pair.restart(celld::pair::Loss::Killed).unwrap();
            assert!(bring_up(&mut pair));
            pair.run_until(2.0, |_| false);
        }
        assert!(holds(&pair), "restarted: {restarted}");
        let tool = lock(&pair.simulator().core().world).glance().tool;
        fault(&mut pair, r#"{"do": "vacuum.drop"}"#);
        let seen = |pair: &Pair| pair.status().and_then(|status| status.held.clone());
        let shown = pair.run_until(0.5, |pair| seen(pair).is_some_and(|held| held.contains("fell near")));
        assert!(shown, "restarted: {restarted}: {:?}", seen(&pair));
        let held = seen(&pair).unwrap();
        let shown = held.split("near x ").nth(1).and_then(|text| text.split(' ').next());
        let shown: f64 = shown.unwrap().parse().unwrap();
        assert!((shown - tool[0]).abs() < 5e-3, "{held}, the tool is at x {:.3}", tool[0]);
        assert!(pair.notices().last().unwrap().alarm, "a person has to look");
        assert_eq!(pair.breaches(), [], "restarted: {restarted}");
    }
}

#[test]
fn what_sticks_to_the_cups_is_named_before_the_next_pick_and_moves_on_no_more() {
    let (mut pair, _) = carrying(0, SightKind::Corners);
    fault(&mut pair, r#"{"do": "vacuum.stick", "args": {"seconds": 300}}"#);
    let ended = pair.reports().len();
    assert!(pair.run_until(60.0, |pair| pair.reports().len() > ended));
    let report = pair.reports().last().unwrap().clone();
    let object = report.object.clone().unwrap();
    assert_eq!((report.code.as_str(), report.moves), ("object_stuck", 1), "{report:?}");
    assert!(report.hint.contains("celld release --yes"), "{report:?}");
    let refused = answer(&mut pair, Order::Arm);
    assert!(!refused.accepted && refused.message.contains(&object), "{refused:?}");
    fault(&mut pair, r#"{"do": "clear"}"#);
    assert!(answer(&mut pair, Order::Release(Channels::Both)).accepted);
    assert!(answer(&mut pair, Order::Arm).accepted, "a person has said that it is gone");
    assert_eq!(pair.breaches(), []);
}

/// The stop leaves within 300 ms of the last answer: after that nothing proves that the object is still
/// there.
#[test]
fn a_gripper_that_falls_silent_while_carrying_stops_the_arm_within_300_ms() {
    for seed in 0..6 {
        let (mut pair, _) = carrying(seed, SightKind::Corners);
        let stopped =
            |pair: &Pair| pair.notices().iter().any(|notice| notice.text.contains("a stop is ordered"));
        fault(&mut pair, r#"{"do": "net.timeout", "args": {"link": "gripper", "seconds": 30}}"#);
        assert!(pair.run_until(0.3, stopped), "seed {seed}");
        assert!(pair.run_until(2.0, |pair| pair.simulator().core().robot.controller().core.mover.stands()));
    }
}

/// The tool does not come down onto a place without the object, wherever on the way it was lost.
#[test]
fn what_is_lost_on_a_way_back_ends_it() {
    for words in [
        "on a way back: unlocking",
        "starting the robot",
        "on a way back: looking",
        "on a way back: putting down",
    ] {
        let (mut pair, _) = carrying(5, SightKind::Corners);
        fault(&mut pair, PROTECTIVE_STOP);
        pair.run_until(1.0, |_| false);
        pair.order(Order::Recover(WayBack::Place));
        let there = |pair: &Pair| pair.status().is_some_and(|status| status.text().starts_with(words));
        assert!(pair.run_until(60.0, there), "{words}");
        pair.run_until(0.1, |_| false);
        fault(&mut pair, r#"{"do": "vacuum.drop"}"#);
        assert!(pair.run_until(10.0, at_rest_and_disarmed), "{words}");
        pair.run_until(20.0, |_| false);
        let said: Vec<&str> = pair.notices().iter().map(|notice| notice.text.as_str()).collect();
        assert!(said.iter().any(|text| text.contains("was lost on the way back")), "{words}: {said:?}");
        assert!(!said.iter().any(|text| text.contains("was put down")), "{words}: {said:?}");
        let refused = answer(&mut pair, Order::Arm);
        assert!(!refused.accepted, "{words}: nobody has said where it is: {refused:?}");
        assert_eq!(pair.breaches(), [], "{words}");
    }
}

/// The vacuum is gone in the middle of a carry. A job that may outlive it is not ended: once a person has
/// seen to the cups and armed the cell, it looks, plans anew and is done. One that may not is ended.
#[test]
fn a_job_outlives_a_lost_object_as_often_as_the_configuration_lets_it() {
    for (retries, seed) in [(0, 1), (1, 1), (1, 2), (1, 5)] {
        let mut stage = stage(seed, SightKind::Corners).expect("a cell");
        stage.model.tolerances.stop_retries = retries;
        let mut pair = Pair::new(stage.clone(), Choice::of(seed)).expect("a cell");
        assert!(bring_up(&mut pair));
        pair.order(Order::Arm);
        pair.submit(job(&stage.model, &true_poses(&pair, &stage.model), seed, 0));
        let carries = |pair: &Pair| pair.status().is_some_and(|now| now.text().starts_with("carrying"));
        assert!(pair.run_until(90.0, carries), "seed {seed}");
        fault(&mut pair, r#"{"do": "vacuum.drop"}"#);
        let disarmed = |pair: &Pair| pair.status().is_some_and(|status| !status.armed);
        assert!(pair.run_until(10.0, disarmed), "seed {seed}");
        pair.run_until(5.0, |_| false);
        assert_eq!(pair.reports().len(), 1 - retries as usize, "seed {seed}");
        let status = pair.status().expect("a status");
        assert!(status.stopped.is_some() && pair.simulator().core().robot.controller().core.mover.stands());
        if retries == 0 {
            assert_eq!(pair.reports()[0].code.as_str(), "vacuum_lost");
            continue;
        }
        assert!(
            status.hint.contains("celld recover") && status.hint.contains("look, plan anew and go on"),
            "{}",
            status.hint
        );
        assert!(answer(&mut pair, Order::Release(Channels::Both)).accepted, "seed {seed}");
        let armed = answer(&mut pair, Order::Arm);
        assert!(armed.accepted, "seed {seed}: {armed:?}");
        assert!(pair.run_until(300.0, |pair| !pair.reports().is_empty()), "seed {seed}");
        let report = &pair.reports()[0];
        assert_eq!(report.code.as_str(), "done", "seed {seed}: {}", report.message);
        assert_eq!(pair.breaches(), [], "seed {seed}");
    }
}
