//! Who of a group takes which of its goals: the assignment is part of the plan.
//!
//! In: an arrangement to reach. Out: another one in which two members of a group have exchanged their ends,
//! or a good one to begin with. What an assignment promises is the bound on what must follow: a move for
//! each object away from its end, and the feedback vertex set of their graph.

use crate::geometry::pose::Pose2;
use crate::planning::auto::aside::feedback_set;
use crate::planning::auto::table::Table;
use crate::planning::buffers::Arrangement;
use crate::planning::effort::Watch;
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::{Scene, Spot};
use rand::RngExt;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Exchanges tried before a roll-out over the whole way.
const EXCHANGES: usize = 12;

/// The groups of a scene.
pub struct Groups {
    /// Movable members of each group that has more than one.
    members: Vec<Vec<usize>>,
    /// The goals that each object may take.
    goals: Vec<Arc<[Pose2]>>,
}

impl Groups {
    /// The groups among the movable objects.
    pub fn new(scene: &Scene) -> Groups {
        let objects = &scene.problem.objects;
        let mut by_name: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for &o in &scene.movable {
            if let Some(name) = &objects[o].group {
                by_name.entry(name).or_default().push(o);
            }
        }
        let mut goals: Vec<Arc<[Pose2]>> = objects.iter().map(|o| o.goal.into_iter().collect()).collect();
        for members in by_name.values() {
            let shared: Arc<[Pose2]> = members.iter().filter_map(|&o| objects[o].goal).collect();
            members.iter().for_each(|&o| goals[o] = shared.clone());
        }
        Groups { members: by_name.into_values().filter(|members| members.len() > 1).collect(), goals }
    }

    /// There is nothing to exchange.
    pub fn is_empty(&self) -> bool {
        self.members.is_empty()
    }

    /// Movable objects that are on no goal of theirs in this arrangement: they may end elsewhere as well.
    pub fn flexible(&self, scene: &Scene, ends: &Arrangement) -> ObjectSet {
        scene.movable.iter().copied().filter(|&o| !self.at_goal(o, &ends[o])).collect()
    }

    fn at_goal(&self, object: usize, spot: &Spot) -> bool {
        self.goals[object].iter().any(|goal| goal.same(&spot.pose))
    }

    /// The arrangement with the ends of two members of a group exchanged; None where that is not valid.
    pub fn exchanged(&self, scene: &Scene, ends: &Arrangement, rng: &mut ChaCha8Rng) -> Option<Arrangement> {
        let members = self.members.choose(rng)?;
        let (a, b) = (rng.random_range(0..members.len()), rng.random_range(0..members.len() - 1));
        let (a, b) = (members[a], members[if b < a { b } else { b + 1 }]);
        let mut new = ends.clone();
        new[a] = self.taking_over(scene, a, &ends[b]);
        new[b] = self.taking_over(scene, b, &ends[a]);
        let stands = |o: usize| {
            let others = (0..new.len()).filter(|&k| k != o && !scene.problem.objects[k].fixed);
            scene.admissible(&new[o]) && others.into_iter().all(|k| scene.clear(&new[o], &new[k]))
        };
        (stands(a) && stands(b)).then_some(new)
    }

    /// The object at the end of another one: an object left without a goal rather stays where it is.
    fn taking_over(&self, scene: &Scene, object: usize, end: &Arc<Spot>) -> Arc<Spot> {
        let start = scene.start(object);
        if !self.at_goal(object, end) || end.pose.same(&start.pose) {
            return start.clone();
        }
        scene.spot(object, end.pose)
    }

    /// The arrangement after some exchanges that promise no more cost.
    pub fn improved(
        &self,
        scene: &Scene,
        costs: &[f64],
        from: &Arrangement,
        ends: Arrangement,
        rng: &mut ChaCha8Rng,
        watch: &mut Watch,
    ) -> Arrangement {
        if self.is_empty() {
            return ends;
        }
        // What there is no time to price is no improvement.
        let mut price =
            |ends: &Arrangement| promise(scene, costs, from, ends, watch).unwrap_or(f64::INFINITY);
        let (mut best, mut least) = (ends.clone(), price(&ends));
        for _ in 0..EXCHANGES {
            let Some(new) = self.exchanged(scene, &best, rng) else { continue };
            let cost = price(&new);
            if cost <= least {
                (best, least) = (new, cost);
            }
        }
        best
    }
}

/// Cost of the cheapest plan between the two arrangements if there is room to put every object of the
/// feedback vertex set aside. No plan costs less if that set is the cheapest one.
fn promise(
    scene: &Scene,
    costs: &[f64],
    from: &Arrangement,
    ends: &Arrangement,
    watch: &mut Watch,
) -> Option<f64> {
    let table = Table::new(scene, from, ends, ObjectSet::EMPTY, watch)?;
    let set = feedback_set(&table.graph(), costs, watch);
    Some(table.remaining.weight(costs) + set.weight(costs))
}
