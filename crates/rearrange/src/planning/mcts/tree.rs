//! The search tree of MCTS: states, how often they were visited, what that was worth, and how they are
//! reached.
//!
//! In: states and the actions between them. Out: which action the upper confidence bound picks next, and the
//! actions from the root to a state. Two paths to one state share its node, with its visits and rewards;
//! each node keeps the cheapest way to it that is known. A node below which nothing is left to find is
//! closed.

use crate::planning::mcts::rule::Rule;
use crate::planning::object_set::ObjectSet;
use std::collections::HashMap;
use std::sync::Arc;

/// An edge: serving `object` leads to `node`.
struct Child {
    object: u32,
    node: u32,
}

/// A state in the tree.
pub(super) struct Node {
    /// Place of every object.
    pub(super) state: Arc<[u32]>,
    /// Objects at their goals.
    pub(super) home: ObjectSet,
    /// Objects whose action has not been tried here.
    pub(super) untried: ObjectSet,
    children: Vec<Child>,
    parent: u32,
    /// Cost of the cheapest known way here.
    cost: f64,
    /// Cost of one move for each object that is not at its goal: no way on is cheaper.
    rest: f64,
    visits: f64,
    rewards: f64,
    closed: bool,
}

/// The nodes, the root first.
pub(super) struct Tree {
    rule: Arc<Rule>,
    nodes: Vec<Node>,
    by_state: HashMap<Arc<[u32]>, u32>,
}

/// A node reached by an action.
pub(super) struct Reached {
    /// Its index.
    pub(super) node: usize,
    /// It is new, or this way to it is cheaper than those before.
    pub(super) improved: bool,
}

impl Tree {
    /// A tree of the root alone. `home`: objects at their goals there.
    pub(super) fn new(rule: Arc<Rule>, state: &[u32], home: ObjectSet) -> Tree {
        let mut tree = Tree { rule, nodes: Vec::new(), by_state: HashMap::new() };
        tree.push(state, home, 0, 0.0);
        tree
    }

    /// Number of nodes.
    pub(super) fn len(&self) -> usize {
        self.nodes.len()
    }

    /// The node at that index.
    pub(super) fn node(&self, at: usize) -> &Node {
        &self.nodes[at]
    }

    /// Every object is at its goal there.
    pub(super) fn is_goal(&self, at: usize) -> bool {
        self.nodes[at].home.len() == self.nodes[at].state.len()
    }

    fn push(&mut self, state: &[u32], home: ObjectSet, parent: usize, cost: f64) -> usize {
        let state: Arc<[u32]> = state.into();
        let away = ObjectSet::first(state.len()) - &home;
        let at = self.nodes.len();
        self.by_state.insert(state.clone(), at as u32);
        self.nodes.push(Node {
            state,
            home,
            rest: away.weight(&self.rule.costs),
            untried: away,
            children: Vec::new(),
            parent: parent as u32,
            cost,
            visits: 0.0,
            rewards: 0.0,
            closed: false,
        });
        at
    }

    /// Takes `object` off the untried actions of a node.
    pub(super) fn mark_tried(&mut self, at: usize, object: usize) {
        self.nodes[at].untried.remove(object);
    }

    /// Nothing below the node is left to find.
    pub(super) fn close(&mut self, at: usize) {
        self.nodes[at].closed = true;
    }

    /// Adds the edge "serving `object` at `from` moves `moved` to where `state` has it", and the node if it
    /// is new.
    pub(super) fn link(
        &mut self,
        from: usize,
        object: usize,
        moved: usize,
        state: &[u32],
        home: ObjectSet,
    ) -> Reached {
        let cost = self.nodes[from].cost + self.rule.costs[moved];
        let known = self.by_state.get(state).map(|&node| node as usize);
        let reached = match known {
            Some(node) => Reached { node, improved: self.found_way(from, node, cost) },
            None => Reached { node: self.push(state, home, from, cost), improved: true },
        };
        self.nodes[from].children.push(Child { object: object as u32, node: reached.node as u32 });
        reached
    }

    /// Remembers the way to `node` over `from` if it is cheaper.
    fn found_way(&mut self, from: usize, node: usize, cost: f64) -> bool {
        let better = cost < self.nodes[node].cost;
        if better {
            self.nodes[node].cost = cost;
            self.nodes[node].parent = from as u32;
        }
        better
    }

    /// The child of the largest upper confidence bound from which a plan below `ceiling` may still be
    /// reached. Equal bounds: the one tried first.
    pub(super) fn best_child(&self, at: usize, ceiling: f64) -> Option<usize> {
        let parent = &self.nodes[at];
        let spread = (2.0 * parent.visits.max(1.0).ln()).sqrt();
        let mut best: Option<(f64, usize)> = None;
        for child in &parent.children {
            let node = &self.nodes[child.node as usize];
            if node.closed || node.cost + node.rest >= ceiling {
                continue;
            }
            let visits = node.visits.max(1.0);
            let exploration = self.rule.exploration[child.object as usize];
            let bound = node.rewards / visits + exploration * spread / visits.sqrt();
            if best.is_none_or(|(most, _)| bound > most) {
                best = Some((bound, child.node as usize));
            }
        }
        best.map(|(_, node)| node)
    }

    /// Counts a visit worth `reward` for every node of `path`.
    pub(super) fn reward(&mut self, path: &[usize], reward: f64) {
        for &at in path {
            self.nodes[at].visits += 1.0;
            self.nodes[at].rewards += reward;
        }
    }

    /// Nodes from the root to `at` along the cheapest known ways.
    pub(super) fn way_to(&self, at: usize) -> Vec<usize> {
        let mut way = vec![at];
        let mut at = at;
        while at != 0 {
            at = self.nodes[at].parent as usize;
            way.push(at);
        }
        way.reverse();
        way
    }
}
