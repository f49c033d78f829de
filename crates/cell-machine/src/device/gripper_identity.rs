//! Which gripper answers: product code, firmware and serial number, read one after another.
//!
//! In: answers. Out: requests, and the [`Identity`] once all are answered. A missing register gives an
//! exception and leaves its part empty. So does a device that is silent twice: it can still grip.

use crate::device::gripper_types::{
    FIRMWARE, Identity, ModbusFailure, ModbusRequest, PRODUCT, SERIAL, SERIAL_COUNT,
};
use serde::{Deserialize, Serialize};

/// Tries for each part.
const TRIES: u32 = 2;

/// Modbus exceptions of a register that is not there: illegal function, address or value.
pub const MISSING: [u8; 3] = [1, 2, 3];

/// A part of the identity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
enum Part {
    Product,
    Firmware,
    Serial,
}

impl Part {
    fn request(self) -> ModbusRequest {
        let (address, count) = match self {
            Part::Product => (PRODUCT, 1),
            Part::Firmware => (FIRMWARE, 2),
            Part::Serial => (SERIAL, SERIAL_COUNT),
        };
        ModbusRequest::Read { address, count }
    }

    fn next(self) -> Option<Part> {
        match self {
            Part::Product => Some(Part::Firmware),
            Part::Firmware => Some(Part::Serial),
            Part::Serial => None,
        }
    }
}

/// How far it is. See the module.
#[derive(Clone, Copy, Debug, Deserialize, Serialize)]
pub struct Identification {
    /// Which one is read; `None` once all were.
    part: Option<Part>,
    tries: u32,
    /// The last request was met with silence.
    silenced: bool,
    identity: Identity,
}

impl Default for Identification {
    fn default() -> Identification {
        Identification { part: Some(Part::Product), tries: 0, silenced: false, identity: Identity::default() }
    }
}

impl Identification {
    /// The device answers again: it may be another one. If it fell silent at one of these requests, the next
    /// one follows, so that this ends.
    pub fn begin(&mut self) {
        if !std::mem::take(&mut self.silenced) {
            *self = Identification::default();
        }
    }

    /// The device answers something else: silence from now on has another cause than these requests.
    pub fn spoke(&mut self) {
        self.silenced = false;
    }

    /// The next request; `None` once all were read or given up.
    pub fn request(&self) -> Option<ModbusRequest> {
        self.part.map(Part::request)
    }

    /// True for the request under way.
    pub fn concerns(&self, request: &ModbusRequest) -> bool {
        self.part.is_some_and(|part| part.request() == *request)
    }

    /// The answer to the request under way.
    pub fn response(&mut self, answer: Result<Vec<u16>, ModbusFailure>) {
        let Some(part) = self.part else { return };
        self.silenced = matches!(answer, Err(ModbusFailure::Timeout));
        match answer {
            Ok(words) => self.take(part, &words),
            Err(ModbusFailure::Exception(code)) if MISSING.contains(&code) => {}
            Err(ModbusFailure::Timeout | ModbusFailure::Malformed(_)) => {
                self.tries += 1;
                if self.tries < TRIES {
                    return;
                }
            }
            // These say nothing about the register.
            Err(ModbusFailure::Exception(_) | ModbusFailure::Connection(_)) => return,
            Err(ModbusFailure::Taken | ModbusFailure::Refused | ModbusFailure::Unserved) => return,
        }
        (self.part, self.tries) = (part.next(), 0);
    }

    /// The identity, once all parts were read or given up.
    pub fn identity(&self) -> Option<Identity> {
        self.part.is_none().then_some(self.identity)
    }

    fn take(&mut self, part: Part, words: &[u16]) {
        match part {
            Part::Product => self.identity.product = words.first().copied(),
            Part::Firmware => self.identity.firmware = words.try_into().ok(),
            Part::Serial => self.identity.serial = words.try_into().ok(),
        }
    }
}
