//! The tokio shell: it moves bytes, keeps time, runs the slow work on threads, and decides nothing.
//!
//! `shell`: the loop between machine and world; `messages`: what it receives. `sockets`: TCP to the
//! controller and Modbus to the gripper. `workers`: perception and planning on threads of their own;
//! `cameras`: the camera that the configuration names; `film`: its pictures for viewers. `store`: the
//! journal on a thread of its own; `keeper`: what is kept there; `job_orders`: jobs as the supervisor takes
//! them; `job_report`: one as a page; `disk`: whether there is room; `last_answers`: when devices answered;
//! `last_picture`: what the camera showed; `carried`: what the arm has taken where since; `plan_files`:
//! plans for people. `intake`: orders, from each source on a thread of its own; `state_orders`: those that
//! operators leave in the state folder; `gripper_memory`: what they have confirmed; `reception`: orders
//! before there is a machine. `recorder`: a run into files, `playback`: out of them; `recordings_folder`:
//! which of them stay. `watchdog`: whether all of them get on. Nothing here depends on whether the peer is
//! a robot or the simulator.

pub mod cameras;
pub mod carried;
pub mod disk;
pub mod film;
pub mod gripper_memory;
pub mod intake;
pub mod job_orders;
pub mod job_report;
pub mod keeper;
pub mod last_answers;
pub mod last_picture;
pub mod messages;
pub mod plan_files;
pub mod playback;
pub mod reception;
pub mod recorder;
pub mod recordings_folder;
pub mod shell;
pub mod sockets;
pub mod state_orders;
pub mod store;
pub mod watchdog;
pub mod workers;
