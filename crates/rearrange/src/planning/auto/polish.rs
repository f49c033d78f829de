//! Small changes to a plan that keep its moves: another order, another place to wait, another worker of a
//! group.
//!
//! In: a plan. Out: another one with as many moves that can be carried out, at random. Under the objective
//! `time` the order and the places decide how far the arm travels, and no bound guides the search: changes
//! are tried one by one and kept if the caller's cost function likes them.

use crate::geometry::pose::Pose2;
use crate::planning::auto::parking;
use crate::planning::buffers::Arrangement;
use crate::planning::effort::Watch;
use crate::planning::scene::{Scene, Spot};
use crate::planning::trlb::Move;
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// A plan's moves as far as they have to be decided: who goes where.
type Step = (usize, Arc<Spot>);

/// A neighbour of the plan; None if the change tried is impossible, or where `watch` ends the work.
pub fn neighbour(
    scene: &Scene,
    start: &Arrangement,
    plan: &[Move],
    rng: &mut ChaCha8Rng,
    watch: &mut Watch,
) -> Option<Vec<Move>> {
    let mut steps: Vec<Step> = plan.iter().map(|m| (m.object, m.to.clone())).collect();
    match rng.random_range(0..10u8) {
        0..=4 => shift(&mut steps, rng),
        5 => reverse(&mut steps, rng),
        6 => exchange_ends(scene, &mut steps, rng)?,
        _ => wait_elsewhere(scene, &mut steps, rng)?,
    }
    carried_out(scene, start, &steps, watch)
}

/// Some moves in a row are made earlier or later.
fn shift(steps: &mut [Step], rng: &mut ChaCha8Rng) {
    let n = steps.len();
    let span = rng.random_range(1..=3.min(n));
    let (from, to) = (rng.random_range(0..=n - span), rng.random_range(0..=n - span));
    if from < to {
        steps[from..to + span].rotate_left(span);
    } else {
        steps[to..from + span].rotate_right(span);
    }
}

fn reverse(steps: &mut [Step], rng: &mut ChaCha8Rng) {
    let n = steps.len();
    let (a, b) = (rng.random_range(0..n), rng.random_range(0..n));
    steps[a.min(b)..=a.max(b)].reverse();
}

/// Two members of a group end where the other one did.
fn exchange_ends(scene: &Scene, steps: &mut [Step], rng: &mut ChaCha8Rng) -> Option<()> {
    let objects = &scene.problem.objects;
    let (a, b) = (steps.choose(rng)?.0, steps.choose(rng)?.0);
    let together = a != b && objects[a].group.is_some() && objects[a].group == objects[b].group;
    let last = |o: usize| steps.iter().rposition(|(object, _)| *object == o).filter(|_| together);
    let (last_a, last_b) = (last(a)?, last(b)?);
    let (end_a, end_b) = (steps[last_a].1.pose, steps[last_b].1.pose);
    steps[last_a].1 = scene.spot(a, end_b);
    steps[last_b].1 = scene.spot(b, end_a);
    Some(())
}

/// An object waits, or ends if it has no goal, at another place: any, or near the one it has.
fn wait_elsewhere(scene: &Scene, steps: &mut [Step], rng: &mut ChaCha8Rng) -> Option<()> {
    let moves_on = |at: usize| steps[at + 1..].iter().any(|(object, _)| *object == steps[at].0);
    let is_free = |at: usize| {
        let object = &scene.problem.objects[steps[at].0];
        moves_on(at) || (object.goal.is_none() && object.group.is_none())
    };
    let waits: Vec<usize> = (0..steps.len()).filter(|&at| is_free(at)).collect();
    let at = *waits.choose(rng)?;
    let (object, old) = (steps[at].0, steps[at].1.pose);
    let near = |pose: Pose2, reach: f64, rng: &mut ChaCha8Rng| {
        let mut off = || rng.random_range(-reach..reach);
        scene.spot(object, Pose2::new(pose.x + off(), pose.y + off(), pose.theta))
    };
    let spot = match rng.random_range(0..4u8) {
        0 => parking::propose(scene, object, rng)?,
        1 => {
            // On the way from where it comes to where it goes.
            let before = steps[..at].iter().rfind(|(o, _)| *o == object);
            let from = before.map_or(scene.start(object).pose, |(_, spot)| spot.pose);
            let to = steps[at + 1..].iter().find(|(o, _)| *o == object).map_or(from, |(_, spot)| spot.pose);
            let share = rng.random_range(0.0..1.0);
            let x = from.x + share * (to.x - from.x);
            let y = from.y + share * (to.y - from.y);
            near(Pose2::new(x, y, old.theta), 0.1, rng)
        }
        2 => near(old, 0.1, rng),
        _ => near(old, 0.02, rng),
    };
    (scene.on_table(object, &spot.pose) && scene.admissible(&spot)).then(|| steps[at].1 = spot)
}

/// The moves, if each finds its place free; None where `watch` ends the work.
pub fn carried_out(
    scene: &Scene,
    start: &Arrangement,
    steps: &[Step],
    watch: &mut Watch,
) -> Option<Vec<Move>> {
    let mut now = start.clone();
    let mut moves = Vec::with_capacity(steps.len());
    for (object, to) in steps {
        if !watch.go_on(scene.row_ticks()) {
            return None;
        }
        let others = scene.movable.iter().filter(|o| *o != object);
        if now[*object].pose == to.pose || !others.into_iter().all(|&o| scene.clear(to, &now[o])) {
            return None;
        }
        let from = std::mem::replace(&mut now[*object], to.clone());
        moves.push(Move { object: *object, from, to: to.clone() });
    }
    Some(moves)
}
