//! The rearrangement problem, its solvers, lower bound and independent plan checker. Pure.
//!
//! `problem`: a task with its rules of contact. `plan`: actions, status, and their file. `check` (with
//! `overlap`): the independent checker, the only way to a plan the robot may carry out; `claims`: what a
//! plan file says of itself. `graph`, `feedback`, `bound`: dependency graph, minimum feedback vertex sets,
//! lower bound. `weights`: HeCP and HeTI. `primitive`, `total_buffers`: primitive plans of minimum running
//! buffer and of least buffer weight in all. `scene`, `buffers`, `detour`, `trlb`: lazy buffer allocation
//! and the bidirectional search. `mcts`: tree search over arrangements. `auto`: our own anytime solver.
//! `completion`, `solver`: one shape for all solvers. `travel`: seconds of a plan where no cell knows
//! better. `generate`: random instances.

pub mod auto;
pub mod bound;
pub mod buffers;
pub mod check;
pub mod claims;
pub mod completion;
pub mod detour;
pub mod effort;
pub mod feedback;
pub mod generate;
pub mod graph;
pub mod mcts;
pub mod object_set;
mod overlap;
pub mod plan;
pub mod primitive;
pub mod problem;
#[cfg(test)]
mod random_tables;
pub mod scene;
pub mod solver;
pub mod total_buffers;
pub mod travel;
pub mod trlb;
pub mod weights;
