//! Monte Carlo tree search over arrangements: MCTS (Labbe et al.) and the paper's EMCTS.
//!
//! In: a start and a complete goal arrangement, a [`Rule`] (who counts how much), random numbers. Out:
//! plans, each offered to the caller, who says whether the search goes on. Source: the paper, sections "MCTS
//! for Solving TORI" and "Extended MCTS", with its reduced action space (only objects away from their goals
//! are served) and its two-step collision check. The reward of a visit is that of the state it adds; nothing
//! is rolled out. Deviations: rewards are shares of the whole, between 0 and 1, so that the exploration
//! constant does not depend on the number of objects; the blocker that is relocated is the nearest that
//! really overlaps the goal (the paper says "an object blocking", its code takes the nearest object); a
//! relocation for which no free pose is sampled is dropped instead of repeating its state; states reached on
//! several ways share one node; a tree that has grown to its limit is dropped and another one begun, since
//! the poses sampled first decide much, and so that a long search does not fill the memory; once a plan is
//! known, states from which no better one can be reached are left out.

mod rule;
mod table;
mod tree;

use crate::planning::buffers::Arrangement;
use crate::planning::effort::{Effort, Watch};
use crate::planning::mcts::table::Table;
use crate::planning::mcts::tree::Tree;
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::Scene;
use crate::planning::trlb::{Move, tidy};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

pub use crate::planning::mcts::rule::{EMCTS_EXPLORATION, MCTS_EXPLORATION, Rule};

/// Nodes after which the first tree is dropped: enough for most problems, so that a tree that started badly
/// does not hold up the search.
pub const FIRST_TREE: usize = 20_000;

/// Nodes after which any tree is dropped (about 1 kB each). Each tree may have twice as many as the one
/// before.
pub const LARGEST_TREE: usize = 160_000;

/// Positions of objects that the nodes of any tree may hold together, each of 4 bytes: 160 MB.
const MOST_POSITIONS: usize = 40_000_000;

/// What the caller makes of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It does not count.
    Refused,
    /// It counts: look for better ones.
    Accepted,
    /// The search ends.
    Enough,
}

/// Takes the plans a search finds.
pub type Offer<'a> = dyn FnMut(Vec<Move>) -> Verdict + 'a;

/// A tree over one problem: a search that can be left and gone on with.
pub struct TreeSearch<'a> {
    rule: Arc<Rule>,
    goal: Arrangement,
    table: Table<'a>,
    tree: Tree,
    most: usize,
    exhausted: bool,
}

impl<'a> TreeSearch<'a> {
    /// A root. `rule` says who counts how much; start and goal are of every object; the tree is full at
    /// `most` nodes. None where `watch` ends the work.
    pub fn new(
        scene: &'a Scene<'a>,
        rule: Arc<Rule>,
        start: &Arrangement,
        goal: Arrangement,
        most: usize,
        watch: &mut Watch,
    ) -> Option<TreeSearch<'a>> {
        let table = Table::new(scene, start, &goal, watch)?;
        let root = table.start();
        let tree = Tree::new(rule.clone(), &root, table.home(&root));
        let most = most.min(MOST_POSITIONS / start.len().max(1)).max(1);
        Some(TreeSearch { rule, goal, table, tree, most, exhausted: false })
    }

    /// Nothing grows any more.
    pub fn is_over(&self) -> bool {
        self.exhausted || self.tree.len() >= self.most
    }

    /// Grows the tree until `offer` has enough, the effort is spent, or the tree is exhausted or full.
    /// Only plans whose sum of the rule's costs is below `ceiling` are offered; accepted ones lower it.
    /// True if the caller has enough.
    pub fn grow(
        &mut self,
        ceiling: &mut f64,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
        offer: &mut Offer,
    ) -> bool {
        if self.tree.is_goal(0) {
            return offer(Vec::new()) == Verdict::Enough;
        }
        while !self.is_over() && effort.step() {
            match self.visit(*ceiling, rng, effort) {
                Visit::Exhausted => self.exhausted = true,
                Visit::Grown => {}
                Visit::Goal(at) => {
                    let moves = tidy(self.moves(at));
                    let cost: f64 = moves.iter().map(|m| self.rule.costs[m.object]).sum();
                    match offer(moves) {
                        Verdict::Enough => return true,
                        Verdict::Accepted => *ceiling = ceiling.min(cost - 1e-9),
                        Verdict::Refused => {}
                    }
                }
            }
        }
        false
    }

    /// One iteration: down by the upper confidence bound, one new state, its reward back up the path.
    fn visit(&mut self, ceiling: f64, rng: &mut ChaCha8Rng, effort: &mut Effort) -> Visit {
        let mut path = vec![0];
        loop {
            let at = path[path.len() - 1];
            let untried = &self.tree.node(at).untried;
            if untried.is_empty() {
                if !effort.watch().go_on(self.goal.len() as u64) {
                    return Visit::Grown;
                }
                match self.tree.best_child(at, ceiling) {
                    Some(child) => path.push(child),
                    None if at == 0 => return Visit::Exhausted,
                    None => {
                        self.tree.close(at);
                        return Visit::Grown;
                    }
                }
                continue;
            }
            let object = untried.iter().nth(rng.random_range(0..untried.len())).unwrap_or_default();
            self.tree.mark_tried(at, object);
            let Some(reached) = self.expand(at, object, rng, effort) else {
                if effort.is_over() {
                    return Visit::Grown;
                }
                continue;
            };
            path.push(reached.node);
            let reward = self.tree.node(reached.node).home.weight(&self.rule.rewards);
            self.tree.reward(&path, reward);
            if !self.tree.is_goal(reached.node) {
                return Visit::Grown;
            }
            self.tree.close(reached.node);
            return if reached.improved { Visit::Goal(reached.node) } else { Visit::Grown };
        }
    }

    fn expand(
        &mut self,
        at: usize,
        object: usize,
        rng: &mut ChaCha8Rng,
        effort: &mut Effort,
    ) -> Option<tree::Reached> {
        let state = self.tree.node(at).state.clone();
        let (moved, place) = self.table.act(&state, object, &self.goal, rng, effort)?;
        let mut next = state.to_vec();
        next[moved] = place;
        let home = &self.tree.node(at).home;
        let home: ObjectSet = if moved == object { home.with(object) } else { home.clone() };
        Some(self.tree.link(at, object, moved, &next, home))
    }

    fn moves(&self, at: usize) -> Vec<Move> {
        let (tree, table) = (&self.tree, &self.table);
        let way = tree.way_to(at);
        let step = |pair: &[usize]| {
            let (before, after) = (&tree.node(pair[0]).state, &tree.node(pair[1]).state);
            let object = (0..before.len()).find(|&o| before[o] != after[o])?;
            let (from, to) = (table.spot(before[object]).clone(), table.spot(after[object]).clone());
            Some(Move { object, from, to })
        };
        way.windows(2).filter_map(step).collect()
    }
}

/// What an iteration came to.
enum Visit {
    /// Nothing left to try.
    Exhausted,
    /// A state more, or one closed.
    Grown,
    /// A state with everything at its goal, by a new way.
    Goal(usize),
}

#[cfg(test)]
mod tests;
