//! celld: the daemon of a robot cell that rearranges a cluttered table.
//!
//! Modules are listed in reading order; each may use only the ones its row in ARCHITECTURE.md names, and
//! `tests/tidy.rs` checks that. The pure core runs down to `report`; `io`, `jobs`, `sim`, `daemon`, `bench`
//! and `cli` are the shell around it.

pub mod units;

pub mod time;

pub mod document;

pub mod wire;

pub mod urscript;

pub mod geometry;

pub mod tabletop;

pub mod planning;

pub mod vision;

pub mod motion;

pub mod calibration;

pub mod cell;

pub mod perception;

pub mod report;

pub mod io;

pub mod jobs;

pub mod config;

pub mod sim;

pub mod daemon;

pub mod pair;

pub mod bench;

pub mod cli;
