//! What the cell does next: a pure state machine from inputs to actions.
//!
//! `model`: what the machine knows of the cell. `order`: a job as it sees it, and its result. `input`: what it
//! is told and what it asks for. `gates`: the conditions without which nothing moves. `cell`: the machine:
//! look, plan, approve, pick, verify, place, look again; `bring_up`, `look`, `judge`, `work`, `operator` and `trouble` hold its parts.
//! No clock, no socket: time and the devices' last word come in with every call, so that every stop, fault and
//! late answer can be played through in a test.

mod bring_up;
pub mod cell;
pub mod gates;
pub mod input;
mod judge;
mod look;
pub mod model;
mod operator;
pub mod order;
mod trouble;
mod work;

#[cfg(test)]
mod tests;
