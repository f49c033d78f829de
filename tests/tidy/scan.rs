//! A small scanner for Rust sources: what a file names, without comments, strings and the compiler.
//!
//! In: the text of one file. Out: its code with comments and literals blanked (same length, same lines),
//! the paths it names (use groups unfolded), the macros it calls, and where its test-only items are. It
//! is lexical on purpose: it needs no build, reads files behind any `cfg`, and cannot be fooled by a
//! re-export because the tidy test forbids those.

/// One `a::b::c` of a file; a group `a::{b, c::d}` gives one per leaf.
#[derive(Debug, Clone, PartialEq)]
pub struct CodePath {
    pub line: usize,
    pub segments: Vec<String>,
    /// Offset of the first segment in the blanked text.
    pub offset: usize,
}

impl CodePath {
    /// True when the first segments are these.
    pub fn starts_with(&self, segments: &[&str]) -> bool {
        self.segments.len() >= segments.len() && self.segments.iter().zip(segments).all(|(a, b)| a == b)
    }

    pub fn text(&self) -> String {
        self.segments.join("::")
    }
}

/// The text with comments, string and character literals turned into spaces; newlines stay.
pub fn blank_comments_and_literals(text: &str) -> String {
    let bytes = text.as_bytes();
    let mut out = bytes.to_vec();
    let mut at = 0;
    while at < bytes.len() {
        let end = literal_or_comment_end(bytes, at);
        if end == at {
            at += 1;
            continue;
        }
        for byte in &mut out[at..end] {
            if *byte != b'\n' {
                *byte = b' ';
            }
        }
        at = end;
    }
    // Only whole literals and comments were blanked, so what is left is still UTF-8.
    String::from_utf8(out).expect("blanking keeps UTF-8")
}

/// End of the comment or literal that starts at `at`, or `at` itself when none does.
fn literal_or_comment_end(bytes: &[u8], at: usize) -> usize {
    let rest = &bytes[at..];
    if rest.starts_with(b"//") {
        return at + rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len());
    }
    if rest.starts_with(b"/*") {
        return block_comment_end(bytes, at);
    }
    let in_word = at > 0 && is_word(bytes[at - 1]);
    match rest[0] {
        b'"' => string_end(bytes, at + 1),
        b'\'' => char_end(bytes, at),
        b'b' | b'c' if !in_word && rest.get(1) == Some(&b'"') => string_end(bytes, at + 2),
        b'b' if !in_word && rest.get(1) == Some(&b'\'') => char_end(bytes, at + 1),
        b'r' if !in_word => raw_string_end(bytes, at, at + 1),
        b'b' | b'c' if !in_word && rest.get(1) == Some(&b'r') => raw_string_end(bytes, at, at + 2),
        _ => at,
    }
}

fn block_comment_end(bytes: &[u8], start: usize) -> usize {
    let (mut depth, mut at) = (0usize, start);
    while at < bytes.len() {
        if bytes[at..].starts_with(b"/*") {
            depth += 1;
            at += 2;
        } else if bytes[at..].starts_with(b"*/") {
            depth -= 1;
            at += 2;
            if depth == 0 {
                return at;
            }
        } else {
            at += 1;
        }
    }
    at
}

fn string_end(bytes: &[u8], mut at: usize) -> usize {
    while at < bytes.len() {
        match bytes[at] {
            b'\\' => at += 2,
            b'"' => return at + 1,
            _ => at += 1,
        }
    }
    bytes.len()
}

/// `hashes_at` is where the `#`s of `r##"` begin; not a raw string (`r#type`, a plain name): `start`.
fn raw_string_end(bytes: &[u8], start: usize, hashes_at: usize) -> usize {
    let hashes = bytes[hashes_at..].iter().take_while(|b| **b == b'#').count();
    if bytes.get(hashes_at + hashes) != Some(&b'"') {
        return start;
    }
    let mut close = vec![b'"'];
    close.extend(std::iter::repeat_n(b'#', hashes));
    let body = hashes_at + hashes + 1;
    match bytes[body..].windows(close.len()).position(|window| window == close) {
        Some(found) => body + found + close.len(),
        None => bytes.len(),
    }
}

/// A character literal, or `at` unchanged for a lifetime.
fn char_end(bytes: &[u8], at: usize) -> usize {
    let Some(first) = bytes.get(at + 1) else { return at };
    if *first == b'\\' {
        let close = bytes[(at + 3).min(bytes.len())..].iter().position(|b| *b == b'\'');
        return close.map_or(bytes.len(), |found| at + 3 + found + 1);
    }
    let width = match first {
        0x00..=0x7f => 1,
        0xc0..=0xdf => 2,
        0xe0..=0xef => 3,
        _ => 4,
    };
    if bytes.get(at + 1 + width) == Some(&b'\'') { at + 2 + width } else { at }
}

fn is_word(byte: u8) -> bool {
    byte == b'_' || byte.is_ascii_alphanumeric() || byte >= 0x80
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Name,
    PathSeparator,
    Other(u8),
}

#[derive(Debug, Clone, Copy)]
struct Token<'a> {
    kind: Kind,
    text: &'a str,
    offset: usize,
    /// From 1.
    line: usize,
}

fn tokens(code: &str) -> Vec<Token<'_>> {
    let bytes = code.as_bytes();
    let mut found = Vec::new();
    let (mut at, mut line) = (0, 1);
    while at < bytes.len() {
        let start = at;
        let kind = if bytes[at].is_ascii_whitespace() {
            line += usize::from(bytes[at] == b'\n');
            at += 1;
            continue;
        } else if is_word(bytes[at]) {
            while at < bytes.len() && is_word(bytes[at]) {
                at += 1;
            }
            Kind::Name
        } else if bytes[at..].starts_with(b"::") {
            at += 2;
            Kind::PathSeparator
        } else {
            at += 1;
            Kind::Other(bytes[start])
        };
        found.push(Token { kind, text: &code[start..at], offset: start, line });
    }
    found
}

/// Every path of blanked code. Single names are not paths; `a::{b, c}` is unfolded; a glob is the segment
/// `*`.
pub fn paths(code: &str) -> Vec<CodePath> {
    let tokens = tokens(code);
    let mut found = Vec::new();
    let mut at = 0;
    while at < tokens.len() {
        let starts =
            tokens[at].kind == Kind::Name && tokens.get(at + 1).map(|t| t.kind) == Some(Kind::PathSeparator);
        at = if starts { unfold(&tokens, at, &[], &mut found) } else { at + 1 };
    }
    found
}

/// Reads one path (tree) at `at` behind `prefix`, adds its leaves, gives the token behind it.
fn unfold(tokens: &[Token<'_>], mut at: usize, prefix: &[String], found: &mut Vec<CodePath>) -> usize {
    let mut segments = prefix.to_vec();
    let Token { line, offset, .. } = tokens[at];
    loop {
        match tokens.get(at).map(|token| token.kind) {
            Some(Kind::Name) => segments.push(tokens[at].text.to_string()),
            Some(Kind::Other(b'*')) => segments.push("*".to_string()),
            Some(Kind::Other(b'{')) => return unfold_group(tokens, at + 1, &segments, found),
            // `a::<T>::b`: the generic part holds paths of its own and is read as such.
            _ => break,
        }
        at += 1;
        if tokens.get(at).map(|token| token.kind) != Some(Kind::PathSeparator) {
            break;
        }
        at += 1;
    }
    found.push(CodePath { line, segments, offset });
    at
}

fn unfold_group(tokens: &[Token<'_>], mut at: usize, prefix: &[String], found: &mut Vec<CodePath>) -> usize {
    while at < tokens.len() {
        match tokens[at].kind {
            Kind::Other(b'}') => return at + 1,
            Kind::Name | Kind::Other(b'*') | Kind::Other(b'{') => {
                at = unfold(tokens, at, prefix, found);
                // `as other_name` belongs to the leaf just read.
                if tokens.get(at).is_some_and(|token| token.text == "as") {
                    at += 2;
                }
            }
            _ => at += 1,
        }
    }
    at
}

/// Names called as macros (`name!`), with their lines.
pub fn macro_calls(code: &str) -> Vec<(usize, String)> {
    let tokens = tokens(code);
    let calls = tokens.windows(3).filter(|three| {
        three[0].kind == Kind::Name && three[1].text == "!" && matches!(three[2].text, "(" | "[" | "{")
    });
    calls.map(|three| (three[0].line, three[0].text.to_string())).collect()
}

/// Byte ranges of items behind `#[cfg(test)]`, up to their closing brace or semicolon.
pub fn test_only_ranges(code: &str) -> Vec<(usize, usize)> {
    let tokens = tokens(code);
    let mut ranges = Vec::new();
    let mut at = 0;
    while at < tokens.len() {
        if is_cfg_test(&tokens[at..]) {
            let end = item_end(&tokens, at + 7);
            ranges.push((tokens[at].offset, end.map_or(code.len(), |last| tokens[last].offset + 1)));
            at = end.unwrap_or(tokens.len());
        }
        at += 1;
    }
    ranges
}

fn is_cfg_test(tokens: &[Token<'_>]) -> bool {
    let expected = ["#", "[", "cfg", "(", "test", ")", "]"];
    tokens.len() >= expected.len() && expected.iter().zip(tokens).all(|(text, token)| *text == token.text)
}

/// Last token of the item that starts at `at`: `;` or the brace that closes its body.
fn item_end(tokens: &[Token<'_>], at: usize) -> Option<usize> {
    let mut depth = 0usize;
    for (index, token) in tokens.iter().enumerate().skip(at) {
        match token.kind {
            Kind::Other(b'{') | Kind::Other(b'(') | Kind::Other(b'[') => depth += 1,
            Kind::Other(b'}') => {
                depth = depth.checked_sub(1)?;
                if depth == 0 {
                    return Some(index);
                }
            }
            Kind::Other(b')') | Kind::Other(b']') => depth = depth.checked_sub(1)?,
            Kind::Other(b';') if depth == 0 => return Some(index),
            _ => {}
        }
    }
    None
}

/// Modules declared as files under `#[cfg(test)]` (`#[cfg(test)] mod name;`).
pub fn test_only_file_modules(code: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (start, end) in test_only_ranges(code) {
        let item = tokens(&code[start..end]);
        if let [.., keyword, name, semicolon] = item.as_slice()
            && keyword.text == "mod"
            && semicolon.text == ";"
        {
            found.push(name.text.to_string());
        }
    }
    found
}

/// Line of the first module behind `#[cfg(test)]`, inline or in a file of its own.
pub fn test_module_line(code: &str) -> Option<usize> {
    let tokens = tokens(code);
    let is_module = |at: usize| {
        let mut head = tokens[at + 7..].iter().take_while(|token| token.text != "{" && token.text != ";");
        head.any(|token| token.text == "mod")
    };
    (0..tokens.len()).find(|&at| is_cfg_test(&tokens[at..]) && is_module(at)).map(|at| tokens[at].line)
}

/// Names of modules declared as files of their own (`mod name;`).
pub fn file_modules(code: &str) -> Vec<String> {
    let tokens = tokens(code);
    let declared = tokens.windows(3).filter(|three| {
        three[0].text == "mod" && three[1].kind == Kind::Name && three[2].kind == Kind::Other(b';')
    });
    declared.map(|three| three[1].text.to_string()).collect()
}

/// A function with a body.
#[derive(Debug, Clone, PartialEq)]
pub struct Function {
    pub name: String,
    /// Line of its `fn`; attributes and docs come before it.
    pub first_line: usize,
    /// Line of the brace that closes it.
    pub last_line: usize,
}

/// Every function of blanked code, those inside others and in `impl` blocks too.
pub fn functions(code: &str) -> Vec<Function> {
    let tokens = tokens(code);
    let mut found = Vec::new();
    for at in 0..tokens.len().saturating_sub(1) {
        // `fn(` is a type.
        if tokens[at].text != "fn" || tokens[at + 1].kind != Kind::Name {
            continue;
        }
        let Some(end) = item_end(&tokens, at).filter(|end| tokens[*end].text == "}") else { continue };
        found.push(Function {
            name: tokens[at + 1].text.to_string(),
            first_line: tokens[at].line,
            last_line: tokens[end].line,
        });
    }
    found
}

/// Byte ranges of the bodies of inline modules (`mod name { .. }`).
pub fn inline_module_ranges(code: &str) -> Vec<(usize, usize)> {
    let tokens = tokens(code);
    let mut ranges = Vec::new();
    for at in 0..tokens.len().saturating_sub(2) {
        if tokens[at].text == "mod" && tokens[at + 1].kind == Kind::Name && tokens[at + 2].text == "{" {
            let end = item_end(&tokens, at).map_or(code.len(), |last| tokens[last].offset + 1);
            ranges.push((tokens[at].offset, end));
        }
    }
    ranges
}

/// True when `offset` lies in one of the ranges.
pub fn within(ranges: &[(usize, usize)], offset: usize) -> bool {
    ranges.iter().any(|(start, end)| (*start..*end).contains(&offset))
}

/// The text with these ranges turned into spaces.
pub fn blank_ranges(text: &str, ranges: &[(usize, usize)]) -> String {
    let mut out = text.as_bytes().to_vec();
    for (start, end) in ranges {
        for byte in &mut out[*start..*end] {
            if *byte != b'\n' {
                *byte = b' ';
            }
        }
    }
    String::from_utf8(out).expect("ranges begin and end at tokens")
}
