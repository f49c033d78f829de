//! The sub-package of a robot state about the masterboard (3): inputs and outputs, supply, safety mode.
//!
//! In: the fields behind the sub-package's header. Out: a value, and bytes again. Apart from `primary_state`
//! because it alone has fields in the middle that are there only sometimes: those of an injection moulding
//! interface. Source: the vendor's client-interface guide.

use crate::bytes::{Reader, WireError, Writer};

/// Optional part of sub-package 3.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EuromapData {
    /// Input bits.
    pub input_bits: u32,
    /// Output bits.
    pub output_bits: u32,
    /// 24 V rail, V.
    pub voltage_24v: f32,
    /// Current, A.
    pub current: f32,
}

/// Sub-package 3.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MasterboardData {
    /// Digital inputs.
    pub digital_input_bits: u32,
    /// Digital outputs.
    pub digital_output_bits: u32,
    /// Ranges of the analog inputs.
    pub analog_input_range: [u8; 2],
    /// Analog inputs, A or V.
    pub analog_input: [f64; 2],
    /// Domains of the analog outputs.
    pub analog_output_domain: [u8; 2],
    /// Analog outputs, A or V.
    pub analog_output: [f64; 2],
    /// Temperature.
    pub temperature: f32,
    /// 48 V rail, V.
    pub robot_voltage_48v: f32,
    /// Robot current, A.
    pub robot_current: f32,
    /// I/O current, A.
    pub io_current: f32,
    /// Number of the safety mode.
    pub safety_mode: u8,
    /// Reduced mode.
    pub reduced_mode: u8,
    /// Present if an injection moulding interface is installed.
    pub euromap: Option<EuromapData>,
    /// Not used.
    pub reserved: u32,
    /// Operational mode selector.
    pub operational_mode_selector: u8,
    /// Three-position enabling device.
    pub three_position_input: u8,
    /// Not used.
    pub reserved_end: u8,
}

impl MasterboardData {
    pub(crate) fn encode(&self, out: &mut Writer) {
        out.u32(self.digital_input_bits)
            .u32(self.digital_output_bits)
            .bytes(&self.analog_input_range)
            .f64s(&self.analog_input)
            .bytes(&self.analog_output_domain)
            .f64s(&self.analog_output)
            .f32(self.temperature)
            .f32(self.robot_voltage_48v)
            .f32(self.robot_current)
            .f32(self.io_current)
            .u8(self.safety_mode)
            .u8(self.reduced_mode)
            .bool(self.euromap.is_some());
        if let Some(euromap) = &self.euromap {
            out.u32(euromap.input_bits)
                .u32(euromap.output_bits)
                .f32(euromap.voltage_24v)
                .f32(euromap.current);
        }
        out.u32(self.reserved)
            .u8(self.operational_mode_selector)
            .u8(self.three_position_input)
            .u8(self.reserved_end);
    }

    pub(crate) fn decode(reader: &mut Reader) -> Result<MasterboardData, WireError> {
        Ok(MasterboardData {
            digital_input_bits: reader.u32("digital input bits")?,
            digital_output_bits: reader.u32("digital output bits")?,
            analog_input_range: reader.array(|r| r.u8("analog input range"))?,
            analog_input: reader.array(|r| r.f64("analog input"))?,
            analog_output_domain: reader.array(|r| r.u8("analog output domain"))?,
            analog_output: reader.array(|r| r.f64("analog output"))?,
            temperature: reader.f32("masterboard temperature")?,
            robot_voltage_48v: reader.f32("robot voltage")?,
            robot_current: reader.f32("robot current")?,
            io_current: reader.f32("I/O current")?,
            safety_mode: reader.u8("safety mode")?,
            reduced_mode: reader.u8("reduced mode")?,
            euromap: decode_euromap(reader)?,
            reserved: reader.u32("reserved")?,
            operational_mode_selector: reader.u8("operational mode selector")?,
            three_position_input: reader.u8("three-position input")?,
            reserved_end: if reader.left() > 0 { reader.u8("reserved")? } else { 0 },
        })
    }
}

fn decode_euromap(reader: &mut Reader) -> Result<Option<EuromapData>, WireError> {
    if reader.u8("euromap installed")? == 0 {
        return Ok(None);
    }
    Ok(Some(EuromapData {
        input_bits: reader.u32("euromap input bits")?,
        output_bits: reader.u32("euromap output bits")?,
        voltage_24v: reader.f32("euromap voltage")?,
        current: reader.f32("euromap current")?,
    }))
}
