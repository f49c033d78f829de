//! Registers, digital and analog outputs, the speed slider, and which client has claimed which input.
//!
//! In: RTDE input packages and the register functions of scripts. Out: the values, for scripts and for RTDE
//! outputs. Inputs keep their values when their writer goes; a claim lasts as long as the connection that
//! made it. Masks are applied when a package arrives, so no script is needed for outputs and the slider.

use std::collections::HashMap;
use ur_wire::rtde_values::{Offer, Value};
use ur_wire::rtde_variables::{self, REGISTERS, Register};

/// Identity of an RTDE connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ClientId(pub u64);

const COUNT: usize = REGISTERS as usize;

/// An input variable, resolved from its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs)]
pub enum Input {
    Int(usize),
    Double(usize),
    Bit(usize),
    BitsLow,
    BitsHigh,
    SpeedSliderMask,
    SpeedSliderFraction,
    StandardDigitalMask,
    StandardDigital,
    ConfigurableDigitalMask,
    ConfigurableDigital,
    ToolDigitalMask,
    ToolDigital,
    AnalogMask,
    AnalogType,
    Analog(usize),
    ExternalForce,
}

impl Input {
    /// The input called `name`.
    pub fn from_name(name: &str) -> Option<Input> {
        if let Some(register) = Register::from_name(name) {
            return match register {
                Register::InputInt(n) => Some(Input::Int(usize::from(n))),
                Register::InputDouble(n) => Some(Input::Double(usize::from(n))),
                Register::InputBit(n) => Some(Input::Bit(usize::from(n))),
                Register::OutputInt(_) | Register::OutputDouble(_) | Register::OutputBit(_) => None,
            };
        }
        Some(match name {
            "input_bit_registers0_to_31" => Input::BitsLow,
            "input_bit_registers32_to_63" => Input::BitsHigh,
            "speed_slider_mask" => Input::SpeedSliderMask,
            "speed_slider_fraction" => Input::SpeedSliderFraction,
            "standard_digital_output_mask" => Input::StandardDigitalMask,
            "standard_digital_output" => Input::StandardDigital,
            "configurable_digital_output_mask" => Input::ConfigurableDigitalMask,
            "configurable_digital_output" => Input::ConfigurableDigital,
            "tool_digital_output_mask" => Input::ToolDigitalMask,
            "tool_digital_output" => Input::ToolDigital,
            "standard_analog_output_mask" => Input::AnalogMask,
            "standard_analog_output_type" => Input::AnalogType,
            "standard_analog_output_0" => Input::Analog(0),
            "standard_analog_output_1" => Input::Analog(1),
            "external_force_torque" => Input::ExternalForce,
            _ => return None,
        })
    }
}

/// All of it.
#[derive(Clone, Debug)]
pub struct Registers {
    /// Written by clients.
    pub input_ints: [i32; COUNT],
    /// Written by clients.
    pub input_doubles: [f64; COUNT],
    /// Written by clients.
    pub input_bits: [bool; 128],
    /// Written by scripts.
    pub output_ints: [i32; COUNT],
    /// Written by scripts.
    pub output_doubles: [f64; COUNT],
    /// Written by scripts.
    pub output_bits: [bool; 128],
    /// 0-7 standard, 8-15 configurable, 16-17 tool.
    pub digital_outputs: u64,
    /// Same layout.
    pub digital_inputs: u64,
    /// Ratio 0 to 1 of the range.
    pub analog_outputs: [f64; 2],
    /// True: voltage, false: current.
    pub analog_output_voltage: [bool; 2],
    /// V: 0, 12 or 24.
    pub tool_voltage: i32,
    /// Force and torque handed in by a client.
    pub external_force: [f64; 6],
    speed_fraction: f64,
    claims: HashMap<String, ClientId>,
    /// Packages in which each input was written last, for watchdogs.
    written: HashMap<Input, u64>,
    packages: u64,
}

impl Default for Registers {
    fn default() -> Registers {
        Registers {
            input_ints: [0; COUNT],
            input_doubles: [0.0; COUNT],
            input_bits: [false; 128],
            output_ints: [0; COUNT],
            output_doubles: [0.0; COUNT],
            output_bits: [false; 128],
            digital_outputs: 0,
            digital_inputs: 0,
            analog_outputs: [0.0; 2],
            analog_output_voltage: [false; 2],
            tool_voltage: 0,
            external_force: [0.0; 6],
            speed_fraction: 1.0,
            claims: HashMap::new(),
            written: HashMap::new(),
            packages: 0,
        }
    }
}

impl Registers {
    /// The speed slider, 0 to 1.
    pub fn speed_fraction(&self) -> f64 {
        self.speed_fraction
    }

    /// Moves the speed slider at the pendant, down to 0.
    pub fn slide_to(&mut self, fraction: f64) {
        self.speed_fraction = fraction.clamp(0.0, 1.0);
    }

    /// Moves the speed slider for a client. It cannot be moved to 0: that is what pausing is for.
    pub fn set_speed_fraction(&mut self, fraction: f64) {
        if fraction.is_finite() && fraction > 0.0 {
            self.speed_fraction = fraction.clamp(0.0, 1.0);
        }
    }

    /// What each input of a recipe can be had as. All are claimed if every one of them can; else none.
    pub fn claim(&mut self, client: ClientId, names: &[String]) -> Vec<Offer> {
        let offers: Vec<Offer> = names
            .iter()
            .map(|name| match rtde_variables::input_type(name) {
                None => Offer::NotFound,
                Some(_) if self.claims.get(name).is_some_and(|owner| *owner != client) => Offer::InUse,
                Some(kind) => Offer::Type(kind),
            })
            .collect();
        if offers.iter().all(|offer| matches!(offer, Offer::Type(_))) {
            self.claims.extend(names.iter().map(|name| (name.clone(), client)));
        }
        offers
    }

    /// Gives up all claims of a connection.
    pub fn release(&mut self, client: ClientId) {
        self.claims.retain(|_, owner| *owner != client);
    }

    /// Gives an input to `client` whichever client has it (a fault).
    pub fn seize(&mut self, client: ClientId, name: &str) {
        self.claims.insert(name.to_owned(), client);
    }

    /// Frees an input that `client` has seized.
    pub fn give_back(&mut self, client: ClientId, name: &str) {
        if self.claims.get(name) == Some(&client) {
            self.claims.remove(name);
        }
    }

    /// Some client has claimed the input.
    pub fn claimed(&self, name: &str) -> bool {
        self.claims.contains_key(name)
    }

    /// Number of the package in which an input was written last; 0 if never.
    pub fn last_written(&self, input: Input) -> u64 {
        self.written.get(&input).copied().unwrap_or(0)
    }

    /// Takes over one input package as a whole.
    pub fn write(&mut self, fields: &[Input], values: &[Value]) {
        self.packages += 1;
        let mut masks = Masks::default();
        for (field, value) in fields.iter().zip(values) {
            self.written.insert(*field, self.packages);
            self.write_one(*field, value, &mut masks);
        }
        self.apply(&masks);
    }

    fn write_one(&mut self, field: Input, value: &Value, masks: &mut Masks) {
        match (field, value) {
            (Input::Int(n), Value::Int32(value)) => self.input_ints[n] = *value,
            (Input::Double(n), Value::Double(value)) => self.input_doubles[n] = *value,
            (Input::Bit(n), Value::Bool(value)) => self.input_bits[n] = *value,
            (Input::BitsLow, Value::Uint32(bits)) => set_bits(&mut self.input_bits[..32], *bits),
            (Input::BitsHigh, Value::Uint32(bits)) => set_bits(&mut self.input_bits[32..64], *bits),
            (Input::SpeedSliderMask, Value::Uint32(mask)) => masks.slider = *mask & 1 != 0,
            (Input::SpeedSliderFraction, Value::Double(fraction)) => masks.fraction = Some(*fraction),
            (Input::StandardDigitalMask, Value::Uint8(mask)) => masks.digital[0].0 = *mask,
            (Input::StandardDigital, Value::Uint8(bits)) => masks.digital[0].1 = *bits,
            (Input::ConfigurableDigitalMask, Value::Uint8(mask)) => masks.digital[1].0 = *mask,
            (Input::ConfigurableDigital, Value::Uint8(bits)) => masks.digital[1].1 = *bits,
            (Input::ToolDigitalMask, Value::Uint8(mask)) => masks.digital[2].0 = *mask & 3,
            (Input::ToolDigital, Value::Uint8(bits)) => masks.digital[2].1 = *bits,
            (Input::AnalogMask, Value::Uint8(mask)) => masks.analog = *mask,
            (Input::AnalogType, Value::Uint8(types)) => masks.analog_types = *types,
            (Input::Analog(n), Value::Double(ratio)) => masks.analog_values[n] = Some(*ratio),
            (Input::ExternalForce, Value::Vector6D(wrench)) if wrench.iter().all(|part| part.is_finite()) => {
                self.external_force = *wrench;
            }
            // The codec hands over values of the type of the field; anything else cannot come up.
            _ => {}
        }
    }

    fn apply(&mut self, masks: &Masks) {
        if let Some(fraction) = masks.fraction.filter(|_| masks.slider) {
            self.set_speed_fraction(fraction);
        }
        for (group, (mask, bits)) in masks.digital.iter().enumerate() {
            let (mask, bits) = (u64::from(*mask) << (8 * group), u64::from(*bits) << (8 * group));
            self.digital_outputs = (self.digital_outputs & !mask) | (bits & mask);
        }
        for output in 0..2 {
            if masks.analog & (1 << output) != 0 {
                self.analog_output_voltage[output] = masks.analog_types & (1 << output) != 0;
                if let Some(ratio) = masks.analog_values[output].filter(|ratio| ratio.is_finite()) {
                    self.analog_outputs[output] = ratio.clamp(0.0, 1.0);
                }
            }
        }
    }
}

/// The parts of a package that act only together.
#[derive(Default)]
struct Masks {
    slider: bool,
    fraction: Option<f64>,
    digital: [(u8, u8); 3],
    analog: u8,
    analog_types: u8,
    analog_values: [Option<f64>; 2],
}

fn set_bits(registers: &mut [bool], bits: u32) {
    registers.iter_mut().enumerate().for_each(|(bit, register)| *register = bits & (1 << bit) != 0);
}

/// A word from 32 bit registers.
pub fn bits_word(registers: &[bool]) -> u32 {
    registers.iter().take(32).enumerate().map(|(bit, set)| u32::from(*set) << bit).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(list: &[&str]) -> Vec<String> {
        list.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn every_documented_input_is_known() {
        for (name, _) in rtde_variables::INPUTS {
            assert!(Input::from_name(name).is_some(), "{name}");
        }
        assert_eq!(Input::from_name("input_int_register_47"), Some(Input::Int(47)));
        assert_eq!(Input::from_name("output_int_register_0"), None);
    }

    #[test]
    fn an_input_belongs_to_one_connection_until_it_closes() {
        let mut registers = Registers::default();
        let (a, b) = (ClientId(1), ClientId(2));
        assert!(matches!(registers.claim(a, &names(&["input_int_register_24"]))[..], [Offer::Type(_)]));
        assert!(matches!(registers.claim(a, &names(&["input_int_register_24"]))[..], [Offer::Type(_)]));
        let offers =
            registers.claim(b, &names(&["input_int_register_25", "input_int_register_24", "nonsense"]));
        assert!(matches!(offers[..], [Offer::Type(_), Offer::InUse, Offer::NotFound]));
        assert!(!registers.claimed("input_int_register_25"), "a refused recipe claims nothing");
        registers.release(a);
        assert!(matches!(registers.claim(b, &names(&["input_int_register_24"]))[..], [Offer::Type(_)]));
    }

    #[test]
    fn masks_choose_what_a_package_changes() {
        let mut registers = Registers::default();
        registers.write(
            &[Input::StandardDigitalMask, Input::StandardDigital, Input::ToolDigitalMask, Input::ToolDigital],
            &[Value::Uint8(0b110), Value::Uint8(0b011), Value::Uint8(1), Value::Uint8(1)],
        );
        assert_eq!(registers.digital_outputs, 0b010 | 1 << 16);
        registers.write(
            &[Input::SpeedSliderMask, Input::SpeedSliderFraction],
            &[Value::Uint32(0), Value::Double(0.3)],
        );
        assert_eq!(registers.speed_fraction(), 1.0);
        registers.write(
            &[Input::SpeedSliderMask, Input::SpeedSliderFraction],
            &[Value::Uint32(1), Value::Double(0.3)],
        );
        assert_eq!(registers.speed_fraction(), 0.3);
        registers.write(
            &[Input::SpeedSliderMask, Input::SpeedSliderFraction],
            &[Value::Uint32(1), Value::Double(f64::NAN)],
        );
        assert_eq!(registers.speed_fraction(), 0.3);
    }

    #[test]
    fn bit_words_go_both_ways() {
        let mut registers = Registers::default();
        registers.write(&[Input::BitsHigh], &[Value::Uint32(0x8000_0001)]);
        assert!(registers.input_bits[32] && registers.input_bits[63] && !registers.input_bits[33]);
        assert_eq!(bits_word(&registers.input_bits[32..64]), 0x8000_0001);
    }
}
