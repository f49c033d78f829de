//! A located tree to typed values, with all complaints collected.
//!
//! In: [`Node`]s. Out: `Some(value)`, or `None` and a complaint kept in the [`Decoder`]; the caller goes on
//! with the next field either way, and calls [`Decoder::finish`] at the end. A [`At`] is a node with its
//! path (`objects[2].start`), a [`Fields`] is a map whose keys have been checked.

use std::ops::RangeInclusive;
use std::str::FromStr;

use crate::document::tree::{Entry, Node, Value};
use crate::document::word::UnknownWord;
use crate::document::{Diagnostic, Diagnostics, Location, parse_rest};

/// Most complaints kept; a file that is wrong everywhere need not fill a screen per object.
const MAX_COMPLAINTS: usize = 200;

/// Reads a whole file; `name` is for the complaints.
///
/// # Errors
/// Everything that is wrong with it.
pub fn read<T>(
    text: &str,
    name: &str,
    decode: impl FnOnce(&At, &mut Decoder) -> Option<T>,
) -> Result<T, Diagnostics> {
    let (node, mut decoder) = Decoder::open(text, name)?;
    let value = decode(&At::top(&node), &mut decoder);
    decoder.finish(value)
}

/// Collects complaints about one text.
#[derive(Debug)]
pub struct Decoder {
    source: String,
    complaints: Vec<Diagnostic>,
}

/// A node and its path.
#[derive(Clone, Debug)]
pub struct At<'n> {
    /// The node.
    pub node: &'n Node,
    /// Path from the top, empty there.
    pub path: String,
    /// Where a complaint about the whole should point: the key for a map's value, else the node.
    pub key_at: Location,
}

/// A map whose keys are all known.
#[derive(Clone, Debug)]
pub struct Fields<'n> {
    entries: &'n [Entry],
    path: String,
    at: Location,
}

impl<'n> At<'n> {
    /// The top of a text.
    pub fn top(node: &'n Node) -> At<'n> {
        At { node, path: String::new(), key_at: node.at }
    }
}

impl<'n> Fields<'n> {
    /// The value of an optional key; `null` counts as absent.
    pub fn optional(&self, key: &str) -> Option<At<'n>> {
        let entry = self.entries.iter().find(|entry| entry.key == key)?;
        (!entry.node.is_null()).then(|| At {
            node: &entry.node,
            path: join(&self.path, &entry.key),
            key_at: entry.key_at,
        })
    }

    /// The value of a key that has to be there.
    pub fn required(&self, key: &str, decoder: &mut Decoder) -> Option<At<'n>> {
        let found = self.optional(key);
        if found.is_none() {
            decoder.complain(self.at, &self.path, format!("key {key:?} is missing"), "add it");
        }
        found
    }

    /// Keys in the order of the text, with their places.
    pub fn keys(&self) -> impl Iterator<Item = (&'n str, Location)> + '_ {
        self.entries.iter().map(|entry| (entry.key.as_str(), entry.key_at))
    }

    /// Where the map begins.
    pub fn at(&self) -> Location {
        self.at
    }

    /// Path of the map.
    pub fn path(&self) -> &str {
        &self.path
    }
}

fn join(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_string() } else { format!("{path}.{key}") }
}

impl Decoder {
    /// A decoder for the text named `source`.
    pub fn new(source: impl Into<String>) -> Decoder {
        Decoder { source: source.into(), complaints: Vec::new() }
    }

    /// What can be read of a text, and a decoder that has the complaints about the rest: with them it never
    /// finishes with a value, but with everything that is wrong.
    ///
    /// # Errors
    /// Nothing of the text can be read; what is wrong.
    pub fn open(text: &str, source: &str) -> Result<(Node, Decoder), Diagnostics> {
        let (node, Diagnostics(complaints)) = parse_rest(text, source)?;
        Ok((node, Decoder { source: source.to_string(), complaints }))
    }

    /// Keeps a complaint.
    pub fn complain(
        &mut self,
        at: Location,
        path: &str,
        message: impl Into<String>,
        help: impl Into<String>,
    ) {
        if self.complaints.len() < MAX_COMPLAINTS {
            let (source, path) = (self.source.clone(), path.to_string());
            self.complaints.push(Diagnostic { source, at, path, message: message.into(), help: help.into() });
        }
    }

    /// Keeps a complaint about a value.
    pub fn complain_at(&mut self, at: &At, message: impl Into<String>, help: impl Into<String>) {
        self.complain(at.node.at, &at.path, message, help);
    }

    /// How many complaints there are so far.
    pub fn count(&self) -> usize {
        self.complaints.len()
    }

    /// The value if there is no complaint.
    ///
    /// # Errors
    /// All complaints, in the order of the text.
    pub fn finish<T>(mut self, value: Option<T>) -> Result<T, Diagnostics> {
        self.complaints.sort_by_key(|complaint| complaint.at);
        self.complaints.dedup();
        match value {
            Some(value) if self.complaints.is_empty() => Ok(value),
            Some(_) => Err(Diagnostics(self.complaints)),
            None => {
                if self.complaints.is_empty() {
                    self.complain(Location { line: 1, column: 1 }, "", "the file could not be read", "");
                }
                Err(Diagnostics(self.complaints))
            }
        }
    }

    /// A map with no other keys than `known`.
    pub fn map<'n>(&mut self, at: &At<'n>, known: &[&str]) -> Option<Fields<'n>> {
        let fields = self.open_map(at)?;
        for entry in fields.entries {
            if !known.contains(&entry.key.as_str()) {
                let help = match suggestion(&entry.key, known) {
                    Some(near) => format!("did you mean {near:?}?"),
                    None => format!("known keys: {}", known.join(", ")),
                };
                self.complain(entry.key_at, &join(&at.path, &entry.key), "unknown key", help);
            }
        }
        Some(fields)
    }

    /// A map with any keys.
    pub fn open_map<'n>(&mut self, at: &At<'n>) -> Option<Fields<'n>> {
        match &at.node.value {
            Value::Map(entries) => Some(Fields { entries, path: at.path.clone(), at: at.node.at }),
            Value::Scalar { .. } | Value::Sequence(_) | Value::Unread => {
                self.wrong_type(at, "a map of keys and values")
            }
        }
    }

    /// A list.
    pub fn sequence<'n>(&mut self, at: &At<'n>) -> Option<Vec<At<'n>>> {
        let Value::Sequence(items) = &at.node.value else { return self.wrong_type(at, "a list") };
        let item = |(index, node): (usize, &'n Node)| At {
            node,
            path: format!("{}[{index}]", at.path),
            key_at: node.at,
        };
        Some(items.iter().enumerate().map(item).collect())
    }

    /// Any finite number.
    pub fn number(&mut self, at: &At) -> Option<f64> {
        let Value::Scalar { text, quoted: false } = &at.node.value else {
            return self.wrong_type(at, "a number without quotes");
        };
        let special = matches!(text.to_ascii_lowercase().trim_start_matches(['+', '-']), ".nan" | ".inf");
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Some(number),
            Ok(_) => self.not_finite(at, text),
            Err(_) if special => self.not_finite(at, text),
            Err(_) => {
                let help = match unit_of(text) {
                    Some(unit) => format!("write the number alone, without {unit:?}"),
                    None => String::new(),
                };
                self.complain_at(at, format!("{text:?} is not a number"), help);
                None
            }
        }
    }

    fn not_finite<T>(&mut self, at: &At, text: &str) -> Option<T> {
        self.complain_at(at, format!("{text} is not a finite number"), "");
        None
    }

    /// A number within `range`; `unit` is for the message.
    pub fn number_in(&mut self, at: &At, range: RangeInclusive<f64>, unit: &str) -> Option<f64> {
        let number = self.number(at)?;
        if range.contains(&number) {
            return Some(number);
        }
        let (low, high) = (range.start(), range.end());
        let help = format!("it has to be between {low} and {}", with_unit(*high, unit));
        self.complain_at(at, format!("{} is out of range", with_unit(number, unit)), help);
        None
    }

    /// A number over 0.
    pub fn positive(&mut self, at: &At, unit: &str) -> Option<f64> {
        let number = self.number(at)?;
        if number > 0.0 {
            return Some(number);
        }
        self.complain_at(at, format!("{} is not over 0", with_unit(number, unit)), "");
        None
    }

    /// A number of at least 0.
    pub fn non_negative(&mut self, at: &At, unit: &str) -> Option<f64> {
        let number = self.number(at)?;
        if number >= 0.0 {
            return Some(number);
        }
        self.complain_at(at, format!("{} is below 0", with_unit(number, unit)), "");
        None
    }

    /// A whole number within `range`.
    pub fn integer(&mut self, at: &At, range: RangeInclusive<i64>) -> Option<i64> {
        let Value::Scalar { text, quoted: false } = &at.node.value else {
            return self.wrong_type(at, "a whole number without quotes");
        };
        match text.parse::<i64>() {
            Ok(number) if range.contains(&number) => Some(number),
            Ok(number) => {
                let help = format!("it has to be between {} and {}", range.start(), range.end());
                self.complain_at(at, format!("{number} is out of range"), help);
                None
            }
            Err(_) => {
                self.complain_at(at, format!("{text:?} is not a whole number"), "");
                None
            }
        }
    }

    /// A word or text, not empty; plain words that look like numbers are taken as they are written.
    pub fn text(&mut self, at: &At) -> Option<String> {
        match &at.node.value {
            Value::Scalar { text, .. } if !at.node.is_null() => {
                if text.trim().is_empty() {
                    self.complain_at(
                        at,
                        "an empty text",
                        "write a text, or leave the key out if it is optional",
                    );
                    return None;
                }
                Some(text.clone())
            }
            _ => self.wrong_type(at, "a text"),
        }
    }

    /// `true` or `false`.
    pub fn boolean(&mut self, at: &At) -> Option<bool> {
        match &at.node.value {
            Value::Scalar { text, quoted: false } if text == "true" => Some(true),
            Value::Scalar { text, quoted: false } if text == "false" => Some(false),
            _ => self.wrong_type(at, "true or false"),
        }
    }

    /// The value of an enum by its word.
    pub fn word<T: FromStr<Err = UnknownWord>>(&mut self, at: &At) -> Option<T> {
        let text = self.text(at)?;
        match text.parse::<T>() {
            Ok(value) => Some(value),
            Err(unknown) => {
                self.complain_at(at, unknown.message(), unknown.help());
                None
            }
        }
    }

    /// One of some words.
    pub fn choice<T: Copy>(&mut self, at: &At, choices: &[(&str, T)]) -> Option<T> {
        let text = self.text(at)?;
        if let Some((_, value)) = choices.iter().find(|(word, _)| *word == text) {
            return Some(*value);
        }
        let words: Vec<&str> = choices.iter().map(|(word, _)| *word).collect();
        self.complain_at(at, format!("{text:?} is not known here"), format!("one of: {}", words.join(", ")));
        None
    }

    /// Exactly `N` numbers: places, angles, pixels. None of these is larger than a million.
    pub fn numbers<const N: usize>(&mut self, at: &At) -> Option<[f64; N]> {
        self.numbers_in(at, -1e6..=1e6, "")
    }

    /// Exactly `N` numbers, each in this range.
    pub fn numbers_in<const N: usize>(
        &mut self,
        at: &At,
        range: RangeInclusive<f64>,
        unit: &str,
    ) -> Option<[f64; N]> {
        let items = self.sequence(at)?;
        if items.len() != N {
            self.complain_at(at, format!("{} values, {N} are wanted", items.len()), "");
            return None;
        }
        let mut out = [Some(0.0); N];
        for (slot, item) in out.iter_mut().zip(&items) {
            *slot = self.number_in(item, range.clone(), unit);
        }
        let mut numbers = [0.0; N];
        for (number, slot) in numbers.iter_mut().zip(out) {
            *number = slot?;
        }
        Some(numbers)
    }

    /// A pose x, y, theta under `key` (radians) or under `key` with `_deg` at its end (degrees), in m and
    /// rad. `None` inside when neither is there; both at once are refused. The angle is converted once, so
    /// that `start_deg: [0, 0, 90]` and its twin in radians agree to the last digit `to_radians` gives.
    pub fn pose(&mut self, fields: &Fields, key: &str) -> Option<Option<[f64; 3]>> {
        let degrees_key = format!("{key}_deg");
        match (fields.optional(key), fields.optional(&degrees_key)) {
            (Some(_), Some(second)) => {
                let message = format!("{key:?} and {degrees_key:?} are both given");
                self.complain(second.key_at, &second.path, message, "remove one of the two");
                None
            }
            (Some(at), None) => self.numbers::<3>(&at).map(Some),
            (None, Some(at)) => {
                let [x, y, degrees] = self.numbers::<3>(&at)?;
                Some(Some([x, y, degrees.to_radians()]))
            }
            (None, None) => Some(None),
        }
    }

    fn wrong_type<T>(&mut self, at: &At, wanted: &str) -> Option<T> {
        let found = match &at.node.value {
            // The complaint about it is there already.
            Value::Unread => return None,
            Value::Scalar { text, quoted: false } if !at.node.is_null() => format!("{text:?}"),
            _ => at.node.kind().to_string(),
        };
        self.complain_at(at, format!("{found} where {wanted} is wanted"), "");
        None
    }
}

fn with_unit(number: f64, unit: &str) -> String {
    if unit.is_empty() { number.to_string() } else { format!("{number} {unit}") }
}

/// Letters that follow a number, as in `300 mm`.
fn unit_of(text: &str) -> Option<&str> {
    let cut = text.find(|c: char| c.is_ascii_alphabetic() || c == '%' || c == '\u{b0}')?;
    text[..cut].trim().parse::<f64>().ok()?;
    Some(text[cut..].trim())
}

/// The known word nearest to `word`, if it is near.
pub fn suggestion<'w>(word: &str, known: &[&'w str]) -> Option<&'w str> {
    let near = known.iter().map(|k| (edit_distance(word, k), *k)).min_by_key(|(distance, _)| *distance)?;
    let allowed = (word.chars().count().max(3) / 3).max(1);
    (near.0 <= allowed).then_some(near.1)
}

/// Levenshtein distance, with a swap of neighbours counting as one.
fn edit_distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().take(64).collect(), b.chars().take(64).collect());
    let mut rows = vec![vec![0usize; b.len() + 1]; a.len() + 1];
    for i in 0..=a.len() {
        for j in 0..=b.len() {
            rows[i][j] = if i == 0 || j == 0 {
                i + j
            } else {
                let change = usize::from(a[i - 1] != b[j - 1]);
                let mut best = (rows[i - 1][j] + 1).min(rows[i][j - 1] + 1).min(rows[i - 1][j - 1] + change);
                if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                    best = best.min(rows[i - 2][j - 2] + 1);
                }
                best
            };
        }
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::parse;

    fn complaints(text: &str, read: impl Fn(&mut Decoder, &Fields)) -> String {
        let node = parse(text, "f.yaml").expect("syntax is fine");
        let mut decoder = Decoder::new("f.yaml");
        let fields = decoder.open_map(&At::top(&node)).expect("a map");
        read(&mut decoder, &fields);
        match decoder.finish(Some(())) {
            Ok(()) => String::new(),
            Err(complaints) => complaints.to_string(),
        }
    }

    #[test]
    fn all_complaints_come_at_once_in_the_order_of_the_text() {
        let text = "b: 300 mm\na: .nan\nc: '1'\nd: [1, 2]\n";
        let reported = complaints(text, |decoder, fields| {
            for key in ["a", "b", "c", "d", "e"] {
                if let Some(at) = fields.required(key, decoder) {
                    let _ = decoder.number(&at);
                }
            }
        });
        let lines: Vec<&str> = reported.lines().collect();
        assert_eq!(
            lines,
            [
                "f.yaml:1:1: key \"e\" is missing; add it",
                "f.yaml:1:4: b: \"300 mm\" is not a number; write the number alone, without \"mm\"",
                "f.yaml:2:4: a: .nan is not a finite number",
                "f.yaml:3:4: c: text in quotes where a number without quotes is wanted",
                "f.yaml:4:4: d: a list where a number without quotes is wanted",
            ]
        );
    }

    #[test]
    fn unknown_keys_get_a_suggestion() {
        let node = parse("workspce: 1\nzzz: 2\n", "f").expect("syntax");
        let mut decoder = Decoder::new("f");
        let _ = decoder.map(&At::top(&node), &["workspace", "objects"]);
        let reported = decoder.finish(Some(())).expect_err("refused").to_string();
        assert!(reported.contains("f:1:1: workspce: unknown key; did you mean \"workspace\"?"), "{reported}");
        assert!(reported.contains("f:2:1: zzz: unknown key; known keys: workspace, objects"), "{reported}");
        assert_eq!(suggestion("gaol", &["goal", "start"]), Some("goal"));
        assert_eq!(suggestion("x", &["goal", "start"]), None);
    }

    #[test]
    fn poses_come_in_radians_or_degrees_not_both() {
        let node =
            parse("a: [1, 2, 3]\nb_deg: [1, 2, 90]\nc: [0, 0, 0]\nc_deg: [0, 0, 0]\n", "f").expect("ok");
        let mut decoder = Decoder::new("f");
        let fields = decoder.open_map(&At::top(&node)).expect("map");
        assert_eq!(decoder.pose(&fields, "a"), Some(Some([1.0, 2.0, 3.0])));
        assert_eq!(decoder.pose(&fields, "b"), Some(Some([1.0, 2.0, std::f64::consts::FRAC_PI_2])));
        assert_eq!(decoder.pose(&fields, "d"), Some(None));
        assert_eq!(decoder.pose(&fields, "c"), None);
        let reported = decoder.finish(Some(())).expect_err("refused").to_string();
        assert!(reported.starts_with("f:4:1: c_deg: \"c\" and \"c_deg\" are both given"), "{reported}");
    }

    #[test]
    fn ranges_name_their_bounds() {
        let reported = complaints("a: -1\nb: 7\nc: 1.5\nd: yes\n", |decoder, fields| {
            let at = |key: &str| fields.optional(key).expect("given");
            let _ = decoder.positive(&at("a"), "m");
            let _ = decoder.number_in(&at("b"), 0.0..=1.0, "m");
            let _ = decoder.integer(&at("c"), 0..=9);
            let _ = decoder.boolean(&at("d"));
        });
        assert!(reported.contains("1:4: a: -1 m is not over 0"), "{reported}");
        assert!(
            reported.contains("2:4: b: 7 m is out of range; it has to be between 0 and 1 m"),
            "{reported}"
        );
        assert!(reported.contains("3:4: c: \"1.5\" is not a whole number"), "{reported}");
        assert!(reported.contains("4:4: d: \"yes\" where true or false is wanted"), "{reported}");
    }
}
