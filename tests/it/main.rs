//! Tests across module borders, in one binary: closed loops over real sockets, files, the command line.

mod bad_bytes;
mod bad_input;
mod bench_command;
mod calibration;
mod camera_faults;
mod cell;
mod closed_loop;
mod doctor;
mod edit;
mod faults;
mod first_moves;
mod looks;
mod mutants;
mod on_robot_program;
mod one_robot;
mod plan_command;
mod program_protocol;
mod public_bounds;
mod render;
mod robot_session;
mod sights;
mod sim_config;
mod slow_disk;
mod third_party;
mod watchdog;
mod ways_back;
