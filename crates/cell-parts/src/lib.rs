//! What the configuration of a cell and that of its simulation have in common: the gripper (`gripper`), the
//! markers fixed to the table (`reference`), a board of markers (`grid`), and the values that both files are
//! made of (`fields`, with `places` for complaints about values that were read long ago;
//! `file` opens one).
//!
//! In: located values of a document and a decoder that collects complaints. Out: plain structs in SI. Pure
//! but for `file`. The cell and its simulation read these parts with the same code and share nothing else of
//! their files.

pub mod fields;
pub mod file;
pub mod grid;
pub mod gripper;
pub mod places;
pub mod reference;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
