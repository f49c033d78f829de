//! Built-ins on strings.
//!
//! In: arguments bound to parameters. Out: a value or the message of a runtime exception. Indices count
//! characters from 0. Results are bounded by `MAX_LENGTH`, so that a loop of `str_cat` cannot eat the
//! machine's memory.

use crate::host::Call;
use crate::value::Value;
use std::fmt::Write;

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
        "to_str" => call.required(0).and_then(|value| text_of(&[value])).map(Value::text),
        "to_num" => number(call),
        "assert" => assertion(call),
        _ => return None,
    })
}

fn concatenate(call: &Call<'_>) -> Result<Value, String> {
    let both = [call.required(0)?, call.required(1)?];
    if both.iter().any(|value| matches!(value, Value::Struct(_))) {
        return Err("str_cat: a struct is no part of a string".to_owned());
    }
    text_of(&both).map(Value::text)
}

/// Values as one string, floats with 6 decimals at most.
fn text_of(values: &[&Value]) -> Result<String, String> {
    let mut text = Bounded::default();
    for value in values {
        // What is written is bounded, so that a list of long strings does not become a longer one first.
        let written = match value {
            Value::Float(number) if number.is_finite() => {
                let digits = format!("{number:.6}");
                text.write_str(digits.trim_end_matches('0').trim_end_matches('.'))
            }
            value => write!(text, "{value}"),
        };
        written.map_err(|_| too_long())?;
    }
    Ok(text.0)
}

fn too_long() -> String {
    format!("a string of more than {MAX_LENGTH} bytes is too long")
}

/// A value as text that is handed on whole: strings as they are, anything else as its program writes it.
///
/// # Errors
/// It is too long and no string that is there already.
pub fn whole(value: &Value) -> Result<String, String> {
    if let Value::Text(text) = value {
        return Ok(text.to_string());
    }
    let mut text = Bounded::default();
    write!(text, "{value}").map_err(|_| too_long())?;
    Ok(text.0)
}

/// A value as text that is shown, and as its method `to_string` writes it: cut short, with dots before its
/// closing bracket, when it is too long.
pub fn cut_short(value: &Value) -> String {
    // One that a program was uploaded with may be longer than those that it makes.
    if let Value::Text(text) = value {
        let most = text.len().min(MAX_LENGTH);
        let end = (0..=most).rev().find(|end| text.is_char_boundary(*end)).unwrap_or_default();
        return text.get(..end).unwrap_or_default().to_owned();
    }
    let mut text = Bounded::default();
    if write!(text, "{value}").is_err() {
        text.0.push_str(if matches!(value, Value::Struct(_)) { "...}" } else { "...]" });
    }
    text.0
}

/// Text up to [`MAX_LENGTH`] bytes.
#[derive(Default)]
struct Bounded(String);

impl Write for Bounded {
    fn write_str(&mut self, part: &str) -> std::fmt::Result {
        if self.0.len() + part.len() > MAX_LENGTH {
            return Err(std::fmt::Error);
        }
        self.0.push_str(part);
        Ok(())
    }
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
    let length = match call.argument(2) {
        None => usize::MAX,
        Some(length) => {
            let length = length.integer()?;
            usize::try_from(length).map_err(|_| format!("str_sub: a length of {length} is not possible"))?
        }
    };
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

/// A whole number, hexadecimal too, stays one; anything else is a float, infinities and "NAN" by name among
/// them.
fn number(call: &Call<'_>) -> Result<Value, String> {
    let text = call.required(0)?.string()?;
    let refused = || format!("\"{text}\" is not a number, or out of range");
    let trimmed = text.trim();
    let digits = trimmed.strip_prefix(['-', '+']).unwrap_or(trimmed);
    if let Some(hexadecimal) = digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X")) {
        let plain = hexadecimal.bytes().all(|digit| digit.is_ascii_hexdigit());
        let bits = u32::from_str_radix(hexadecimal, 16).ok().filter(|_| plain).ok_or_else(refused)?;
        let whole = bits as i32;
        return Ok(Value::Int(if trimmed.starts_with('-') { whole.wrapping_neg() } else { whole }));
    }
    if !digits.is_empty() && digits.bytes().all(|digit| digit.is_ascii_digit()) {
        return trimmed.parse().map(Value::Int).map_err(|_| refused());
    }
    let number: f64 = trimmed.parse().map_err(|_| refused())?;
    // A number that is too large is out of range; one that is called infinite is meant.
    if number.is_infinite() && digits.starts_with(|first: char| first.is_ascii_digit() || first == '.') {
        return Err(refused());
    }
    Ok(Value::Float(number))
}

fn assertion(call: &Call<'_>) -> Result<Value, String> {
    if call.required(0)?.truth()? {
        return Ok(Value::Nothing);
    }
    let message = call.argument(1).map(|message| format!(": {}", cut_short(message)));
    Err(format!("assertion failed{}", message.unwrap_or_default()))
}
