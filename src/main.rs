//! The binary: hands the command line to [`celld::cli`] and nothing else.

fn main() {}
