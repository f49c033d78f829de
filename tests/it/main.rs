//! Tests across module borders, in one binary: closed loops over real sockets, files, the command line.

mod bad_bytes;
mod bad_input;
mod bench_command;
mod book;
mod calibration;
mod camera_faults;
mod cell;
mod ci_tree;
mod closed_loop;
mod doctor;
mod edit;
mod faults;
mod first_moves;
mod gripper_box;
mod journal_repair;
mod kills;
mod looks;
mod mutants;
mod on_robot_program;
mod one_robot;
mod packaging;
mod page;
mod plan_command;
mod program_protocol;
mod public_bounds;
mod render;
mod replay;
mod robot_session;
mod schemas;
#[path = "../shell/mod.rs"]
mod shell;
mod sights;
mod sim_config;
mod slow_disk;
mod spoilt_files;
mod step_zero;
mod third_party;
#[cfg(feature = "video")]
mod videos;
mod watchdog;
mod ways_back;
