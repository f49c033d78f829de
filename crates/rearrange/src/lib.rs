//! Tabletop rearrangement with pick-n-places: instances, solvers, lower bound, independent plan checker.
//!
//! Path: `document` (text to located values) -> `tabletop` (catalogue, workspace, arrangement, instances) ->
//! `planning` (problem, dependency graph, solvers, checker), with `geometry` (poses, footprints, collision)
//! underneath. Pure: text, seeds and limits come in as arguments; nothing is opened, printed or timed here.

pub mod document;

pub mod geometry;

pub mod tabletop;

pub mod planning;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
