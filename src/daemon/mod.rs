//! The tokio shell: it moves bytes, keeps time, runs the slow work on threads, and decides nothing.
//!
//! `links`: TCP to the controller and Modbus to the gripper, reconnecting. `hardware`: the device sessions
//! fed by those links. `workers`: detection and planning on threads of their own; `doubts`: their pictures of looks that cannot be trusted; `empty_table`: pictures of the empty table to compare with. `office`: the state folder; `desk`: it on a thread of its own. `setup`: configuration and
//! calibration files into the supervisor's model. `run`: the daemon's loop; `agenda`: what it does in which order. `calibrate`: the same hardware
//! driven through the calibration poses. `calibration_files`: what came of it, read and written. Nothing here knows whether it talks to a robot or to the simulator.

pub mod agenda;
pub mod calibrate;
pub mod calibration_files;
pub mod cameras;
pub mod desk;
pub mod doubts;
pub mod empty_table;
pub mod hardware;
pub mod links;
pub mod office;
pub mod run;
pub mod setup;
pub mod workers;
