//! Holds the architecture: the module table of ARCHITECTURE.md against the sources, and the house rules.
//!
//! In: the repository as it is. Out: every breach with file and line, all at once. The compiler does not
//! enforce layers inside one crate, so this test reads the sources instead. The table below is the one
//! place that says which module may use which; if a row hurts, change the row knowingly, not the code.

#[path = "tidy/imports.rs"]
mod imports;
#[path = "tidy/planted.rs"]
mod planted;
#[path = "tidy/rules.rs"]
mod rules;
#[path = "tidy/scan.rs"]
mod scan;
#[path = "tidy/tree.rs"]
mod tree;

use rules::{Row, Uses};

/// The module table in reading order: the crates, then the modules of celld. An entry `a::b` allows that
/// submodule only.
const TABLE: &[Row] = &[
    Row { module: "cell-values", uses: Uses::Only(&[]), pure: true },
    Row { module: "cell-edge", uses: Uses::Only(&["cell-values"]), pure: false },
    Row { module: "cell-fleet", uses: Uses::Only(&["cell-values"]), pure: false },
    Row { module: "ur-wire", uses: Uses::Only(&[]), pure: true },
    Row { module: "urscript", uses: Uses::Only(&[]), pure: true },
    Row { module: "ur-arm", uses: Uses::Only(&["cell-values"]), pure: true },
    Row { module: "rearrange", uses: Uses::Only(&[]), pure: true },
    Row {
        module: "cell-vision",
        uses: Uses::Only(&["cell-values", "rearrange::geometry", "rearrange::tabletop"]),
        pure: true,
    },
    Row { module: "vision-pictures", uses: Uses::Only(&["cell-values", "cell-vision"]), pure: true },
    Row {
        module: "cell-parts",
        uses: Uses::Only(&[
            "cell-edge::files",
            "cell-values",
            "rearrange::document",
            "rearrange::geometry",
            "rearrange::tabletop",
        ]),
        pure: false,
    },
    Row {
        module: "ur-sim",
        uses: Uses::Only(&[
            "cell-edge",
            "cell-parts",
            "cell-values",
            "rearrange::document",
            "rearrange::geometry",
            "rearrange::tabletop",
            "ur-arm",
            "ur-wire",
            "urscript",
        ]),
        pure: false,
    },
    Row { module: "cell-motion", uses: Uses::Only(&["cell-values", "rearrange", "ur-arm"]), pure: true },
    Row {
        module: "cell-calibration",
        uses: Uses::Only(&[
            "cell-motion",
            "cell-values",
            "cell-vision",
            "rearrange::document",
            "rearrange::geometry",
            "ur-arm",
        ]),
        pure: true,
    },
    Row {
        module: "cell-machine",
        uses: Uses::AllAbove {
            but: &["cell-edge", "cell-fleet", "urscript", "cell-parts", "ur-sim"],
            also: &[],
        },
        pure: true,
    },
    Row { module: "cell-replay", uses: Uses::Only(&["cell-machine", "cell-values"]), pure: true },
    Row {
        module: "perception",
        uses: Uses::Only(&[
            "cell-values",
            "rearrange::document",
            "rearrange::geometry",
            "rearrange::tabletop",
            "cell-vision",
        ]),
        pure: true,
    },
    Row {
        module: "report",
        uses: Uses::Only(&["cell-values", "ur-arm", "rearrange", "cell-vision", "cell-motion"]),
        pure: true,
    },
    Row {
        module: "io",
        uses: Uses::Only(&["cell-values", "cell-edge", "cell-vision::camera", "rearrange::document"]),
        pure: false,
    },
    Row {
        module: "jobs",
        uses: Uses::Only(&[
            "cell-values",
            "cell-edge::file_lock",
            "cell-edge::files",
            "cell-edge::mailbox",
            "rearrange",
            "cell-machine::code",
            "cell-machine::intake",
            "cell-machine::orders",
        ]),
        pure: false,
    },
    Row {
        module: "config",
        uses: Uses::AllAbove { but: &["ur-wire", "urscript", "ur-sim"], also: &[] },
        pure: false,
    },
    Row { module: "daemon", uses: Uses::AllAbove { but: &["ur-sim"], also: &[] }, pure: false },
    Row { module: "page", uses: Uses::AllAbove { but: &["ur-sim"], also: &[] }, pure: false },
    Row { module: "fleet", uses: Uses::AllAbove { but: &["ur-sim"], also: &[] }, pure: false },
    Row { module: "doctor", uses: Uses::AllAbove { but: &["ur-sim", "page"], also: &[] }, pure: false },
    Row {
        module: "demo",
        uses: Uses::AllAbove { but: &["daemon", "page", "doctor"], also: &[] },
        pure: false,
    },
    Row {
        module: "pair",
        uses: Uses::AllAbove { but: &["daemon", "page", "doctor"], also: &[] },
        pure: false,
    },
    Row { module: "bench", uses: Uses::AllAbove { but: &[], also: &[] }, pure: false },
    Row { module: "cli", uses: Uses::AllAbove { but: &[], also: &[] }, pure: false },
];

/// Source lines a file may have before it has to be split.
const MOST_LINES: usize = 600;

/// The same without its test module; files of tests are exempt.
const MOST_LINES_WITHOUT_TESTS: usize = 500;

/// Columns of a line with a comment: with its line end it has those of a line of code.
const MOST_COLUMNS: usize = 109;

/// Lines a function may have, from its `fn` to its closing brace.
const MOST_FUNCTION_LINES: usize = 60;

#[track_caller]
fn none(breaches: Vec<String>) {
    assert!(breaches.is_empty(), "{} breach(es):\n{}", breaches.len(), breaches.join("\n"));
}

#[test]
fn the_table_is_in_reading_order_and_keeps_the_fixed_borders() {
    none(rules::table_faults(TABLE));
    let borders =
        [("ur-sim", "cell-machine"), ("daemon", "ur-sim"), ("cell-machine", "cell-edge"), ("io", "daemon")];
    for (module, never) in borders {
        assert!(!rules::allows(TABLE, module, never), "{module} may never use {never}");
    }
}

#[test]
fn every_module_is_in_the_table() {
    none(rules::modules_missing_from(TABLE, &tree::sources()));
}

#[test]
fn modules_only_look_down() {
    none(rules::layering_breaches(TABLE, &tree::sources()));
}

#[test]
fn crates_depend_on_what_the_table_says() {
    none(rules::manifest_breaches(TABLE, &tree::manifests()));
}

#[test]
fn pure_modules_are_pure() {
    none(rules::purity_breaches(TABLE, &tree::sources()));
}

#[test]
fn native_libraries_stay_in_their_files() {
    none(rules::native_breaches(&tree::sources()));
}

#[test]
fn files_open_with_a_doc_and_stay_short() {
    let mut breaches = Vec::new();
    for file in tree::rust_files() {
        breaches.extend(rules::opening_breach(&file));
    }
    for file in tree::sources() {
        breaches.extend(rules::length_breach(&file, MOST_LINES));
    }
    none(breaches);
}

#[test]
fn files_stay_short_without_their_tests() {
    none(rules::long_files(&tree::rust_files(), MOST_LINES_WITHOUT_TESTS));
}

#[test]
fn functions_stay_short() {
    none(
        tree::rust_files().iter().flat_map(|file| rules::long_functions(file, MOST_FUNCTION_LINES)).collect(),
    );
}

#[test]
fn comments_stay_within_their_columns() {
    none(tree::text_files().iter().flat_map(|file| rules::wide_comments(file, MOST_COLUMNS)).collect());
}

#[test]
fn things_do_not_act_like_persons() {
    none(tree::text_files().iter().flat_map(rules::persons_words).collect());
}

#[test]
fn public_functions_name_their_errors() {
    none(tree::rust_files().iter().flat_map(rules::unnamed_errors).collect());
}

#[test]
fn files_import_in_no_circle() {
    let sources = tree::sources();
    none(tree::by_crate(&sources).iter().flat_map(|files| imports::circles(files)).collect());
}

#[test]
fn nothing_is_left_unfinished() {
    none(tree::text_files().iter().flat_map(rules::unfinished_marks).collect());
}

#[test]
fn no_path_of_one_machine_is_named() {
    none(tree::text_files().iter().flat_map(rules::machine_paths).collect());
}

#[test]
fn every_dependency_has_its_reason() {
    none(rules::dependency_breaches(&tree::manifests(), &tree::read("ARCHITECTURE.md")));
}

#[test]
fn the_written_table_is_the_checked_table() {
    none(rules::written_table_breaches(TABLE, &tree::read("ARCHITECTURE.md")));
}

#[test]
fn ci_calls_the_makefile_and_the_makefile_sets_up_first() {
    let ci = tree::read(".ci/run");
    let commands: Vec<&str> =
        ci.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with('#')).collect();
    assert_eq!(commands.first(), Some(&"set -euo pipefail"), "a suite that fails ends the run");
    assert!(commands.ends_with(&["make test-clients", "make test"]), "{commands:?}");
    let makefile = tree::read("Makefile");
    for target in ["demo", "test", "clients", "bench", "figures"] {
        assert!(makefile.contains(&format!("\n{target}: setup")), "{target} must call setup first");
    }
}
