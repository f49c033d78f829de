//! Built-ins that set something and read it back: flags, ports, Modbus signals, configuration of inputs.
//!
//! In: calls from running programs. Out: values, or the message of a runtime exception for an address or
//! name that does not exist. Nothing is wired to the simulated control box: configuration that would act on
//! inputs is checked for its arguments and accepted, ports and signals keep what scripts write.

use crate::controller::core::Core;
use crate::controller::modbus_map;
use crate::controller::settings::{MAX_SIGNALS, ToolLine};
use urscript::host::Call;
use urscript::value::Value;

/// Configuration without an effect here.
const ACCEPTED: &[&str] = &[
    "set_safety_mode_transition_hardness",
    "high_holding_torque_enable",
    "high_holding_torque_disable",
    "position_deviation_warning",
    "pause_on_error_code",
    "set_analog_inputrange",
    "set_standard_analog_input_domain",
    "set_tool_analog_input_domain",
    "tool_wrench_limit_disable",
    "set_baselight_off",
    "set_baselight_iec",
    "set_baselight_solid",
    "modbus_reset_connection",
    "set_runstate_outputs",
    "set_tool_output_mode",
    "set_tool_digital_output_mode",
    "set_input_actions_to_default",
    "set_standard_digital_input_action",
    "set_configurable_digital_input_action",
    "set_tool_digital_input_action",
    "set_gp_boolean_input_action",
    "set_runstate_standard_digital_output_to_value",
    "set_runstate_configurable_digital_output_to_value",
    "set_runstate_tool_digital_output_to_value",
    "set_runstate_standard_analog_output_to_value",
    "set_runstate_gp_boolean_output_to_value",
    "modbus_set_signal_update_frequency",
    "modbus_set_runstate_dependent_choice",
    "modbus_set_digital_input_action",
];

/// Carries out a built-in of this file; `None` if it is none of them.
pub fn call(core: &mut Core, call: &Call<'_>) -> Option<Result<Value, String>> {
    if ACCEPTED.contains(&call.name) {
        return Some(Ok(Value::Nothing));
    }
    Some(match call.name {
        "get_flag" => flag(core, call).map(|flag| Value::Bool(*flag)),
        "set_flag" => given(call, 1, Value::truth).and_then(|on| {
            *flag(core, call)? = on;
            Ok(Value::Nothing)
        }),
        "read_port_bit" => {
            address(call).map(|at| Value::Bool(modbus_map::read_coil(core, at).unwrap_or(false)))
        }
        "read_port_register" => {
            let held = |at| modbus_map::read(core, at).unwrap_or(0).cast_signed();
            address(call).map(|at| Value::Int(i32::from(held(at))))
        }
        "write_port_bit" => address(call).and_then(|at| {
            written(call, at, modbus_map::write_coil(core, at, given(call, 1, Value::truth)?))
        }),
        "write_port_register" => address(call).and_then(|at| {
            let value = given(call, 1, Value::integer)?;
            let value = i16::try_from(value).map(i16::cast_unsigned).or_else(|_| u16::try_from(value));
            let value = value.map_err(|_| format!("{}: the value has more than 16 bits", call.name))?;
            written(call, at, modbus_map::write(core, at, value))
        }),
        "set_tool_communication" => tool_communication(core, call),
        "tool_wrench_limit_set" => given(call, 0, Value::pose).map(|_| Value::Nothing),
        "get_base_acceleration" => Ok(Value::numbers(core.settings.base_acceleration)),
        "set_base_acceleration" => given(call, 0, Value::array::<3>).and_then(|acceleration| {
            if acceleration.iter().any(|axis| !axis.is_finite()) {
                return Err("set_base_acceleration: not a finite number".to_owned());
            }
            core.settings.base_acceleration = acceleration;
            Ok(Value::Nothing)
        }),
        _ => return signals(core, call),
    })
}

fn written(call: &Call<'_>, address: u16, done: bool) -> Result<Value, String> {
    if done { Ok(Value::Nothing) } else { Err(format!("{}: address {address} is read-only", call.name)) }
}

fn given<T>(call: &Call<'_>, index: usize, read: impl Fn(&Value) -> Result<T, String>) -> Result<T, String> {
    call.required(index).and_then(read)
}

fn flag<'a>(core: &'a mut Core, call: &Call<'_>) -> Result<&'a mut bool, String> {
    let number = given(call, 0, Value::integer)?;
    let flag = usize::try_from(number).ok().and_then(|n| core.settings.flags.get_mut(n));
    flag.ok_or_else(|| format!("{}: there is no flag {number}", call.name))
}

fn address(call: &Call<'_>) -> Result<u16, String> {
    let address = given(call, 0, Value::integer)?;
    u16::try_from(address).map_err(|_| format!("{}: there is no address {address}", call.name))
}

/// The serial line of the tool: its parameters are checked as the manual gives them.
fn tool_communication(core: &mut Core, call: &Call<'_>) -> Result<Value, String> {
    let enabled = given(call, 0, Value::truth)?;
    let (baud, parity) = (given(call, 1, Value::integer)?, given(call, 2, Value::integer)?);
    let stop_bits = given(call, 3, Value::integer)?;
    let (receive, transmit) = (given(call, 4, Value::number)?, given(call, 5, Value::number)?);
    let known = [9600, 19200, 38400, 57600, 115_200, 1_000_000, 2_000_000, 5_000_000].contains(&baud);
    let idle = (1.0..=40.0).contains(&receive) && (0.0..=40.0).contains(&transmit);
    if known && (0..=2).contains(&parity) && (1..=2).contains(&stop_bits) && idle {
        core.settings.tool_line =
            enabled.then_some(ToolLine { baud, parity, stop_bits, idle_chars: [receive, transmit] });
        return Ok(Value::Nothing);
    }
    Err("set_tool_communication: a parameter is out of range".to_owned())
}

fn signals(core: &mut Core, call: &Call<'_>) -> Option<Result<Value, String>> {
    let signals = &mut core.settings.signals;
    let name = |index: usize| given(call, index, |value| value.string().map(|name| name.to_string()));
    let unknown = |name: &str| format!("{}: there is no signal {name}", call.name);
    Some(match call.name {
        "modbus_add_signal" | "modbus_add_rw_signal" => {
            let place = if call.name == "modbus_add_signal" { 4 } else { 6 };
            name(place).and_then(|name| {
                if signals.len() >= MAX_SIGNALS {
                    return Err(format!("{}: more than {MAX_SIGNALS} signals", call.name));
                }
                signals.insert(name, 0);
                Ok(Value::Nothing)
            })
        }
        "modbus_get_error"
        | "modbus_get_time_since_signal_invalid"
        | "modbus_request_update_signal_value"
        | "modbus_set_signal_watchdog" => name(0).and_then(|name| match call.name {
            _ if !signals.contains_key(&name) => Err(unknown(&name)),
            "modbus_get_error" => Ok(Value::Int(0)),
            "modbus_get_time_since_signal_invalid" => Ok(Value::Float(0.0)),
            "modbus_set_signal_watchdog" => match given(call, 1, Value::number)? {
                0.0..=300.0 => Ok(Value::Nothing),
                seconds => Err(format!("{}: {seconds} s is not between 0 and 300", call.name)),
            },
            _ => Ok(Value::Nothing),
        }),
        "modbus_delete_signal" => name(0).map(|name| {
            signals.remove(&name);
            Value::Nothing
        }),
        "modbus_get_signal_status" => {
            name(0).and_then(|name| signals.get(&name).map(|v| Value::Int(*v)).ok_or_else(|| unknown(&name)))
        }
        "modbus_set_output_register" | "modbus_set_output_signal" => name(0).and_then(|name| {
            let value = match call.required(1)? {
                Value::Bool(on) => i32::from(*on),
                other => other.integer()?,
            };
            *signals.get_mut(&name).ok_or_else(|| unknown(&name))? = value;
            Ok(Value::Nothing)
        }),
        _ => return None,
    })
}
