//! The rearrangement problem, its solvers, lower bound and independent plan checker. Pure.
//!
//! `problem`: a task with its rules of contact. `plan`: actions, status, and their file. `check`: the
//! independent checker, the only way to a plan the robot may carry out. `graph`, `feedback`: dependency
//! graph, components, minimum feedback vertex sets. `primitive`: primitive plans of minimum running buffer.

pub mod effort;

pub mod feedback;

pub mod graph;

pub mod object_set;

pub mod check;
mod overlap;
pub mod plan;

pub mod primitive;

pub mod problem;
