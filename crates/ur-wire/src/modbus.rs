//! Modbus TCP as a server receives and answers it: framing, the functions on registers and coils,
//! exceptions.
//!
//! In: bytes of a master's stream. Out: [`Adu`]s and the [`Function`] in each, and the bytes of answers. The
//! daemon's master uses a library; this end is ours, so that a misreading does not meet itself, and so that
//! an answer can be wrong on purpose. Source: the Modbus application protocol 1.1b3 and its TCP guide.

use crate::bytes::{Pending, Reader, WireError, Writer};

/// Bytes of the header: transaction, protocol, length, unit.
const HEADER: usize = 7;

/// Shortest and longest value of the length field: unit, function code and up to 252 bytes of data.
const LENGTHS: std::ops::RangeInclusive<usize> = 2..=254;

/// Most registers read, and written, in one request.
const MOST_READ: u16 = 125;
const MOST_WRITTEN: u16 = 123;

/// The same for coils.
const MOST_COILS_READ: u16 = 2000;
const MOST_COILS_WRITTEN: u16 = 1968;

/// One request as framed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Adu {
    /// The answer has the same number.
    pub transaction: u16,
    /// Which device behind the address.
    pub unit: u8,
    /// Function code and data.
    pub pdu: Vec<u8>,
}

/// Why a request is not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exception {
    /// 1.
    IllegalFunction,
    /// 2.
    IllegalAddress,
    /// 3.
    IllegalValue,
    /// 4.
    DeviceFailure,
    /// 6.
    DeviceBusy,
    /// 11: no device with this unit number.
    NoTarget,
}

impl Exception {
    /// The number on the wire.
    pub fn code(self) -> u8 {
        match self {
            Exception::IllegalFunction => 1,
            Exception::IllegalAddress => 2,
            Exception::IllegalValue => 3,
            Exception::DeviceFailure => 4,
            Exception::DeviceBusy => 6,
            Exception::NoTarget => 11,
        }
    }

    /// The exception of a number; `None` for one that is not listed here.
    pub fn from_code(code: u8) -> Option<Exception> {
        use Exception::{DeviceBusy, DeviceFailure, IllegalAddress, IllegalFunction, IllegalValue, NoTarget};
        [IllegalFunction, IllegalAddress, IllegalValue, DeviceFailure, DeviceBusy, NoTarget]
            .into_iter()
            .find(|exception| exception.code() == code)
    }
}

/// The function that a request names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Function {
    /// 0x03: 1 to 125 holding registers from `first` on.
    Read {
        /// Address of the first.
        first: u16,
        /// How many.
        count: u16,
    },
    /// 0x04: the same of input registers.
    ReadInputs {
        /// Address of the first.
        first: u16,
        /// How many.
        count: u16,
    },
    /// 0x01 and 0x02: 1 to 2000 coils or discrete inputs from `first` on.
    ReadCoils {
        /// Address of the first.
        first: u16,
        /// How many.
        count: u16,
    },
    /// 0x05.
    WriteCoil {
        /// Address.
        first: u16,
        /// New value.
        on: bool,
    },
    /// 0x0F: 1 to 1968 coils from `first` on.
    WriteCoils {
        /// Address of the first.
        first: u16,
        /// New values.
        values: Vec<bool>,
    },
    /// 0x06.
    WriteOne {
        /// Address.
        first: u16,
        /// New value.
        value: u16,
    },
    /// 0x10: 1 to 123 holding registers from `first` on.
    WriteMany {
        /// Address of the first.
        first: u16,
        /// New values.
        values: Vec<u16>,
    },
}

/// Splits a byte stream into requests. Holds at most one unfinished request besides what was pushed.
#[derive(Debug, Default)]
pub struct Splitter(Pending);

impl Splitter {
    /// Appends what arrived; then call [`Splitter::next_adu`] until it gives `None`.
    pub fn push(&mut self, bytes: &[u8]) {
        self.0.push(bytes);
    }

    /// The next whole request.
    ///
    /// # Errors
    /// Another protocol than Modbus or an impossible length: the stream cannot be trusted any more, and what
    /// waits is dropped.
    pub fn next_adu(&mut self) -> Result<Option<Adu>, WireError> {
        let [t1, t0, p1, p0, l1, l0, unit, ..] = *self.0.waiting() else { return Ok(None) };
        let length = usize::from(u16::from_be_bytes([l1, l0]));
        if [p1, p0] != [0, 0] || !LENGTHS.contains(&length) {
            self.0.clear();
            let (min, max) = (*LENGTHS.start(), *LENGTHS.end());
            return Err(WireError::Length { found: length as i64, min, max });
        }
        let taken = self.0.take(HEADER - 1 + length).and_then(|adu| adu.get(HEADER..));
        let transaction = u16::from_be_bytes([t1, t0]);
        Ok(taken.map(|pdu| Adu { transaction, unit, pdu: pdu.to_vec() }))
    }
}

impl Adu {
    /// The function that the request names.
    ///
    /// # Errors
    /// The exception to answer with: a function that is not offered, or data that do not fit it.
    pub fn function(&self) -> Result<Function, Exception> {
        let mut reader = Reader::new(&self.pdu);
        let code = reader.u8("function code").map_err(|_| Exception::IllegalFunction)?;
        let function = match code {
            0x01 | 0x02 => read_coils(&mut reader),
            0x03 => read(&mut reader),
            0x04 => read_inputs(&mut reader),
            0x05 => write_coil(&mut reader),
            0x0f => write_coils(&mut reader),
            0x06 => write_one(&mut reader),
            0x10 => write_many(&mut reader),
            _ => return Err(Exception::IllegalFunction),
        };
        function.ok().flatten().filter(|_| reader.left() == 0).ok_or(Exception::IllegalValue)
    }

    /// The bytes of an answer: function code and `data`, or an exception.
    pub fn answer(&self, data: Result<Vec<u8>, Exception>) -> Vec<u8> {
        let code = self.pdu.first().copied().unwrap_or(0);
        let (code, data) = match data {
            Ok(data) => (code, data),
            Err(exception) => (code | 0x80, vec![exception.code()]),
        };
        let mut out = Writer::new();
        // What we answer is at most 251 bytes: 125 registers and their count.
        out.u16(self.transaction).u16(0).u16(data.len() as u16 + 2).u8(self.unit).u8(code).bytes(&data);
        out.finish()
    }
}

fn read(reader: &mut Reader) -> Result<Option<Function>, WireError> {
    let (first, count) = (reader.u16("address")?, reader.u16("quantity")?);
    Ok((1..=MOST_READ).contains(&count).then_some(Function::Read { first, count }))
}

fn read_inputs(reader: &mut Reader) -> Result<Option<Function>, WireError> {
    let (first, count) = (reader.u16("address")?, reader.u16("quantity")?);
    Ok((1..=MOST_READ).contains(&count).then_some(Function::ReadInputs { first, count }))
}

fn read_coils(reader: &mut Reader) -> Result<Option<Function>, WireError> {
    let (first, count) = (reader.u16("address")?, reader.u16("quantity")?);
    Ok((1..=MOST_COILS_READ).contains(&count).then_some(Function::ReadCoils { first, count }))
}

fn write_coil(reader: &mut Reader) -> Result<Option<Function>, WireError> {
    let (first, value) = (reader.u16("address")?, reader.u16("value")?);
    Ok(matches!(value, 0 | 0xff00).then_some(Function::WriteCoil { first, on: value != 0 }))
}

fn write_coils(reader: &mut Reader) -> Result<Option<Function>, WireError> {
    let (first, count) = (reader.u16("address")?, reader.u16("quantity")?);
    let bytes = reader.u8("byte count")?;
    if !(1..=MOST_COILS_WRITTEN).contains(&count) || u16::from(bytes) != count.div_ceil(8) {
        return Ok(None);
    }
    let bytes = (0..bytes).map(|_| reader.u8("coils")).collect::<Result<Vec<u8>, _>>()?;
    let bits = bytes.iter().flat_map(|byte| (0..8).map(move |bit| byte >> bit & 1 == 1));
    Ok(Some(Function::WriteCoils { first, values: bits.take(usize::from(count)).collect() }))
}

fn write_one(reader: &mut Reader) -> Result<Option<Function>, WireError> {
    Ok(Some(Function::WriteOne { first: reader.u16("address")?, value: reader.u16("value")? }))
}

fn write_many(reader: &mut Reader) -> Result<Option<Function>, WireError> {
    let (first, count) = (reader.u16("address")?, reader.u16("quantity")?);
    let bytes = reader.u8("byte count")?;
    if !(1..=MOST_WRITTEN).contains(&count) || u16::from(bytes) != 2 * count {
        return Ok(None);
    }
    let values = (0..count).map(|_| reader.u16("value")).collect::<Result<_, _>>()?;
    Ok(Some(Function::WriteMany { first, values }))
}

impl Function {
    /// Data of the answer to a write: what was requested, without the values of several.
    pub fn echo(&self) -> Vec<u8> {
        let mut out = Writer::new();
        match self {
            Function::Read { first, count }
            | Function::ReadInputs { first, count }
            | Function::ReadCoils { first, count } => out.u16(*first).u16(*count),
            Function::WriteCoil { first, on } => out.u16(*first).u16(if *on { 0xff00 } else { 0 }),
            Function::WriteCoils { first, values } => out.u16(*first).u16(values.len() as u16),
            Function::WriteOne { first, value } => out.u16(*first).u16(*value),
            Function::WriteMany { first, values } => out.u16(*first).u16(values.len() as u16),
        };
        out.finish()
    }
}

/// Data of the answer to a read.
pub fn register_bytes(values: &[u16]) -> Vec<u8> {
    let mut out = Writer::new();
    out.u8((values.len() * 2) as u8);
    values.iter().for_each(|value| {
        out.u16(*value);
    });
    out.finish()
}

/// Data of the answer to a read of coils.
pub fn coil_bytes(values: &[bool]) -> Vec<u8> {
    let mut out = Writer::new();
    let bytes = values
        .chunks(8)
        .map(|bits| bits.iter().enumerate().fold(0u8, |byte, (number, on)| byte | u8::from(*on) << number));
    out.u8(values.len().div_ceil(8) as u8).bytes(&bytes.collect::<Vec<u8>>());
    out.finish()
}

#[cfg(test)]
mod tests {
    //! A failure of a golden string here means the wire changed.
    use super::*;
    use proptest::prelude::*;

    fn adu(pdu: &[u8]) -> Adu {
        Adu { transaction: 0x1234, unit: 65, pdu: pdu.to_vec() }
    }

    #[test]
    fn requests_come_out_however_they_are_cut() {
        let bytes = [0x12, 0x34, 0, 0, 0, 6, 65, 3, 1, 2, 0, 2, 0, 1, 0, 0, 0, 2, 65, 7];
        for cut in 1..bytes.len() {
            let mut splitter = Splitter::default();
            let mut seen = Vec::new();
            for part in [&bytes[..cut], &bytes[cut..]] {
                splitter.push(part);
                while let Some(adu) = splitter.next_adu().unwrap() {
                    seen.push(adu);
                }
            }
            assert_eq!(seen, [adu(&[3, 1, 2, 0, 2]), Adu { transaction: 1, unit: 65, pdu: vec![7] }]);
        }
    }

    #[test]
    fn functions_and_what_does_not_fit_them() {
        assert_eq!(adu(&[3, 1, 2, 0, 2]).function(), Ok(Function::Read { first: 258, count: 2 }));
        assert_eq!(adu(&[6, 0, 2, 1, 0]).function(), Ok(Function::WriteOne { first: 2, value: 256 }));
        let many = Function::WriteMany { first: 0, values: vec![0x013c, 0x0200] };
        assert_eq!(adu(&[16, 0, 0, 0, 2, 4, 1, 0x3c, 2, 0]).function(), Ok(many));
        for bad in [&[3, 0, 0, 0, 0][..], &[3, 0, 0, 0, 126], &[3, 0, 0], &[6, 0, 2, 1, 0, 9]] {
            assert_eq!(adu(bad).function(), Err(Exception::IllegalValue), "{bad:?}");
        }
        for bad in [&[16, 0, 0, 0, 2, 5, 1, 0x3c, 2, 0][..], &[16, 0, 0, 0, 0, 0], &[16, 0, 0, 0, 2, 4, 1]] {
            assert_eq!(adu(bad).function(), Err(Exception::IllegalValue), "{bad:?}");
        }
        for code in [0, 7, 0x17, 0x83] {
            assert_eq!(adu(&[code]).function(), Err(Exception::IllegalFunction));
        }
        assert_eq!(adu(&[]).function(), Err(Exception::IllegalFunction));
    }

    #[test]
    fn coils_are_packed_from_the_lowest_bit() {
        assert_eq!(adu(&[1, 0, 16, 7, 208]).function(), Ok(Function::ReadCoils { first: 16, count: 2000 }));
        assert_eq!(adu(&[2, 0, 0, 0, 8]).function(), Ok(Function::ReadCoils { first: 0, count: 8 }));
        assert_eq!(adu(&[4, 1, 2, 0, 2]).function(), Ok(Function::ReadInputs { first: 258, count: 2 }));
        assert_eq!(adu(&[5, 0, 1, 0xff, 0]).function(), Ok(Function::WriteCoil { first: 1, on: true }));
        let bits = [true, false, true, false, false, false, false, false, false, true];
        let many = adu(&[15, 0, 19, 0, 10, 2, 0b101, 0b10]);
        assert_eq!(many.function(), Ok(Function::WriteCoils { first: 19, values: bits.to_vec() }));
        assert_eq!(many.function().unwrap().echo(), [0, 19, 0, 10]);
        assert_eq!(coil_bytes(&bits), [2, 0b101, 0b10]);
        for bad in
            [&[1, 0, 0, 7, 209][..], &[5, 0, 1, 0xff, 1], &[15, 0, 0, 0, 9, 1, 1], &[15, 0, 0, 0, 0, 0]]
        {
            assert_eq!(adu(bad).function(), Err(Exception::IllegalValue), "{bad:?}");
        }
    }

    #[test]
    fn golden_answers() {
        let read = adu(&[3, 1, 2, 0, 2]);
        let golden = [0x12, 0x34, 0, 0, 0, 7, 65, 3, 4, 2, 0x58, 0, 0];
        assert_eq!(read.answer(Ok(register_bytes(&[600, 0]))), golden, "the wire changed");
        let golden = [0x12, 0x34, 0, 0, 0, 3, 65, 0x83, 2];
        assert_eq!(read.answer(Err(Exception::IllegalAddress)), golden, "the wire changed");
        for code in [1, 2, 3, 4, 6, 11] {
            assert_eq!(Exception::from_code(code).map(Exception::code), Some(code));
        }
        assert_eq!(Exception::from_code(5), None);
    }

    #[test]
    fn another_protocol_ends_the_stream() {
        for bytes in [[0, 1, 0, 1, 0, 6, 65], [0, 1, 0, 0, 0, 1, 65], [0, 1, 0, 0, 0, 255, 65]] {
            let mut splitter = Splitter::default();
            splitter.push(&bytes);
            assert!(splitter.next_adu().is_err());
            assert_eq!(splitter.next_adu(), Ok(None));
        }
    }

    proptest! {
        #[test]
        fn foreign_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let request = adu(&bytes);
            let data = request.function().map(|function| function.echo());
            let _ = request.answer(data);
            let mut splitter = Splitter::default();
            splitter.push(&bytes);
            while let Ok(Some(_)) = splitter.next_adu() {}
        }
    }
}
