//! Modbus RTU as a device on a serial line receives and answers it: frames with a checksum and no length.
//!
//! In: the bytes that are on the line. Out: requests as [`Adu`]s, and the bytes of answers. A frame is as
//! long as its function says; where that is not known, it goes to the end of what is there, as a device
//! takes it that waits for silence. What has a wrong checksum is dropped to the same end. Source: Modbus
//! over serial line 1.02.

use crate::modbus::{Adu, Exception};

/// Bytes of the longest frame.
const LONGEST: usize = 256;

/// Bytes of the shortest: unit, function, checksum.
const SHORTEST: usize = 4;

/// The checksum of a frame, low byte first on the wire.
pub fn checksum(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xffff, |sum, byte| {
        (0..8).fold(sum ^ u16::from(*byte), |sum, _| if sum & 1 == 1 { sum >> 1 ^ 0xa001 } else { sum >> 1 })
    })
}

/// What is on the line and belongs to no whole frame yet.
#[derive(Clone, Debug, Default)]
pub struct SerialLine(Vec<u8>);

impl SerialLine {
    /// Appends what arrived; then call [`SerialLine::next_request`] until it gives `None`.
    pub fn push(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }

    /// The line was silent: what is there is no frame.
    pub fn silence(&mut self) {
        self.0.clear();
    }

    /// The next whole request with a right checksum; its transaction is 0.
    pub fn next_request(&mut self) -> Option<Adu> {
        let [unit, function, ..] = *self.0 else { return None };
        let length = match function {
            0x01..=0x06 => 8,
            0x0f | 0x10 => 9 + usize::from(*self.0.get(6)?),
            _ => self.0.len().max(SHORTEST),
        };
        if length <= LONGEST && self.0.len() < length {
            return None;
        }
        let frame = self.0.get(..length).and_then(|frame| frame.split_last_chunk::<2>());
        let sound = frame.filter(|(body, sum)| checksum(body).to_le_bytes() == **sum);
        let pdu = sound.and_then(|(body, _)| body.get(1..)).map(<[u8]>::to_vec);
        match pdu {
            Some(pdu) => {
                self.0.drain(..length);
                Some(Adu { transaction: 0, unit, pdu })
            }
            None => {
                self.silence();
                None
            }
        }
    }
}

/// The bytes of an answer: function code and `data`, or an exception.
pub fn answer(request: &Adu, data: Result<Vec<u8>, Exception>) -> Vec<u8> {
    // Behind transaction, protocol and length the two kinds of Modbus are the same.
    let tcp = request.answer(data);
    let mut frame = tcp.get(6..).unwrap_or_default().to_vec();
    let sum = checksum(&frame).to_le_bytes();
    frame.extend(sum);
    frame
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The example of the specification's appendix: reading a device's status, checksum 41 12.
    #[test]
    fn the_checksum_is_that_of_the_specification() {
        assert_eq!(checksum(&[0x02, 0x07]).to_le_bytes(), [0x41, 0x12]);
    }

    fn framed(body: &[u8]) -> Vec<u8> {
        [body, &checksum(body).to_le_bytes()].concat()
    }

    #[test]
    fn requests_come_out_however_they_are_cut() {
        let read = framed(&[65, 3, 1, 2, 0, 2]);
        let write = framed(&[65, 16, 0, 0, 0, 2, 4, 1, 60, 1, 60]);
        let bytes = [&read[..], &write].concat();
        for cut in 0..bytes.len() {
            let mut line = SerialLine::default();
            let mut seen = Vec::new();
            for part in [&bytes[..cut], &bytes[cut..]] {
                line.push(part);
                seen.extend(std::iter::from_fn(|| line.next_request()));
            }
            let pdus: Vec<_> = seen.iter().map(|adu| adu.pdu.len()).collect();
            assert_eq!(pdus, [5, 10], "cut at {cut}");
            assert!(seen.iter().all(|adu| adu.unit == 65));
        }
    }

    #[test]
    fn what_has_a_wrong_checksum_is_dropped_and_the_next_frame_is_read() {
        let mut line = SerialLine::default();
        let mut wrong = framed(&[65, 3, 1, 2, 0, 2]);
        wrong[2] ^= 1;
        line.push(&wrong);
        assert_eq!(line.next_request(), None);
        line.push(&framed(&[65, 0x2b]));
        assert_eq!(line.next_request(), Some(Adu { transaction: 0, unit: 65, pdu: vec![0x2b] }));
        line.push(&[65, 3, 0]);
        assert_eq!(line.next_request(), None);
        line.silence();
        line.push(&framed(&[66, 6, 0, 0, 0, 1]));
        assert_eq!(line.next_request().map(|adu| adu.unit), Some(66));
    }

    #[test]
    fn answers_have_a_checksum_in_place_of_the_header() {
        let request = Adu { transaction: 0, unit: 65, pdu: vec![3, 1, 2, 0, 1] };
        assert_eq!(answer(&request, Ok(vec![2, 0, 7])), framed(&[65, 3, 2, 0, 7]));
        assert_eq!(answer(&request, Err(Exception::IllegalAddress)), framed(&[65, 0x83, 2]));
    }

    proptest! {
        #[test]
        fn foreign_bytes_never_panic_and_are_not_kept(
            pieces in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..300), 0..6)
        ) {
            let mut line = SerialLine::default();
            for piece in pieces {
                line.push(&piece);
                while line.next_request().is_some() {}
                prop_assert!(line.0.len() <= LONGEST);
            }
        }
    }
}
