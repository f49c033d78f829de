//! Built-ins on registers, digital and analog inputs and outputs.
//!
//! In: calls from running programs. Out: values, or the message of a runtime exception for a number out of
//! range. Inputs read as false and 0: nothing is wired to the simulated control box.

use crate::controller::core::Core;
use urscript::host::Call;
use urscript::value::Value;

/// Carries out a built-in on registers; `None` if it is none of them. Programs spend most calls on these.
pub fn register_call(core: &mut Core, call: &Call<'_>) -> Option<Result<Value, String>> {
    if !call.name.ends_with("_register") {
        return None;
    }
    let of = |length: usize| number(call, length);
    let registers = &mut core.registers;
    Some(match call.name {
        "read_input_integer_register" => of(48).map(|n| Value::Int(registers.input_ints[n])),
        "read_input_float_register" => of(48).map(|n| Value::Float(registers.input_doubles[n])),
        "read_input_boolean_register" => of(128).map(|n| Value::Bool(registers.input_bits[n])),
        "read_output_integer_register" => of(48).map(|n| Value::Int(registers.output_ints[n])),
        "read_output_float_register" => of(48).map(|n| Value::Float(registers.output_doubles[n])),
        "read_output_boolean_register" => of(128).map(|n| Value::Bool(registers.output_bits[n])),
        "write_output_integer_register" => of(48).and_then(|n| {
            registers.output_ints[n] = call.required(1)?.integer()?;
            Ok(Value::Nothing)
        }),
        "write_output_float_register" => of(48).and_then(|n| {
            registers.output_doubles[n] = call.required(1)?.number()?;
            Ok(Value::Nothing)
        }),
        "write_output_boolean_register" => of(128).and_then(|n| {
            registers.output_bits[n] = call.required(1)?.truth()?;
            Ok(Value::Nothing)
        }),
        _ => return None,
    })
}

/// The number in the first argument, below `length`.
fn number(call: &Call<'_>, length: usize) -> Result<usize, String> {
    let number = call.required(0)?.integer()?;
    let found = usize::try_from(number).ok().filter(|number| *number < length);
    found.ok_or_else(|| format!("{}: there is no number {number}", call.name))
}

/// Carries out another built-in of this file; `None` if it is none of them.
pub fn call(core: &mut Core, call: &Call<'_>) -> Option<Result<Value, String>> {
    let of = |length: usize| number(call, length);
    let registers = &mut core.registers;
    Some(match call.name {
        "set_tool_voltage" => call.required(0).and_then(Value::integer).and_then(|voltage| match voltage {
            0 | 12 | 24 => {
                registers.tool_voltage = voltage;
                Ok(Value::Nothing)
            }
            other => Err(format!("set_tool_voltage: {other} V cannot be set")),
        }),
        _ => return digital(core, call, &of).or_else(|| analog(core, call, &of)),
    })
}

type Number<'a> = &'a dyn Fn(usize) -> Result<usize, String>;

fn digital(core: &mut Core, call: &Call<'_>, of: Number<'_>) -> Option<Result<Value, String>> {
    let head = call.name.strip_suffix("_out").or_else(|| call.name.strip_suffix("_in"));
    let (first, count) = match head.and_then(|head| head.strip_suffix("digital")) {
        Some("set_" | "get_") => (0, 10),
        Some("set_standard_" | "get_standard_") => (0, 8),
        Some("set_configurable_" | "get_configurable_") => (8, 8),
        Some("set_tool_" | "get_tool_") => (16, 2),
        _ => return None,
    };
    let bit = of(count).map(|n| if first == 0 && n >= 8 { 16 + n - 8 } else { first + n });
    let registers = &mut core.registers;
    Some(bit.and_then(|bit| {
        if call.name.starts_with("set") {
            let on = call.required(1)?.truth()?;
            registers.digital_outputs = registers.digital_outputs & !(1 << bit) | u64::from(on) << bit;
            return Ok(Value::Nothing);
        }
        let word =
            if call.name.ends_with("out") { registers.digital_outputs } else { registers.digital_inputs };
        Ok(Value::Bool(word & (1 << bit) != 0))
    }))
}

fn analog(core: &mut Core, call: &Call<'_>, of: Number<'_>) -> Option<Result<Value, String>> {
    let registers = &mut core.registers;
    Some(match call.name {
        "set_analog_out" | "set_standard_analog_out" => of(2).and_then(|n| {
            let ratio = call.required(1)?.number()?;
            if !(0.0..=1.0).contains(&ratio) {
                return Err(format!("{}: {ratio} is not between 0 and 1", call.name));
            }
            registers.analog_outputs[n] = ratio;
            Ok(Value::Nothing)
        }),
        "get_analog_out" | "get_standard_analog_out" => {
            of(2).map(|n| Value::Float(registers.analog_outputs[n]))
        }
        "set_analog_outputdomain" => of(2).and_then(|n| {
            registers.analog_output_voltage[n] = call.required(1)?.integer()? != 0;
            Ok(Value::Nothing)
        }),
        "get_analog_in" => of(4).map(|_| Value::Float(0.0)),
        "get_standard_analog_in" | "get_tool_analog_in" => of(2).map(|_| Value::Float(0.0)),
        _ => return None,
    })
}
