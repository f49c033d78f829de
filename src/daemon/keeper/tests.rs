//! The state folder as the daemon keeps it, on real folders and a real database.

use super::*;
use crate::config::load::load_cell;
use crate::jobs::record::StepPhase;
use cell_machine::supervisor::status::Doing;
use rearrange::geometry::pose::Pose2;

fn open(state: &StateFolder) -> StateKeeper {
    let config = load_cell(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/cell.yaml")).unwrap();
    StateKeeper::open(config, state.clone(), "d1".into()).unwrap()
}

/// A keeper with a job that waits.
fn with_a_job() -> (tempfile::TempDir, StateFolder, StateKeeper) {
    let folder = tempfile::tempdir().unwrap();
    let state = StateFolder::new(folder.path());
    state.take(&status::Status::default()).unwrap();
    let mut keeper = open(&state);
    let job = "version: 1\nid: tidy\ngoal:\n  objects:\n    - {id: lid, pose: [0.3, 0.38, 0]}\n";
    std::fs::write(state.incoming().join("tidy.yaml"), job).unwrap();
    for ms in [0, 600] {
        keeper.look_after(Timestamp::ZERO + Duration::from_millis(ms));
    }
    (folder, state, keeper)
}

fn intent() -> Record {
    Record::Intent {
        step: 0,
        object: "lid".into(),
        from: Pose2::default(),
        to: Pose2::default(),
        kind: ActionKind::Goal,
        tool_from_object: None,
        table: Vec::new(),
    }
}

/// What is held when a job is stopped and kept is taken off by hand: the job's step is closed by that,
/// and the next one can be opened.
#[test]
fn a_job_goes_on_after_what_it_held_was_let_go_by_hand() {
    let (_folder, _, mut keeper) = with_a_job();
    assert_eq!(keeper.claim().map(|job| job.id).as_deref(), Some("tidy"));
    for gripped in [false, true, false] {
        keeper.commit(&intent()).unwrap();
        if gripped {
            keeper.commit(&Record::Gripped { step: 0 }).unwrap();
        }
        keeper.commit(&Record::LetGo { how: String::new() }).unwrap();
    }
    keeper.commit(&intent()).unwrap();
    keeper.commit(&Record::Done { step: 0 }).unwrap();
    let phases: Vec<_> = keeper.journal.steps("tidy").unwrap().iter().map(|step| step.phase).collect();
    assert_eq!(phases.last(), Some(&StepPhase::Done), "{phases:?}");
    assert!(phases[..3].iter().all(|phase| *phase == StepPhase::Abandoned), "{phases:?}");
}

/// The word of a job that was cut off is there at every start until something else was done.
#[test]
fn a_job_that_was_cut_off_is_named_at_every_start_until_a_step_follows() {
    let (_folder, state, mut first) = with_a_job();
    assert_eq!(first.cut_off(), None);
    first.claim().expect("a job");
    first.commit(&intent()).unwrap();
    first.commit(&Record::Gripped { step: 0 }).unwrap();
    drop(first);
    for start in 2..4 {
        let cut_off = open(&state).cut_off().unwrap_or_else(|| panic!("start {start}"));
        assert!(cut_off.carrying && cut_off.object == "lid", "{cut_off:?}");
    }
    open(&state).commit(&Record::LetGo { how: String::new() }).unwrap();
    assert_eq!(open(&state).cut_off(), None, "it was taken off by hand");
}

#[test]
fn a_cell_whose_arm_is_on_the_way_is_not_idle_without_a_job_either() {
    let (_folder, state, mut keeper) = with_a_job();
    let rests = [Doing::Idle, Doing::Paused, Doing::Ready, Doing::Writing];
    let moves = [Doing::Visiting(1, 8), Doing::Parking, Doing::Recovering("lifting".into()), Doing::Stopping];
    for (doing, word) in
        rests.map(|doing| (doing, "idle")).into_iter().chain(moves.map(|doing| (doing, "working")))
    {
        keeper.status(&Status { doing: doing.clone(), ..Status::idle() });
        let written = status::Status::read(&state.status()).unwrap().expect("a status");
        assert_eq!(written.state, word, "{doing:?}");
    }
}

#[test]
fn a_file_that_is_refused_is_in_the_status() {
    let (_folder, state, mut keeper) = with_a_job();
    let file = state.root().join("jobs/incoming/wrong.yaml");
    std::fs::write(file, "version: 1\ngoal: {objects: [{id: nothing, pose: [0, 0, 0]}]}\n").unwrap();
    (0..20).for_each(|turn| _ = keeper.look_after(Timestamp::from_secs_f64(f64::from(turn))));
    keeper.status(&Status::idle());
    let written = status::Status::read(&state.status()).unwrap().expect("a status");
    let refused = written.refused.clone().expect("refused");
    assert!(refused.name == "wrong.yaml" && refused.message.contains("nothing"), "{refused:?}");
    assert!(written.text().contains("wrong.yaml was refused ("), "{}", written.text());
}

#[test]
fn on_a_full_disk_no_job_is_begun_and_the_status_says_so() {
    let (_folder, state, mut keeper) = with_a_job();
    let need = std::mem::replace(&mut keeper.disk.jobs_need, u64::MAX);
    assert!(keeper.claim().is_none());
    let idle = Status { armed: true, ..Status::idle() };
    let written = |keeper: &mut StateKeeper| {
        keeper.status(&idle);
        status::Status::read(&state.status()).unwrap().expect("a status")
    };
    let full = written(&mut keeper);
    assert!(full.message.contains("no job is begun") && full.hint.contains("make room"), "{full:?}");
    assert!(full.blocked.is_some_and(|why| full.message.ends_with(&why)));
    keeper.disk.jobs_need = need;
    assert_eq!(written(&mut keeper).blocked, None);
    assert_eq!((written(&mut keeper).message.as_str(), keeper.claim().is_some()), ("idle", true));
}

#[test]
fn a_status_that_could_not_be_replaced_does_not_stay_behind_celld() {
    let (_folder, state, mut keeper) = with_a_job();
    keeper.status(&Status { armed: true, ..Status::idle() });
    assert!(state.status().exists());
    // A folder in the place of the file cannot be replaced by one.
    std::fs::remove_file(state.status()).unwrap();
    std::fs::create_dir(state.status()).unwrap();
    keeper.status(&Status::idle());
    std::fs::remove_dir(state.status()).unwrap();
    std::fs::write(state.status(), "armed").unwrap();
    keeper.close();
    assert!(!state.status().exists());
    keeper.status(&Status::idle());
    keeper.close();
    assert!(state.status().exists(), "one that is of now stays");
}
