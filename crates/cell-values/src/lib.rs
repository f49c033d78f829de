//! The plain values that the rooms of a robot cell pass on: joint positions and the few factors between
//! units (`units`), timestamps (`time`), the hue of an object by its number (`hue`), pictures in memory with
//! the patterns of the marker family (`image`).
//!
//! Pure: no clock is read and no file is opened.

pub mod hue;
pub mod image;
pub mod time;
pub mod units;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
