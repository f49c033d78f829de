//! Checked configuration of the cell and of the simulator.
