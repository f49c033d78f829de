//! The edge that the processes of a cell share: the clock that both sides follow (`clock`), thread
//! priorities (`priority`), files that survive a power cut (`files`) or belong together (`together`), a lock
//! with one holder (`file_lock`), whose program calls (`peer`), what a command prints, reads and logs
//! (`terminal`).
//!
//! Everything here touches the machine it runs on; what is computed from it lies elsewhere.

pub mod clock;
pub mod file_lock;
pub mod files;
pub mod peer;
pub mod priority;
pub mod terminal;
pub mod together;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
