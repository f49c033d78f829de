//! How the arm does a pick-n-place: kinematics, limits, paths. Pure.
//!
//! `kinematics`: joints to poses and back. `path`: segments and the check that lets them reach the robot.
//! `pick_n_place`: one action of a checked plan as three checked paths. `cycle_time`: what a sequence of them
//! will take. `put_down`: the way back with an object in the hand. `slow`: the moves of a calibration.

pub mod cycle_time;
pub mod path;
pub mod pick_n_place;
pub mod put_down;
pub mod slow;
