//! What is on a page of the book: fenced blocks, links, headings, pictures.
//!
//! In: a page's text. Out: its blocks with their info strings and lines, where its links lead, the anchors
//! of its headings. Nothing here reads a file.

use super::reference::slug;
use std::collections::BTreeMap;

/// A fenced block.
#[derive(Debug)]
pub struct Block {
    /// The words behind the fence: `sh`, `sh retry`, `yaml`, ...
    pub info: String,
    pub text: String,
    /// Line of its fence, from 1.
    pub line: usize,
}

impl Block {
    /// The file that a block is, by the name in the comment at its top.
    pub fn file(&self) -> Option<&str> {
        let name = self.text.lines().next()?.strip_prefix("# ")?;
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./".contains(c);
        (name.contains('.') && !name.contains("..") && name.chars().all(plain)).then_some(name)
    }

    /// The exit code that it is to end with: 0 unless a comment line names another one.
    pub fn exit_code(&self) -> i32 {
        let named = self.text.lines().find_map(|line| line.trim().strip_prefix("# exit "));
        named.and_then(|code| code.trim().parse().ok()).unwrap_or(0)
    }

    /// The commands in it: lines that are no comment and do not go on with the line before.
    pub fn commands(&self) -> usize {
        let text = self.text.replace("\\\n", " ");
        text.lines().filter(|line| !line.trim().is_empty() && !line.trim().starts_with('#')).count()
    }
}

/// The fenced blocks of a page, in order.
pub fn blocks(page: &str) -> Vec<Block> {
    let mut found: Vec<Block> = Vec::new();
    let mut open = false;
    for (number, line) in page.lines().enumerate() {
        if let Some(info) = line.strip_prefix("```") {
            if !open {
                found.push(Block { info: info.trim().to_string(), text: String::new(), line: number + 1 });
            }
            open = !open;
        } else if let Some(block) = found.last_mut().filter(|_| open) {
            block.text.push_str(line);
            block.text.push('\n');
        }
    }
    assert!(!open, "the last block of the page is not closed");
    found
}

/// The lines of a page outside of its blocks, fenced or indented, with their numbers from 1.
fn prose(page: &str) -> Vec<(usize, &str)> {
    let mut open = false;
    let mut kept = Vec::new();
    for (number, line) in page.lines().enumerate() {
        if line.starts_with("```") {
            open = !open;
        } else if !open && !line.starts_with("    ") {
            kept.push((number + 1, line));
        }
    }
    kept
}

/// Where the links and pictures of a page lead, with their lines.
pub fn links(page: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (number, line) in prose(page) {
        // What is quoted as code is no link.
        let bare: String = line.split('`').step_by(2).collect();
        for rest in bare.split("](").skip(1) {
            let target = rest.split(')').next().unwrap_or_default();
            found.push((number, target.to_string()));
        }
    }
    found
}

/// The anchors of a page's headings; a heading that there is twice has a number behind it.
pub fn anchors(page: &str) -> Vec<String> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    let headings = prose(page).into_iter().filter(|(_, line)| line.starts_with('#'));
    let slugs = headings.map(|(_, line)| slug(line.trim_start_matches('#')));
    slugs
        .map(|slug| {
            let times = seen.entry(slug.clone()).or_default();
            *times += 1;
            if *times == 1 { slug } else { format!("{slug}-{}", *times - 1) }
        })
        .collect()
}

/// The first line of `wanted` that is not printed, in this order, in `printed`; `...` is anything.
pub fn missing<'a>(wanted: &'a str, printed: &str) -> Option<&'a str> {
    let mut lines = printed.lines();
    wanted.lines().filter(|line| line.trim() != "...").find(|line| !lines.any(|printed| fits(line, printed)))
}

/// Whether a printed line is the wanted one, with anything where that has `...`; columns may be as wide as
/// they are.
fn fits(wanted: &str, printed: &str) -> bool {
    let single = |line: &str| line.split_whitespace().collect::<Vec<_>>().join(" ");
    let (wanted, printed) = (single(wanted), single(printed));
    let parts: Vec<&str> = wanted.split("...").collect();
    let Some(mut rest) = printed.strip_prefix(parts[0]) else { return false };
    for part in &parts[1..] {
        let Some(at) = rest.find(part) else { return false };
        rest = &rest[at + part.len()..];
    }
    rest.is_empty() || parts.last() == Some(&"")
}

#[test]
fn a_printed_line_fits_with_anything_in_its_gaps() {
    assert!(fits("done, ... moves", "done, 12 moves") && fits("cost 3...", "cost 3 in 0.1 s"));
    assert!(fits("lid  done  ...", "lid   done  today      1  done"));
    assert!(!fits("cost 3", "cost 30") && !fits("a...c", "a b") && !fits("b", "a b"));
    assert_eq!(missing("a\n...\nc\n", "a\nb\nc\n"), None);
    assert_eq!(missing("c\na\n", "a\nb\nc\n"), Some("a"));
}

#[test]
fn blocks_links_and_anchors_of_a_page_are_found() {
    let page = "# A `b`\n\n[x](y.md#z) `[no](no.md)`\n\n```sh\ncelld a \\\n  b\n# exit 1\n```\n\n## A b\n\n    [no](no.md)\n";
    let found = blocks(page);
    assert_eq!((found.len(), found[0].info.as_str(), found[0].line), (1, "sh", 5));
    assert_eq!((found[0].commands(), found[0].exit_code(), found[0].file()), (1, 1, None));
    assert_eq!(links(page), [(3, "y.md#z".to_string())]);
    assert_eq!(anchors(page), ["a-b", "a-b-1"]);
    let yaml = blocks("```yaml\n# job.yaml\nversion: 1\n```\n");
    assert_eq!(yaml[0].file(), Some("job.yaml"));
}
