//! Seeded schedules of crashes, partitions, lost answers and redelivery over whole fleets in virtual time.
//!
//! In: seeds. Out: no job is lost, none is carried out twice, none is begun by a second cell unless a person
//! gave it away; a failure names its seed. `CELLD_FLEET_SEEDS=N` runs more of them.

#![allow(clippy::unwrap_used, reason = "helpers of tests: an unwrap that fails is the test that fails")]

#[path = "schedules/model.rs"]
mod model;

use cell_fleet::payloads::ClaimState;
use model::{Plan, World, is_impossible};
use std::collections::BTreeMap;

const CALM: Plan =
    Plan { cells: 4, jobs: 30, crashes: 0, server_crashes: 0, cuts: 0, disarms: 0, cancels: 0, dead: 0 };

fn seeds(usual: u64) -> std::ops::Range<u64> {
    0..std::env::var("CELLD_FLEET_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
}

fn run(seed: u64, plan: Plan) -> World {
    let mut world = World::new(seed, plan);
    world.run();
    check(seed, &world);
    world
}

/// What must hold of every run.
fn check(seed: u64, world: &World) {
    let of = |job: &str| {
        let lines: Vec<&String> =
            world.trace.iter().filter(|line| line.contains(&format!("\"{job}\""))).collect();
        lines.iter().map(|line| line.chars().take(400).collect::<String>()).collect::<Vec<_>>().join("\n")
    };
    let open = world.open();
    let first = open.first().map(|job| of(job)).unwrap_or_default();
    assert!(
        open.is_empty(),
        "seed {seed}: lost or stuck {open:?}; claim {:?}\n{first}",
        world.claims.get(open.first().map_or("", |j| j))
    );
    let mut times: BTreeMap<&str, Vec<(usize, u32)>> = BTreeMap::new();
    for (cell, job, epoch) in &world.carried_out {
        times.entry(job).or_default().push((*cell, *epoch));
    }
    for (job, times) in &times {
        let given = world.given.contains(*job);
        assert!(times.len() == 1 || given, "seed {seed}: {job} was carried out {times:?}\n{}", of(job));
        let mut cells: Vec<usize> = times.iter().map(|(cell, _)| *cell).collect();
        cells.sort_unstable();
        cells.dedup();
        assert_eq!(cells.len(), times.len(), "seed {seed}: {job} twice in one cell\n{}", of(job));
    }
    // A cell that can do it is there: no one sets it aside.
    let all_live = world.cells.iter().all(|cell| !cell.dead);
    let aside =
        |job: &str| matches!(world.claims.get(job), Some((claim, ..)) if claim.state == ClaimState::Aside);
    for job in world.claims.keys().filter(|job| aside(job) && !is_impossible(job)) {
        assert!(!all_live || world.given.contains(job), "seed {seed}: {job} was set aside\n{}", of(job));
    }
    let mut begun: BTreeMap<&str, Vec<(u32, &str)>> = BTreeMap::new();
    for (job, epoch, cell) in &world.begun {
        begun.entry(job).or_default().push((*epoch, cell));
    }
    for (job, begun) in &begun {
        let given = world.given.contains(*job);
        assert!(begun.len() == 1 || given, "seed {seed}: {job} was begun {begun:?}\n{}", of(job));
    }
    for (cell, job, epoch) in &world.carried_out {
        let name = format!("c{cell}");
        let began = world.begun.iter().any(|(j, e, c)| j == job && e == epoch && *c == name);
        assert!(began, "seed {seed}: {job} was carried out by {name} without being begun\n{}", of(job));
    }
}

#[test]
fn a_calm_fleet_does_each_job_once_and_sets_aside_what_no_cell_can_do() {
    let world = run(1, CALM);
    for (job, (claim, ..)) in &world.claims {
        let wanted = if is_impossible(job) { ClaimState::Aside } else { ClaimState::Ended };
        assert_eq!(claim.state, wanted, "{job}: {claim:?}");
        if is_impossible(job) {
            assert!(claim.reasons.values().all(|reason| reason.contains("no cell")), "{claim:?}");
        } else {
            assert_eq!(claim.outcome.as_ref().map(|o| o.status.as_str()), Some("done"));
        }
    }
    assert_eq!(world.claims.len(), 30);
    // Each state goes to two at most beside the cell itself.
    assert_eq!(world.follow_all(), ["c0"]);
    assert_eq!(world.follow_one(), [("c1", "c0"), ("c2", "c0"), ("c3", "c0")]);
}

#[test]
fn crashes_of_cells_and_server_lose_nothing_and_do_nothing_twice() {
    for seed in seeds(60) {
        let plan = Plan { cells: 5, jobs: 40, crashes: 30, server_crashes: 4, cuts: 10, disarms: 10, ..CALM };
        run(seed, plan);
    }
}

#[test]
fn cancellations_close_a_job_or_end_it() {
    for seed in seeds(40) {
        let plan = Plan { crashes: 8, cuts: 8, cancels: 15, server_crashes: 2, ..CALM };
        run(1_000_000 + seed, plan);
    }
}

#[test]
fn what_a_dead_cell_had_not_begun_goes_on_by_itself_and_what_it_had_begun_by_a_person() {
    let mut given = 0;
    for seed in seeds(40) {
        let plan = Plan { cells: 6, crashes: 12, cuts: 6, dead: 3, server_crashes: 1, ..CALM };
        given += run(2_000_000 + seed, plan).given.len();
    }
    assert!(given > 0, "no job was ever stranded: the schedules are too tame");
}
