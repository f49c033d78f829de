//! The edge that the processes of a cell share: the clock that both sides follow (`clock`, over
//! `clock_channel`; `pace`: who waits for whom), thread priorities (`priority`), files that survive a power
//! cut (`files`) or belong together (`together`), a lock with one holder (`file_lock`), a folder for short
//! messages between processes (`mailbox`), file handles in reserve (`reserve`), large blocks of memory
//! (`memory`), whose program calls (`peer`), what a command prints and reads (`terminal`), a log that nobody
//! waits for (`log`), standard input and output of a helper process (`requests`), work whose panic ends that
//! work alone (`panics`).
//!
//! Everything here touches the machine it runs on; what is computed from it lies elsewhere.

pub mod clock;
pub mod clock_channel;
pub mod file_lock;
pub mod files;
pub mod log;
pub mod mailbox;
pub mod memory;
pub mod pace;
pub mod panics;
pub mod peer;
pub mod priority;
pub mod requests;
pub mod reserve;
pub mod terminal;
pub mod together;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
