//! What can be read of a YAML text that is not valid as a whole, so that its other complaints come at once.
//!
//! In: a text that [`crate::document::tree::parse`] refuses. Out: a tree in which [`Value::Unread`] is
//! for what does not parse, and a complaint for each such place. The text is cut where a key or a list item
//! begins at the least indentation, each piece is parsed by itself, and a piece that does not parse is cut
//! once more inside. A text in one piece (JSON, a map in braces) has nothing to cut and is given up.

use crate::document::diagnostic::{Diagnostic, Diagnostics, Location};
use crate::document::tree::{Entry, Node, Value, complaint, parse_part, plain, repeated, sorted};
use std::collections::HashMap;

/// How often pieces are cut into pieces: sections, their items, the fields of an item.
const CUTS: usize = 3;

/// Most complaints kept: every line of a large file can be wrong.
const MOST: usize = 200;

/// Parses what can be read: of a text that is not valid, the tree of the rest and what is wrong with it.
///
/// # Errors
/// Nothing of it can be read; what is wrong.
pub fn parse_rest(text: &str, source: &str) -> Result<(Node, Diagnostics), Diagnostics> {
    let text = plain(text, source)?;
    let (node, complaints) = parse_part(text, source, 0);
    if let Some(node) = node {
        return Ok((node, sorted(complaints)));
    }
    let mut found = Vec::new();
    match pieces(text, source, &mut found) {
        Some(node) if !found.is_empty() => Ok((node, sorted(found))),
        // Cut apart it is valid: the place is known to the whole alone.
        Some(node) => Ok((node, sorted(complaints))),
        None => Err(sorted(complaints)),
    }
}

/// A text in pieces; `None` where there is nothing to cut.
fn pieces(text: &str, source: &str, complaints: &mut Vec<Diagnostic>) -> Option<Node> {
    let lines: Vec<Line> =
        text.split_inclusive('\n').zip(1..).map(|(text, number)| Line { text, number }).collect();
    Pieces { source, complaints }.block(&lines, CUTS)
}

/// A line of the text and its number.
#[derive(Clone, Copy)]
struct Line<'t> {
    text: &'t str,
    number: usize,
}

impl<'t> Line<'t> {
    fn content(&self) -> &'t str {
        self.text.trim_matches([' ', '\r', '\n'])
    }

    fn indent(&self) -> usize {
        self.text.len() - self.text.trim_start_matches(' ').len()
    }

    /// Blank lines and comments belong to what is before them, and so does a bracket that closes.
    fn begins(&self, indent: usize) -> bool {
        let content = self.content();
        self.indent() <= indent && !content.is_empty() && !content.starts_with(['#', ']', '}'])
    }

    fn at(&self) -> Location {
        Location { line: self.number, column: self.indent() + 1 }
    }

    /// The key that the line begins with, with or without its colon.
    fn key(&self) -> Option<&'t str> {
        let word = self.content().split([':', ' ']).next()?;
        let plain = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-' | '.');
        (!word.is_empty() && word != "-" && word.chars().all(plain)).then_some(word)
    }

    fn is_item(&self) -> bool {
        self.content() == "-" || self.content().starts_with("- ")
    }
}

struct Pieces<'a> {
    source: &'a str,
    complaints: &'a mut Vec<Diagnostic>,
}

impl Pieces<'_> {
    /// A block of lines: a list where its first piece is an item, else a map.
    fn block(&mut self, lines: &[Line], cuts: usize) -> Option<Node> {
        let first = lines.iter().position(|line| line.begins(usize::MAX))?;
        let lines = lines.get(first..)?;
        let (head, indent) = (lines.first()?, lines.first()?.indent());
        if cuts == 0 || !(head.is_item() || head.key().is_some()) {
            return None;
        }
        // The list under a key may be as far left as the key.
        let begins = |line: &Line| line.begins(indent) && line.is_item() == head.is_item();
        let mut starts: Vec<usize> = (0..lines.len()).filter(|k| begins(&lines[*k])).collect();
        starts.push(lines.len());
        let pieces = starts.windows(2).filter_map(|pair| lines.get(pair[0]..pair[1]));
        let value = match head.is_item() {
            true => Value::Sequence(pieces.filter_map(|piece| self.item(piece)).collect()),
            false => {
                let mut map = Map::default();
                pieces.for_each(|piece| self.entries(piece, cuts, &mut map));
                Value::Map(map.entries)
            }
        };
        Some(Node { at: head.at(), value })
    }

    /// A list item. Its fields are not kept apart: who reads it would miss those that it lost.
    fn item(&mut self, piece: &[Line]) -> Option<Node> {
        let at = piece.first()?.at();
        let unread = Node { at, value: Value::Unread };
        match self.parsed(piece) {
            Ok(Node { value: Value::Sequence(items), .. }) => items.into_iter().next(),
            Ok(_) => {
                self.complain(at, "an item of the list, `- ...`, is wanted here");
                Some(unread)
            }
            Err(complaints) => {
                self.keep(complaints);
                Some(unread)
            }
        }
    }

    /// The key of a piece and its value.
    fn entries(&mut self, piece: &[Line], cuts: usize, map: &mut Map) {
        let Some(head) = piece.first() else { return };
        let value = match self.parsed(piece) {
            Ok(Node { value: Value::Map(entries), .. }) => {
                for entry in entries {
                    self.keep(map.add(self.source, entry));
                }
                return;
            }
            Ok(_) => {
                self.complain(head.at(), "a key, a colon and a value are wanted here");
                Value::Unread
            }
            Err(complaints) => {
                // What is inside is kept apart where the key has a line to itself.
                let alone = head.content().ends_with(':');
                let inside = piece.get(1..).filter(|_| alone).and_then(|rest| self.block(rest, cuts - 1));
                if inside.is_none() {
                    self.keep(complaints);
                }
                inside.map_or(Value::Unread, |node| node.value)
            }
        };
        if let Some(key) = head.key() {
            let node = Node { at: head.at(), value };
            let entry = Entry { key: key.to_string(), key_at: head.at(), node };
            self.keep(map.add(self.source, entry));
        }
    }

    fn parsed(&self, piece: &[Line]) -> Result<Node, Vec<Diagnostic>> {
        let text: String = piece.iter().map(|line| line.text).collect();
        let before = piece.first().map_or(0, |line| line.number - 1);
        let (node, complaints) = parse_part(&text, self.source, before);
        node.filter(|_| complaints.is_empty()).ok_or(complaints)
    }

    fn complain(&mut self, at: Location, message: &str) {
        self.keep([complaint(self.source, at, message, "check indentation, brackets and colons")]);
    }

    fn keep(&mut self, complaints: impl IntoIterator<Item = Diagnostic>) {
        let room = MOST.saturating_sub(self.complaints.len());
        self.complaints.extend(complaints.into_iter().take(room));
    }
}

/// Entries whose keys are unique.
#[derive(Default)]
struct Map {
    entries: Vec<Entry>,
    seen: HashMap<String, Location>,
}

impl Map {
    fn add(&mut self, source: &str, entry: Entry) -> Option<Diagnostic> {
        if let Some(first) = self.seen.get(&entry.key) {
            return Some(repeated(source, &entry.key, entry.key_at, *first));
        }
        self.seen.insert(entry.key.clone(), entry.key_at);
        self.entries.push(entry);
        None
    }
}

#[cfg(test)]
mod tests {
    use crate::document::decode::{At, Decoder, read};
    use crate::document::{Diagnostics, Location};

    /// A map of a number, a list of points and a word.
    fn decode(at: &At, decoder: &mut Decoder) -> Option<()> {
        let fields = decoder.map(at, &["speed", "points", "name", "inner"])?;
        let speed = fields.required("speed", decoder).and_then(|at| decoder.number(&at));
        let points = fields.required("points", decoder).and_then(|at| decoder.sequence(&at));
        let points: Option<Vec<Option<[f64; 2]>>> =
            points.map(|items| items.iter().map(|item| decoder.numbers(item)).collect());
        let name = fields.required("name", decoder).and_then(|at| decoder.text(&at));
        if let Some(at) = fields.optional("inner") {
            let inner = decoder.map(&at, &["x", "y"])?;
            inner.required("x", decoder).and_then(|at| decoder.number(&at));
            inner.required("y", decoder).and_then(|at| decoder.number(&at));
        }
        speed.and(points).and(name).map(drop)
    }

    fn lines(text: &str) -> Vec<(usize, String)> {
        let Err(Diagnostics(complaints)) = read(text, "f.yaml", decode) else { panic!("{text} is valid") };
        complaints.into_iter().map(|complaint| (complaint.at.line, complaint.message)).collect()
    }

    #[test]
    fn what_follows_a_syntax_error_is_read() {
        let found = lines("speed: fast\npoints: [[0, 1], [2\nname: [1]\nother: 1\n");
        let places: Vec<usize> = found.iter().map(|(line, _)| *line).collect();
        assert_eq!(places, [1, 3, 3, 4], "{found:?}");
        assert!(found.iter().any(|(_, message)| message.contains("not valid YAML")), "{found:?}");
    }

    #[test]
    fn a_broken_item_leaves_its_neighbours() {
        let found = lines("speed: 1\npoints:\n  - [0, 1]\n  - [0, 1\n  - [0, x]\n  - [0]\nname: n\n");
        let places: Vec<usize> = found.iter().map(|(line, _)| *line).collect();
        assert_eq!(places.iter().filter(|line| **line >= 5).count(), 3, "{found:?}");
        assert!(found.iter().all(|(_, message)| !message.contains("missing")), "{found:?}");
    }

    #[test]
    fn a_broken_section_is_no_missing_one() {
        let found = lines("speed 1\npoints:\n- [1, 2]\nname: \"open\ninner:\n  x: {\n  y: word\n");
        assert!(found.iter().all(|(_, message)| !message.contains("missing")), "{found:?}");
        assert!(
            found.iter().any(|(line, message)| *line == 7 && message.contains("not a number")),
            "{found:?}"
        );
    }

    #[test]
    fn a_bracket_that_closes_further_left_is_no_piece() {
        let found = lines("points: [\n  [0, 1],\n]\nspeed: x\nname: {\n");
        assert!(found.iter().all(|(line, _)| *line >= 4), "{found:?}");
    }

    #[test]
    fn a_large_file_that_is_wrong_everywhere_keeps_as_many_complaints_as_a_person_reads() {
        assert_eq!(lines(&"speed: [1\n".repeat(10_000)).len(), super::MOST);
    }

    #[test]
    fn text_in_one_piece_keeps_its_one_complaint() {
        for text in ["{\"speed\": }}", "[1, 2", "\"open"] {
            let found = lines(text);
            assert_eq!(found.len(), 1, "{text}: {found:?}");
        }
    }

    #[test]
    fn places_are_those_of_the_text_and_keys_stay_unique() {
        let Err(Diagnostics(found)) = read("a: {\nspeed: 1\n\nspeed: 2\n", "f.yaml", decode) else {
            panic!("valid")
        };
        let twice = found.iter().find(|complaint| complaint.message.contains("written twice"));
        assert_eq!(twice.map(|complaint| complaint.at), Some(Location { line: 4, column: 1 }), "{found:?}");
    }
}
