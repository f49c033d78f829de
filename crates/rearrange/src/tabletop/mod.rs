//! Object catalogue, workspace, arrangement, instance formats and importers. Pure: text in, values out.
//!
//! `instance`: the structs. `decode`: objects and footprints out of a document. `parse`: instance files, all
//! complaints at once, by way of their `parts`; `arrangement`: whether things can lie where a file puts
//! them. `rule`: goals in other words than poses. `public_data`: the importers. `write`: instances back to
//! YAML and JSON. `scenes`: the demo's named tasks. `fit`: any task made ready for a cell, by what has
//! `room` on an object's top.

pub mod arrangement;
pub mod decode;
pub mod fit;
pub mod instance;
pub mod parse;
pub mod parts;
pub mod public_data;
pub mod room;
pub mod rule;
pub mod scenes;
pub mod write;

#[cfg(test)]
mod tests;
