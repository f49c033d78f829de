//! The book of `docs/`: its commands are run, its pictures are made again, its configuration reference is
//! compared with the schemas, its links are followed.
//!
//! In: the pages. Out: the block that does not do what it says, with all that it printed. A block `sh` is
//! run and ends with 0 (or with the code of its comment `# exit 1`); `sh retry` is repeated until it
//! succeeds and prints the block `text` that follows, for what a reader waits for; `sh background` goes on
//! beside the rest of its page; `yaml` with a file's name in its first line is that file; `text` is
//! printed by the block before, line by line, `...` being anything; `console` is what no test can do, of
//! which the words alone are tried. With `CELLD_WRITE=1` the reference and the pictures are written
//! instead.

#![allow(clippy::unwrap_used, reason = "helpers of tests: an unwrap that fails is the test that fails")]

mod ordered;
mod pages;
mod reference;
mod sandbox;

use ordered::Json;
use pages::{Block, anchors, blocks, links, missing};
use sandbox::Sandbox;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// Most bytes of a picture.
const PICTURE_BYTES: usize = 60_000;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Compares a file of the repository with what the program makes of it, or writes it.
#[track_caller]
fn held(path: &str, made: &str) {
    if std::env::var_os("CELLD_WRITE").is_some() {
        std::fs::write(root().join(path), made).unwrap();
    }
    let kept = std::fs::read_to_string(root().join(path)).unwrap_or_default();
    assert!(kept == made, "{path} is out of date: CELLD_WRITE=1 cargo test --test it book:: writes it anew");
}

/// The names of the pages in docs/.
fn names() -> BTreeSet<String> {
    let entries = std::fs::read_dir(root().join("docs")).unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    names.filter(|name| name.ends_with(".md")).collect()
}

/// Runs the commands of a page, of which there are at least `least`, and holds its pictures.
fn runs(sandbox: &Sandbox, page: &str, least: usize) {
    let text = read(&format!("docs/{page}"));
    let (mut run, mut printed) = (0, String::new());
    let all = blocks(&text);
    for (block, next) in all.iter().zip(all.iter().skip(1).map(Some).chain([None])) {
        let begun = Instant::now();
        match block.info.as_str() {
            "sh" => printed = sandbox.run(page, block),
            "sh retry" => {
                let wanted = next.filter(|next| next.info == "text").map_or("", |next| &next.text);
                printed = sandbox.run_until_it_prints(page, block, wanted);
            }
            "sh background" => sandbox.run_beside(page, block),
            "yaml" => sandbox.keep(block),
            "text" => {
                let line = missing(&block.text, &printed);
                assert!(line.is_none(), "{page}:{}: not printed: {line:?}\n{printed}", block.line);
            }
            "console" => knows_the_words(page, block),
            other => panic!("{page}:{}: a block of unknown kind {other:?}", block.line),
        }
        if block.info.starts_with("sh") {
            println!("{page}:{}: {:.1} s", block.line, begun.elapsed().as_secs_f64());
            run += block.commands();
        }
    }
    assert!(run >= least, "{page}: {run} commands, at least {least} were to be run");
    for (_, link) in links(&text) {
        if let Some(name) = link.strip_prefix("pictures/") {
            let made = std::fs::read_to_string(sandbox.path().join(name));
            let made = made.unwrap_or_else(|error| panic!("{page}: no command makes {name}: {error}"));
            assert!(made.len() <= PICTURE_BYTES, "{name} has {} bytes", made.len());
            held(&format!("docs/pictures/{name}"), &made);
        }
    }
}

/// What is not run: commands of celld are known with their options, targets of make exist.
fn knows_the_words(page: &str, block: &Block) {
    let makefile = read("Makefile");
    for line in block.text.replace("\\\n", " ").lines() {
        let bare = line.split(" #").next().unwrap_or_default().trim();
        if let Some(words) = bare.strip_prefix("celld ") {
            let mut celld = Command::new(crate::cell::CELLD);
            let help = celld.args(words.split_whitespace()).arg("--help").output().unwrap();
            assert!(help.status.success(), "{page}:{}: no such command: {line}", block.line);
        }
        if let Some(words) = bare.strip_prefix("make ") {
            let target = words.split_whitespace().next().unwrap_or_default();
            assert!(makefile.contains(&format!("\n{target}:")), "{page}:{}: no target {target}", block.line);
        }
    }
}

#[test]
fn cell_book_quick_start_goes_from_a_clone_to_a_rearranged_table() {
    let sandbox = Sandbox::new("127.7.21.1", 2);
    runs(&sandbox, "quick-start.md", 12);
    std::fs::copy(sandbox.path().join("out/two/run.mcap"), sandbox.path().join("run.mcap")).unwrap();
    runs(&sandbox, "recordings.md", 3);
}

#[test]
fn cell_book_jobs_does_what_each_recipe_says() {
    runs(&Sandbox::new("127.7.21.2", 3), "jobs.md", 20);
}

#[test]
fn book_pages_that_need_no_devices_run_as_printed() {
    let sandbox = Sandbox::new("127.7.21.3", 1);
    for (page, least) in
        [("concepts.md", 3), ("solvers.md", 11), ("calibration.md", 3), ("commissioning.md", 1)]
    {
        runs(&sandbox, page, least);
    }
}

/// The kinds in the order of the page.
fn kinds() -> Vec<reference::Kind> {
    let words = ["config", "sim", "job", "goal", "instance", "plan", "calibration", "faults"];
    let schema = |word: &str| serde_json::from_str(&read(&format!("schemas/{word}.json"))).unwrap();
    words.into_iter().map(|word| reference::Kind { word, schema: schema(word) }).collect()
}

/// Every key that a schema names, wherever it names it.
fn keys_of(schema: &Json, found: &mut BTreeSet<String>) {
    match schema {
        Json::List(list) => list.iter().for_each(|item| keys_of(item, found)),
        Json::Map(entries) => entries.iter().for_each(|(_, value)| keys_of(value, found)),
        _ => {}
    }
    found.extend(schema.entries_of("properties").iter().map(|(key, _)| key.clone()));
}

#[test]
fn book_has_every_key_of_every_schema() {
    let kinds = kinds();
    let (page, rows) = reference::page(&kinds);
    held("docs/configuration.md", &page);
    assert!(rows > 400, "{rows} rows");
    for kind in &kinds {
        let mut keys = BTreeSet::new();
        keys_of(&kind.schema, &mut keys);
        for key in keys {
            let in_row = |line: &&str| {
                let path = line.strip_prefix("| `").and_then(|rest| rest.split('`').next()).unwrap_or("");
                path.rsplit('.').next() == Some(&key)
            };
            assert!(page.lines().any(|line| in_row(&line)), "{}: {key} is in no row", kind.word);
        }
    }
    let anchors = anchors(&page);
    for (line, link) in links(&page).into_iter().filter(|(_, link)| link.starts_with('#')) {
        assert!(anchors.iter().any(|anchor| *anchor == link[1..]), "configuration.md:{line}: {link}");
    }
}

#[test]
fn book_summary_has_every_page_once() {
    let summary = read("docs/SUMMARY.md");
    let chapters: Vec<String> = links(&summary.replace("    - ", "- ")).into_iter().map(|(_, l)| l).collect();
    let once: BTreeSet<String> = chapters.iter().cloned().collect();
    assert_eq!(once.len(), chapters.len(), "a page is a chapter once: {chapters:?}");
    let mut pages = names();
    assert!(pages.remove("SUMMARY.md"));
    assert_eq!(once, pages);
    for page in &pages {
        let text = read(&format!("docs/{page}"));
        if let Some(included) = text.strip_prefix("{{#include ").and_then(|rest| rest.split('}').next()) {
            assert!(root().join("docs").join(included).is_file(), "{page} includes {included}");
        }
    }
}

/// Where a page of the book leads out of docs/, the book has a page for it.
fn is_in_the_book(target: &str, makefile: &str) -> bool {
    let html = target.trim_end_matches(".md").replace('.', "\\.");
    makefile.contains(&format!("href=\"\\.\\./{html}\\.html|"))
}

#[test]
fn book_links_lead_somewhere() {
    let makefile = read("Makefile");
    let mut pages: Vec<String> = names().into_iter().map(|name| format!("docs/{name}")).collect();
    for name in ["README.md", "CONTRIBUTING.md", "ARCHITECTURE.md", "config/README.md"] {
        pages.push(name.to_string());
    }
    for name in ["calibration/README.md", "hardware/README.md", "fuzz/README.md"] {
        pages.push(name.to_string());
    }
    let (mut followed, mut dead) = (0, Vec::new());
    for page in &pages {
        let folder = PathBuf::from(page).parent().unwrap().to_path_buf();
        for (line, link) in links(&read(page)) {
            if link.contains("://") {
                continue;
            }
            followed += 1;
            let (file, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let path = if file.is_empty() { PathBuf::from(page) } else { folder.join(file) };
            let at = format!("{page}:{line}: {link}");
            let Ok(text) = std::fs::read(root().join(&path)) else {
                dead.push(at);
                continue;
            };
            let text = String::from_utf8_lossy(&text);
            if !anchor.is_empty() && !anchors(&text).iter().any(|known| known == anchor) {
                dead.push(format!("{at}: no such heading"));
            }
            let outside = file.strip_prefix("../").filter(|_| page.starts_with("docs/"));
            if outside.is_some_and(|target| !is_in_the_book(target, &makefile)) {
                dead.push(format!("{at}: no page of the book, see BOOK_LINKS in the Makefile"));
            }
        }
    }
    assert!(dead.is_empty(), "{}", dead.join("\n"));
    assert!(followed > 100, "{followed} links");
}

/// With these words a text has a person move the arm, which a pendant allows in Local Control alone.
const BY_HAND: [&str; 6] =
    ["jog ", "jogged ", "guide the arm ", "move the arm by hand", "bring the tip ", "with freedrive"];

/// The Rust files below a folder, without those of unit tests.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let kept = entries.filter(|path| path.file_stem().is_some_and(|name| name != "tests"));
    let files = kept.flat_map(|path| if path.is_dir() { sources(&path) } else { vec![path] });
    files.filter(|path| path.extension().is_some_and(|extension| extension == "rs")).collect()
}

/// The string literals of Rust code before its unit tests.
fn literals(code: &str) -> Vec<String> {
    let code = code.split("\nmod tests {").next().unwrap_or_default();
    let lines: Vec<&str> = code.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
    let code = lines.join("\n").replace("\\\"", "").replace("'\"'", "").replace("\\\n", " ");
    code.split('"').skip(1).step_by(2).map(str::to_string).collect()
}

#[test]
fn book_and_hints_name_local_control_where_a_person_moves_the_arm() {
    let (mut found, mut silent) = (0, Vec::new());
    let mut check = |place: &str, text: &str, hint: &str| {
        let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        if BY_HAND.iter().any(|phrase| words(text).to_lowercase().contains(phrase)) {
            found += 1;
            if !words(hint).contains("Local Control") {
                silent.push(format!("{place}: {}", words(text)));
            }
        }
    };
    for name in names() {
        // A row of a table and an item of a list are read alone.
        let page = read(&format!("docs/{name}")).replace("\n|", "\n\n|").replace("\n* ", "\n\n* ");
        page.split("\n\n").for_each(|paragraph| check(&name, paragraph, paragraph));
    }
    let sources = ["src", "crates"].map(|folder| sources(&root().join(folder))).concat();
    // The words of a `Jog` are completed in travel.rs.
    for path in sources.iter().filter(|path| !path.ends_with("cell-motion/src/jog.rs")) {
        let all = literals(&std::fs::read_to_string(path).unwrap());
        for (at, text) in all.iter().enumerate() {
            // A hint may be put together from several literals.
            let hint = all[at.saturating_sub(2)..(at + 3).min(all.len())].join(" ");
            check(&path.display().to_string(), text, &hint);
        }
    }
    assert!(silent.is_empty(), "{}", silent.join("\n"));
    assert!(found >= 10, "{found} instructions");
}
