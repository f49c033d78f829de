//! celld: the daemon of a robot cell that rearranges a cluttered table.
//!
//! Modules are listed in reading order; each may use only the modules and crates that its row in
//! ARCHITECTURE.md names, and `tests/tidy.rs` checks that. The pure core runs down to `report`; the rest is
//! the shell around it.

pub mod perception;

pub mod report;

pub mod io;

pub mod jobs;

pub mod config;

pub mod daemon;

pub mod page;

#[cfg(feature = "fleet")]
pub mod fleet;

pub mod doctor;

pub mod demo;

pub mod pair;

pub mod bench;

pub mod cli;
