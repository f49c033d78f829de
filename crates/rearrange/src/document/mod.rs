//! Text (YAML or JSON) to typed values, every complaint with line and column.
//!
//! `tree`: text to a tree of located values. `recover`: what can be read of a text that is not valid. `decode`: the tree to numbers, names, lists and maps, with all
//! complaints collected before anything is refused. `word`: the words of enums. `write`: values back to YAML
//! and JSON. `chain`: an error and its causes on one line. Pure: the text comes in, nothing is opened. JSON
//! is read by the same parser: YAML 1.2 contains it.

pub mod chain;
pub mod decode;
mod diagnostic;
#[cfg(test)]
#[path = "../../../../tests/it/edit.rs"]
pub(crate) mod edit;
mod recover;
pub mod tree;
pub mod word;
pub mod write;

pub use diagnostic::{Diagnostic, Diagnostics, Location};
pub use recover::parse_rest;
pub use tree::{Node, parse};
