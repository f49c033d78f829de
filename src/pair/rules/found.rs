//! Where rules put what they find.

use crate::pair::rules::rule::Rule;

/// Breaches of one frame or message, with what was seen.
#[derive(Debug, Default)]
pub(super) struct Found(Vec<(Rule, String)>);

impl Found {
    /// A rule is broken.
    pub fn push(&mut self, rule: Rule, detail: impl Into<String>) {
        self.0.push((rule, detail.into()));
    }

    /// What was found, oldest first; nothing is left.
    pub fn take(&mut self) -> Vec<(Rule, String)> {
        std::mem::take(&mut self.0)
    }
}
