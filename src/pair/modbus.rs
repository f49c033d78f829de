//! The master's end of Modbus TCP, as far as the gripper needs it: requests to bytes, bytes to answers.
//!
//! The daemon uses a library for this; the closed loop has no sockets that the library could use.

use cell_machine::device::gripper_types::{ModbusRequest, UNIT};
use ur_wire::modbus::Splitter;

/// One connection's transactions.
#[derive(Default)]
pub struct Master {
    transaction: u16,
    splitter: Splitter,
}

/// What has come back.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Not all of it yet.
    Incomplete,
    /// The registers read; nothing for a write.
    Words(Vec<u16>),
    /// The device refuses.
    Exception(u8),
    /// No answer to this request.
    Wrong(String),
}

impl Master {
    /// The bytes of a request.
    pub fn request(&mut self, request: &ModbusRequest) -> Vec<u8> {
        self.transaction = self.transaction.wrapping_add(1);
        let mut pdu = Vec::new();
        match request {
            ModbusRequest::Read { address, count } => {
                pdu.push(3);
                pdu.extend(address.to_be_bytes());
                pdu.extend(count.to_be_bytes());
            }
            ModbusRequest::Write { address, values } => {
                pdu.push(16);
                pdu.extend(address.to_be_bytes());
                pdu.extend((values.len() as u16).to_be_bytes());
                pdu.push(2 * values.len() as u8);
                pdu.extend(values.iter().flat_map(|value| value.to_be_bytes()));
            }
        }
        let mut bytes = self.transaction.to_be_bytes().to_vec();
        bytes.extend([0, 0]);
        bytes.extend((pdu.len() as u16 + 1).to_be_bytes());
        bytes.push(UNIT);
        bytes.extend(pdu);
        bytes
    }

    /// Bytes that came in while `request` was under way.
    pub fn received(&mut self, request: &ModbusRequest, bytes: &[u8]) -> Answer {
        self.splitter.push(bytes);
        let adu = match self.splitter.next_adu() {
            Ok(Some(adu)) => adu,
            Ok(None) => return Answer::Incomplete,
            Err(error) => return Answer::Wrong(error.to_string()),
        };
        if adu.transaction != self.transaction {
            return Answer::Wrong(format!("transaction {} instead of {}", adu.transaction, self.transaction));
        }
        match (request, adu.pdu.as_slice()) {
            (_, [function, code, ..]) if *function >= 0x80 => Answer::Exception(*code),
            (ModbusRequest::Read { .. }, [3, _, data @ ..]) => {
                let words = data.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]));
                Answer::Words(words.collect())
            }
            (ModbusRequest::Write { .. }, [16, ..]) => Answer::Words(Vec::new()),
            (_, other) => Answer::Wrong(format!("function {:?}", other.first())),
        }
    }
}
