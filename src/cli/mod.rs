//! The command line: one file a subcommand.

pub mod check;
pub mod demo;
pub mod jobs;
pub mod submit;
