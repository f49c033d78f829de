//! The replacement for the hardware: world, UR controller, VGC10 and camera behind the real protocols.

pub mod box_clients;
pub mod camera;

pub mod camera_server;

pub mod cell;

pub mod command;

pub mod compare;

pub mod compute_box;

pub mod config;

pub mod conformance;

pub mod control_server;

pub mod controller;

pub mod core;

pub mod facts;

pub mod faults;

pub mod frames;

pub mod gripper_server;

pub mod motion;

pub mod render;

pub mod robot_api;

pub mod robot_api_server;

pub mod robot_server;

pub mod robotiq_server;

pub mod script_sockets;

pub mod serve;

pub mod session;

pub mod simulator;

pub mod tool_serial_server;

pub mod world;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
