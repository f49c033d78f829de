//! Built-ins on strings.
//!
//! In: arguments bound to parameters. Out: a value or the message of a runtime exception. Indices count
//! characters from 0. Results are bounded by [`MAX_LENGTH`], so that a loop of `str_cat` cannot eat the
//! machine's memory.

use crate::urscript::host::Call;
use crate::urscript::value::Value;

/// Longest string, in bytes.
const MAX_LENGTH: usize = 65_536;

/// Carries out a built-in of this file; `None` if it is none of them.
pub fn call(call: &Call<'_>) -> Option<Result<Value, String>> {
    Some(match call.name {
        "str_cat" => concatenate(call),
        "str_len" => call.required(0).and_then(Value::string).map(|s| Value::Int(s.chars().count() as i32)),
        "str_empty" => call.required(0).and_then(Value::string).map(|s| Value::Bool(s.is_empty())),
        "str_at" => at(call),
        "str_sub" => part(call),
        "str_find" => find(call),
        "to_str" => call.required(0).map(|value| Value::text(value.to_string())),
        "to_num" => number(call),
        "assert" => assertion(call),
        _ => return None,
    })
}

fn concatenate(call: &Call<'_>) -> Result<Value, String> {
    let text = format!("{}{}", call.required(0)?, call.required(1)?);
    if text.len() > MAX_LENGTH {
        return Err(format!("a string of {} bytes is too long", text.len()));
    }
    Ok(Value::text(text))
}

fn at(call: &Call<'_>) -> Result<Value, String> {
    let text = call.required(0)?.string()?;
    let index = call.required(1)?.integer()?;
    let found = usize::try_from(index).ok().and_then(|index| text.chars().nth(index));
    found.map(|c| Value::text(c.to_string())).ok_or_else(|| format!("index {index} is outside the string"))
}

fn part(call: &Call<'_>) -> Result<Value, String> {
    let text = call.required(0)?.string()?;
    let index = call.required(1)?.integer()?;
    let start = usize::try_from(index).map_err(|_| format!("index {index} is outside the string"))?;
    if start > text.chars().count() {
        return Err(format!("index {index} is outside the string"));
    }
    let length = call.argument(2).map_or(Ok(-1), Value::integer)?;
    let length = usize::try_from(length).unwrap_or(usize::MAX);
    Ok(Value::text(text.chars().skip(start).take(length).collect::<String>()))
}

fn find(call: &Call<'_>) -> Result<Value, String> {
    let (text, target) = (call.required(0)?.string()?, call.required(1)?.string()?);
    let start = call.argument(2).map_or(Ok(0), Value::integer)?;
    let skipped: usize = text.chars().take(usize::try_from(start).unwrap_or(0)).map(char::len_utf8).sum();
    let Some(offset) = text.get(skipped..).and_then(|rest| rest.find(&**target)) else {
        return Ok(Value::Int(-1));
    };
    let before = text.get(..skipped + offset).unwrap_or_default();
    Ok(Value::Int(before.chars().count() as i32))
}

/// A whole number, hexadecimal too, stays one; anything else is a float, infinities and "NAN" among them.
fn number(call: &Call<'_>) -> Result<Value, String> {
    let text = call.required(0)?.string()?;
    let trimmed = text.trim();
    if let Ok(whole) = trimmed.parse::<i32>() {
        return Ok(Value::Int(whole));
    }
    if let Some(digits) = trimmed.strip_prefix("0x").or_else(|| trimmed.strip_prefix("0X"))
        && let Ok(bits) = u32::from_str_radix(digits, 16)
    {
        return Ok(Value::Int(bits as i32));
    }
    trimmed.parse::<f64>().map(Value::Float).map_err(|_| format!("\"{text}\" is not a number"))
}

fn assertion(call: &Call<'_>) -> Result<Value, String> {
    if call.required(0)?.truth()? {
        return Ok(Value::Nothing);
    }
    Err(call
        .argument(1)
        .map_or_else(|| "assertion failed".to_owned(), |message| format!("assertion failed: {message}")))
}
