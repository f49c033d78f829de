//! The smaller sub-packages of a robot state: force mode (7), additional information (8), the tool's serial
//! line (11) and outputs (12).
//!
//! In: the fields behind a sub-package's header. Out: values, and bytes again. Apart from `primary_state`
//! because no client of celld reads them; they are there for other people's clients. Source: the vendor's
//! client-interface guide.

use crate::bytes::{Reader, WireError, Writer};

/// Sub-package 7.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ForceModeData {
    /// Force and torque at the TCP, N and Nm.
    pub wrench: [f64; 6],
    /// Dexterity: how far the arm is from a singularity.
    pub dexterity: f64,
}

/// Sub-package 8.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AdditionalData {
    /// State of the freedrive button on the pendant.
    pub teach_button: u8,
    /// The button may be used.
    pub freedrive_enabled: bool,
    /// Freedrive by a digital input.
    pub freedrive_by_input: bool,
    /// Not used.
    pub reserved: u8,
}

/// Sub-package 11: the serial line in the tool connector.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ToolCommunicationData {
    /// Switched on.
    pub enabled: bool,
    /// Baud.
    pub baud_rate: i32,
    /// 0 none, 1 odd, 2 even.
    pub parity: i32,
    /// 1 or 2.
    pub stop_bits: i32,
    /// Idle characters before receiving.
    pub rx_idle_chars: f32,
    /// Idle characters before sending.
    pub tx_idle_chars: f32,
}

/// Sub-package 12.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ToolModeData {
    /// 0 digital outputs, 1 power.
    pub output_mode: u8,
    /// Modes of the two digital outputs: 1 sinking, 2 sourcing, 3 push and pull.
    pub digital_output_mode: [u8; 2],
}

impl ForceModeData {
    pub(crate) fn encode(&self, out: &mut Writer) {
        out.f64s(&self.wrench).f64(self.dexterity);
    }

    pub(crate) fn decode(reader: &mut Reader) -> Result<ForceModeData, WireError> {
        Ok(ForceModeData {
            wrench: reader.array(|r| r.f64("force mode wrench"))?,
            dexterity: reader.f64("robot dexterity")?,
        })
    }
}

impl AdditionalData {
    pub(crate) fn encode(&self, out: &mut Writer) {
        out.u8(self.teach_button)
            .bool(self.freedrive_enabled)
            .bool(self.freedrive_by_input)
            .u8(self.reserved);
    }

    pub(crate) fn decode(reader: &mut Reader) -> Result<AdditionalData, WireError> {
        Ok(AdditionalData {
            teach_button: reader.u8("freedrive button")?,
            freedrive_enabled: reader.bool("freedrive button enabled")?,
            freedrive_by_input: reader.bool("freedrive by input")?,
            reserved: if reader.left() > 0 { reader.u8("reserved")? } else { 0 },
        })
    }
}

impl ToolCommunicationData {
    pub(crate) fn encode(&self, out: &mut Writer) {
        out.bool(self.enabled).i32(self.baud_rate).i32(self.parity).i32(self.stop_bits);
        out.f32(self.rx_idle_chars).f32(self.tx_idle_chars);
    }

    pub(crate) fn decode(reader: &mut Reader) -> Result<ToolCommunicationData, WireError> {
        Ok(ToolCommunicationData {
            enabled: reader.bool("tool communication enabled")?,
            baud_rate: reader.i32("baud rate")?,
            parity: reader.i32("parity")?,
            stop_bits: reader.i32("stop bits")?,
            rx_idle_chars: reader.f32("rx idle characters")?,
            tx_idle_chars: reader.f32("tx idle characters")?,
        })
    }
}

impl ToolModeData {
    pub(crate) fn encode(&self, out: &mut Writer) {
        out.u8(self.output_mode).bytes(&self.digital_output_mode);
    }

    pub(crate) fn decode(reader: &mut Reader) -> Result<ToolModeData, WireError> {
        Ok(ToolModeData {
            output_mode: reader.u8("tool output mode")?,
            digital_output_mode: reader.array(|r| r.u8("tool digital output mode"))?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primary_state::SubPackage;

    #[track_caller]
    fn check(part: SubPackage, bytes: usize) {
        let encoded = part.encode();
        assert_eq!(encoded.len(), bytes, "{part:?}");
        assert_eq!(SubPackage::decode_all(&encoded), Ok(vec![part]));
    }

    #[test]
    fn sub_packages_have_their_documented_lengths() {
        check(SubPackage::ForceMode(ForceModeData { wrench: [1.0; 6], dexterity: 0.5 }), 61);
        let additional = AdditionalData { freedrive_enabled: true, ..AdditionalData::default() };
        check(SubPackage::Additional(additional), 9);
        let line = ToolCommunicationData { enabled: true, baud_rate: 115_200, ..Default::default() };
        check(SubPackage::ToolCommunication(line), 26);
        check(SubPackage::ToolMode(ToolModeData { output_mode: 1, digital_output_mode: [2, 3] }), 8);
    }
}
