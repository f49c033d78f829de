//! The whole cell as one pure machine: bytes, answers, orders and time in, effects out.
//!
//! `machine`: [`machine::Machine`], the one thing that a shell drives. `event`: what goes in, what comes
//! out. `device`: the sessions with robot and gripper. `links`: when a connection is made anew.
//! `supervisor`: what the cell does next. `orders`: what a person may order, and the answer.
//! `intake`: what of an order is judged before it is decided. `planner`: a
//! plan request answered, with `plan_check` for what the arm can do of a plan and `quickest`
//! for the order of its moves. `views`: from where the
//! camera sees which part of the table. `times`: where a job's time goes. `code`: the words for how a job
//! ends. No clock, no socket, no file: the daemon turns effects into tokio calls, and a test plays the
//! other side in its own time.

pub mod code;
pub mod device;
pub mod event;
pub mod intake;
pub mod links;
pub mod machine;
mod notified;
pub mod orders;
pub mod plan_check;
pub mod planner;
pub mod quickest;
mod snapshot;
pub mod stillness;
pub mod supervisor;
pub mod times;
pub mod views;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
