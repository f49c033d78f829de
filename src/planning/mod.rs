//! The rearrangement problem, its solvers, lower bound and independent plan checker. Pure.
//!
//! `problem`: a task with its rules of contact. `plan`: actions, status, and their file. `check` (with
//! `overlap`): the independent checker, the only way to a plan the robot may carry out. `graph`, `feedback`,
//! `bound`: dependency graph, minimum feedback vertex sets, lower bound. `weights`, `primitive`: HeCP and HeTI,
//! primitive plans of minimum running buffer. `scene`, `buffers`, `trlb`: lazy buffer allocation and the
//! bidirectional search. `completion`, `solver`: one shape for all solvers. `generate`: random instances.

pub mod bound;
pub mod buffers;
pub mod check;
pub mod completion;
pub mod effort;
pub mod feedback;
pub mod generate;
pub mod graph;
pub mod object_set;
mod overlap;
pub mod plan;
pub mod primitive;
pub mod problem;
pub mod scene;
pub mod solver;
pub mod trlb;
pub mod weights;
