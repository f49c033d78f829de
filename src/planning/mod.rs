//! The rearrangement problem, its solvers, lower bound and independent plan checker. Pure.
//!
//! Reading order: `problem` (a task with its rules of contact) and `plan` (actions, status, their file);
//! `check`, the independent checker and the only way to a plan the robot may carry out; `scene`, the same table
//! as the solvers see it; `graph`, `feedback` and `bound`, what no plan can undercut; `weights`, `primitive`,
//! `buffers`, `trlb` and `completion`, the parts of the running-buffer solvers; `solver`, the front of all of them.

pub mod problem;

pub mod plan;

pub mod check;
mod overlap;

pub mod effort;

pub mod object_set;

pub mod graph;

pub mod feedback;

pub mod scene;

pub mod weights;

pub mod bound;

pub mod primitive;

pub mod buffers;

pub mod trlb;

pub mod completion;

pub mod solver;
