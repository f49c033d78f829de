//! Built-ins on lists and matrices.
//!
//! In: arguments bound to parameters. Out: a value or the message of a runtime exception. A matrix is a list
//! of rows of equal length.

use crate::bounds::TOO_LARGE;
use crate::host::Call;
use crate::operators;
use crate::value::Value;
use nalgebra::DMatrix;

/// Largest matrix that is inverted: as much work as the largest product (`operators`).
const MAX_INVERTED: usize = 100;

/// Longest list that `make_list` builds.
const MAX_LENGTH: i32 = 100_000;

/// Carries out a built-in of this file; `None` if it is none of them.
pub fn call(call: &Call<'_>) -> Option<Result<Value, String>> {
    Some(match call.name {
        "length" | "size" | "get_list_length" => length(call),
        "norm" => norm(call),
        "normalize" => normalize(call),
        "dot" => dot(call),
        "cross" => cross(call),
        "sum" => sum(call),
        "make_list" => make_list(call),
        "inv" => inverse(call),
        "transpose" => transpose(call),
        "integer_to_binary_list" => call
            .required(0)
            .and_then(Value::integer)
            .map(|bits| Value::list((0..32).map(|bit| Value::Bool(bits & (1 << bit) != 0)).collect())),
        "binary_list_to_integer" => bits(call),
        _ => return None,
    })
}

fn length(call: &Call<'_>) -> Result<Value, String> {
    let count = match call.required(0)? {
        Value::List(elements) => match (call.name, elements.first()) {
            ("size", Some(Value::List(row))) => {
                return Ok(Value::list(vec![count_value(elements.len())?, count_value(row.len())?]));
            }
            _ => elements.len(),
        },
        Value::Pose(_) => 6,
        Value::Text(text) => text.chars().count(),
        other => return Err(format!("{} has no length", other.type_name())),
    };
    count_value(count)
}

fn count_value(count: usize) -> Result<Value, String> {
    i32::try_from(count).map(Value::Int).map_err(|_| "the list is too long".to_owned())
}

fn norm(call: &Call<'_>) -> Result<Value, String> {
    match call.required(0)? {
        Value::Int(value) => Ok(Value::Int(value.wrapping_abs())),
        Value::Float(value) => Ok(Value::Float(value.abs())),
        other => Ok(Value::Float(other.number_list()?.iter().map(|x| x * x).sum::<f64>().sqrt())),
    }
}

fn normalize(call: &Call<'_>) -> Result<Value, String> {
    let numbers = call.required(0)?.number_list()?;
    let norm = numbers.iter().map(|x| x * x).sum::<f64>().sqrt();
    if norm == 0.0 {
        return Err("a vector of zeros has no direction".to_owned());
    }
    Ok(Value::numbers(numbers.into_iter().map(|x| x / norm)))
}

fn dot(call: &Call<'_>) -> Result<Value, String> {
    let (a, b) = (call.required(0)?.number_list()?, call.required(1)?.number_list()?);
    if a.len() != b.len() {
        return Err(format!("lists of {} and {} elements cannot be combined", a.len(), b.len()));
    }
    Ok(Value::Float(a.iter().zip(&b).map(|(a, b)| a * b).sum()))
}

fn cross(call: &Call<'_>) -> Result<Value, String> {
    let [a, b] = [call.required(0)?.array::<3>()?, call.required(1)?.array::<3>()?];
    Ok(Value::numbers([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]))
}

fn sum(call: &Call<'_>) -> Result<Value, String> {
    let add = |total: Value, value: &Value| operators::binary(crate::ast::Binary::Add, &total, value);
    call.required(0)?.elements()?.iter().try_fold(Value::Int(0), add)
}

fn make_list(call: &Call<'_>) -> Result<Value, String> {
    let length = call.required(0)?.integer()?;
    if !(0..=MAX_LENGTH).contains(&length) {
        return Err(format!("a list of {length} elements cannot be made"));
    }
    let capacity = call.argument(2).map_or(Ok(length), Value::integer)?;
    if !(length..=MAX_LENGTH).contains(&capacity) {
        return Err(format!("a list of {length} elements cannot have a capacity of {capacity}"));
    }
    let elements = vec![call.required(1)?.clone(); length.unsigned_abs() as usize];
    Ok(Value::list_of_capacity(elements, capacity.unsigned_abs() as usize))
}

fn matrix(call: &Call<'_>) -> Result<DMatrix<f64>, String> {
    let rows: Vec<Vec<f64>> =
        call.required(0)?.elements()?.iter().map(Value::number_list).collect::<Result<_, String>>()?;
    let width = rows.first().map_or(0, Vec::len);
    if width == 0 || rows.iter().any(|row| row.len() != width) {
        return Err("expected a matrix with rows of equal length".to_owned());
    }
    Ok(DMatrix::from_row_iterator(rows.len(), width, rows.into_iter().flatten()))
}

fn rows(matrix: &DMatrix<f64>) -> Value {
    Value::list(matrix.row_iter().map(|row| Value::numbers(row.iter().copied())).collect())
}

/// A vector is a row: it becomes a column of rows of one element, and such a column a vector.
fn transpose(call: &Call<'_>) -> Result<Value, String> {
    let elements = call.required(0)?.elements()?;
    if elements.iter().all(|element| element.as_number().is_some()) {
        return Ok(Value::list(elements.iter().map(|element| Value::list(vec![element.clone()])).collect()));
    }
    let turned = matrix(call)?.transpose();
    Ok(match turned.nrows() {
        1 => Value::numbers(turned.iter().copied()),
        _ => rows(&turned),
    })
}

fn inverse(call: &Call<'_>) -> Result<Value, String> {
    if let pose @ Value::Pose(_) = call.required(0)? {
        return crate::pose_library::inverse(pose);
    }
    let matrix = matrix(call)?;
    if !matrix.is_square() {
        return Err("only a square matrix has an inverse".to_owned());
    }
    if matrix.nrows() > MAX_INVERTED {
        return Err(TOO_LARGE.to_owned());
    }
    matrix.try_inverse().map(|inverse| rows(&inverse)).ok_or_else(|| "the matrix has no inverse".to_owned())
}

fn bits(call: &Call<'_>) -> Result<Value, String> {
    let list = call.required(0)?.elements()?;
    let mut whole = 0u32;
    for (bit, value) in list.iter().take(32).enumerate() {
        whole |= u32::from(value.truth()?) << bit;
    }
    Ok(Value::Int(whole as i32))
}
