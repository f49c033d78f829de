//! How large a value may become.
//!
//! In: a value that was made or changed. Out: the value, or that it is too large. A script that fills a list
//! without end is stopped here, before it takes the memory of the computer.

use crate::value::Value;

/// Most elements of a list, those of its lists included, and deepest nesting of lists.
pub(crate) const MAX_ELEMENTS: usize = 200_000;
const MAX_LIST_NESTING: usize = 8;

/// What is said to a larger one.
pub(crate) const TOO_LARGE: &str = "the list is too large";

/// The value, if it is within bounds.
pub(crate) fn bounded(value: Value) -> Result<Value, String> {
    bounded_ref(&value)?;
    Ok(value)
}

/// Nothing if the value is within bounds.
pub(crate) fn bounded_ref(value: &Value) -> Result<(), String> {
    let mut left = MAX_ELEMENTS;
    if fits(value, MAX_LIST_NESTING, &mut left) { Ok(()) } else { Err(TOO_LARGE.to_owned()) }
}

fn fits(value: &Value, levels: usize, left: &mut usize) -> bool {
    if *left == 0 {
        return false;
    }
    *left -= 1;
    match value {
        Value::List(elements) => levels > 0 && elements.iter().all(|element| fits(element, levels - 1, left)),
        Value::Struct(members) => {
            levels > 0 && members.iter().all(|(_, element)| fits(element, levels - 1, left))
        }
        _ => true,
    }
}
