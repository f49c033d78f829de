//! The dependency graph of a rearrangement and its strongly connected components.
//!
//! In: for every object the set of objects whose present pose blocks its goal. Out: components in an order
//! in which they can be solved one after the other. Source: the paper, section "Dependency Graph";
//! components by Tarjan (1972), iterative, so that a long chain cannot overflow the stack.

use crate::planning::object_set::ObjectSet;

/// Arc i -> j: object i cannot be placed at its goal while object j is where it is now.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct DependencyGraph {
    /// `blockers[i]` holds every j of an arc i -> j; never i itself.
    blockers: Vec<ObjectSet>,
}

impl DependencyGraph {
    /// A graph of `count` vertices with an arc i -> j wherever `blocks(i, j)` holds and i != j.
    pub fn from_fn(count: usize, mut blocks: impl FnMut(usize, usize) -> bool) -> DependencyGraph {
        let blockers = (0..count).map(|i| (0..count).filter(|&j| j != i && blocks(i, j)).collect()).collect();
        DependencyGraph { blockers }
    }

    /// The graph with these blockers; no vertex may be among its own.
    pub fn from_blockers(blockers: Vec<ObjectSet>) -> DependencyGraph {
        DependencyGraph { blockers }
    }

    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.blockers.len()
    }

    /// Has no vertex.
    pub fn is_empty(&self) -> bool {
        self.blockers.is_empty()
    }

    /// The objects that block the goal of `i`.
    pub fn blockers(&self, i: usize) -> &ObjectSet {
        &self.blockers[i]
    }

    /// Every arc (i, j), in increasing order.
    pub fn arcs(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.blockers.iter().enumerate().flat_map(|(i, set)| set.iter().map(move |j| (i, j)))
    }

    /// The same graph with only the vertices of `kept`; the others lose all arcs.
    pub fn restricted(&self, kept: &ObjectSet) -> DependencyGraph {
        let blockers = self
            .blockers
            .iter()
            .enumerate()
            .map(|(i, set)| if kept.contains(i) { set & kept } else { ObjectSet::EMPTY })
            .collect();
        DependencyGraph { blockers }
    }

    /// The graph on these vertices, which are numbered in their order.
    pub fn part(&self, vertices: &[usize]) -> DependencyGraph {
        let mut number = vec![UNSEEN; self.len()];
        vertices.iter().enumerate().for_each(|(at, &v)| number[v] = at);
        let known = |set: &ObjectSet| set.iter().map(|j| number[j]).filter(|&at| at != UNSEEN).collect();
        DependencyGraph { blockers: vertices.iter().map(|&v| known(&self.blockers[v])).collect() }
    }

    /// Strongly connected components, a component after all that it depends on (sinks first).
    ///
    /// `order` lists every vertex once; vertices are entered in that order, so that a shuffled order gives
    /// another of the valid sequences.
    pub fn components(&self, order: &[usize]) -> Vec<Vec<usize>> {
        let mut search = Tarjan::new(self);
        for &root in order {
            search.run_from(root);
        }
        search.components
    }
}

const UNSEEN: usize = usize::MAX;

/// Tarjan's algorithm with its own stack of (vertex, successors not yet looked at).
struct Tarjan<'a> {
    graph: &'a DependencyGraph,
    index: Vec<usize>,
    low: Vec<usize>,
    open: Vec<bool>,
    stack: Vec<usize>,
    next: usize,
    components: Vec<Vec<usize>>,
}

impl<'a> Tarjan<'a> {
    fn new(graph: &'a DependencyGraph) -> Tarjan<'a> {
        let count = graph.len();
        Tarjan {
            graph,
            index: vec![UNSEEN; count],
            low: vec![UNSEEN; count],
            open: vec![false; count],
            stack: Vec::new(),
            next: 0,
            components: Vec::new(),
        }
    }

    fn enter(&mut self, v: usize) {
        self.index[v] = self.next;
        self.low[v] = self.next;
        self.next += 1;
        self.open[v] = true;
        self.stack.push(v);
    }

    fn run_from(&mut self, root: usize) {
        if self.index[root] != UNSEEN {
            return;
        }
        self.enter(root);
        let graph = self.graph;
        let mut path = vec![(root, graph.blockers(root).iter())];
        while let Some((v, successors)) = path.last_mut() {
            let v = *v;
            if let Some(w) = successors.next() {
                if self.index[w] == UNSEEN {
                    self.enter(w);
                    path.push((w, graph.blockers(w).iter()));
                } else if self.open[w] {
                    self.low[v] = self.low[v].min(self.index[w]);
                }
                continue;
            }
            path.pop();
            if let Some((parent, _)) = path.last() {
                self.low[*parent] = self.low[*parent].min(self.low[v]);
            }
            if self.low[v] == self.index[v] {
                self.close(v);
            }
        }
    }

    fn close(&mut self, root: usize) {
        let mut component = Vec::new();
        while let Some(v) = self.stack.pop() {
            self.open[v] = false;
            component.push(v);
            if v == root {
                break;
            }
        }
        self.components.push(component);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph(count: usize, arcs: &[(usize, usize)]) -> DependencyGraph {
        DependencyGraph::from_fn(count, |i, j| arcs.contains(&(i, j)))
    }

    #[test]
    fn a_component_comes_after_what_it_depends_on() {
        // 0 <-> 1 depends on 2 <-> 3, which depends on 4.
        let graph = graph(5, &[(0, 1), (1, 0), (1, 2), (2, 3), (3, 2), (3, 4)]);
        for order in [[0, 1, 2, 3, 4], [4, 3, 2, 1, 0], [2, 0, 4, 1, 3]] {
            let mut found = graph.components(&order);
            found.iter_mut().for_each(|c| c.sort_unstable());
            assert_eq!(found, [vec![4], vec![2, 3], vec![0, 1]]);
        }
    }

    #[test]
    fn every_vertex_is_in_one_component() {
        let graph = graph(6, &[(0, 1), (1, 2), (2, 0), (4, 5)]);
        let mut all: Vec<usize> = graph.components(&[5, 4, 3, 2, 1, 0]).concat();
        all.sort_unstable();
        assert_eq!(all, [0, 1, 2, 3, 4, 5]);
    }

    #[test]
    fn a_long_chain_needs_no_call_stack() {
        let graph = DependencyGraph::from_fn(3000, |i, j| j == i + 1);
        let components = graph.components(&(0..3000).collect::<Vec<_>>());
        assert_eq!(components.len(), 3000);
        assert_eq!(components[0], [2999]);
    }
}
