//! Lower bound on the cost of every plan: required moves, and what the dependency cycles cost on top.
//!
//! In: a scene and the cost of one move of each object. Out: a number no valid plan is cheaper than, with
//! its parts. An object must move if its start is not its goal, or if it has no goal and blocks one. In a
//! cycle of the dependency graph not all objects can go home in one move each, for each would have to wait
//! for the next; so the objects that move twice form a feedback vertex set, and the cheapest one is added.
//! Members of a group count only by what holds for every assignment: they take no part in the cycles, and
//! the group needs as many moves as it has goals at which there is no member (or members that are in the
//! way of a goal, if that is more). The feedback vertex set is exact, unless its search is cut short; then
//! the lower bound of that search is added. When the caller stops early, the parts not yet computed count
//! as zero, so the bound holds at any time. `buffer_space` proves more where there is no room to put
//! objects aside.

use crate::geometry::pose::Pose2;
use crate::planning::effort::Watch;
use crate::planning::feedback;
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::Scene;
use std::collections::BTreeMap;

pub mod buffer_space;

/// The bound and what it is made of.
#[derive(Clone, Debug, PartialEq)]
pub struct LowerBound {
    /// No plan costs less.
    pub value: f64,
    /// Objects (or nameless members of groups) that move at least once.
    pub required_moves: usize,
    /// Cost of these moves.
    pub required_cost: f64,
    /// Cost of the cheapest second moves that break all cycles.
    pub cycle_cost: f64,
}

/// Arc i -> j exactly when i at its own goal and j at its start may not be there at once. Vertices are the
/// problem's objects; those that are fixed have no arcs, those without a goal no outgoing ones, and neither
/// have those that start at their goal: they may stay, and a pair of starts is never refused. Objects that
/// `watch` leaves no time for have no outgoing arcs.
pub fn start_goal_graph(scene: &Scene, watch: &mut Watch) -> DependencyGraph {
    let objects = &scene.problem.objects;
    let blockers = |i: usize| -> ObjectSet {
        let goal = scene.goal(i).filter(|_| !objects[i].fixed && !stays(scene, i));
        let Some(goal) = goal.filter(|_| watch.go_on(scene.row_ticks())) else { return ObjectSet::EMPTY };
        let others = scene.movable.iter().copied().filter(|&j| j != i);
        others.filter(|&j| !scene.clear(goal, scene.start(j))).collect()
    };
    DependencyGraph::from_blockers((0..objects.len()).map(blockers).collect())
}

/// True when the object starts at its goal, angles modulo a full turn.
fn stays(scene: &Scene, i: usize) -> bool {
    scene.goal(i).is_some_and(|goal| goal.pose.same(&scene.start(i).pose))
}

/// What the bound is put together from.
#[derive(Clone, Debug)]
pub struct Parts {
    /// Objects that move and are no member of a group.
    pub single: ObjectSet,
    /// Those of them that must move.
    pub required: ObjectSet,
    /// Objects (or nameless members of groups) that move at least once.
    pub required_moves: usize,
    /// Cost of these moves.
    pub required_cost: f64,
    /// Who of the single objects waits for whom.
    pub graph: DependencyGraph,
    /// Cost of the cheapest second moves that break all cycles, as far as it is proved.
    pub cycle_cost: f64,
    /// Nothing cheaper breaks all cycles than what `cycle_cost` pays for.
    pub is_exact: bool,
}

impl Parts {
    /// For the given cost of one move of each object of the problem.
    pub fn new(scene: &Scene, move_costs: &[f64], watch: &mut Watch) -> Parts {
        let graph = start_goal_graph(scene, watch);
        let groups = groups(scene);
        let grouped: ObjectSet = groups.values().flatten().copied().collect();
        let single: ObjectSet = scene.movable.iter().copied().filter(|&i| !grouped.contains(i)).collect();
        let blocking = blocking(scene, &graph, &groups, &single, watch);
        let required: ObjectSet = single.iter().filter(|&i| must_move(scene, i, &blocking)).collect();
        let mut required_moves = required.len();
        let mut required_cost = required.weight(move_costs);
        for members in groups.values() {
            let (moves, cost) = group_moves(scene, members, &blocking, move_costs, watch);
            required_moves += moves;
            required_cost += cost;
        }
        let graph = graph.restricted(&single);
        let cycles = feedback::minimum(&graph, move_costs, watch);
        let (cycle_cost, is_exact) = (cycles.lower_bound, cycles.is_minimum());
        Parts { single, required, required_moves, required_cost, graph, cycle_cost, is_exact }
    }

    /// The bound that they make.
    pub fn bound(&self) -> LowerBound {
        let Parts { required_moves, required_cost, cycle_cost, .. } = *self;
        LowerBound { value: required_cost + cycle_cost, required_moves, required_cost, cycle_cost }
    }
}

/// The bound for the given cost of one move of each object of the problem.
pub fn lower_bound(scene: &Scene, move_costs: &[f64], watch: &mut Watch) -> LowerBound {
    Parts::new(scene, move_costs, watch).bound()
}

/// Movable objects by group, groups of at least two only: a lone member is like any other object.
fn groups<'a>(scene: &Scene<'a>) -> BTreeMap<&'a str, Vec<usize>> {
    let mut groups: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for &i in &scene.movable {
        if let Some(name) = &scene.problem.objects[i].group {
            groups.entry(name).or_default().push(i);
        }
    }
    groups.retain(|_, members| members.len() > 1);
    groups
}

/// Objects whose start blocks a goal that will be filled whatever the assignment of groups.
fn blocking(
    scene: &Scene,
    graph: &DependencyGraph,
    groups: &BTreeMap<&str, Vec<usize>>,
    single: &ObjectSet,
    watch: &mut Watch,
) -> ObjectSet {
    let mut blocking = ObjectSet::EMPTY;
    for i in single {
        blocking.extend(graph.blockers(i));
    }
    for members in groups.values() {
        for &i in members {
            // A member that starts at this goal might stay, and what is beside it since the start as well.
            // Where there is no time to look, one may.
            if !watch.go_on(members.len() as u64) {
                return blocking;
            }
            let taken = scene.goal(i).is_some_and(|goal| stands_at(scene, members, &goal.pose));
            if !taken {
                blocking.extend(graph.blockers(i));
            }
        }
    }
    blocking
}

fn must_move(scene: &Scene, i: usize, blocking: &ObjectSet) -> bool {
    match scene.goal(i) {
        Some(_) => !stays(scene, i),
        None => blocking.contains(i),
    }
}

fn stands_at(scene: &Scene, members: &[usize], pose: &Pose2) -> bool {
    members.iter().any(|&member| scene.start(member).pose.same(pose))
}

/// Moves that the group needs under every assignment, and their least cost.
fn group_moves(
    scene: &Scene,
    members: &[usize],
    blocking: &ObjectSet,
    costs: &[f64],
    watch: &mut Watch,
) -> (usize, f64) {
    let goals: Vec<Pose2> = members.iter().filter_map(|&i| scene.goal(i)).map(|goal| goal.pose).collect();
    // What there is no time to look at counts as no move.
    let mut timely = || watch.go_on(members.len() as u64);
    let empty_goals = goals.iter().filter(|goal| timely() && !stands_at(scene, members, goal)).count();
    let stays = |i: usize| goals.iter().any(|goal| goal.same(&scene.start(i).pose));
    let in_the_way = members.iter().filter(|&&i| blocking.contains(i) && timely() && !stays(i)).count();
    let moves = empty_goals.max(in_the_way);
    let mut cheapest: Vec<f64> = members.iter().map(|&i| costs[i]).collect();
    cheapest.sort_by(f64::total_cmp);
    (moves, cheapest.iter().take(moves).sum())
}

#[cfg(test)]
mod tests;
