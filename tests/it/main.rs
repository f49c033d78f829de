//! Tests across module borders, in one binary: closed loops over real sockets, files, the command line.

mod public_bounds;

mod render;
