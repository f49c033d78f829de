//! The rearrangement problem, its solvers, lower bound and independent plan checker.

pub mod effort;

pub mod feedback;

pub mod graph;

pub mod object_set;

pub mod primitive;
