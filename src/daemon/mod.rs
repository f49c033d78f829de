//! The tokio shell: it moves bytes, keeps time, runs the slow work on threads, and decides nothing.
//!
//! `shell`: the loop between machine and world; `messages`: what it receives. `sockets`: TCP to the
//! controller and Modbus to the gripper. `workers`: perception and planning on threads of their own;
//! `cameras`: the camera that the configuration names. `store`: the state folder on threads of its own;
//! `keeper`: what is kept there; `recorder`: a run into one file. Nothing here depends on whether the peer
//! is a robot or the simulator.

pub mod cameras;
pub mod keeper;
pub mod messages;
pub mod recorder;
pub mod shell;
pub mod sockets;
pub mod store;
pub mod workers;
