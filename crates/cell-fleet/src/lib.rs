//! Many robot cells, one queue: jobs, claims and events of a fleet over NATS JetStream.
//!
//! `subjects`, `payloads` and `requests`: what goes over the wire; `asyncapi`: the same in a document.
//! `agent`: what a cell decides, with `hands` (the jobs it has), `steward` (all jobs of the fleet),
//! `succession` (which cell is the steward), `world` (what they share) and `values` (inputs and effects);
//! all of these are pure. `store`: the cell's
//! database; `connect`, `server`, `link`, `pull`, `network`, `watches`: NATS; `side`: the cell as its part
//! in the fleet sees it; `run`: that part from start to end; `client`: what a person at a terminal does;
//! `changes`: all that changes, for who shows it; `files`, `fetch`: pictures, plans and recordings for who
//! requests them; `fragments`, `publish`: parts of a configuration in versions.

pub mod agent;
pub mod asyncapi;
pub mod changes;
pub mod client;
pub mod connect;
pub mod fetch;
pub mod files;
pub mod fragments;
pub mod hands;
pub mod link;
pub mod network;
pub mod payloads;
pub mod publish;
pub mod pull;
pub mod requests;
pub mod run;
pub mod server;
pub mod side;
pub mod steward;
pub mod store;
pub mod subjects;
pub mod succession;
pub mod values;
pub mod watches;
pub mod words;
pub mod world;

/// The example of the README, run by `cargo test --doc`.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
