//! The rearrangement problem, its solvers, lower bound and independent plan checker. Pure.
//!
//! `problem`: a task with its rules of contact. `plan`: actions, status, and their file. `check`: the
//! independent checker, the only way to a plan the robot may carry out.

pub mod plan;
pub mod problem;
