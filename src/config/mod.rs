//! Checked configuration of the cell and of the simulator.

pub mod cell;
pub mod simulated;
