//! Values of RTDE variables: types, their encoding, and recipes (the agreed order of fields in a package).
//!
//! In: a recipe and the bytes of a data package. Out: typed values, and bytes again. Source: the vendor's
//! RTDE guide, table of types; fields follow each other without padding.

use crate::bytes::{Reader, WireError, Writer};
use serde::{Deserialize, Serialize};

/// Type of a variable, with the token that set-up replies use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize, Serialize)]
pub enum VariableType {
    /// BOOL, one byte 0 or 1.
    Bool,
    /// UINT8.
    Uint8,
    /// UINT32.
    Uint32,
    /// INT32.
    Int32,
    /// UINT64.
    Uint64,
    /// DOUBLE, IEEE 754.
    Double,
    /// VECTOR3D, three doubles.
    Vector3D,
    /// VECTOR6D, six doubles.
    Vector6D,
    /// VECTOR6INT32.
    Vector6Int32,
    /// VECTOR6UINT32.
    Vector6Uint32,
}

impl VariableType {
    /// Every type.
    pub const ALL: [VariableType; 10] = [
        VariableType::Bool,
        VariableType::Uint8,
        VariableType::Uint32,
        VariableType::Int32,
        VariableType::Uint64,
        VariableType::Double,
        VariableType::Vector3D,
        VariableType::Vector6D,
        VariableType::Vector6Int32,
        VariableType::Vector6Uint32,
    ];

    /// The token in set-up replies.
    pub fn token(self) -> &'static str {
        match self {
            VariableType::Bool => "BOOL",
            VariableType::Uint8 => "UINT8",
            VariableType::Uint32 => "UINT32",
            VariableType::Int32 => "INT32",
            VariableType::Uint64 => "UINT64",
            VariableType::Double => "DOUBLE",
            VariableType::Vector3D => "VECTOR3D",
            VariableType::Vector6D => "VECTOR6D",
            VariableType::Vector6Int32 => "VECTOR6INT32",
            VariableType::Vector6Uint32 => "VECTOR6UINT32",
        }
    }

    /// Bytes of a value.
    pub fn size(self) -> usize {
        match self {
            VariableType::Bool | VariableType::Uint8 => 1,
            VariableType::Uint32 | VariableType::Int32 => 4,
            VariableType::Uint64 | VariableType::Double => 8,
            VariableType::Vector3D | VariableType::Vector6Int32 | VariableType::Vector6Uint32 => 24,
            VariableType::Vector6D => 48,
        }
    }

    /// What a register or field of this type holds before the first write.
    pub fn zero(self) -> Value {
        match self {
            VariableType::Bool => Value::Bool(false),
            VariableType::Uint8 => Value::Uint8(0),
            VariableType::Uint32 => Value::Uint32(0),
            VariableType::Int32 => Value::Int32(0),
            VariableType::Uint64 => Value::Uint64(0),
            VariableType::Double => Value::Double(0.0),
            VariableType::Vector3D => Value::Vector3D([0.0; 3]),
            VariableType::Vector6D => Value::Vector6D([0.0; 6]),
            VariableType::Vector6Int32 => Value::Vector6Int32([0; 6]),
            VariableType::Vector6Uint32 => Value::Vector6Uint32([0; 6]),
        }
    }
}

/// One entry of a set-up reply: the variable's type, or why it cannot be had.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Offer {
    /// The variable exists and has this type.
    Type(VariableType),
    /// This controller has no variable of that name.
    NotFound,
    /// Another RTDE client or a field bus writes this input.
    InUse,
}

impl Offer {
    /// The token in set-up replies.
    pub fn token(self) -> &'static str {
        match self {
            Offer::Type(kind) => kind.token(),
            Offer::NotFound => "NOT_FOUND",
            Offer::InUse => "IN_USE",
        }
    }

    /// The offer of a token; `None` for a token that the guide does not have.
    pub fn from_token(token: &str) -> Option<Offer> {
        match token {
            "NOT_FOUND" => Some(Offer::NotFound),
            "IN_USE" => Some(Offer::InUse),
            other => VariableType::ALL.into_iter().find(|kind| kind.token() == other).map(Offer::Type),
        }
    }
}

/// A variable's value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// BOOL.
    Bool(bool),
    /// UINT8.
    Uint8(u8),
    /// UINT32.
    Uint32(u32),
    /// INT32.
    Int32(i32),
    /// UINT64.
    Uint64(u64),
    /// DOUBLE.
    Double(f64),
    /// VECTOR3D.
    Vector3D([f64; 3]),
    /// VECTOR6D.
    Vector6D([f64; 6]),
    /// VECTOR6INT32.
    Vector6Int32([i32; 6]),
    /// VECTOR6UINT32.
    Vector6Uint32([u32; 6]),
}

impl Value {
    /// The value's type.
    pub fn kind(&self) -> VariableType {
        match self {
            Value::Bool(_) => VariableType::Bool,
            Value::Uint8(_) => VariableType::Uint8,
            Value::Uint32(_) => VariableType::Uint32,
            Value::Int32(_) => VariableType::Int32,
            Value::Uint64(_) => VariableType::Uint64,
            Value::Double(_) => VariableType::Double,
            Value::Vector3D(_) => VariableType::Vector3D,
            Value::Vector6D(_) => VariableType::Vector6D,
            Value::Vector6Int32(_) => VariableType::Vector6Int32,
            Value::Vector6Uint32(_) => VariableType::Vector6Uint32,
        }
    }

    /// The doubles in it, none if it is of another type.
    pub fn doubles(&self) -> &[f64] {
        match self {
            Value::Double(value) => std::slice::from_ref(value),
            Value::Vector3D(values) => values,
            Value::Vector6D(values) => values,
            Value::Bool(_)
            | Value::Uint8(_)
            | Value::Uint32(_)
            | Value::Int32(_)
            | Value::Uint64(_)
            | Value::Vector6Int32(_)
            | Value::Vector6Uint32(_) => &[],
        }
    }

    /// False if a double in it is NaN or infinite.
    pub fn is_finite(&self) -> bool {
        self.doubles().iter().all(|value| value.is_finite())
    }

    /// Appends the value's bytes.
    pub fn encode(&self, out: &mut Writer) {
        match self {
            Value::Bool(value) => out.bool(*value),
            Value::Uint8(value) => out.u8(*value),
            Value::Uint32(value) => out.u32(*value),
            Value::Int32(value) => out.i32(*value),
            Value::Uint64(value) => out.u64(*value),
            Value::Double(value) => out.f64(*value),
            Value::Vector3D(values) => out.f64s(values),
            Value::Vector6D(values) => out.f64s(values),
            Value::Vector6Int32(values) => values.iter().fold(out, |out, value| out.i32(*value)),
            Value::Vector6Uint32(values) => values.iter().fold(out, |out, value| out.u32(*value)),
        };
    }

    /// Reads a value of a given type.
    ///
    /// # Errors
    /// Fewer bytes are left than the type takes, or a BOOL is neither 0 nor 1.
    pub fn decode(kind: VariableType, reader: &mut Reader) -> Result<Value, WireError> {
        Ok(match kind {
            VariableType::Bool => Value::Bool(reader.bool("BOOL")?),
            VariableType::Uint8 => Value::Uint8(reader.u8("UINT8")?),
            VariableType::Uint32 => Value::Uint32(reader.u32("UINT32")?),
            VariableType::Int32 => Value::Int32(reader.i32("INT32")?),
            VariableType::Uint64 => Value::Uint64(reader.u64("UINT64")?),
            VariableType::Double => Value::Double(reader.f64("DOUBLE")?),
            VariableType::Vector3D => Value::Vector3D(reader.array(|r| r.f64("VECTOR3D"))?),
            VariableType::Vector6D => Value::Vector6D(reader.array(|r| r.f64("VECTOR6D"))?),
            VariableType::Vector6Int32 => Value::Vector6Int32(reader.array(|r| r.i32("VECTOR6INT32"))?),
            VariableType::Vector6Uint32 => Value::Vector6Uint32(reader.array(|r| r.u32("VECTOR6UINT32"))?),
        })
    }
}

/// A recipe that client and controller agreed on: an id and the types of its fields in order. Id 0 means
/// "refused" on the wire and is not a recipe.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct Recipe {
    /// Id in data packages, 1 to 255.
    pub id: u8,
    /// Names and types in order.
    pub fields: Vec<(String, VariableType)>,
}

/// What to do with bytes behind the last field of a data package.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Leftover {
    /// An error: what a client expects of a controller, whose packages always fit the recipe.
    Refuse,
    /// Ignored: what a controller does with the packages of clients, some of which append bytes.
    Ignore,
}

/// Why values do not fit a recipe (a mistake of the caller, not of a peer).
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RecipeError {
    /// Another number of values than fields.
    #[error("recipe {recipe} has {fields} fields, {values} values were given")]
    Count {
        /// Recipe id.
        recipe: u8,
        /// Fields of the recipe.
        fields: usize,
        /// Values given.
        values: usize,
    },
    /// A value of the wrong type.
    #[error("field {name} of recipe {recipe} is {expected:?}, the value is {found:?}")]
    Type {
        /// Recipe id.
        recipe: u8,
        /// Field name.
        name: String,
        /// Type in the recipe.
        expected: VariableType,
        /// Type of the value.
        found: VariableType,
    },
}

impl Recipe {
    /// Bytes of all fields, without the recipe id.
    pub fn size(&self) -> usize {
        self.fields.iter().map(|(_, kind)| kind.size()).sum()
    }

    /// Packs values into the bytes that follow the recipe id.
    ///
    /// # Errors
    /// There are more or fewer values than fields ([`RecipeError::Count`]), or a value has another type than
    /// its field ([`RecipeError::Type`]).
    pub fn encode(&self, values: &[Value]) -> Result<Vec<u8>, RecipeError> {
        if values.len() != self.fields.len() {
            let (fields, values) = (self.fields.len(), values.len());
            return Err(RecipeError::Count { recipe: self.id, fields, values });
        }
        let mut out = Writer::new();
        for ((name, kind), value) in self.fields.iter().zip(values) {
            if value.kind() != *kind {
                let (name, expected, found) = (name.clone(), *kind, value.kind());
                return Err(RecipeError::Type { recipe: self.id, name, expected, found });
            }
            value.encode(&mut out);
        }
        Ok(out.finish())
    }

    /// Unpacks the bytes that follow the recipe id.
    ///
    /// # Errors
    /// The payload ends inside a field, a BOOL is neither 0 nor 1, or bytes are left over that `leftover`
    /// refuses.
    pub fn decode(&self, payload: &[u8], leftover: Leftover) -> Result<Vec<Value>, WireError> {
        let mut reader = Reader::new(payload);
        let values = self
            .fields
            .iter()
            .map(|(_, kind)| Value::decode(*kind, &mut reader))
            .collect::<Result<_, _>>()?;
        match leftover {
            Leftover::Refuse => reader.finish()?,
            Leftover::Ignore => {}
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn recipe() -> Recipe {
        let fields = VariableType::ALL.iter().map(|kind| (kind.token().to_lowercase(), *kind)).collect();
        Recipe { id: 3, fields }
    }

    fn values() -> Vec<Value> {
        vec![
            Value::Bool(true),
            Value::Uint8(7),
            Value::Uint32(0xdead_beef),
            Value::Int32(-2),
            Value::Uint64(1 << 40),
            Value::Double(-1.5),
            Value::Vector3D([1.0, 2.0, 3.0]),
            Value::Vector6D([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]),
            Value::Vector6Int32([-1, 2, -3, 4, -5, 6]),
            Value::Vector6Uint32([1, 2, 3, 4, 5, u32::MAX]),
        ]
    }

    #[test]
    fn all_types_survive_the_wire() {
        let payload = recipe().encode(&values()).unwrap();
        assert_eq!(payload.len(), recipe().size());
        assert_eq!(recipe().decode(&payload, Leftover::Refuse).unwrap(), values());
    }

    #[test]
    fn leftovers_are_refused_or_ignored() {
        let mut payload = recipe().encode(&values()).unwrap();
        payload.extend_from_slice(&[0; 48]);
        assert!(matches!(
            recipe().decode(&payload, Leftover::Refuse),
            Err(WireError::Leftover { left: 48, .. })
        ));
        assert_eq!(recipe().decode(&payload, Leftover::Ignore).unwrap(), values());
    }

    #[test]
    fn wrong_values_are_refused_by_name() {
        let mut wrong = values();
        wrong[3] = Value::Uint32(1);
        assert!(recipe().encode(&wrong).unwrap_err().to_string().contains("int32"));
        assert!(matches!(recipe().encode(&wrong[..2]), Err(RecipeError::Count { .. })));
    }

    #[test]
    fn tokens_come_back() {
        for offer in VariableType::ALL.map(Offer::Type).into_iter().chain([Offer::NotFound, Offer::InUse]) {
            assert_eq!(Offer::from_token(offer.token()), Some(offer));
        }
        assert_eq!(Offer::from_token("VECTOR7D"), None);
        assert_eq!(VariableType::ALL.map(|kind| kind.zero().kind()), VariableType::ALL);
    }

    proptest! {
        #[test]
        fn foreign_payloads_never_panic(payload in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = recipe().decode(&payload, Leftover::Refuse);
            let _ = recipe().decode(&payload, Leftover::Ignore);
        }
    }
}
