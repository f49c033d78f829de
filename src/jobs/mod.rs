//! Job files, spool folders and the journal database: from a dropped YAML file to its result.

pub mod changes;
pub mod command;
#[cfg(test)]
#[path = "../../tests/it/edit.rs"]
pub(crate) mod edit;
pub mod goal;
pub mod goal_source;
pub mod history;
pub mod inbox;
pub mod job_file;
pub mod journal;
pub mod order_queue;
pub mod record;
pub mod reported;
#[cfg(test)]
mod samples;
pub mod sources;
pub mod spool;
pub mod state;
pub mod status;
pub mod submit;
pub mod utc;
