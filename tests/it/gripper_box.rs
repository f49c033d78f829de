//! The gripper's box in virtual time: a pulled plug, a place that is kept for nobody, a second client.

use cell_machine::orders::Order;
use celld::pair::camera_view::SightKind;
use celld::pair::run::{bring_up, true_poses};
use celld::pair::table::stage;
use celld::pair::work::job;
use celld::pair::{Choice, Loss, Pair};
use ur_sim::box_clients::{BoxConfig, SecondClient};
use ur_sim::faults::read::read_posted;
use ur_sim::world::lock;

/// What a box may do with a second client.
const SECONDS: [SecondClient; 3] = [SecondClient::Refused, SecondClient::Evicts, SecondClient::Waits];

/// celld gives a release up after this, and some for a frame and the network, s.
const RELEASE_WITHIN_S: f64 = 2.1;

const PULLED: &str = r#"{"do": "net.timeout", "args": {"link": "gripper"}}"#;
const PLUGGED: &str = r#"{"do": "clear"}"#;

fn fault(pair: &mut Pair, text: &str) {
    for planned in read_posted(text).expect("a fault of the catalogue") {
        pair.fault(planned).expect("a fault of the catalogue");
    }
}

/// A cell whose box treats clients like this, and which carries an object.
fn carrying(seed: u64, clients: BoxConfig) -> Pair {
    let eye = SightKind::Corners;
    let mut stage = stage(seed, eye).expect("a cell");
    stage.world.gripper.clients = clients;
    let mut pair = Pair::new(stage.clone(), Choice { eye, ..Choice::of(seed) }).expect("a cell");
    assert!(bring_up(&mut pair));
    pair.order(Order::Arm);
    pair.submit(job(&stage.model, &true_poses(&pair, &stage.model), seed, 0));
    let carries = |pair: &Pair| pair.status().is_some_and(|now| now.text().starts_with("carrying"));
    assert!(pair.run_until(90.0, carries), "seed {seed}");
    pair
}

fn gripper_says(pair: &Pair) -> String {
    let status = pair.status().expect("a status");
    let gripper = status.devices.iter().find(|note| note.device.as_str() == "gripper");
    gripper.expect("a gripper").message.clone()
}

/// Seconds until it answers; all of them if it does not.
fn answers_within(pair: &mut Pair, seconds: f64) -> f64 {
    let began = pair.seconds();
    pair.run_until(seconds, |pair| gripper_says(pair).starts_with("answers"));
    pair.seconds() - began
}

#[test]
fn a_pulled_plug_while_carrying_is_named_within_half_a_second() {
    for seed in 1..=12 {
        for second in SECONDS {
            let mut pair = carrying(seed, BoxConfig { second, half_open_s: 0.0 });
            pair.run_until(0.05 * seed as f64, |_| false);
            fault(&mut pair, PULLED);
            let named = |pair: &Pair| {
                let stop = pair.status().and_then(|status| status.stopped.as_ref());
                stop.is_some_and(|stop| stop.code.as_str() == "gripper_unreachable")
            };
            let began = pair.seconds();
            let came = pair.run_until(10.0, named);
            let seconds = pair.seconds() - began;
            assert!(came && seconds <= 0.5, "seed {seed}: {seconds:.3} s, {:?}", pair.status());
            assert!(
                pair.run_until(2.0, |pair| {
                    pair.simulator().core().robot.controller().core.mover.stands()
                })
            );
            // What hangs on the cups is watched again as soon as the plug is back.
            pair.run_until(4.0, |_| false);
            fault(&mut pair, PLUGGED);
            let seconds = answers_within(&mut pair, 10.0);
            assert!(seconds <= 2.0, "seed {seed}, {second:?}: {seconds:.3} s");
            assert_eq!(gripper_says(&pair), "answers, and holds something", "seed {seed}");
            assert_eq!(pair.breaches(), [], "seed {seed}");
        }
    }
}

/// The computer loses power while the cable is out: the box keeps the place of a client that will never come
/// back. What hangs on the cups hangs there meanwhile.
#[test]
fn a_half_open_place_is_named_and_taken_once_it_is_free() {
    let named = [
        (SecondClient::Refused, "another client holds"),
        (SecondClient::Waits, "accepts the connection but does not answer"),
    ];
    for (seed, (second, words)) in (1..=6).zip(named.into_iter().cycle()) {
        let mut pair = carrying(seed, BoxConfig { second, half_open_s: 30.0 });
        fault(&mut pair, PULLED);
        pair.run_until(0.5, |_| false);
        pair.restart(Loss::Killed).expect("a template");
        let free_at = pair.seconds() + 30.0;
        fault(&mut pair, PLUGGED);
        let taken = |pair: &Pair| {
            pair.status().is_some_and(|status| status.devices.iter().any(|note| note.message.contains(words)))
        };
        assert!(pair.run_until(25.0, taken), "seed {seed}: {:?}", pair.status());
        while pair.seconds() < free_at {
            assert!(!gripper_says(&pair).starts_with("answers"), "seed {seed}");
            let held = pair.status().and_then(|status| status.held.clone()).expect("not known to be empty");
            assert!(held.ends_with("may hang on the cups"), "seed {seed}: {held}");
            pair.run_until(0.1, |_| false);
        }
        let seconds = answers_within(&mut pair, 10.0);
        assert!(seconds <= 2.0, "seed {seed}: {seconds:.3} s");
        assert_eq!(gripper_says(&pair), "answers, and holds something", "seed {seed}");
        assert_eq!(pair.breaches(), [], "seed {seed}");
    }
}

/// The cable goes as the object is to be let go: the command has not reached the box, and must not later, by
/// the connection that was cut or by the next one, which waits for the place of the first.
#[test]
fn a_release_that_a_pulled_cable_kept_back_is_never_carried_out_late() {
    for (seed, second) in (1..=6).zip(SECONDS.into_iter().cycle()) {
        for out_s in [1.3, 3.0] {
            let mut pair = carrying(seed, BoxConfig { second, half_open_s: 8.0 });
            let held = |pair: &Pair| lock(&pair.simulator().core().world).held().next().map(str::to_string);
            let object = held(&pair).expect("it carries");
            let lets_go =
                |pair: &Pair| pair.status().is_some_and(|status| status.text().starts_with("releasing"));
            assert!(pair.run_until(30.0, lets_go), "seed {seed}");
            fault(&mut pair, PULLED);
            pair.run_until(out_s, |_| false);
            assert_eq!(held(&pair).as_ref(), Some(&object), "the command was on its way");
            fault(&mut pair, PLUGGED);
            // celld tries for 2 s to let go; where the box takes a second client, the object is let go then.
            pair.run_until(RELEASE_WITHIN_S - out_s, |_| false);
            let hangs = held(&pair);
            assert!(hangs.is_some() || second == SecondClient::Evicts, "seed {seed}, {second:?}, {out_s} s");
            assert!(answers_within(&mut pair, 20.0) <= 10.0, "seed {seed}, {second:?}");
            pair.run_until(5.0, |_| false);
            assert_eq!(held(&pair), hangs, "seed {seed}, {second:?}, {out_s} s");
            assert_eq!(pair.breaches(), [], "seed {seed}");
        }
    }
}
