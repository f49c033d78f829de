//! What the cell does next: a pure state machine from inputs to actions.
//!
//! `model`: what it knows of the cell. `order`: a job as it sees it, and its result. `input`: what comes in
//! and what it requests. `mode`: whether and how the cell may move. `ledger`: records on their way to the
//! disk. `gates`: the conditions without which nothing moves. `cell`: the states: look, plan, approve, pick,
//! verify, place, look again; `bring_up`, `look`, `judge`, `work`, `visits`, `operator`, `standing` and
//! `faults` hold its parts. No clock, no socket: time and the devices' last word come in with every call, so
//! that every stop, fault and late answer can be played through in a test.

mod bring_up;
pub mod cell;
mod faults;
pub mod gates;
pub mod input;
mod judge;
pub(crate) mod ledger;
mod look;
pub mod mode;
pub mod model;
mod operator;
pub mod order;
pub(crate) mod phase;
pub mod round;
mod standing;
pub mod status;
mod visits;
mod work;

#[cfg(test)]
mod tests;
