//! Names of orders that the listing of the folder found without a report of the kernel.
//!
//! In: names from the thread that lists. Out: the same names for the thread that takes all orders except
//! stops. One thread takes them all, so that the orders of a sender keep their sequence.

use std::sync::{Arc, Mutex, PoisonError};

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Unreported(Arc<Mutex<Vec<String>>>);

impl Unreported {
    /// Adds a name.
    pub fn leave(&self, name: String) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(name);
    }

    /// The names added since the last call.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
