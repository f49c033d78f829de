//! Recorded runs, carried out again: the cell decides the same, byte for byte.
//!
//! In: whole cells in virtual time, their faults by seed. Out: no difference between what was decided and
//! what is decided again from the recording's bytes. A recording that `celld replay --as-test` puts into
//! `tests/recordings` is replayed here.

#![allow(clippy::unwrap_used, reason = "helpers of tests: an unwrap that fails is the test that fails")]

use cell_machine::event::Event;
use cell_machine::orders::Order;
use cell_replay::{Kind, Piece, Replay, event_of};
use celld::daemon::recorder::{piece_of, topic_of};
use celld::io::recording::Recording;
use celld::io::recording::read::{Item, Items};
use celld::pair::camera_view::SightKind;
use celld::pair::rules::Rule;
use celld::pair::run::{bring_up, run_jobs, true_poses};
use celld::pair::storm::{storm, strikes};
use celld::pair::table::stage;
use celld::pair::work::job;
use celld::pair::{Choice, Pair};
use rearrange::geometry::pose::Pose2;
use std::path::Path;
use std::process::Command;

fn differs(pair: &Pair) -> Option<String> {
    let breach = pair.breaches().iter().find(|breach| breach.rule == Rule::ReplayDiffers);
    breach.map(|breach| breach.detail.clone())
}

/// More of them: `celld simulate --faults random --jobs 200 --replay`.
#[test]
fn jobs_with_faults_are_decided_the_same_again() {
    let mut decisions = 0;
    for seed in 100..106 {
        let stage = stage(seed, SightKind::Corners).unwrap();
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
    let stage = stage(3, SightKind::Pictures).unwrap();
    let choice = Choice { replay: true, eye: SightKind::Pictures, ..Choice::of(3) };
    let (summary, pair) = run_jobs(&stage, choice, 1, &[], &mut |_| {}).unwrap();
    assert_eq!((summary.jobs, differs(&pair)), (1, None));
}

/// The pieces of one job, as a recording has them.
fn pieces() -> Vec<Piece> {
    let stage = stage(5, SightKind::Corners).unwrap();
    let mut choice = Choice::of(5);
    choice.replay = true;
    let mut pair = Pair::new(stage.clone(), choice).unwrap();
    pair.keep_pieces();
    bring_up(&mut pair);
    pair.order(Order::Arm);
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

/// A job as a recording in a file; where everything truly lies at its end.
fn recorded_job(path: &Path) -> Vec<(String, Pose2)> {
    let stage = stage(8, SightKind::Corners).unwrap();
    let mut choice = Choice::of(8);
    choice.replay = true;
    let mut pair = Pair::new(stage.clone(), choice).unwrap();
    pair.keep_pieces();
    bring_up(&mut pair);
    pair.order(Order::Arm);
    pair.submit(job(&stage.model, &true_poses(&pair, &stage.model), 8, 0));
    assert!(pair.run_until(600.0, |pair| !pair.reports().is_empty()));
    let mut recording = Recording::create(path, 1.7e9).unwrap();
    for piece in pair.take_pieces() {
        recording.piece(topic_of(piece.kind), piece.at, &piece.bytes).unwrap();
    }
    recording.finish().unwrap();
    true_poses(&pair, &stage.model)
}

/// What the page says of the run is what happened: objects travel with the tool and end where they lie.
#[test]
fn a_recording_becomes_a_page_that_shows_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let (file, page) = (folder.path().join("run.mcap"), folder.path().join("run.html"));
    let truth = recorded_job(&file);
    let celld = env!("CARGO_BIN_EXE_celld");
    let ran = Command::new(celld).arg("replay").arg(&file).arg("--page").arg(&page).output().unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let html = std::fs::read_to_string(&page).unwrap();
    let json = html.split("id=\"data\">").nth(1).unwrap().split("</script>").next().unwrap();
    let run: serde_json::Value = serde_json::from_str(json).unwrap();
    let list = |value: &serde_json::Value| value.as_array().unwrap().clone();
    for (id, pose) in truth {
        let object = list(&run["objects"]).into_iter().find(|object| object["id"] == *id).unwrap();
        let last = list(&object["at"]).last().unwrap()[1].clone();
        let [x, y] = [0, 1].map(|axis| last[axis].as_f64().unwrap());
        let off = (pose.x - x).hypot(pose.y - y);
        assert!(off < 0.005, "{id} lies {off} m from where the page has it at the end");
    }
    let moves: usize = list(&run["plans"]).iter().map(|plan| list(&plan[1]).len()).max().unwrap();
    let carried = list(&run["objects"]).iter().filter(|object| list(&object["at"]).len() > 15).count();
    assert!(moves > 0 && carried > 0, "{moves} moves planned, {carried} objects seen to travel");
    let sentences: Vec<String> = list(&run["sentences"]).iter().map(|one| one["text"].to_string()).collect();
    assert!(sentences.iter().any(|text| text.contains("done")), "{sentences:?}");
    assert!(list(&run["states"]).iter().any(|state| state[1]["armed"] == true));
    let times: Vec<f64> = list(&run["arm"]).iter().map(|sample| sample[0].as_f64().unwrap()).collect();
    assert!(times.len() > 100 && times.is_sorted(), "{} places of the arm", times.len());
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
            let taken = replay.take(kind, &entry.piece());
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
