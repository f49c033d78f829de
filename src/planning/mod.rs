//! The rearrangement problem, its solvers, lower bound and independent plan checker. Pure.
//!
//! `problem`: a task with its rules of contact. `plan`: actions, status, and their file. `check`: the
//! independent checker, the only way to a plan the robot may carry out.

pub mod problem;

pub mod check;
mod overlap;
pub mod plan;

pub mod check;

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
