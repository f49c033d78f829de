//! How the arm does a pick-n-place: bodies, limits, paths. Pure.
//!
//! `arm`: joints to poses and back. `path`: segments and the check that lets them reach the robot.
//! `pick_n_place`: one action of a checked plan as three checked paths. `cycle`: its heights and speeds.
//! `cycle_time`: what a sequence of them will take. `set_out`: towards an object that is not yet known to be
//! where it was. `put_down`: the way back with an object in the gripper. `slow`: the moves of a calibration.
//! `reach`: where the arm can pick and place at all. `holding`: what the cups withstand. `bodies`: what the
//! arm, its tool, its load and the cell are made of, and the check that none meets another. `way`: round
//! them. `jog`: what a person does where there is none. `crossing`: ways on which blends are recorded.

pub mod arm;
pub mod bodies;
pub mod crossing;
pub mod cycle;
pub mod cycle_time;
pub mod holding;
pub mod jog;
pub mod path;
pub mod pick_n_place;
pub mod put_down;
mod ramp;
pub mod reach;
pub mod set_out;
pub mod slow;
#[cfg(any(test, feature = "testing"))]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "for tests alone")]
pub mod testing;
pub mod way;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
