//! Completes a goal: which member of a group takes which goal, and where objects without a goal end.
//!
//! In: a scene, random numbers. Out: one spot for every object, an arrangement that is valid as a whole.
//! Members of a group are matched to the group's goals before the search: a member at a goal keeps it, the
//! rest go to near ones. Any matching gives a valid plan; the lower bound holds for all of them. An object
//! without a goal stays where it is if no other object needs its place, else it gets a random free pose, one
//! that blocks as few unmoved objects as possible. Another call gives other free poses.

use crate::geometry::pose::Pose2;
use crate::planning::buffers::Arrangement;
use crate::planning::effort::Effort;
use crate::planning::scene::{Scene, Spot};
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Poses tried for one object without a goal.
const SAMPLES: usize = 400;

/// The goal pose each object is to take; None where the problem leaves it open.
pub fn assigned_goals(scene: &Scene) -> Vec<Option<Pose2>> {
    let objects = &scene.problem.objects;
    let mut goals: Vec<Option<Pose2>> = objects.iter().map(|object| object.goal).collect();
    let mut groups: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for &i in &scene.movable {
        if let Some(name) = &objects[i].group {
            groups.entry(name).or_default().push(i);
        }
    }
    for members in groups.values() {
        let starts: Vec<Pose2> = members.iter().map(|&i| objects[i].start).collect();
        let open: Vec<Pose2> = members.iter().filter_map(|&i| objects[i].goal).collect();
        for (&member, taken) in members.iter().zip(match_to_goals(&starts, &open)) {
            goals[member] = taken.map(|g| open[g]);
        }
    }
    goals
}

/// For each start the index of the goal it takes, at most one each: identical poses first, then greedily the
/// nearest pairs, then exchanges of two as long as they shorten the way.
pub fn match_to_goals(starts: &[Pose2], goals: &[Pose2]) -> Vec<Option<usize>> {
    let cost = |s: usize, g: usize| {
        // Staying counts far more than any distance on the table.
        if starts[s].same(&goals[g]) { -1e6 } else { starts[s].distance(&goals[g]) }
    };
    let mut pairs: Vec<(usize, usize)> =
        (0..starts.len()).flat_map(|s| (0..goals.len()).map(move |g| (s, g))).collect();
    pairs.sort_by(|a, b| cost(a.0, a.1).total_cmp(&cost(b.0, b.1)));
    let mut taken: Vec<Option<usize>> = vec![None; starts.len()];
    for (s, g) in pairs {
        if taken[s].is_none() && !taken.contains(&Some(g)) {
            taken[s] = Some(g);
        }
    }
    let total = |s: usize, g: Option<usize>| g.map_or(0.0, |g| cost(s, g));
    let mut improved = true;
    while improved {
        improved = false;
        for a in 0..starts.len() {
            for b in a + 1..starts.len() {
                let now = total(a, taken[a]) + total(b, taken[b]);
                if total(a, taken[b]) + total(b, taken[a]) < now - 1e-9 {
                    taken.swap(a, b);
                    improved = true;
                }
            }
        }
    }
    taken
}

/// A complete goal arrangement; None if no free pose was found for some object this time.
pub fn complete(
    scene: &Scene,
    goals: &[Option<Pose2>],
    rng: &mut ChaCha8Rng,
    effort: &mut Effort,
) -> Option<Arrangement> {
    let mut ends: Vec<Option<Arc<Spot>>> = goals
        .iter()
        .enumerate()
        .map(|(i, goal)| match goal {
            Some(pose) if pose.same(&scene.start(i).pose) => Some(scene.start(i).clone()),
            Some(pose) => Some(scene.spot(i, *pose)),
            None => None,
        })
        .collect();
    let mut homeless = Vec::new();
    for i in 0..ends.len() {
        if ends[i].is_none() {
            let start = scene.start(i);
            if ends.iter().flatten().all(|end| scene.clear(end, start)) {
                ends[i] = Some(start.clone());
            } else {
                homeless.push(i);
            }
        }
    }
    homeless.shuffle(rng);
    for i in homeless {
        ends[i] = Some(free_end(scene, i, &ends, rng, effort)?);
    }
    ends.into_iter().collect()
}

/// A pose clear of all ends chosen so far, and of as many starts as possible.
fn free_end(
    scene: &Scene,
    object: usize,
    ends: &[Option<Arc<Spot>>],
    rng: &mut ChaCha8Rng,
    effort: &mut Effort,
) -> Option<Arc<Spot>> {
    let mut best: Option<(usize, Arc<Spot>)> = None;
    for _ in 0..SAMPLES {
        if !effort.step() {
            return None;
        }
        let Some(spot) = scene.sample(object, rng) else { continue };
        if !scene.admissible(&spot) || !ends.iter().flatten().all(|end| scene.clear(end, &spot)) {
            continue;
        }
        let in_the_way =
            scene.movable.iter().filter(|&&o| o != object && !scene.clear(scene.start(o), &spot)).count();
        if best.as_ref().is_none_or(|(least, _)| in_the_way < *least) {
            best = Some((in_the_way, spot));
        }
        if in_the_way == 0 {
            break;
        }
    }
    best.map(|(_, spot)| spot)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_stands_at_a_goal_keeps_it() {
        let at = |x: f64| Pose2::new(x, 0.0, 0.0);
        let taken = match_to_goals(&[at(0.0), at(1.0), at(2.0)], &[at(1.0), at(2.1)]);
        assert_eq!(taken, [None, Some(0), Some(1)]);
    }

    #[test]
    fn exchanges_shorten_the_way() {
        let at = |x: f64| Pose2::new(x, 0.0, 0.0);
        // The nearest pair (1.0, 1.1) first would send 0.0 to -3.0 or 3.0 whichever is left.
        let taken = match_to_goals(&[at(0.0), at(1.0), at(4.0)], &[at(3.5), at(1.2), at(0.9)]);
        assert_eq!(taken, [Some(2), Some(1), Some(0)]);
    }
}
