//! The arms of Universal Robots: their models, forward and inverse kinematics (`kinematics`), capsules that
//! contain their links (`bodies`), and poses as the controller writes them (`pose`).
//!
//! In and out: metres, radians, standard Denavit-Hartenberg parameters, nominal or calibrated. Pure.

pub mod bodies;
pub mod chain;
pub mod kinematics;
pub mod models;
pub mod pose;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
