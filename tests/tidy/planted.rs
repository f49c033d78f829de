//! Planted breaches: the scanner and every rule have to find them, and leave their harmless twins alone.
//!
//! In: small made-up sources. Out: proof that a green tidy test means something.

use crate::imports;
use crate::rules::{self, Row, Uses};
use crate::scan;
use crate::tree::File;

const MINIATURE: &[Row] = &[
    Row { module: "low", uses: Uses::Only(&[]), pure: true },
    Row { module: "side", uses: Uses::Only(&[]), pure: true },
    Row { module: "high", uses: Uses::Only(&["low", "side::open"]), pure: true },
    Row { module: "shell", uses: Uses::AllAbove { but: &["side"], also: &["side::open"] }, pure: false },
];

fn layering(path: &str, text: &str) -> Vec<String> {
    rules::layering_breaches(MINIATURE, &[File::planted(path, text)])
}

fn purity(text: &str) -> Vec<String> {
    rules::purity_breaches(MINIATURE, &[File::planted("src/low/clock.rs", text)])
}

#[track_caller]
fn flagged(breaches: Vec<String>, wanted: &[&str]) {
    assert_eq!(breaches.len(), wanted.len(), "{breaches:?}");
    for (breach, part) in breaches.iter().zip(wanted) {
        assert!(breach.contains(part), "{breach:?} does not say {part:?}");
    }
}

#[test]
fn comments_and_literals_are_blanked_and_lines_kept() {
    let text =
        "a /* x /* y */ z\n */ b // c\n\"q \\\" \n r\" d r##\"\"# \"## e 'f' '\\'' 'g: &'h i b\"j\" r#type";
    let code = scan::blank_comments_and_literals(text);
    assert_eq!(code.lines().count(), text.lines().count());
    let words: Vec<&str> = code.split_whitespace().collect();
    assert_eq!(words, ["a", "b", "d", "e", "'g:", "&'h", "i", "r#type"]);
}

#[test]
fn paths_are_unfolded_through_nested_groups() {
    let code = "use crate::{a::{b, c as d}, e,\n  f::*};\nlet x = std::mem::take::<g::H>(y);";
    let found: Vec<(usize, String)> =
        scan::paths(code).into_iter().map(|path| (path.line, path.text())).collect();
    let wanted = [
        (1, "crate::a::b"),
        (1, "crate::a::c"),
        (1, "crate::e"),
        (2, "crate::f::*"),
        (3, "std::mem::take"),
        (3, "g::H"),
    ];
    assert_eq!(found, wanted.map(|(line, text)| (line, text.to_string())));
}

#[test]
fn a_use_from_above_is_flagged_however_it_is_written() {
    flagged(
        layering("src/low/x.rs", "use crate::high::thing;"),
        &["src/low/x.rs:1: `low` may not use `high::thing`"],
    );
    flagged(layering("src/low.rs", "fn f() -> crate::shell::X { todo }"), &["`shell::X`"]);
    flagged(layering("src/low.rs", "use crate::{\n    low::a,\n    high::{b, c},\n};"), &[":3: ", ":3: "]);
    flagged(layering("src/high/x.rs", "use crate::side::closed::Y;"), &["`high` may not use `side::closed`"]);
    flagged(layering("src/high/x.rs", "use crate::side;"), &["`high` may not use `side`"]);
    flagged(layering("src/shell/x.rs", "use crate::side::closed;"), &["`shell` may not use `side::closed`"]);
    flagged(layering("src/low/x.rs", "#[cfg(test)]\nmod tests { use crate::high::t; }"), &[":2: "]);
}

#[test]
fn ways_around_the_scan_are_flagged() {
    flagged(layering("src/low/x.rs", "use crate::*;"), &["whole crate"]);
    flagged(layering("src/low/x.rs", "use celld::low;"), &["inside the library"]);
    flagged(layering("src/low/mod.rs", "use super::high;"), &["leaves the module unseen"]);
    flagged(layering("src/low/deep/x.rs", "use super::super::high;"), &["`super::super`"]);
}

#[test]
fn allowed_uses_are_left_alone() {
    for (path, text) in [
        ("src/high/x.rs", "use crate::{low::a, high::b, side::open::c};"),
        ("src/shell.rs", "use crate::{high::x, side::open};\nmod inner { use super::*; }"),
        ("src/low/x.rs", "// use crate::high;\nconst S: &str = \"crate::high\";\nuse super::y;"),
        ("src/main.rs", "fn main() { celld::shell::main() }"),
    ] {
        flagged(layering(path, text), &[]);
    }
}

#[test]
fn impure_names_are_flagged_in_pure_modules_only() {
    flagged(purity("let t = Instant::now();"), &["Instant::now"]);
    flagged(
        purity("use std::{\n  fs::File,\n  io,\n  net::{TcpStream, UdpSocket},\n};"),
        &[":2:", ":4:", ":4:"],
    );
    flagged(purity("use std::time::{Duration, Instant};"), &["std::time::Instant"]);
    flagged(
        purity("fn f() { println!(\"{}\", rand::random::<u8>()); dbg!(1); }"),
        &["rand::random", "println!", "dbg!"],
    );
    flagged(
        purity("use tokio::sync::mpsc; use std::thread; use std::env::var;"),
        &["tokio", "thread", "env"],
    );
    let shell = File::planted("src/shell/x.rs", "use tokio::net::TcpStream;");
    flagged(rules::purity_breaches(MINIATURE, &[shell]), &[]);
}

#[test]
fn test_items_are_exempt_from_purity_and_nothing_behind_them() {
    flagged(purity("#[cfg(test)]\nmod tests { fn a() { println!(); } }\nfn b() {}"), &[]);
    flagged(purity("#[cfg(test)]\nuse std::fs;\nuse std::net;"), &["std::net"]);
    flagged(purity("#[cfg(test)]\nmod tests { fn a() {} }\nfn b() { println!(); }"), &["println!"]);
    flagged(purity("fn log() { tracing::info!(\"x\"); write!(f, \"println!()\"); }"), &[]);
    let parent = File::planted("src/low/mod.rs", "#[cfg(test)]\nmod fixtures;\nmod real;");
    let fixture = File::planted("src/low/fixtures.rs", "use std::fs;");
    let real = File::planted("src/low/real.rs", "use std::fs;");
    flagged(rules::purity_breaches(MINIATURE, &[parent, fixture, real]), &["src/low/real.rs"]);
}

#[test]
fn native_libraries_are_flagged_outside_their_files() {
    let inside = File::planted("crates/cell-vision/src/cv.rs", "use opencv::core;");
    let outside =
        File::planted("crates/cell-vision/src/observe.rs", "use opencv::core;\nuse apriltag::Detector;");
    flagged(rules::native_breaches(&[inside, outside]), &["`opencv`", "`apriltag`"]);
}

#[test]
fn a_table_with_a_cycle_or_a_stranger_is_flagged() {
    let cyclic = [
        Row { module: "a", uses: Uses::Only(&["b"]), pure: true },
        Row { module: "b", uses: Uses::Only(&["a"]), pure: true },
    ];
    flagged(rules::table_faults(&cyclic), &["a: `b`"]);
    let impure = [
        Row { module: "a", uses: Uses::Only(&[]), pure: false },
        Row { module: "b", uses: Uses::Only(&["a"]), pure: true },
    ];
    flagged(rules::table_faults(&impure), &["b: pure"]);
    let files = [File::planted("src/low.rs", ""), File::planted("src/stranger/x.rs", "")];
    let missing = rules::modules_missing_from(&MINIATURE[..1], &files);
    flagged(missing, &["`stranger` is not in the table"]);
    flagged(rules::modules_missing_from(&MINIATURE[..1], &files[1..]), &["`stranger`", "`low` has no file"]);
}

#[test]
fn the_root_re_exports_nothing_and_lists_the_table() {
    let low = File::planted("src/low.rs", "");
    let good = File::planted("src/lib.rs", "//! Doc.\npub mod low;\n");
    flagged(rules::modules_missing_from(&MINIATURE[..1], &[low.clone(), good]), &[]);
    let bad = File::planted("src/lib.rs", "mod low;\nmod other;\npub use low::Thing;\n");
    flagged(rules::modules_missing_from(&MINIATURE[..1], &[low, bad]), &["declares", "re-export"]);
}

#[test]
fn openings_lengths_marks_and_paths_are_flagged() {
    assert!(rules::opening_breach(&File::planted("a.rs", "use std::fs;")).is_some());
    assert!(rules::opening_breach(&File::planted("a.rs", "//! Says what it does.")).is_none());
    assert!(rules::length_breach(&File::planted("a.rs", "x\nx\nx\n"), 2).is_some());
    assert!(rules::length_breach(&File::planted("a.rs", "x\nx\n"), 2).is_none());
    for halves in [["// TO", "DO: later"], ["todo", "!()"], ["#[ig", "nore]"], ["@", "@FIGURES@@"]] {
        flagged(rules::unfinished_marks(&File::planted("a.rs", &halves.concat())), &["a.rs:1"]);
    }
    flagged(rules::unfinished_marks(&File::planted("a.rs", "// a mastodon, to do good")), &[]);
    flagged(rules::unfinished_marks(&File::planted("a.rs", &["PROGRAM_XX", "X_STARTED"].concat())), &[]);
    flagged(rules::machine_paths(&File::planted("src/a.rs", "x\n\"../shared/data\"")), &["src/a.rs:2"]);
    flagged(rules::machine_paths(&File::planted("tests/it/a.rs", "\"../shared/data\"")), &[]);
}

#[test]
fn wide_comments_are_flagged_and_wide_code_is_not() {
    let wide = |path: &str, text: &str| rules::wide_comments(&File::planted(path, text), 12);
    flagged(wide("a.rs", "/// short\n/// rather wide\nlet a = 1; // wide"), &["a.rs:2", "a.rs:3"]);
    flagged(wide("a.rs", "let a = \"// a literal\";\nlet b = call_it_now();"), &[]);
    flagged(wide("a.yaml", "# rather wide\nkey: value # here\nkey: [1, 2, 3, 4]"), &["a.yaml:1", "a.yaml:2"]);
    flagged(wide("a.py", "\"\"\"One.\nrather wide too\n\"\"\"\nlong_name(of_it)"), &["a.py:2"]);
    flagged(wide("a.md", "# A heading that is wide"), &[]);
}

#[test]
fn results_without_a_word_on_their_errors_are_flagged() {
    let found = |text: &str| rules::unnamed_errors(&File::planted("src/a.rs", text));
    flagged(found("/// Reads.\npub fn read(\n    text: &str,\n) -> Result<u8, E> {\n}"), &["src/a.rs:2"]);
    flagged(found("/// # Errors\n/// None.\n#[inline]\npub async fn read() -> Result<u8, E> {}"), &[]);
    flagged(found("pub fn read() -> u8 {}\nfn inner() -> Result<u8, E> {}"), &[]);
}

#[test]
fn things_that_act_like_persons_are_flagged() {
    let found = |path: &str, text: &str| rules::persons_words(&File::planted(path, text));
    flagged(
        found("a.rs", "let told = \"asks\"; // the client asks\n/// It Tells.\nask();"),
        &["a.rs:1", "a.rs:2"],
    );
    flagged(found("a.rs", "// a `told` task, and a mask"), &[]);
    flagged(found("a.md", "It was told.\n\n    celld ask\n\nThe `ask` of it."), &["a.md:1"]);
    flagged(found("a.yaml", "# it asks"), &[]);
}

#[test]
fn a_dependency_without_a_reason_is_flagged_and_so_is_a_reason_without_a_dependency() {
    let root = "[workspace.dependencies]\nown = { path = \"crates/own\" }\none = \"1\"\n\
                two = { version = \"2\" }\n\
                [lints.rust]\na = \"b\"\n[dependencies]\none.workspace = true\n[dev-dependencies]\n\
                two.workspace = true\n";
    let manifests = [File::planted("Cargo.toml", root), File::planted("crates/own/Cargo.toml", "")];
    let both =
        "\n## Dependencies\n\n| crate | why |\n|---|---|\n| `one`, `two` | because it saves us work |\n";
    flagged(rules::dependency_breaches(&manifests, both), &[]);
    let one = both.replace("`two`", "`three`");
    flagged(rules::dependency_breaches(&manifests, &one), &["`two` has no line", "`three` is not"]);
    let silent = both.replace("because it saves us work", "yes");
    flagged(rules::dependency_breaches(&manifests, &silent), &["says no reason"]);
}

#[test]
fn a_library_that_no_crate_uses_is_flagged() {
    let root = File::planted("Cargo.toml", "[workspace.dependencies]\none = \"1\"\n[dependencies]\n");
    let written = "\n## Dependencies\n\n| crate | why |\n|---|---|\n| `one` | because it saves us work |\n";
    flagged(rules::dependency_breaches(&[root], written), &["no crate uses `one`"]);
}

const CRATES: &[Row] = &[
    Row { module: "low-er", uses: Uses::Only(&[]), pure: true },
    Row { module: "rearrange", uses: Uses::Only(&["low-er"]), pure: true },
    Row { module: "inside", uses: Uses::Only(&["rearrange::open"]), pure: true },
];

#[test]
fn crates_are_named_by_themselves_and_modules_behind_crate() {
    let found = |path: &str, text: &str| rules::layering_breaches(CRATES, &[File::planted(path, text)]);
    flagged(
        found("crates/low-er/src/a.rs", "use rearrange::open;"),
        &["`low-er` may not use `rearrange::open`"],
    );
    flagged(found("src/inside/a.rs", "use low_er::a;"), &["`inside` may not use `low-er::a`"]);
    flagged(found("src/inside/a.rs", "use rearrange::shut::X;"), &["`inside` may not use `rearrange::shut`"]);
    flagged(found("src/inside/a.rs", "use rearrange::open::X;\nuse inside_out::y;"), &[]);
    flagged(found("crates/rearrange/src/a.rs", "use crate::inside::y;\nuse low_er::a;"), &[]);
}

#[test]
fn a_manifest_that_needs_more_than_its_row_is_flagged() {
    let manifest = |uses: &str| {
        let text = format!(
            "[dependencies]\n{uses}serde.workspace = true\n[dev-dependencies]\nother.workspace = true\n"
        );
        rules::manifest_breaches(CRATES, &[File::planted("crates/rearrange/Cargo.toml", &text)])
    };
    flagged(manifest("low-er.workspace = true\n"), &[]);
    flagged(manifest(""), &["depends on []"]);
    flagged(manifest("inside.workspace = true\nlow-er.workspace = true\n"), &["\"inside\", \"low-er\""]);
}

#[test]
fn a_manifest_that_needs_what_its_row_excepts_is_flagged() {
    const TABLE: &[Row] = &[
        Row { module: "low-er", uses: Uses::Only(&[]), pure: true },
        Row { module: "si-de", uses: Uses::Only(&[]), pure: true },
        Row { module: "rearrange", uses: Uses::AllAbove { but: &["si-de"], also: &[] }, pure: true },
        Row { module: "high-er", uses: Uses::Only(&[]), pure: true },
    ];
    let manifest = |uses: &str| {
        let text = format!("[dependencies]\n{uses}serde.workspace = true\n");
        rules::manifest_breaches(TABLE, &[File::planted("crates/rearrange/Cargo.toml", &text)])
    };
    flagged(manifest(""), &[]);
    flagged(manifest("low-er.workspace = true\n"), &[]);
    flagged(manifest("si-de.workspace = true\n"), &["\"si-de\""]);
    flagged(manifest("high-er.workspace = true\n"), &["\"high-er\""]);
}

#[test]
fn a_written_table_that_drifts_is_flagged() {
    let good = "\n## Modules\n\n| module | job | may use |\n|---|---|---|\n| `low` | a | - |\n\
                | `side` | b | - |\n\
                | `high` | c | `low`, `side::open` |\n\
                | `shell` | d | all above but `side`, with `side::open` |\n\n## Next\n| `x` | y | z |\n";
    flagged(rules::written_table_breaches(MINIATURE, good), &[]);
    let drifted = good.replace("`low`, `side::open` |", "`low` |");
    flagged(rules::written_table_breaches(MINIATURE, &drifted), &["`high`"]);
}

fn circles(files: &[(&str, &str)]) -> Vec<String> {
    let files: Vec<File> = files.iter().map(|(path, text)| File::planted(path, text)).collect();
    imports::circles(&files)
}

#[test]
fn a_circle_of_imports_is_flagged_with_what_ties_it() {
    let found = circles(&[
        ("src/a.rs", "pub mod x;\npub mod y;\npub mod z;"),
        ("src/a/x.rs", "\nuse crate::{a::{y::{Y, Y2}, z}, b::B};\nfn f(_: z::Z) {}"),
        ("src/a/y.rs", "fn f() -> super::z::Z { super::z::Z }"),
        ("src/a/z.rs", "use crate::a::x::X;"),
        ("src/b.rs", "pub struct B;"),
    ]);
    flagged(found.clone(), &["circle of 3 files"]);
    let ties = [
        "src/a/x.rs:2: `crate::a::y::Y` of src/a/y.rs",
        "src/a/x.rs:2: `crate::a::z` of src/a/z.rs",
        "src/a/y.rs:1: `super::z::Z` of src/a/z.rs",
        "src/a/z.rs:1: `crate::a::x::X` of src/a/x.rs",
    ];
    assert_eq!(found[0].lines().skip(1).map(str::trim).collect::<Vec<_>>(), ties);
}

#[test]
fn a_parent_and_a_child_that_import_from_each_other_are_a_circle() {
    let child = ("src/a/x.rs", "use super::Fault;");
    for parent in [
        "mod x;\nfn f() { x::g() }",
        "mod x;\npub use x::X;",
        "mod x;\nuse self::x::X;",
        "mod x;\nmod inner { use super::x::X; }",
        "mod x;\nuse crate::a::x as other;",
    ] {
        flagged(circles(&[("src/a.rs", parent), child]), &["circle of 2 files"]);
        flagged(circles(&[("src/a/mod.rs", parent), child]), &["circle of 2 files"]);
    }
    // By way of a module that was imported: `deep` is of `x`, and not of the file that names it.
    let by_name = [
        ("src/a.rs", "use crate::b;\nfn f() { b::deep::g() }"),
        ("src/b.rs", "pub mod deep;"),
        ("src/b/deep.rs", "use crate::a::A;"),
    ];
    flagged(circles(&by_name), &["circle of 2 files"]);
}

#[test]
fn what_is_no_circle_of_imports_is_left_alone() {
    for files in [
        // Declared and not named.
        [("src/a.rs", "mod x;"), ("src/a/x.rs", "use crate::a::Fault;")],
        // Down only, however often.
        [("src/a.rs", "mod x;\nuse x::X;\nfn f() { x::g() }"), ("src/a/x.rs", "use crate::b;")],
        // In tests, and in files of theirs.
        [("src/a.rs", "mod x;\nuse x::X;"), ("src/a/x.rs", "#[cfg(test)]\nmod t { use crate::a::A; }")],
        [("src/a.rs", "#[cfg(test)]\nmod x;\n#[cfg(test)]\nuse x::X;"), ("src/a/x.rs", "use super::*;")],
        // Words, and who may see.
        [("src/a.rs", "mod x;\nuse x::X;"), ("src/a/x.rs", "// crate::a::A\nconst S: &str = \"crate::a\";")],
        [("src/a.rs", "mod x;\nuse x::X;"), ("src/a/x.rs", "pub(in crate::a) fn f() {}")],
        // Within one file.
        [("src/a.rs", "mod inner { use super::A; }\nfn f() { crate::a::g(); self::g() }"), ("src/b.rs", "")],
        [("src/a.rs", "mod x;\nuse x::X;"), ("src/a/x.rs", "mod inner { use super::X; }")],
    ] {
        flagged(circles(&files), &[]);
    }
}

fn long_files(files: &[(&str, &str)]) -> Vec<String> {
    let files: Vec<File> = files.iter().map(|(path, text)| File::planted(path, text)).collect();
    rules::long_files(&files, 2)
}

#[test]
fn long_files_are_flagged_by_their_lines_before_the_test_module() {
    let module = "#[cfg(test)]\npub(crate) mod tests {\nx\nx\n}\n";
    flagged(long_files(&[("src/a.rs", "x\nx\nx\n")]), &["src/a.rs: 3 lines without its tests"]);
    flagged(long_files(&[("src/a.rs", &format!("x\nx\nx\n{module}"))]), &["src/a.rs: 3 lines"]);
    flagged(long_files(&[("src/a.rs", &format!("x\nx\n{module}"))]), &[]);
    flagged(long_files(&[("src/a.rs", "x\nx\n#[cfg(test)]\nmod tests;\n")]), &[]);
    // Neither another test-only item nor a comment begins the tests.
    flagged(long_files(&[("src/a.rs", &format!("#[cfg(test)]\nuse b::{{c}};\nx\n{module}"))]), &["3 lines"]);
    flagged(long_files(&[("benches/a.rs", "// #[cfg(test)]\n// mod tests;\nx\n")]), &["benches/a.rs: 3"]);
}

#[test]
fn long_files_of_tests_are_left_alone() {
    let declared = ("src/a.rs", "mod real;\n#[cfg(test)]\nmod tests;\n");
    let long = "x\nx\nx\n";
    flagged(long_files(&[declared, ("src/a/tests.rs", long), ("src/a/tests/deep.rs", long)]), &[]);
    flagged(long_files(&[declared, ("src/a/real.rs", long)]), &["src/a/real.rs"]);
    flagged(long_files(&[("tests/it/main.rs", long)]), &[]);
}

#[test]
fn long_functions_are_flagged_wherever_they_stand() {
    let long = |text: &str| rules::long_functions(&File::planted("a.rs", text), 3);
    let body = "{\n    g();\n    g();\n}";
    flagged(long(&format!("fn f() {body}")), &["a.rs:1: `f` has 4 lines"]);
    flagged(
        long(&format!("impl A {{\n    /// Doc.\n    #[inline]\n    pub fn f(a: [u8; 2]) -> u8 {body}\n}}")),
        &["a.rs:4: `f` has 4 lines"],
    );
    flagged(long(&format!("fn f() {{\n    fn g() {body}\n}}")), &["`f` has 6 lines", "`g` has 4 lines"]);
    flagged(
        long(&format!("#[cfg(test)]\nmod t {{ async fn f<T>()\nwhere T: Fn(u8) {body} }}")),
        &["`f` has 5"],
    );
    for short in [
        "/// Doc.\n\n#[inline]\n#[must_use]\nfn f() {\n    g();\n}",
        "trait T {\n    fn f(\n        a: u8,\n        b: u8,\n    );\n}",
        "type F = fn(\n    u8,\n    u8,\n) -> u8;",
        "const S: &str = \"fn f() {\n\n\n\n}\";",
    ] {
        flagged(long(short), &[]);
    }
}
