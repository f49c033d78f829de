//! Recorded runs, carried out again: the cell decides the same, byte for byte.
//!
//! In: whole cells in virtual time, their faults by seed. Out: no difference between what was decided and
//! what is decided again from the recording's bytes. A recording that `celld replay --as-test` puts into
//! `tests/recordings` is replayed here.

#![allow(clippy::unwrap_used, reason = "helpers of tests: an unwrap that fails is the test that fails")]

use cell_machine::event::Event;
use cell_replay::{Kind, Piece, Replay, event_of};
use celld::daemon::recorder::piece_of;
use celld::io::recording::read::{Item, Items};
use celld::pair::eyes::Eye;
use celld::pair::rules::Rule;
use celld::pair::run::run_jobs;
use celld::pair::storm::{storm, strikes};
use celld::pair::table::stage;
use celld::pair::{Choice, Pair};
use std::path::Path;

fn differs(pair: &Pair) -> Option<String> {
    let breach = pair.breaches().iter().find(|breach| breach.rule == Rule::ReplayDiffers);
    breach.map(|breach| breach.detail.clone())
}

/// More of them: `celld simulate --faults random --jobs 200 --replay`.
#[test]
fn jobs_with_faults_are_decided_the_same_again() {
    let mut decisions = 0;
    for seed in 100..106 {
        let stage = stage(seed, Eye::Corners).unwrap();
        let choice = Choice { replay: true, ..Choice::of(seed) };
        let (_, pair) = storm(&stage, choice, &strikes(seed)).unwrap();
        assert_eq!(differs(&pair), None, "seed {seed}");
        decisions += pair.replayed().unwrap().decisions;
    }
    assert!(decisions > 20_000, "{decisions}");
}

/// Rendered pictures, the real detector and depth are observations like any other.
#[test]
fn a_job_on_pictures_is_decided_the_same_again() {
    let stage = stage(3, Eye::Pictures).unwrap();
    let choice = Choice { replay: true, eye: Eye::Pictures, ..Choice::of(3) };
    let (summary, pair) = run_jobs(&stage, choice, 1, &[], &mut |_| {}).unwrap();
    assert_eq!((summary.jobs, differs(&pair)), (1, None));
}

/// The pieces of one job, as a recording has them.
fn pieces() -> Vec<Piece> {
    let stage = stage(5, Eye::Corners).unwrap();
    let mut choice = Choice::of(5);
    choice.replay = true;
    let mut pair = Pair::new(stage.clone(), choice).unwrap();
    pair.keep_pieces();
    celld::pair::run::bring_up(&mut pair);
    pair.order(cell_machine::orders::Order::Arm);
    pair.run_until(3.0, |_| false);
    pair.take_pieces()
}

fn replayed(pieces: &[Piece]) -> Option<u64> {
    let mut replay = Replay::default();
    let differs = |piece: &Piece| replay.take(piece.kind, &piece.bytes).unwrap();
    pieces.iter().find_map(differs).map(|difference| difference.decision)
}

/// Whatever is missing or changed in a recording, the replay names a decision that differs.
#[test]
fn a_recording_that_lacks_something_differs() {
    let pieces = pieces();
    assert_eq!(replayed(&pieces), None);
    let without = |index: usize| {
        let mut less = pieces.clone();
        less.remove(index);
        replayed(&less)
    };
    let of =
        |kind: Kind| pieces.iter().enumerate().filter(move |(_, piece)| piece.kind == kind).map(|(at, _)| at);
    let effects: Vec<usize> = of(Kind::Effect).collect();
    assert!(effects.len() > 100, "{}", effects.len());
    for index in effects.iter().step_by(effects.len() / 20) {
        assert!(without(*index).is_some(), "an effect is missing");
    }
    // The first bytes of each connection and the order decide everything behind them.
    let order = pieces.iter().position(|piece| {
        piece.kind == Kind::Event && matches!(event_of(&piece.bytes), Some((_, Event::Order(..))))
    });
    assert!(without(order.expect("an order")).is_some(), "the order is missing");
    let mut changed = pieces.clone();
    let last = changed[effects[50]].bytes.len() - 1;
    changed[effects[50]].bytes[last] ^= 1;
    // Each effect is a decision, and so is each machine between two turns but the first.
    let before = pieces[..effects[50]].iter().filter(|piece| piece.kind != Kind::Event).count() as u64 - 1;
    assert_eq!(replayed(&changed), Some(before + 1));
}

#[test]
fn recorded_runs_are_decided_the_same_for_ever() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings");
    let Ok(entries) = std::fs::read_dir(&folder) else { return };
    for path in entries
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "mcap"))
    {
        let mut replay = Replay::default();
        for item in Items::new(std::fs::File::open(&path).unwrap()) {
            let Item::Message(entry) = item.unwrap() else { continue };
            let Some(kind) = piece_of(&entry.channel.topic) else { continue };
            let taken = replay.take(kind, &entry.data);
            assert_eq!(
                taken.unwrap_or_else(|error| panic!("{}: {error}", path.display())),
                None,
                "{}",
                path.display()
            );
        }
        assert!(replay.so_far().decisions > 0, "{} has nothing to replay", path.display());
    }
}
