//! Simulator: world, camera, gripper and controller behind the sockets that the real devices have.

pub mod camera_server;
pub mod control_server;
pub mod gripper_server;
pub mod render;
pub mod world;
