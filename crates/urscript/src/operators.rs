//! What the operators and brackets of the language do to values.
//!
//! In: operands. Out: the result, or a message that becomes a runtime exception. Choices where the manual is
//! silent: `int / int` is a float (deployed scripts divide integers and need the fraction), whole-number
//! arithmetic wraps at 32 bits, `%` has the sign of the dividend, dividing by zero is an exception.

use crate::ast::{Binary, Unary};
use crate::bounds::{MAX_ELEMENTS, TOO_LARGE};
use crate::value::{List, Value};
use std::sync::Arc;

/// `operator value`.
///
/// # Errors
/// The operator does not apply to the type of the value.
pub fn unary(operator: Unary, value: &Value) -> Result<Value, String> {
    match (operator, value) {
        (Unary::Not, value) => Ok(Value::Bool(!value.truth()?)),
        (Unary::Plus, value) => binary(Binary::Multiply, value, &Value::Int(1)),
        (Unary::Negate, value) => binary(Binary::Multiply, value, &Value::Int(-1)),
    }
}

/// `left operator right`. `and` and `or` get here only with both sides evaluated.
///
/// # Errors
/// The operator does not apply to these types, the sizes of lists or matrices do not fit, or the divisor is
/// 0.
pub fn binary(operator: Binary, left: &Value, right: &Value) -> Result<Value, String> {
    match operator {
        Binary::And => Ok(Value::Bool(left.truth()? && right.truth()?)),
        Binary::Or => Ok(Value::Bool(left.truth()? || right.truth()?)),
        Binary::Xor => Ok(Value::Bool(left.truth()? != right.truth()?)),
        Binary::Equal => Ok(Value::Bool(equal(left, right))),
        Binary::NotEqual => Ok(Value::Bool(!equal(left, right))),
        Binary::Less | Binary::LessEqual | Binary::Greater | Binary::GreaterEqual => {
            compare(operator, left, right)
        }
        Binary::Add | Binary::Subtract | Binary::Multiply | Binary::Divide | Binary::Modulo => {
            arithmetic(operator, left, right)
        }
    }
}

/// Equality across types: numbers by value, `True` as 1, lists and poses element by element.
pub fn equal(left: &Value, right: &Value) -> bool {
    match (left, right) {
        (Value::Bool(a), b) | (b, Value::Bool(a)) => match b {
            Value::Bool(b) => a == b,
            b => b.as_number() == Some(f64::from(u8::from(*a))),
        },
        (Value::List(a), Value::List(b)) => {
            a.len() == b.len() && a.iter().zip(b.iter()).all(|(a, b)| equal(a, b))
        }
        (Value::Thread(a), Value::Int(b)) | (Value::Int(b), Value::Thread(a)) => a.0 == *b,
        (a, b) => match (a.as_number(), b.as_number()) {
            (Some(a), Some(b)) => a == b,
            _ => a == b,
        },
    }
}

fn compare(operator: Binary, left: &Value, right: &Value) -> Result<Value, String> {
    let order = match (left, right) {
        (Value::Text(a), Value::Text(b)) => a.partial_cmp(b),
        (a, b) => a.number()?.partial_cmp(&b.number()?),
    };
    Ok(Value::Bool(order.is_some_and(|order| match operator {
        Binary::Less => order.is_lt(),
        Binary::LessEqual => order.is_le(),
        Binary::Greater => order.is_gt(),
        _ => order.is_ge(),
    })))
}

fn arithmetic(operator: Binary, left: &Value, right: &Value) -> Result<Value, String> {
    let refused = || {
        let (a, b) = (left.type_name(), right.type_name());
        Err(format!("cannot compute {a} {} {b}", symbol(operator)))
    };
    match (left, right) {
        (Value::Int(a), Value::Int(b)) => whole(operator, *a, *b),
        (Value::List(a), Value::List(b)) => match operator {
            Binary::Multiply => matrix_product(a, b),
            Binary::Add | Binary::Subtract if a.len() == b.len() => {
                let parts: Result<_, String> =
                    a.iter().zip(b.iter()).map(|(a, b)| binary(operator, a, b)).collect();
                Ok(Value::list(parts?))
            }
            Binary::Add | Binary::Subtract => {
                Err(format!("lists of {} and {} elements cannot be combined", a.len(), b.len()))
            }
            _ => refused(),
        },
        (Value::List(a), b) if b.as_number().is_some() => {
            Ok(Value::list(a.iter().map(|a| binary(operator, a, b)).collect::<Result<_, String>>()?))
        }
        (a, Value::List(b)) if a.as_number().is_some() && operator != Binary::Divide => {
            Ok(Value::list(b.iter().map(|b| binary(operator, a, b)).collect::<Result<_, String>>()?))
        }
        (Value::Pose(pose), scalar) | (scalar, Value::Pose(pose)) => match (operator, scalar.as_number()) {
            (Binary::Multiply, Some(factor)) => Ok(Value::Pose(pose.map(|element| element * factor))),
            _ => refused(),
        },
        (a, b) => match (a.as_number(), b.as_number()) {
            (Some(a), Some(b)) => real(operator, a, b),
            _ => refused(),
        },
    }
}

fn symbol(operator: Binary) -> &'static str {
    match operator {
        Binary::Add => "+",
        Binary::Subtract => "-",
        Binary::Multiply => "*",
        Binary::Divide => "/",
        _ => "%",
    }
}

fn whole(operator: Binary, a: i32, b: i32) -> Result<Value, String> {
    Ok(match operator {
        Binary::Add => Value::Int(a.wrapping_add(b)),
        Binary::Subtract => Value::Int(a.wrapping_sub(b)),
        Binary::Multiply => Value::Int(a.wrapping_mul(b)),
        Binary::Modulo if b != 0 => Value::Int(a.wrapping_rem(b)),
        _ => return real(operator, f64::from(a), f64::from(b)),
    })
}

fn real(operator: Binary, a: f64, b: f64) -> Result<Value, String> {
    Ok(Value::Float(match operator {
        Binary::Add => a + b,
        Binary::Subtract => a - b,
        Binary::Multiply => a * b,
        _ if b == 0.0 => return Err("division by zero".to_owned()),
        Binary::Divide => a / b,
        _ => a % b,
    }))
}

/// One product is one instruction, and a frame has time for some thousands of those: 100 by 100 by 100 is a
/// millisecond, and no program for an arm is known that comes near it.
const MAX_MULTIPLICATIONS: usize = 1_000_000;

/// Matrix times matrix or matrix times vector; two plain vectors have no product.
fn matrix_product(a: &[Value], b: &[Value]) -> Result<Value, String> {
    let rows: Vec<Vec<f64>> = a
        .iter()
        .map(Value::number_list)
        .collect::<Result<_, String>>()
        .map_err(|_| "the left side of a product of lists must be a matrix".to_owned())?;
    let is_matrix = matches!(b.first(), Some(Value::List(_)));
    let columns: Vec<Vec<f64>> = if is_matrix {
        b.iter().map(Value::number_list).collect::<Result<_, String>>()?
    } else {
        b.iter().map(|value| value.number().map(|number| vec![number])).collect::<Result<_, String>>()?
    };
    let width = columns.first().map_or(0, Vec::len);
    if width == 0
        || rows.iter().any(|row| row.len() != columns.len())
        || columns.iter().any(|row| row.len() != width)
    {
        return Err("the sizes of the matrices do not fit".to_owned());
    }
    // A column times a row is larger than both: it is counted before it is made.
    let multiplications = rows.len().saturating_mul(width).saturating_mul(columns.len());
    if rows.len().saturating_mul(width + 1) >= MAX_ELEMENTS || multiplications > MAX_MULTIPLICATIONS {
        return Err(TOO_LARGE.to_owned());
    }
    let cell =
        |row: &[f64], column: usize| -> f64 { row.iter().zip(&columns).map(|(a, b)| a * b[column]).sum() };
    let product = rows.iter().map(|row| (0..width).map(|column| cell(row, column)).collect::<Vec<f64>>());
    Ok(Value::list(
        product
            .map(|row| if is_matrix { Value::numbers(row) } else { Value::Float(row.iter().sum()) })
            .collect(),
    ))
}

/// `value[index]`, counted from 0.
///
/// # Errors
/// The index is no whole number or out of range, or the value has no elements.
pub fn index(value: &Value, index: &Value) -> Result<Value, String> {
    let at = index.integer()?;
    let found = usize::try_from(at).ok().and_then(|at| match value {
        Value::List(elements) => elements.get(at).cloned(),
        Value::Pose(pose) => pose.get(at).map(|element| Value::Float(*element)),
        Value::Struct(members) => members.get(at).map(|(_, member)| member.clone()),
        _ => None,
    });
    found.ok_or_else(|| match value {
        Value::List(elements) => {
            format!("index {at} is out of range, the list has {} elements", elements.len())
        }
        Value::Pose(_) => format!("index {at} is out of range, a pose has 6 elements"),
        Value::Struct(members) => {
            format!("index {at} is out of range, the struct has {} members", members.len())
        }
        other => format!("{} has no elements", other.type_name()),
    })
}

/// `value.name`.
///
/// # Errors
/// The value is no struct, or the struct has no member of this name.
pub fn member(value: &Value, name: &str) -> Result<Value, String> {
    let Value::Struct(members) = value else {
        return Err(format!("{} has no members", value.type_name()));
    };
    let found = members.iter().find(|(member, _)| &**member == name);
    found.map(|(_, value)| value.clone()).ok_or_else(|| format!("the struct has no member `{name}`"))
}

/// One evaluated step into a value.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// `[i]`
    Index(Value),
    /// `.name`
    Member(Arc<str>),
}

/// Replaces the part of `target` that `path` leads to.
///
/// # Errors
/// When it leads nowhere, or the value does not fit.
pub fn replace(target: &mut Value, path: &[Step], value: Value) -> Result<(), String> {
    if let (Some((Step::Index(at), before)), true) = (path.split_last(), !path.is_empty())
        && let Value::Pose(pose) = part(target, before)?
    {
        let at = at.integer()?;
        let element = usize::try_from(at).ok().and_then(|at| pose.get_mut(at));
        *element.ok_or_else(|| format!("index {at} is out of range, a pose has 6 elements"))? =
            value.number()?;
        return Ok(());
    }
    assign(part(target, path)?, value)
}

/// The part of `target` that `path` leads to.
///
/// # Errors
/// When it leads nowhere.
pub fn part<'a>(target: &'a mut Value, path: &[Step]) -> Result<&'a mut Value, String> {
    let mut here = target;
    for step in path {
        here = match (step, here) {
            (Step::Index(at), Value::List(elements)) => {
                let (at, count) = (at.integer()?, elements.len());
                let element = usize::try_from(at).ok().and_then(|at| Arc::make_mut(elements).get_mut(at));
                element.ok_or_else(|| format!("index {at} is out of range, the list has {count} elements"))?
            }
            (Step::Index(at), Value::Struct(members)) => {
                let (at, count) = (at.integer()?, members.len());
                let member = usize::try_from(at).ok().and_then(|at| Arc::make_mut(members).get_mut(at));
                let missing = || format!("index {at} is out of range, the struct has {count} members");
                &mut member.ok_or_else(missing)?.1
            }
            (Step::Member(name), Value::Struct(members)) => {
                let found = Arc::make_mut(members).iter_mut().find(|(member, _)| member == name);
                &mut found.ok_or_else(|| format!("the struct has no member `{name}`"))?.1
            }
            (_, other) => return Err(format!("cannot assign into {}", other.type_name())),
        };
    }
    Ok(here)
}

/// Gives a variable that has a value a new one. A list keeps its capacity, which the new elements must fit
/// into; a struct of members of one type becomes a list where one of that type was (script manual, 4.1.1 and
/// 4.2).
///
/// # Errors
/// When a list is longer than the capacity of the one it replaces, or a struct is no list.
pub fn assign(target: &mut Value, value: Value) -> Result<(), String> {
    let Value::List(old) = &*target else {
        *target = value;
        return Ok(());
    };
    let capacity = old.capacity();
    let mut new = match value {
        Value::List(list) => list,
        Value::Struct(members) => {
            let first = old.first().or(members.first().map(|(_, member)| member));
            if !members.iter().all(|(_, member)| first.is_none_or(|first| same_type(first, member))) {
                return Err("only a struct whose members have the list's type becomes a list".to_owned());
            }
            Arc::new(List::from(members.iter().map(|(_, member)| member.clone()).collect::<Vec<_>>()))
        }
        other => {
            *target = other;
            return Ok(());
        }
    };
    if new.len() > capacity {
        let length = new.len();
        return Err(format!("a list of {length} elements does not fit into one of capacity {capacity}"));
    }
    // Elements are only copied where the two differ: a list of the same capacity is shared until one is
    // changed.
    if new.capacity() != capacity {
        Arc::make_mut(&mut new).set_capacity(capacity);
    }
    *target = Value::List(new);
    Ok(())
}

fn same_type(a: &Value, b: &Value) -> bool {
    a.as_number().is_some() && b.as_number().is_some() || a.type_name() == b.type_name()
}
