//! The arms of Universal Robots: their models, forward and inverse kinematics (`kinematics`), where the
//! links of one arm are and which arm it is (`links`), capsules that contain them (`bodies`), and poses as
//! the controller writes them (`pose`).
//!
//! In and out: metres, radians, standard Denavit-Hartenberg parameters, nominal or calibrated. Pure.

pub mod bodies;
pub mod chain;
pub mod kinematics;
pub mod links;
pub mod models;
pub mod pose;
#[cfg(any(test, feature = "testing"))]
pub mod testing;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
