//! Calibration of a cell: its files, what is fitted, which poses are proposed, which are visited.
//!
//! `files`: camera, hand-eye and table files, read, checked against each other and written. `fit`: mount and
//! table from a round's samples. `propose`: poses inside a taught box. `visit`: what is made of the pictures
//! of a round. `empty`: pictures of the empty table, for cameras without depth. The mathematics is
//! `vision::calibrate`; the arm is moved by the machine (`cell::supervisor::round`).

pub mod empty;
pub mod files;
pub mod fit;
pub mod propose;
pub mod visit;
