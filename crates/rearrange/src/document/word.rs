//! The words by which files and the command line name the values of an enum.
//!
//! In: a word, the values there are, the word of each. Out: the value, or an [`UnknownWord`] that names the
//! words there are. `FromStr` of such an enum is one call of [`named`].

use std::fmt;

/// A word that names nothing here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownWord {
    /// The word.
    pub word: String,
    /// The words there are.
    pub known: Vec<&'static str>,
}

impl UnknownWord {
    /// What is wrong.
    pub fn message(&self) -> String {
        format!("{:?} is not known here", self.word)
    }

    /// What to write instead.
    pub fn help(&self) -> String {
        format!("one of: {}", self.known.join(", "))
    }
}

impl fmt::Display for UnknownWord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}; {}", self.message(), self.help())
    }
}

impl std::error::Error for UnknownWord {}

/// The value among `all` whose word is `word`.
///
/// # Errors
/// None has that word.
pub fn named<T: Copy>(word: &str, all: &[T], as_str: fn(T) -> &'static str) -> Result<T, UnknownWord> {
    let found = all.iter().copied().find(|value| as_str(*value) == word);
    found.ok_or_else(|| UnknownWord {
        word: word.to_owned(),
        known: all.iter().map(|value| as_str(*value)).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_word_gets_the_words_there_are() {
        let as_str = |small: bool| if small { "small" } else { "large" };
        assert_eq!(named("large", &[true, false], as_str), Ok(false));
        let unknown = named("huge", &[true, false], as_str).expect_err("no such word");
        assert_eq!(unknown.to_string(), "\"huge\" is not known here; one of: small, large");
    }
}
