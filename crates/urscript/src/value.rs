//! The values a script computes with, and their text.
//!
//! In and out: [`Value`]. Lists and structs are values, not references: assigning or passing one copies it
//! (the storage is shared until one side changes). A pose is six numbers, x y z in m and a rotation vector
//! in rad, and is its own type: it is not a list of six.

use std::sync::Arc;

/// Identity of a thread; 0 is never used, so scripts may start handles with 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ThreadId(pub i32);

/// A value of the language.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// What a function without `return` gives back.
    Nothing,
    /// `True`, `False`.
    Bool(bool),
    /// 32 bit whole number; arithmetic wraps.
    Int(i32),
    /// Double precision number.
    Float(f64),
    /// Text.
    Text(Arc<str>),
    /// A list; a matrix is a list of lists.
    List(Arc<List>),
    /// A pose: m and rad.
    Pose([f64; 6]),
    /// A thread handle.
    Thread(ThreadId),
    /// Named members in the order they were given.
    Struct(Arc<Vec<(Arc<str>, Value)>>),
    /// A handle whose methods are calls to a server: its address.
    Remote(Arc<str>),
}

/// A list's elements, and how many it can hold. Lists are equal when their elements are.
#[derive(Clone, Debug)]
pub struct List {
    elements: Vec<Value>,
    capacity: usize,
}

impl List {
    /// Elements it can hold.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// Makes it hold as many, but not fewer than it has.
    pub fn set_capacity(&mut self, capacity: usize) {
        self.capacity = capacity.max(self.elements.len());
    }

    /// The elements, to add and to take away; what is added must fit.
    pub fn edit(&mut self) -> &mut Vec<Value> {
        &mut self.elements
    }
}

impl From<Vec<Value>> for List {
    fn from(elements: Vec<Value>) -> List {
        List { capacity: elements.len(), elements }
    }
}

impl std::ops::Deref for List {
    type Target = [Value];

    fn deref(&self) -> &[Value] {
        &self.elements
    }
}

impl std::ops::DerefMut for List {
    fn deref_mut(&mut self) -> &mut [Value] {
        &mut self.elements
    }
}

impl PartialEq for List {
    fn eq(&self, other: &List) -> bool {
        self.elements == other.elements
    }
}

impl Value {
    /// A list of numbers.
    pub fn numbers(values: impl IntoIterator<Item = f64>) -> Value {
        Value::list(values.into_iter().map(Value::Float).collect())
    }

    /// A list that can hold as many elements as it has.
    pub fn list(values: Vec<Value>) -> Value {
        let capacity = values.len();
        Value::list_of_capacity(values, capacity)
    }

    /// A list that can hold `capacity` elements.
    pub fn list_of_capacity(elements: Vec<Value>, capacity: usize) -> Value {
        Value::List(Arc::new(List { capacity: capacity.max(elements.len()), elements }))
    }

    /// Text.
    pub fn text(text: impl Into<Arc<str>>) -> Value {
        Value::Text(text.into())
    }

    /// What messages call this value's type.
    pub fn type_name(&self) -> &'static str {
        match self {
            Value::Nothing => "nothing",
            Value::Bool(_) => "bool",
            Value::Int(_) => "int",
            Value::Float(_) => "float",
            Value::Text(_) => "string",
            Value::List(_) => "list",
            Value::Pose(_) => "pose",
            Value::Thread(_) => "thread",
            Value::Struct(_) => "struct",
            Value::Remote(_) => "handle",
        }
    }

    /// The number, if it is one.
    pub fn as_number(&self) -> Option<f64> {
        match self {
            Value::Int(value) => Some(f64::from(*value)),
            Value::Float(value) => Some(*value),
            _ => None,
        }
    }

    /// The number.
    ///
    /// # Errors
    /// Names the type that was found.
    pub fn number(&self) -> Result<f64, String> {
        self.as_number().ok_or_else(|| format!("expected a number, found {}", self.type_name()))
    }

    /// The whole number; a float counts if it has no fraction and fits.
    ///
    /// # Errors
    /// Names what was found instead.
    pub fn integer(&self) -> Result<i32, String> {
        match self {
            Value::Int(value) => Ok(*value),
            Value::Float(value) if value.fract() == 0.0 && value.abs() <= f64::from(i32::MAX) => {
                Ok(*value as i32)
            }
            Value::Float(value) => Err(format!("expected a whole number, found {value}")),
            other => Err(format!("expected a whole number, found {}", other.type_name())),
        }
    }

    /// The text.
    ///
    /// # Errors
    /// Names the type that was found.
    pub fn string(&self) -> Result<&Arc<str>, String> {
        match self {
            Value::Text(text) => Ok(text),
            other => Err(format!("expected a string, found {}", other.type_name())),
        }
    }

    /// The elements of a list.
    ///
    /// # Errors
    /// Names the type that was found.
    pub fn elements(&self) -> Result<&[Value], String> {
        match self {
            Value::List(elements) => Ok(elements),
            other => Err(format!("expected a list, found {}", other.type_name())),
        }
    }

    /// The numbers of a list or pose.
    ///
    /// # Errors
    /// Names the element or type that does not fit.
    pub fn number_list(&self) -> Result<Vec<f64>, String> {
        match self {
            Value::Pose(pose) => Ok(pose.to_vec()),
            other => other.elements()?.iter().map(Value::number).collect(),
        }
    }

    /// Exactly `N` numbers from a list or pose.
    ///
    /// # Errors
    /// Names the length or type that was found.
    pub fn array<const N: usize>(&self) -> Result<[f64; N], String> {
        let numbers = self.number_list()?;
        let count = numbers.len();
        numbers.try_into().map_err(|_| format!("expected {N} numbers, found {count}"))
    }

    /// The pose; a list of six numbers does not count as one.
    ///
    /// # Errors
    /// Names the type that was found.
    pub fn pose(&self) -> Result<[f64; 6], String> {
        match self {
            Value::Pose(pose) => Ok(*pose),
            other => Err(format!("expected a pose, found {}", other.type_name())),
        }
    }

    /// How it counts as a condition: numbers other than zero and living handles are true.
    ///
    /// # Errors
    /// Names the type that cannot be a condition.
    pub fn truth(&self) -> Result<bool, String> {
        match self {
            Value::Bool(value) => Ok(*value),
            Value::Int(value) => Ok(*value != 0),
            Value::Float(value) => Ok(*value != 0.0),
            Value::Thread(_) | Value::Remote(_) => Ok(true),
            other => Err(format!("expected a condition, found {}", other.type_name())),
        }
    }
}

impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Value::Nothing => f.write_str("None"),
            Value::Bool(true) => f.write_str("True"),
            Value::Bool(false) => f.write_str("False"),
            Value::Int(value) => write!(f, "{value}"),
            Value::Float(value) => write!(f, "{value}"),
            Value::Text(text) => f.write_str(text),
            Value::List(elements) => {
                f.write_str("[")?;
                write_separated(f, elements.iter())?;
                f.write_str("]")
            }
            Value::Pose(pose) => {
                f.write_str("p[")?;
                write_separated(f, pose.iter())?;
                f.write_str("]")
            }
            Value::Thread(id) => write!(f, "{}", id.0),
            Value::Remote(address) => f.write_str(address),
            Value::Struct(members) => {
                f.write_str("struct(")?;
                for (index, (name, value)) in members.iter().enumerate() {
                    write!(f, "{}{name} = {value}", if index == 0 { "" } else { ", " })?;
                }
                f.write_str(")")
            }
        }
    }
}

fn write_separated<T: std::fmt::Display>(
    f: &mut std::fmt::Formatter<'_>,
    items: impl Iterator<Item = T>,
) -> std::fmt::Result {
    for (index, item) in items.enumerate() {
        write!(f, "{}{item}", if index == 0 { "" } else { ", " })?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_what_a_script_would_write() {
        assert_eq!(Value::Bool(true).to_string(), "True");
        assert_eq!(Value::numbers([1.0, 0.5]).to_string(), "[1, 0.5]");
        assert_eq!(Value::Pose([0.1, 0.0, 0.0, 0.0, 3.25, 0.0]).to_string(), "p[0.1, 0, 0, 0, 3.25, 0]");
    }

    #[test]
    fn a_pose_is_not_a_list_but_both_give_numbers() {
        assert!(Value::numbers([0.0; 6]).pose().is_err());
        assert_eq!(Value::Pose([1.0; 6]).array::<6>(), Ok([1.0; 6]));
        assert!(Value::numbers([0.0; 5]).array::<6>().is_err());
    }
}
