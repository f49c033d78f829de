//! Primary and secondary client interface (TCP 30001, 30002): packages of robot state and of messages.
//!
//! In: bytes of the stream a controller sends at 10 Hz and on events. Out: [`Package`]s, and bytes again.
//! What a client sends on these ports is program text, which needs no codec. Source: the vendor's
//! client-interface guide (reference on UR interfaces, 3.2 to 3.4).

use crate::bytes::{Pending, WireError, Writer};
use crate::primary_message::Message;
use crate::primary_state::SubPackage;
use serde::{Deserialize, Serialize};

/// Bytes of a package header: `i32` length of the whole package, `u8` type.
pub const HEADER: usize = 5;

/// Longest package accepted. Real ones are below 2 KiB; a bound is needed because the length field has 31
/// bits.
pub const MAX_PACKAGE: usize = 64 * 1024;

const ROBOT_STATE: u8 = 16;
const ROBOT_MESSAGE: u8 = 20;

/// A package of the stream.
#[derive(Clone, Debug, PartialEq)]
pub enum Package {
    /// Type 16: sub-packages in the order they came.
    RobotState(Vec<SubPackage>),
    /// Type 20.
    Message(Message),
    /// Any other type (safety set-up broadcast, program state, ...), which need not be read here.
    Other {
        /// Type byte.
        kind: u8,
        /// What follows the header.
        payload: Vec<u8>,
    },
}

impl Package {
    /// Header and payload.
    pub fn encode(&self) -> Vec<u8> {
        let (kind, payload) = match self {
            Package::RobotState(parts) => (ROBOT_STATE, parts.iter().flat_map(SubPackage::encode).collect()),
            Package::Message(message) => (ROBOT_MESSAGE, message.encode()),
            Package::Other { kind, payload } => (*kind, payload.clone()),
        };
        let mut out = Writer::new();
        out.i32((payload.len() + HEADER) as i32).u8(kind).bytes(&payload);
        out.finish()
    }

    /// Reads what follows the header.
    ///
    /// # Errors
    /// A robot state or a message ends inside a field, or a field holds a value that it cannot hold. Other
    /// types never fail.
    pub fn decode(kind: u8, payload: &[u8]) -> Result<Package, WireError> {
        Ok(match kind {
            ROBOT_STATE => Package::RobotState(SubPackage::decode_all(payload)?),
            ROBOT_MESSAGE => Package::Message(Message::decode(payload)?),
            kind => Package::Other { kind, payload: payload.to_vec() },
        })
    }
}

/// Splits a byte stream into packages. Holds at most one unfinished package besides what was pushed.
#[derive(Default, Deserialize, Serialize)]
pub struct Splitter(Pending);

impl Splitter {
    /// Appends what arrived; then call [`Splitter::next_package`] until it gives `None`.
    pub fn push(&mut self, bytes: &[u8]) {
        self.0.push(bytes);
    }

    /// The next whole package. After an error inside a package the next call goes on behind it; after an
    /// error in a length the stream cannot be trusted any more and what waits is dropped.
    ///
    /// # Errors
    /// The length is impossible ([`WireError::Length`]), or [`Package::decode`] fails.
    pub fn next_package(&mut self) -> Result<Option<Package>, WireError> {
        let [a, b, c, d, kind, ..] = *self.0.waiting() else { return Ok(None) };
        let length = i32::from_be_bytes([a, b, c, d]);
        let size = usize::try_from(length).ok().filter(|size| (HEADER..=MAX_PACKAGE).contains(size));
        let Some(size) = size else {
            self.0.clear();
            return Err(WireError::Length { found: i64::from(length), min: HEADER, max: MAX_PACKAGE });
        };
        match self.0.take(size).and_then(|package| package.get(HEADER..)) {
            Some(payload) => Package::decode(kind, payload).map(Some),
            None => Ok(None),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primary_message::{MessageBody, PROGRAM_STARTED};
    use crate::primary_state::tests::{all_kinds, kinematics};
    use proptest::prelude::*;

    fn stream() -> (Vec<Package>, Vec<u8>) {
        let key = MessageBody::Key { code: 0, argument: 0, title: PROGRAM_STARTED.into(), text: "p".into() };
        let packages = vec![
            Package::RobotState(all_kinds()),
            Package::Message(Message { timestamp: 7, source: -2, body: key }),
            Package::Other { kind: 25, payload: vec![1, 2, 3] },
            Package::RobotState(vec![SubPackage::Kinematics(kinematics())]),
        ];
        let bytes = packages.iter().flat_map(Package::encode).collect();
        (packages, bytes)
    }

    #[test]
    fn packages_come_out_whole_however_they_are_cut() {
        let (packages, bytes) = stream();
        for cut in 1..bytes.len() {
            let mut splitter = Splitter::default();
            let mut seen = Vec::new();
            for part in [&bytes[..cut], &bytes[cut..]] {
                splitter.push(part);
                while let Some(package) = splitter.next_package().unwrap() {
                    seen.push(package);
                }
            }
            assert_eq!(seen, packages, "cut at {cut}");
        }
    }

    #[test]
    fn impossible_lengths_end_the_stream() {
        for length in [-1, 0, 4, MAX_PACKAGE as i32 + 1, i32::MAX] {
            let mut splitter = Splitter::default();
            splitter.push(&length.to_be_bytes());
            splitter.push(&[16, 0, 0]);
            assert!(matches!(splitter.next_package(), Err(WireError::Length { .. })), "{length}");
            assert_eq!(splitter.next_package(), Ok(None));
        }
    }

    #[test]
    fn a_bad_package_does_not_take_the_next_one_with_it() {
        let mut splitter = Splitter::default();
        splitter.push(&[0, 0, 0, 6, 20, 1]);
        let next = Package::Other { kind: 5, payload: vec![] };
        splitter.push(&next.encode());
        assert!(splitter.next_package().is_err());
        assert_eq!(splitter.next_package(), Ok(Some(next)));
    }

    proptest! {
        #[test]
        fn foreign_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400), kind in any::<u8>()) {
            let _ = Package::decode(kind, &bytes);
            let _ = Package::decode(ROBOT_STATE, &bytes);
            let _ = Package::decode(ROBOT_MESSAGE, &bytes);
        }

        #[test]
        fn damaged_packages_never_panic(at in any::<prop::sample::Index>(), byte in any::<u8>(), cut in any::<prop::sample::Index>()) {
            let (_, mut bytes) = stream();
            let length = bytes.len();
            bytes[at.index(length)] = byte;
            bytes.truncate(cut.index(length));
            let mut splitter = Splitter::default();
            splitter.push(&bytes);
            // Every call consumes a package, drops everything, or needs more: at most one per 5 bytes.
            for _ in 0..length {
                if splitter.next_package() == Ok(None) { break; }
            }
            prop_assert!(splitter.next_package() == Ok(None) || splitter.next_package().is_err());
        }
    }
}
