//! Why there is no calibration.
//!
//! In: a sentence. Out: the sentence with the exit code that goes with it.

use cell_calibration::tied::TiedFault;

/// Why there is no calibration, and the exit code that says so.
#[derive(Debug)]
pub(super) struct Fault {
    pub(super) message: String,
    pub(super) code: u8,
}

pub(super) fn bad_input(message: String) -> Fault {
    Fault { message, code: 2 }
}

impl From<TiedFault> for Fault {
    fn from(fault: TiedFault) -> Fault {
        match fault {
            TiedFault::Input(message) => Fault { message, code: 2 },
            TiedFault::Unfit(message) => Fault { message, code: 1 },
        }
    }
}
