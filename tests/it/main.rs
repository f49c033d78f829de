//! Tests across module borders, in one binary: closed loops over real sockets, files, the command line.

mod plan_command;

mod public_bounds;

mod render;
