//! Tests across module borders, in one binary: closed loops over real sockets, files, the command line.

mod on_robot_program;
mod program_protocol;
mod render;
mod robot_session;
