//! Text to a tree with the location of every key and value.
//!
//! In: YAML 1.2 or JSON text. Out: a [`Node`], or [`Diagnostics`]. Scalars stay text here; what a field
//! should be decides how they are read, so that `id: 007` is a name where a name is wanted. Anchors,
//! aliases, tags and several documents in one file are refused: none is needed, and each can hide what a
//! file says. Size, depth and number of values are bounded, because files may come from anywhere.

use std::collections::HashMap;

use saphyr_parser::{Event, Parser, ScalarStyle, StrInput};

use crate::document::diagnostic::{Diagnostic, Diagnostics, Location};

/// Longest text accepted, bytes.
pub const MAX_BYTES: usize = 16 << 20;
/// Deepest nesting accepted.
pub const MAX_DEPTH: usize = 48;
/// Most values accepted.
pub const MAX_NODES: usize = 1_000_000;

/// A value and where it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Where it begins.
    pub at: Location,
    /// What it is.
    pub value: Value,
}

/// What a node holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A number, word or text.
    Scalar {
        /// Its characters, escapes resolved.
        text: String,
        /// Written in quotes or as a block: never a number, a truth value or null.
        quoted: bool,
    },
    /// A list.
    Sequence(Vec<Node>),
    /// Keys and values in the order of the text; keys are unique.
    Map(Vec<Entry>),
    /// Text that is not valid: there is a complaint about it, and none that it lacks something.
    Unread,
}

/// A key and its value.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// The key.
    pub key: String,
    /// Where the key begins.
    pub key_at: Location,
    /// The value.
    pub node: Node,
}

impl Node {
    /// The value of `key` when this is a map that has it.
    pub fn get(&self, key: &str) -> Option<&Node> {
        match &self.value {
            Value::Map(entries) => entries.iter().find(|entry| entry.key == key).map(|entry| &entry.node),
            Value::Scalar { .. } | Value::Sequence(_) | Value::Unread => None,
        }
    }

    /// The characters of a scalar, in quotes or not.
    pub fn scalar(&self) -> Option<&str> {
        match &self.value {
            Value::Scalar { text, .. } => Some(text),
            Value::Sequence(_) | Value::Map(_) | Value::Unread => None,
        }
    }

    /// True for an absent value: nothing written, `null` or `~`.
    pub fn is_null(&self) -> bool {
        matches!(&self.value, Value::Scalar { text, quoted: false } if matches!(text.as_str(), "" | "~" | "null" | "Null" | "NULL"))
    }

    /// "a list", "a map", ...: for messages.
    pub fn kind(&self) -> &'static str {
        match &self.value {
            Value::Sequence(_) => "a list",
            Value::Map(_) => "a map",
            Value::Unread => "what cannot be read",
            Value::Scalar { .. } if self.is_null() => "nothing",
            Value::Scalar { quoted: true, .. } => "text in quotes",
            Value::Scalar { .. } => "a plain value",
        }
    }
}

/// Parses a YAML or JSON text; `source` is the file name to put into complaints.
///
/// # Errors
/// The syntax error, or every duplicate key, anchor, alias and tag at once.
pub fn parse(text: &str, source: &str) -> Result<Node, Diagnostics> {
    let text = plain(text, source)?;
    let (node, complaints) = parse_part(text, source, 0);
    node.filter(|_| complaints.is_empty()).ok_or_else(|| sorted(complaints))
}

/// The text without its mark of byte order.
pub(crate) fn plain<'t>(text: &'t str, source: &str) -> Result<&'t str, Diagnostics> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    if text.len() > MAX_BYTES {
        let message = format!("the file has {} bytes, at most {MAX_BYTES} are read", text.len());
        return Err(Diagnostics(vec![complaint(source, Location { line: 1, column: 1 }, message, "")]));
    }
    Ok(text)
}

/// Parses the lines of a text that follow its first `before`; no tree where the syntax is wrong.
pub(crate) fn parse_part(text: &str, source: &str, before: usize) -> (Option<Node>, Vec<Diagnostic>) {
    let events = Parser::new_from_str(text);
    let mut builder = Builder { source, events, before, complaints: Vec::new(), nodes: 0 };
    let result = builder.document();
    let mut complaints = builder.complaints;
    match result {
        Ok(node) => (Some(node), complaints),
        Err(Stop(complaint)) => {
            complaints.push(complaint);
            (None, complaints)
        }
    }
}

/// Complaints in the order of the text.
pub(crate) fn sorted(mut complaints: Vec<Diagnostic>) -> Diagnostics {
    complaints.sort_by_key(|complaint| complaint.at);
    Diagnostics(complaints)
}

/// A complaint about a place of the text.
pub(crate) fn complaint(source: &str, at: Location, message: impl Into<String>, help: &str) -> Diagnostic {
    let (source, message) = (source.to_string(), message.into());
    Diagnostic { source, at, path: String::new(), message, help: help.to_string() }
}

/// A key that is there already.
pub(crate) fn repeated(source: &str, key: &str, at: Location, first: Location) -> Diagnostic {
    let message = format!("key {key:?} is written twice, first in line {}", first.line);
    complaint(source, at, message, "remove one of the two")
}

/// A complaint after which the rest of the text means nothing.
struct Stop(Diagnostic);

struct Builder<'a> {
    source: &'a str,
    events: Parser<'a, StrInput<'a>>,
    /// Lines of the file before this text.
    before: usize,
    complaints: Vec<Diagnostic>,
    nodes: usize,
}

impl<'a> Builder<'a> {
    fn document(&mut self) -> Result<Node, Stop> {
        loop {
            let (event, at) = self.next()?;
            match event {
                Event::StreamStart | Event::DocumentStart(_) | Event::Nothing => {}
                Event::StreamEnd | Event::DocumentEnd => {
                    return Err(self.stop(at, "the file is empty", ""));
                }
                other => {
                    let node = self.node(other, at, 0)?;
                    self.end()?;
                    return Ok(node);
                }
            }
        }
    }

    fn end(&mut self) -> Result<(), Stop> {
        loop {
            let (event, at) = self.next()?;
            match event {
                Event::StreamEnd => return Ok(()),
                Event::DocumentEnd | Event::Nothing => {}
                _ => {
                    return Err(self.stop(at, "a second document begins here", "keep one document per file"));
                }
            }
        }
    }

    fn next(&mut self) -> Result<(Event<'a>, Location), Stop> {
        match self.events.next_event() {
            Some(Ok((event, span))) => Ok((event, self.location(span.start.line(), span.start.col()))),
            Some(Err(error)) => {
                let at = self.location(error.marker().line(), error.marker().col());
                let message = format!("not valid YAML or JSON: {}", error.info());
                Err(self.stop(at, message, "check indentation, brackets, quotes and colons"))
            }
            None => Err(self.stop(Location::default(), "the text ends too early", "")),
        }
    }

    fn location(&self, line: usize, column: usize) -> Location {
        Location { line: self.before + line, column: column + 1 }
    }

    fn stop(&self, at: Location, message: impl Into<String>, help: &str) -> Stop {
        Stop(complaint(self.source, at, message, help))
    }

    fn node(&mut self, event: Event<'a>, at: Location, depth: usize) -> Result<Node, Stop> {
        self.nodes += 1;
        if depth > MAX_DEPTH {
            return Err(self.stop(at, format!("nested deeper than {MAX_DEPTH} levels"), ""));
        }
        if self.nodes > MAX_NODES {
            return Err(self.stop(at, format!("more than {MAX_NODES} values in one file"), ""));
        }
        let value = match event {
            Event::Scalar(text, style, anchor, tag) => {
                self.refuse_extras(at, anchor, tag.is_some());
                Value::Scalar { text: text.into_owned(), quoted: style != ScalarStyle::Plain }
            }
            Event::SequenceStart(anchor, tag) => {
                self.refuse_extras(at, anchor, tag.is_some());
                self.sequence(depth)?
            }
            Event::MappingStart(anchor, tag) => {
                self.refuse_extras(at, anchor, tag.is_some());
                self.map(depth)?
            }
            Event::Alias(_) => {
                self.complain(at, "aliases (`*name`) are not read", "write the value out");
                Value::Scalar { text: String::new(), quoted: true }
            }
            _ => return Err(self.stop(at, "a value is missing here", "")),
        };
        Ok(Node { at, value })
    }

    fn sequence(&mut self, depth: usize) -> Result<Value, Stop> {
        let mut items = Vec::new();
        loop {
            let (event, at) = self.next()?;
            if event == Event::SequenceEnd {
                return Ok(Value::Sequence(items));
            }
            items.push(self.node(event, at, depth + 1)?);
        }
    }

    fn map(&mut self, depth: usize) -> Result<Value, Stop> {
        let mut entries: Vec<Entry> = Vec::new();
        let mut seen: HashMap<String, Location> = HashMap::new();
        loop {
            let (event, key_at) = self.next()?;
            if event == Event::MappingEnd {
                return Ok(Value::Map(entries));
            }
            let key = self.node(event, key_at, depth + 1)?;
            let (event, at) = self.next()?;
            let node = self.node(event, at, depth + 1)?;
            let Value::Scalar { text: key, .. } = key.value else {
                self.complain(key_at, "a key has to be a word", "");
                continue;
            };
            if let Some(first) = seen.get(&key) {
                self.complaints.push(repeated(self.source, &key, key_at, *first));
                continue;
            }
            seen.insert(key.clone(), key_at);
            entries.push(Entry { key, key_at, node });
        }
    }

    fn refuse_extras(&mut self, at: Location, anchor: usize, tagged: bool) {
        if anchor != 0 {
            self.complain(at, "anchors (`&name`) are not read", "remove the anchor");
        }
        if tagged {
            self.complain(at, "tags (`!name`) are not read", "remove the tag");
        }
    }

    fn complain(&mut self, at: Location, message: impl Into<String>, help: &str) {
        self.complaints.push(complaint(self.source, at, message, help));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(text: &str) -> String {
        parse(text, "f.yaml").expect_err("refused").to_string()
    }

    #[test]
    fn places_are_those_of_the_text() {
        let node = parse("a: 1\nb:\n  - x\n  - {c: \"2\"}\n", "f").expect("valid");
        let b = node.get("b").expect("b");
        let Value::Sequence(items) = &b.value else { panic!("{b:?}") };
        assert_eq!(items[0].at, Location { line: 3, column: 5 });
        let Value::Map(entries) = &items[1].value else { panic!("{items:?}") };
        assert_eq!(entries[0].key_at, Location { line: 4, column: 6 });
        assert_eq!(entries[0].node.at, Location { line: 4, column: 9 });
        assert_eq!(entries[0].node.value, Value::Scalar { text: "2".into(), quoted: true });
    }

    #[test]
    fn json_is_read_too() {
        let text = "{\n\t\"a\": [1, 2.5e-3, -0],\n\t\"b\": {\"c\":\"x\\n\\u00e9\"}, \"d\": null, \"e\":true}";
        let node = parse(text, "f").expect("valid");
        assert!(node.get("d").expect("d").is_null());
        let c = node.get("b").and_then(|b| b.get("c")).expect("c");
        assert_eq!(c.value, Value::Scalar { text: "x\n\u{e9}".into(), quoted: true });
    }

    #[test]
    fn everything_that_hides_meaning_is_refused_at_its_place() {
        let text = "a: &x 1\nb: *x\nc: !t 2\na: 3\n";
        let complaints = parse(text, "f.yaml").expect_err("refused").0;
        let lines: Vec<usize> = complaints.iter().map(|complaint| complaint.at.line).collect();
        assert_eq!(lines, [1, 2, 3, 4], "{complaints:?}");
        assert!(fault("a: 1\na: 2\n").starts_with("f.yaml:2:1: key \"a\" is written twice, first in line 1"));
        assert!(fault("a: 1\n---\nb: 2\n").contains("second document"));
        assert!(fault("").contains("empty"));
        assert!(fault("# nothing\n").contains("empty"));
    }

    #[test]
    fn syntax_errors_have_a_place() {
        assert!(fault("a: [1, 2\nb: 3\n").starts_with("f.yaml:"), "{}", fault("a: [1, 2\nb: 3\n"));
        assert!(fault("{\"a\": }}").contains("f.yaml:1:"), "{}", fault("{\"a\": }}"));
        assert!(fault("a: \"open\n").contains("not valid"));
    }

    #[test]
    fn budgets_hold() {
        let deep = "[".repeat(200) + &"]".repeat(200);
        assert!(fault(&deep).contains("nested deeper"));
        let deep_blocks: String = (0..100).map(|k| format!("{}a:\n", " ".repeat(k))).collect();
        assert!(fault(&deep_blocks).contains("nested deeper"));
        assert!(fault(&" ".repeat(MAX_BYTES + 1)).contains("bytes"));
    }

    #[test]
    fn arbitrary_text_never_panics() {
        let alphabet: Vec<char> = "ab:{}[],\"'#&*!|>-?%@`\n\t 0.~\u{e9}\\".chars().collect();
        let mut state = 12345u64;
        for _ in 0..20_000 {
            let text: String = (0..24)
                .map(|_| {
                    state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    alphabet[(state >> 33) as usize % alphabet.len()]
                })
                .collect();
            let _ = crate::document::parse_rest(&text, "f");
        }
    }
}
