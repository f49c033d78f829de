//! The rearrangement problem, its solvers, lower bound and independent plan checker.

pub mod bound;

pub mod buffers;

pub mod effort;

pub mod feedback;

pub mod graph;

pub mod object_set;

pub mod primitive;

pub mod problem;

pub mod scene;

pub mod trlb;

pub mod weights;
