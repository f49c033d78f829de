//! Which source file imports from which, and where that goes round in a circle.
//!
//! In: the files below `src`. Out: one breach for each group of files that reach each other, with the paths
//! that tie them. A file imports from another when it names a path into it: from `crate`, `self` or `super`,
//! from a module it declares, or from one it has imported; the deepest module with a file of its own counts.
//! `mod child;` alone is no import, naming something of the child is. Test-only items are exempt: tests look
//! at what they please.

use crate::rules;
use crate::scan::{self, CodePath};
use crate::tree::File;
use std::collections::HashMap;

/// Segments of a module's path below `crate`.
type Module = Vec<String>;

/// The modules that have a file, and the numbers of these.
type Known = HashMap<Module, usize>;

/// The first path by which one file imports from another.
struct Import {
    from: usize,
    to: usize,
    line: usize,
    text: String,
}

/// Groups of files that import from each other, directly or by way of others.
pub fn circles(files: &[File]) -> Vec<String> {
    let test_files = rules::test_only_files(files);
    let counts = |file: &&File| !test_files.iter().any(|stem| rules::belongs_to(&file.path, stem));
    let files: Vec<&File> = files.iter().filter(counts).collect();
    let numbered = files.iter().enumerate();
    let known: Known = numbered.filter_map(|(at, file)| Some((module_of(&file.path)?, at))).collect();
    let imports: Vec<Import> = (0..files.len()).flat_map(|at| imports_of(&files, at, &known)).collect();
    let mut next = vec![Vec::new(); files.len()];
    imports.iter().for_each(|import| next[import.from].push(import.to));
    let reached: Vec<Vec<bool>> = (0..files.len()).map(|from| reached_from(from, &next)).collect();
    let mut breaches = Vec::new();
    for (first, from_first) in reached.iter().enumerate() {
        let tied = |other: &usize| from_first[*other] && reached[*other][first];
        let group: Vec<usize> = (0..files.len()).filter(tied).collect();
        if group.len() > 1 && group[0] == first {
            breaches.push(breach(&files, &group, &imports));
        }
    }
    breaches
}

fn breach(files: &[&File], group: &[usize], imports: &[Import]) -> String {
    let inside = imports.iter().filter(|import| group.contains(&import.from) && group.contains(&import.to));
    let ties = inside.map(|import| {
        let (from, to) = (&files[import.from].path, &files[import.to].path);
        format!("\n    {from}:{}: `{}` of {to}", import.line, import.text)
    });
    let ties: String = ties.collect();
    format!("import circle of {} files; move what they share below them:{ties}", group.len())
}

/// Everything that can be reached from a file, itself only where a circle leads back.
fn reached_from(from: usize, next: &[Vec<usize>]) -> Vec<bool> {
    let mut reached = vec![false; next.len()];
    let mut open = vec![from];
    while let Some(at) = open.pop() {
        for &to in &next[at] {
            if !std::mem::replace(&mut reached[to], true) {
                open.push(to);
            }
        }
    }
    reached
}

/// The module that a file below `src` is; `None` for the roots of binaries.
fn module_of(path: &str) -> Option<Module> {
    let inside = path.strip_prefix("src/")?.strip_suffix(".rs")?;
    if inside == "main" || inside.starts_with("bin/") {
        return None;
    }
    let inside = inside.strip_suffix("/mod").unwrap_or(inside);
    Some(if inside == "lib" { Vec::new() } else { inside.split('/').map(str::to_string).collect() })
}

/// What one file imports from others, one import for each of them.
fn imports_of(files: &[&File], from: usize, known: &Known) -> Vec<Import> {
    let Some(module) = module_of(&files[from].path) else { return Vec::new() };
    let code = scan::blank_comments_and_literals(&files[from].text);
    let code = scan::blank_ranges(&code, &scan::test_only_ranges(&code));
    let inline_modules = scan::inline_module_ranges(&code);
    let mut paths = Vec::new();
    for path in scan::paths(&code).into_iter().filter(|path| !says_who_sees(&code, path)) {
        let depth = inline_modules.iter().filter(|range| scan::within(&[**range], path.offset)).count();
        paths.push((absolute(&module, depth, &path), path));
    }
    let names = names_of_modules(&module, &scan::file_modules(&code), &paths, known);
    let mut found: Vec<Import> = Vec::new();
    for (target, path) in paths {
        let named = || Some([names.get(&path.segments[0])?.as_slice(), &path.segments[1..]].concat());
        let Some(target) = target.or_else(named) else { continue };
        let deepest = (0..=target.len()).rev().find_map(|end| known.get(&target[..end]).copied());
        let Some(to) = deepest.filter(|&to| to != from) else { continue };
        if !found.iter().any(|import| import.to == to) {
            found.push(Import { from, to, line: path.line, text: path.text() });
        }
    }
    found
}

/// The modules that a file may name by one word: those it declares, and those it has imported.
fn names_of_modules(
    module: &[String],
    declared: &[String],
    paths: &[(Option<Module>, CodePath)],
    known: &Known,
) -> HashMap<String, Module> {
    let below = declared.iter().map(|child| [module, std::slice::from_ref(child)].concat());
    let imported = paths.iter().filter_map(|(target, _)| target.clone()).filter(|to| known.contains_key(to));
    below.chain(imported).filter_map(|target| Some((target.last()?.clone(), target))).collect()
}

/// True for the path in `pub(in path)`, which imports nothing.
fn says_who_sees(code: &str, path: &CodePath) -> bool {
    code[..path.offset].trim_end().ends_with("pub(in")
}

/// A path that begins at `crate`, `self` or `super`, from `crate` on; `depth` inline modules enclose it.
fn absolute(module: &[String], depth: usize, path: &CodePath) -> Option<Module> {
    let supers = path.segments.iter().take_while(|segment| *segment == "super").count();
    let mut base = match path.segments[0].as_str() {
        "crate" => Vec::new(),
        "self" | "super" => module.to_vec(),
        _ => return None,
    };
    // The first steps up lead out of the inline modules.
    base.truncate(base.len().saturating_sub(supers.saturating_sub(depth)));
    let rest = path.segments.iter().skip(supers.max(1));
    // `a::{self}` is `a`.
    base.extend(rest.filter(|segment| *segment != "self").cloned());
    Some(base)
}
