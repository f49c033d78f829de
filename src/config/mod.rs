//! Checked configuration of the cell and of the simulator.

pub mod blends;
pub mod bodies;
pub mod calibrated;
mod calibration;
pub mod camera;
pub mod cell;
pub mod check;
pub mod empty;
pub mod fleet;
pub mod fragment;
mod kept;
mod limits;
pub mod load;
pub mod page;
mod parts;
pub mod pictures;
pub mod read_cell;
pub mod read_fragment;
pub mod round;
pub mod sessions;
pub mod setup;
#[cfg(test)]
mod tests;
