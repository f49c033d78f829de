//! The simulated cell made to measure for an instance, and what a run of it came to.
//!
//! In: an instance, what a person may choose, what a run has shown. Out: the configurations of both sides,
//! and the run's report. `teach`: markers and joint poses as a person would survey and teach them; `cell`:
//! the configurations; `task`: whether an instance can be done by such a cell; `kept`: what is kept of a run
//! while it happens; `outcome`: its verdict and report. No device is opened here: `celld demo` runs the cell
//! on sockets, the closed loop in virtual time runs it on one thread, and both are made from this.

pub mod cell;
pub mod kept;
pub mod outcome;
pub mod task;
pub mod teach;
