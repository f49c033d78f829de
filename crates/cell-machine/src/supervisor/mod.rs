//! What the cell does next: a pure state machine from inputs to actions.
//!
//! `model`: what it knows of the cell. `order`: a job as it sees it, and its result. `input`: what comes in
//! and what it requests. `mode`: whether and how the cell may move. `ledger`: records on their way to the
//! disk. `gates`: the conditions without which nothing moves. `cell`: the states: look, plan, approve, pick,
//! verify, place, look again; `bring_up`, `look`, `sight`, `route`, `travel`, `judge`, `work`, `visits`,
//! `wanted`, `preview`, `operator`, `answers`, `standing`, `lapse`, `identity`, `holding`, `faults`,
//! `stop_reasons`, `recovery`, `free_place`, `situation`, `paused`, `device_notes` and `time_book` hold its
//! parts. `draft`: plans for goals that are not submitted. No clock, no socket: time and the devices' last
//! word come in with every call, so that every stop, fault and late answer can be played through in a test.

mod answers;
mod back;
mod bring_up;
pub mod cell;
mod device_notes;
pub mod draft;
mod faults;
mod free_place;
pub mod gates;
mod holding;
pub mod identity;
mod improve;
pub mod input;
mod judge;
mod lapse;
pub(crate) mod ledger;
mod look;
pub(crate) mod look_plan;
pub mod mode;
pub mod model;
mod operator;
pub mod order;
mod paused;
pub(crate) mod phase;
mod preview;
mod reach;
pub mod reason;
mod recovery;
pub mod round;
mod route;
pub mod safety_words;
mod set_out;
mod sight;
pub mod situation;
mod standing;
pub mod status;
mod stop_reasons;
mod tabletop;
mod time_book;
mod travel;
mod visits;
mod wanted;
mod work;

#[cfg(test)]
pub(crate) mod tests;
