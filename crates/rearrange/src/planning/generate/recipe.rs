//! What is generated: scenario, number of objects, density, law of the side ratios, and on which table.
//!
//! In: words of the command line. Out: a [`Recipe`], not checked yet.

use crate::document::word::{UnknownWord, named};
use crate::tabletop::instance::Workspace;
use std::fmt;
use std::str::FromStr;

/// The table of every generated instance, m.
pub const TABLE: Workspace = Workspace { width: 1.0, height: 1.0 };

/// A scenario of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Scenario {
    /// Ellipses and rectangles of random area and side ratio.
    Rand,
    /// Two large squares and many small ones, of a ninth of their area.
    Sq,
}

impl Scenario {
    /// Both.
    pub const ALL: [Scenario; 2] = [Scenario::Rand, Scenario::Sq];

    /// The word on the command line and in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            Scenario::Rand => "rand",
            Scenario::Sq => "sq",
        }
    }
}

impl fmt::Display for Scenario {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Scenario {
    type Err = UnknownWord;

    fn from_str(word: &str) -> Result<Scenario, UnknownWord> {
        named(word, &Scenario::ALL, Scenario::as_str)
    }
}

/// How side ratios are drawn in RAND; the two differ in distribution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RatioLaw {
    /// As the paper writes: longer side over shorter side, uniform in [1, 3].
    Paper,
    /// As the published instances were made: side over other side, uniform in [0.33, 1]. More near-squares.
    Public,
}

impl RatioLaw {
    /// Both.
    pub const ALL: [RatioLaw; 2] = [RatioLaw::Paper, RatioLaw::Public];

    /// The word on the command line and in files.
    pub fn as_str(self) -> &'static str {
        match self {
            RatioLaw::Paper => "paper",
            RatioLaw::Public => "public",
        }
    }
}

impl fmt::Display for RatioLaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for RatioLaw {
    type Err = UnknownWord;

    fn from_str(word: &str) -> Result<RatioLaw, UnknownWord> {
        named(word, &RatioLaw::ALL, RatioLaw::as_str)
    }
}

/// What is generated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recipe {
    /// RAND or SQ.
    pub scenario: Scenario,
    /// Number of objects; at least 3 for SQ.
    pub objects: usize,
    /// Share of the table that the objects cover, over 0 and under 1.
    pub density: f64,
    /// Law of the side ratios; SQ has none and ignores it.
    pub ratios: RatioLaw,
}
