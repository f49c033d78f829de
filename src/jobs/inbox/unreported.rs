//! Commands that the listing of the folder has found and that nobody reported.
//!
//! In: their names. Out: the same, for the reader of reported files: it takes all orders that are no stops,
//! so that those of a sender keep their order.

use std::sync::{Arc, Mutex, PoisonError};

/// Names that the listing leaves to the reader of reported files.
#[derive(Clone, Debug, Default)]
pub struct Unreported(Arc<Mutex<Vec<String>>>);

impl Unreported {
    /// Leaves a name.
    pub fn leave(&self, name: String) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(name);
    }

    /// Those that were left since the last call.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
