//! States of the robot, out of everything else that comes over RTDE.
//!
//! In: bytes as they come. Out: the controller's time in each state, as bits: enough to know one again.

/// Length of a package's header: two bytes of length, one of kind.
const HEADER: usize = 3;

/// The controller's time is the first field of a state, behind the recipe's number.
const TIME: std::ops::Range<usize> = 4..12;

/// Bytes of a package that is not complete.
#[derive(Debug, Default)]
pub(super) struct States(Vec<u8>);

impl States {
    /// A new connection.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// The times of the states that are complete with these bytes.
    pub fn take(&mut self, bytes: &[u8]) -> Vec<u64> {
        self.0.extend(bytes);
        let mut times = Vec::new();
        while let [high, low, kind, ..] = *self.0 {
            let length = usize::from(u16::from_be_bytes([high, low])).max(HEADER);
            if self.0.len() < length {
                break;
            }
            let time = self.0.get(TIME).filter(|_| length >= TIME.end).and_then(|time| time.try_into().ok());
            times.extend(time.filter(|_| kind == b'U').map(u64::from_be_bytes));
            self.0.drain(..length);
        }
        times
    }
}
