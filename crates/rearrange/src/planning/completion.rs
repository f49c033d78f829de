//! Completes a goal: which member of a group takes which goal, and where objects without a goal end.
//!
//! In: a scene, random numbers. Out: one spot for every object, an arrangement that is valid as a whole.
//! Members of a group are matched to the group's goals before the search: a member at a goal keeps it, the
//! rest go to near ones. Any matching gives a valid plan; the lower bound holds for all of them. An object
//! without a goal stays where it is if no other object needs its place, else it gets a random free pose, one
//! that blocks as few unmoved objects as possible. Another call gives other free poses.

use crate::geometry::pose::Pose2;
use crate::planning::buffers::Arrangement;
use crate::planning::effort::{Effort, Watch};
use crate::planning::scene::{Scene, Spot};
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Poses tried for one object without a goal.
const SAMPLES: usize = 400;

/// Pairs of a start and a goal that are sorted by distance; of more, each start takes the nearest goal left.
const MOST_PAIRS: usize = 100_000;

/// The goal pose each object is to take; None where the problem leaves it open, or where `watch` ends the
/// work.
pub fn assigned_goals(scene: &Scene, watch: &mut Watch) -> Vec<Option<Pose2>> {
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
        for (&member, taken) in members.iter().zip(match_to_goals(&starts, &open, watch)) {
            goals[member] = taken.map(|g| open[g]);
        }
    }
    goals
}

/// For each start the index of the goal it takes, at most one each: identical poses first, then greedily
/// the nearest pairs, then exchanges of two as long as they shorten the way. Where `watch` ends the work,
/// what was matched until then.
pub fn match_to_goals(starts: &[Pose2], goals: &[Pose2], watch: &mut Watch) -> Vec<Option<usize>> {
    let mut taken = nearest_goals(starts, goals, watch);
    let total = |s: usize, g: Option<usize>| g.map_or(0.0, |g| cost(&starts[s], &goals[g]));
    let mut improved = true;
    while improved {
        improved = false;
        for a in 0..starts.len() {
            if !watch.go_on(4 * starts.len() as u64) {
                return taken;
            }
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

/// Staying counts far more than any distance on the table.
fn cost(start: &Pose2, goal: &Pose2) -> f64 {
    if start.same(goal) { -1e6 } else { start.distance(goal) }
}

/// The nearest pairs first.
fn nearest_goals(starts: &[Pose2], goals: &[Pose2], watch: &mut Watch) -> Vec<Option<usize>> {
    let mut taken: Vec<Option<usize>> = vec![None; starts.len()];
    let mut is_left = vec![true; goals.len()];
    if starts.len() * goals.len() > MOST_PAIRS {
        for (s, start) in starts.iter().enumerate() {
            if !watch.go_on(goals.len() as u64) {
                break;
            }
            let left = (0..goals.len()).filter(|&g| is_left[g]);
            taken[s] = left.min_by(|&a, &b| cost(start, &goals[a]).total_cmp(&cost(start, &goals[b])));
            taken[s].into_iter().for_each(|g| is_left[g] = false);
        }
        return taken;
    }
    let pair = |s: usize, g: usize| (cost(&starts[s], &goals[g]), s, g);
    let mut pairs: Vec<(f64, usize, usize)> =
        (0..starts.len()).flat_map(|s| (0..goals.len()).map(move |g| pair(s, g))).collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (_, s, g) in pairs {
        if taken[s].is_none() && is_left[g] {
            (taken[s], is_left[g]) = (Some(g), false);
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
            if !effort.watch().go_on(scene.row_ticks()) {
                return None;
            }
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

    fn matched(starts: &[Pose2], goals: &[Pose2]) -> Vec<Option<usize>> {
        match_to_goals(starts, goals, &mut Watch::new(&|| false))
    }

    #[test]
    fn of_many_each_takes_a_goal_of_its_own_and_those_who_stand_at_one_keep_it() {
        let count = MOST_PAIRS.isqrt() + 10;
        let at = |k: usize| Pose2::new(k as f64, 0.0, 0.0);
        let starts: Vec<Pose2> = (0..count).map(at).collect();
        let goals: Vec<Pose2> = (count / 2..count / 2 + count).rev().map(at).collect();
        let taken = matched(&starts, &goals);
        let mut goals_taken: Vec<usize> = taken.iter().flatten().copied().collect();
        goals_taken.sort_unstable();
        assert_eq!(goals_taken, (0..count).collect::<Vec<_>>());
        assert!((count / 2..count).all(|s| taken[s].is_some_and(|g| goals[g].same(&starts[s]))));
    }

    #[test]
    fn who_stands_at_a_goal_keeps_it() {
        let at = |x: f64| Pose2::new(x, 0.0, 0.0);
        let taken = matched(&[at(0.0), at(1.0), at(2.0)], &[at(1.0), at(2.1)]);
        assert_eq!(taken, [None, Some(0), Some(1)]);
    }

    #[test]
    fn exchanges_shorten_the_way() {
        let at = |x: f64| Pose2::new(x, 0.0, 0.0);
        // The nearest pair (1.0, 1.1) first would send 0.0 to -3.0 or 3.0 whichever is left.
        let taken = matched(&[at(0.0), at(1.0), at(4.0)], &[at(3.5), at(1.2), at(0.9)]);
        assert_eq!(taken, [Some(2), Some(1), Some(0)]);
    }
}
