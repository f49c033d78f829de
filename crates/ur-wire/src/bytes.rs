//! Big-endian fields: a reader that reports what was missing where, a writer, and the error of all codecs.
//!
//! In: a package's bytes. Out: numbers and short texts. Every binary UR socket is big-endian; every length
//! in a package is checked against what is there before it is used.

use serde::{Deserialize, Serialize};

/// Why bytes of a peer could not be read. Offsets count from the start of the slice that was decoded: for
/// RTDE and the primary interface the first byte after the package header, or after a sub-package's header.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The package ends inside a field.
    #[error("{field} at offset {offset} needs {needed} bytes, {left} are left")]
    Truncated {
        /// Name of the field as the vendor's guide has it.
        field: &'static str,
        /// Where the field starts.
        offset: usize,
        /// Bytes the field takes.
        needed: usize,
        /// Bytes that were left.
        left: usize,
    },
    /// A field holds something that it cannot hold.
    #[error("{field} at offset {offset} is {found}, expected {expected}")]
    Unexpected {
        /// Name of the field.
        field: &'static str,
        /// Where the field starts.
        offset: usize,
        /// What was there, printed.
        found: String,
        /// What may be there.
        expected: &'static str,
    },
    /// A length that no package of this protocol can have; framing is lost.
    #[error("package length at offset 0 is {found}, expected {min} to {max}")]
    Length {
        /// The length read.
        found: i64,
        /// Smallest legal length, header included.
        min: usize,
        /// Largest legal length, header included.
        max: usize,
    },
    /// A package type this protocol does not have in this direction.
    #[error("package type {found} is unknown in this direction")]
    UnknownType {
        /// The type byte.
        found: u8,
    },
    /// Bytes follow the last field.
    #[error("{left} bytes follow the last field at offset {offset}")]
    Leftover {
        /// Where the last field ended.
        offset: usize,
        /// How many bytes follow.
        left: usize,
    },
    /// A line without an end.
    #[error("line is longer than {max} bytes")]
    LineTooLong {
        /// The bound.
        max: usize,
    },
}

/// Reads fields one after the other from a slice.
pub struct Reader<'a> {
    bytes: &'a [u8],
    offset: usize,
}

impl<'a> Reader<'a> {
    /// Starts at the first byte.
    pub fn new(bytes: &'a [u8]) -> Reader<'a> {
        Reader { bytes, offset: 0 }
    }

    /// Where the next field starts.
    pub fn offset(&self) -> usize {
        self.offset
    }

    /// Bytes not read yet.
    pub fn left(&self) -> usize {
        self.bytes.len() - self.offset
    }

    /// The next `count` bytes.
    ///
    /// # Errors
    /// Fewer than `count` bytes are left ([`WireError::Truncated`]).
    pub fn bytes(&mut self, field: &'static str, count: usize) -> Result<&'a [u8], WireError> {
        let taken = self.offset.checked_add(count).and_then(|end| self.bytes.get(self.offset..end));
        let Some(taken) = taken else {
            return Err(WireError::Truncated {
                field,
                offset: self.offset,
                needed: count,
                left: self.left(),
            });
        };
        self.offset += count;
        Ok(taken)
    }

    /// Everything that is left.
    pub fn rest(&mut self) -> &'a [u8] {
        let rest = self.bytes.get(self.offset..).unwrap_or_default();
        self.offset = self.bytes.len();
        rest
    }

    /// Everything that is left, as text; bytes that are not UTF-8 are replaced, as it is for people only.
    pub fn rest_text(&mut self) -> String {
        String::from_utf8_lossy(self.rest()).into_owned()
    }

    /// A length byte and that many bytes of text.
    ///
    /// # Errors
    /// No length byte is left, or fewer bytes follow than it counts ([`WireError::Truncated`]).
    pub fn short_text(&mut self, field: &'static str) -> Result<String, WireError> {
        let length = usize::from(self.u8(field)?);
        Ok(String::from_utf8_lossy(self.bytes(field, length)?).into_owned())
    }

    /// `N` fields of one kind.
    ///
    /// # Errors
    /// `field` fails; its first error is passed on.
    pub fn array<T: Copy + Default, const N: usize>(
        &mut self,
        mut field: impl FnMut(&mut Reader<'a>) -> Result<T, WireError>,
    ) -> Result<[T; N], WireError> {
        let mut values = [T::default(); N];
        for value in &mut values {
            *value = field(self)?;
        }
        Ok(values)
    }

    /// 0 or 1.
    ///
    /// # Errors
    /// The byte is neither 0 nor 1 ([`WireError::Unexpected`]), or no byte is left
    /// ([`WireError::Truncated`]).
    pub fn bool(&mut self, field: &'static str) -> Result<bool, WireError> {
        let offset = self.offset;
        match self.u8(field)? {
            0 => Ok(false),
            1 => Ok(true),
            other => {
                Err(WireError::Unexpected { field, offset, found: other.to_string(), expected: "0 or 1" })
            }
        }
    }

    /// Nothing may follow.
    ///
    /// # Errors
    /// Bytes are left ([`WireError::Leftover`]).
    pub fn finish(&self) -> Result<(), WireError> {
        match self.left() {
            0 => Ok(()),
            left => Err(WireError::Leftover { offset: self.offset, left }),
        }
    }
}

macro_rules! numbers {
    ($($name:ident: $kind:ty),*) => {
        impl Reader<'_> {
            $(
                /// A big-endian number.
                ///
                /// # Errors
                /// Fewer bytes are left than the number takes ([`WireError::Truncated`]).
                pub fn $name(&mut self, field: &'static str) -> Result<$kind, WireError> {
                    let mut raw = [0; size_of::<$kind>()];
                    raw.copy_from_slice(self.bytes(field, size_of::<$kind>())?);
                    Ok(<$kind>::from_be_bytes(raw))
                }
            )*
        }

        impl Writer {
            $(
                /// A big-endian number.
                pub fn $name(&mut self, value: $kind) -> &mut Writer {
                    self.0.extend_from_slice(&value.to_be_bytes());
                    self
                }
            )*
        }
    };
}

numbers!(u8: u8, i8: i8, u16: u16, u32: u32, i32: i32, u64: u64, f32: f32, f64: f64);

/// Collects fields one after the other.
#[derive(Default)]
pub struct Writer(Vec<u8>);

impl Writer {
    /// Empty.
    pub fn new() -> Writer {
        Writer::default()
    }

    /// Raw bytes.
    pub fn bytes(&mut self, bytes: &[u8]) -> &mut Writer {
        self.0.extend_from_slice(bytes);
        self
    }

    /// 0 or 1.
    pub fn bool(&mut self, value: bool) -> &mut Writer {
        self.u8(u8::from(value))
    }

    /// Several doubles.
    pub fn f64s(&mut self, values: &[f64]) -> &mut Writer {
        for value in values {
            self.f64(*value);
        }
        self
    }

    /// A length byte and at most 255 bytes of text, cut at a character.
    pub fn short_text(&mut self, text: &str) -> &mut Writer {
        let cut = cut_text(text, 255);
        self.u8(cut.len() as u8).bytes(cut.as_bytes())
    }

    /// What was collected.
    pub fn finish(self) -> Vec<u8> {
        self.0
    }
}

/// The longest start of `text` that has at most `max` bytes and ends with a whole character.
pub fn cut_text(text: &str, max: usize) -> &str {
    let mut end = text.len().min(max);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    &text[..end]
}

/// Bytes that arrived but do not make a whole package yet. Taking from the front is cheap: the consumed
/// part is dropped only once it is the larger half.
#[derive(Debug, Default, Deserialize, Serialize)]
pub struct Pending {
    bytes: Vec<u8>,
    start: usize,
}

impl Pending {
    /// Appends what arrived.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.start > 0 && self.start * 2 >= self.bytes.len() {
            self.bytes.drain(..self.start);
            self.start = 0;
        }
        self.bytes.extend_from_slice(bytes);
    }

    /// What is waiting.
    pub fn waiting(&self) -> &[u8] {
        self.bytes.get(self.start..).unwrap_or_default()
    }

    /// Takes the first `count` bytes; `None` if there are fewer.
    pub fn take(&mut self, count: usize) -> Option<&[u8]> {
        let from = self.start;
        let to = from.checked_add(count)?;
        let taken = self.bytes.get(from..to)?;
        self.start = to;
        Some(taken)
    }

    /// Forgets everything: after an error in the framing nothing that follows can be trusted.
    pub fn clear(&mut self) {
        self.bytes.clear();
        self.start = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_field_is_named_with_its_place() {
        let mut reader = Reader::new(&[0, 1, 2]);
        assert_eq!(reader.u16("size").unwrap(), 1);
        let error = reader.u32("timestamp").unwrap_err();
        assert_eq!(error.to_string(), "timestamp at offset 2 needs 4 bytes, 1 are left");
        assert!(reader.bytes("huge", usize::MAX).is_err());
        assert_eq!(reader.u8("last").unwrap(), 2);
        reader.finish().unwrap();
    }

    #[test]
    fn text_is_cut_at_a_character() {
        assert_eq!(cut_text("abc", 2), "ab");
        assert_eq!(cut_text("a\u{e9}b", 2), "a");
    }

    #[test]
    fn pending_bytes_survive_any_slicing() {
        let mut pending = Pending::default();
        let mut out = Vec::new();
        for chunk in (0u8..=255).collect::<Vec<_>>().chunks(7) {
            pending.push(chunk);
            while let Some(two) = pending.take(2) {
                out.extend_from_slice(two);
            }
        }
        assert_eq!(out, (0u8..=255).collect::<Vec<_>>());
        assert!(pending.waiting().is_empty());
    }
}
