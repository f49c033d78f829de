//! Methods of lists, matrices and structs: `value.name(arguments)`, which the language has since PolyScope
//! 5.15.
//!
//! In: the value the method belongs to and its arguments. Out: what it returns, or the message of a runtime
//! exception; methods that [`change`] their value work on it in place. Source: script manual, chapter 4.3.
//! The manual gives no return value to `pop` and `remove`; deployed scripts use that of `pop`, so both
//! return the element they take out.

use crate::string_library;
use crate::value::{List, Value};
use std::sync::Arc;

/// Longest list that methods build.
pub const MAX_LENGTH: usize = 100_000;

/// Every method with what it belongs to.
pub const METHODS: &[(&str, &[&str])] = &[
    (
        "list",
        &[
            "append",
            "capacity",
            "clear",
            "excess_capacity",
            "extend",
            "insert",
            "length",
            "pop",
            "remove",
            "slice",
            "to_string",
        ],
    ),
    ("struct", &["length", "to_string"]),
    ("matrix", &["get_column", "get_row", "shape", "to_string"]),
];

/// True for methods that change the value they belong to.
pub fn changes(name: &str) -> bool {
    matches!(name, "append" | "clear" | "extend" | "insert" | "pop" | "remove")
}

/// Calls a method that leaves its value as it is.
///
/// # Errors
/// The message of a runtime exception: no such method, wrong arguments, an index out of range.
pub fn call(of: &Value, name: &str, arguments: &[Value]) -> Result<Value, String> {
    match of {
        Value::List(list) => of_list(list, name, arguments),
        Value::Struct(members) => match name {
            "length" => none(name, arguments).and_then(|()| count(members.len())),
            "to_string" => none(name, arguments).map(|()| Value::text(string_library::cut_short(of))),
            _ => Err(unknown(of, name)),
        },
        _ => Err(unknown(of, name)),
    }
}

fn of_list(list: &Arc<List>, name: &str, arguments: &[Value]) -> Result<Value, String> {
    match name {
        "length" => none(name, arguments).and_then(|()| count(list.len())),
        "capacity" => none(name, arguments).and_then(|()| count(list.capacity())),
        "excess_capacity" => none(name, arguments).and_then(|()| count(list.capacity() - list.len())),
        "to_string" => {
            none(name, arguments).map(|()| Value::text(string_library::cut_short(&Value::List(list.clone()))))
        }
        "slice" => {
            let [begin, end] = exactly(name, arguments)?;
            let (begin, end) = (position(begin)?, position(end)?);
            let part = list.get(begin..end).ok_or_else(|| {
                format!("slice: {begin} to {end} is out of range, the list has {} elements", list.len())
            })?;
            Ok(Value::list(part.to_vec()))
        }
        "get_row" | "get_column" | "shape" => of_matrix(list, name, arguments),
        _ => Err(unknown(&Value::List(list.clone()), name)),
    }
}

/// A matrix is a list of rows of equal length.
fn of_matrix(rows: &[Value], name: &str, arguments: &[Value]) -> Result<Value, String> {
    let cells: Vec<&[Value]> = rows.iter().map(Value::elements).collect::<Result<_, _>>().unwrap_or_default();
    let width = cells.first().map_or(0, |row| row.len());
    if width == 0 || cells.iter().any(|row| row.len() != width) {
        return Err(format!("{name}: only a matrix has rows and columns"));
    }
    if name == "shape" {
        none(name, arguments)?;
        return Ok(Value::list(vec![count(cells.len())?, count(width)?]));
    }
    let [index] = exactly(name, arguments)?;
    let index = position(index)?;
    let of = if name == "get_row" { cells.len() } else { width };
    if index >= of {
        return Err(format!("{name}: index {index} is out of range, there are {of}"));
    }
    Ok(match name {
        "get_row" => rows[index].clone(),
        _ => Value::list(cells.iter().map(|row| row[index].clone()).collect()),
    })
}

/// Calls a method that changes its value.
///
/// # Errors
/// As [`call`], and when the list is full.
pub fn change(of: &mut Value, name: &str, arguments: Vec<Value>) -> Result<Value, String> {
    let Value::List(list) = of else { return Err(unknown(of, name)) };
    let list = Arc::make_mut(list);
    match name {
        "append" => {
            let [element] = taken(name, arguments)?;
            let end = list.len();
            insert(list, end, element, name)
        }
        "insert" => {
            let [index, element] = taken(name, arguments)?;
            let index = position(&index)?;
            insert(list, index, element, name)
        }
        "extend" => {
            let [more] = taken(name, arguments)?;
            let more = more.elements()?;
            room(list, more.len(), name)?;
            list.edit().extend(more.iter().cloned());
            Ok(Value::Nothing)
        }
        "clear" => {
            none(name, &arguments)?;
            list.edit().clear();
            Ok(Value::Nothing)
        }
        "pop" => {
            none(name, &arguments)?;
            list.edit().pop().ok_or_else(|| "pop: the list is empty".to_owned())
        }
        _ => {
            let [index] = taken(name, arguments)?;
            let (index, length) = (position(&index)?, list.len());
            if index >= length {
                return Err(format!("{name}: index {index} is out of range, the list has {length} elements"));
            }
            Ok(list.edit().remove(index))
        }
    }
}

fn insert(list: &mut List, index: usize, element: Value, name: &str) -> Result<Value, String> {
    let length = list.len();
    if index > length {
        return Err(format!("{name}: index {index} is out of range, the list has {length} elements"));
    }
    if element == Value::Nothing {
        return Err(format!("{name}: a function without a return value gives no element"));
    }
    room(list, 1, name)?;
    list.edit().insert(index, element);
    Ok(Value::Nothing)
}

fn room(list: &List, more: usize, name: &str) -> Result<(), String> {
    let capacity = list.capacity().max(list.len()).min(MAX_LENGTH);
    if list.len() + more > capacity {
        return Err(format!(
            "{name}: the list holds {} of {capacity} elements, make_list sets its capacity",
            list.len()
        ));
    }
    Ok(())
}

fn position(value: &Value) -> Result<usize, String> {
    let index = value.integer()?;
    usize::try_from(index).map_err(|_| format!("index {index} is out of range"))
}

fn count(count: usize) -> Result<Value, String> {
    i32::try_from(count).map(Value::Int).map_err(|_| "the list is too long".to_owned())
}

fn none(name: &str, arguments: &[Value]) -> Result<(), String> {
    exactly::<0>(name, arguments).map(|_| ())
}

fn exactly<'a, const N: usize>(name: &str, arguments: &'a [Value]) -> Result<&'a [Value; N], String> {
    arguments.try_into().map_err(|_| format!("{name} takes {N} arguments, {} given", arguments.len()))
}

fn taken<const N: usize>(name: &str, arguments: Vec<Value>) -> Result<[Value; N], String> {
    let given = arguments.len();
    arguments.try_into().map_err(|_| format!("{name} takes {N} arguments, {given} given"))
}

fn unknown(of: &Value, name: &str) -> String {
    format!("{} has no method `{name}`", of.type_name())
}
