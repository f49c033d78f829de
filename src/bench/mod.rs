//! Benchmark runners and their tables.
