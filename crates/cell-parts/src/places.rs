//! Where the keys of a configuration are in its text.
//!
//! In: the tree of the text. Out: locations, for complaints about values that were read long ago. Pure.

use rearrange::document::Location;
use rearrange::document::tree::{Node, Value};

/// Finds the place of a key in the text, for complaints about values that were read long ago.
pub struct Places<'n> {
    top: &'n Node,
}

impl<'n> Places<'n> {
    /// In the text with this tree.
    pub fn new(top: &'n Node) -> Places<'n> {
        Places { top }
    }

    /// The whole text.
    pub fn top(&self) -> &'n Node {
        self.top
    }

    /// Place of `keys` inside each other; of the innermost that is there.
    pub fn at(&self, keys: &[&str]) -> Location {
        let mut node = self.top;
        for key in keys {
            let inner = match key.parse::<usize>() {
                Ok(index) => item(node, index),
                Err(_) => node.get(key),
            };
            let Some(inner) = inner else { break };
            node = inner;
        }
        node.at
    }
}

fn item(node: &Node, index: usize) -> Option<&Node> {
    match &node.value {
        Value::Sequence(items) => items.get(index),
        Value::Map(_) | Value::Scalar { .. } | Value::Unread => None,
    }
}
