//! Why there is no calibration.
//!
//! In: a sentence. Out: the sentence with the exit code that goes with it.

/// Why there is no calibration, and the exit code that says so.
#[derive(Debug)]
pub(super) struct Fault {
    pub(super) message: String,
    pub(super) code: u8,
}

pub(super) fn bad_input(message: String) -> Fault {
    Fault { message, code: 2 }
}
