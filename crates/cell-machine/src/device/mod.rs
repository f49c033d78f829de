//! Sans-IO sessions with the robot controller and the gripper.
//!
//! In: bytes or answers of a device, commands, and the time. Out: bytes or requests to send, events, and the
//! time at which the session wants to be called again, with the reason. Nothing here opens a socket or reads
//! a clock, so every delay, loss and refusal can be played through in a test. All sessions have the same
//! verbs: `connected`, `disconnected`, `received`, `tick`, `poll_transmit`, `poll_event`, `poll_timeout`;
//! time passes in `tick` alone, after everything that has arrived was handed over.

pub mod outbox;

#[cfg(test)]
pub(crate) mod recordings;
pub mod registers;

pub mod program;

pub mod rtde_recipes;

pub mod rtde_jump;
pub mod rtde_session;

pub mod software;

pub mod dashboard_session;

pub mod primary_session;

pub mod stream;

pub mod robot_types;

pub mod robot;

pub mod gripper_types;

pub mod gripper;

pub mod gripper_identity;

pub mod modbus;
