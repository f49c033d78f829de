//! Jobs for the closed loop: two to four moves each, by seed.
//!
//! In: where the objects are, the workspace, a seed. Out: a job that brings two or three objects to places
//! that are free once those objects have left theirs, so that some of them have to wait in a buffer.

use cell_machine::orders::Approval;
use cell_machine::supervisor::model::CellModel;
use cell_machine::supervisor::order::JobOrder;
use cell_values::time::Duration;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::geometry::collision::{closer_than, inside};
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::Objective;
use rearrange::planning::solver::SolverKind;

/// Tries for one place.
const TRIES: usize = 400;

/// Room kept between goals, m: a placed object is off by up to a millimetre.
const ROOM_M: f64 = 0.006;

/// Distance of an object's origin from the edge of the table, m.
const EDGE_M: f64 = 0.05;

/// Job number `number` of a run, for objects that are at `at`.
pub fn job(model: &CellModel, at: &[(String, Pose2)], seed: u64, number: usize) -> JobOrder {
    let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9).wrapping_add(number as u64));
    let mut names: Vec<&(String, Pose2)> = at.iter().collect();
    names.sort_by(|a, b| a.0.cmp(&b.0));
    names.shuffle(&mut rng);
    let count = rng.random_range(2..=3).min(names.len());
    let (moved, rest) = names.split_at(count);
    let mut taken: Vec<(String, Pose2)> = rest.iter().map(|known| (*known).clone()).collect();
    let mut goals = Vec::new();
    for (id, _) in moved {
        let swaps = rng.random_bool(0.4);
        let pose = place(model, id, &taken, moved, swaps, &mut rng);
        if let Some(pose) = pose {
            taken.push((id.clone(), pose));
            goals.push((id.clone(), pose));
        }
    }
    JobOrder {
        id: format!("job-{number}"),
        goals,
        objective: Objective::Pp,
        solver: SolverKind::Auto,
        time_limit: Duration::from_secs(2),
        seed,
        approval: Approval::Never,
        rule: None,
        agreed: Vec::new(),
    }
}

/// The same with an approval by seed; a person has to approve plans meanwhile
/// (`Pair::approve_plans`).
pub fn approved_job(model: &CellModel, at: &[(String, Pose2)], seed: u64, number: usize) -> JobOrder {
    let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x6170_7072).wrapping_add(number as u64));
    let approval = Approval::ALL[rng.random_range(0..Approval::ALL.len())];
    JobOrder { approval, ..job(model, at, seed, number) }
}

/// A place that touches nothing of `taken`; with `swaps` where another object of the job is now.
fn place(
    model: &CellModel,
    id: &str,
    taken: &[(String, Pose2)],
    moved: &[&(String, Pose2)],
    swaps: bool,
    rng: &mut ChaCha8Rng,
) -> Option<Pose2> {
    let object = model.object(id)?;
    let (width, height) = (model.workspace.width, model.workspace.height);
    let free = |pose: &Pose2| {
        taken.iter().all(|(other, at)| {
            model
                .object(other)
                .is_none_or(|known| !closer_than(&object.footprint, pose, &known.footprint, at, ROOM_M))
        })
    };
    let others: Vec<Pose2> = moved.iter().filter(|known| known.0 != id).map(|known| known.1).collect();
    for attempt in 0..TRIES {
        let pose = match others.get(attempt) {
            Some(other) if swaps => Pose2::new(other.x, other.y, rng.random_range(-3.1..3.1)),
            _ => Pose2::new(
                rng.random_range(EDGE_M..width - EDGE_M),
                rng.random_range(EDGE_M..height - EDGE_M),
                rng.random_range(-3.1..3.1),
            ),
        };
        if inside(&object.footprint, &pose, width, height) && free(&pose) {
            return Some(pose);
        }
    }
    None
}
