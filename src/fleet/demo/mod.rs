//! A whole fleet on one computer, to look at and to try: a NATS server, simulated cells, a campaign.
//!
//! `cells`: the files of a simulated cell; `processes`: the programs that are started, and ended with it;
//! `report`: what came of it, as one page. Each cell is the same two programs that `make try` starts, on an
//! address of its own; nothing is shortened but the robot.

pub mod cells;
pub mod processes;
pub mod report;
