//! Values back to text: a small tree, written as YAML people like to read or as JSON.
//!
//! In: [`Out`] values. Out: text that [`crate::document::parse`] reads back to the same values; numbers keep
//! every digit (Rust prints the shortest decimal that gives the same `f64`).

use std::fmt::Write;

/// A value to be written.
#[derive(Clone, Debug, PartialEq)]
pub enum Out {
    /// A finite number.
    Number(f64),
    /// A whole number.
    Integer(i64),
    /// true or false.
    Boolean(bool),
    /// Text; quoted where needed.
    Text(String),
    /// A list; written on one line when all of it is numbers or short.
    List(Vec<Out>),
    /// Keys and values, in this order.
    Map(Vec<(String, Out)>),
}

impl Out {
    /// A list of numbers.
    pub fn numbers(numbers: &[f64]) -> Out {
        Out::List(numbers.iter().map(|number| Out::Number(*number)).collect())
    }

    /// A map from pairs.
    pub fn map(pairs: Vec<(&str, Out)>) -> Out {
        Out::Map(pairs.into_iter().map(|(key, value)| (key.to_string(), value)).collect())
    }

    /// As YAML: block style down to `block_levels`, flow style below.
    pub fn to_yaml(&self, block_levels: usize) -> String {
        let mut text = String::new();
        block(self, 0, block_levels, &mut text);
        text
    }

    /// As JSON on one line.
    pub fn to_json(&self) -> String {
        let mut text = String::new();
        flow(self, true, &mut text);
        text.push('\n');
        text
    }
}

fn block(value: &Out, indent: usize, levels: usize, text: &mut String) {
    match value {
        Out::Map(pairs) if levels > 0 && !pairs.is_empty() => {
            for (index, (key, value)) in pairs.iter().enumerate() {
                if index > 0 {
                    pad(indent, text);
                }
                flow(&Out::Text(key.clone()), false, text);
                text.push(':');
                nested(value, indent, levels, text);
            }
        }
        Out::List(items) if levels > 0 && items.iter().any(|item| matches!(item, Out::Map(_))) => {
            for (index, item) in items.iter().enumerate() {
                if index > 0 {
                    pad(indent, text);
                }
                text.push_str("- ");
                block(item, indent + 2, levels - 1, text);
            }
        }
        _ => {
            flow(value, false, text);
            text.push('\n');
        }
    }
}

fn nested(value: &Out, indent: usize, levels: usize, text: &mut String) {
    let goes_down = match value {
        Out::Map(pairs) => levels > 1 && !pairs.is_empty(),
        Out::List(items) => levels > 1 && items.iter().any(|item| matches!(item, Out::Map(_))),
        _ => false,
    };
    if goes_down {
        text.push('\n');
        pad(indent + 2, text);
        block(value, indent + 2, levels - 1, text);
    } else {
        text.push(' ');
        flow(value, false, text);
        text.push('\n');
    }
}

fn pad(indent: usize, text: &mut String) {
    text.extend(std::iter::repeat_n(' ', indent));
}

fn flow(value: &Out, json: bool, text: &mut String) {
    match value {
        Out::Number(number) => push_number(*number, text),
        Out::Integer(number) => {
            let _ = write!(text, "{number}");
        }
        Out::Boolean(truth) => text.push_str(if *truth { "true" } else { "false" }),
        Out::Text(word) if !json && is_plain(word) => text.push_str(word),
        Out::Text(word) => push_quoted(word, text),
        Out::List(items) => {
            text.push('[');
            for (index, item) in items.iter().enumerate() {
                if index > 0 {
                    text.push_str(", ");
                }
                flow(item, json, text);
            }
            text.push(']');
        }
        Out::Map(pairs) => {
            text.push('{');
            for (index, (key, value)) in pairs.iter().enumerate() {
                if index > 0 {
                    text.push_str(", ");
                }
                flow(&Out::Text(key.clone()), json, text);
                text.push_str(": ");
                flow(value, json, text);
            }
            text.push('}');
        }
    }
}

/// `{:?}` keeps the `.0` that marks a float, and writes very large and small numbers with an exponent.
fn push_number(number: f64, text: &mut String) {
    let _ = write!(text, "{number:?}");
}

/// Words that mean nothing else in YAML.
fn is_plain(word: &str) -> bool {
    let starts = word.chars().next().is_some_and(|c| c.is_ascii_alphabetic());
    let harmless = word.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.' | '/'));
    let reserved = ["true", "false", "null", "yes", "no", "on", "off", "y", "n"];
    let special = reserved.iter().any(|r| word.eq_ignore_ascii_case(r));
    starts && harmless && !special && word.parse::<f64>().is_err()
}

fn push_quoted(word: &str, text: &mut String) {
    text.push('"');
    for c in word.chars() {
        match c {
            '"' => text.push_str("\\\""),
            '\\' => text.push_str("\\\\"),
            '\n' => text.push_str("\\n"),
            '\t' => text.push_str("\\t"),
            c if (c as u32) < 0x20
                || c == '\u{7f}'
                || c == '\u{85}'
                || c == '\u{2028}'
                || c == '\u{2029}'
                || c == '\u{feff}' =>
            {
                let _ = write!(text, "\\u{:04x}", c as u32);
            }
            c => text.push(c),
        }
    }
    text.push('"');
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::document::decode::{At, Decoder};
    use crate::document::parse;

    #[test]
    fn what_is_written_is_read_back() {
        let words =
            ["plain", "true", "1.5", "a: b", "x#y", "\"q\"\\", "line\nbreak", "\u{e9}\u{85}", "", "nan", "-"];
        let value = Out::map(vec![
            ("numbers", Out::numbers(&[0.1, 1e-300, -3.0, 0.1 + 0.2])),
            (
                "deep",
                Out::map(vec![(
                    "list",
                    Out::List(vec![Out::map(vec![("k", Out::Integer(3)), ("l", Out::Boolean(true))])]),
                )]),
            ),
            ("words", Out::List(words.iter().map(|word| Out::Text(word.to_string())).collect())),
        ]);
        for text in [value.to_yaml(0), value.to_yaml(1), value.to_yaml(2), value.to_yaml(5), value.to_json()]
        {
            let node = parse(&text, "f").unwrap_or_else(|fault| panic!("{fault}\n{text}"));
            let mut decoder = Decoder::new("f");
            let fields = decoder.open_map(&At::top(&node)).expect("map");
            let numbers = decoder.numbers::<4>(&fields.optional("numbers").expect("numbers"));
            assert_eq!(numbers, Some([0.1, 1e-300, -3.0, 0.1 + 0.2]), "{text}");
            let list = decoder.sequence(&fields.optional("words").expect("words")).expect("list");
            for (item, word) in list.iter().zip(words) {
                assert_eq!(item.node.scalar(), Some(word), "{text}");
            }
            let k = node.get("deep").and_then(|deep| deep.get("list")).expect("list");
            let items = decoder.sequence(&At::top(k)).expect("list");
            assert!(items[0].node.get("k").is_some(), "{text}");
            decoder.finish(Some(())).expect("no complaint");
        }
        serde_json::from_str::<serde_json::Value>(&value.to_json()).expect("real JSON");
    }
}
