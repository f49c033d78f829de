//! A part of a configuration that a cell shares with others, as a document: it takes the place of sections.
//!
//! In: the document, read and checked (`read_fragment`). Out: a cell's document with its sections. Pure.

use rearrange::document::tree::{Node, Value};

/// A fragment whose sections are each by themselves sound.
#[derive(Clone, Debug, PartialEq)]
pub struct ConfigFragment {
    /// A map whose keys are sections.
    pub(super) top: Node,
}

impl ConfigFragment {
    /// A cell's document with the sections of this one in the place of its own.
    pub fn over(&self, mut cell: Node) -> Node {
        if let (Value::Map(own), Value::Map(shared)) = (&mut cell.value, &self.top.value) {
            for entry in shared.iter().filter(|entry| entry.key != "version") {
                match own.iter_mut().find(|known| known.key == entry.key) {
                    Some(known) => *known = entry.clone(),
                    None => own.push(entry.clone()),
                }
            }
        }
        cell
    }
}
