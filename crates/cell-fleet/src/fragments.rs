//! Parts of a configuration that many cells share, in versions: catalogue, planner, tolerances.
//!
//! In: what persons have published for a cell, a label or all; a cell's name and labels. Out: which of it
//! the cell should run with. The cell's own name goes before its labels, those before `any`, and of one
//! target the newest counts. A text without content takes back; where nothing was ever published, a cell
//! stays as it is: a server that has lost everything changes no cell. Pure.

use crate::subjects::{ANY, Target};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Longest text of a fragment.
pub const FRAGMENT_MAX: usize = 256 * 1024;

/// A part of a configuration as it was published.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fragment {
    /// [`crate::payloads::VERSION`].
    pub version: u32,
    /// YAML with `objects`, `planner`, `tolerances` or some of them; empty: taken back.
    pub text: String,
    /// Of the text, lower-case hex.
    pub sha256: String,
    /// When it was published.
    pub unix_s: f64,
}

/// A fragment with what the server says of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Published {
    /// For whom.
    pub target: Target,
    /// Who published it, as the server let them.
    pub by: String,
    /// Its number: that of its storing, which grows over all targets.
    pub revision: u64,
    /// Itself.
    pub fragment: Fragment,
}

/// The newest fragment of each target.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shelf(BTreeMap<Target, Published>);

impl Shelf {
    /// Takes one in, in whatever order they come.
    pub fn put(&mut self, published: Published) {
        let known = self.0.get(&published.target).map_or(0, |known| known.revision);
        if published.revision > known {
            self.0.insert(published.target.clone(), published);
        }
    }

    /// All of them.
    pub fn all(&self) -> impl Iterator<Item = &Published> {
        self.0.values()
    }

    /// What a cell should run with; `None`: nothing was ever published for it.
    pub fn wanted(&self, cell: &str, labels: &[String]) -> Option<Wanted<'_>> {
        let own = std::iter::once(Target::Cell(cell.to_string()));
        let labelled = labels.iter().filter(|label| *label != ANY).map(|label| Target::Label(label.clone()));
        let mut taken_back = None;
        for target in own.chain(labelled).chain([Target::any()]) {
            match self.0.get(&target) {
                Some(found) if !found.fragment.text.is_empty() => return Some(Wanted::This(found)),
                Some(_) => taken_back = Some(Wanted::None),
                None => {}
            }
        }
        taken_back
    }
}

/// What a cell should run with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wanted<'a> {
    /// Its own configuration with this.
    This(&'a Published),
    /// Its own configuration alone.
    None,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn published(target: &str, revision: u64, text: &str) -> Published {
        let fragment =
            Fragment { version: 1, text: text.into(), sha256: crate::words::sha256(text), unix_s: 0.0 };
        Published { target: Target::parse(target).unwrap(), by: "anna".into(), revision, fragment }
    }

    #[test]
    fn the_nearest_target_and_of_it_the_newest_counts() {
        let labels = ["line-a".to_string(), "vacuum".to_string()];
        let mut shelf = Shelf::default();
        let text = |shelf: &Shelf| match shelf.wanted("c1", &labels) {
            None => "as it is".to_string(),
            Some(Wanted::None) => "its own".to_string(),
            Some(Wanted::This(found)) => found.fragment.text.clone(),
        };
        assert_eq!(text(&shelf), "as it is");
        for (target, revision, line, wanted) in [
            ("cell=c2", 1, "other", "as it is"),
            ("any", 2, "all", "all"),
            ("label=vacuum", 3, "vacuum", "vacuum"),
            ("label=line-a", 4, "a", "a"),
            ("label=line-a", 3, "late", "a"),
            ("cell=c1", 6, "mine", "mine"),
            ("cell=c1", 7, "", "a"),
            ("label=line-a", 8, "", "vacuum"),
            ("label=vacuum", 9, "", "all"),
            ("any", 10, "", "its own"),
        ] {
            shelf.put(published(target, revision, line));
            assert_eq!(text(&shelf), wanted, "{target} {revision}");
        }
    }
}
