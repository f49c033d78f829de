//! The command line: one file a subcommand.

pub mod demo;

pub mod task;

pub mod plan;

pub mod verify;

pub mod bench_planning;
