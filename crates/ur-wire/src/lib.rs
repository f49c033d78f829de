//! Sans-IO codecs: RTDE, dashboard and primary interface of the UR controller, Modbus as a server. Bytes
//! and numbers only.
//!
//! In: bytes from either end of a link. Out: typed packages, and bytes again. Each codec serves both ends:
//! the daemon's sessions (`device`) are clients, the simulator answers with the same functions. What they
//! share is the layout of bytes, never a decision. No function here panics on what a peer sent; a failure
//! names the field, its offset in the package, and what was found there.

pub mod bytes;

pub mod enumerations;
pub mod error_codes;

pub mod rtde;

pub mod rtde_ranges;

pub mod rtde_values;

pub mod rtde_variables;

pub mod dashboard;

pub mod primary;

pub mod primary_message;

pub mod primary_state;

pub mod primary_arm;

pub mod primary_masterboard;

pub mod primary_tool;

pub mod modbus;

pub mod modbus_rtu;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
