//! Pictures for the benchmark of marker detection: drawn prints, and drawn pictures made worse.
//!
//! In: a lens, a view, prints, a seed. Out: grey pictures of known truth. A crate of its own, because pixels
//! want an optimizer that the shell around them does without. Pure.

pub mod degrade;
pub mod render;
pub mod view;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
