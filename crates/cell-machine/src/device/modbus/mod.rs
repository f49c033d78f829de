//! Modbus TCP as a client speaks it: requests to bytes, bytes to answers. `master`: the connection under it.
//!
//! In: a [`ModbusRequest`] and its transaction number; bytes in any pieces. Out: the request's bytes;
//! [`Answer`]s. Functions 3 (read holding registers) and 16 (write registers). The simulated gripper reads
//! and writes these bytes with other code, so that a misreading does not meet itself. Source: Modbus
//! application protocol 1.1b3 and its TCP guide.

pub mod master;

use crate::device::gripper_types::{ModbusFailure, ModbusRequest};

const READ: u8 = 3;
const WRITE: u8 = 16;
/// Added to the function of a request that is refused.
const EXCEPTION: u8 = 0x80;
/// Transaction, protocol and length, two bytes each.
const PREFIX: usize = 6;
/// Shortest and longest length: unit, function and up to 252 bytes of data.
const LENGTHS: std::ops::RangeInclusive<usize> = 2..=254;

/// The bytes of a request to a unit.
pub fn request_bytes(transaction: u16, unit: u8, request: &ModbusRequest) -> Vec<u8> {
    let mut body = vec![unit];
    match request {
        ModbusRequest::Read { address, count } => {
            body.push(READ);
            body.extend(address.to_be_bytes());
            body.extend(count.to_be_bytes());
        }
        ModbusRequest::Write { address, values } => {
            body.push(WRITE);
            body.extend(address.to_be_bytes());
            body.extend((values.len() as u16).to_be_bytes());
            body.push(2 * values.len() as u8);
            body.extend(values.iter().flat_map(|value| value.to_be_bytes()));
        }
    }
    let mut bytes = transaction.to_be_bytes().to_vec();
    bytes.extend([0, 0]);
    bytes.extend((body.len() as u16).to_be_bytes());
    bytes.extend(body);
    bytes
}

/// What a device has answered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// The number of the request.
    pub transaction: u16,
    /// Function and data.
    pdu: Vec<u8>,
}

impl Answer {
    /// The registers that were read; nothing after a write.
    ///
    /// # Errors
    /// The device refuses the request, or this answers another one.
    pub fn words(&self, request: &ModbusRequest) -> Result<Vec<u16>, ModbusFailure> {
        let function = match request {
            ModbusRequest::Read { .. } => READ,
            ModbusRequest::Write { .. } => WRITE,
        };
        match (self.pdu.as_slice(), request) {
            (&[code, exception], _) if code == function | EXCEPTION => {
                Err(ModbusFailure::Exception(exception))
            }
            (&[READ, size, ref data @ ..], ModbusRequest::Read { count, .. })
                if usize::from(size) == data.len() && data.len() == 2 * usize::from(*count) =>
            {
                let (pairs, _) = data.as_chunks::<2>();
                Ok(pairs.iter().map(|pair| u16::from_be_bytes(*pair)).collect())
            }
            (&[WRITE, a1, a0, n1, n0], ModbusRequest::Write { address, values })
                if u16::from_be_bytes([a1, a0]) == *address
                    && usize::from(u16::from_be_bytes([n1, n0])) == values.len() =>
            {
                Ok(Vec::new())
            }
            (pdu, _) => Err(ModbusFailure::Malformed(format!(
                "{} bytes with function {} for a request of function {function}",
                pdu.len(),
                pdu.first().copied().unwrap_or(0)
            ))),
        }
    }
}

/// Divides what a device sends into answers.
#[derive(Debug, Default)]
pub struct Answers(Vec<u8>);

impl Answers {
    /// Takes in what has arrived; then call [`Answers::next_answer`] until it gives `None`.
    pub fn push(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }

    /// The next whole answer.
    ///
    /// # Errors
    /// What has arrived is no Modbus TCP; nothing that follows can be read.
    pub fn next_answer(&mut self) -> Result<Option<Answer>, ModbusFailure> {
        let &[t1, t0, p1, p0, l1, l0, ..] = self.0.as_slice() else { return Ok(None) };
        let length = usize::from(u16::from_be_bytes([l1, l0]));
        if [p1, p0] != [0, 0] || !LENGTHS.contains(&length) {
            self.0.clear();
            let found = format!("protocol {}, length {length}", u16::from_be_bytes([p1, p0]));
            return Err(ModbusFailure::Malformed(found));
        }
        if self.0.len() < PREFIX + length {
            return Ok(None);
        }
        let pdu = self.0.drain(..PREFIX + length).skip(PREFIX + 1).collect();
        Ok(Some(Answer { transaction: u16::from_be_bytes([t1, t0]), pdu }))
    }
}

#[cfg(test)]
mod tests {
    //! A failure of a golden string here means the wire changed.
    use super::*;
    use proptest::prelude::*;

    const READING: ModbusRequest = ModbusRequest::Read { address: 258, count: 2 };

    fn writing() -> ModbusRequest {
        ModbusRequest::Write { address: 0, values: vec![0x013c, 0x0200] }
    }

    fn answers(bytes: &[u8]) -> Vec<Answer> {
        let mut answers = Answers::default();
        answers.push(bytes);
        std::iter::from_fn(|| answers.next_answer().unwrap()).collect()
    }

    #[test]
    fn golden_requests() {
        let golden = [0x12, 0x34, 0, 0, 0, 6, 65, 3, 1, 2, 0, 2];
        assert_eq!(request_bytes(0x1234, 65, &READING), golden, "the wire changed");
        let golden = [0, 7, 0, 0, 0, 11, 66, 16, 0, 0, 0, 2, 4, 1, 0x3c, 2, 0];
        assert_eq!(request_bytes(7, 66, &writing()), golden, "the wire changed");
    }

    #[test]
    fn an_answer_has_the_registers_that_were_requested() {
        let bytes = [0x12, 0x34, 0, 0, 0, 7, 65, 3, 4, 2, 0x58, 0, 9, 0, 1, 0, 0, 0, 6, 65, 16, 0, 0, 0, 2];
        for cut in 0..bytes.len() {
            let mut answers = Answers::default();
            let mut seen = Vec::new();
            for part in [&bytes[..cut], &bytes[cut..]] {
                answers.push(part);
                seen.extend(std::iter::from_fn(|| answers.next_answer().unwrap()));
            }
            let [first, second] = &seen[..] else { panic!("{seen:?}") };
            assert_eq!((first.transaction, first.words(&READING)), (0x1234, Ok(vec![600, 9])));
            assert_eq!((second.transaction, second.words(&writing())), (1, Ok(Vec::new())));
            assert!(first.words(&writing()).is_err() && second.words(&READING).is_err());
        }
    }

    #[test]
    fn an_exception_and_an_answer_of_another_size_are_failures() {
        let refused = &answers(&[0, 1, 0, 0, 0, 3, 65, 0x83, 2])[0];
        assert_eq!(refused.words(&READING), Err(ModbusFailure::Exception(2)));
        assert!(matches!(refused.words(&writing()), Err(ModbusFailure::Malformed(_))));
        for wrong in [
            &[0, 1, 0, 0, 0, 5, 65, 3, 2, 0, 1][..],
            &[0, 1, 0, 0, 0, 7, 65, 3, 2, 0, 1, 0, 1],
            &[0, 1, 0, 0, 0, 2, 65, 3],
            &[0, 1, 0, 0, 0, 7, 65, 4, 4, 0, 1, 0, 1],
        ] {
            let words = answers(wrong)[0].words(&READING);
            assert!(matches!(words, Err(ModbusFailure::Malformed(_))), "{wrong:?}: {words:?}");
        }
        let elsewhere = &answers(&[0, 1, 0, 0, 0, 6, 65, 16, 0, 1, 0, 2])[0];
        assert!(elsewhere.words(&writing()).is_err());
    }

    #[test]
    fn another_protocol_ends_the_stream() {
        for bytes in [[0, 1, 0, 1, 0, 6, 65], [0, 1, 0, 0, 0, 1, 65], [0, 1, 0, 0, 0, 255, 65]] {
            let mut answers = Answers::default();
            answers.push(&bytes);
            assert!(answers.next_answer().is_err());
            assert_eq!(answers.next_answer(), Ok(None));
        }
    }

    proptest! {
        #[test]
        fn foreign_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let mut answers = Answers::default();
            answers.push(&bytes);
            while let Ok(Some(answer)) = answers.next_answer() {
                let _ = (answer.words(&READING), answer.words(&writing()));
            }
        }
    }
}
