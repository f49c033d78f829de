//! The rules of the house as functions from files to breaches.
//!
//! In: a module table and files (real or planted). Out: one line per breach with file, line and what to do.

use crate::scan;
use crate::tree::File;

/// One line of the module table: a crate by its folder below `crates`, or a module of `src`.
pub struct Row {
    pub module: &'static str,
    pub uses: Uses,
    pub pure: bool,
}

/// What a module may use.
pub enum Uses {
    /// These modules (or `module::submodule`).
    Only(&'static [&'static str]),
    /// Every module in a row above but some, and these submodules of them.
    AllAbove { but: &'static [&'static str], also: &'static [&'static str] },
}

fn position(table: &[Row], module: &str) -> Option<usize> {
    table.iter().position(|row| row.module == module)
}

/// True when `module` may name `used` (`name` or `name::submodule`).
pub fn allows(table: &[Row], module: &str, used: &str) -> bool {
    let Some(row) = position(table, module) else { return false };
    let top = used.split("::").next().unwrap_or(used);
    if top == module {
        return true;
    }
    match &table[row].uses {
        Uses::Only(names) => names.iter().any(|name| *name == top || *name == used),
        Uses::AllAbove { but, also } => {
            let above = table[..row].iter().any(|above| above.module == top);
            above && (!but.contains(&top) || also.contains(&used))
        }
    }
}

/// Names the table uses before they are in it: a cycle or a wrong reading order.
pub fn table_faults(table: &[Row]) -> Vec<String> {
    let mut faults = Vec::new();
    for (index, row) in table.iter().enumerate() {
        let (names, more): (&[&str], &[&str]) = match &row.uses {
            Uses::Only(names) => (names, &[]),
            Uses::AllAbove { but, also } => (but, also),
        };
        for name in names.iter().chain(more) {
            let top = name.split("::").next().unwrap_or(name);
            match position(table, top) {
                Some(above) if above < index => {}
                _ => faults.push(format!("{}: `{name}` does not stand in a row above", row.module)),
            }
        }
        if position(table, row.module) != Some(index) {
            faults.push(format!("{}: listed twice", row.module));
        }
        let impure = |name: &&&str| position(table, name).is_some_and(|at| !table[at].pure);
        if let (true, Uses::Only(names)) = (row.pure, &row.uses)
            && let Some(name) = names.iter().find(impure)
        {
            faults.push(format!("{}: pure, but uses `{name}`, which is not", row.module));
        }
    }
    faults
}

/// The crate or top-level module that a source file belongs to; `None` for the roots of celld and its
/// binary.
fn top_module(path: &str) -> Option<&str> {
    if let Some(inside) = path.strip_prefix("crates/") {
        return inside.split('/').next();
    }
    let inside = path.strip_prefix("src/")?;
    if inside == "lib.rs" || inside == "main.rs" || inside.starts_with("bin/") {
        return None;
    }
    inside.split('/').next().map(|part| part.trim_end_matches(".rs"))
}

/// Source files of modules the table does not know, rows without a file, and modules declared in `lib.rs`
/// in another order than the table's.
pub fn modules_missing_from(table: &[Row], files: &[File]) -> Vec<String> {
    let mut breaches = Vec::new();
    for file in files {
        if let Some(module) = top_module(&file.path)
            && position(table, module).is_none()
        {
            breaches.push(format!("{}: module `{module}` is not in the table", file.path));
        }
    }
    for row in table {
        if !files.iter().any(|file| top_module(&file.path) == Some(row.module)) {
            breaches.push(format!("table: module `{}` has no file", row.module));
        }
    }
    if let Some(root) = files.iter().find(|file| file.path == "src/lib.rs") {
        let own = |row: &&Row| files.iter().any(|file| is_module_of_src(&file.path, row.module));
        let listed: Vec<&str> = table.iter().filter(own).map(|row| row.module).collect();
        breaches.extend(order_breach(&listed, root));
    }
    let roots = files.iter().filter(|file| file.path.ends_with("src/lib.rs"));
    breaches.extend(roots.flat_map(re_exports));
    breaches
}

fn is_module_of_src(path: &str, module: &str) -> bool {
    path.starts_with("src/") && top_module(path) == Some(module)
}

/// `lib.rs` declares the table's modules in the table's order.
fn order_breach(listed: &[&str], root: &File) -> Option<String> {
    let code = scan::blank_comments_and_literals(&root.text);
    let declared: Vec<&str> = code
        .lines()
        .filter_map(|line| line.trim().trim_start_matches("pub ").strip_prefix("mod ")?.strip_suffix(';'))
        .collect();
    (declared != listed).then(|| format!("{}: declares {declared:?}, the table lists {listed:?}", root.path))
}

/// A crate's root re-exports nothing: a re-export would hide from the scan where a name comes from.
fn re_exports(root: &File) -> Vec<String> {
    let code = scan::blank_comments_and_literals(&root.text);
    let mut breaches = Vec::new();
    for (number, line) in code.lines().enumerate() {
        let line = line.trim();
        if line.starts_with("pub use") || line.starts_with("pub(crate) use") {
            breaches.push(format!("{}:{}: re-export at the crate root", root.path, number + 1));
        }
    }
    breaches
}

/// Uses of a module that the row does not name, and the ways around the scan.
pub fn layering_breaches(table: &[Row], files: &[File]) -> Vec<String> {
    files.iter().flat_map(|file| layering_breaches_of(table, file)).collect()
}

fn layering_breaches_of(table: &[Row], file: &File) -> Vec<String> {
    let code = scan::blank_comments_and_literals(&file.text);
    let inline_modules = scan::inline_module_ranges(&code);
    let mut breaches = Vec::new();
    for path in scan::paths(&code) {
        let mut breach = |what: String| breaches.push(format!("{}:{}: {what}", file.path, path.line));
        let text = path.text();
        if path.starts_with(&["super", "super"]) {
            breach("`super::super`; name the path from `crate::`".to_string());
        }
        let Some(module) = top_module(&file.path) else { continue };
        let is_module_root =
            file.path == format!("src/{module}.rs") || file.path == format!("src/{module}/mod.rs");
        if path.starts_with(&["super"]) && is_module_root && !scan::within(&inline_modules, path.offset) {
            breach(format!("`{text}` leaves the module unseen; name it from `crate::`"));
        }
        if path.starts_with(&["celld"]) {
            breach(format!("`{text}`: inside the library it is `crate::`"));
        }
        let Some(used) = used_room(table, &file.path, &path.segments) else { continue };
        if used.is_empty() || used.starts_with('*') || used.starts_with("self") {
            breach(format!("`{text}` takes the whole crate; name the modules"));
        } else if !allows(table, module, &used) {
            breach(format!("`{module}` may not use `{used}`"));
        }
    }
    breaches
}

/// What a path names of the table, `name` or `name::submodule`: a module of celld behind `crate`, a crate by
/// its own name. `None` for a path inside one's own crate and for foreign ones.
fn used_room(table: &[Row], file: &str, segments: &[String]) -> Option<String> {
    let first = segments.first()?;
    if first == "crate" {
        let inside = segments.get(1..3.min(segments.len())).unwrap_or(&[]);
        return (!file.starts_with("crates/")).then(|| inside.join("::"));
    }
    let name = first.replace('_', "-");
    let is_crate = table.iter().any(|row| row.module == name) && name.contains('-');
    if !is_crate && !CRATES_OF_ONE_WORD.contains(&name.as_str()) {
        return None;
    }
    Some(segments.get(1).map_or(name.clone(), |inner| format!("{name}::{inner}")))
}

/// Crates whose names could as well be those of modules.
const CRATES_OF_ONE_WORD: &[&str] = &["rearrange", "urscript"];

/// Crates of the workspace that a crate's manifest names, against its row of the table. Cargo holds what the
/// manifests say; this holds the manifests to the table.
pub fn manifest_breaches(table: &[Row], manifests: &[File]) -> Vec<String> {
    let mut breaches = Vec::new();
    for manifest in manifests {
        let Some(row) = top_module(&manifest.path).and_then(|name| position(table, name)) else { continue };
        let is_room = |name: &&str| position(table, name).is_some();
        let needed: Vec<&str> =
            dependencies(&manifest.text, "[dependencies]").into_iter().filter(is_room).collect();
        let top = |name: &'static str| name.split("::").next().unwrap_or(name);
        let wanted: Vec<&str> = match &table[row].uses {
            Uses::Only(names) => {
                let mut names: Vec<&str> = names.iter().map(|name| top(name)).collect();
                names.dedup();
                names
            }
            // What it could use, and does not, is no breach.
            Uses::AllAbove { .. } => {
                needed.iter().copied().filter(|name| allows(table, table[row].module, name)).collect()
            }
        };
        if needed != wanted {
            breaches.push(format!("{}: depends on {needed:?}, the table says {wanted:?}", manifest.path));
        }
    }
    breaches
}

/// Names in the sections of a manifest whose heading ends so.
fn dependencies<'a>(manifest: &'a str, heading: &str) -> Vec<&'a str> {
    let mut names = Vec::new();
    let mut inside = false;
    for line in manifest.lines() {
        if line.starts_with('[') {
            inside = line.trim().ends_with(heading);
        } else if let (true, Some((name, _))) = (inside, line.split_once('=')) {
            names.push(name.trim().trim_end_matches(".workspace"));
        }
    }
    names
}

/// What a pure module may not name, as the beginning of a path, with the way out.
const IMPURE_PATHS: &[(&[&str], &str)] = &[
    (&["std", "time", "Instant"], "time comes in as `crate::time::Timestamp`"),
    (&["std", "time", "SystemTime"], "time comes in as an argument"),
    (&["std", "time", "UNIX_EPOCH"], "time comes in as an argument"),
    (&["std", "time", "*"], "name what you need of std::time"),
    (&["Instant", "now"], "time comes in as `crate::time::Timestamp`"),
    (&["SystemTime"], "time comes in as an argument"),
    (&["tokio"], "sockets and tasks belong to io, sim and daemon"),
    (&["std", "net"], "sockets belong to io, sim and daemon"),
    (&["std", "fs"], "texts and bytes come in as arguments"),
    (&["std", "env"], "settings come in as arguments"),
    (&["std", "process"], "processes belong to the shell"),
    (&["std", "thread"], "threads belong to the caller"),
    (&["std", "thread_local"], "state comes in as an argument"),
    (&["rand", "rng"], "random numbers come from a seed that is recorded"),
    (&["rand", "random"], "random numbers come from a seed that is recorded"),
    (&["rand", "thread_rng"], "random numbers come from a seed that is recorded"),
    (&["rand", "rngs", "ThreadRng"], "random numbers come from a seed that is recorded"),
    (&["rand", "rngs", "OsRng"], "random numbers come from a seed that is recorded"),
    (&["rand", "rngs", "SysRng"], "random numbers come from a seed that is recorded"),
];
const IMPURE_MACROS: &[&str] = &["println", "eprintln", "print", "eprint", "dbg", "thread_local"];

/// Clocks, sockets, files, threads, unseeded randomness and printing in modules that are declared pure.
/// Items behind `#[cfg(test)]` are exempt.
pub fn purity_breaches(table: &[Row], files: &[File]) -> Vec<String> {
    let test_files = test_only_files(files);
    let mut breaches = Vec::new();
    for file in files {
        let pure =
            top_module(&file.path).and_then(|name| position(table, name)).is_some_and(|at| table[at].pure);
        if !pure || test_files.iter().any(|stem| belongs_to(&file.path, stem)) {
            continue;
        }
        let code = scan::blank_comments_and_literals(&file.text);
        let code = scan::blank_ranges(&code, &scan::test_only_ranges(&code));
        for path in scan::paths(&code) {
            if let Some((_, way_out)) = IMPURE_PATHS.iter().find(|(banned, _)| path.starts_with(banned)) {
                breaches.push(format!(
                    "{}:{}: `{}` in a pure module: {way_out}",
                    file.path,
                    path.line,
                    path.text()
                ));
            }
        }
        for (line, name) in scan::macro_calls(&code) {
            if IMPURE_MACROS.contains(&name.as_str()) {
                breaches.push(format!("{}:{line}: `{name}!` in a pure module: return the text", file.path));
            }
        }
    }
    breaches
}

/// Paths without ending of files declared by `#[cfg(test)] mod name;`.
pub fn test_only_files(files: &[File]) -> Vec<String> {
    let mut stems = Vec::new();
    for file in files {
        let folder = match file.path.strip_suffix("/mod.rs") {
            Some(folder) => folder.to_string(),
            None => file.path.trim_end_matches(".rs").to_string(),
        };
        let code = scan::blank_comments_and_literals(&file.text);
        stems.extend(scan::test_only_file_modules(&code).into_iter().map(|name| format!("{folder}/{name}")));
    }
    stems
}

/// True for the file of that path without ending, and for those below it.
pub fn belongs_to(path: &str, stem: &str) -> bool {
    path.strip_prefix(stem).is_some_and(|rest| rest == ".rs" || rest.starts_with('/'))
}

/// The native libraries and the only places (path beginnings) that may call them.
const NATIVE: &[(&str, &[&str])] = &[
    ("opencv", &["crates/cell-vision/src/cv.rs", "src/bin/celld-video"]),
    ("libloading", &["src/io/camera/realsense/"]),
    ("apriltag", &["crates/cell-vision/src/detect.rs", "crates/cell-vision/src/detect/"]),
    ("apriltag_sys", &["crates/cell-vision/src/detect.rs", "crates/cell-vision/src/detect/"]),
];

/// Calls of native libraries outside the files that wrap them.
pub fn native_breaches(files: &[File]) -> Vec<String> {
    let mut breaches = Vec::new();
    for file in files {
        let code = scan::blank_comments_and_literals(&file.text);
        for path in scan::paths(&code) {
            for (library, places) in NATIVE {
                if path.starts_with(&[library]) && !places.iter().any(|place| file.path.starts_with(place)) {
                    breaches.push(format!(
                        "{}:{}: `{library}` belongs in {}",
                        file.path,
                        path.line,
                        places.join(" or ")
                    ));
                }
            }
        }
    }
    breaches
}

/// A Rust file that does not say at its top what it is for.
pub fn opening_breach(file: &File) -> Option<String> {
    let first = file.text.lines().next().unwrap_or("");
    let says_something =
        first.strip_prefix("//! ").is_some_and(|words| words.split_whitespace().count() >= 3);
    (!says_something).then(|| format!("{}:1: opens without a `//!` sentence", file.path))
}

/// A source file longer than `most` lines.
pub fn length_breach(file: &File, most: usize) -> Option<String> {
    let lines = file.text.lines().count();
    (lines > most).then(|| format!("{}: {lines} lines; split it by subject (at most {most})", file.path))
}

/// Files with more than `most` lines before their test module. Files of tests may be longer: a test is read
/// by itself.
pub fn long_files(files: &[File], most: usize) -> Vec<String> {
    let test_files = test_only_files(files);
    let is_test =
        |path: &str| path.starts_with("tests/") || test_files.iter().any(|stem| belongs_to(path, stem));
    let mut breaches = Vec::new();
    for file in files.iter().filter(|file| !is_test(&file.path)) {
        let code = scan::blank_comments_and_literals(&file.text);
        let lines = scan::test_module_line(&code).map_or(file.text.lines().count(), |line| line - 1);
        if lines > most {
            breaches.push(format!(
                "{}: {lines} lines without its tests; split it by subject (at most {most})",
                file.path
            ));
        }
    }
    breaches
}

/// Comments that reach beyond column `most`. A line of code that is longer than that carries none.
pub fn wide_comments(file: &File, most: usize) -> Vec<String> {
    let is_rust = file.path.ends_with(".rs");
    let hashed = [".yaml", ".toml", ".script", ".py", "Makefile", "run"];
    if !is_rust && !hashed.iter().any(|ending| file.path.ends_with(ending)) {
        return Vec::new();
    }
    let code = if is_rust { scan::blank_comments_and_literals(&file.text) } else { String::new() };
    let docstrings = if file.path.ends_with(".py") { docstring_lines(&file.text) } else { Vec::new() };
    let has_comment = |number: usize, line: &str| {
        if is_rust {
            // What was blanked and is no literal: the code ends before the slashes do.
            let kept = code.lines().nth(number).unwrap_or("").trim_end();
            return line.get(kept.len()..).is_some_and(|rest| rest.trim_start().starts_with("//"));
        }
        let in_docstring = docstrings.get(number).is_some_and(|inside| *inside);
        in_docstring || line.trim_start().starts_with('#') || line.contains(" # ")
    };
    let wide = file.text.lines().enumerate().filter(|(_, line)| line.chars().count() > most);
    let found = wide.filter(|(number, line)| has_comment(*number, line));
    found.map(|(number, _)| format!("{}:{}: a comment beyond column {most}", file.path, number + 1)).collect()
}

/// What people do and things do not: in comments and pages a subject requests, reports or receives.
const PERSONS_WORDS: [&str; 12] = [
    "ask", "asks", "asked", "asking", "tell", "tells", "told", "hear", "hears", "heard", "somebody",
    "someone",
];

/// Comments and pages in which things act like persons. Quoted code may say what it likes.
pub fn persons_words(file: &File) -> Vec<String> {
    let is_rust = file.path.ends_with(".rs");
    if !is_rust && !file.path.ends_with(".md") {
        return Vec::new();
    }
    let code = if is_rust { scan::blank_comments_and_literals(&file.text) } else { String::new() };
    let prose = |number: usize, line: &str| -> String {
        let from = if is_rust {
            let kept = code.lines().nth(number).unwrap_or("").trim_end();
            let rest = line.get(kept.len()..).unwrap_or("").trim_start();
            if rest.starts_with("//") { rest } else { "" }
        } else if line.starts_with("    ") {
            ""
        } else {
            line
        };
        from.split('`').step_by(2).collect::<Vec<_>>().join(" ")
    };
    let found = |(number, line): (usize, &str)| {
        let prose = prose(number, line).to_lowercase();
        let mut words = prose.split(|c: char| !c.is_alphanumeric());
        let word = words.find(|word| PERSONS_WORDS.contains(word))?;
        Some(format!("{}:{}: things do not {word:?}", file.path, number + 1))
    };
    file.text.lines().enumerate().filter_map(found).collect()
}

/// Public functions that return a `Result` and do not say when it is an error. Clippy sees only those that
/// other crates reach.
pub fn unnamed_errors(file: &File) -> Vec<String> {
    if !file.path.ends_with(".rs") || file.path.contains("/tests") || file.path.starts_with("tests/") {
        return Vec::new();
    }
    let code = scan::blank_comments_and_literals(&file.text);
    let (code, lines): (Vec<&str>, Vec<&str>) = (code.lines().collect(), file.text.lines().collect());
    let found = |(number, line): (usize, &&str)| {
        let line = line.trim_start();
        let named = line.strip_prefix("pub fn ").or_else(|| line.strip_prefix("pub async fn "))?;
        let end = code[number..]
            .iter()
            .position(|line| line.contains(['{', ';']))
            .map_or(code.len(), |more| number + more + 1);
        let signature = code[number..end].join(" ");
        let above = lines[..number].iter().rev().map(|line| line.trim_start());
        let mut docs = above.take_while(|line| line.starts_with("///") || line.starts_with("#["));
        let returns = signature.rsplit_once("->").map_or("", |(_, returned)| returned.trim_start());
        let silent = returns.starts_with("Result<") && !docs.any(|line| line.starts_with("/// # Errors"));
        let name = named.split(|c: char| !(c.is_alphanumeric() || c == '_')).next().unwrap_or_default();
        silent.then(|| format!("{}:{}: `{name}` does not say when it is an error", file.path, number + 1))
    };
    code.iter().enumerate().filter_map(found).collect()
}

/// For each line of a Python file, whether it belongs to a text in three quotes.
fn docstring_lines(text: &str) -> Vec<bool> {
    let mut inside = false;
    let lines = text.lines().map(|line| {
        let quotes = line.matches("\"\"\"").count();
        let belongs = inside || quotes > 0;
        inside ^= quotes % 2 == 1;
        belongs
    });
    lines.collect()
}

/// Functions of more than `most` lines, from the `fn` to the closing brace.
pub fn long_functions(file: &File, most: usize) -> Vec<String> {
    let code = scan::blank_comments_and_literals(&file.text);
    let functions = scan::functions(&code).into_iter().map(|f| (f.last_line + 1 - f.first_line, f));
    let long = functions.filter(|(lines, _)| *lines > most);
    let found = long.map(|(lines, function)| {
        let scan::Function { name, first_line, .. } = function;
        format!(
            "{}:{first_line}: `{name}` has {lines} lines; give its parts names (at most {most})",
            file.path
        )
    });
    found.collect()
}

/// Marks of unfinished work, places kept free for figures among them. Put together here, so that this file
/// does not name them itself.
fn marks() -> Vec<String> {
    let halves = [
        ("TO", "DO"),
        ("FIX", "ME"),
        ("XX", "X"),
        ("todo", "!("),
        ("unimplemented", "!("),
        ("#[ig", "nore"),
        ("@", "@"),
    ];
    halves.iter().map(|(a, b)| format!("{a}{b}")).collect()
}

/// True when `mark` occurs in `line` and is not a piece of a longer word (the controller really sends
/// messages with such a piece in their names).
fn stands_alone(line: &str, mark: &str) -> bool {
    let in_word = |c: char| c == '_' || c.is_alphanumeric();
    line.match_indices(mark).any(|(at, _)| {
        let before = line[..at].chars().next_back().is_some_and(in_word);
        let after = line[at + mark.len()..].chars().next().is_some_and(in_word);
        !(before || after && mark.ends_with(in_word))
    })
}

/// Marks of unfinished work, wherever they are.
pub fn unfinished_marks(file: &File) -> Vec<String> {
    let marks = marks();
    let lines = file.text.lines().enumerate();
    let found = lines.filter_map(|(number, line)| {
        let mark = marks.iter().find(|mark| stands_alone(line, mark))?;
        Some(format!("{}:{}: `{mark}`", file.path, number + 1))
    });
    found.collect()
}

/// Paths a user does not have: absolute ones of a developer's machine, and the folder of reference data that
/// only tests and the Makefile may look for.
pub fn machine_paths(file: &File) -> Vec<String> {
    if file.path == "Makefile" || file.path.starts_with("tests/") || file.path.starts_with("benches/") {
        return Vec::new();
    }
    let banned = ["../shared", "/work/", "/home/", "/root/", "/Users/"];
    let lines = file.text.lines().enumerate();
    let found = lines.filter_map(|(number, line)| {
        let path = banned.iter().find(|path| line.contains(*path))?;
        Some(format!("{}:{}: `{path}` exists on one machine only", file.path, number + 1))
    });
    found.collect()
}

/// First cells of the rows of the Markdown table behind a heading, with all cells.
fn table_rows<'a>(markdown: &'a str, heading: &str) -> Vec<Vec<&'a str>> {
    let section = markdown.split_once(heading).map_or("", |(_, rest)| rest);
    let section = section.split("\n## ").next().unwrap_or("");
    let rows = section.lines().filter(|line| line.starts_with('|') && !line.starts_with("|-"));
    rows.skip(1).map(|line| line.trim_matches('|').split('|').map(str::trim).collect()).collect()
}

fn code_words(cell: &str) -> Vec<&str> {
    cell.split('`').skip(1).step_by(2).collect()
}

/// Libraries without a line in the dependency table of ARCHITECTURE.md, lines without a library, and
/// libraries of the workspace that no crate uses. `manifests` are the workspace's own and those of its
/// crates.
pub fn dependency_breaches(manifests: &[File], architecture: &str) -> Vec<String> {
    let mut breaches = Vec::new();
    let of = |heading: &'static str| manifests.iter().flat_map(move |m| dependencies(&m.text, heading));
    let is_library = |name: &&str| !manifests.iter().any(|m| m.path == format!("crates/{name}/Cargo.toml"));
    let wanted: Vec<&str> = of("[workspace.dependencies]").filter(is_library).collect();
    let used: Vec<&str> = of("[dependencies]").chain(of("[dev-dependencies]")).collect();
    for name in wanted.iter().filter(|name| !used.contains(name)) {
        breaches.push(format!("Cargo.toml: no crate uses `{name}`"));
    }
    let rows = table_rows(architecture, "\n## Dependencies");
    let reasons: Vec<&str> = rows.iter().flat_map(|row| code_words(row[0])).collect();
    for name in &wanted {
        if !reasons.contains(name) {
            breaches
                .push(format!("Cargo.toml: `{name}` has no line in the dependency table of ARCHITECTURE.md"));
        }
    }
    for name in &reasons {
        if !wanted.contains(name) {
            breaches.push(format!("ARCHITECTURE.md: `{name}` is not a dependency any more"));
        }
    }
    if wanted.is_empty() {
        breaches.push("Cargo.toml: found no dependencies at all".to_string());
    }
    for row in &rows {
        if row.len() < 2 || row[1].split_whitespace().count() < 4 {
            breaches.push(format!("ARCHITECTURE.md: {} says no reason", row[0]));
        }
    }
    breaches
}

/// The last cell of a module row says what `uses` says: the names in backticks, `-` for none, or
/// `all above`, with the exceptions behind "but".
fn written_uses(uses: &Uses) -> String {
    let quoted = |names: &[&str]| names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    match uses {
        Uses::Only([]) => "-".to_string(),
        Uses::Only(names) => quoted(names),
        Uses::AllAbove { but: [], .. } => "all above".to_string(),
        Uses::AllAbove { but, also: [] } => format!("all above but {}", quoted(but)),
        Uses::AllAbove { but, also } => format!("all above but {}, with {}", quoted(but), quoted(also)),
    }
}

/// Rows of the module table in ARCHITECTURE.md that differ from the checked table.
pub fn written_table_breaches(table: &[Row], architecture: &str) -> Vec<String> {
    let rows = table_rows(architecture, "\n## Modules");
    let written: Vec<(&str, &str)> = rows
        .iter()
        .map(|row| (code_words(row[0]).first().copied().unwrap_or(""), *row.last().unwrap_or(&"")))
        .collect();
    let checked: Vec<(&str, String)> =
        table.iter().map(|row| (row.module, written_uses(&row.uses))).collect();
    let mut breaches = Vec::new();
    for (index, (module, uses)) in checked.iter().enumerate() {
        match written.get(index) {
            Some((name, said)) if name == module && said == uses => {}
            other => {
                breaches.push(format!("ARCHITECTURE.md, modules: want `{module}` | {uses}, found {other:?}"))
            }
        }
    }
    if written.len() != checked.len() {
        breaches.push(format!(
            "ARCHITECTURE.md, modules: {} rows, the table has {}",
            written.len(),
            checked.len()
        ));
    }
    breaches
}
