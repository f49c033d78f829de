//! Benchmark runners and their tables.

pub mod planning;
