//! The configuration reference of the book, out of the schemas of `celld schema`.
//!
//! In: the schemas, each with the word of its kind. Out: one page of Markdown: every key with its type,
//! unit, range, default and sentence, in the order of the schema; shapes that several kinds have alike
//! are given once, at the end. The page is made so that no key can be missing in it and none can be
//! described wrongly.

use super::ordered::Json;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// The columns of every table.
const COLUMNS: &str = "| key | type | unit | range | default | what it says |\n|---|---|---|---|---|---|\n";

/// Units as the sentences of the schemas end in them: behind a comma or a colon.
const UNITS: &[&str] = &[
    "m and unit quaternion",
    "m, m, degrees",
    "m, m, rad",
    "degrees/s2",
    "degrees/s",
    "degrees",
    "m/s2",
    "m/s",
    "mm",
    "m",
    "kg",
    "rad",
    "s",
    "pixels",
    "Hz",
    "GB",
    "bytes",
    "days",
    "microseconds",
    "grey levels of 255",
    "share of an atmosphere",
];

/// A kind of file: its word for `celld schema`, and its schema.
pub struct Kind {
    pub word: &'static str,
    pub schema: Json,
}

/// The page, and how many rows describe a key.
pub fn page(kinds: &[Kind]) -> (String, usize) {
    let mut writer = Writer { common: common(kinds), out: String::new(), rows: 0 };
    writer.opening(kinds);
    for kind in kinds {
        writer.kind(kind);
    }
    writer.out.push_str("\n## Shapes that several files have\n");
    let mut written = BTreeSet::new();
    for kind in kinds {
        for name in reached(kind) {
            if writer.common.contains(&name) && written.insert(name.clone()) {
                let _ = write!(writer.out, "\n### `{name}`\n\n");
                writer.shape(kind, definition(kind, &name));
            }
        }
    }
    (writer.out, writer.rows)
}

struct Writer {
    /// Names of the shapes that are the same wherever they are.
    common: BTreeSet<String>,
    out: String,
    rows: usize,
}

/// What the columns say of a value.
#[derive(Default)]
struct Column {
    kind: String,
    range: String,
}

impl Writer {
    fn opening(&mut self, kinds: &[Kind]) {
        self.out.push_str(
            "# Configuration reference\n\nEvery key of every file that celld reads, out of the schemas that \
             `celld schema` prints. A test makes this page from\nthem and compares: `CELLD_WRITE=1 cargo test \
             --test it book::` writes it anew. What the keys mean together is in the\nexamples below \
             `config/`, whose comments say more; whether they fit each other says `celld check FILE`.\n\n",
        );
        for kind in kinds {
            let title = kind.schema.text_of("title");
            let _ = writeln!(self.out, "* [{title}](#{}): `celld schema {}`", slug(title), kind.word);
        }
        self.out.push_str(
            "\nA key with *required* as its default has to be there, one with `-` may be left out; a key \
             with nothing behind it counts as\nleft out. Keys that are not listed are errors. `a.b` is the \
             key `b` in the map under `a`, `a[].b` the key `b` of each\nentry of the list under `a`. Text \
             may be written without quotes, also where it looks like a number.\n",
        );
    }

    fn kind(&mut self, kind: &Kind) {
        let title = kind.schema.text_of("title");
        let _ = write!(self.out, "\n## {title}\n\n{}\n", kind.schema.text_of("description"));
        let forms = forms(&kind.schema);
        if forms.is_empty() {
            self.out.push('\n');
            self.table(kind, &kind.schema);
        } else {
            self.out.push_str("\nOne of:\n\n");
            for name in forms {
                let says = definition(kind, &name).text_of("description");
                let says = if says.is_empty() { String::new() } else { format!(": {says}") };
                let _ = writeln!(self.out, "* {}{says}", self.link(kind, &name));
            }
        }
        for name in reached(kind) {
            if !self.common.contains(&name) {
                let _ = write!(self.out, "\n### `{name}` in {}\n\n", kind.word);
                self.shape(kind, definition(kind, &name));
            }
        }
    }

    /// What stands below the heading of a shape.
    fn shape(&mut self, kind: &Kind, shape: &Json) {
        let says = shape.text_of("description");
        if !says.is_empty() {
            let _ = write!(self.out, "{says}\n\n");
        }
        let alternatives = alternatives(shape);
        if shape.get("properties").is_some() {
            self.table(kind, shape);
        } else if alternatives.len() > 1 {
            let (maps, others): (Vec<_>, Vec<_>) = alternatives.into_iter().partition(|one| has_keys(one));
            let mut kinds: Vec<String> = others.iter().map(|one| self.column(kind, one).kind).collect();
            kinds.extend(maps.iter().map(|_| "map".to_string()));
            let _ = write!(self.out, "A {}:\n\n", kinds.join(", or a "));
            for map in maps {
                self.table(kind, map);
            }
        } else {
            let column = self.column(kind, shape);
            let range = if column.range.is_empty() { String::new() } else { format!(": {}", column.range) };
            let _ = writeln!(self.out, "A {}{range}.", column.kind);
        }
    }

    /// The keys of a map, and what holds for several of them.
    fn table(&mut self, kind: &Kind, map: &Json) {
        self.out.push_str(COLUMNS);
        self.rows_of(kind, map, "");
        let mut notes = Vec::new();
        notes.extend(exactly_one(map));
        for rule in map.list_of("allOf") {
            if let Some(name) = reference(rule) {
                notes.push(definition(kind, &name).text_of("description").to_string());
            }
        }
        notes.retain(|note| !note.is_empty());
        if !notes.is_empty() {
            let _ = write!(self.out, "\n{}\n", notes.join(" "));
        }
    }

    fn rows_of(&mut self, kind: &Kind, map: &Json, prefix: &str) {
        let required: Vec<&str> = map.list_of("required").iter().filter_map(Json::text).collect();
        let arguments = arguments(map);
        for (key, schema) in properties(map) {
            let path = format!("{prefix}{key}");
            self.row(kind, &path, &schema, required.contains(&key.as_str()));
            let alternatives = alternatives(&schema);
            if let [only] = alternatives[..] {
                let inside = if only.is("type", "array") { only.get("items") } else { Some(only) };
                let dots = if only.is("type", "array") { "[]." } else { "." };
                if let Some(inside) = inside.filter(|inside| inside.get("properties").is_some()) {
                    self.rows_of(kind, inside, &format!("{path}{dots}"));
                }
                continue;
            }
            for word in alternatives.iter().filter(|one| one.get("const").is_some()) {
                self.word(kind, &path, word, &arguments);
            }
            let maps: Vec<_> = alternatives.into_iter().filter(|one| has_keys(one)).collect();
            for (number, map) in maps.iter().enumerate() {
                let which = match (maps.len(), number) {
                    (1, _) => "as a map",
                    (_, 0) => "either",
                    _ => "or",
                };
                let _ = writeln!(self.out, "| *`{path}`, {which}* | | | | | |");
                self.rows_of(kind, map, &format!("{path}."));
            }
        }
    }

    fn row(&mut self, kind: &Kind, path: &str, schema: &Json, required: bool) {
        let column = self.column(kind, schema);
        let says = sentence(kind, schema);
        let default = match schema.get("default") {
            Some(value) => format!("`{value}`"),
            None if required => "*required*".to_string(),
            None => "-".to_string(),
        };
        let unit = unit(&says).unwrap_or("-");
        let range = if column.range.is_empty() { "-" } else { &column.range };
        self.rows += 1;
        let says = says.replace('|', "\\|");
        let _ = writeln!(self.out, "| `{path}` | {} | {unit} | {range} | {default} | {says} |", column.kind);
    }

    /// One of the words that a key may have, with what it means and which arguments it takes.
    fn word(&mut self, kind: &Kind, path: &str, schema: &Json, arguments: &BTreeMap<String, String>) {
        let word = schema.get("const").unwrap_or(&Json::Null);
        let says = schema.text_of("description").replace('|', "\\|");
        let takes = arguments.get(&word.to_string()).filter(|name| has_keys(definition(kind, name)));
        let takes = takes.map_or("-".to_string(), |name| format!("`args`: {}", self.link(kind, name)));
        let _ = writeln!(self.out, "| `{path}: {word}` | word | - | {takes} | - | {says} |");
    }

    /// Type and range of a value.
    fn column(&self, kind: &Kind, schema: &Json) -> Column {
        if let Some(name) = reference(schema) {
            let target = definition(kind, &name);
            return if is_plain(target) {
                self.column(kind, target)
            } else {
                Column { kind: self.link(kind, &name), range: String::new() }
            };
        }
        let alternatives = alternatives(schema);
        if alternatives.len() > 1 {
            if alternatives.iter().all(|one| one.get("const").is_some()) {
                return Column { kind: "word".into(), range: "see below".into() };
            }
            let mut kinds: Vec<String> = alternatives.iter().map(|one| self.column(kind, one).kind).collect();
            kinds.dedup();
            return Column { kind: kinds.join(" or "), range: String::new() };
        }
        if let Some(only) = alternatives.first().filter(|only| !std::ptr::eq(**only, schema)) {
            return self.column(kind, only);
        }
        if schema.is("type", "array") {
            return self.list(kind, schema);
        }
        plain(schema)
    }

    fn list(&self, kind: &Kind, schema: &Json) -> Column {
        let entries = match (schema.get("minItems"), schema.get("maxItems")) {
            (Some(least), Some(most)) if least == most => Some(format!("{least} entries")),
            (Some(least), Some(most)) => Some(format!("{least} to {most} entries")),
            (None, Some(most)) => Some(format!("up to {most} entries")),
            (Some(least), None) => Some(format!("at least {least} entries")),
            (None, None) => None,
        };
        let places: Vec<Column> = match schema.get("items") {
            Some(Json::List(places)) => places.iter().map(|place| self.column(kind, place)).collect(),
            Some(one) => vec![self.column(kind, one)],
            None => Vec::new(),
        };
        let mut each: Vec<&str> = places.iter().map(|place| place.range.as_str()).collect();
        each.dedup();
        let each = match each[..] {
            [] | [""] => None,
            [one] => Some(format!("each {one}")),
            _ => Some(places.iter().map(|place| place.range.as_str()).collect::<Vec<_>>().join("; ")),
        };
        let ranges: Vec<String> = [entries, each].into_iter().flatten().collect();
        let inner = places.first().map_or("values", |place| place.kind.as_str());
        Column { kind: format!("list of {}", plural(inner)), range: ranges.join(": ") }
    }

    fn link(&self, kind: &Kind, name: &str) -> String {
        if self.common.contains(name) {
            format!("[`{name}`](#{name})")
        } else {
            format!("[`{name}`](#{name}-in-{})", kind.word)
        }
    }
}

fn plural(kind: &str) -> String {
    match kind {
        "number" | "whole number" | "word" | "map" => format!("{kind}s"),
        "text" => "texts".into(),
        list if list.starts_with("list ") => format!("lists{}", &list["list".len()..]),
        other => other.into(),
    }
}

/// A value that is neither list nor shape.
fn plain(schema: &Json) -> Column {
    let words: Vec<String> = match (schema.get("const"), schema.get("enum")) {
        (Some(word), _) => vec![format!("`{word}`")],
        (None, Some(Json::List(words))) => words
            .iter()
            .filter(|word| !matches!(word, Json::Null))
            // The words `true` and `false` in quotes count as the truth values.
            .filter(|word| !matches!(word.text(), Some("true" | "false")))
            .map(|word| format!("`{word}`"))
            .collect(),
        _ => Vec::new(),
    };
    let types: Vec<&str> = match schema.get("type") {
        Some(Json::List(types)) => types.iter().filter_map(Json::text).collect(),
        Some(one) => one.text().into_iter().collect(),
        None => Vec::new(),
    };
    let kind = match types.iter().find(|word| **word != "null") {
        _ if types.contains(&"string") => "text",
        Some(&"integer") => "whole number",
        Some(&"number") => "number",
        Some(&"boolean") => "`true` or `false`",
        Some(&"object") => "map",
        None if types == ["null"] => "nothing",
        _ => "word",
    };
    let range = if words.is_empty() { numbers(schema) } else { words.join(", ") };
    Column { kind: kind.into(), range }
}

/// The range of a number, or the length of a text.
fn numbers(schema: &Json) -> String {
    let least = schema.get("minimum").map(|least| (least, ""));
    let least = least.or_else(|| schema.get("exclusiveMinimum").map(|least| (least, "over ")));
    let most = schema.get("maximum").map(|most| match most.to_string().as_str() {
        "9223372036854775807" => "2^63 - 1".to_string(),
        "18446744073709551615" => "2^64 - 1".to_string(),
        other => other.to_string(),
    });
    match (least, most, schema.get("maxLength")) {
        (Some((least, over)), Some(most), _) => format!("{over}{least} to {most}"),
        (Some((least, "")), None, _) => format!("at least {least}"),
        (Some((least, over)), None, _) => format!("{over}{least}"),
        (None, Some(most), _) => format!("up to {most}"),
        (None, None, Some(most)) => format!("up to {most} characters"),
        (None, None, None) => String::new(),
    }
}

/// The sentence of a key; for a text of a certain form also what is said of that form.
fn sentence(kind: &Kind, schema: &Json) -> String {
    let says = schema.text_of("description");
    let form = alternatives(schema).into_iter().find_map(reference);
    let form = form.map(|name| definition(kind, &name)).filter(|form| form.get("pattern").is_some());
    match form.map(|form| form.text_of("description")) {
        Some(form) if !form.is_empty() && form != says => format!("{says} {form}"),
        _ => says.to_string(),
    }
}

/// The unit that a sentence names.
fn unit(says: &str) -> Option<&'static str> {
    let ends = |rest: &str| rest.is_empty() || rest.starts_with(['.', ';', ',', ')', ' ']);
    let begins = [", ", ": "].into_iter().flat_map(|before| says.split(before).skip(1).map(move |_| before));
    let begins: BTreeSet<&str> = begins.collect();
    UNITS.iter().copied().find(|unit| {
        begins.iter().any(|before| {
            let wanted = format!("{before}{unit}");
            says.match_indices(&wanted).any(|(at, found)| {
                let rest = &says[at + found.len()..];
                ends(rest) && (!rest.starts_with(' ') || rest.starts_with(" ("))
            })
        })
    })
}

/// What a schema may be, without the null that stands for a key left out.
fn alternatives(schema: &Json) -> Vec<&Json> {
    let several = ["anyOf", "oneOf"].into_iter().find_map(|word| match schema.get(word) {
        Some(Json::List(list)) => Some(list),
        _ => None,
    });
    let is_rule = |one: &Json| one.get("required").is_some() && one.get("type").is_none();
    match several {
        Some(list) if !list.iter().all(is_rule) => {
            list.iter().filter(|one| !one.is("type", "null")).collect()
        }
        _ => vec![schema],
    }
}

/// The definition that a schema stands for, itself or behind one that adds a sentence.
fn reference(schema: &Json) -> Option<String> {
    let direct = |schema: &Json| match schema.get("$ref") {
        Some(Json::Text(path)) => path.rsplit('/').next().map(str::to_string),
        _ => None,
    };
    direct(schema).or_else(|| match schema.list_of("allOf") {
        [only] if schema.get("properties").is_none() => direct(only),
        _ => match alternatives(schema)[..] {
            [only] if !std::ptr::eq(only, schema) => direct(only),
            _ => None,
        },
    })
}

/// The keys of a map; one whose type depends on another key has the type that it has where it counts.
fn properties(map: &Json) -> Vec<(String, Json)> {
    let depends = map.get("then").map_or(&[][..], |then| then.entries_of("properties"));
    let whole = |(key, schema): &(String, Json)| {
        let wanted = depends.iter().find(|(name, _)| name == key).map(|(_, schema)| schema);
        let merged = match (schema, wanted) {
            (Json::Map(entries), Some(Json::Map(more))) if entries.len() == 1 => {
                Json::Map(entries.iter().chain(more).cloned().collect())
            }
            _ => schema.clone(),
        };
        (key.clone(), merged)
    };
    map.entries_of("properties").iter().map(whole).collect()
}

fn definition<'a>(kind: &'a Kind, name: &str) -> &'a Json {
    let definitions = kind.schema.get("definitions").unwrap_or(&Json::Null);
    definitions.get(name).unwrap_or_else(|| panic!("{}: no definition {name}", kind.word))
}

/// A number, text, word or truth value: said in the column of its key, without a heading of its own.
fn is_plain(schema: &Json) -> bool {
    let shape = |word: &str| matches!(word, "object" | "array");
    let has_shape = match schema.get("type") {
        Some(Json::List(types)) => types.iter().filter_map(Json::text).any(shape),
        Some(one) => one.text().is_some_and(shape),
        None => schema.get("enum").is_none() && schema.get("const").is_none(),
    };
    !has_shape
}

fn has_keys(schema: &Json) -> bool {
    !schema.entries_of("properties").is_empty()
}

/// The shapes of which a whole file is one; none where the file is a map of keys.
fn forms(schema: &Json) -> Vec<String> {
    if schema.get("properties").is_some() {
        return Vec::new();
    }
    let branches = ["then", "else"].into_iter().filter_map(|word| schema.get(word));
    branches.chain(schema.list_of("oneOf")).filter_map(reference).collect()
}

/// `exactly one of` as a sentence, where a map says so of keys by a list of requirements.
fn exactly_one(map: &Json) -> Option<String> {
    let keys: Vec<String> = map
        .list_of("oneOf")
        .iter()
        .filter(|rule| rule.get("type").is_none())
        .filter_map(|rule| rule.list_of("required").first().map(|key| format!("`{key}`")))
        .collect();
    (keys.len() > 1).then(|| format!("Exactly one of {}.", keys.join(", ")))
}

/// Which definition the arguments of a word have, where a map says so word by word.
fn arguments(map: &Json) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    for rule in map.list_of("allOf") {
        let (Some(condition), Some(then)) = (rule.get("if"), rule.get("then")) else { continue };
        let wanted = then.entries_of("properties").first().map(|(_, schema)| schema);
        let Some(name) = wanted.and_then(reference) else { continue };
        for (_, schema) in condition.entries_of("properties") {
            for word in schema.list_of("enum").iter().chain(schema.get("const")) {
                found.insert(word.to_string(), name.clone());
            }
        }
    }
    found
}

/// The shapes that a kind's file is made of, in the order in which they are come upon.
fn reached(kind: &Kind) -> Vec<String> {
    let mut found = forms(&kind.schema);
    references(kind, &kind.schema, &mut found);
    let mut next = 0;
    while next < found.len() {
        let name = found[next].clone();
        references(kind, definition(kind, &name), &mut found);
        next += 1;
    }
    found
}

/// Adds the shapes that keys and entries of a schema refer to.
fn references(kind: &Kind, schema: &Json, found: &mut Vec<String>) {
    let mut names: Vec<String> = arguments(schema).into_values().collect();
    names.retain(|name| has_keys(definition(kind, name)));
    names.extend(alternatives(schema).into_iter().chain([schema]).filter_map(reference));
    for name in names {
        if !is_plain(definition(kind, &name)) && !found.contains(&name) {
            found.push(name);
        }
    }
    for (_, inner) in properties(schema) {
        references(kind, &inner, found);
    }
    if let Some(inner) = schema.get("items") {
        references(kind, inner, found);
    }
    for alternative in alternatives(schema) {
        if !std::ptr::eq(alternative, schema) {
            references(kind, alternative, found);
        }
    }
}

/// Shapes that more than one kind has, and all that have them alike, down to the shapes within.
fn common(kinds: &[Kind]) -> BTreeSet<String> {
    let mut by_name: BTreeMap<String, Vec<&Kind>> = BTreeMap::new();
    for kind in kinds {
        for name in reached(kind) {
            by_name.entry(name).or_default().push(kind);
        }
    }
    let alike = |name: &str, kinds: &[&Kind]| {
        kinds.len() > 1 && kinds.windows(2).all(|pair| definition(pair[0], name) == definition(pair[1], name))
    };
    let mut common: BTreeSet<String> =
        by_name.iter().filter(|(name, kinds)| alike(name, kinds)).map(|(name, _)| name.clone()).collect();
    loop {
        let whole = |name: &String| {
            let mut inner = Vec::new();
            let kind = by_name[name][0];
            references(kind, definition(kind, name), &mut inner);
            inner.iter().all(|inner| common.contains(inner))
        };
        let kept: BTreeSet<String> = common.iter().filter(|name| whole(name)).cloned().collect();
        if kept.len() == common.len() {
            return kept;
        }
        common = kept;
    }
}

/// The anchor of a heading.
pub fn slug(heading: &str) -> String {
    let lower = heading.trim().to_lowercase();
    let kept = lower.chars().filter(|c| c.is_alphanumeric() || matches!(c, '-' | '_' | ' '));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}
