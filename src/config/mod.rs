//! Checked configuration of the cell and of the simulator.

pub mod calibrated;
mod calibration;
pub mod camera;
pub mod cell;
pub mod check;
pub mod empty;
mod fields;
pub mod load;
mod parts;
mod pieces;
mod places;
pub mod read_cell;
pub mod read_sim;
pub mod setup;
pub mod simulated;
#[cfg(test)]
mod tests;
