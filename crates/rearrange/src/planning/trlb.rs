//! TRLB: primitive plans, lazy buffers, and a search from both ends when a plan cannot be carried out.
//!
//! In: a start and a complete goal arrangement, and a way to make primitive plans between two arrangements.
//! Out: moves from the one to the other. A primitive plan whose buffers cannot be placed leaves a partial
//! plan; the arrangements these reach grow two trees, rooted at start and goal, until a plan joins them.
//! Moves of the goal-rooted tree are turned round: a move that is possible one way is possible the other
//! way. Source: the paper, section TRLB. The first plan ends the search. Deviations: after `TREE_LIMIT`
//! nodes the trees start afresh, so that a long search does not fill the memory; from `DETOURS_AFTER` nodes
//! on an object that finds no buffer has one cleared for it (`detour`), unless `detours` is off.

use crate::planning::buffers::{Arrangement, allocate};
use crate::planning::detour;
use crate::planning::effort::{Effort, Watch};
use crate::planning::graph::DependencyGraph;
use crate::planning::object_set::ObjectSet;
use crate::planning::primitive::Step;
use crate::planning::scene::{Scene, Spot};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Nodes of one tree after which both are dropped.
const TREE_LIMIT: usize = 3000;

/// Positions of objects in one tree after which both are dropped: a node has one of each object, of 8 bytes
/// and a spot that it may share.
const POSITION_LIMIT: usize = 10_000_000;

/// Nodes of a tree from which on objects that are stuck get a place cleared: most problems need none, and
/// detours cost moves.
const DETOURS_AFTER: usize = 16;

/// One pick-n-place between two spots.
#[derive(Clone, Debug)]
pub struct Move {
    /// Index of the object in the problem.
    pub object: usize,
    /// Where it is picked.
    pub from: Arc<Spot>,
    /// Where it is placed.
    pub to: Arc<Spot>,
}

/// Makes a primitive plan: graph over some objects, and which objects of the problem its vertices are.
/// The steps name vertices. None when the effort is spent.
pub type Planner<'a> =
    dyn Fn(&DependencyGraph, &[usize], &mut ChaCha8Rng, &mut Effort) -> Option<Vec<Step>> + 'a;

/// Two arrangements to join, and the means.
pub struct Trlb<'a> {
    /// The table.
    pub scene: &'a Scene<'a>,
    /// The primitive planner.
    pub planner: &'a Planner<'a>,
    /// Places may be cleared for objects that find none; the paper has no such thing.
    pub detours: bool,
}

/// Moves from one arrangement towards another, and where they end.
struct Attempt {
    moves: Vec<Move>,
    reached: Arrangement,
    complete: bool,
    /// The object that found no buffer.
    stuck: Option<usize>,
}

struct Node {
    arrangement: Arrangement,
    parent: Option<usize>,
    /// Moves from the parent's arrangement to this one.
    moves: Vec<Move>,
}

/// The trees from both ends: a search can be left with them and gone on with later.
pub struct Trees {
    trees: [Vec<Node>; 2],
    /// The tree that grows next.
    side: usize,
}

impl Trees {
    /// Two roots.
    pub fn new(start: Arrangement, goal: Arrangement) -> Trees {
        let root = |arrangement| vec![Node { arrangement, parent: None, moves: Vec::new() }];
        Trees { trees: [root(start), root(goal)], side: 0 }
    }

    /// Nothing grows any more.
    pub fn are_full(&self) -> bool {
        let most =
            |tree: &[Node]| POSITION_LIMIT / tree.first().map_or(1, |root| root.arrangement.len().max(1));
        self.trees.iter().any(|tree| tree.len() >= TREE_LIMIT.min(most(tree).max(2)))
    }
}

impl Trlb<'_> {
    /// The first plan from `start` to `goal`; None when the effort is spent or the trees have grown to their
    /// limit.
    pub fn search(
        &self,
        start: Arrangement,
        goal: Arrangement,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Option<Vec<Move>> {
        self.go_on(&mut Trees::new(start, goal), rng, effort)
    }

    /// Lets the trees grow until they meet, are full, or the effort is spent.
    pub fn go_on(&self, both: &mut Trees, rng: &mut ChaCha8Rng, effort: &mut Effort) -> Option<Vec<Move>> {
        while !effort.is_over() && !both.are_full() {
            let [near, far] = if both.side == 0 { [0, 1] } else { [1, 0] };
            if let Some(plan) = self.grow(&mut both.trees, near, far, rng, effort) {
                return Some(tidy(plan));
            }
            both.side = 1 - both.side;
            // A loop that samples nothing (no move possible at all) has to come to its limit too.
            effort.step();
        }
        None
    }

    /// One extension of the tree `near` towards the root of `far`, then towards the nearest node of `far`.
    fn grow(
        &self,
        trees: &mut [Vec<Node>; 2],
        near: usize,
        far: usize,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Option<Vec<Move>> {
        let chosen = rng.random_range(0..trees[near].len());
        let towards_root =
            self.attempt(&trees[near][chosen].arrangement, &trees[far][0].arrangement, rng, effort);
        let complete = towards_root.complete;
        let stuck = towards_root.stuck.filter(|_| self.detours && trees[near].len() >= DETOURS_AFTER);
        if towards_root.moves.is_empty() && !complete && stuck.is_none() {
            return None;
        }
        let Attempt { moves, reached, .. } = towards_root;
        trees[near].push(Node { arrangement: reached, parent: Some(chosen), moves });
        let new = trees[near].len() - 1;
        if complete {
            return Some(join(trees, near, new, Vec::new(), 0));
        }
        self.link(trees, near, new, rng, effort)
            .or_else(|| self.grow_detour(trees, near, new, stuck?, rng, effort))
    }

    /// Tries to get from the node `new` of the tree `near` to the nearest one of the other tree.
    fn link(
        &self,
        trees: &[Vec<Node>; 2],
        near: usize,
        new: usize,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Option<Vec<Move>> {
        let far = &trees[1 - near];
        let nearest = nearest_node(far, &trees[near][new].arrangement, effort.watch())?;
        let link = self.attempt(&trees[near][new].arrangement, &far[nearest].arrangement, rng, effort);
        link.complete.then(|| join(trees, near, new, link.moves, nearest))
    }

    /// Adds a node below `from` in which the object `stuck` has a place cleared for it, and links that.
    fn grow_detour(
        &self,
        trees: &mut [Vec<Node>; 2],
        near: usize,
        from: usize,
        stuck: usize,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Option<Vec<Move>> {
        let goal = &trees[1 - near][0].arrangement;
        let start = &trees[near][from].arrangement;
        let steps = detour::clear_a_place(self.scene, start, goal, stuck, rng, effort)?;
        let mut arrangement = start.clone();
        let moves = carry_out(&mut arrangement, steps);
        trees[near].push(Node { arrangement, parent: Some(from), moves });
        self.link(trees, near, trees[near].len() - 1, rng, effort)
    }

    /// A primitive plan from `from` to `to`, carried out as far as buffers are found.
    fn attempt(
        &self,
        from: &Arrangement,
        to: &Arrangement,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Attempt {
        let objects: Vec<usize> =
            self.scene.movable.iter().copied().filter(|&o| from[o].pose != to[o].pose).collect();
        let steps = self
            .graph(from, to, &objects, effort.watch())
            .and_then(|graph| (self.planner)(&graph, &objects, rng, effort));
        let Some(steps) = steps else {
            return Attempt { moves: Vec::new(), reached: from.clone(), complete: false, stuck: None };
        };
        let steps: Vec<Step> = steps.iter().map(|s| Step { object: objects[s.object], ..*s }).collect();
        let allocated = allocate(self.scene, from, to, &steps, rng, effort);
        let mut reached = from.clone();
        let moves = carry_out(&mut reached, allocated.moves);
        Attempt { moves, reached, complete: allocated.complete, stuck: allocated.stuck }
    }

    /// Who of the objects waits for whom on the way from one arrangement to the other; None where `watch`
    /// ends the work.
    fn graph(
        &self,
        from: &Arrangement,
        to: &Arrangement,
        objects: &[usize],
        watch: &mut Watch,
    ) -> Option<DependencyGraph> {
        let blocks = |i: usize, j: usize| i != j && !self.scene.clear(&to[objects[i]], &from[objects[j]]);
        let blockers = |i: usize| -> Option<ObjectSet> {
            let row = || (0..objects.len()).filter(|&j| blocks(i, j)).collect();
            watch.go_on(self.scene.row_ticks()).then(row)
        };
        let blockers: Option<Vec<ObjectSet>> = (0..objects.len()).map(blockers).collect();
        blockers.map(DependencyGraph::from_blockers)
    }
}

/// Makes the steps' moves, and changes the arrangement accordingly.
fn carry_out(arrangement: &mut Arrangement, steps: Vec<(usize, Arc<Spot>)>) -> Vec<Move> {
    let steps = steps.into_iter();
    let step = |(object, to): (usize, Arc<Spot>)| {
        let from = std::mem::replace(&mut arrangement[object], to.clone());
        Move { object, from, to }
    };
    steps.map(step).collect()
}

/// The node whose arrangement differs from `arrangement` in the fewest objects; the oldest of these. None
/// where `watch` ends the work.
fn nearest_node(tree: &[Node], arrangement: &Arrangement, watch: &mut Watch) -> Option<usize> {
    let differing =
        |node: &Node| node.arrangement.iter().zip(arrangement).filter(|(a, b)| a.pose != b.pose).count();
    let mut nearest: Option<(usize, usize)> = None;
    for (at, node) in tree.iter().enumerate() {
        if !watch.go_on(arrangement.len() as u64) {
            return None;
        }
        let far = differing(node);
        if nearest.is_none_or(|(least, _)| far < least) {
            nearest = Some((far, at));
        }
    }
    nearest.map(|(_, at)| at)
}

/// The plan over `near_node` of the tree `near`, the link, and `far_node` of the other tree, from start to
/// goal.
fn join(
    trees: &[Vec<Node>; 2],
    near: usize,
    near_node: usize,
    link: Vec<Move>,
    far_node: usize,
) -> Vec<Move> {
    let mut plan = from_root(&trees[near], near_node);
    plan.extend(link);
    plan.extend(reversed(from_root(&trees[1 - near], far_node)));
    if near == 0 { plan } else { reversed(plan) }
}

fn from_root(tree: &[Node], node: usize) -> Vec<Move> {
    let mut path = Vec::new();
    let mut at = Some(node);
    while let Some(index) = at {
        path.push(index);
        at = tree[index].parent;
    }
    path.iter().rev().flat_map(|&index| tree[index].moves.clone()).collect()
}

/// The moves from the end to the beginning: what is possible one way is possible the other way.
pub fn reversed(moves: Vec<Move>) -> Vec<Move> {
    moves.into_iter().rev().map(|m| Move { object: m.object, from: m.to, to: m.from }).collect()
}

/// Drops moves that move nothing and merges moves of one object that follow each other at once.
pub fn tidy(moves: Vec<Move>) -> Vec<Move> {
    let mut tidied: Vec<Move> = Vec::new();
    for next in moves {
        match tidied.last_mut() {
            Some(last) if last.object == next.object => last.to = next.to,
            _ => tidied.push(next),
        }
        if tidied.last().is_some_and(|last| last.from.pose == last.to.pose) {
            tidied.pop();
        }
    }
    tidied
}
